"""A folder of fringe images to points: `decode.py PLAN.toml HEAD FOLDER POINTS.npz`, as `flankscope decode` does."""

import pathlib
import sys

import flankscope as fs
import numpy as np
from PIL import Image


def read_frames(plan: fs.Plan, folder: pathlib.Path) -> tuple[list[np.typing.NDArray[np.uint16]], int]:
    """The images of a view in the plan's order, and how many bits a pixel has."""
    images = [np.array(Image.open(file)) for file in plan.files(folder)]
    # Pillow gives images of 16 bits as uint16 or int32, by their format.
    return [image.astype(np.uint16) for image in images], 8 if images[0].dtype == np.uint8 else 16


def main(plan_file: str, head_file: str, folder: str, points_file: str) -> None:
    plan, head = fs.Plan(plan_file), fs.Head(head_file)
    frames, bits = read_frames(plan, pathlib.Path(folder))
    view = fs.Decoder(plan, head, bits=bits).decode(frames)
    np.savez(points_file, points_mm=view.points_mm, sigma_z_mm=view.sigma_z_mm)
    print(f"{len(view.points_mm)} points of {view.mask.size} cells")
    if len(view.points_mm):
        print(f"median standard uncertainty of z: {1e3 * np.median(view.sigma_z_mm):.2f} um")
    for reason, cells in sorted(view.rejected.items()):
        if cells:
            print(f"{cells} cells without a point: {reason}")


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
