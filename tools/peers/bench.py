"""Times other tools on the benchmark's data; see README.md."""

import json
import sys
import time
from pathlib import Path

import numpy as np
import open3d as o3d
import small_gicp
import trimesh

THREADS = 2
folder = Path(sys.argv[1])
o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)


def report(name, seconds, processor, note=None):
    ms, cpu_ms = (sorted(1e3 * s for s in times) for times in (seconds, processor))
    figure = {"name": name, "ms": ms[len(ms) // 2], "cpu_ms": cpu_ms[len(ms) // 2], "all": ms}
    if note:
        figure["note"] = note
    print(json.dumps(figure), flush=True)


def timed(name, work, repeats=5, note=None):
    """Median of `repeats` runs after one that is not counted; returns the last result."""
    seconds, processor, result = [], [], work()
    for _ in range(repeats):
        start, before = time.perf_counter(), time.process_time()
        result = work()
        seconds.append(time.perf_counter() - start)
        processor.append(time.process_time() - before)
    report(name, seconds, processor, note(result) if note else None)
    return result


def cloud(name):
    return np.fromfile(folder / name, dtype="<f8").reshape(-1, 3)


def legacy(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def error_um(found, truth, points):
    """Root mean square distance between the points under both poses."""
    moved = [points @ t[:3, :3].T + t[:3, 3] for t in (found, truth)]
    return 1e3 * np.sqrt(np.mean(np.sum((moved[0] - moved[1]) ** 2, axis=1)))


def registration():
    mesh = o3d.io.read_triangle_mesh(str(folder / "feature.ply"))
    o3d.utility.random.seed(1)
    mesh.compute_triangle_normals()
    sampled = mesh.sample_points_uniformly(100_000, use_triangle_normal=True)
    target_points = np.asarray(sampled.points)
    source_points = cloud("feature.f64")
    truth = np.fromfile(folder / "truth.f64", dtype="<f8").reshape(4, 4)

    def prepare():
        target = small_gicp.PointCloud(target_points)
        tree = small_gicp.KdTree(target, num_threads=THREADS)
        small_gicp.estimate_normals(target, tree, num_neighbors=10, num_threads=THREADS)
        return target, tree, small_gicp.PointCloud(source_points)

    target, tree, source = timed("small_gicp/prepare", prepare)
    timed(
        "small_gicp/align",
        lambda: small_gicp.align(
            target,
            source,
            tree,
            registration_type="PLANE_ICP",
            max_correspondence_distance=1.0,
            num_threads=THREADS,
            rotation_epsilon=1e-6,
            translation_epsilon=1e-5,
            max_iterations=50,
        ),
        note=lambda r: f"{error_um(r.T_target_source, truth, source_points):.3f} µm to the truth, {r.iterations} steps",
    )
    source = legacy(source_points)
    icp = o3d.pipelines.registration
    timed(
        "open3d/register",
        lambda: icp.registration_icp(
            source,
            sampled,
            1.0,
            np.eye(4),
            icp.TransformationEstimationPointToPlane(),
            icp.ICPConvergenceCriteria(1e-8, 1e-8, 50),
        ),
        note=lambda r: f"{error_um(r.transformation, truth, source_points):.3f} µm to the truth",
    )


def distance():
    for name in ("coarse", "fine"):
        mesh = o3d.t.io.read_triangle_mesh(str(folder / f"{name}.ply"))

        def prepare():
            scene = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
            scene.add_triangles(mesh)
            # The hierarchy is built with the first query.
            scene.compute_distance(np.zeros((1, 3), np.float32), nthreads=THREADS)
            return scene

        scene = timed(f"open3d/prepare/{name}", prepare, repeats=3)
        for order in ("random", "sorted", "scan"):
            points = o3d.core.Tensor(cloud(f"{order}.f64").astype(np.float32))
            timed(
                f"open3d/distance/{name}/{order}",
                lambda: scene.compute_signed_distance(points, nthreads=THREADS),
                repeats=5,
            )
            timed(
                f"open3d/unsigned/{name}/{order}",
                lambda: scene.compute_distance(points, nthreads=THREADS),
                repeats=5,
            )


def clouds():
    mesh = o3d.io.read_triangle_mesh(str(folder / "fine.ply"))
    timed("open3d/sample", lambda: mesh.sample_points_uniformly(100_000), repeats=9)
    for name in ("feature", "view"):
        points = legacy(cloud(f"{name}.f64"))
        for k in (8, 20):
            timed(
                f"open3d/outliers/{name}/{k}",
                lambda: points.remove_statistical_outlier(k, 2.0),
                repeats=7,
            )
    for order in ("random", "scan"):
        points = legacy(cloud(f"{order}.f64"))
        timed(
            f"open3d/merge/{order}",
            lambda: points.voxel_down_sample(0.05),
            repeats=5,
            note=lambda r: f"{len(r.points)} points",
        )


def loading():
    for kind in ("ply", "stl"):
        path = str(folder / f"fine.{kind}")
        timed(f"open3d/load/{kind}", lambda: o3d.io.read_triangle_mesh(path))
        timed(f"trimesh/load/{kind}", lambda: trimesh.load(path))


def brute_force(points, corners):
    """Distance of every point to the nearest of all triangles, in f64: to the plane where the foot lies inside, else to the edges."""
    a = corners[:, 0]
    edges = [corners[:, (k + 1) % 3] - corners[:, k] for k in range(3)]
    normal = np.cross(edges[0], edges[1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inward = [np.cross(normal, edge) for edge in edges]
    nearest = np.empty(len(points))
    for i, point in enumerate(points):
        off = [point - corners[:, k] for k in range(3)]
        inside = np.all([np.einsum("ij,ij->i", off[k], inward[k]) >= 0 for k in range(3)], axis=0)
        best = np.abs(np.einsum("ij,ij->i", point - a, normal))
        best[~inside] = np.inf
        for k in range(3):
            along = np.einsum("ij,ij->i", off[k], edges[k]) / np.einsum("ij,ij->i", edges[k], edges[k])
            foot = np.clip(along, 0, 1)[:, None] * edges[k]
            best = np.minimum(best, np.linalg.norm(off[k] - foot, axis=1))
        nearest[i] = best.min()
    return nearest


def accuracy():
    for name, count in (("coarse", 2000), ("fine", 100)):
        mesh = o3d.t.io.read_triangle_mesh(str(folder / f"{name}.ply"))
        corners = mesh.vertex.positions.numpy().astype(float)[mesh.triangle.indices.numpy()]
        scene = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
        scene.add_triangles(mesh)
        points = cloud("random.f64")
        points = points[:: len(points) // count][:count]
        found = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
        off_um = 1e3 * np.abs(found - brute_force(points, corners))
        note = (
            f"off brute force by up to {off_um.max():.1f} µm, by more than 1 µm on {100 * np.mean(off_um > 1):.0f} % "
            f"of {count} points, median {np.median(off_um):.3f} µm"
        )
        print(json.dumps({"name": f"open3d/accuracy/{name}", "note": note}), flush=True)


wanted = sys.argv[2:] or ["registration", "clouds", "loading", "distance", "accuracy"]
for part in wanted:
    globals()[part]()
