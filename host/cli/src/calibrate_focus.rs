//! `flankscope calibrate --focus-series`: the head at a setting of its lens, interpolated between calibrations at other settings.

use std::io::Write;
use std::path::{Path, PathBuf};

use flankscope_foundation::date::{self, Date};
use flankscope_jobs::calibration::save_head;
use flankscope_profilometry::calibrate::FocusSeries;
use flankscope_profilometry::head::CalibrationRecord;
use flankscope_record::seal::{Kind, toml_document};
use serde::Serialize;

use crate::instrument::seals;
use crate::output::{Common, Outcome};

/// Which lens, and how it is driven.
#[derive(clap::Args)]
pub struct FocusArgs {
    /// Compute the file of a head with a driven lens for one setting (--focus) from its calibrations at several settings, which
    /// this file lists; nothing is captured
    #[arg(
        long,
        value_name = "FOCUS.toml",
        requires = "lens_celsius",
        conflicts_with_all = ["images", "board", "check"]
    )]
    pub focus_series: Option<PathBuf>,
    /// Power to which the lens is driven, rounded to a step of its driver [default: the starting head's counts]
    #[arg(
        long,
        value_name = "DPT",
        conflicts_with_all = ["board", "check"],
        allow_negative_numbers = true
    )]
    pub focus: Option<f64>,
    /// Find the setting of a driven lens at which the camera is sharp on the middle of the target's blank plate; with --focus-series
    /// and -o, write the head file for that setting
    #[arg(long, conflicts_with_all = ["focus", "images", "board", "check"])]
    pub autofocus: bool,
    /// Head with which --autofocus measures the distance of the plate; one that was calibrated, at any setting of its lens, gives a
    /// smaller uncertainty [default: the target's head.toml]
    #[arg(long, value_name = "HEAD.toml", requires = "autofocus")]
    pub head: Option<PathBuf>,
    /// Temperature of the lens in degrees C; with --focus-series
    #[arg(
        long,
        value_name = "CELSIUS",
        requires = "focus_series",
        allow_negative_numbers = true
    )]
    lens_celsius: Option<f64>,
}

#[derive(Serialize)]
struct Document<'a> {
    head: &'a Path,
    focus_series: &'a Path,
    date: String,
    calibration: &'a CalibrationRecord,
}

/// Computes and writes the head at a setting.
pub fn write(
    args: &FocusArgs,
    setting_dpt: f64,
    series: &Path,
    output: &Path,
) -> anyhow::Result<CalibrationRecord> {
    let Some(celsius) = args.lens_celsius else {
        anyhow::bail!("--focus-series without --lens-celsius");
    };
    let heads = FocusSeries::load(series)?.heads(series)?;
    let seals = seals()?;
    for path in heads.files() {
        let document = toml_document(path, &flankscope_foundation::files::read_text(path)?)?;
        seals.believe(Kind::Head, path, &document)?;
    }
    let (head, record) = heads.at(setting_dpt, celsius)?;
    let record = save_head(head, output, Date::today(), |head| CalibrationRecord {
        blake3: head.geometry_blake3(),
        ..record
    })?;
    seals.seal_toml(Kind::Head, output)?;
    Ok(record)
}

/// Computes and writes the head at the requested setting.
pub fn run(
    args: &FocusArgs,
    series: &Path,
    output: &Path,
    common: &Common,
) -> anyhow::Result<Outcome> {
    let Some(setting_dpt) = args.focus else {
        anyhow::bail!("--focus-series without --focus, and without --autofocus, which finds one");
    };
    let record = write(args, setting_dpt, series, output)?;
    common.write_json(&Document {
        head: output,
        focus_series: series,
        date: date::now(),
        calibration: &record,
    })?;
    if !common.quiet && common.json.as_deref() != Some(Path::new("-")) {
        print(&record, output)?;
    }
    Ok(Outcome::Done)
}

fn print(record: &CalibrationRecord, path: &Path) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if let Some(focus) = &record.focus {
        let [depth_um, lateral_um] = focus.interpolation_um;
        let [drift_depth_um, drift_lateral_um] = focus.drift_um;
        writeln!(
            out,
            "{} dpt at {} °C, computed between {:?} dpt\ninterpolation between them leaves {depth_um:.1} µm in depth, {lateral_um:.1} µm \
             across, drift {drift_depth_um:.1} µm and {drift_lateral_um:.1} µm",
            focus.setting_dpt, focus.celsius, focus.between_dpt
        )?;
    }
    writeln!(
        out,
        "a point's standard uncertainty by the calibration: {:.1} µm in depth, {:.1} µm across",
        record.depth_sigma_um, record.lateral_sigma_um
    )?;
    if record.simulated == Some(true) {
        writeln!(out, "SIMULATED BENCH: this head cannot be used at a press")?;
    }
    writeln!(
        out,
        "{}: valid until {}\nno self-test yet; checks need one: flankscope calibrate --check {}",
        path.display(),
        record.expires,
        path.display()
    )?;
    Ok(())
}
