//! Where the uncertainty of a wear figure comes from.

use serde::Serialize;

/// Standard uncertainties of one wear figure by source, mm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Budget {
    /// Noise of the points, averaged over the cells that the figure rests on.
    pub noise_mm: f64,
    /// Pose, from the covariance of the fit with the stages' prior.
    pub registration_mm: f64,
    /// Wear that the pose hides.
    pub leakage_mm: f64,
    /// Calibration of the head; of a difference to a baseline, its drift since.
    pub calibration_mm: f64,
    /// Thermal expansion that the temperature's uncertainty leaves.
    pub temperature_mm: f64,
    /// The CAD surface: chord error and as-built form. Cancels in a difference to a baseline.
    pub cad_mm: f64,
    /// The baseline capture.
    pub reference_mm: f64,
}

impl Budget {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self {
        noise_mm: f64::NAN,
        registration_mm: f64::NAN,
        leakage_mm: f64::NAN,
        calibration_mm: f64::NAN,
        temperature_mm: f64::NAN,
        cad_mm: f64::NAN,
        reference_mm: f64::NAN,
    };

    fn terms(&self) -> [f64; 7] {
        [
            self.noise_mm,
            self.registration_mm,
            self.leakage_mm,
            self.calibration_mm,
            self.temperature_mm,
            self.cad_mm,
            self.reference_mm,
        ]
    }

    /// Combined standard uncertainty, mm.
    pub fn total_mm(&self) -> f64 {
        self.terms().iter().map(|u| u * u).sum::<f64>().sqrt()
    }

    /// What all cells of a zone share, mm: everything but noise.
    pub fn systematic_mm(&self) -> f64 {
        Self {
            noise_mm: 0.0,
            ..*self
        }
        .total_mm()
    }
}
