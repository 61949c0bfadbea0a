//! What stood in space: the toothing, the cameras, the first view before and after its initial transformation, and the final
//! cloud (figures 5, 10, 15 and 18).

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;

use flankscope_foundation::rigid::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::registration::ArticleOptions;
use flankscope_metrology::surface::sampling::{Region, centre_of_mass};
use nalgebra::Isometry3;
use serde::Serialize;

use crate::drawn::{Drawn, laid};

/// The initial transformation of the article's method: the pose that the registration of the first view starts at.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct InitialTransformation {
    pub view: usize,
    /// The pose, row by row: tool frame from camera frame, mm.
    pub tool_from_camera: [[f64; 4]; 4],
}

impl InitialTransformation {
    pub(crate) fn new(view: usize, pose: &Isometry3<f64>) -> Self {
        Self {
            view,
            tool_from_camera: Rigid::<ToolFrame, Camera>::from_isometry(*pose).to_rows(),
        }
    }
}

/// What the pictures in space show, in the tool frame, mm.
#[derive(Clone, Debug)]
pub struct InSpace {
    /// The part of the CAD that is nearer to the axis than the article's threshold.
    pub toothing: TriMesh,
    /// The part of that which the first view is laid on.
    pub window: TriMesh,
    /// Its middle.
    pub window_centre_mm: [f64; 3],
    /// Random reference points on it.
    pub window_points_mm: Vec<[f64; 3]>,
    /// Drawn points of the first view in its camera's frame.
    pub first_camera_mm: Vec<[f64; 3]>,
    /// The same at the initial transformation.
    pub first_start_mm: Vec<[f64; 3]>,
    /// Centre of projection of every view that the article's method laid, and the centre of what it saw.
    pub cameras_mm: Vec<[[f64; 3]; 2]>,
    /// Drawn points of all these views, each with its distance to the nearest reference point, µm.
    pub cloud: Vec<([f64; 3], f64)>,
}

/// Reference points that are shown: a share of the article's, so that single ones are seen.
const SHOWN_POINTS: usize = 4000;

impl InSpace {
    /// Of the views at the article's poses, the first of them from its initial transformation; `cloud` is all of their points with
    /// their distances. None when there is no such view, or no toothing where it was laid.
    pub(crate) fn of(
        mesh: &TriMesh,
        views: &BTreeMap<usize, Drawn>,
        poses: &BTreeMap<usize, Isometry3<f64>>,
        initial: &InitialTransformation,
        options: &ArticleOptions,
        cloud: Vec<([f64; 3], f64)>,
    ) -> Option<Self> {
        let (first, pose) = (views.get(&initial.view)?, poses.get(&initial.view)?);
        let region = &options.region;
        let toothing = within(mesh, region.radial_threshold_mm);
        let centre_mm = centre_of_mass(&laid(&first.xyz, pose))?;
        let start = Rigid::<ToolFrame, Camera>::from_rows(&initial.tool_from_camera).ok()?;
        let camera = |(view, pose): (&usize, &Isometry3<f64>)| {
            let place = pose.translation.vector.into();
            Some([place, centre_of_mass(&laid(&views.get(view)?.xyz, pose))?])
        };
        Some(Self {
            window: window(&toothing, centre_mm, region),
            window_centre_mm: centre_mm,
            window_points_mm: region
                .sample(centre_mm, mesh, SHOWN_POINTS, options.seed)
                .ok()?,
            first_start_mm: laid(&first.xyz, start.isometry()),
            first_camera_mm: first.xyz.clone(),
            cameras_mm: poses.iter().filter_map(camera).collect(),
            toothing,
            cloud,
        })
    }
}

/// The triangles of which every corner is nearer to the z axis than `radius_mm`.
fn within(mesh: &TriMesh, radius_mm: f64) -> TriMesh {
    let mut part = Part::default();
    for corners in (0..mesh.triangles.len()).map(|index| mesh.corners(index)) {
        if corners.iter().all(|[x, y, _]| x.hypot(*y) <= radius_mm) {
            part.add(&corners);
        }
    }
    part.0
}

/// The toothing cut at the ends of the article's window about `centre_mm`: its heights, and its angles where they are no half turn.
fn window(toothing: &TriMesh, centre_mm: [f64; 3], region: &Region) -> TriMesh {
    let towards = centre_mm[1].atan2(centre_mm[0]);
    // Inside is where `normal . p + offset` is positive.
    let mut planes = vec![
        ([0.0, 0.0, 1.0], region.half_height_mm - centre_mm[2]),
        ([0.0, 0.0, -1.0], region.half_height_mm + centre_mm[2]),
    ];
    if region.half_angle_rad < FRAC_PI_2 {
        let (sin, cos) = (towards - region.half_angle_rad).sin_cos();
        planes.push(([-sin, cos, 0.0], 0.0));
        let (sin, cos) = (towards + region.half_angle_rad).sin_cos();
        planes.push(([sin, -cos, 0.0], 0.0));
    }
    let near = region.part(centre_mm, toothing);
    let mut part = Part::default();
    for corners in (0..near.triangles.len()).map(|index| near.corners(index)) {
        let mut polygon = corners.to_vec();
        for (normal, offset) in &planes {
            polygon = cut(&polygon, |p| {
                (0..3).map(|k| normal[k] * p[k]).sum::<f64>() + offset
            });
        }
        part.add(&polygon);
    }
    part.0
}

/// What is left of a convex polygon where `height` is not negative (Sutherland and Hodgman 1974).
fn cut(polygon: &[[f64; 3]], height: impl Fn(&[f64; 3]) -> f64) -> Vec<[f64; 3]> {
    let mut left = Vec::with_capacity(polygon.len() + 1);
    for (at, to) in polygon.iter().enumerate() {
        let from = &polygon[(at + polygon.len() - 1) % polygon.len()];
        let (a, b) = (height(from), height(to));
        if (a < 0.0) != (b < 0.0) {
            let t = a / (a - b);
            left.push([0, 1, 2].map(|k| from[k] + t * (to[k] - from[k])));
        }
        if b >= 0.0 {
            left.push(*to);
        }
    }
    left
}

/// Polygons as triangles, each with corners of its own.
struct Part(TriMesh);

impl Default for Part {
    fn default() -> Self {
        Self(TriMesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        })
    }
}

impl Part {
    fn add(&mut self, polygon: &[[f64; 3]]) {
        let first = self.0.vertices.len() as u32;
        self.0.vertices.extend(polygon);
        let fan = 1..(polygon.len() as u32).saturating_sub(1);
        let triangles = fan.map(|k| [first, first + k, first + k + 1]);
        self.0.triangles.extend(triangles);
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use flankscope_metrology::surface::sampling::area_mm2;

    use super::*;

    /// A tube about the z axis of `facets` plane facets whose corners lie on `radius_mm`, two long triangles each.
    fn tube(facets: u32, radius_mm: f64, height_mm: [f64; 2]) -> TriMesh {
        let mut tube = Part::default();
        let corner = |at: u32, z: f64| {
            let (sin, cos) = (TAU * f64::from(at) / f64::from(facets)).sin_cos();
            [radius_mm * cos, radius_mm * sin, z]
        };
        let [low, high] = height_mm;
        for at in 0..facets {
            let [a, b] = [at, at + 1];
            tube.add(&[
                corner(b, low),
                corner(a, low),
                corner(a, high),
                corner(b, high),
            ]);
        }
        tube.0
    }

    #[test]
    fn a_window_is_cut_out_of_faces_that_are_longer_than_it() {
        let mut both = Part(tube(360, 40.0, [0.0, 60.0]));
        let outer = tube(360, 55.0, [0.0, 60.0]);
        for index in 0..outer.triangles.len() {
            both.add(&outer.corners(index));
        }
        let toothing = within(&both.0, 50.0);
        assert_eq!(toothing.triangles.len(), 720);
        // Across the cut of the angle.
        let region = Region::default();
        let centre_mm = [-40.0, 0.0, 8.0];
        let part = window(&toothing, centre_mm, &region);
        // 18 mm are left of its height; a facet's plane is as far from the axis as its middle.
        let width_mm = 40.0 * 0.4;
        let area = area_mm2(&part);
        assert!((area / (18.0 * width_mm) - 1.0).abs() < 1e-3, "{area}");
        for &[x, y, z] in &part.vertices {
            let off_rad = f64::atan2(-y, -x);
            assert!(off_rad.abs() < 0.2 + 1e-9 && (-1e-9..18.0 + 1e-9).contains(&z));
        }
        // Cut faces look where they looked: a bore's, inwards.
        for corners in (0..part.triangles.len()).map(|index| part.corners(index)) {
            let [u, v] = [1, 2].map(|of: usize| [0, 1, 2].map(|k| corners[of][k] - corners[0][k]));
            let across = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]];
            let outwards = across[0] * corners[0][0] + across[1] * corners[0][1];
            assert!(outwards < 1e-12, "{corners:?}");
        }
    }
}
