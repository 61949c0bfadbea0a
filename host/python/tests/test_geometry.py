"""Mesh, deviation, registration and wear against brute force, closed forms and trimesh."""

import pathlib
import tempfile
import threading
import unittest

import flankscope as fs
import numpy as np
import trimesh
from shapes import block, distances, moved, pose, write_tool


class Deviation(unittest.TestCase):
    def test_of_a_block_is_that_of_brute_force_and_of_trimesh(self):
        vertices, triangles = block()
        mesh = fs.Mesh(vertices, triangles)
        self.assertTrue(mesh.signed, mesh.orientation)
        self.assertEqual(mesh.orientation, "")
        points = np.random.default_rng(1).uniform([-5, -5, -5], [45, 25, 15], (3000, 3))
        found = fs.deviation(points, mesh)
        self.assertLess(np.abs(found - distances(points, vertices, triangles)).max(), 1e-9)
        theirs = trimesh.proximity.signed_distance(trimesh.Trimesh(vertices, triangles), points)
        self.assertLess(np.abs(found + theirs).max(), 1e-6)

    def test_of_a_sphere_is_the_closed_form_within_its_facets(self):
        sphere = trimesh.creation.icosphere(subdivisions=4, radius=10)
        mesh = fs.Mesh(np.array(sphere.vertices, np.float64), np.array(sphere.faces, np.uint32))
        points = np.random.default_rng(2).normal(size=(2000, 3)) * 6
        radius = np.linalg.norm(points, axis=1)
        # The facets' planes lie within the sphere, by no more than this.
        chord_mm = 10 - np.linalg.norm(sphere.triangles.mean(axis=1), axis=1).min()
        away = fs.deviation(points, mesh) - (radius - 10)
        self.assertTrue((away > -1e-9).all() and (away < 1.01 * chord_mm).all(), (away.min(), away.max(), chord_mm))

    def test_nearest_is_brute_force_in_every_order(self):
        random = np.random.default_rng(3)
        points, reference = random.uniform(size=(200, 3)), random.uniform(size=(300, 3))
        apart = np.abs(points[:, None] - reference[None])
        for order, expected in [(1, apart.sum(2)), (2, np.linalg.norm(apart, axis=2)), (np.inf, apart.max(2))]:
            found = fs.nearest(points, reference, order=order)
            self.assertLess(np.abs(found - expected.min(axis=1)).max(), 1e-12, order)

    def test_triangles_that_were_wound_the_wrong_way_are_turned_and_it_is_said(self):
        vertices, triangles = block()
        mesh = fs.Mesh(vertices, np.ascontiguousarray(triangles[:, ::-1]))
        self.assertIn("turned", mesh.orientation)
        self.assertEqual(fs.deviation(np.array([[10.0, 10.0, 11.0]]), mesh)[0], 1)

    def test_a_file_is_read_with_its_unit(self):
        with tempfile.TemporaryDirectory() as folder:
            write_tool(pathlib.Path(folder))
            mesh = fs.Mesh.load(f"{folder}/block.obj", unit="inch")
            self.assertEqual(mesh.vertices_mm[:, 0].max(), 40 * 25.4)
            with self.assertRaisesRegex(fs.FileError, "nothing.stl"):
                fs.Mesh.load(f"{folder}/nothing.stl")
            with self.assertRaisesRegex(fs.GeometryError, "furlong"):
                fs.Mesh.load(f"{folder}/block.obj", unit="furlong")


class Register(unittest.TestCase):
    def setUp(self):
        vertices, triangles = block()
        self.mesh = fs.Mesh(vertices, triangles)
        theirs, _ = trimesh.sample.sample_surface(trimesh.Trimesh(vertices, triangles), 20_000, seed=4)
        self.points = np.array(theirs, np.float64)
        self.motion = pose((0.01, -0.02, 0.015), (0.3, -0.2, 0.4))

    def test_finds_the_pose_that_the_cloud_was_moved_by(self):
        noise = np.random.default_rng(5).normal(scale=0.005, size=self.points.shape)
        cloud = moved(self.motion, self.points + noise)
        for reference in (self.mesh, self.points):
            found = fs.register(cloud, reference)
            self.assertTrue(found.registered and found.status == "registered" and found.reason is None, found)
            back = found.apply(cloud) - self.points - noise
            # 5 um over the root of thousands of points along any direction is below 0.2 um.
            self.assertLess(np.abs(back).max(), 0.0015 if reference is self.mesh else 0.01)
            self.assertTrue(np.allclose(found.tool_from_cloud @ self.motion, np.eye(4), atol=0.01))
            self.assertEqual(found.covariance.shape, (6, 6))
            self.assertTrue((np.linalg.eigvalsh(found.covariance) > 0).all())
        self.assertAlmostEqual(fs.register(cloud, self.mesh, sigma_mm=np.full(len(cloud), 0.005, np.float32)).rms_mm, 0.005, 3)

    def test_starts_where_it_is_told_and_says_why_it_found_nothing(self):
        far = pose((0, 0, 1.0), (200.0, 0, 0))
        cloud = moved(far, self.points)
        lost = fs.register(cloud, self.mesh)
        self.assertFalse(lost.registered)
        self.assertEqual(lost.reason_code, "disjoint")
        self.assertIn("at least 50 %", lost.reason)
        found = fs.register(cloud, self.mesh, initial=np.linalg.inv(far))
        self.assertTrue(found.registered, found)

    def test_refuses_what_is_no_option(self):
        for named, words in [
            ({"noise_mm": float("nan")}, "noise_mm is NaN"),
            ({"capture_mm": -1.0}, "capture_mm is -1"),
            ({"least_inliers": 2.0}, "least_inliers is 2"),
            ({"teeth": 0}, "teeth is 0"),
            ({"initial": np.diag([2.0, 1, 1, 1])}, "."),
        ]:
            with self.assertRaisesRegex(fs.GeometryError, words):
                fs.register(self.points, self.mesh, **named)
        with self.assertRaisesRegex(fs.GeometryError, "20"):
            fs.register(self.points, self.points[:19])


class Wear(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.tool = fs.Tool(write_tool(pathlib.Path(self.folder.name)))
        x, y = np.meshgrid(np.arange(0.0, 20, 0.05) + 0.02, np.arange(0.0, 20, 0.05) + 0.02)
        self.x, self.y = x.ravel(), y.ravel()

    def land(self, loss_mm):
        return np.stack([self.x, self.y, 10 - loss_mm * np.ones_like(self.x)], 1)

    def test_of_a_pit_is_its_depth(self):
        self.assertEqual((self.tool.name, self.tool.teeth, self.tool.inspected), ("block", None, [1]))
        pit = (np.abs(self.x - 12) < 1) & (np.abs(self.y - 7) < 1)
        [worn] = fs.wear(self.land(0.1 * pit), self.tool, sigma_mm=np.full(pit.size, 1e-4, np.float32))
        self.assertEqual((worn.tooth, worn.flank), (1, "face"))
        # A flat pit of 4 mm2 holds a disc of 0.25 mm2 whole.
        self.assertAlmostEqual(worn.wear_mm, 0.1, 4)
        self.assertEqual(worn.coverage, 1)
        rows, columns = worn.map_mm.shape
        # The zone is the land but for a rim of 0.25 mm.
        self.assertAlmostEqual(rows * worn.cell_mm[1], 19.5, 6)
        self.assertAlmostEqual(columns * worn.cell_mm[0], 19.5, 6)
        # Cells at the pit's rim count in part: half of one on each side, at most.
        most_mm = 0.1 * (2 + max(worn.cell_mm)) ** 2 / 19.5**2
        least_mm = 0.1 * (2 - max(worn.cell_mm)) ** 2 / 19.5**2
        self.assertTrue(least_mm < worn.mean_mm < most_mm, (least_mm, worn.mean_mm, most_mm))
        self.assertAlmostEqual(worn.u_mm, np.sqrt(sum(u**2 for u in worn.budget_mm.values())), 12)
        self.assertAlmostEqual(worn.u95_mm, 1.959964 * worn.u_mm, 6)

    def test_of_no_points_is_nan(self):
        [worn] = fs.wear(self.land(0.0)[self.x < 0.0], self.tool)
        self.assertTrue(np.isnan(worn.wear_mm) and worn.coverage == 0 and np.isnan(worn.map_mm).all())

    def test_is_not_read_where_points_lie_nowhere(self):
        mesh = self.tool.mesh
        nowhere = fs.register(self.land(0.0) + 500, mesh)
        with self.assertRaisesRegex(fs.GeometryError, "indeterminate"):
            fs.wear(self.land(0.0), self.tool, registration=nowhere)
        for number in (0, 2, 3):
            with self.assertRaisesRegex(fs.GeometryError, f"{number} is no number"):
                fs.wear(self.land(0.0), self.tool, teeth=[number])
        with self.assertRaisesRegex(fs.FileError, "tool.toml"):
            fs.Tool(self.folder.name + "/none")


class Border(unittest.TestCase):
    def setUp(self):
        self.mesh = fs.Mesh(*block())
        self.points = np.random.default_rng(6).uniform(size=(1000, 3))

    def test_names_what_is_wrong_with_an_array_and_what_would_be_right(self):
        holes = self.points.copy()
        holes[17, 2] = np.nan
        far = self.points.copy()
        far[3, 1] = 1e300
        # In one piece row after row, and one byte beside where float64 may lie.
        beside = np.empty(8 * 3000 + 1, np.uint8)[1:].view(np.float64).reshape(1000, 3)
        beside[:] = self.points
        # A view of three numbers that claims to be more points than any memory holds.
        claimed = np.lib.stride_tricks.as_strided(self.points, (10**15, 3), (0, 8))
        for array, error, words in [
            (self.points.astype(np.float32), fs.ArrayError, "float32; float64"),
            (self.points.astype(">f8"), fs.ArrayError, "float64"),
            (self.points[:, :2], fs.ArrayError, r"\[1000, 2\]; \(n, 3\)"),
            (self.points[0], fs.ArrayError, r"\[3\]"),
            (self.points[::2], fs.ArrayError, "ascontiguousarray"),
            (np.asfortranarray(self.points), fs.ArrayError, "ascontiguousarray"),
            (beside, fs.ArrayError, r"points_mm\.copy"),
            (claimed, fs.ArrayError, "ascontiguousarray"),
            (self.points.tolist(), fs.ArrayError, "list"),
            (holes, fs.NotFiniteError, r"points_mm\[17, 2\] is NaN"),
            (np.full((1, 3), np.inf), fs.NotFiniteError, "inf"),
            (far, fs.GeometryError, r"points_mm\[3, 1\] is 1e300 mm; at most 1e9 mm"),
        ]:
            with self.assertRaisesRegex(error, words):
                fs.deviation(array, self.mesh)
            with self.assertRaises(ValueError):
                fs.register(array, self.mesh)
        with self.assertRaisesRegex(fs.GeometryError, "at most 1000000000"):
            self.mesh.sample(10**12)
        for sigma in (np.ones(999, np.float32), np.zeros(1000, np.float32), np.ones(1000)):
            with self.assertRaises(fs.ArrayError):
                fs.register(self.points, self.mesh, sigma_mm=sigma)
        vertices, triangles = block()
        with self.assertRaisesRegex(fs.GeometryError, "12"):
            fs.Mesh(vertices, triangles + np.uint32(5))
        with self.assertRaises(fs.GeometryError):
            fs.Mesh(vertices, triangles[:0])
        with self.assertRaisesRegex(fs.GeometryError, "vertices_mm"):
            fs.Mesh(vertices * 1e300, triangles)

    def test_takes_an_array_that_must_not_be_written_to_and_no_points_at_all(self):
        self.points.flags.writeable = False
        self.assertEqual(len(fs.deviation(self.points, self.mesh)), 1000)
        self.assertEqual(fs.deviation(np.empty((0, 3)), self.mesh).shape, (0,))
        self.assertEqual(fs.register(np.empty((0, 3)), self.mesh).reason_code, "too_few_points")

    def test_gives_arrays_that_are_the_callers_own(self):
        found = fs.deviation(self.points, self.mesh)
        self.assertTrue(found.flags.writeable and found.flags.c_contiguous)
        # Not copied: the memory is that of Rust's own vector.
        self.assertIn("PySliceContainer", type(found.base).__name__)

    def test_lets_other_threads_go_on(self):
        points = np.random.default_rng(7).uniform(-5, 45, (2_000_000, 3))
        begun, done = threading.Event(), threading.Event()

        def compute():
            begun.set()
            fs.deviation(points, self.mesh)
            done.set()

        thread = threading.Thread(target=compute)
        thread.start()
        begun.wait()
        steps = 0
        while not done.is_set():
            steps += 1
        thread.join()
        # With the lock held, no more than passes between two lines.
        self.assertGreater(steps, 1000)


if __name__ == "__main__":
    unittest.main()
