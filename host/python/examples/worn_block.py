# %% [markdown]
# # From a drawn part to its wear
#
# A block with two lands: the upper one is judged. A cloud as a sensor would give it is laid on the
# drawing, its deviations are mapped, and the wear of the upper land is read, with its uncertainty. Everything is checked against what
# was done to the block. Run it as a script, or cell by cell.

# %%
import pathlib
import tempfile

import flankscope as fs
import numpy as np

folder = pathlib.Path(tempfile.mkdtemp())

# %% [markdown]
# The drawing (OBJ) and the tool file: which parts are judged, and by what limits (docs/formats/tool.md, `[[patch]]`).

# %%
OUTLINE = [(0, 0), (40, 0), (40, 8), (20, 8), (20, 10), (0, 10)]
corners = [(x, y, z) for y in (0, 20) for x, z in OUTLINE]
faces: list[tuple[int, ...]] = [(1, 2, 3, 4, 5, 6), (12, 11, 10, 9, 8, 7)]
faces += [(at + 1, at + 7, (at + 1) % 6 + 7, (at + 1) % 6 + 1) for at in range(6)]
lines = ["v {} {} {}".format(*corner) for corner in corners] + ["f " + " ".join(map(str, face)) for face in faces]
(folder / "block.obj").write_text("\n".join(lines))
(folder / "tool.toml").write_text("""
name = "block"
[cad]
file = "block.obj"
[[patch]]
name = "upper land"
seed_mm = [10, 10, 10]
angle_deg = 5
up = [0, 1, 0]
datum = ["lower land"]
[[patch]]
name = "lower land"
seed_mm = [30, 10, 8]
angle_deg = 5
up = [0, 1, 0]
[inspect]
warn_um = 30
limit_um = 50
""")
tool = fs.Tool(folder)
cad = tool.mesh
print(tool, cad, "signed" if cad.signed else cad.orientation)

# %% [markdown]
# A worn block: a dimple of 80 µm, 3 mm wide, in the upper land. The cloud is seen in the camera's frame, with 5 µm of noise.

# %%
random = np.random.default_rng(1)
points = cad.sample(3_000_000, seed=1)
points = points[(points[:, 2] > 7.9) & (np.abs(points[:, 0] - 20) > 0.1)]
from_dimple = np.hypot(points[:, 0] - 12, points[:, 1] - 7)
upper = points[:, 2] > 9.9
loss_mm = np.where(upper & (from_dimple < 1.5), 0.08 * np.cos(np.pi / 3 * from_dimple) ** 2, 0.0)
points[:, 2] -= loss_mm
points += random.normal(scale=0.005, size=points.shape)

turn = 0.01
camera_from_tool = np.array([[1, 0, 0, 0.2], [0, np.cos(turn), -np.sin(turn), -0.1], [0, np.sin(turn), np.cos(turn), 0.3], [0, 0, 0, 1]])
cloud = np.ascontiguousarray(points @ camera_from_tool[:3, :3].T + camera_from_tool[:3, 3])

# %% [markdown]
# Laid on the drawing: few of the points lie in the dimple, and far ones count less. A pose that may not be used says why.

# %%
found = fs.register(cloud, cad)
assert found.registered, found.reason
laid = found.apply(cloud)
deviation_mm = fs.deviation(laid, cad)
print(f"{len(laid)} points: rms {1e3 * np.sqrt(np.mean(deviation_mm**2)):.2f} um, deepest {1e3 * deviation_mm.min():.1f} um")
# What is left of the pose's error, of the noise, and of the dimple at its middle.
assert np.abs(deviation_mm[(from_dimple > 2) & upper].mean()) < 0.002

# %% [markdown]
# Wear is the largest mean loss over any disc of 0.25 mm².

# %%
[worn] = fs.wear(laid, tool, sigma_mm=np.full(len(laid), 0.005, np.float32), registration=found)
print(worn, {name: round(1e3 * u, 2) for name, u in worn.budget_mm.items() if u > 0})
disc_mm = np.sqrt(0.25 / np.pi)
radius_mm = np.linspace(0, disc_mm, 1001)[1:]
expected_mm = np.average(0.08 * np.cos(np.pi / 3 * radius_mm) ** 2, weights=radius_mm)
print(f"expected {1e3 * expected_mm:.2f} um")
assert abs(worn.wear_mm - expected_mm) < worn.u95_mm

# %% [markdown]
# The map for plotting (`matplotlib.pyplot.imshow(worn.map_mm, origin="lower")`), or for later.

# %%
np.savez(folder / "wear.npz", map_mm=worn.map_mm, cell_mm=worn.cell_mm, points_mm=laid, deviation_mm=deviation_mm)
print(f"{np.nanmax(worn.map_mm) * 1e3:.1f} um in the deepest of {worn.map_mm.shape} cells")
