//! Deviation maps of a tooth's two flanks or of a patch: what a report draws.

use flankscope_metrology::feature::Features;
use flankscope_metrology::gear::{Flank, FlankPlace};
use flankscope_metrology::surface::Closest;
use flankscope_metrology::wear::Zone;

use flankscope_record::document::{FeatureId, FlankMap};

/// Cell of the maps, mm.
const CELL_MM: f64 = 0.1;

/// The maps of all sides of `tooth` in a zone, and the deviations in them, µm; `places` are the surface coordinates of `closest`.
pub(super) fn draw(
    features: Features<'_>,
    tooth: u32,
    zone: &Zone,
    closest: &[Closest],
    places: &[Option<FlankPlace>],
) -> (Vec<FlankMap>, Vec<f64>) {
    let sides = features.sides();
    let [from, to] = zone.radius_mm.map(|radius| features.along_mm(radius));
    let [low, high] = zone.height_mm;
    let size_mm = [to - from, high - low];
    let [columns, rows] = size_mm.map(|length| ((length / CELL_MM).ceil() as usize).clamp(1, 4096));
    let mut sums = vec![vec![(0.0_f64, 0_u32); columns * rows]; sides.len()];
    let mut deviations_um = Vec::new();
    for (hit, place) in closest.iter().zip(places) {
        let Some(at) = place.filter(|at| at.tooth == tooth) else {
            continue;
        };
        let along = (at.profile_mm - from) / size_mm[0];
        let down = (high - at.height_mm) / size_mm[1];
        if !(0.0..1.0).contains(&along) || !(0.0..1.0).contains(&down) {
            continue;
        }
        let cell = (down * rows as f64) as usize * columns + (along * columns as f64) as usize;
        let um = hit.signed_distance_mm * 1e3;
        // The left flank comes first; a patch has one side.
        let sum = &mut sums[usize::from(at.flank == Flank::Right)][cell];
        *sum = (sum.0 + um, sum.1 + 1);
        deviations_um.push(um);
    }
    // Middles of the cells from the map's upper left corner, as lengths along and up.
    let laid_out = (0..columns * rows).map(|cell| {
        let [across, down] = [cell % columns, cell / columns].map(|at| at as f64 + 0.5);
        [
            from + across / columns as f64 * size_mm[0],
            high - down / rows as f64 * size_mm[1],
        ]
    });
    let laid_out: Vec<[f64; 2]> = laid_out.collect();
    let maps = sides.iter().zip(sums).map(|(flank, sums)| FlankMap {
        middles_mm: laid_out
            .iter()
            .map(|&at| {
                features
                    .point_mm(tooth, *flank, at)
                    .unwrap_or([f64::NAN; 3])
            })
            .collect(),
        outward: features
            .outward(tooth, *flank, [0.5 * (from + to), 0.5 * (low + high)])
            .unwrap_or([0.0; 3]),
        id: FeatureId {
            tooth,
            flank: *flank,
            patch: features.patch(tooth).map(|patch| patch.name.clone()),
        },
        columns,
        rows,
        size_mm,
        deviation_um: sums
            .iter()
            .map(|&(sum, count)| sum / f64::from(count))
            .collect(),
    });
    (maps.collect(), deviations_um)
}
