//! Measured points on the article's reference points, seen along the axis (figures 16 and 17).

use std::collections::BTreeMap;

use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::registration::{ArticleOptions, ArticleReference};
use flankscope_metrology::surface::sampling::centre_of_mass;
use nalgebra::Isometry3;

use crate::drawn::{Drawn, laid};
use crate::method::ArticleSettings;

/// Thickness of the slice that is shown, mm: so many points that teeth are seen, and not more.
const SLICE_MM: f64 = 0.6;
/// Half of what is shown around, mm.
const HALF_WIDTH_MM: f64 = 7.0;

/// A slice of points across the axis.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// Views, each with its points: along the bore from the middle, and distance from the axis, mm.
    pub measured: Vec<(usize, Vec<[f64; 2]>)>,
    /// The reference points.
    pub reference: Vec<[f64; 2]>,
}

/// The first view alone, and the first `count` together; also the distances of the first view's points to the nearest reference
/// point of its window, µm.
pub(crate) fn overlays(
    views: &BTreeMap<usize, Drawn>,
    poses: &BTreeMap<usize, Isometry3<f64>>,
    mesh: &TriMesh,
    settings: &ArticleSettings,
    count: usize,
) -> (Vec<Overlay>, Vec<f64>) {
    let clouds: Vec<(usize, Vec<[f64; 3]>)> = poses
        .iter()
        .filter_map(|(&view, pose)| Some((view, laid(&views.get(&view)?.xyz, pose))))
        .take(count)
        .collect();
    let mut one_view_um = Vec::new();
    let mut found = Vec::new();
    for some in [&clouds[..clouds.len().min(1)], &clouds] {
        let Some((_, middle)) = some.get(some.len() / 2) else {
            continue;
        };
        let Some(centre) = centre_of_mass(middle) else {
            continue;
        };
        let options = ArticleOptions {
            seed: settings.registration.seed,
            ..settings.registration
        };
        let Some(reference) = ArticleReference::new(mesh, centre, &options) else {
            continue;
        };
        if found.is_empty() {
            let distances = reference.distances(middle, settings.order);
            one_view_um = distances.iter().map(|mm| mm * 1e3).collect();
        }
        let measured = some
            .iter()
            .map(|(view, cloud)| (*view, slice(cloud, centre)));
        found.push(Overlay {
            measured: measured.collect(),
            reference: slice(reference.points(), centre),
        });
    }
    (found, one_view_um)
}

/// The points within half a slice of the centre's height, unrolled about it.
fn slice(points: &[[f64; 3]], centre: [f64; 3]) -> Vec<[f64; 2]> {
    let radius_mm = centre[0].hypot(centre[1]);
    let (sin, cos) = centre[1].atan2(centre[0]).sin_cos();
    points
        .iter()
        .filter(|[_, _, z]| (z - centre[2]).abs() <= 0.5 * SLICE_MM)
        .map(|&[x, y, _]| {
            let off_rad = f64::atan2(y * cos - x * sin, x * cos + y * sin);
            [radius_mm * off_rad, x.hypot(y)]
        })
        .filter(|[along_mm, _]| along_mm.abs() <= HALF_WIDTH_MM)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slice_is_unrolled_about_its_middle_across_the_cut_of_the_angle() {
        let at = |angle_deg: f64, radius: f64, z: f64| {
            let angle = angle_deg.to_radians();
            [radius * angle.cos(), radius * angle.sin(), z]
        };
        let points = [
            at(179.0, 41.0, 10.2),
            at(-178.0, 42.0, 9.8),
            at(180.0, 41.0, 10.4),
            at(150.0, 41.0, 10.0),
        ];
        let found = slice(&points, at(180.0, 40.0, 10.0));
        let expected = [
            [-40.0 * 1f64.to_radians(), 41.0],
            [40.0 * 2f64.to_radians(), 42.0],
        ];
        assert_eq!(found.len(), 2);
        for (got, expected) in found.iter().zip(expected) {
            assert!((got[0] - expected[0]).abs() < 1e-9 && (got[1] - expected[1]).abs() < 1e-9);
        }
    }
}
