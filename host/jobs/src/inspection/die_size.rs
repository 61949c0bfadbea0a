//! Whether the die in view is of its drawing's size: what all teeth in view say together, which wear does not.

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::FlankPlace;
use flankscope_metrology::registration::scale;
use flankscope_metrology::surface::Closest;
use flankscope_metrology::tool::STEEL_PER_K;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_metrology::wear::{WearSettings, Zone};

/// Standard uncertainty that a scale of the die leaves in its flanks' wear, mm: by the scale that the teeth in view may have, be it one that
/// the calibration's uncertainty explains. From one side a larger bore is one that stands farther away: nothing else tells.
///
/// # Errors
/// The die in view is not of the drawing's size.
pub(super) fn scale_mm(
    features: Features<'_>,
    (tooth, zone): (u32, &Zone),
    closest: &[Closest],
    places: &[Option<FlankPlace>],
    settings: &WearSettings,
) -> Result<f64, Reason> {
    let Some(gear) = features.gear() else {
        return Ok(0.0);
    };
    let known_mm = settings.cad_mm.hypot(settings.as_built_mm);
    let form_mm = known_mm.hypot(settings.drift_mm);
    let stated_mm = [form_mm, settings.calibration_mm];
    let found = scale::of_view(gear, tooth, closest, places, stated_mm);
    let Some(found) = found.filter(scale::Scale::is_possible) else {
        return Ok(0.0);
    };
    if found.is_shown() {
        let why = other_size(tooth, found.value, COVERAGE_95 * found.u);
        return Err(Reason::instrument(Code::OtherDie, why));
    }
    // Scaling moves every flank along its normal by its distance from the base circle's tangent point.
    let radius_mm = 0.5 * (zone.radius_mm[0] + zone.radius_mm[1]);
    let base_mm = gear.base_radius_mm();
    let per_scale_mm = (radius_mm * radius_mm - base_mm * base_mm).max(0.0).sqrt();
    Ok(found.value.abs() * per_scale_mm)
}

/// Why a view in which everything agrees on another size is not judged.
fn other_size(tooth: u32, scale: f64, u95: f64) -> String {
    format!(
        "the die in view of tooth {tooth} is {:.3} ± {:.3} % {} than the drawing: tips, roots and both flanks of the teeth beside it \
         say so together, which wear does not; it is of another drawing, or steel that is {:.0} K {} than supposed",
        100.0 * scale.abs(),
        100.0 * u95,
        if scale > 0.0 { "larger" } else { "smaller" },
        scale.abs() / STEEL_PER_K,
        if scale > 0.0 { "warmer" } else { "colder" },
    )
}
