"""Shapes and tools of the tests, which share no formula with the package."""

import pathlib

import numpy as np

# A block of 40 x 20 mm with two lands: z = 10 up to x = 20, z = 8 beyond.
OUTLINE = [(0, 0), (40, 0), (40, 8), (20, 8), (20, 10), (0, 10)]


def block() -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of the block, counter-clockwise seen from outside."""
    front = [(x, 0.0, z) for x, z in OUTLINE]
    back = [(x, 20.0, z) for x, z in OUTLINE]
    count = len(OUTLINE)
    sides = []
    for at in range(count):
        after = (at + 1) % count
        sides += [(at, after, count + after), (at, count + after, count + at)]
    # Triangles of the outline that lie within it, seen from the front.
    caps = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    ends = [(a, b, c) for a, b, c in caps] + [(count + a, count + c, count + b) for a, b, c in caps]
    flip = [(a, c, b) for a, b, c in sides]
    # The front is seen along +y: its outline runs clockwise there.
    triangles = np.array([(a, b, c) for a, b, c in flip] + ends, np.uint32)
    return np.array(front + back, np.float64), triangles


def corner() -> tuple[list[tuple[np.ndarray, float]], np.ndarray, np.ndarray]:
    """Three planes (normal away from the camera, distance) that meet in a corner 98 mm before it, and the pyramid between them."""
    apex = np.array([0.0, 0.0, 98.0])
    base = np.array([[80 * np.cos(a), 80 * np.sin(a), 123.0] for a in 0.3 + 2 * np.pi / 3 * np.arange(3)])
    planes = []
    for at in range(3):
        normal = np.cross(base[at] - apex, base[(at + 1) % 3] - apex)
        normal *= np.sign(normal[2]) / np.linalg.norm(normal)
        planes.append((normal, float(normal @ apex)))
    triangles = np.array([(0, 2, 1), (0, 3, 2), (0, 1, 3), (1, 2, 3)], np.uint32)
    return planes, np.vstack([apex, base]), triangles


def write_tool(folder: pathlib.Path) -> pathlib.Path:
    """The block as a tool: its upper land is judged, the lower one is the datum."""
    vertices, triangles = block()
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (folder / "block.obj").write_text("\n".join(lines) + "\n")
    (folder / "tool.toml").write_text(
        'name = "block"\n[cad]\nfile = "block.obj"\n'
        '[[patch]]\nname = "upper land"\nseed_mm = [10, 10, 10]\nangle_deg = 5\nup = [0, 1, 0]\ndatum = ["lower land"]\n'
        '[[patch]]\nname = "lower land"\nseed_mm = [30, 10, 8]\nangle_deg = 5\nup = [0, 1, 0]\n'
        "[inspect]\nwarn_um = 30.0\nlimit_um = 50.0\n"
    )
    return folder


def pose(turn_rad: tuple[float, float, float], shift_mm: tuple[float, float, float]) -> np.ndarray:
    """A rigid motion: turns about x, then y, then z, then a shift."""
    motion = np.eye(4)
    for axis, angle in enumerate(turn_rad):
        turn, (a, b) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
        turn[a, a] = turn[b, b] = np.cos(angle)
        turn[b, a], turn[a, b] = np.sin(angle), -np.sin(angle)
        motion = turn @ motion
    motion[:3, 3] = shift_mm
    return motion


def moved(motion: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points @ motion[:3, :3].T + motion[:3, 3])


def distances(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Signed distance of each point to each triangle's nearest place: brute force, the sign by the solid angle that is enclosed."""
    corners = vertices[triangles]
    found = np.full(len(points), np.inf)
    angle = np.zeros(len(points))
    for a, b, c in corners:
        u, v, w = b - a, c - a, points - a
        normal = np.cross(u, v)
        inverse = np.linalg.inv(np.array([[u @ u, u @ v], [u @ v, v @ v]]))
        s, t = inverse @ np.array([w @ u, w @ v])
        inside = (s >= 0) & (t >= 0) & (s + t <= 1)
        plane = np.abs(w @ normal) / np.linalg.norm(normal)
        edges = np.full(len(points), np.inf)
        for p, q in [(a, b), (b, c), (c, a)]:
            along = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            edges = np.minimum(edges, np.linalg.norm(points - p - along[:, None] * (q - p), axis=1))
        found = np.minimum(found, np.where(inside, plane, edges))
        # Van Oosterom and Strackee 1983.
        x, y, z = (p - points for p in (a, b, c))
        lengths = [np.linalg.norm(p, axis=1) for p in (x, y, z)]
        dot = lambda p, q: np.einsum("ij,ij->i", p, q)
        top = dot(x, np.cross(y, z))
        bottom = np.prod(lengths, axis=0) + dot(x, y) * lengths[2] + dot(y, z) * lengths[0] + dot(z, x) * lengths[1]
        angle += 2 * np.arctan2(top, bottom)
    return np.where(angle > 2 * np.pi, -found, found)
