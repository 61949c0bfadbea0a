//! How well a scan knows the mean size of the bore.
//!
//! Views of a bore that is larger all around lie on the CAD as those of a head that stands farther from the wall do, and the
//! head's distance is known to no better than half a millimetre: poses take up the size as a whole, and the map shows none of it.
//! What tells it is the pitch. Of teeth at a larger radius the views see the distances larger by the same share, within what the
//! head's calibration leaves of its lateral scale.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::HEAD_SIGMA_MM;

/// Standard uncertainty of the mean radius as the map has it, that of the CAD, mm. `stretch` is the share by which the teeth stand
/// farther apart than the CAD's, `lateral_mm` the standard uncertainty of a point across the view by the calibration, which may
/// all be scale, at the edge of the field.
///
/// What was found of the size counts as uncertainty: nothing corrects the map for it. Without a figure of the pitch the size is
/// known as the head's distance is.
pub(super) fn size_sigma_mm(
    gear: &GearData,
    stretch: Option<f64>,
    lateral_mm: f64,
    half_field_mm: f64,
) -> f64 {
    stretch.map_or(HEAD_SIGMA_MM, |stretch| {
        gear.pitch_radius_mm() * stretch.hypot(lateral_mm / half_field_mm)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_metrology::gear::GearKind;

    #[test]
    fn the_size_is_as_uncertain_as_scale_and_what_was_found_of_it() {
        let gear = GearData {
            kind: GearKind::Internal,
            teeth: 80,
            module_mm: 1.0,
            pressure_angle_deg: 20.0,
            tip_radius_mm: 39.0,
            root_radius_mm: 41.25,
            first_tooth_centre_deg: 2.25,
            height_mm: [0.0, 66.0],
            radial_threshold_mm: 50.0,
        };
        let um = |stretch, lateral_mm| 1e3 * size_sigma_mm(&gear, stretch, lateral_mm, 5.0);
        // 40 mm of pitch radius: 1 um at 5 mm is 8 um there.
        assert!((um(Some(0.0), 1e-3) - 8.0).abs() < 1e-9);
        // Teeth 6e-4 farther apart are 24 um farther out.
        assert!((um(Some(6e-4), 0.0) - 24.0).abs() < 1e-9);
        assert!((um(Some(-6e-4), 1e-3) - 24f64.hypot(8.0)).abs() < 1e-9);
        assert!((um(None, 1e-3) - 500.0).abs() < 1e-9);
    }
}
