//! Rotational symmetry of a surface about the tool axis: its number of teeth.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use nalgebra::{Rotation3, Vector3};

use crate::io::mesh::TriMesh;
use crate::surface::Surface;
use flankscope_foundation::random::uniform;

/// Most teeth that are looked for.
const MOST_TEETH: u32 = 400;
const PROBES: u64 = 64;
/// Probes that may miss: a keyway or a slot repeats less often than the teeth.
const MOST_MISSES: usize = 6;

/// The largest n of at least 3 for which the flanks of the surface turned by 2 pi / n about z fall onto it within `tolerance_mm` at
/// nearly all of 64 probes; none when there is no such n. A body of revolution has no flanks and no teeth.
pub fn detect_teeth(mesh: &TriMesh, surface: &Surface, tolerance_mm: f64) -> Option<u32> {
    let probes = flank_probes(mesh)?;
    let fits = |angle: f64| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let is_off = |probe: &&Vector3<f64>| {
            let turned: [f64; 3] = (turn * **probe).into();
            surface.closest(turned).signed_distance_mm.abs() > tolerance_mm
        };
        probes.iter().filter(is_off).nth(MOST_MISSES).is_none()
    };
    // Irrational parts of a turn tell what repeats at any angle.
    if fits(0.123_456_7) && fits(0.765_432_1) {
        return None;
    }
    // A turn by one of 121 pitches differs from one of 120 by less than the tolerance, if teeth are small. Turns by many do not.
    let repeats = |&n: &u32| {
        [1, n / 3, n / 2]
            .iter()
            .all(|&pitches| fits(TAU * f64::from(pitches) / f64::from(n)))
    };
    (3..=MOST_TEETH).rev().find(repeats)
}

/// Middles of facets that face around the axis rather than to it or along it, drawn by area; none if there are none. Lands, bores and
/// end faces would fit any turn, or as many as they have facets.
fn flank_probes(mesh: &TriMesh) -> Option<Vec<Vector3<f64>>> {
    let mut total_mm2 = 0.0;
    let mut flanks: Vec<(f64, Vector3<f64>)> = Vec::new();
    for index in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(index).map(Vector3::from);
        let (middle, normal) = ((a + b + c) / 3.0, (b - a).cross(&(c - a)));
        let arm = middle.x * normal.y - middle.y * normal.x;
        let radius = middle.x.hypot(middle.y);
        if arm.abs() > FRAC_1_SQRT_2 * radius * normal.norm() {
            total_mm2 += 0.5 * normal.norm();
            flanks.push((total_mm2, middle));
        }
    }
    let probe = |number| {
        let at_mm2 = uniform(1, number) * total_mm2;
        let place = flanks.partition_point(|&(sum_mm2, _)| sum_mm2 <= at_mm2);
        flanks.get(place).map(|&(_, middle)| middle)
    };
    (0..PROBES).map(probe).collect()
}
