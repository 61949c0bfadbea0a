//! A tool file, and the wear of what it names.

use std::collections::BTreeMap;
use std::path::PathBuf;

use flankscope_metrology::tool as lib;
use flankscope_metrology::wear::{self as lib_wear, Figure, Measured};
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::array::{Sigmas, points, shaped};
use crate::error::{FileError, GeometryError, file};
use crate::mesh::Mesh;
use crate::registration::Registration;

/// A tool: its CAD, its features, what is judged of them.
#[pyclass(frozen, module = "flankscope")]
pub struct Tool {
    tool: lib::Tool,
}

#[pymethods]
impl Tool {
    /// Reads a folder with a tool.toml, or the file itself.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let tool = py.detach(|| lib::Tool::load(&path)).map_err(file)?;
        Ok(Self { tool })
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.tool.name
    }

    /// Teeth of its gear.
    #[getter]
    fn teeth(&self) -> Option<u32> {
        self.tool.gear.as_ref().map(|gear| gear.teeth)
    }

    /// Numbers of the teeth or patches that are inspected.
    #[getter]
    fn inspected(&self) -> Vec<u32> {
        self.tool.inspected()
    }

    /// Its CAD.
    #[getter]
    fn mesh(&self, py: Python<'_>) -> Mesh {
        py.detach(|| Mesh::of_tool(&self.tool))
    }

    fn __repr__(&self) -> String {
        format!("Tool({:?})", self.tool.name)
    }
}

/// Wear of one flank or patch, as read; positive is loss.
#[pyclass(frozen, module = "flankscope")]
pub struct FlankWear {
    wear: lib_wear::FlankWear,
}

impl FlankWear {
    /// The wear depth; NaN, as NumPy has it, where there is none.
    fn depth_mm(&self) -> Figure {
        self.wear.wear_mm().unwrap_or(Figure {
            value: f64::NAN,
            u: f64::NAN,
        })
    }
}

#[pymethods]
impl FlankWear {
    /// Number of the tooth or patch.
    #[getter]
    fn tooth(&self) -> u32 {
        self.wear.tooth
    }

    /// Side.
    #[getter]
    fn flank(&self) -> String {
        self.wear.flank.to_string()
    }

    /// Largest mean loss over a disc, mm.
    #[getter]
    fn wear_mm(&self) -> f64 {
        self.depth_mm().value
    }

    /// Its standard uncertainty, mm.
    #[getter]
    fn u_mm(&self) -> f64 {
        self.depth_mm().u
    }

    /// Its expanded uncertainty (95 %), mm.
    #[getter]
    fn u95_mm(&self) -> f64 {
        self.depth_mm().u95()
    }

    /// Parts of the uncertainty, mm.
    #[getter]
    fn budget_mm(&self) -> BTreeMap<&'static str, f64> {
        self.wear.budget.terms().into_iter().collect()
    }

    /// Mean loss over the zone, mm.
    #[getter]
    fn mean_mm(&self) -> f64 {
        self.wear.judged.map_or(f64::NAN, |of| of.mean_mm.value)
    }

    /// Largest mean height of proud material over a disc, mm.
    #[getter]
    fn proud_mm(&self) -> f64 {
        self.wear.judged.map_or(f64::NAN, |of| of.proud_mm.value)
    }

    /// The largest loss that a disc with unmeasured parts may have, mm.
    #[getter]
    fn hidden_mm(&self) -> Option<f64> {
        self.wear.judged?.hidden_mm
    }

    /// Measured share of the zone.
    #[getter]
    fn coverage(&self) -> f64 {
        self.wear.coverage
    }

    /// Points in the zone.
    #[getter]
    fn points(&self) -> usize {
        self.wear.points
    }

    /// Mean loss cell by cell, mm.
    #[getter]
    fn map_mm(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        let field = &self.wear.field;
        shaped(py, field.wear_mm.clone(), &[field.rows, field.columns])
    }

    /// Size of a cell along profile and height, mm.
    #[getter]
    fn cell_mm(&self) -> [f64; 2] {
        self.wear.field.cell_mm
    }

    fn __repr__(&self) -> String {
        let w = &self.wear;
        let um = |mm: f64| 1e3 * mm;
        format!(
            "FlankWear({} {}: {:.1} um, U95 {:.1} um, {:.0} % measured)",
            w.tooth,
            w.flank,
            um(self.wear_mm()),
            um(self.u95_mm()),
            100.0 * w.coverage
        )
    }
}

/// Wear of the flanks or patches of a tool from points in its coordinates.
#[pyfunction]
#[pyo3(signature = (points_mm, tool, *, sigma_mm = None, registration = None, teeth = None))]
pub fn wear(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    tool: &Bound<'_, Tool>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    registration: Option<&Bound<'_, Registration>>,
    teeth: Option<Vec<u32>>,
) -> PyResult<Vec<FlankWear>> {
    let given = points("points_mm", points_mm)?;
    let rows = given.rows();
    let sigmas = sigma_mm
        .map(|array| Sigmas::of(array, rows.len()))
        .transpose()?;
    let sigma_mm = sigmas.as_ref().map(Sigmas::values);
    let tool = &tool.get().tool;
    if tool.inspect.is_none() {
        return Err(FileError::new_err(format!(
            "{} has no [inspect] section, which says what zone is judged (docs/formats/tool.md)",
            tool.path.display()
        )));
    }
    let teeth = teeth.unwrap_or_else(|| tool.inspected());
    let is_known = |tooth: u32| match &tool.gear {
        Some(gear) => (1..=gear.teeth).contains(&tooth),
        None => tool.inspected().contains(&tooth),
    };
    let registration = registration.map(|of| &of.get().found);
    if let Some(of) = registration.filter(|of| !of.is_registered()) {
        return Err(GeometryError::new_err(format!(
            "the registration is indeterminate ({:?}): points that lie nowhere have no wear",
            of.status
        )));
    }
    let zones: Vec<(u32, lib_wear::Zone)> = teeth
        .iter()
        .map(|&tooth| {
            let zone = tool.zone_of(tooth).filter(|_| is_known(tooth));
            let unknown = || {
                GeometryError::new_err(format!(
                    "{tooth} is no number of a tooth or judged patch of {:?}; those inspected are {:?}",
                    tool.name,
                    tool.inspected()
                ))
            };
            Ok((tooth, zone.ok_or_else(unknown)?))
        })
        .collect::<PyResult<_>>()?;
    let found = py.detach(|| {
        let closest = tool.surface.closest_many(rows);
        let measured = Measured {
            points: rows,
            closest: &closest,
            sigma_mm,
            sight: None,
        };
        let (features, settings) = (tool.features(), tool.wear_settings());
        let places = lib_wear::places(features, &closest);
        let of = |(tooth, zone): &(u32, lib_wear::Zone)| {
            let teeth = &[*tooth];
            lib_wear::evaluate_placed(
                features,
                zone,
                teeth,
                measured,
                &places,
                registration,
                &settings,
            )
        };
        zones.iter().flat_map(of).collect::<Vec<_>>()
    });
    Ok(found.into_iter().map(|wear| FlankWear { wear }).collect())
}
