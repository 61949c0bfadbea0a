//! Points that lie inside a patch's datum.

use flankscope_metrology::patch::Patches;
use flankscope_metrology::surface::Closest;
use nalgebra::Vector3;

use super::place::Place;

/// Points so near to the rim of a datum are left out, mm. Where the pose is off, their nearest surface lies beyond the edge: they
/// would hold the view along a plane, which no point of a plane can, and as badly as an edge is known.
const RIM_MM: f64 = 0.15;

/// Of points where the stages say that they are (tool frame, mm), those inside the datum of the place's patch.
pub(super) fn within(patches: &Patches, place: &Place, points: &[[f64; 3]]) -> Vec<bool> {
    let judged = patches.get(place.tooth);
    let closest = place.surface.closest_many(points);
    let on = closest.iter().map(|at| {
        let (number, patch) = patches.at(at.triangle, at.point)?;
        judged?.rests_on(number).then_some((number, patch, at))
    });
    let on: Vec<_> = on.collect();
    // A step to every side is still on it.
    let steps = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let probes: Vec<[f64; 3]> = on
        .iter()
        .flatten()
        .flat_map(|(_, patch, at)| {
            let [along, up] = [0, 1].map(|k| Vector3::from(patch.axes[k]));
            steps.map(|[a, u]| (Vector3::from(at.point) + RIM_MM * (along * a + up * u)).into())
        })
        .collect();
    let beside = place.surface.closest_many(&probes);
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
