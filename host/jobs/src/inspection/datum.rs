//! Datum surfaces that the workpiece never touches: a patch's datum, or bands of the flanks above or below the judged zone.

use flankscope_foundation::rigid::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::{Flank, FlankPlace, GearData, LAND_DEPTH_MODULES};
use flankscope_metrology::patch::{Patch, Patches};
use flankscope_metrology::surface::{Closest, Surface};
use flankscope_metrology::tool::{Datum, Tool};
use flankscope_metrology::verdict::{Code, Reason};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::views::EvaluatorError;
use crate::plan::FieldOfView;
use flankscope_metrology::wear::sensitivity::LEAST_POINTS;

/// Step in height at which a flank's visibility is tested, mm.
const STEP_MM: f64 = 0.05;

/// Points within this distance of a datum's rim are left out, mm. If the pose is off, their nearest surface lies beyond the edge:
/// they would hold the view along a plane, which no point of a plane can, and only as well as an edge is known.
const RIM_MM: f64 = 0.15;

/// Selects the points (tool frame, mm) that the pose may rest on while these teeth, or this patch, are judged.
pub(super) fn used(
    tool: &Tool,
    judged: &[u32],
    surface: &Surface,
    points: &[[f64; 3]],
) -> Vec<bool> {
    let inspect = tool.inspect.as_ref();
    match tool.features() {
        Features::Gear(gear) => {
            let bands_mm = inspect.map_or(&[][..], |inspect| &inspect.datum_height_mm);
            let datum = inspect.map(|inspect| inspect.datum).unwrap_or_default();
            on_gear(datum, bands_mm, gear, judged, points)
        }
        Features::Patches(patches) => {
            let judged = judged.first().and_then(|&patch| patches.get(patch));
            within(patches, judged, surface, points)
        }
    }
}

/// Selects the points on a gear (tool frame, mm) that the pose may rest on while these teeth are judged. Judged flanks are
/// excluded: their wear would pull the pose towards them and hide part of itself (a fifth, for 10 µm on one of seven flanks in
/// view). The whole judged tooth is excluded, because wear at the ends of a flank extends into what would count as a land. If
/// the tool file names bands of height, points on flanks within them are used alone, also on judged teeth.
fn on_gear(
    datum: Datum,
    bands_mm: &[[f64; 2]],
    gear: &GearData,
    judged: &[u32],
    points: &[[f64; 3]],
) -> Vec<bool> {
    if !bands_mm.is_empty() {
        return within_bands(bands_mm, gear, points);
    }
    let margin_mm = LAND_DEPTH_MODULES * gear.module_mm;
    let (low_mm, high_mm) = (
        gear.tip_radius_mm.min(gear.root_radius_mm) + margin_mm,
        gear.tip_radius_mm.max(gear.root_radius_mm) - margin_mm,
    );
    let is_used = |&[x, y, _]: &[f64; 3]| match datum {
        Datum::Neighbours => !judged.contains(&gear.tooth_at(y.atan2(x))),
        Datum::Lands => !(low_mm..high_mm).contains(&x.hypot(y)),
        Datum::All => true,
    };
    points.par_iter().map(is_used).collect()
}

/// Selects the points inside the datum of a patch (tool frame, mm).
fn within(
    patches: &Patches,
    judged: Option<&Patch>,
    surface: &Surface,
    points: &[[f64; 3]],
) -> Vec<bool> {
    let closest = surface.closest_many(points);
    let on = closest.iter().map(|at| {
        let (number, patch) = patches.at(at.triangle, at.point)?;
        judged?.rests_on(number).then_some((number, patch, at))
    });
    let on: Vec<_> = on.collect();
    // A point counts if a step to every side is still on the datum.
    let steps = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let probes: Vec<[f64; 3]> = on
        .iter()
        .flatten()
        .flat_map(|(_, patch, at)| {
            let [along, up] = [0, 1].map(|k| Vector3::from(patch.axes[k]));
            steps.map(|[a, u]| (Vector3::from(at.point) + RIM_MM * (along * a + up * u)).into())
        })
        .collect();
    let beside = surface.closest_many(&probes);
    let mut beside = beside.chunks_exact(steps.len());
    on.iter()
        .map(|on| {
            let Some((number, ..)) = on else { return false };
            let same =
                |at: &Closest| patches.at(at.triangle, at.point).map(|(n, _)| n) == Some(*number);
            beside.next().is_some_and(|steps| steps.iter().all(same))
        })
        .collect()
}

/// Selects the points on flanks within these bands of height, mm, by the stages' pose (tool frame, mm). Tip and root lands are
/// excluded, because the stated form error applies to flanks.
fn within_bands(bands_mm: &[[f64; 2]], gear: &GearData, points: &[[f64; 3]]) -> Vec<bool> {
    let [low_mm, high_mm] = gear.active_flank_mm();
    let is_on = |&[x, y, z]: &[f64; 3]| {
        (low_mm..=high_mm).contains(&x.hypot(y))
            && bands_mm.iter().any(|[from, to]| (from..=to).contains(&&z))
    };
    points.iter().map(is_on).collect()
}

/// Why the pose is not determined by these bands: one of them has too few points of one side among those that the fit `used`.
pub(super) fn unseen(
    bands_mm: &[[f64; 2]],
    used: &[bool],
    places: &[Option<FlankPlace>],
) -> Option<Reason> {
    bands_mm.iter().find_map(|[from, to]| {
        Flank::BOTH.into_iter().find_map(|flank| {
            let is_there = |place: &FlankPlace| {
                place.flank == flank && (from..=to).contains(&&place.height_mm)
            };
            let on = used.iter().zip(places);
            let got = on
                .filter(|(used, place)| **used && place.as_ref().is_some_and(is_there))
                .count();
            let why = format_args!(
                "the datum from {from} to {to} mm of height shows {got} points of {flank} flanks, at least {LEAST_POINTS} are needed"
            );
            (got < LEAST_POINTS).then(|| Reason::instrument(Code::TooFewPoints, why))
        })
    })
}

/// Checks that a view from this place sees the tooth in its middle at all heights of these bands, mm.
///
/// # Errors
/// A band extends beyond the field.
pub(super) fn check_in_field(
    bands_mm: &[[f64; 2]],
    gear: &GearData,
    tooth: u32,
    tool_from_camera: Rigid<ToolFrame, Camera>,
    field: &FieldOfView,
) -> Result<(), EvaluatorError> {
    let [from, to] = gear.active_flank_mm();
    let camera_from_tool = tool_from_camera.isometry().inverse();
    let is_seen = |height_mm: f64| {
        Flank::BOTH.into_iter().all(|flank| {
            let point = gear.flank_point(tooth, flank, 0.5 * (from + to), height_mm);
            point.is_some_and(|point| {
                let at = camera_from_tool * Point3::from(point);
                at.x.hypot(at.y) <= field.slope * at.z
            })
        })
    };
    let [bottom, top] = gear.height_mm;
    let heights = (0..=((top - bottom) / STEP_MM) as u32).map(|i| bottom + STEP_MM * f64::from(i));
    let seen_mm = heights
        .filter(|&height| is_seen(height))
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], height| {
            [low.min(height), high.max(height)]
        });
    let outside = |[from, to]: &&[f64; 2]| !(is_seen(*from) && is_seen(*to));
    match bands_mm.iter().find(outside) {
        None => Ok(()),
        Some(&band_mm) => Err(EvaluatorError::DatumOutsideField {
            tooth,
            band_mm,
            seen_mm,
        }),
    }
}
