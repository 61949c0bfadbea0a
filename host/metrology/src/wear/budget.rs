//! Uncertainty budget of a wear figure.

use serde::Serialize;

/// Standard uncertainties of one wear figure by source, mm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Budget {
    /// Noise of the points, averaged over the disc as in the figure.
    pub noise_mm: f64,
    /// Pose: from the covariance of the fit, which includes the stages' prior.
    pub registration_mm: f64,
    /// Wear of the judged flank that the fit takes for motion.
    pub leakage_mm: f64,
    /// Wear that all flanks in view share, which looks like a motion.
    pub shared_mm: f64,
    /// Calibration of the head; of a difference to a baseline, its drift since.
    pub calibration_mm: f64,
    /// Thermal expansion by the temperature's uncertainty.
    pub temperature_mm: f64,
    /// The CAD surface's chord error. Cancels in a difference to a baseline.
    pub cad_mm: f64,
    /// As-built form of the die: of this flank, and of the others through the pose. Cancels in a difference to a baseline.
    pub as_built_mm: f64,
    /// Oil or spray on the flank.
    pub film_mm: f64,
    /// The baseline capture's pose.
    pub reference_mm: f64,
    /// Loss in unmeasured cells if they are as deep as the cells at their rim; the figure itself counts no loss there.
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

    /// Uncertainty that all points of a zone share, mm: all terms but noise and holes.
    pub fn systematic_mm(&self) -> f64 {
        Self {
            noise_mm: 0.0,
            unmeasured_mm: 0.0,
            ..*self
        }
        .total_mm()
    }

    /// Uncertainty on a flank without wear, mm: all terms that do not grow with wear.
    pub fn without_wear_mm(&self) -> f64 {
        Self {
            leakage_mm: 0.0,
            unmeasured_mm: 0.0,
            ..*self
        }
        .total_mm()
    }
}
