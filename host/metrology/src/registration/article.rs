//! The article's registration, kept for comparison: point-to-point ICP to random points on CAD.
//!
//! The reference is an area-uniform cloud in a window about the view's centre of mass. Each step pairs every point with its
//! nearest reference point, keeps the nearest share of the pairs and moves by their best rigid motion. Its noise floor is
//! the spacing of the reference points; along an extrusion it settles wherever the random points pull it.

use nalgebra::Matrix6;
use rayon::prelude::*;

use super::pairs::{Pair, fit_pairs};
use super::{Registration, RegistrationFailure, Status};
use crate::deviation::{Order, SampleTree};
use crate::io::mesh::TriMesh;
use crate::surface::sampling::{Region, centre_of_mass};
use flankscope_foundation::rigid::{Cloud, Rigid, Tool};

/// The article's settings.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArticleOptions {
    /// Number of reference points in the window.
    pub samples: usize,
    /// Seed of the reference points.
    #[serde(skip_deserializing)]
    pub seed: u64,
    /// Window about the centre of mass.
    pub region: Region,
    /// Share of the pairs that count.
    pub inlier_ratio: f64,
    /// Most steps.
    pub most_iterations: usize,
    /// Converged when a step moves the centre of mass by less than this, mm ...
    pub translation_mm: f64,
    /// ... and turns by less than this, degrees.
    pub rotation_deg: f64,
    /// Least number of points.
    #[serde(skip_deserializing)]
    pub least_points: usize,
    /// Pairs must lie within this on average, mm.
    #[serde(skip_deserializing)]
    pub most_rms_mm: f64,
}

impl Default for ArticleOptions {
    fn default() -> Self {
        Self {
            samples: 100_000,
            seed: 0,
            region: Region::default(),
            inlier_ratio: 0.8,
            most_iterations: 25,
            translation_mm: 0.001,
            rotation_deg: 0.005,
            least_points: 100,
            most_rms_mm: 0.15,
        }
    }
}

/// Random CAD points in the window about a view.
pub struct ArticleReference {
    points: Vec<[f64; 3]>,
    tree: SampleTree,
}

impl ArticleReference {
    /// Draws the points in the window about `centre` (tool coordinates, mm); none when no surface is there.
    pub fn new(mesh: &TriMesh, centre: [f64; 3], options: &ArticleOptions) -> Option<Self> {
        let region = &options.region;
        let points = region.sample(centre, mesh, options.samples, options.seed);
        Self::of_points(points.ok()?)
    }

    /// Points that were measured, tool coordinates, mm; none when there are none.
    pub fn of_points(points: Vec<[f64; 3]>) -> Option<Self> {
        let tree = SampleTree::new(&points).ok()?;
        Some(Self { points, tree })
    }

    /// The points, tool coordinates, mm.
    pub fn points(&self) -> &[[f64; 3]] {
        &self.points
    }

    /// Distance of every point (tool coordinates, mm) to the nearest of them, mm.
    pub fn distances(&self, points: &[[f64; 3]], order: Order) -> Vec<f64> {
        self.tree.distances(points, order)
    }

    /// Pairs of a cloud at a pose with their nearest reference points: the nearest `kept` of them, in the cloud's order.
    fn pairs(&self, points: &[[f64; 3]], pose: &Rigid<Tool, Cloud>, kept: usize) -> Vec<Pair> {
        let mut pairs: Vec<(f64, u32, Pair)> = points
            .par_iter()
            .with_min_len(1024)
            .enumerate()
            .map(|(index, point)| {
                let (nearest, distance2) = self.tree.nearest(&pose.apply(*point));
                (distance2, index as u32, (*point, self.points[nearest]))
            })
            .collect();
        // The index breaks ties, so that the same pairs are kept on every run.
        pairs.select_nth_unstable_by(kept - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        pairs.truncate(kept);
        pairs.sort_unstable_by_key(|pair| pair.1);
        pairs.into_iter().map(|pair| pair.2).collect()
    }
}

/// Lays finite `points` (mm) on random points of the mesh as the article does. Returns these points too, unless nothing of
/// the mesh is where the cloud starts.
pub fn register_by_article(
    mesh: &TriMesh,
    points: &[[f64; 3]],
    initial: &Rigid<Tool, Cloud>,
    options: &ArticleOptions,
) -> (Registration, Option<ArticleReference>) {
    let centre = match centre_at(points, initial, options) {
        Ok(centre) => centre,
        Err(too_few) => return (Registration::refused(*initial, too_few), None),
    };
    match ArticleReference::new(mesh, centre, options) {
        None => {
            let nothing_there = RegistrationFailure::Disjoint {
                ratio: 0.0,
                least_ratio: options.inlier_ratio,
                capture_mm: options.region.half_height_mm,
            };
            (Registration::refused(*initial, nothing_there), None)
        }
        Some(reference) => {
            let found = settle(&reference, points, initial, centre, options);
            (found, Some(reference))
        }
    }
}

/// Lays finite `points` (mm) on other points as [`register_by_article`] does on random ones.
pub fn register_to_reference(
    reference: &ArticleReference,
    points: &[[f64; 3]],
    initial: &Rigid<Tool, Cloud>,
    options: &ArticleOptions,
) -> Registration {
    match centre_at(points, initial, options) {
        Ok(centre) => settle(reference, points, initial, centre, options),
        Err(too_few) => Registration::refused(*initial, too_few),
    }
}

/// Centre of mass of the points at a pose, tool coordinates, mm.
fn centre_at(
    points: &[[f64; 3]],
    pose: &Rigid<Tool, Cloud>,
    options: &ArticleOptions,
) -> Result<[f64; 3], RegistrationFailure> {
    let moved: Vec<[f64; 3]> = points.iter().map(|&p| pose.apply(p)).collect();
    let centre = centre_of_mass(&moved).filter(|_| points.len() >= options.least_points);
    centre.ok_or(RegistrationFailure::TooFewPoints {
        points: points.len(),
        least: options.least_points,
    })
}

/// Point-to-point ICP from a pose.
fn settle(
    reference: &ArticleReference,
    points: &[[f64; 3]],
    initial: &Rigid<Tool, Cloud>,
    centre: [f64; 3],
    options: &ArticleOptions,
) -> Registration {
    let not_begun = RegistrationFailure::Disjoint {
        ratio: 0.0,
        least_ratio: options.inlier_ratio,
        capture_mm: options.region.half_height_mm,
    };
    let mut result = Registration::refused(*initial, not_begun);
    let kept = ((points.len() as f64 * options.inlier_ratio) as usize).max(3);
    let mut pose = result.tool_from_cloud;
    for iteration in 1..=options.most_iterations {
        let chosen = reference.pairs(points, &pose, kept);
        let Ok(next) = fit_pairs(&chosen) else {
            break;
        };
        let moved = next.isometry() * pose.isometry().inverse();
        let shift = moved * nalgebra::Point3::from(centre) - nalgebra::Point3::from(centre);
        pose = next;
        result.tool_from_cloud = pose;
        result.iterations = iteration;
        result.inliers = kept;
        result.rms_mm = super::pairs_rms(&chosen, &pose);
        result.converged = shift.norm() < options.translation_mm
            && moved.rotation.angle().to_degrees() < options.rotation_deg;
        if result.converged {
            break;
        }
    }
    result.noise_mm = result.rms_mm;
    result.centre_mm = centre;
    // Point-to-point residuals do not show which directions are observable, so no covariance is stated.
    result.covariance = Matrix6::identity();
    result.status = if result.rms_mm <= options.most_rms_mm {
        Status::Registered
    } else {
        Status::Indeterminate(RegistrationFailure::TooFewInliers {
            inliers: 0,
            points: points.len(),
            reach_mm: options.most_rms_mm,
            least_ratio: options.inlier_ratio,
        })
    };
    result
}
