"""Recorded frames of the demo die, of steel without any diffuse part, by Mitsuba 3, a physically based path tracer; see README.md.

usage: steel.py DIE.ply OUT [--roughness 0.3] [--samples 96] [--exposures 1,4] [--turns 0,1.25] [--average]
OUT gets frames.toml, plan.toml, head.toml and a folder of frames for every turn of the die, in pitches, about tooth 40: what
`flankscope inspect --frames OUT --teeth 40` reads. A rendering has noise that a camera has not: light over other surfaces comes along a
few random paths, and no longer exposure averages that. --average takes its mean over neighbouring pixels of the same surface, 1 by 4
pixels (standard deviation of a Gaussian), as if by some fifty times the samples.
"""

import argparse
from pathlib import Path

import mitsuba as mi
import numpy as np
from pinhole_head import (
    COLUMNS,
    PROJECTOR_FOCAL,
    ROWS,
    camera_at,
    even,
    fov_deg,
    place,
    projector_from_camera,
    stage_from_camera,
    steel,
)

mi.set_variant("llvm_ad_rgb")
arguments = argparse.ArgumentParser()
arguments.add_argument("die")
arguments.add_argument("out", type=Path)
arguments.add_argument("--roughness", type=float, default=0.3)
arguments.add_argument("--samples", type=int, default=96)
arguments.add_argument("--exposures", default="1,4", help="the first shows 3 %% of the lit pixels beyond 3300 counts")
arguments.add_argument("--turns", default="0")
arguments.add_argument("--average", action="store_true")
given = arguments.parse_args()
EXPOSURES = [float(ratio) for ratio in given.exposures.split(",")]

WIDTH, HEIGHT, FOCAL = 960, 600, 1265.0
PITCH, HEIGHT_MM = 2 * np.pi / 84, 33.0
TOOTH = 39.5 * PITCH
OFF_MM = [0.035, -0.020, 0.040]  # the die on its seat, which the stages do not know of
SETS = [(41, 4), (45, 4), (48, 8)]  # high16: periods, steps
ELECTRONS_PER_COUNT, READ_NOISE_E, OFFSET = 7.91, 7.0, 100
STRAIGHT, ALL = 2, 6  # path edges: light straight from the projector, over up to five places


def scene_of(camera, picture, edges):
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgb"}
    film |= {"component_format": "float32", "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": fov_deg(WIDTH, FOCAL), "fov_axis": "x", "near_clip": 0.1, "film": film}
    sensor |= {"to_world": place(camera), "sampler": {"type": "independent", "sample_count": given.samples}}
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
    projector = {"type": "projector", "fov": fov_deg(COLUMNS, PROJECTOR_FOCAL), "scale": 1.0, "irradiance": bitmap}
    projector |= {"to_world": place(camera @ np.linalg.inv(projector_from_camera))}
    die = {"type": "ply", "filename": given.die, "face_normals": True, "bsdf": {"type": "twosided", "surface": steel(given.roughness)}}
    path = {"type": "path", "max_depth": edges}
    return mi.load_dict({"type": "scene", "integrator": path, "sensor": sensor, "emitter": projector, "die": die})


def lanes(camera, edges):
    """An evenly lit projector, then cosine and sine part of the fringes of every set: three patterns at a time, as colours."""
    columns = np.arange(COLUMNS) + 0.5
    patterns = [np.ones(COLUMNS)]
    for periods, _ in SETS:
        phase = 2 * np.pi * periods * columns / COLUMNS
        patterns += [0.5 + 0.5 * np.cos(phase), 0.5 + 0.5 * np.sin(phase)]
    shown = []
    for first in range(0, len(patterns), 3):
        three = (patterns[first : first + 3] + [np.ones(COLUMNS)] * 2)[:3]
        picture = np.repeat(np.stack(three, -1)[None], ROWS, 0).astype(np.float32)
        scene = scene_of(camera, picture, edges)
        parts = max(1, given.samples // 96)
        renderings = [np.array(mi.render(scene, spp=given.samples // parts, seed=part), float) for part in range(parts)]
        shown += list(np.moveaxis(sum(renderings) / parts, -1, 0))
    return np.array([shown[0]] + [2 * half - shown[0] for half in shown[1 : len(patterns)]])


def surfaces(camera):
    """A number for every flank and land, by pixel."""
    x, y = np.meshgrid((np.arange(WIDTH) - (WIDTH - 1) / 2) / FOCAL, (np.arange(HEIGHT) - (HEIGHT - 1) / 2) / FOCAL)
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ camera[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    axes = [np.ascontiguousarray(rays[:, axis], dtype=np.float32) for axis in range(3)]
    origin = [np.full(len(rays), value, dtype=np.float32) for value in camera[:3, 3]]
    met = mi.load_dict({"type": "scene", "die": {"type": "ply", "filename": given.die, "face_normals": True}})
    met = met.ray_intersect(mi.Ray3f(o=mi.Point3f(*origin), d=mi.Vector3f(*axes)))
    far, normal = np.array(met.t, dtype=float), np.array(met.n).T
    at = camera[:3, 3] + rays * np.where(np.isfinite(far), far, 0)[:, None]
    radius = np.hypot(at[:, 0], at[:, 1])
    tooth = np.rint((np.arctan2(at[:, 1], at[:, 0]) - TOOTH) / PITCH)
    across = (at[:, 0] * normal[:, 1] - at[:, 1] * normal[:, 0]) / radius
    side = np.where(np.abs(across) > 0.5, np.sign(across), np.where(radius > 41.5, 2, 0))
    return np.where(np.isfinite(far), 8 * tooth + side, np.nan).reshape(HEIGHT, WIDTH)


def averaged(light, surface):
    """Mean of light over neighbouring pixels of the same surface."""
    gaussian = [np.exp(-2 * (np.pi * sigma * np.fft.fftfreq(size)) ** 2) for sigma, size in ((4, HEIGHT), (1, WIDTH))]
    blur = lambda plane: np.fft.ifft2(np.fft.fft2(plane) * np.outer(*gaussian)).real
    for number in np.unique(surface[np.isfinite(surface)]):
        inside = surface == number
        weight = np.maximum(blur(inside.astype(float)), 1e-6)
        for plane in light:
            plane[inside] = (blur(np.where(inside, plane, 0)) / weight)[inside]
    return light


def table(pose):
    return "[" + ", ".join("[" + ", ".join(f"{value:.12g}" for value in row) + "]" for row in pose[:3, :3]) + "]"


given.out.mkdir(parents=True, exist_ok=True)
random = np.random.default_rng(1)
gain = None
index = 'simulated = true\nplan = "plan.toml"\nhead = "head.toml"\n'
for turn in [float(pitches) for pitches in given.turns.split(",")]:
    camera = camera_at(TOOTH - turn * PITCH, HEIGHT_MM, OFF_MM)
    light = lanes(camera, ALL)
    if given.average:
        straight = lanes(camera, STRAIGHT)
        light = straight + averaged(light - straight, surfaces(camera))
    even_light = light[0]
    gain = gain or 3300 / np.percentile(even_light[even_light > 0], 97)
    folder = given.out / f"turn-{turn:g}"
    folder.mkdir(exist_ok=True)
    frame = 0
    for ratio in EXPOSURES:
        for at, (_, steps) in enumerate(SETS):
            for shift in 2 * np.pi * np.arange(steps) / steps:
                wave = np.cos(shift) * light[1 + 2 * at] - np.sin(shift) * light[2 + 2 * at]
                electrons = np.maximum(0.5 * (even_light + wave), 0) * gain * ratio * ELECTRONS_PER_COUNT
                electrons = random.normal(electrons, np.sqrt(electrons + READ_NOISE_E**2))
                counts = np.clip(np.rint(electrons / ELECTRONS_PER_COUNT + OFFSET), 0, 4095).astype(np.uint16)
                mi.Bitmap(counts[:, :, None]).write(str(folder / f"frame_{frame:03}.png"))
                frame += 1
    index += f'[[view]]\nfolder = "{folder.name}"\ntooth = 40\n'
    index += f"rotation_rad = {turn * PITCH - TOOTH!r}\nvertical_mm = {HEIGHT_MM}\n"
    print(f"turned by {turn:g} pitches: {np.mean(even_light > 0):.3f} of the view is lit", flush=True)

sensor = f"[sensor]\nfull_well_e = 32400.0\ngain_e_per_dn = {ELECTRONS_PER_COUNT}\nread_noise_e = {READ_NOISE_E}\n"
sensor += f"offset_dn = {OFFSET:.1f}\nbits = 12\n"
lenses = ""
for name, width, height, focal in (("camera", WIDTH, HEIGHT, FOCAL), ("projector", COLUMNS, ROWS, PROJECTOR_FOCAL)):
    lenses += f"[{name}]\nwidth_px = {width}\nheight_px = {height}\nfocal_px = [{focal}, {focal}]\n"
    lenses += f"principal_px = [{(width - 1) / 2}, {(height - 1) / 2}]\n"
for name, pose in (("projector_from_camera", projector_from_camera), ("stage_from_camera", stage_from_camera)):
    lenses += f"[{name}]\nrotation = {table(pose)}\ntranslation_mm = {[float(value) for value in pose[:3, 3]]}\n"
exposures = ", ".join(f"{10_000 * ratio:.0f}" for ratio in EXPOSURES)
sets = "".join(f"[[set]]\nperiods = {periods}\nsteps = {steps}\n" for periods, steps in SETS)
(given.out / "plan.toml").write_text(f'name = "high16"\nexposures_us = [{exposures}]\n{sets}{sensor}')
(given.out / "head.toml").write_text(
    f'name = "two pinholes"\nbinning = 1\n{lenses}{sensor}[volume]\nnear_mm = 20.3\nfar_mm = 23.7\n'
)
(given.out / "frames.toml").write_text(index)
