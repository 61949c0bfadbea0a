//! `flankscope calibrate --images` with an ordinary board: a checkerboard, a ChArUco board or circles in a few poses.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use flankscope_foundation::date::{self, Date};
use flankscope_jobs::calibration::BoardFolder;
use flankscope_profilometry::calibrate::board::{BoardAdjusted, Parameter, PoseReport};
use flankscope_profilometry::head::CalibrationRecord;
use flankscope_record::seal::Kind;
use serde::Serialize;

use crate::instrument::seals;
use crate::output::{Common, Outcome, say};

#[derive(Serialize)]
struct Document<'a> {
    head: &'a Path,
    date: String,
    calibration: &'a CalibrationRecord,
    /// Root mean square of the reprojection errors in both images, as other programs state it.
    reprojection_px: Reprojection,
    poses: &'a [PoseReport],
    parameters: &'a [Parameter],
    /// Covariance of the parameters, row by row in their order.
    covariance: &'a [Vec<f64>],
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Reprojection {
    camera: f64,
    projector: f64,
}

#[derive(Serialize)]
struct Elapsed {
    total: f64,
}

/// Input and output of the calibration.
pub struct Order<'a> {
    /// Folder of the poses.
    pub images: &'a Path,
    /// `board.toml`, if it is elsewhere.
    pub board: Option<&'a Path>,
    /// The head file.
    pub output: &'a Path,
}

/// Calibrates and writes the head.
pub fn run(order: &Order<'_>, common: &Common) -> anyhow::Result<Outcome> {
    let begun = Instant::now();
    let folder = BoardFolder::open(order.images, order.board)?;
    if !common.quiet {
        say(&format!("board    {}", folder.board()));
    }
    let adjusted = folder.calibrate(|pose| {
        if !common.quiet {
            say(&pose.display().to_string());
        }
    })?;
    let record = folder.save(&adjusted, order.output, Date::today())?;
    seals()?
        .seal_toml(Kind::Head, order.output)
        .context("seal of the head")?;
    common.write_json(&Document {
        head: order.output,
        date: date::now(),
        calibration: &record,
        reprojection_px: Reprojection {
            camera: adjusted.camera_rms_px[1],
            projector: adjusted.projector_rms_px[1],
        },
        poses: &adjusted.poses,
        parameters: &adjusted.parameters,
        covariance: &adjusted.covariance,
        elapsed_ms: Elapsed {
            total: begun.elapsed().as_secs_f64() * 1e3,
        },
    })?;
    if !common.quiet && common.json.as_deref() != Some(Path::new("-")) {
        print(&adjusted, &record, order.output)?;
    }
    Ok(Outcome::Done)
}

fn print(adjusted: &BoardAdjusted, record: &CalibrationRecord, path: &Path) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out)?;
    for pose in &adjusted.poses {
        let [camera, projector] = [pose.camera_rms_px[0], pose.projector_rms_px[0]];
        let used = match pose.used {
            true => format!("{} dropped", pose.dropped),
            false => "LEFT OUT: it does not fit the others".to_owned(),
        };
        writeln!(
            out,
            "{}: {} points, {used}; camera {camera:.3} px, projector {projector:.3} px",
            pose.name, pose.points
        )?;
        if let Some(out_of) = &pose.left_out {
            writeln!(
                out,
                "    by the other poses: camera {:.3} px, projector {:.3} px, flat to {:.0} µm rms, points in place to {:.0} µm rms",
                out_of.camera_rms_px,
                out_of.projector_rms_px,
                out_of.flatness_rms_um,
                out_of.points_rms_um
            )?;
        }
    }
    writeln!(
        out,
        "\n{} points in {} poses, {} dropped; residual per axis {:.3} px in the camera, {:.3} px in the projector (distances {:.3} and {:.3} px)",
        record.dots,
        record.views,
        record.dropped,
        record.camera_rms_px,
        record.projector_rms_px,
        adjusted.camera_rms_px[1],
        adjusted.projector_rms_px[1]
    )?;
    let [near_mm, far_mm] = adjusted.depth_mm;
    writeln!(
        out,
        "a point's standard uncertainty between {near_mm:.0} and {far_mm:.0} mm: {:.0} µm in depth, {:.0} µm across",
        record.depth_sigma_um, record.lateral_sigma_um
    )?;
    let scale = record
        .board
        .as_ref()
        .and_then(|board| board.scale_sigma_ratio);
    match scale {
        Some(ratio) => writeln!(out, "that of the scale ({:.3} %) is counted", 100.0 * ratio)?,
        None => writeln!(
            out,
            "the scale is not known: every length is in proportion to the board's pitch, which nobody certified (pitch_sigma_mm)"
        )?,
    }
    writeln!(
        out,
        "where the head is on its stage is not known: `decode` measures with {}, `inspect` does not",
        path.display()
    )?;
    writeln!(out, "{}: valid until {}", path.display(), record.expires)
}
