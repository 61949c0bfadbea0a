"""The demo die's light by Mitsuba 3, a physically based path tracer; see README.md.

usage: light.py DIE.ply OUT

For each surface and number of path edges (2: light straight from the projector, 6: up to five places) OUT gets
SURFACE-EDGES.f32: little-endian float32 images of an evenly lit projector, then cosine and sine part of fringes of 4 and of 48
periods; and pose.txt, the camera in the die's frame (4 x 4, mm), the same for all. The head has two pinholes: no fibres, no blur.
"""

import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
from pinhole_head import COLUMNS, PROJECTOR_FOCAL, ROWS, camera_at, even, fov_deg, place, projector_from_camera, steel

mi.set_variant("llvm_ad_mono")
die, out = sys.argv[1], Path(sys.argv[2])
out.mkdir(parents=True, exist_ok=True)

SCALE = 4  # pixels of the sensor per pixel here, along each axis
WIDTH, HEIGHT, FOCAL = 1920 // SCALE, 1200 // SCALE, 2530.0 / SCALE
SAMPLES = {2: 32, 6: 96}

# Tooth 12 of 84, the head 30 mm up and a little off its place.
camera = camera_at(2 * np.pi / 84 * 11.5, 30.0, [0.02, -0.03, 0.01])
projector = camera @ np.linalg.inv(projector_from_camera)

SURFACES = {
    "sprayed": {"type": "diffuse", "reflectance": even(0.6)},
    "ground": {
        "type": "blendbsdf",
        "weight": 0.85,
        "dull": {"type": "diffuse", "reflectance": even(0.3)},
        "shining": steel(0.3),
    },
    "polished": steel(0.15),
}


def render(columns, surface, edges):
    """Radiance for a projector that shows `columns` in every row."""
    picture = np.repeat(columns[None, :], ROWS, 0)[:, :, None].astype(np.float32)
    sampler = {"type": "independent", "sample_count": SAMPLES[edges], "seed": 1}
    film = {
        "type": "hdrfilm",
        "width": WIDTH,
        "height": HEIGHT,
        "pixel_format": "luminance",
        "rfilter": {"type": "box"},
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": edges},
            "sensor": {
                "type": "perspective",
                "fov": fov_deg(WIDTH, FOCAL),
                "fov_axis": "x",
                "near_clip": 0.1,
                "to_world": place(camera),
                "film": film,
                "sampler": sampler,
            },
            "emitter": {
                "type": "projector",
                "to_world": place(projector),
                "fov": fov_deg(COLUMNS, PROJECTOR_FOCAL),
                "scale": 1.0,
                "irradiance": {
                    "type": "bitmap",
                    "bitmap": mi.Bitmap(picture),
                    "raw": True,
                    "filter_type": "bilinear",
                    "wrap_mode": "clamp",
                },
            },
            "die": {
                "type": "ply",
                "filename": die,
                "face_normals": True,
                "bsdf": {"type": "twosided", "surface": SURFACES[surface]},
            },
        }
    )
    return np.array(mi.render(scene, seed=1), dtype=np.float64).reshape(HEIGHT, WIDTH)


x = np.arange(COLUMNS) + 0.5
for surface in SURFACES:
    for edges in SAMPLES:
        one = render(np.ones(COLUMNS), surface, edges)
        lanes = [one]
        for periods in (4, 48):
            phase = 2 * np.pi * periods * x / COLUMNS
            # A projector cannot show less than nothing: half bright, and taken off again.
            lanes += [2 * render(0.5 + 0.5 * wave(phase), surface, edges) - one for wave in (np.cos, np.sin)]
        np.stack(lanes).astype("<f4").tofile(out / f"{surface}-{edges}.f32")
        print(f"{surface}, {edges} edges: {np.mean(one > 0):.3f} of the view is lit", flush=True)
np.savetxt(out / "pose.txt", camera)
