"""Fringe images to points, points on CAD, deviations and wear, on NumPy's arrays.

Millimetres and radians. Arrays that go in are read where they lie: points are float64 of shape (n, 3), frames uint16, row after row
in one piece; another type or layout is an ArrayError that says what makes it right, NaN and infinity a NotFiniteError. Arrays that
come out are the caller's alone, moved and not copied. Python's lock is released while something is computed: do not write to an array
meanwhile.
"""

from os import PathLike
from pathlib import Path
from typing import Literal, Sequence, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ArrayError",
    "Decoded",
    "Decoder",
    "FileError",
    "FlankWear",
    "FlankscopeError",
    "GeometryError",
    "Head",
    "Mesh",
    "NotFiniteError",
    "Plan",
    "Registration",
    "Tool",
    "deviation",
    "nearest",
    "register",
    "wear",
]

_Points = NDArray[np.float64]
_Path = str | PathLike[str]

class FlankscopeError(ValueError):
    """What every exception of the package is."""

class ArrayError(FlankscopeError):
    """An array of another type, shape or layout than is needed."""

class NotFiniteError(ArrayError):
    """NaN or infinity in an array."""

class FileError(FlankscopeError):
    """A file that cannot be read or does not say what is needed."""

class GeometryError(FlankscopeError):
    """Values that are sound one by one and cannot be worked with together."""

@final
class Head:
    """Camera and projector, calibrated: a head.toml, or an OpenCV calibration (XML, YAML)."""

    def __new__(cls, path: _Path, *, projector: int = 1) -> Head: ...
    @property
    def frame_shape(self) -> tuple[int, int]:
        """Rows and columns of a frame."""
    @property
    def has_cores(self) -> bool:
        """Whether it has a map of its bundle's cores."""

@final
class Plan:
    """What is projected, and what the frames of a view are: a PLAN.toml."""

    def __new__(cls, path: _Path) -> Plan: ...
    @staticmethod
    def named(name: str, *, exposures_us: Sequence[int], dark_frame: bool = True) -> Plan:
        """A set of patterns by its name ("article8", "insitu12", "scan16")."""
    @property
    def name(self) -> str:
        """Name of the set."""
    @property
    def periods(self) -> list[float]:
        """Fringes over the projector's width, low to high."""
    def files(self, folder: _Path) -> list[Path]:
        """Files of a folder's images in the order of capture, of a plan that was read from a file."""

@final
class Decoder:
    """Everything that does not change from view to view; what is left out is as `flankscope decode` has it.

    `bits` of a pixel are needed where neither plan nor head has a [sensor]; uncertainties are then indicative (`sensor_assumed`).
    `cores` says whether points are made of the cores of the head's map.
    """

    def __new__(
        cls,
        plan: Plan,
        head: Head,
        *,
        bits: int | None = None,
        cores: bool | None = None,
        binning: int | None = None,
        smooth_px: float | None = None,
        smooth_coarse_px: float | None = None,
        min_contrast: float | None = None,
        min_modulation_dn: float | None = None,
        max_sigma_z_mm: float | None = None,
        frame_consistency: float | None = None,
        min_patch_cells: int | None = None,
    ) -> Decoder: ...
    @property
    def frames(self) -> list[str]:
        """What the frames of a view show, in the order in which they are needed."""
    @property
    def sensor_assumed(self) -> bool:
        """Whether nobody described the sensor."""
    def decode(self, frames: NDArray[np.uint16] | Sequence[NDArray[np.uint16]]) -> Decoded:
        """Points and maps of one view: a stack (frames, rows, columns), or one array per frame, in the order of `frames`.

        Frames in another order, whose steps are not one fringe moved step by step, are a GeometryError that names the set.
        """

@final
class Decoded:
    """Points and maps of a view. Maps are rows by columns for blocks of pixels, a list for cores; frequencies from the lowest."""

    @property
    def points_mm(self) -> _Points:
        """Points in the camera's frame, (n, 3), in the order of the cells of `mask` that are true."""
    @property
    def sigma_z_mm(self) -> NDArray[np.float32]:
        """Standard uncertainty of each point's z; it moves along its ray."""
    @property
    def mask(self) -> NDArray[np.bool_]:
        """Cells with a point."""
    @property
    def periods(self) -> NDArray[np.float64]:
        """Fringes over the projector's width, of each frequency."""
    @property
    def pixel_px(self) -> NDArray[np.float64]:
        """Camera pixel that a cell measures along, (..., 2): x and y."""
    @property
    def phase_rad(self) -> NDArray[np.float32]:
        """Wrapped phase as the frames have it, (frequencies, ...), 0 to 2 pi; NaN where all exposures are saturated."""
    @property
    def modulation_e(self) -> NDArray[np.float32]:
        """Amplitude of each frequency, electrons."""
    @property
    def mean_e(self) -> NDArray[np.float32]:
        """Mean of each frequency, electrons, ambient light included."""
    @property
    def order(self) -> NDArray[np.int32]:
        """Which period of the finest fringes the phase lies in; -2**31 where none was told."""
    @property
    def column_px(self) -> NDArray[np.float64]:
        """Projector column (row) that lights the cell; NaN where none was told."""
    @property
    def depth_mm(self) -> NDArray[np.float32]:
        """z of the point; NaN where there is none."""
    @property
    def rejected(self) -> dict[str, int]:
        """Cells without a point, by reason."""
    @property
    def frame_noise_ratio(self) -> float:
        """By how much frames scatter more than the sensor predicts; uncertainties have been raised by it."""
    @property
    def contrast(self) -> list[float]:
        """Median contrast of each frequency over the points."""

@final
class Mesh:
    """A CAD surface, ready to be asked. Triangles are wound counter-clockwise seen from outside, those of a file that is not too."""

    def __new__(cls, vertices_mm: _Points, triangles: NDArray[np.uint32]) -> Mesh: ...
    @staticmethod
    def load(path: _Path, *, unit: Literal["mm", "m", "um", "inch"] = "mm") -> Mesh:
        """Reads a PLY, STL or OBJ file."""
    @property
    def vertices_mm(self) -> _Points:
        """Corners, (n, 3)."""
    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Their numbers, (m, 3)."""
    @property
    def signed(self) -> bool:
        """Whether deviations from it have a sign: not where nothing is outside of it."""
    @property
    def orientation(self) -> str:
        """What was found of its triangles' order; empty where there is nothing to say."""
    def sample(self, count: int, *, seed: int = 0) -> _Points:
        """Area-uniform random points; the same seed gives the same ones."""

def deviation(points_mm: _Points, mesh: Mesh) -> NDArray[np.float64]:
    """Exact distance of every point to the surface, mm: positive where material stands proud. Without sign if not mesh.signed."""

def nearest(points_mm: _Points, reference_mm: _Points, *, order: float = 2.0) -> NDArray[np.float64]:
    """Distance of every point to the nearest of other points, mm, of Minkowski's order 1, 2 or infinity."""

@final
class Registration:
    """What a registration found. A pose that may not be used has a reason."""

    @property
    def tool_from_cloud(self) -> NDArray[np.float64]:
        """Takes points of the cloud to tool coordinates, (4, 4), mm."""
    @property
    def registered(self) -> bool:
        """Whether the pose may be used."""
    @property
    def status(self) -> Literal["registered", "indeterminate"]:
        """The same in a word."""
    @property
    def reason(self) -> str | None:
        """Why the pose may not be used, with value and limit."""
    @property
    def reason_code(self) -> str | None:
        """The same as a word that stays (docs/formats.md)."""
    @property
    def converged(self) -> bool:
        """Whether the steps died out."""
    @property
    def iterations(self) -> int:
        """Steps."""
    @property
    def inliers(self) -> int:
        """Points on the surface."""
    @property
    def rms_mm(self) -> float:
        """Root mean square of their distances."""
    @property
    def noise_mm(self) -> float:
        """Robust standard deviation of all distances."""
    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of rotation (rad) and translation (mm) about centre_mm, (6, 6)."""
    @property
    def centre_mm(self) -> list[float]:
        """Centre of the cloud in tool coordinates."""
    @property
    def arm_mm(self) -> float:
        """Root mean square distance of the points from it: turns rotations into lengths."""
    @property
    def weak_directions(self) -> NDArray[np.float64]:
        """Unit vectors (rotation times arm_mm, translation) that the points leave weak, (k, 6), weakest first."""
    def apply(self, points_mm: _Points) -> _Points:
        """Points laid in tool coordinates."""

def register(
    points_mm: _Points,
    reference: Mesh | _Points,
    *,
    sigma_mm: NDArray[np.float32] | None = None,
    initial: NDArray[np.float64] | None = None,
    teeth: int | None = None,
    noise_mm: float | None = None,
    capture_mm: float | None = None,
    inlier_mm: float | None = None,
    least_inliers: float = 0.5,
) -> Registration:
    """Lays points on CAD, or on other points as the surface that they sample; as `flankscope register` does.

    `initial` is where to start, (4, 4). `teeth` of a toothing about z, where poses one pitch apart look alike. `noise_mm` is what a point
    is expected to scatter by, at most (0.02); reach (`capture_mm`) and `inlier_mm` follow it unless they are given.
    """

@final
class Tool:
    """A tool: a folder with a tool.toml, or the file itself."""

    def __new__(cls, path: _Path) -> Tool: ...
    @property
    def name(self) -> str:
        """Its name."""
    @property
    def teeth(self) -> int | None:
        """Teeth of its gear."""
    @property
    def inspected(self) -> list[int]:
        """Numbers of the teeth or patches that are inspected."""
    @property
    def mesh(self) -> Mesh:
        """Its CAD."""

@final
class FlankWear:
    """Wear of one flank or patch, as read; positive is loss. Figures of a zone without points are NaN. No verdict: that needs what a
    check knows beside the points (stages, calibration's date, frames, the wear that the pose hides)."""

    @property
    def tooth(self) -> int:
        """Tooth or patch, from 1."""
    @property
    def flank(self) -> str:
        """"left", "right" or "face"."""
    @property
    def wear_mm(self) -> float:
        """Largest mean loss over any disc of the tool's area in the zone."""
    @property
    def u_mm(self) -> float:
        """Its standard uncertainty, from budget_mm."""
    @property
    def u95_mm(self) -> float:
        """Its expanded uncertainty (95 %)."""
    @property
    def budget_mm(self) -> dict[str, float]:
        """Parts of the standard uncertainty; 0 where nothing is known: the pose's leakage, shared wear, temperature."""
    @property
    def mean_mm(self) -> float:
        """Mean loss over the zone."""
    @property
    def proud_mm(self) -> float:
        """Largest mean height of proud material over a disc."""
    @property
    def hidden_mm(self) -> float | None:
        """The largest loss that a disc with unmeasured parts may have; None where every disc was measured whole."""
    @property
    def coverage(self) -> float:
        """Measured share of the zone."""
    @property
    def points(self) -> int:
        """Points in the zone."""
    @property
    def map_mm(self) -> NDArray[np.float64]:
        """Mean loss of each cell, rows up the height by columns along the profile; NaN where nothing was measured."""
    @property
    def cell_mm(self) -> list[float]:
        """Size of a cell along profile and height."""

def wear(
    points_mm: _Points,
    tool: Tool,
    *,
    sigma_mm: NDArray[np.float32] | None = None,
    registration: Registration | None = None,
    teeth: Sequence[int] | None = None,
) -> list[FlankWear]:
    """Wear of the flanks or patches from points in tool coordinates, each with its standard uncertainty if that is known (else from
    their scatter). `registration` brings the pose's covariance in. `teeth` are those that the tool inspects unless given."""
