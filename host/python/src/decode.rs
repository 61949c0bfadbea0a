//! Frames to points.

use std::collections::BTreeMap;
use std::path::PathBuf;

use flankscope_profilometry::counts::CountRange;
use flankscope_profilometry::decode::{
    self as lib, ConsistencyOptions, DecodeOptions, PatchOptions, PhaseMaps,
};
use flankscope_profilometry::frame_order::{self, FrameOrderError};
use flankscope_profilometry::head::HeadModel;
use flankscope_profilometry::pattern::PatternSet;
use flankscope_profilometry::plan;
use flankscope_profilometry::{DecodeError, FrameError, FrameView};
use numpy::{Ix2, Ix3, PyArray1, PyArrayDyn, PyReadonlyArray, PyUntypedArrayMethods};
use numpy::{PyReadonlyArray2, PyUntypedArray};
use pyo3::prelude::*;

use crate::array::{borrow, from_points, list, shaped, values};
use crate::error::{ArrayError, FileError, GeometryError, file, geometry};

/// Camera and projector, calibrated.
#[pyclass(frozen, module = "flankscope")]
pub struct Head {
    head: HeadModel,
}

#[pymethods]
impl Head {
    /// Reads a head.toml, or an OpenCV calibration; of a head with two projectors, one of them.
    #[new]
    #[pyo3(signature = (path, *, projector = 1))]
    fn new(path: PathBuf, projector: u8) -> PyResult<Self> {
        let head = HeadModel::load(&path).map_err(file)?;
        let head = head.with_projector(projector).ok_or_else(|| {
            let has = head.projectors();
            ArrayError::new_err(format!("projector is {projector}, the head has {has}"))
        })?;
        Ok(Self { head })
    }

    /// Size of a frame: rows, columns.
    #[getter]
    fn frame_shape(&self) -> (u32, u32) {
        (self.head.camera.height_px, self.head.camera.width_px)
    }

    /// Whether it has a map of its bundle's cores.
    #[getter]
    fn has_cores(&self) -> bool {
        self.head.core_map.is_some()
    }
}

/// What is projected, and what the frames of a view are.
#[pyclass(frozen, module = "flankscope")]
pub struct Plan {
    patterns: PatternSet,
    exposures_us: Vec<u32>,
    dark_frame: bool,
    /// The file, where there is one.
    file: Option<plan::Plan>,
}

#[pymethods]
impl Plan {
    /// Reads a PLAN.toml.
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let plan = plan::Plan::load(&path).map_err(file)?;
        Ok(Self {
            patterns: plan.patterns.clone(),
            exposures_us: plan.exposures_us.clone(),
            dark_frame: plan.dark_frame,
            file: Some(plan),
        })
    }

    /// A set of patterns by its name.
    #[staticmethod]
    #[pyo3(signature = (name, *, exposures_us, dark_frame = true))]
    fn named(name: &str, exposures_us: Vec<u32>, dark_frame: bool) -> PyResult<Self> {
        Ok(Self {
            patterns: PatternSet::named(name).map_err(geometry)?,
            exposures_us,
            dark_frame,
            file: None,
        })
    }

    /// Name of the set.
    #[getter]
    fn name(&self) -> &str {
        &self.patterns.name
    }

    /// Fringes over the projector's width, low to high.
    #[getter]
    fn periods(&self) -> Vec<f64> {
        self.patterns.sets.iter().map(|set| set.periods).collect()
    }

    /// Files of a folder's images in the order of capture.
    fn files(&self, folder: PathBuf) -> PyResult<Vec<PathBuf>> {
        let Some(plan) = &self.file else {
            return Err(FileError::new_err(
                "a set that was named says nothing of files; a PLAN.toml does",
            ));
        };
        let frames = plan.frames(&folder).map_err(file)?;
        Ok(frames.into_iter().map(|(_, path)| path).collect())
    }
}

/// Everything that does not change from view to view, made once.
#[pyclass(frozen, module = "flankscope")]
pub struct Decoder {
    decoder: lib::Decoder,
    patterns: PatternSet,
    sensor_assumed: bool,
}

#[pymethods]
impl Decoder {
    #[new]
    #[pyo3(signature = (plan, head, *, bits = None, cores = None, binning = None, smooth_px = None, smooth_coarse_px = None,
        min_contrast = None, min_modulation_dn = None, max_sigma_z_mm = None, frame_consistency = None, min_patch_cells = None))]
    #[expect(
        clippy::too_many_arguments,
        reason = "all but two are named by who calls it"
    )]
    fn new(
        py: Python<'_>,
        plan: &Bound<'_, Plan>,
        head: &Bound<'_, Head>,
        bits: Option<u32>,
        cores: Option<bool>,
        binning: Option<usize>,
        smooth_px: Option<f64>,
        smooth_coarse_px: Option<f64>,
        min_contrast: Option<f64>,
        min_modulation_dn: Option<f64>,
        max_sigma_z_mm: Option<f64>,
        frame_consistency: Option<f64>,
        min_patch_cells: Option<usize>,
    ) -> PyResult<Self> {
        let plan = plan.get();
        let mut head = head.get().head.clone();
        match cores {
            Some(false) => head.core_map = None,
            Some(true) if head.core_map.is_none() => {
                return Err(geometry(DecodeError::NoCores));
            }
            _ => {}
        }
        let sensor = plan.file.as_ref().and_then(|file| file.sensor);
        if sensor.is_none() && head.sensor.is_none() && bits.is_none() {
            return Err(GeometryError::new_err(
                "neither plan nor head has a [sensor]: bits, how many a pixel has, is needed",
            ));
        }
        if let Some(bits) = bits
            && !(1..=16).contains(&bits)
        {
            return Err(GeometryError::new_err(format!(
                "bits is {bits}; 1 to 16 are needed"
            )));
        }
        let sensor_assumed = head.take_sensor(sensor, &CountRange::from_bits(bits.unwrap_or(16)));
        let defaults = DecodeOptions::for_images(&head, plan.dark_frame, sensor_assumed);
        let options = DecodeOptions {
            binning: binning.unwrap_or(defaults.binning),
            smoothing_px: smooth_px.unwrap_or(defaults.smoothing_px),
            coarse_smoothing_px: smooth_coarse_px.unwrap_or(defaults.coarse_smoothing_px),
            min_contrast: min_contrast.unwrap_or(defaults.min_contrast),
            min_modulation_dn,
            max_sigma_z_mm,
            consistency: match frame_consistency {
                None => defaults.consistency,
                Some(least) => Some(ConsistencyOptions::for_images(least)),
            },
            patches: match min_patch_cells {
                None => defaults.patches,
                Some(0) => None,
                Some(min_cells) => defaults.patches.map(|of| PatchOptions { min_cells, ..of }),
            },
            ..defaults
        };
        let made =
            py.detach(|| lib::Decoder::new(&head, &plan.patterns, &plan.exposures_us, options));
        Ok(Self {
            decoder: made.map_err(geometry)?,
            patterns: plan.patterns.clone(),
            sensor_assumed,
        })
    }

    /// What the frames of a view show, in the order in which they are needed.
    #[getter]
    fn frames(&self) -> Vec<String> {
        let order = self.decoder.capture_order();
        order.map(|kind| kind.to_string()).collect()
    }

    /// Whether nobody described the sensor.
    #[getter]
    fn sensor_assumed(&self) -> bool {
        self.sensor_assumed
    }

    /// Points and maps of one view.
    fn decode(&self, py: Python<'_>, frames: &Bound<'_, PyAny>) -> PyResult<Decoded> {
        let planned: Vec<_> = self.decoder.capture_order().collect();
        let [columns, rows] = self.decoder.size_px().map(|px| px as usize);
        let frames = Frames::of(frames, planned.len(), [rows, columns])?;
        if frames.len() != planned.len() {
            let given = match frames.len() {
                more if more > planned.len() => format!("more than {}", planned.len()),
                fewer => fewer.to_string(),
            };
            return Err(ArrayError::new_err(format!(
                "{given} frames, of this plan {} are needed, in this order: {}",
                planned.len(),
                self.frames().join("; ")
            )));
        }
        let views = frames.views(rows, columns);
        let views: Vec<_> = planned.into_iter().zip(views).collect();
        let (decoded, maps) = py
            .detach(|| {
                frame_order::check(&self.patterns, &views)?;
                let mut sums = self.decoder.begin();
                for (kind, view) in &views {
                    sums.add(*view, *kind)?;
                }
                let decoded = self.decoder.finish(&sums)?;
                let maps = self.decoder.maps(&sums, &decoded)?;
                Ok((decoded, maps))
            })
            .map_err(|error: Refused| match error {
                Refused::Frame(error) => ArrayError::new_err(error.to_string()),
                Refused::Order(error) => geometry(error),
                Refused::View(error) => geometry(error),
            })?;
        Decoded::of(py, decoded, maps)
    }
}

/// Why a view was not decoded.
enum Refused {
    Frame(FrameError),
    Order(FrameOrderError),
    View(DecodeError),
}

impl From<FrameError> for Refused {
    fn from(error: FrameError) -> Self {
        Self::Frame(error)
    }
}

impl From<FrameOrderError> for Refused {
    fn from(error: FrameOrderError) -> Self {
        Self::Order(error)
    }
}

impl From<DecodeError> for Refused {
    fn from(error: DecodeError) -> Self {
        Self::View(error)
    }
}

/// The frames of a view, borrowed.
enum Frames<'py> {
    Stack(PyReadonlyArray<'py, u16, Ix3>),
    Each(Vec<PyReadonlyArray2<'py, u16>>),
}

impl<'py> Frames<'py> {
    /// Of a stack, or of one array per frame; of an iterator no more than one beyond `count` is asked for.
    fn of(frames: &Bound<'py, PyAny>, count: usize, [rows, columns]: [usize; 2]) -> PyResult<Self> {
        if frames.cast::<PyUntypedArray>().is_ok() {
            let needed = format!("(frames, {rows}, {columns})");
            let fits = |shape: &[usize]| matches!(*shape, [_, r, c] if [r, c] == [rows, columns]);
            let stack = borrow::<u16, Ix3>("frames", (needed.as_str(), fits), frames)?;
            return Ok(Self::Stack(stack));
        }
        let needed = format!("({rows}, {columns})");
        let each = frames.try_iter()?.take(count + 1).enumerate();
        let each = each.map(|(at, frame)| {
            let fits = |shape: &[usize]| *shape == [rows, columns];
            borrow::<u16, Ix2>(&format!("frames[{at}]"), (needed.as_str(), fits), &frame?)
        });
        Ok(Self::Each(each.collect::<PyResult<_>>()?))
    }

    fn len(&self) -> usize {
        match self {
            Self::Stack(stack) => stack.shape()[0],
            Self::Each(frames) => frames.len(),
        }
    }

    fn views(&self, rows: usize, columns: usize) -> Vec<FrameView<'_>> {
        let pixels: Vec<&[u16]> = match self {
            Self::Stack(stack) => values(stack).chunks_exact(rows * columns).collect(),
            Self::Each(frames) => frames.iter().map(|frame| values(frame)).collect(),
        };
        let view = |frame| FrameView::packed(frame, columns, rows);
        pixels.into_iter().map(view).collect()
    }
}

/// Points and maps of a view.
#[pyclass(frozen, get_all, module = "flankscope")]
pub struct Decoded {
    points_mm: Py<PyArrayDyn<f64>>,
    sigma_z_mm: Py<PyArray1<f32>>,
    mask: Py<PyArrayDyn<bool>>,
    periods: Py<PyArray1<f64>>,
    pixel_px: Py<PyArrayDyn<f64>>,
    phase_rad: Py<PyArrayDyn<f32>>,
    modulation_e: Py<PyArrayDyn<f32>>,
    mean_e: Py<PyArrayDyn<f32>>,
    order: Py<PyArrayDyn<i32>>,
    column_px: Py<PyArrayDyn<f64>>,
    depth_mm: Py<PyArrayDyn<f32>>,
    rejected: BTreeMap<&'static str, usize>,
    frame_noise_ratio: f64,
    contrast: Vec<f64>,
}

impl Decoded {
    fn of(py: Python<'_>, decoded: lib::Decoded, maps: PhaseMaps) -> PyResult<Self> {
        let of_cells = maps.shape.as_slice();
        let of_sets = [&[maps.periods.len()], of_cells].concat();
        let mask: Vec<bool> = maps.depth_mm.iter().map(|z| z.is_finite()).collect();
        let rejected = decoded.rejected;
        Ok(Self {
            points_mm: from_points(py, decoded.cloud.points_mm)?,
            sigma_z_mm: list(py, decoded.cloud.sigma_z_mm),
            mask: shaped(py, mask, of_cells)?,
            pixel_px: shaped(py, maps.pixel_px, &[of_cells, &[2]].concat())?,
            phase_rad: shaped(py, maps.phase_rad, &of_sets)?,
            modulation_e: shaped(py, maps.modulation_e, &of_sets)?,
            mean_e: shaped(py, maps.mean_e, &of_sets)?,
            order: shaped(py, maps.order, of_cells)?,
            column_px: shaped(py, maps.column_px, of_cells)?,
            depth_mm: shaped(py, maps.depth_mm, of_cells)?,
            periods: list(py, maps.periods),
            rejected: rejected.reasons().into_iter().collect(),
            frame_noise_ratio: decoded.frame_noise_ratio,
            contrast: decoded.contrast,
        })
    }
}
