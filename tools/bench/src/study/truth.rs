//! What a capture should find, from the damage's closed form.

use flankscope_gear_cad::{Flank, GearSpec};
use flankscope_metrology::tool::Tool;

use super::TOOTH;
use crate::world::{FlankId, Wear, WearField, WearKind};

/// Raster of the true depth, mm: a disc of 0.25 mm2 has 600 places.
const RASTER_MM: f64 = 0.02;

/// The measurand: the largest mean of the true depth over any disc of the tool's area in the zone; of the height of built-up
/// material for cases with such, µm. From the damage's closed form, not from anything measured.
pub(super) fn truth_um(
    tool: &Tool,
    gear: &GearSpec,
    wear: &[Wear],
    flank: Flank,
) -> anyhow::Result<f64> {
    let (Some(data), Some(zone), Some(inspect)) = (&tool.gear, tool.zone(), &tool.inspect) else {
        anyhow::bail!("the demo tool has no zone");
    };
    let field = WearField::new(gear, wear)?;
    let id = FlankId {
        tooth: TOOTH,
        flank,
    };
    let buildup = wear
        .iter()
        .any(|one| one.flank == flank && one.kind == WearKind::Buildup);
    let sign = if buildup { -1.0 } else { 1.0 };
    let base = data.base_radius_mm();
    let profile_mm = zone.radius_mm.map(|radius| data.profile_mm(radius));
    let count = |[low, high]: [f64; 2]| ((high - low) / RASTER_MM).round() as usize;
    let (columns, rows) = (count(profile_mm), count(zone.height_mm));
    // Sums along each row up to a column.
    let mut sums = vec![vec![0.0; columns + 1]; rows];
    for (row, sums) in sums.iter_mut().enumerate() {
        let height = zone.height_mm[0] + RASTER_MM * (row as f64 + 0.5);
        for column in 0..columns {
            // Profile length s from the base circle: r2 = rb2 + 2 rb s.
            let s = profile_mm[0] + RASTER_MM * (column as f64 + 0.5);
            let radius = (base * base + 2.0 * base * s).sqrt();
            sums[column + 1] = sums[column] + sign * field.depth_mm(id, radius, height);
        }
    }
    let radius = (inspect.wear_area_mm2 / std::f64::consts::PI).sqrt() / RASTER_MM;
    let reach = radius.floor() as usize;
    let halves: Vec<usize> = (0..=2 * reach)
        .map(|i| {
            let away = i as f64 - reach as f64;
            (radius * radius - away * away).max(0.0).sqrt() as usize
        })
        .collect();
    let places: usize = halves.iter().map(|half| 2 * half + 1).sum();
    let mut largest = f64::NEG_INFINITY;
    for row in reach..rows - reach {
        for column in reach..columns - reach {
            let sum: f64 = halves
                .iter()
                .enumerate()
                .map(|(i, &half)| {
                    let sums = &sums[row + i - reach];
                    sums[column + half + 1] - sums[column - half]
                })
                .sum();
            largest = largest.max(sum / places as f64);
        }
    }
    Ok(1e3 * largest)
}
