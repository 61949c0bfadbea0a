//! What the head's calibration leaves uncertain of a flank.
//!
//! A calibrated head says how well it knows a point along its view and across. A flank feels the part along its normal, which
//! on an involute lies at the pressure angle off the circumference: most of it across the view. The pose, which takes up what
//! all flanks in view share, is not counted on.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;

/// Standard uncertainty of a flank's distance from its CAD by the head's calibration alone, um: what the head's file says,
/// but at least the tool's `calibration_um`, if that is given.
pub(crate) fn calibration_um(tool: &Tool, head: &HeadModel) -> f64 {
    let stated_um = tool.inspect.as_ref().and_then(|i| i.calibration_um);
    head.calibration
        .as_ref()
        .map_or(1e3 * tool.wear_settings().calibration_mm, |record| {
            let (sin, cos) = normal_from_circumference_rad(tool).sin_cos();
            let own_um = (record.depth_sigma_um * sin).hypot(record.lateral_sigma_um * cos);
            own_um.max(stated_um.unwrap_or(0.0))
        })
}

/// Angle between a flank's normal and the circumference in the middle of the judged zone. Without a gear: half a right angle.
fn normal_from_circumference_rad(tool: &Tool) -> f64 {
    let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
    let of_gear = |gear: &GearData| {
        let radius_mm = middle(tool.zone().map_or(gear.active_flank_mm(), |z| z.radius_mm));
        (gear.base_radius_mm() / radius_mm).min(1.0).acos()
    };
    let none = std::f64::consts::FRAC_PI_4;
    tool.gear.as_ref().map_or(none, of_gear)
}
