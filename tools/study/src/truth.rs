//! Expected result of a capture from the closed form of the damage, without measurement and without the form error of a die as built.

use flankscope_gear_cad::{Flank, GearSpec};
use flankscope_metrology::tool::Tool;

use flankscope_bench::damage::{RASTER_MM, Rectangle, largest_mean_um};
use flankscope_bench::world::{FlankId, Wear, WearField};

/// The judged rectangle of a flank, and the disc's area, mm².
pub(super) fn judged(tool: &Tool) -> anyhow::Result<(Rectangle, f64)> {
    let (Some(data), Some(zone), Some(inspect)) = (&tool.gear, tool.zone(), &tool.inspect) else {
        anyhow::bail!("the demo tool has no zone");
    };
    let rectangle = Rectangle {
        profile_mm: zone.radius_mm.map(|radius| data.profile_mm(radius)),
        height_mm: zone.height_mm,
    };
    Ok((rectangle, inspect.wear_area_mm2))
}

/// The measurand of built-in wear: the largest mean of the true depth over any disc of the tool's area in the zone, µm.
pub(super) fn of_wear_um(
    tool: &Tool,
    gear: &GearSpec,
    wear: &[Wear],
    (tooth, flank): (u32, Flank),
) -> anyhow::Result<f64> {
    let (rectangle, area_mm2) = judged(tool)?;
    let field = WearField::new(gear, wear)?;
    let base = gear.base_radius_mm();
    Ok(largest_mean_um(
        rectangle,
        area_mm2,
        RASTER_MM,
        |profile, height| {
            // Profile length s from the base circle: r² = rb² + 2 rb s.
            let radius = (base * base + 2.0 * base * profile).sqrt();
            field.depth_mm(FlankId { tooth, flank }, radius, height)
        },
    ))
}
