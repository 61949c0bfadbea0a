//! Where the uncertainty of a wear figure comes from.

use serde::Serialize;

/// Standard uncertainties of one wear figure by source, mm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Budget {
    /// Noise of the points, as far as it reaches the figure.
    pub noise_mm: f64,
    /// Pose, from the covariance of the fit with the stages' prior.
    pub registration_mm: f64,
    /// Wear of the judged flank itself that the pose hides.
    pub leakage_mm: f64,
    /// Wear that the flanks in view share, which the pose cannot be told from.
    pub shared_mm: f64,
    /// Calibration of the head; of a difference to a baseline, its drift since.
    pub calibration_mm: f64,
    /// Thermal expansion that the temperature's uncertainty leaves.
    pub temperature_mm: f64,
    /// The CAD surface's chord error. Cancels in a difference to a baseline.
    pub cad_mm: f64,
    /// As-built form of the die: of this flank, and of the others through the pose. Cancels in a difference to a baseline.
    pub as_built_mm: f64,
    /// Oil or spray on the flank.
    pub film_mm: f64,
    /// The baseline capture's pose.
    pub reference_mm: f64,
    /// What is lost where nothing was measured, if that is as deep as its rim: the figure itself counts nothing there.
    pub unmeasured_mm: f64,
}

impl Budget {
    /// Standard uncertainties with their names, mm.
    pub fn terms(&self) -> [(&'static str, f64); 11] {
        [
            ("noise", self.noise_mm),
            ("registration", self.registration_mm),
            ("leakage", self.leakage_mm),
            ("shared", self.shared_mm),
            ("calibration", self.calibration_mm),
            ("temperature", self.temperature_mm),
            ("cad", self.cad_mm),
            ("as_built", self.as_built_mm),
            ("film", self.film_mm),
            ("reference", self.reference_mm),
            ("unmeasured", self.unmeasured_mm),
        ]
    }

    /// Combined standard uncertainty, mm.
    pub fn total_mm(&self) -> f64 {
        self.terms().iter().map(|(_, u)| u * u).sum::<f64>().sqrt()
    }

    /// What all that was measured of a zone shares, mm: everything but noise and holes.
    pub fn systematic_mm(&self) -> f64 {
        Self {
            noise_mm: 0.0,
            unmeasured_mm: 0.0,
            ..*self
        }
        .total_mm()
    }

    /// What would be left if the flank had no wear, mm: without what grows with it.
    pub fn without_wear_mm(&self) -> f64 {
        Self {
            leakage_mm: 0.0,
            unmeasured_mm: 0.0,
            ..*self
        }
        .total_mm()
    }
}
