//! Uncertainty of the mean bore size in a scan.
//!
//! Views of a bore that is larger all around look like those of a head farther from the wall, and the head's distance is known
//! only to half a millimetre: the poses absorb the size completely, and the map does not show it. The pitch does: teeth at a
//! larger radius are farther apart by the same ratio, to within the uncertainty of the head's lateral scale.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::HEAD_SIGMA_MM;

/// Standard uncertainty of the map's mean radius, which equals that of the CAD, mm. `stretch` is the relative excess of the
/// teeth's distances over the CAD's; `lateral_mm` is the standard uncertainty of a point across the view due to the calibration,
/// which may be entirely scale, at the edge of the field.
///
/// The measured stretch counts as uncertainty, because the map is not corrected for it. Without a value of the pitch, the
/// uncertainty of the size is that of the head's distance.
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
        // 40 mm of pitch radius: 1 µm at 5 mm corresponds to 8 µm there.
        assert!((um(Some(0.0), 1e-3) - 8.0).abs() < 1e-9);
        // Teeth farther apart by 6e-4 are 24 µm farther out.
        assert!((um(Some(6e-4), 0.0) - 24.0).abs() < 1e-9);
        assert!((um(Some(-6e-4), 1e-3) - 24f64.hypot(8.0)).abs() < 1e-9);
        assert!((um(None, 1e-3) - 500.0).abs() < 1e-9);
    }
}
