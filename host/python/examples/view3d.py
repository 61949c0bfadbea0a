"""Views in 3D over time, for the Rerun viewer: `view3d.py PLAN.toml HEAD CAD OUT.rrd FOLDER...`, one folder of images per view.

Each view is decoded, laid on the CAD and recorded: its frames as the camera saw them, its pose, and its points in the tool's
coordinates, coloured by their deviation (blue: missing, red: proud). `rerun OUT.rrd` shows them along the timelines `view` and `frame`.
"""

import pathlib
import sys

import flankscope as fs
import numpy as np
import rerun as rr
from decode import read_frames

FULL_SCALE_MM = 0.1


def colours(deviation_mm: np.typing.NDArray[np.float64]) -> np.typing.NDArray[np.uint8]:
    """White where the surface is as drawn, blue where material is missing, red where it stands proud."""
    share = np.clip(deviation_mm / FULL_SCALE_MM, -1, 1)[:, None]
    ends = np.where(share < 0, [[33, 82, 176]], [[178, 24, 43]])
    mixed: np.typing.NDArray[np.uint8] = (255 + np.abs(share) * (ends - 255)).astype(np.uint8)
    return mixed


def main(plan_file: str, head_file: str, cad_file: str, out: str, *folders: str) -> None:
    plan, head, cad = fs.Plan(plan_file), fs.Head(head_file), fs.Mesh.load(cad_file)
    with rr.RecordingStream("flankscope") as record:
        record.save(out)
        record.log("tool/cad", rr.Mesh3D(vertex_positions=cad.vertices_mm, triangle_indices=cad.triangles), static=True)
        frame = 0
        for number, folder in enumerate(folders):
            record.set_time("view", sequence=number)
            frames, bits = read_frames(plan, pathlib.Path(folder))
            for image in frames:
                record.set_time("frame", sequence=frame)
                record.log("camera/frame", rr.Image(image, color_model="L"))
                frame += 1
            view = fs.Decoder(plan, head, bits=bits).decode(frames)
            found = fs.register(view.points_mm, cad)
            if not found.registered:
                record.log("log", rr.TextLog(f"{folder}: {found.reason}", level="WARN"))
                record.log("tool/points", rr.Clear(recursive=False))
                continue
            pose = found.tool_from_cloud
            record.log("tool/camera", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
            laid = found.apply(view.points_mm)
            deviation_mm = fs.deviation(laid, cad)
            record.log("tool/points", rr.Points3D(laid, colors=colours(deviation_mm)))
            print(f"{folder}: {len(laid)} points, rms {1e3 * np.sqrt(np.mean(deviation_mm**2)):.1f} um")


if __name__ == "__main__":
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    main(*sys.argv[1:])
