//! Uncertainty of a flank due to the head's calibration.
//!
//! A calibrated head states the uncertainty of a point along and across its viewing direction. Only the component along a flank's
//! normal matters; on an involute this normal lies at the pressure angle off the circumference, so most of it is across the view.
//! That the pose absorbs errors common to all flanks in view is not taken into account.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;

/// Standard uncertainty of a flank's distance from its CAD due to the head's calibration alone, µm: from the head file, but at
/// least the tool's `calibration_um`, if given.
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

/// Angle between a flank's normal and the circumference in the middle of the judged zone. `None` for a patch, which may face
/// anywhere: the larger of both uncertainties is then used.
fn normal_from_circumference_rad(tool: &Tool) -> Option<f64> {
    let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
    let of_gear = |gear: &GearData| {
        let radius_mm = middle(tool.zone().map_or(gear.active_flank_mm(), |z| z.radius_mm));
        (gear.base_radius_mm() / radius_mm).min(1.0).acos()
    };
    tool.gear.as_ref().map(of_gear)
}
