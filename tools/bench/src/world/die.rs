//! The real die: the CAD surface with its wear and form error.

use super::WorldError;
use super::die_mesh::DieMesh;
use super::form::Form;
use super::rays::RayCaster;
use super::refine::refine;
use super::wear::{FlankId, FlankZone, WearField};
use flankscope_gear_cad::{Flank, GearKind, GearSpec, Mesh};
use nalgebra::{Matrix2, Point3, Vector2, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Tolerance for the distance of flank vertices of another CAD kernel from the involute, mm.
const ON_INVOLUTE_MM: f64 = 0.01;
/// Largest distance of a flank's surface from its position in the drawing, mm.
const FLANK_REACH_MM: f64 = 1.0;
/// Range of coordinates that the ray caster supports, mm.
const MAX_COORDINATE_MM: f64 = 1000.0;

/// The die's real surface, with the feature of each triangle.
#[derive(Clone, Debug)]
pub struct Die {
    mesh: Mesh,
    source: Source,
    field: WearField,
    growth: f64,
}

/// Source of the surface.
#[derive(Clone, Debug)]
enum Source {
    /// The CAD, with the flank of every triangle.
    Cad(Vec<Option<FlankId>>),
    /// Any mesh, open or closed.
    Mesh { closed: bool },
}

impl Die {
    /// Applies `field` and `form` to a CAD mesh of its gear: any closed mesh whose flanks follow the gear data.
    pub fn as_built(cad: &Mesh, field: WearField, form: Form) -> Result<Self, WorldError> {
        check_mesh(cad)?;
        let gear = field.gear();
        let mut mesh = cad.clone();
        let mut flanks: Vec<Option<FlankId>> = mesh
            .triangles
            .iter()
            .map(|t| flank_of_facet(gear, t.map(|i| mesh.vertices[i as usize]), ON_INVOLUTE_MM))
            .collect();
        for id in field.worn_flanks() {
            if !flanks.contains(&Some(id)) {
                return Err(WorldError::FlankNotFound {
                    tooth: id.tooth,
                    flank: id.flank,
                    limit_mm: ON_INVOLUTE_MM,
                });
            }
            for zone in field.varying_zones(id) {
                let wanted = |of: FlankId, corners| of == id && meets(&field, &zone, corners);
                refine(&mut mesh, &mut flanks, zone.longest_mm, wanted);
            }
        }
        displace(&mut mesh, &flanks, &field);
        form.apply(&mut mesh, field.gear());
        Ok(Self {
            mesh,
            source: Source::Cad(flanks),
            field,
            growth: 1.0,
        })
    }

    /// A die that consists of `mesh`, with a form error. Its flanks are at the positions of `field`'s gear.
    pub fn standing(mesh: &DieMesh, field: WearField, form: Form) -> Self {
        let closed = mesh.is_closed();
        let mut mesh = mesh.mesh().clone();
        form.apply(&mut mesh, field.gear());
        Self {
            mesh,
            source: Source::Mesh { closed },
            field,
            growth: 1.0,
        }
    }

    /// Thermal growth: every point moves away from the axis and from z = 0 by this factor.
    pub(crate) fn grow(&mut self, growth: f64) {
        for x in self.mesh.vertices.iter_mut().flatten() {
            *x *= growth;
        }
        self.growth *= growth;
    }

    /// The surface in the tool frame, mm.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Flank that a triangle of [`Self::mesh`] belongs to; `None` on lands, roots, walls and ends, and for a mesh from a file,
    /// whose triangles are not assigned to flanks.
    pub fn flank(&self, triangle: usize) -> Option<FlankId> {
        match &self.source {
            Source::Cad(flanks) => flanks[triangle],
            Source::Mesh { .. } => None,
        }
    }

    /// Flank that a point of the surface belongs to: that of its triangle, or for a mesh from a file, the one at its position.
    pub(crate) fn flank_at(
        &self,
        triangle: usize,
        point: Point3<f64>,
        normal: Vector3<f64>,
    ) -> Option<FlankId> {
        match &self.source {
            Source::Cad(flanks) => flanks[triangle],
            Source::Mesh { .. } => {
                let gear = self.field.gear();
                let p = (point / self.growth).into();
                let (id, off_mm) = nearest_flank(gear, p)?;
                let radius = f64::hypot(p[0], p[1]);
                let from_land_mm = (radius - gear.tip_radius_mm)
                    .abs()
                    .min((radius - gear.root_radius_mm).abs());
                let [nx, ny] = gear.flank_normal(id.tooth, id.flank, radius);
                let parallel = normal.x * nx + normal.y * ny > std::f64::consts::FRAC_1_SQRT_2;
                let near = off_mm.abs() < from_land_mm;
                (off_mm.abs() <= FLANK_REACH_MM && (parallel || near)).then_some(id)
            }
        }
    }

    /// Whether the orientation of triangles does not define inside and outside.
    pub(crate) fn has_no_winding(&self) -> bool {
        matches!(self.source, Source::Mesh { .. })
    }

    /// Whether a viewpoint is inside the material of a die whose triangles have no defined orientation.
    pub(crate) fn encloses_eye(&self, rays: &RayCaster, eye: Point3<f64>) -> bool {
        matches!(self.source, Source::Mesh { closed: true }) && rays.encloses(eye)
    }

    /// Wear depth (positive: loss) at a point of the real surface that lies on `id`, mm.
    pub fn wear_at_mm(&self, id: FlankId, point: [f64; 3]) -> f64 {
        // The wear field is defined on the nominal flank: iterate along the normal until depth and foot point agree.
        let gear = self.field.gear();
        let point = point.map(|x| x / self.growth);
        if self.has_no_winding() {
            // Distance from the nominal flank itself.
            return nearest_flank(gear, point).map_or(0.0, |(_, off_mm)| -off_mm);
        }
        let mut depth = 0.0;
        for _ in 0..4 {
            let normal = gear.flank_normal(id.tooth, id.flank, point[0].hypot(point[1]));
            let foot = (point[0] + depth * normal[0]).hypot(point[1] + depth * normal[1]);
            depth = self.field.depth_mm(id, foot, point[2]);
        }
        depth
    }
}

pub(super) fn check_mesh(cad: &Mesh) -> Result<(), WorldError> {
    if cad.triangles.is_empty() {
        return Err(WorldError::EmptyMesh);
    }
    for (vertex, p) in cad.vertices.iter().enumerate() {
        for &got_mm in p {
            if !got_mm.is_finite() || got_mm.abs() > MAX_COORDINATE_MM {
                return Err(WorldError::Vertex {
                    vertex,
                    got_mm,
                    limit_mm: MAX_COORDINATE_MM,
                });
            }
        }
    }
    for (triangle, t) in cad.triangles.iter().enumerate() {
        for &got in t {
            if got as usize >= cad.vertices.len() {
                return Err(WorldError::Index {
                    triangle,
                    got,
                    vertices: cad.vertices.len(),
                });
            }
        }
    }
    Ok(())
}

/// The flank nearest in angle to a point, and its distance from that involute, mm. `None` outside the flank's radii.
pub(crate) fn nearest_flank(gear: &GearSpec, p: [f64; 3]) -> Option<(FlankId, f64)> {
    let radius = p[0].hypot(p[1]);
    let (a, b) = (gear.tip_radius_mm, gear.flank_root_radius_mm());
    if !(a.min(b) - ON_INVOLUTE_MM..=a.max(b) + ON_INVOLUTE_MM).contains(&radius) {
        return None;
    }
    let from_first = (p[1].atan2(p[0]) - gear.turned_rad).rem_euclid(std::f64::consts::TAU);
    let turns = from_first / gear.pitch_angle_rad();
    let tooth = (turns.floor() as u32).min(gear.teeth - 1) + 1;
    let from_centre = p[1].atan2(p[0]) - gear.tooth_centre_rad(tooth);
    let from_centre =
        from_centre - std::f64::consts::TAU * (from_centre / std::f64::consts::TAU).round();
    let flank = if from_centre >= 0.0 {
        Flank::Left
    } else {
        Flank::Right
    };
    // Normals of an involute are tangents of the base circle: an angle times the base radius is a distance along the normal.
    let outside_rad = from_centre.abs() - gear.tooth_half_angle_rad(radius);
    Some((
        FlankId { tooth, flank },
        gear.base_radius_mm() * outside_rad,
    ))
}

/// The flank that a facet of a drawing belongs to: its corners are close to the involute, and its normal is that of the flank.
pub(crate) fn flank_of_facet(
    gear: &GearSpec,
    corners: [[f64; 3]; 3],
    near_mm: f64,
) -> Option<FlankId> {
    let on = |p: [f64; 3]| {
        nearest_flank(gear, p)
            .filter(|(_, off)| off.abs() <= near_mm)
            .map(|(id, _)| id)
    };
    let id = on(corners[0])?;
    if on(corners[1])? != id || on(corners[2])? != id {
        return None;
    }
    // Triangles of the end faces may touch one flank with all corners.
    let [u, v] = [1, 2].map(|i| [0, 1, 2].map(|k| corners[i][k] - corners[0][k]));
    let normal = [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ];
    let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
    let middle: [f64; 2] = [0, 1].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / 3.0);
    let [nx, ny] = gear.flank_normal(id.tooth, id.flank, middle[0].hypot(middle[1]));
    (normal[0] * nx + normal[1] * ny > 0.95 * length).then_some(id)
}

/// Whether the bounding rectangle of a triangle on the flank overlaps a zone.
fn meets(field: &WearField, zone: &FlankZone, corners: [[f64; 3]; 3]) -> bool {
    let base = field.gear().base_radius_mm();
    let profiles = corners.map(|v| field.profile_mm(v[0].hypot(v[1]).max(base)));
    let overlaps = |values: [f64; 3], [low, high]: [f64; 2]| {
        values.iter().any(|v| *v <= high) && values.iter().any(|v| *v >= low)
    };
    overlaps(profiles, zone.profile_mm) && overlaps(corners.map(|v| v[2]), zone.height_mm)
}

/// Whether a point at this distance from the axis belongs to the toothing, rather than to the body's wall or bore.
pub(crate) fn in_toothing(gear: &GearSpec, radius_mm: f64) -> bool {
    let between_mm = 0.5 * (gear.root_radius_mm + gear.body_radius_mm);
    match gear.kind {
        GearKind::Internal => radius_mm < between_mm,
        GearKind::External => gear.body_radius_mm >= gear.root_radius_mm || radius_mm > between_mm,
    }
}

/// Moves every vertex of a worn flank along its normal by the local depth, and the toothing inwards by its uniform loss.
fn displace(mesh: &mut Mesh, flanks: &[Option<FlankId>], field: &WearField) {
    let ring_mm = field.ring_mm();
    let worn: BTreeSet<FlankId> = field.worn_flanks().into_iter().collect();
    let mut vertices: BTreeMap<FlankId, BTreeSet<u32>> = BTreeMap::new();
    for (triangle, flank) in mesh.triangles.iter().zip(flanks) {
        if let Some(id) = flank.filter(|id| worn.contains(id)) {
            vertices.entry(id).or_default().extend(triangle);
        }
    }
    let mut moves = if ring_mm > 0.0 {
        toothing_inwards(mesh, field.gear(), ring_mm)
    } else {
        BTreeMap::new()
    };
    for (id, of_flank) in vertices {
        for vertex in of_flank {
            let p = mesh.vertices[vertex as usize];
            let radius = p[0].hypot(p[1]);
            // The uniform loss of the toothing has moved the flank already.
            let depth = field.depth_mm(id, radius, p[2]) - ring_mm;
            let normal = Vector2::from(field.gear().flank_normal(id.tooth, id.flank, radius));
            *moves.entry(vertex).or_default() -= depth * normal;
        }
    }
    for (vertex, by) in moves {
        let p = &mut mesh.vertices[vertex as usize];
        p[0] += by.x;
        p[1] += by.y;
    }
}

/// Motion of the toothing's vertices if all its faces move into the material by `depth_mm`.
///
/// A vertex stays on all its faces: where flank and land meet, the edge moves along the bisector, farther than either face.
fn toothing_inwards(mesh: &Mesh, gear: &GearSpec, depth_mm: f64) -> BTreeMap<u32, Vector2<f64>> {
    /// Faces whose directions differ by less than about a thousandth count as one, because the motion across them is undetermined.
    const LEAST_RATIO: f64 = 1e-6;
    let mut faces: BTreeMap<u32, (Matrix2<f64>, Vector2<f64>)> = BTreeMap::new();
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| Vector3::from(mesh.vertices[v as usize]));
        let outside = |p: &Vector3<f64>| !in_toothing(gear, p.x.hypot(p.y));
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
            continue;
        };
        // End faces and the body do not move.
        if normal.z.abs() > 0.5 || [a, b, c].iter().any(outside) {
            continue;
        }
        let normal = normal.xy().normalize();
        for &vertex in t {
            let (squares, sum) = faces.entry(vertex).or_default();
            *squares += normal * normal.transpose();
            *sum += normal;
        }
    }
    let solve = |(squares, sum): (Matrix2<f64>, Vector2<f64>)| {
        let axes = squares.symmetric_eigen();
        let least = LEAST_RATIO * axes.eigenvalues.max();
        (0..2)
            .filter(|&i| axes.eigenvalues[i] > least)
            .map(|i| {
                let axis = axes.eigenvectors.column(i).into_owned();
                axis * (-depth_mm * axis.dot(&sum) / axes.eigenvalues[i])
            })
            .sum()
    };
    faces
        .into_iter()
        .map(|(vertex, face)| (vertex, solve(face)))
        .collect()
}
