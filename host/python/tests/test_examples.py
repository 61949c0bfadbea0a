"""The examples, run as a user runs them."""

import importlib.util
import io
import os
import pathlib
import runpy
import subprocess
import sys
import tempfile
import unittest

import flankscope as fs
import numpy as np
import pandas as pd
from PIL import Image
from shapes import corner, pose
from test_decode import frames_of, plane, write_plan_and_head

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"


def run(example: str, *arguments: object) -> str:
    command = [sys.executable, EXAMPLES / example, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"})
    if ended.returncode:
        raise AssertionError(f"{example}: {ended.stderr}")
    return ended.stdout


def write_frames(folder: pathlib.Path, stack: np.ndarray) -> pathlib.Path:
    folder.mkdir()
    for at, frame in enumerate(stack):
        Image.fromarray(frame).save(folder / f"{at:02}.png")
    return folder


class Examples(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.files = write_plan_and_head(self.folder)

    def test_decode_makes_the_points_that_the_package_makes(self):
        depth, _ = plane()
        stack = frames_of(depth)
        said = run("decode.py", *self.files, write_frames(self.folder / "view", stack), self.folder / "points.npz")
        written = np.load(self.folder / "points.npz")
        view = fs.Decoder(fs.Plan(self.files[0]), fs.Head(self.files[1])).decode(stack)
        self.assertTrue(np.array_equal(written["points_mm"], view.points_mm))
        self.assertTrue(np.array_equal(written["sigma_z_mm"], view.sigma_z_mm))
        self.assertIn(f"{len(view.points_mm)} points of {view.mask.size} cells", said)

    def test_history_table_finds_the_rate_of_the_present_life(self):
        # The columns as docs/formats/history.md lists them.
        page = (EXAMPLES.parents[2] / "docs/formats/history.md").read_text()
        listed = page.split("writes a line per check and flank: `")[1].split("`")[0]
        columns = [name.strip() for name in listed.split(",")]
        rows = []
        # A life of 40 checks, then one of 5, the first by another baseline: 0.02 um per cycle left, none right. Between them another tool's.
        for check in range(45):
            cycles = 5 * check if check < 40 else 100 * (check - 39)
            base = {"check": 2 * check + 1, "tool": "die", "tool_cycles": cycles, "tooth": 7, "limit_um": 50.0, "u95_um": 1.96}
            base["baseline"] = "b1" if check == 40 else "b2"
            left_um = 10 + 0.02 * cycles if check > 40 else 90.0
            for flank, wear_um in (("left", left_um), ("right", 3.0), ("face", np.nan)):
                rows.append(dict.fromkeys(columns) | base | {"flank": flank, "wear_um": wear_um})
            if check < 44:
                rows.append(rows[-2] | {"check": 2 * check + 2, "tool": "other", "wear_um": 70.0})
        table = pd.DataFrame(rows, columns=columns)
        table.to_csv(self.folder / "table.csv", index=False)
        lines = run("history_table.py", self.folder / "table.csv").splitlines()
        self.assertEqual(len(lines), 3)
        self.assertEqual(lines[1].split()[:4], ["7", "left", "4", "20"])
        found = runpy.run_path(str(EXAMPLES / "history_table.py"))["trends"](pd.read_csv(io.StringIO(table.to_csv())))
        left = found.iloc[0]
        # A line through exact values, of four checks 100 cycles apart, each known to 1 um: 1 / sqrt(sum of squares about their mean).
        self.assertAlmostEqual(left["um_per_cycle"], 0.02, 9)
        self.assertAlmostEqual(left["u_um_per_cycle"], 1 / np.sqrt(50_000), 9)
        self.assertAlmostEqual(found.iloc[1]["um_per_cycle"], 0, 9)

    @unittest.skipUnless(importlib.util.find_spec("rerun"), "rerun-sdk is not installed")
    def test_view3d_writes_a_recording_that_reruns_own_reader_opens(self):
        from rerun.chunk import RrdReader

        planes, vertices, triangles = corner()
        lines = ["v {} {} {}".format(*v) for v in vertices] + ["f {} {} {}".format(*(t + 1)) for t in triangles]
        (self.folder / "corner.obj").write_text("\n".join(lines) + "\n")
        folders = []
        for number, shift in enumerate((0.0, 0.2)):
            motion = pose((0, 0, 0), (shift, 0, 0))
            v, u = np.mgrid[0:120, 0:160]
            rays = np.stack([(u - 79.5) / 200, (v - 59.5) / 200, np.ones_like(u)], -1)
            # A ray enters a convex body through the last of the planes that face it.
            depth = np.max([(d + n @ motion[:3, 3]) / (rays @ n) for n, d in planes], axis=0)
            folders.append(write_frames(self.folder / f"view{number}", frames_of(depth)))
        out = self.folder / "views.rrd"
        said = run("view3d.py", *self.files, self.folder / "corner.obj", out, *folders)
        self.assertEqual(said.count("rms"), 2, said)
        entities: dict[str, int] = {}
        timelines = set()
        for chunk in RrdReader(out).stream():
            entities[chunk.entity_path] = entities.get(chunk.entity_path, 0) + chunk.num_rows
            timelines |= set(chunk.timeline_names)
        for path, rows in [("/tool/cad", 1), ("/tool/points", 2), ("/tool/camera", 2), ("/camera/frame", 16)]:
            self.assertEqual(entities.get(path), rows, entities)
        self.assertTrue({"view", "frame"} <= timelines, timelines)


if __name__ == "__main__":
    unittest.main()
