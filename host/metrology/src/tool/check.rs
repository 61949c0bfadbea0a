//! Checks of a tool file: every value in its range, and every limit, zone and threshold against the gear and its CAD.

use std::path::Path;

use nalgebra::Vector3;

use super::patch_file::without_teeth;
use super::{Datum, File, Inspect, Temperature, ToolError};
use crate::gear::{Flank, GearData};
use crate::io::mesh::TriMesh;
use crate::registration::detect_teeth;
use crate::surface::Surface;
use crate::verdict::flank::LEAST_COVERAGE;

/// CAD and gear data of one tool agree within this, mm: profile corrections are smaller, a wrong tooth is larger.
const AGREEMENT_MM: f64 = 0.1;
/// More repetitions than this halve no uncertainty any more that fewer have not.
const MOST_REPEATS: u32 = 10;

/// Refuses values by key.
struct Refusal<'a>(&'a Path);

impl Refusal<'_> {
    fn refuse<T>(&self, key: &'static str, value: f64, expected: &str) -> Result<T, ToolError> {
        Err(ToolError::Value {
            path: self.0.to_owned(),
            key,
            value,
            expected: expected.to_owned(),
        })
    }

    /// A value that is not finite is in no range.
    fn within(
        &self,
        key: &'static str,
        value: f64,
        [least, most]: [f64; 2],
    ) -> Result<(), ToolError> {
        if (least..=most).contains(&value) {
            return Ok(());
        }
        self.refuse(key, value, &format!("{least} to {most}"))
    }
}

/// Checks every value of a tool file, each by itself and against the gear.
pub(super) fn values(path: &Path, file: &File) -> Result<(), ToolError> {
    let is = Refusal(path);
    is.within("cad.chord_error_um", file.cad.chord_error_um, [0.0, 1000.0])?;
    if let Some(gear) = &file.gear {
        gear.check().map_err(|source| ToolError::Gear {
            path: path.to_owned(),
            source,
        })?;
    }
    if let Some(temperature) = &file.temperature {
        of_temperature(&is, temperature)?;
    }
    if !file.patch.is_empty() {
        let path = path.to_owned();
        match (&file.gear, &file.inspect) {
            (Some(_), _) => return Err(ToolError::GearAndPatches { path }),
            (None, None) => return Err(ToolError::NotInspected { path }),
            (None, Some(inspect)) => without_teeth(&path, inspect)?,
        }
    }
    let Some(inspect) = &file.inspect else {
        return Ok(());
    };
    alone(&is, inspect)?;
    if inspect.teeth.is_empty() && file.patch.is_empty() {
        return is.refuse("inspect.teeth (count)", 0.0, "at least one tooth");
    }
    limits(&is, inspect, file.gear.as_ref())?;
    if let Some(gear) = &file.gear {
        zone(&is, inspect, gear)?;
    }
    Ok(())
}

#[rustfmt::skip]
fn of_temperature(is: &Refusal<'_>, temperature: &Temperature) -> Result<(), ToolError> {
    let [low, high] = temperature.range_degc;
    if !(-50.0..=high).contains(&low) || high > 1000.0 {
        return is.refuse("temperature.range_degc[0]", low, "increasing, from -50 to 1000");
    }
    is.within("temperature.reference_degc", temperature.reference_degc, [-50.0, 1000.0])?;
    is.within("temperature.expansion_per_k", temperature.expansion_per_k, [0.0, 1e-3])?;
    is.within("temperature.u_k", temperature.u_k, [0.0, 100.0])
}

/// Values that say by themselves whether they are possible.
#[rustfmt::skip]
fn alone(is: &Refusal<'_>, inspect: &Inspect) -> Result<(), ToolError> {
    for (key, value, range) in [
        ("inspect.drift_um", inspect.drift_um, [0.0, 1000.0]),
        ("inspect.film_um", inspect.film_um, [0.0, 1000.0]),
        ("inspect.as_built_um", inspect.as_built_um.unwrap_or(0.0), [0.0, 1000.0]),
        ("inspect.calibration_um", inspect.calibration_um.unwrap_or(0.0), [0.0, 1000.0]),
        ("inspect.least_coverage", inspect.least_coverage, [LEAST_COVERAGE, 1.0]),
        // A disc below a hundredth of a square millimetre holds only a few cores.
        ("inspect.wear_area_mm2", inspect.wear_area_mm2, [0.01, 100.0]),
        ("inspect.remeasure", f64::from(inspect.remeasure), [0.0, f64::from(MOST_REPEATS)]),
    ] {
        is.within(key, value, range)?;
    }
    if !(0.5..1.0).contains(&inspect.probability) {
        return is.refuse("inspect.probability", inspect.probability, "0.5 to below 1");
    }
    let [down, up] = inspect.zone_height_mm;
    if !(-1000.0..up).contains(&down) || up > 1000.0 {
        return is.refuse("inspect.zone_height_mm[0]", down, "below zone_height_mm[1], both relative to height_mm");
    }
    Ok(())
}

/// Warning limits up to their stop limits, and these up to what a tooth has: a limit that no damage can reach is none.
fn limits(is: &Refusal<'_>, inspect: &Inspect, gear: Option<&GearData>) -> Result<(), ToolError> {
    // Half the thickness of a tooth at the pitch circle, which is half the gap beside it, too; without a gear, a centimetre.
    let half_mm = gear.map_or(10.0, |gear| 0.25 * std::f64::consts::PI * gear.module_mm);
    let wear_um = [inspect.warn_um, inspect.limit_um];
    #[rustfmt::skip]
    let mut pairs = vec![
        (["inspect.warn_um", "inspect.limit_um"], wear_um, 1e3 * half_mm),
        (["inspect.proud_warn_um", "inspect.proud_limit_um"], inspect.proud_um(), 1e3 * half_mm),
        // A single cell may lose more than a whole disc: up to all of the tooth.
        (["inspect.cell_warn_um", "inspect.cell_limit_um"], inspect.cell_um(), 2e3 * half_mm),
    ];
    if let Some(gear) = gear {
        let keys = ["inspect.tip_warn_mm", "inspect.tip_limit_mm"];
        pairs.push((keys, inspect.tip_mm(gear), half_mm));
    }
    for (keys, [warn, limit], most) in pairs {
        if !(limit > 0.0 && limit <= most) {
            let expected =
                format!("above 0, at most {most:.4}: what a tooth of this gear has to lose");
            return is.refuse(keys[1], limit, &expected);
        }
        if !(warn > 0.0 && warn <= limit) {
            let expected = format!("above 0, at most its stop limit, {limit}");
            return is.refuse(keys[0], warn, &expected);
        }
    }
    // Less than the stop limit supposed in a hole would let a hole hide a no-go.
    let hidden_um = inspect.hidden_depth_um();
    is.within(
        "inspect.hidden_depth_um",
        hidden_um,
        [inspect.limit_um, 1e5],
    )
}

/// The zone lies on the toothing, and has room for the disc.
fn zone(is: &Refusal<'_>, inspect: &Inspect, gear: &GearData) -> Result<(), ToolError> {
    for &tooth in &inspect.teeth {
        is.within(
            "inspect.teeth",
            f64::from(tooth),
            [1.0, f64::from(gear.teeth)],
        )?;
    }
    let [low, high] = gear.height_mm;
    is.within("inspect.height_mm", inspect.height_mm, gear.height_mm)?;
    let [down, up] = inspect.zone_height_mm;
    for (key, end_mm) in [
        ("inspect.zone_height_mm[0]", down),
        ("inspect.zone_height_mm[1]", up),
    ] {
        let at_mm = inspect.height_mm + end_mm;
        if !(low..=high).contains(&at_mm) {
            let expected = format!(
                "{} to {}, so that the zone lies within gear.height_mm, {low} to {high}",
                low - inspect.height_mm,
                high - inspect.height_mm
            );
            return is.refuse(key, end_mm, &expected);
        }
    }
    datum_bands(is, inspect, gear)?;
    if let Some([from, to]) = inspect.zone_radius_mm {
        let least = gear.tip_radius_mm.min(gear.root_radius_mm);
        let most = gear.tip_radius_mm.max(gear.root_radius_mm);
        let expected = format!("increasing and within {least} to {most} (tip and root)");
        if !(least..to).contains(&from) {
            return is.refuse("inspect.zone_radius_mm[0]", from, &expected);
        }
        if to > most {
            return is.refuse("inspect.zone_radius_mm[1]", to, &expected);
        }
    }
    let radii = inspect
        .zone_radius_mm
        .unwrap_or_else(|| gear.active_flank_mm());
    let [from_mm, to_mm] = radii.map(|radius| gear.profile_mm(radius));
    let room_mm = (to_mm - from_mm).min(up - down);
    let most_mm2 = 0.25 * std::f64::consts::PI * room_mm * room_mm;
    // Comparisons with NaN are false: a value that is not a number is refused as well.
    if inspect.wear_area_mm2 <= most_mm2 {
        return Ok(());
    }
    let expected = format!("at most {most_mm2:.3}: a disc that fits into the judged zone");
    is.refuse("inspect.wear_area_mm2", inspect.wear_area_mm2, &expected)
}

/// Bands of a datum lie on the toothing, beside the judged zone, and nothing else is named as what the pose rests on.
fn datum_bands(is: &Refusal<'_>, inspect: &Inspect, gear: &GearData) -> Result<(), ToolError> {
    let key = "inspect.datum_height_mm";
    let zone_mm = inspect.zone_height_mm.map(|end| inspect.height_mm + end);
    for &[from, to] in &inspect.datum_height_mm {
        for end in [from, to] {
            is.within(key, end, gear.height_mm)?;
        }
        if from >= to {
            let expected = format!("below the upper end of its band, {to}");
            return is.refuse(key, from, &expected);
        }
        let [low, high] = zone_mm;
        if from < high && to > low {
            let inside = if from >= low { from } else { to };
            let expected = format!(
                "a band that ends at {low} or begins at {high}: the judged zone (inspect.zone_height_mm) wears"
            );
            return is.refuse(key, inside, &expected);
        }
    }
    let named = inspect.datum_height_mm.len();
    if named > 0 && inspect.datum != Datum::default() {
        let key = "inspect.datum_height_mm (bands) beside inspect.datum";
        return is.refuse(key, named as f64, "one of the two keys");
    }
    Ok(())
}

/// The gear's involutes, tips, roots and ends must lie on the mesh, and the mesh must repeat as often as the gear has teeth.
pub(super) fn against_mesh(
    path: &Path,
    gear: &GearData,
    mesh: &TriMesh,
    surface: &Surface,
) -> Result<(), ToolError> {
    if let Some(found) = detect_teeth(mesh, surface, 0.02)
        && found != gear.teeth
    {
        return Err(ToolError::Teeth {
            path: path.to_owned(),
            stated: gear.teeth,
            found,
        });
    }
    let height = 0.5 * (gear.height_mm[0] + gear.height_mm[1]);
    let [from, to] = gear.active_flank_mm();
    let step = (gear.teeth / 7).max(1);
    for tooth in (1..=gear.teeth).step_by(step as usize) {
        for flank in Flank::BOTH {
            for radius_mm in [from, 0.5 * (from + to), to] {
                let Some(point) = gear.flank_point(tooth, flank, radius_mm, height) else {
                    continue;
                };
                let distance_mm = surface.closest(point).signed_distance_mm.abs();
                if distance_mm > AGREEMENT_MM {
                    return Err(ToolError::Disagree {
                        path: path.to_owned(),
                        tooth,
                        flank,
                        radius_mm,
                        distance_mm,
                        limit_mm: AGREEMENT_MM,
                    });
                }
            }
        }
        lands(path, gear, surface, tooth, height)?;
    }
    Ok(())
}

/// Whether the mesh's material lies on the other side of all flanks than the gear's. Of a mesh that is not closed only the
/// gear can tell; a solid that says so is another part.
///
/// # Errors
/// [`ToolError::OtherSide`] where some flanks say so and others not, or the mesh is closed.
pub(super) fn is_inside_out(
    path: &Path,
    gear: &GearData,
    surface: &Surface,
    is_closed: bool,
) -> Result<bool, ToolError> {
    let height = 0.5 * (gear.height_mm[0] + gear.height_mm[1]);
    let [from, to] = gear.active_flank_mm();
    let (mut right, mut wrong) = (0, None);
    for tooth in 1..=gear.teeth {
        for flank in Flank::BOTH {
            let Some(point) = gear.flank_point(tooth, flank, 0.5 * (from + to), height) else {
                continue;
            };
            let normals = [
                gear.flank_normal(flank, point),
                surface.closest(point).normal,
            ];
            let [out, found] = normals.map(Vector3::from);
            if out.dot(&found) > 0.0 {
                right += 1;
            } else {
                wrong = Some((tooth, flank));
            }
        }
    }
    match wrong {
        None => Ok(false),
        Some(_) if right == 0 && !is_closed => Ok(true),
        Some((tooth, flank)) => Err(ToolError::OtherSide {
            path: path.to_owned(),
            tooth,
            flank,
        }),
    }
}

/// The middle of a tooth's tip, of the root beside it, and its middle at either end.
fn lands(
    path: &Path,
    gear: &GearData,
    surface: &Surface,
    tooth: u32,
    height_mm: f64,
) -> Result<(), ToolError> {
    let centre = gear.tooth_centre_rad(tooth);
    let pitch_mm = gear.pitch_radius_mm();
    let [low, high] = gear.height_mm;
    let (tip_mm, root_mm) = (gear.tip_radius_mm, gear.root_radius_mm);
    let gap = centre + 0.5 * gear.pitch_rad();
    for (key, stated_mm, radius_mm, angle, z) in [
        ("tip_radius_mm", tip_mm, tip_mm, centre, height_mm),
        ("root_radius_mm", root_mm, root_mm, gap, height_mm),
        ("height_mm[0]", low, pitch_mm, centre, low),
        ("height_mm[1]", high, pitch_mm, centre, high),
    ] {
        let point = [radius_mm * angle.cos(), radius_mm * angle.sin(), z];
        let off_mm = surface.closest(point).signed_distance_mm.abs();
        // Comparisons with NaN are false: a value that is not a number is refused as well.
        let agrees = off_mm <= AGREEMENT_MM;
        if !agrees {
            return Err(ToolError::Land {
                path: path.to_owned(),
                key,
                stated_mm,
                off_mm,
                limit_mm: AGREEMENT_MM,
            });
        }
    }
    Ok(())
}
