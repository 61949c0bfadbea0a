//! `flankscope calibrate --autofocus`: finds the setting of a driven lens at which the camera is sharp on a target's blank plate,
//! and writes the head for that setting.

use std::io::Write;
use std::path::Path;

use flankscope_jobs::calibration::Focused;
use flankscope_profilometry::calibrate::Sharpness;
use flankscope_profilometry::head::{CalibrationRecord, LensDrive};
use serde::Serialize;

use crate::output::{Common, Outcome};
use crate::site::Made;

/// A setting that was tried.
#[derive(Serialize)]
pub struct Step {
    counts: u16,
    setting_dpt: f64,
    contrast: f64,
}

#[derive(Serialize)]
struct Found {
    /// Counts of the driver, and the resulting power.
    counts: u16,
    setting_dpt: f64,
    /// Best focus of the camera, its combined standard uncertainty, and the contributions to it.
    sharpest_dpt: f64,
    sigma_dpt: f64,
    sigma: Parts,
    /// Setting with the largest contrast of the fringes, that contrast, and the correction from there to best focus.
    vertex_dpt: f64,
    contrast: f64,
    correction: Correction,
    /// Distance of the plate's centre.
    distance_mm: f64,
    projector_farther_mm: f64,
    steps: Vec<Step>,
}

#[derive(Serialize)]
struct Parts {
    scatter_dpt: f64,
    projector_dpt: f64,
    head_dpt: f64,
    curvature_dpt: f64,
}

#[derive(Serialize)]
struct Correction {
    projector_dpt: f64,
    curvature_dpt: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    made: Made<'a>,
    autofocus: Found,
    #[serde(skip_serializing_if = "Option::is_none")]
    head: Option<&'a Path>,
    #[serde(skip_serializing_if = "Option::is_none")]
    calibration: Option<&'a CalibrationRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<serde_json::Value>,
}

impl Step {
    /// Settings that were tried with a lens.
    pub fn list(tried: &[Sharpness], lens: &LensDrive) -> Vec<Self> {
        let step = |step: &Sharpness| Self {
            counts: step.counts,
            setting_dpt: lens.power_dpt(step.counts),
            contrast: step.contrast,
        };
        tried.iter().map(step).collect()
    }
}

impl Found {
    fn of(focused: &Focused) -> Self {
        let lens = focused.lens;
        let sharpest = focused.sharpest;
        Self {
            counts: lens.counts,
            setting_dpt: lens.setting_dpt(),
            sharpest_dpt: sharpest.setting_dpt,
            sigma_dpt: sharpest.sigma.combined_dpt(),
            sigma: Parts {
                scatter_dpt: sharpest.sigma.scatter_dpt,
                projector_dpt: sharpest.sigma.projector_dpt,
                head_dpt: sharpest.sigma.head_dpt,
                curvature_dpt: sharpest.sigma.curvature_dpt,
            },
            vertex_dpt: sharpest.vertex_dpt,
            contrast: sharpest.contrast,
            correction: Correction {
                projector_dpt: sharpest.projector_dpt,
                curvature_dpt: sharpest.curvature_dpt,
            },
            distance_mm: sharpest.place.distance_mm,
            projector_farther_mm: sharpest.place.farther_mm,
            steps: Step::list(&focused.steps, &lens),
        }
    }
}

/// Prints the result, and which head file was written for it, if any.
pub fn conclude(
    focused: &Focused,
    made: Made<'_>,
    written: Option<(&Path, &CalibrationRecord)>,
    truth: Option<serde_json::Value>,
    common: &Common,
) -> anyhow::Result<Outcome> {
    let found = Found::of(focused);
    let words = format!(
        "the camera is sharp at {:.3} ± {:.3} dpt (fringes have most contrast, {:.3}, at {:.3} dpt); the nearest counts are {} ({:.3} dpt)",
        found.sharpest_dpt,
        found.sigma_dpt,
        found.contrast,
        found.vertex_dpt,
        found.counts,
        found.setting_dpt
    );
    common.write_json(&Document {
        made,
        autofocus: found,
        head: written.map(|(path, _)| path),
        calibration: written.map(|(_, record)| record),
        truth,
    })?;
    if !common.quiet && common.json.as_deref() != Some(Path::new("-")) {
        writeln!(std::io::stdout(), "{words}")?;
    }
    Ok(Outcome::Done)
}
