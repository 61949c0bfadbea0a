//! What a capture should find, from the damage's closed form.

use flankscope_gear_cad::{Flank, GearSpec};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::wear::Zone;
use nalgebra::Vector2;

use super::TOOTH;
use crate::world::{FlankId, Wear, WearField, WearKind};

/// The measurand: the percentile over the zone's cells of the true depth, averaged over each cell; of the height of
/// built-up material for cases with such. From the damage's closed form, not from anything measured.
pub(super) fn truth_um(
    tool: &Tool,
    gear: &GearSpec,
    wear: &[Wear],
    flank: Flank,
) -> anyhow::Result<f64> {
    let (Some(data), Some(zone)) = (&tool.gear, tool.zone()) else {
        anyhow::bail!("the demo tool has no zone");
    };
    let field = WearField::new(gear, wear)?;
    let settings = tool.wear_settings();
    let mut depths = depths_um(data, &zone, &field, flank, settings.cell_mm);
    depths.sort_by(f64::total_cmp);
    let own = |one: &&Wear| one.flank == flank;
    let buildup = wear
        .iter()
        .filter(own)
        .any(|one| one.kind == WearKind::Buildup);
    let share = if buildup {
        100.0 - settings.percentile
    } else {
        settings.percentile
    } / 100.0;
    let rank = share * (depths.len() - 1) as f64;
    let (low, part) = (rank.floor() as usize, rank.fract());
    let value = depths[low] + part * (depths[(low + 1).min(depths.len() - 1)] - depths[low]);
    Ok(if buildup { -value } else { value })
}

/// True mean depth of each cell of the zone, µm.
fn depths_um(
    gear: &GearData,
    zone: &Zone,
    field: &WearField,
    flank: Flank,
    cell_mm: f64,
) -> Vec<f64> {
    /// Samples along each side of a cell.
    const FINE: usize = 12;
    let id = FlankId {
        tooth: TOOTH,
        flank,
    };
    let from = Vector2::new(gear.profile_mm(zone.radius_mm[0]), zone.height_mm[0]);
    let size = Vector2::new(gear.profile_mm(zone.radius_mm[1]), zone.height_mm[1]) - from;
    let count = size.map(|length| (length / cell_mm).floor() as usize);
    let base = gear.base_radius_mm();
    let mut depths = Vec::with_capacity(count.x * count.y);
    for row in 0..count.y {
        for column in 0..count.x {
            let mut sum = 0.0;
            for i in 0..FINE * FINE {
                let inside =
                    Vector2::new((i % FINE) as f64 + 0.5, (i / FINE) as f64 + 0.5) / FINE as f64;
                let cell = Vector2::new(column as f64, row as f64) + inside;
                let at = from
                    + size
                        .component_mul(&cell)
                        .component_div(&count.map(|n| n as f64));
                // Profile length s from the base circle: r2 = rb2 + 2 rb s.
                let radius = (base * base + 2.0 * base * at.x).sqrt();
                sum += field.depth_mm(id, radius, at.y);
            }
            depths.push(1e3 * sum / (FINE * FINE) as f64);
        }
    }
    depths
}
