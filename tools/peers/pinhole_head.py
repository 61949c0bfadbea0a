"""The demo head as a renderer sees it, without fibres and blur, and what it looks at: shared by the scripts that render with Mitsuba."""

import mitsuba as mi
import numpy as np

COLUMNS, ROWS, PROJECTOR_FOCAL = 1024, 768, 2252.8

cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
projector_from_camera = np.eye(4)
projector_from_camera[:3, :3] = [[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]
projector_from_camera[:3, 3] = [11.0, 0, 22 - 22 * cos]
stage_from_camera = np.eye(4)
stage_from_camera[:3, :3], stage_from_camera[:3, 3] = [[0, 0, 1], [0, -1, 0], [1, 0, 0]], [19.5, 0, 0]


def camera_at(angle, height_mm, off_mm):
    """Pose in the die's frame of a camera that is turned and raised so, and as far off its place."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    pose = pose @ stage_from_camera
    pose[:3, 3] += np.array(off_mm) + [0, 0, height_mm]
    return pose


def place(pose):
    """Mitsuba looks along +z with x to the left and y up."""
    return mi.ScalarTransform4f(pose @ np.diag([-1.0, -1, 1, 1]))


def fov_deg(size, focal):
    return float(np.degrees(2 * np.arctan(size / 2 / focal)))


def even(value):
    return {"type": "spectrum", "value": value}


def steel(alpha):
    return {"type": "roughconductor", "alpha": alpha, "distribution": "ggx", "eta": even(2.4), "k": even(3.4)}
