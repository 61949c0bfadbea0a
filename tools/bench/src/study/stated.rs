//! What drawn calibrations leave of an undamaged flank, evaluated before the study: what an instrument finds on a master.

use anyhow::Context;
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::decode::GridKind;
use flankscope_station::baseline::Baseline;
use flankscope_station::inspection::ViewOutcome;
use rayon::prelude::*;

use super::capture::{CALIBRATION_PX, DRIFT_PX, Instrument, Trouble, calibrated, judged};
use crate::demo;
use crate::world::World;

/// Captures of the master, and calibrations drawn for each; both flanks count.
const POSITIONS: u32 = 4;
const DRAWS: u32 = 10;

/// Depth of a master's flanks, which have none, by calibrations with errors, and its difference to a baseline by their drift,
/// µm (root mean square): the same frames decoded with heads that differ by as much (a Monte Carlo evaluation as in JCGM
/// 101). Beside the calibrations it holds what optics and decoding leave. The draws are not those of the captures.
pub(super) fn on_master_um(tool: &Tool, head: &HeadModel, seed: u64) -> anyhow::Result<[f64; 2]> {
    let mut config = demo::world_of(tool, head)?;
    config.run_seed = seed;
    let world = World::new(&config)?;
    let size_px = world.size_px();
    let plain = Instrument::new(tool, head, GridKind::Core, None, None)?;
    let mut squares = [0.0; 2];
    for position in 0..POSITIONS {
        let draw = |number: u32| (seed << 44) | (1 << 43) | u64::from(DRAWS * position + number);
        let state = plain.approach(&world, draw(0), Trouble::default())?;
        let mut frames = Vec::new();
        plain.frames(&world, &state, position, Trouble::default(), |frame, _| {
            frames.push(frame.pixels.to_vec());
            Ok(())
        })?;
        let golden = plain.judge(&frames, size_px)?;
        let baseline = Baseline {
            tool: tool.name.clone(),
            hashes: std::collections::BTreeMap::new(),
            simulated: Some(true),
            flanks: golden.fields,
            poses: golden.pose.into_iter().collect(),
        };
        let square = |number: u32, sd_px: f64, baseline| -> anyhow::Result<f64> {
            let head = calibrated(head, draw(number), sd_px);
            let instrument = Instrument::new(tool, &head, GridKind::Core, None, baseline)?;
            mean_square_um2(&instrument.judge(&frames, size_px)?)
        };
        let found: Vec<[f64; 2]> = (0..DRAWS)
            .into_par_iter()
            .map(|number| {
                Ok([
                    square(number, CALIBRATION_PX, None)?,
                    square(number, DRIFT_PX, Some(baseline.clone()))?,
                ])
            })
            .collect::<anyhow::Result<_>>()?;
        for found in found {
            squares = [squares[0] + found[0], squares[1] + found[1]];
        }
    }
    Ok(squares.map(|sum| (sum / f64::from(POSITIONS * DRAWS)).sqrt()))
}

/// Of the two flanks' depths.
fn mean_square_um2(outcome: &ViewOutcome) -> anyhow::Result<f64> {
    let of = |flank| -> anyhow::Result<f64> {
        let depth_um = judged(outcome, flank)?.wear_um;
        Ok(depth_um
            .context("an undamaged flank has no figure")?
            .powi(2))
    };
    Ok(0.5 * (of(Flank::Left)? + of(Flank::Right)?))
}
