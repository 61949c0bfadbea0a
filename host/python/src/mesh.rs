//! CAD, and distances to it.

use std::path::PathBuf;

use flankscope_metrology::deviation::{self as lib, Order, SampleTree, SampleTreeError};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh::{self, TriMesh};
use flankscope_metrology::surface::Surface;
use flankscope_metrology::surface::orientation::{Orientation, orient};
use flankscope_metrology::surface::sampling;
use flankscope_metrology::tool::Tool;
use numpy::{PyArray1, PyArrayDyn};
use pyo3::prelude::*;

use crate::array::{Rows, from_points, list, points, shaped};
use crate::error::{GeometryError, file, geometry};

/// A CAD surface, ready to be asked.
#[pyclass(frozen, module = "flankscope")]
pub struct Mesh {
    mesh: TriMesh,
    pub surface: Surface,
    orientation: Orientation,
}

impl Mesh {
    /// Winds the triangles counter-clockwise seen from outside, and prepares the surface.
    pub fn prepared(mut mesh: TriMesh) -> PyResult<Self> {
        mesh.check().map_err(geometry)?;
        let orientation = orient(&mut mesh);
        let surface = Surface::oriented(&mesh, &orientation).map_err(geometry)?;
        Ok(Self {
            mesh,
            surface,
            orientation,
        })
    }

    /// A tool's, which is prepared.
    pub fn of_tool(tool: &Tool) -> Self {
        let mut mesh = tool.mesh.clone();
        Self {
            orientation: orient(&mut mesh),
            mesh,
            surface: tool.surface.clone(),
        }
    }

    /// Distances to it have a sign.
    fn is_signed(&self) -> bool {
        self.orientation.unsigned.is_none()
    }
}

#[pymethods]
impl Mesh {
    #[new]
    fn new(
        py: Python<'_>,
        vertices_mm: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let vertices = points("vertices_mm", vertices_mm)?;
        let triangles = Rows::<u32>::of("triangles", triangles)?;
        let (vertices, triangles) = (vertices.rows(), triangles.rows());
        py.detach(|| {
            Self::prepared(TriMesh {
                vertices: vertices.to_vec(),
                triangles: triangles.to_vec(),
            })
        })
    }

    /// Reads a PLY, STL or OBJ file.
    #[staticmethod]
    #[pyo3(signature = (path, *, unit = "mm"))]
    fn load(py: Python<'_>, path: PathBuf, unit: &str) -> PyResult<Self> {
        let unit = match unit {
            "mm" => Unit::Mm,
            "m" => Unit::M,
            "um" => Unit::Um,
            "inch" => Unit::Inch,
            other => {
                return Err(GeometryError::new_err(format!(
                    "unit {other:?} is none; \"mm\", \"m\", \"um\" or \"inch\" is needed"
                )));
            }
        };
        py.detach(|| {
            let read = mesh::load(&path, unit);
            Self::prepared(read.map_err(|error| file(format_args!("{}: {error}", path.display())))?)
        })
    }

    /// Corners.
    #[getter]
    fn vertices_mm(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        from_points(py, self.mesh.vertices.clone())
    }

    /// Their numbers, counter-clockwise seen from outside.
    #[getter]
    fn triangles(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<u32>>> {
        let count = self.mesh.triangles.len();
        let corners = self.mesh.triangles.clone().into_flattened();
        shaped(py, corners, &[count, 3])
    }

    /// Whether deviations from it have a sign.
    #[getter]
    fn signed(&self) -> bool {
        self.is_signed()
    }

    /// What was found of its triangles' order, in words; empty where there is nothing to say.
    #[getter]
    fn orientation(&self) -> String {
        self.orientation.to_string()
    }

    /// Area-uniform random points.
    #[pyo3(signature = (count, *, seed = 0))]
    fn sample(&self, py: Python<'_>, count: usize, seed: u64) -> PyResult<Py<PyArrayDyn<f64>>> {
        let drawn = py.detach(|| sampling::sample(&self.mesh, count, seed));
        from_points(py, drawn.map_err(geometry)?)
    }

    fn __repr__(&self) -> String {
        let (corners, triangles) = (self.mesh.vertices.len(), self.mesh.triangles.len());
        format!("Mesh({triangles} triangles, {corners} vertices)")
    }
}

/// Signed distance of every point to the surface itself, mm: positive where material stands proud.
#[pyfunction]

pub fn deviation(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    mesh: &Bound<'_, Mesh>,
) -> PyResult<Py<PyArray1<f64>>> {
    let points = points("points_mm", points_mm)?;
    let (rows, mesh) = (points.rows(), mesh.get());
    let found = py.detach(|| {
        let mut deviations_mm = lib::deviations(&mesh.surface, rows);
        if !mesh.is_signed() {
            deviations_mm.iter_mut().for_each(|d| *d = d.abs());
        }
        deviations_mm
    });
    Ok(list(py, found))
}

/// Distance of every point to the nearest of other points, mm.
#[pyfunction]
#[pyo3(signature = (points_mm, reference_mm, *, order = 2.0))]
pub fn nearest(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    reference_mm: &Bound<'_, PyAny>,
    order: f64,
) -> PyResult<Py<PyArray1<f64>>> {
    let order = Order::try_from(order).map_err(geometry)?;
    let points_given = points("points_mm", points_mm)?;
    let reference = points("reference_mm", reference_mm)?;
    let (rows, reference) = (points_given.rows(), reference.rows());
    let found = py.detach(|| Ok(SampleTree::new(reference)?.distances(rows, order)));
    Ok(list(
        py,
        found.map_err(|error: SampleTreeError| geometry(error))?,
    ))
}
