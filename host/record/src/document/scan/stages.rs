//! What a scan finds of die, head and stages: the common parameters of all views.

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::multiview::adjustment::StageSigma;
use serde::Serialize;

/// Common parameters of all views.
#[derive(Clone, Debug, Serialize)]
pub struct Adjustment {
    /// Number of rounds until convergence.
    pub rounds: usize,
    /// Whether the solution converged.
    pub settled: bool,
    /// Condition number of the information of all views together, in units of the prior.
    pub condition: f64,
    /// Combinations of parameters that the views determine less than the prior does, and the prior's fraction.
    pub weak: Vec<(&'static str, f64)>,
    /// Steps between overlapping views, before and after the overlaps were used.
    pub steps: Steps,
    /// Estimated errors of die, head and stages.
    pub found: StageErrors,
}

/// Differences of die, head and stages from their files.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageErrors {
    /// Die off the rotation axis, mm.
    pub eccentricity_mm: f64,
    /// Intersections of the rotation axis with the die's lower and upper end, x and y in the tool frame, mm.
    pub axis_mm: [[f64; 2]; 2],
    /// Tilt of the die's axis relative to the rotation axis, degrees.
    pub tilt_deg: f64,
    /// Rotation of the head relative to its file, degrees, camera axes.
    pub head_turn_deg: [f64; 3],
    /// Shift of the head relative to its file, mm, camera axes.
    pub head_shift_mm: [f64; 3],
    /// Tilt of the vertical axis relative to the rotation axis, along the wall and towards it, mrad. The second component looks
    /// like a conical die: the views add nothing to its prior.
    pub vertical_lean_mrad: [f64; 2],
    /// Cosine and sine of the encoder's error at one, two and three periods per revolution, millidegrees.
    pub harmonics_mdeg: [[f64; 2]; 3],
    /// Expanded uncertainties (95 %) of some of these.
    pub u95: StageU95,
}

/// Expanded uncertainties (95 %) of these differences.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StageU95 {
    pub eccentricity_mm: f64,
    /// Of the tilt, degrees.
    pub tilt_deg: f64,
    /// Of the vertical axis's tilt, mrad.
    pub vertical_lean_mrad: [f64; 2],
    /// Of the encoder's harmonics, millidegrees.
    pub harmonics_mdeg: [[f64; 2]; 3],
}

impl From<StageSigma> for StageU95 {
    fn from(sigma: StageSigma) -> Self {
        let mdeg = |rad: f64| COVERAGE_95 * rad.to_degrees() * 1e3;
        Self {
            eccentricity_mm: COVERAGE_95 * sigma.eccentricity_mm,
            tilt_deg: COVERAGE_95 * sigma.tilt_rad.to_degrees(),
            vertical_lean_mrad: sigma.vertical_lean_rad.map(|rad| COVERAGE_95 * rad * 1e3),
            harmonics_mdeg: sigma.harmonics_rad.map(|pair| pair.map(mdeg)),
        }
    }
}

/// Steps between overlapping views: mean differences of their deviations over the common cells.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Steps {
    /// Between views of a layer.
    pub around: Option<Step>,
    /// Between layers.
    pub up: Option<Step>,
}

/// Steps of one kind.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Step {
    /// Number of pairs.
    pub pairs: usize,
    /// Root mean square of the steps with every view registered to the CAD alone, µm.
    pub before_um: f64,
    /// Root mean square of the steps after the overlaps were used, µm.
    pub after_um: f64,
}
