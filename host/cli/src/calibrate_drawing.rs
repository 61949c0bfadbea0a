//! `flankscope calibrate --drawing`: what is printed on a target's plates, or on a board, for whoever makes them.

use std::path::Path;

use anyhow::{Context, bail};
use flankscope_jobs::calibration::{board_artwork, target_artwork};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::Target;
use flankscope_report::artwork_svg;
use serde::Serialize;

use crate::geometry::{tell, write_file};
use crate::output::{Common, Outcome};

#[derive(Serialize)]
struct Document<'a> {
    drawing: &'a Path,
    size_mm: [f64; 2],
    marks: usize,
    pitch_mm: f64,
    tolerance_mm: Option<f64>,
}

/// Draws the board of this file, or else the plates of the target in this folder.
pub fn run(
    drawing: &Path,
    target: Option<&Path>,
    board: Option<&Path>,
    common: &Common,
) -> anyhow::Result<Outcome> {
    common.try_json()?;
    let artwork = match (board, target) {
        (Some(board), _) => board_artwork(board)?,
        (None, Some(folder)) => {
            let target = Target::load(&folder.join("target.toml")).context("target")?;
            let head = folder.join("head.toml");
            let head = HeadModel::load(&head).context("head, for which the plates are")?;
            target_artwork(&target, &head)?
        }
        (None, None) => bail!(
            "--drawing draws the plates of --target DIR or the board of --board BOARD.toml: name one"
        ),
    };
    let svg = artwork_svg(&artwork);
    write_file(drawing, |out| out.write_all(svg.as_bytes()))?;
    let [across, up] = artwork.size_mm;
    let marks = artwork.marks.len();
    common.write_json(&Document {
        drawing,
        size_mm: artwork.size_mm,
        marks,
        pitch_mm: artwork.pitch_mm,
        tolerance_mm: artwork.tolerance_mm,
    })?;
    tell(common, || {
        format!(
            "{}: {marks} marks on {across} x {up} mm -> {}",
            artwork.title,
            drawing.display()
        )
    });
    Ok(Outcome::Done)
}
