"""Frames of a plane, rendered by its closed form, and back."""

import itertools
import pathlib
import tempfile
import unittest

import flankscope as fs
import numpy as np

HEAD = """name = "test"
[camera]
width_px = 160
height_px = 120
focal_px = [200.0, 200.0]
principal_px = [79.5, 59.5]
[projector]
width_px = 256
height_px = 192
focal_px = [300.0, 300.0]
principal_px = [217.5, 95.5]
[projector_from_camera]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation_mm = [-30.0, 0.0, 0.0]
"""
SENSOR = "[sensor]\nfull_well_e = 10000.0\ngain_e_per_dn = 2.5\nread_noise_e = 5.0\noffset_dn = 100.0\nbits = 12\n"
PLAN = "exposures_us = [10000]\n[[set]]\nperiods = 1\nsteps = 4\n[[set]]\nperiods = 8\nsteps = 4\n"
AMPLITUDE_DN = 1200.0


def write_plan_and_head(folder):
    """The plan, and the head with its sensor, as files."""
    plan, head = folder / "PLAN.toml", folder / "head.toml"
    plan.write_text(PLAN)
    head.write_text(HEAD + SENSOR)
    return plan, head


def plane():
    """Depth and projector column of every pixel of a slanted plane: z - 0.2 x - 0.1 y = 100 mm."""
    v, u = np.mgrid[0:120, 0:160]
    x, y = (u - 79.5) / 200, (v - 59.5) / 200
    z = 100 / (1 - 0.2 * x - 0.1 * y)
    return z, column_of(z)


def column_of(z):
    """Projector column that lights every pixel, from its depth."""
    x = (np.arange(160) - 79.5) / 200
    return 300 * (x - 30 / z) + 217.5


def frames():
    return frames_of(plane()[0])


def frames_of(z):
    """The frames of the plan, of a surface by the depth of every pixel."""
    column = column_of(z)
    shown = []
    for periods in (1, 8):
        for step in range(4):
            phase = 2 * np.pi * (periods * (column + 0.5) / 256 + step / 4)
            shown.append(np.round(100 + 1500 + AMPLITUDE_DN * np.cos(phase)))
    return np.array(shown, np.uint16)


class Decode(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        (self.folder / "bare.toml").write_text(HEAD)
        plan, head = write_plan_and_head(self.folder)
        self.plan, self.head = fs.Plan(plan), fs.Head(head)

    def test_a_plane_comes_back_as_its_closed_form(self):
        decoder = fs.Decoder(self.plan, self.head, smooth_px=0.0, smooth_coarse_px=0.0)
        self.assertFalse(decoder.sensor_assumed)
        self.assertEqual(len(decoder.frames), 8)
        stack = frames()
        view = decoder.decode(stack)
        depth, column = plane()
        lit = (column > 3) & (column < 252)
        self.assertEqual(self.head.frame_shape, view.mask.shape)
        self.assertTrue(view.mask[lit].all())
        self.assertEqual(view.mask.sum() + sum(view.rejected.values()), view.mask.size)
        self.assertEqual(view.periods.tolist(), [1, 8])
        # Half a count of rounding in each of four steps, all against the phase.
        phase_rad = 2 / 4 * 0.5 * (2 * np.sqrt(2)) / AMPLITUDE_DN
        for at, periods in enumerate((1, 8)):
            expected = 2 * np.pi * periods * (column + 0.5) / 256
            off = np.angle(np.exp(1j * (view.phase_rad[at] - expected)))
            self.assertLess(np.abs(off).max(), phase_rad + 1e-5)
        seen = view.mask
        column_px = phase_rad / (2 * np.pi * 8) * 256
        self.assertLess(np.abs(view.column_px - column)[seen].max(), column_px + 1e-4)
        # A column moves by f b / z^2 pixels per mm.
        self.assertLess((np.abs(view.depth_mm - depth) / depth**2)[seen].max(), (column_px + 1e-4) / (300 * 30) * 1.01)
        self.assertTrue(np.array_equal(view.points_mm[:, 2].astype(np.float32), view.depth_mm[seen]))
        x, y, z = view.points_mm.T
        pixels = np.stack([200 * x / z + 79.5, 200 * y / z + 59.5], 1)
        self.assertLess(np.abs(pixels - view.pixel_px[seen]).max(), 1e-9)
        self.assertTrue((view.sigma_z_mm > 0).all() and view.sigma_z_mm.dtype == np.float32)
        # Amplitude and mean in electrons over four steps' worth of one exposure: 2.5 to the count.
        self.assertTrue(np.allclose(view.modulation_e[1][seen] / view.mean_e[1][seen], AMPLITUDE_DN / 1500, atol=2e-3))
        again = decoder.decode(list(stack))
        self.assertTrue(np.array_equal(again.points_mm, view.points_mm))

    def test_a_set_by_its_name_asks_for_its_frames(self):
        plan = fs.Plan.named("scan16", exposures_us=[10_000])
        self.assertEqual((plan.name, plan.periods), ("scan16", [4, 13, 48]))
        decoder = fs.Decoder(plan, self.head)
        self.assertEqual((len(decoder.frames), decoder.frames[0]), (17, "the dark frame"))
        with self.assertRaisesRegex(fs.FileError, "PLAN.toml"):
            plan.files(self.folder)
        with self.assertRaises(fs.GeometryError):
            fs.Plan.named("none", exposures_us=[10_000])

    def test_frames_in_another_order_than_the_plans_are_noticed(self):
        decoder, stack = fs.Decoder(self.plan, self.head), frames()
        for order, words in [
            # Steps of the fine set exchanged, then the sets.
            ([0, 1, 2, 3, 4, 6, 5, 7], "frames of 8 periods are not one fringe"),
            ([4, 5, 6, 7, 0, 1, 2, 3], "frames of 8 periods show fringes only 0.1 times as fine"),
        ]:
            with self.assertRaisesRegex(fs.GeometryError, words):
                decoder.decode(stack[order])
            with self.assertRaisesRegex(fs.GeometryError, words):
                decoder.decode([stack[at] for at in order])

    def test_what_does_not_fit_is_refused_by_name(self):
        decoder, stack = fs.Decoder(self.plan, self.head), frames()
        for given, words in [
            (stack[:7], "7 frames, of this plan 8"),
            (stack.astype(np.uint8), "uint8; uint16"),
            (stack[:, :, ::-1], "ascontiguousarray"),
            (np.ascontiguousarray(stack[:, 1:]), r"\[8, 119, 160\]; \(frames, 120, 160\)"),
            (stack[0], r"\[120, 160\]; \(frames, 120, 160\)"),
            (np.empty((8, 0, 0), np.uint16), r"\[8, 0, 0\]"),
            (np.empty((0, 120, 160), np.uint16), "0 frames"),
            # A view of one pixel that claims to be 1e11 frames.
            (np.lib.stride_tricks.as_strided(stack[0, 0, :1], (10**11, 120, 160), (0, 0, 0)), "ascontiguousarray"),
            (itertools.repeat(stack[0]), "more than 8 frames"),
            ([*stack[:7], stack[7, 1:]], r"frames\[7\] has the shape \[119, 160\]; \(120, 160\)"),
            ([*stack[:7], stack[7].astype(np.float64)], r"frames\[7\] is of float64"),
            ([], "0 frames"),
        ]:
            with self.assertRaisesRegex(fs.ArrayError, words):
                decoder.decode(given)
        bare = fs.Head(self.folder / "bare.toml")
        with self.assertRaisesRegex(fs.GeometryError, "bits"):
            fs.Decoder(self.plan, bare)
        self.assertTrue(fs.Decoder(self.plan, bare, bits=12).sensor_assumed)
        for named, words in [({"bits": 17}, "17"), ({"cores": True}, "core"), ({"min_contrast": float("nan")}, "min_contrast")]:
            with self.assertRaisesRegex(fs.GeometryError, words):
                fs.Decoder(self.plan, self.head, **named)
        (self.folder / "bad.toml").write_text(HEAD + "colour = 3\n")
        with self.assertRaisesRegex(fs.FileError, "bad.toml"):
            fs.Head(self.folder / "bad.toml")


if __name__ == "__main__":
    unittest.main()
