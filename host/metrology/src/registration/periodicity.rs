//! Rotational symmetry of a surface about the tool axis: its number of teeth.

use flankscope_foundation::order::median;
use nalgebra::{Rotation3, Vector3};

use crate::gear::GearKind;
use crate::io::mesh::TriMesh;
use crate::surface::Surface;
use flankscope_foundation::random::uniform;

/// Most teeth that are looked for.
const MOST_TEETH: u32 = 400;
const PROBES: u64 = 64;

/// The largest n of at least 3 for which the surface turned by 2 pi / n about z falls onto itself within `tolerance_mm`
/// everywhere at 64 probes; none when there is no such n. A body of revolution repeats at any angle and has no teeth: none.
/// `kind` says on which side of the body teeth are looked for.
pub fn detect_teeth(
    mesh: &TriMesh,
    surface: &Surface,
    tolerance_mm: f64,
    kind: GearKind,
) -> Option<u32> {
    let probes = toothed_probes(mesh, kind);
    let fits = |angle: f64| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        probes.iter().all(|&probe| {
            let turned: [f64; 3] = (turn * Vector3::from(probe)).into();
            surface.closest(turned).signed_distance_mm.abs() <= tolerance_mm
        })
    };
    // Irrational parts of a turn tell a body of revolution.
    if fits(0.123_456_7) && fits(0.765_432_1) {
        return None;
    }
    (3..=MOST_TEETH)
        .rev()
        .find(|&n| fits(std::f64::consts::TAU / f64::from(n)))
}

/// Corner points spread over the half of the mesh's corners that the teeth are in: the one nearer to the axis of an internal
/// gear, the other one of an external gear. The body's wall would fit any turn, or as many as it has facets.
fn toothed_probes(mesh: &TriMesh, kind: GearKind) -> Vec<[f64; 3]> {
    let radius = |v: &[f64; 3]| v[0].hypot(v[1]);
    let mut radii: Vec<f64> = mesh.vertices.iter().map(radius).collect();
    let middle = median(&mut radii).unwrap_or(0.0);
    let toothed: Vec<[f64; 3]> = mesh
        .vertices
        .iter()
        .filter(|v| match kind {
            GearKind::Internal => radius(v) <= middle,
            GearKind::External => radius(v) >= middle,
        })
        .copied()
        .collect();
    (0..PROBES)
        .map(|i| toothed[(uniform(1, i) * toothed.len() as f64) as usize])
        .collect()
}
