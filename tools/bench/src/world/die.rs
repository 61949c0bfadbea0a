//! The die as it is: the CAD surface with its wear and its form.

use super::WorldError;
use super::form::Form;
use super::refine::refine;
use super::wear::{FlankId, FlankZone, WearField};
use flankscope_gear_cad::{Flank, GearSpec, Mesh};
use std::collections::BTreeSet;

/// Longest edge of the mesh where wear varies, mm: a pit of 1 mm2 and 80 um is then nowhere 0.2 um shallower than its shape.
const WORN_EDGE_MM: f64 = 0.035;
/// A vertex of a foreign CAD kernel's flank lies within this of the involute, mm.
const ON_INVOLUTE_MM: f64 = 0.01;
/// Coordinates the ray caster is made for, mm.
const MAX_COORDINATE_MM: f64 = 1000.0;

/// The die's real surface and what each triangle belongs to.
#[derive(Clone, Debug)]
pub struct Die {
    mesh: Mesh,
    flanks: Vec<Option<FlankId>>,
    field: WearField,
    growth: f64,
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
            .map(|t| flank_of_triangle(gear, t.map(|i| mesh.vertices[i as usize])))
            .collect();
        for id in field.worn_flanks() {
            if !flanks.contains(&Some(id)) {
                return Err(WorldError::FlankNotFound {
                    tooth: id.tooth,
                    flank: id.flank,
                    limit_mm: ON_INVOLUTE_MM,
                });
            }
            let zones = field.varying_zones(id);
            let wanted = |of: FlankId, corners| {
                of == id && zones.iter().any(|zone| meets(&field, zone, corners))
            };
            refine(&mut mesh, &mut flanks, WORN_EDGE_MM, wanted);
        }
        for id in field.worn_flanks() {
            displace(&mut mesh, &flanks, &field, id);
        }
        form.apply(&mut mesh, field.gear());
        Ok(Self {
            mesh,
            flanks,
            field,
            growth: 1.0,
        })
    }

    /// Warms the die: every point moves away from the axis and from z = 0 by this factor.
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

    /// Flank that a triangle of [`Self::mesh`] belongs to; `None` on lands, roots, walls and ends.
    pub fn flank(&self, triangle: usize) -> Option<FlankId> {
        self.flanks[triangle]
    }

    /// Wear depth (positive: loss) at a point of the real surface that lies on `id`, mm.
    pub fn wear_at_mm(&self, id: FlankId, point: [f64; 3]) -> f64 {
        // The field is defined on the nominal flank: walk back along the normal until depth and foot agree.
        let gear = self.field.gear();
        let point = point.map(|x| x / self.growth);
        let mut depth = 0.0;
        for _ in 0..4 {
            let normal = gear.flank_normal(id.tooth, id.flank, point[0].hypot(point[1]));
            let foot = (point[0] + depth * normal[0]).hypot(point[1] + depth * normal[1]);
            depth = self.field.depth_mm(id, foot, point[2]);
        }
        depth
    }
}

fn check_mesh(cad: &Mesh) -> Result<(), WorldError> {
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
    let turns = p[1].atan2(p[0]).rem_euclid(std::f64::consts::TAU) / gear.pitch_angle_rad();
    let tooth = (turns.floor() as u32).min(gear.teeth - 1) + 1;
    let from_centre = p[1].atan2(p[0]) - gear.tooth_centre_rad(tooth);
    let from_centre =
        from_centre - std::f64::consts::TAU * (from_centre / std::f64::consts::TAU).round();
    let flank = if from_centre >= 0.0 {
        Flank::Left
    } else {
        Flank::Right
    };
    // Normals of an involute are tangents of the base circle: an angle times the base radius is a normal distance.
    let outside_rad = from_centre.abs() - gear.tooth_half_angle_rad(radius);
    Some((
        FlankId { tooth, flank },
        gear.base_radius_mm() * outside_rad,
    ))
}

fn flank_of_triangle(gear: &GearSpec, corners: [[f64; 3]; 3]) -> Option<FlankId> {
    let on = |p: [f64; 3]| {
        nearest_flank(gear, p)
            .filter(|(_, off)| off.abs() <= ON_INVOLUTE_MM)
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

/// Moves the vertices of one worn flank along its normal by the depth at each.
fn displace(mesh: &mut Mesh, flanks: &[Option<FlankId>], field: &WearField, id: FlankId) {
    let of_flank = mesh
        .triangles
        .iter()
        .zip(flanks)
        .filter(|(_, flank)| **flank == Some(id));
    let vertices: BTreeSet<u32> = of_flank.flat_map(|(t, _)| *t).collect();
    for vertex in vertices {
        let p = &mut mesh.vertices[vertex as usize];
        let radius = p[0].hypot(p[1]);
        let depth = field.depth_mm(id, radius, p[2]);
        let [nx, ny] = field.gear().flank_normal(id.tooth, id.flank, radius);
        p[0] -= depth * nx;
        p[1] -= depth * ny;
    }
}
