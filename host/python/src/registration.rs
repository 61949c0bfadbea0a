//! One cloud laid on CAD, or on another cloud.

use flankscope_foundation::rigid::Rigid;
use flankscope_metrology::cloud_surface::CloudSurface;
use flankscope_metrology::registration::{self as lib, Options, Status, TYPICAL_NOISE_MM};
use flankscope_metrology::verdict::Code;
use numpy::PyArrayDyn;
use pyo3::prelude::*;

use crate::array::{Sigmas, from_points, from_pose, points, pose, shaped};
use crate::error::{GeometryError, geometry};
use crate::mesh::Mesh;

/// What a registration found.
#[pyclass(frozen, module = "flankscope")]
pub struct Registration {
    pub found: lib::Registration,
}

#[pymethods]
impl Registration {
    /// Pose, (4, 4).
    #[getter]
    fn tool_from_cloud(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        from_pose(py, self.found.tool_from_cloud.to_rows())
    }

    /// Whether the pose may be used.
    #[getter]
    fn registered(&self) -> bool {
        self.found.is_registered()
    }

    /// "registered" or "indeterminate".
    #[getter]
    fn status(&self) -> &'static str {
        if self.found.is_registered() {
            "registered"
        } else {
            "indeterminate"
        }
    }

    /// Why the pose may not be used.
    #[getter]
    fn reason(&self) -> Option<String> {
        match &self.found.status {
            Status::Registered => None,
            Status::Indeterminate(reason) => Some(reason.to_string()),
        }
    }

    /// The same as a word that stays.
    #[getter]
    fn reason_code(&self) -> Option<&'static str> {
        match &self.found.status {
            Status::Registered => None,
            Status::Indeterminate(reason) => Some(Code::from(reason).word()),
        }
    }

    /// Whether the steps died out.
    #[getter]
    fn converged(&self) -> bool {
        self.found.converged
    }

    /// Steps.
    #[getter]
    fn iterations(&self) -> usize {
        self.found.iterations
    }

    /// Points on the surface.
    #[getter]
    fn inliers(&self) -> usize {
        self.found.inliers
    }

    /// Their root mean square distance, mm.
    #[getter]
    fn rms_mm(&self) -> f64 {
        self.found.rms_mm
    }

    /// Robust standard deviation of the distances, mm.
    #[getter]
    fn noise_mm(&self) -> f64 {
        self.found.noise_mm
    }

    /// Covariance of rotation and translation about the centre, (6, 6).
    #[getter]
    fn covariance(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        // Symmetric: columns are rows.
        shaped(py, self.found.covariance.as_slice().to_vec(), &[6, 6])
    }

    /// Centre of the cloud in tool coordinates, mm.
    #[getter]
    fn centre_mm(&self) -> [f64; 3] {
        self.found.centre_mm
    }

    /// What turns rotations into lengths, mm.
    #[getter]
    fn arm_mm(&self) -> f64 {
        self.found.arm_mm
    }

    /// Directions that the points leave weak: unit vectors of six.
    #[getter]
    fn weak_directions(&self, py: Python<'_>) -> PyResult<Py<PyArrayDyn<f64>>> {
        let weak: Vec<[f64; 6]> = self
            .found
            .weak_directions
            .iter()
            .map(|w| w.vector)
            .collect();
        let count = weak.len();
        shaped(py, weak.into_flattened(), &[count, 6])
    }

    /// Points laid in tool coordinates.
    fn apply(&self, py: Python<'_>, points_mm: &Bound<'_, PyAny>) -> PyResult<Py<PyArrayDyn<f64>>> {
        let points = points("points_mm", points_mm)?;
        let (rows, pose) = (points.rows(), &self.found.tool_from_cloud);
        let laid = py.detach(|| rows.iter().map(|&point| pose.apply(point)).collect());
        from_points(py, laid)
    }

    fn __repr__(&self) -> String {
        match self.reason() {
            None => format!("Registration(registered, rms {} mm)", self.found.rms_mm),
            Some(reason) => format!("Registration(indeterminate: {reason})"),
        }
    }
}

/// Lays points on a surface, from coarse to fine.
#[pyfunction]
#[pyo3(signature = (points_mm, reference, *, sigma_mm = None, initial = None, teeth = None, noise_mm = None,
    capture_mm = None, inlier_mm = None, least_inliers = 0.5))]
#[expect(
    clippy::too_many_arguments,
    reason = "all but two are named by who calls it"
)]
pub fn register(
    py: Python<'_>,
    points_mm: &Bound<'_, PyAny>,
    reference: &Bound<'_, PyAny>,
    sigma_mm: Option<&Bound<'_, PyAny>>,
    initial: Option<&Bound<'_, PyAny>>,
    teeth: Option<u32>,
    noise_mm: Option<f64>,
    capture_mm: Option<f64>,
    inlier_mm: Option<f64>,
    least_inliers: f64,
) -> PyResult<Registration> {
    let given = points("points_mm", points_mm)?;
    let cloud = given.rows();
    let sigmas = sigma_mm
        .map(|array| Sigmas::of(array, cloud.len()))
        .transpose()?;
    let sigmas = sigmas.as_ref().map(Sigmas::values);
    for (name, value_mm) in [
        ("noise_mm", noise_mm),
        ("capture_mm", capture_mm),
        ("inlier_mm", inlier_mm),
    ] {
        if let Some(value_mm) = value_mm
            && !(value_mm.is_finite() && value_mm > 0.0)
        {
            return Err(GeometryError::new_err(format!(
                "{name} is {value_mm}; a finite length above 0 is needed"
            )));
        }
    }
    if !(0.0..=1.0).contains(&least_inliers) {
        return Err(GeometryError::new_err(format!(
            "least_inliers is {least_inliers}; a share from 0 to 1 is needed"
        )));
    }
    if teeth == Some(0) {
        return Err(GeometryError::new_err("teeth is 0; at least 1 is needed"));
    }
    let noise_mm = noise_mm.unwrap_or(TYPICAL_NOISE_MM);
    let scaled = Options::for_noise(noise_mm);
    let options = Options {
        initial: match initial {
            Some(rows) => Rigid::from_rows(&pose("initial", rows)?).map_err(geometry)?,
            None => scaled.initial,
        },
        teeth,
        capture_mm: capture_mm.unwrap_or(scaled.capture_mm),
        most_inlier_mm: inlier_mm.unwrap_or(scaled.most_inlier_mm),
        least_inlier_ratio: least_inliers,
        ..scaled
    };
    let found = match reference.cast::<Mesh>() {
        Ok(mesh) => {
            let mesh = mesh.get();
            py.detach(|| lib::register(&mesh.surface, cloud, sigmas, &options))
        }
        Err(_) => {
            let other = points("reference", reference)?;
            let other = other.rows();
            let laid = py.detach(|| {
                let surface = CloudSurface::new(other, noise_mm)?;
                Ok(lib::register(&surface, cloud, sigmas, &options))
            });
            laid.map_err(|error: flankscope_metrology::deviation::SampleTreeError| geometry(error))?
        }
    };
    Ok(Registration { found })
}
