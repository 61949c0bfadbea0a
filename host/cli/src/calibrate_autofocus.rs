//! `flankscope calibrate --autofocus`: the setting of a driven lens at which a target's blank plate is sharp, and the head there.

use std::io::Write;
use std::path::Path;

use flankscope_profilometry::head::CalibrationRecord;
use flankscope_station::calibration::Focused;
use serde::Serialize;

use crate::calibrate::Made;
use crate::output::{Common, Outcome};

/// A setting that was looked at.
#[derive(Serialize)]
struct Step {
    counts: u16,
    setting_dpt: f64,
    contrast: f64,
}

#[derive(Serialize)]
struct Found {
    /// What the driver is to be told, and what that gives.
    counts: u16,
    setting_dpt: f64,
    /// Where the fringes are sharpest, and how surely.
    sharpest_dpt: f64,
    sigma_dpt: f64,
    contrast: f64,
    steps: Vec<Step>,
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

impl Found {
    fn of(focused: &Focused) -> Self {
        let lens = focused.lens;
        let sharpest = focused.sharpest;
        let steps = focused.steps.iter().map(|step| Step {
            counts: step.counts,
            setting_dpt: lens.power_dpt(step.counts),
            contrast: step.contrast,
        });
        Self {
            counts: lens.counts,
            setting_dpt: lens.setting_dpt(),
            sharpest_dpt: (sharpest.counts - lens.zero_counts) * lens.dpt_per_count,
            sigma_dpt: sharpest.sigma_counts * lens.dpt_per_count.abs(),
            contrast: sharpest.contrast,
            steps: steps.collect(),
        }
    }
}

/// Says what was found, and which head was written for it, if one was.
pub fn conclude(
    focused: &Focused,
    made: Made<'_>,
    written: Option<(&Path, &CalibrationRecord)>,
    truth: Option<serde_json::Value>,
    common: &Common,
) -> anyhow::Result<Outcome> {
    let found = Found::of(focused);
    let words = format!(
        "sharpest at {:.3} ± {:.3} dpt (contrast {:.3}); the nearest counts are {} ({:.3} dpt)",
        found.sharpest_dpt, found.sigma_dpt, found.contrast, found.counts, found.setting_dpt
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
