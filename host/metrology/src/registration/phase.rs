//! A first pose on a toothing, when it is only known to about half a tooth.

use flankscope_foundation::rigid::{Cloud, Rigid, Tool};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use crate::surface::Surface;

/// Places tried around one tooth.
const PHASES: usize = 32;
/// Places tried towards and away from the axis, on each side, and their distance, mm.
const RADIAL_STEPS: i32 = 4;
const RADIAL_MM: f64 = 0.3;
/// Points that vote.
const VOTERS: usize = 600;
/// Share of them that lie best and are counted.
const TRIMMED: f64 = 0.8;

/// The best of the poses up to half a tooth about the z axis and 1.2 mm radially from `start` (tool frame from the frame of
/// the points): the one with the least trimmed mean distance. Whether another tooth would do as well is for the
/// registration that follows to say: it knows how far a rival is.
pub fn search_phase(
    surface: &Surface,
    points: &[[f64; 3]],
    start: &Rigid<Tool, Cloud>,
    teeth: u32,
) -> Rigid<Tool, Cloud> {
    let step = points.len().div_ceil(VOTERS).max(1);
    let voters: Vec<Point3<f64>> = points
        .iter()
        .step_by(step)
        .map(|&p| start.isometry() * Point3::from(p))
        .collect();
    let sum: Vector3<f64> = voters.iter().map(|p| p.coords).sum();
    let outwards = Vector3::new(sum.x, sum.y, 0.0)
        .try_normalize(0.0)
        .unwrap_or_else(Vector3::zeros);
    let pitch_rad = std::f64::consts::TAU / f64::from(teeth.max(1));
    let moves: Vec<Isometry3<f64>> = (0..PHASES)
        .flat_map(|phase| (-RADIAL_STEPS..=RADIAL_STEPS).map(move |radial| (phase, radial)))
        .map(|(phase, radial)| {
            let share = phase as f64 / PHASES as f64 - 0.5;
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), share * pitch_rad);
            turn * Translation3::from(outwards * (f64::from(radial) * RADIAL_MM))
        })
        .collect();
    let scores: Vec<f64> = moves
        .par_iter()
        .map(|motion| {
            let mut off: Vec<f64> = voters
                .iter()
                .map(|p| {
                    surface
                        .closest((motion * p).into())
                        .signed_distance_mm
                        .abs()
                })
                .collect();
            off.sort_unstable_by(f64::total_cmp);
            let best = (TRIMMED * off.len() as f64) as usize;
            off[..best].iter().sum()
        })
        .collect();
    let best = scores
        .iter()
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(b.1))
        .and_then(|(i, _)| moves.get(i));
    best.map_or(*start, |motion| {
        Rigid::from_isometry(motion * start.isometry())
    })
}
