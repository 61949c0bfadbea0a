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
            let [depth_um, lateral_um] = [record.depth_sigma_um, record.lateral_sigma_um];
            let own_um = match normal_from_circumference_rad(tool) {
                Some(angle_rad) => {
                    let (sin, cos) = angle_rad.sin_cos();
                    (depth_um * sin).hypot(lateral_um * cos)
                }
                None => depth_um.max(lateral_um),
            };
            own_um.max(stated_um.unwrap_or(0.0))
        })
}

/// Angle between a flank's normal and the circumference in the middle of the judged zone. A patch may face anywhere: the larger of
/// both uncertainties is then as much as it can feel.
fn normal_from_circumference_rad(tool: &Tool) -> Option<f64> {
    let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
    let of_gear = |gear: &GearData| {
        let radius_mm = middle(tool.zone().map_or(gear.active_flank_mm(), |z| z.radius_mm));
        (gear.base_radius_mm() / radius_mm).min(1.0).acos()
    };
    tool.gear.as_ref().map(of_gear)
}
