//! Point-to-triangle registration: Levenberg-Marquardt on rigid motions with Welsch weights, from coarse to fine.

use std::borrow::Cow;

use flankscope_foundation::order::{SIGMA_PER_MAD, median};
use nalgebra::{
    Isometry3, Matrix6, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6,
};
use rayon::prelude::*;

use super::observe::Observability;
use super::prior::ScaledPrior;
use super::{Options, Registration, RegistrationFailure, RegistrationTarget, Status};
use crate::space::morton::along_curve;
use crate::surface::CHUNK;
use flankscope_foundation::random::uniform;
use flankscope_foundation::rigid::Rigid;

/// Points per level; the last level takes all.
const LEVELS: [usize; 2] = [1_000, 10_000];
/// Steps below this part of a point's noise end the last level; earlier levels end fifty times sooner.
const STEP_PER_NOISE: f64 = 1e-3;
/// From this damping on no step is long enough to lower the cost: it is at its minimum but for kinks between facets.
const STALLED: f64 = 1e4;
/// Steps up to this together are taken on the last closest points. A facet of 0.1 mm loses 2 % of its points to its neighbour
/// by that, whose plane differs by a degree or so: less than 1 nm in the mean.
const LINEAR_MM: f64 = 2e-3;
/// Noise is not taken for less than this, so that perfect data do not divide by zero.
const LEAST_NOISE_MM: f64 = 1e-6;
/// Largest Mahalanobis distance from the prior: for six normal variables it is exceeded once in a million.
const MOST_PRIOR_DISTANCE: f64 = 6.2;
/// A pose must be clearly nearer to the start than its rival one pitch on.
const RIVAL_RATIO: f64 = 0.6;

/// Lays `points` (mm) on a surface, or on another cloud. `sigma_mm` is the standard uncertainty of each point, where known;
/// otherwise all points count the same and the noise is estimated from the residuals.
///
/// The same input gives the same bytes on any number of threads.
pub fn register<R: RegistrationTarget>(
    reference: &R,
    points: &[[f64; 3]],
    sigma_mm: Option<&[f32]>,
    options: &Options,
) -> Registration {
    match FitProblem::new(reference, points, sigma_mm, options) {
        Ok(problem) => problem.solve(),
        Err(reason) => Registration::refused(options.initial, reason),
    }
}

struct FitProblem<'a, R> {
    reference: &'a R,
    /// Neighbours follow each other.
    points: Cow<'a, [[f64; 3]]>,
    sigma_mm: Option<Cow<'a, [f32]>>,
    options: &'a Options,
    centre: Vector3<f64>,
    arm: f64,
    /// Mean inverse variance of the points, 1/mm2; 1 when none is stated.
    mean_weight: f64,
    prior: Option<ScaledPrior>,
}

/// One point laid on the surface: place in tool coordinates relative to the centre, normal, signed distance.
#[derive(Clone, Copy)]
struct FitSample {
    arm: Vector3<f64>,
    normal: Vector3<f64>,
    distance: f64,
    /// Inverse variance relative to the common noise; 0 for points that take no part.
    weight: f64,
}

impl FitSample {
    const UNSET: Self = Self {
        arm: Vector3::new(0.0, 0.0, 0.0),
        normal: Vector3::new(0.0, 0.0, 0.0),
        distance: 0.0,
        weight: 0.0,
    };
}

/// A level's view of the cloud: which points, and the current fit.
struct Fit {
    pose: Isometry3<f64>,
    samples: Vec<FitSample>,
    noise: f64,
    /// Small steps taken together since the points were laid on the surface, in scaled variables.
    since: Vector6<f64>,
}

impl Fit {
    /// The sample's row of the design matrix: how its distance grows with each of the scaled variables.
    #[inline(always)]
    fn row(sample: &FitSample, inverse_arm: f64) -> [f64; 6] {
        let turn = sample.arm.cross(&sample.normal) * inverse_arm;
        let n = sample.normal;
        [turn.x, turn.y, turn.z, n.x, n.y, n.z]
    }

    /// The sample's distance after the small steps: every point keeps its normal.
    #[inline(always)]
    fn distance(&self, sample: &FitSample, row: &[f64; 6]) -> f64 {
        let mut distance = sample.distance;
        for (row, since) in row.iter().zip(self.since.iter()) {
            distance += row * since;
        }
        distance
    }
}

impl<'a, R: RegistrationTarget> FitProblem<'a, R> {
    fn new(
        reference: &'a R,
        points: &'a [[f64; 3]],
        sigma_mm: Option<&'a [f32]>,
        options: &'a Options,
    ) -> Result<Self, RegistrationFailure> {
        if points.len() < options.least_points.max(6) {
            return Err(RegistrationFailure::TooFewPoints {
                points: points.len(),
                least: options.least_points.max(6),
            });
        }
        if let Some(sigmas) = sigma_mm
            && sigmas.len() != points.len()
        {
            return Err(RegistrationFailure::SigmaCount {
                sigmas: sigmas.len(),
                points: points.len(),
            });
        }
        let bad_point = points.iter().position(|p| p.iter().any(|c| !c.is_finite()));
        let bad_sigma = sigma_mm.and_then(|s| s.iter().position(|s| !(s.is_finite() && *s > 0.0)));
        if let Some(index) = bad_point.or(bad_sigma) {
            return Err(RegistrationFailure::NotFinite { index });
        }
        let pose = options.initial.isometry();
        let n = points.len() as f64;
        let mean: Vector3<f64> = points
            .iter()
            .map(|&p| Vector3::from(p))
            .sum::<Vector3<f64>>()
            / n;
        let spread: f64 = points
            .iter()
            .map(|&p| (Vector3::from(p) - mean).norm_squared())
            .sum();
        let centre = (pose * Point3::from(mean)).coords;
        let arm = (spread / n).sqrt().max(1e-6);
        let prior = match &options.prior {
            None => None,
            Some(prior) => Some(
                prior
                    .scaled(centre, arm)
                    .ok_or(RegistrationFailure::BadPrior)?,
            ),
        };
        let mean_weight = sigma_mm.map_or(1.0, |sigmas| {
            sigmas.iter().map(|s| f64::from(*s).powi(-2)).sum::<f64>() / n
        });
        let (points, sigma_mm) = match along_curve(points) {
            None => (points.into(), sigma_mm.map(Cow::from)),
            Some(order) => {
                let along = order.iter().map(|&i| points[i as usize]);
                let sigmas =
                    sigma_mm.map(|sigmas| order.iter().map(|&i| sigmas[i as usize]).collect());
                (along.collect(), sigmas)
            }
        };
        Ok(Self {
            reference,
            points,
            sigma_mm,
            options,
            centre,
            arm,
            mean_weight,
            prior,
        })
    }

    fn solve(&self) -> Registration {
        let mut pose = *self.options.initial.isometry();
        let mut iterations = 0;
        let mut last_step = f64::INFINITY;
        let mut settled = false;
        let mut reach = f64::INFINITY;
        let sizes = LEVELS
            .into_iter()
            .filter(|&size| size < self.points.len())
            .chain([self.points.len()]);
        let mut fit = None;
        for size in sizes {
            let subset = self.subset(size);
            let mut current = self.lay(&subset, pose);
            if fit.is_none()
                && let Some(reason) = self.disjoint(&current.samples)
            {
                return Registration::refused(self.options.initial, reason);
            }
            let last_mm = self.step_limit_mm();
            let limit = if size == self.points.len() {
                last_mm
            } else {
                50.0 * last_mm
            };
            let mut damping = 0.0;
            settled = false;
            for _ in 0..self.options.most_iterations {
                // The weights' reach shrinks by at most half per step, so that early steps still see everything.
                reach = f64::max(0.5 * reach.min(6.0 * current.noise), 3.0 * current.noise);
                // Far from the solution the residuals do not estimate the noise.
                let noise = current.noise.min(self.options.noise_mm);
                let step = self.step(&current, reach, noise, damping);
                iterations += 1;
                last_step = step.norm();
                // Only a full step may end the search: a damped one is short for another reason.
                if damping > 0.0 && last_step < limit {
                    last_step = self.step(&current, reach, noise, 0.0).norm();
                    settled = damping >= STALLED && last_step < self.options.observed_mm;
                }
                settled |= last_step < limit;
                let pose = self.moved(&current.pose, &step);
                let better = if (current.since + step).norm() < LINEAR_MM {
                    current.since += step;
                    current.pose = pose;
                    true
                } else {
                    let moved = self.lay(&subset, pose);
                    let better = self.cost_change(&current, &moved, reach, noise) <= 0.0;
                    if better || settled {
                        current = moved;
                    }
                    better
                };
                if settled {
                    break;
                }
                damping = match better {
                    true if damping < 1e-3 => 0.0,
                    true => 0.1 * damping,
                    false => f64::max(10.0 * damping, 0.1),
                };
            }
            pose = current.pose;
            fit = Some(current);
        }
        match fit {
            Some(fit) => self.report(fit, iterations, last_step, settled),
            // There is always the level of all points.
            None => Registration::refused(
                self.options.initial,
                RegistrationFailure::TooFewPoints {
                    points: 0,
                    least: self.options.least_points,
                },
            ),
        }
    }

    /// `size` of the points, spread evenly over the cloud's order with a fixed jitter against regular scan patterns.
    fn subset(&self, size: usize) -> Vec<u32> {
        let n = self.points.len();
        if size >= n {
            return (0..n as u32).collect();
        }
        let stride = n as f64 / size as f64;
        (0..size)
            .map(|i| ((i as f64 + uniform(0, i as u64)) * stride) as usize)
            .map(|i| i.min(n - 1) as u32)
            .collect()
    }

    /// Lays the subset on the surface under `pose`.
    fn lay(&self, subset: &[u32], pose: Isometry3<f64>) -> Fit {
        let rotation: Rotation3<f64> = pose.rotation.to_rotation_matrix();
        let shift = pose.translation.vector - self.centre;
        let mut samples = vec![FitSample::UNSET; subset.len()];
        samples
            .par_chunks_mut(CHUNK)
            .zip(subset.par_chunks(CHUNK))
            .for_each(|(samples, indices)| {
                let mut there = [[0.0; 3]; CHUNK];
                let there = &mut there[..indices.len()];
                for ((sample, there), &index) in samples.iter_mut().zip(&mut *there).zip(indices) {
                    sample.weight = self.weight(index) / self.mean_weight;
                    sample.arm = rotation * Vector3::from(self.points[index as usize]) + shift;
                    *there = (sample.arm + self.centre).into();
                }
                self.reference.each_foot(there, samples, |foot, sample| {
                    sample.normal = Vector3::from(foot.normal);
                    sample.distance = foot.signed_distance_mm;
                    let takes_part =
                        foot.smooth && sample.distance.abs() <= self.options.capture_mm;
                    if !takes_part {
                        sample.weight = 0.0;
                    }
                });
            });
        let noise = robust_noise(&samples);
        Fit {
            pose,
            samples,
            noise,
            since: Vector6::zeros(),
        }
    }

    fn step_limit_mm(&self) -> f64 {
        STEP_PER_NOISE * self.options.noise_mm
    }

    fn weight(&self, index: u32) -> f64 {
        self.sigma_mm
            .as_ref()
            .map_or(1.0, |sigmas| f64::from(sigmas[index as usize]).powi(-2))
    }

    fn disjoint(&self, samples: &[FitSample]) -> Option<RegistrationFailure> {
        let near = samples
            .iter()
            .filter(|s| s.distance.abs() <= self.options.capture_mm)
            .count();
        let ratio = near as f64 / samples.len() as f64;
        (ratio < self.options.least_inlier_ratio).then_some(RegistrationFailure::Disjoint {
            ratio,
            least_ratio: self.options.least_inlier_ratio,
            capture_mm: self.options.capture_mm,
        })
    }

    /// Information and gradient of the whole cloud (a subset stands for all points), in units of the given noise.
    fn normal_equations(&self, fit: &Fit, reach: f64, noise: f64) -> (Matrix6<f64>, Vector6<f64>) {
        let inverse_arm = 1.0 / self.arm;
        // Only the lower triangle is summed: 21 products per point.
        let parts: Vec<([f64; 21], [f64; 6])> = fit
            .samples
            .par_chunks(4 * CHUNK)
            .map(|chunk| {
                let mut information = [0.0; 21];
                let mut gradient = [0.0; 6];
                for sample in chunk.iter().filter(|s| s.weight > 0.0) {
                    let row = Fit::row(sample, inverse_arm);
                    let distance = fit.distance(sample, &row);
                    let x = distance / reach;
                    let weight = sample.weight * (-0.5 * x * x).exp();
                    let mut at = 0;
                    for i in 0..6 {
                        let weighted = weight * row[i];
                        gradient[i] += weighted * distance;
                        for &other in &row[..=i] {
                            information[at] += weighted * other;
                            at += 1;
                        }
                    }
                }
                (information, gradient)
            })
            .collect();
        let scale = self.points.len() as f64
            / fit.samples.len() as f64
            / (noise * noise * self.options.correlated_points);
        let mut information = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for (h, g) in parts {
            let mut at = 0;
            for i in 0..6 {
                gradient[i] += g[i];
                for j in 0..=i {
                    information[(i, j)] += h[at];
                    at += 1;
                }
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        (information * scale, gradient * scale)
    }

    fn step(&self, fit: &Fit, reach: f64, noise: f64, damping: f64) -> Vector6<f64> {
        let (mut information, mut gradient) = self.normal_equations(fit, reach, noise);
        if let Some(prior) = &self.prior {
            information += prior.information();
            gradient += prior.gradient(&fit.pose);
        }
        Observability::new(&information).step(&gradient, damping, self.open_above_mm())
    }

    /// With a prior every direction may move, since the prior holds what the points do not.
    fn open_above_mm(&self) -> f64 {
        if self.prior.is_some() {
            f64::MAX
        } else {
            self.options.unobserved_mm
        }
    }

    /// Growth of half the weighted sum of squares (with Welsch's bound, plus the prior's share) grows from one fit to the
    /// next. Points that take part in only one of them are left out: they came or went, the fit did not change by them.
    fn cost_change(&self, from: &Fit, to: &Fit, reach: f64, noise: f64) -> f64 {
        let cost = |fit: &Fit, sample: &FitSample| {
            let x = fit.distance(sample, &Fit::row(sample, 1.0 / self.arm)) / reach;
            sample.weight * -(-0.5 * x * x).exp_m1()
        };
        let parts: Vec<f64> = from
            .samples
            .par_chunks(4 * CHUNK)
            .zip(to.samples.par_chunks(4 * CHUNK))
            .map(|(before, after)| {
                before
                    .iter()
                    .zip(after)
                    .filter(|(a, b)| a.weight > 0.0 && b.weight > 0.0)
                    .map(|(a, b)| cost(to, b) - cost(from, a))
                    .sum()
            })
            .collect();
        let points = self.points.len() as f64 / from.samples.len() as f64;
        let scale = points * (reach / noise).powi(2) / self.options.correlated_points;
        let prior = self.prior.as_ref().map_or(0.0, |prior| {
            0.5 * (prior.distance2(&to.pose) - prior.distance2(&from.pose))
        });
        parts.iter().sum::<f64>() * scale + prior
    }

    /// The pose after a step in scaled variables: a rotation about the centre, then a translation.
    fn moved(&self, pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
        let turn = Vector3::new(step[0], step[1], step[2]) / self.arm;
        let rotation = UnitQuaternion::from_scaled_axis(turn);
        let shift = Vector3::new(step[3], step[4], step[5]);
        let translation = self.centre - rotation * self.centre + shift;
        Isometry3::from_parts(Translation3::from(translation), rotation) * pose
    }

    fn report(&self, fit: Fit, iterations: usize, last_step: f64, converged: bool) -> Registration {
        let options = self.options;
        let reach_mm = (3.0 * fit.noise).min(options.most_inlier_mm);
        let (mut inliers, mut sum) = (0, 0.0);
        for sample in &fit.samples {
            let distance = fit.distance(sample, &Fit::row(sample, 1.0 / self.arm));
            if distance.abs() <= reach_mm {
                inliers += 1;
                sum += distance * distance;
            }
        }
        let rms_mm = (sum / inliers.max(1) as f64).sqrt();

        let stated = self.sigma_mm.as_ref().map(|_| self.mean_weight.powf(-0.5));
        // Stated uncertainties are believed unless the residuals are larger.
        let noise = stated.map_or(fit.noise, |stated| stated.max(fit.noise));
        let (information, _) = self.normal_equations(&fit, 3.0 * fit.noise, noise);
        let observed = Observability::new(&information);
        let prior_information = self.prior.as_ref().map(ScaledPrior::information);
        let total = Observability::new(&(information + prior_information.unwrap_or_default()));
        let mut unscale = Matrix6::identity();
        for k in 0..3 {
            unscale[(k, k)] = 1.0 / self.arm;
        }

        let weak = observed.weak(options.observed_mm, prior_information.as_ref());
        let unobserved = observed.count_above(options.unobserved_mm);
        let reason = if (inliers as f64) < options.least_inlier_ratio * fit.samples.len() as f64 {
            Some(RegistrationFailure::TooFewInliers {
                inliers,
                points: fit.samples.len(),
                reach_mm,
                least_ratio: options.least_inlier_ratio,
            })
        } else if !converged {
            Some(RegistrationFailure::NotConverged {
                iterations,
                step_mm: last_step,
                limit_mm: self.step_limit_mm(),
            })
        } else if self.prior.is_none() && unobserved > 2 {
            Some(RegistrationFailure::Unconstrained {
                unobserved,
                limit_mm: options.unobserved_mm,
            })
        } else if self.prior.is_none() && weak.len() == 6 {
            Some(RegistrationFailure::AllWeak {
                best_mm: weak[5].sigma_mm,
                limit_mm: options.observed_mm,
            })
        } else {
            self.prior_violated(&fit.pose)
                .or_else(|| self.ambiguous(&fit, reach_mm, inliers))
        };
        Registration {
            tool_from_cloud: Rigid::from_isometry(fit.pose),
            status: reason.map_or(Status::Registered, Status::Indeterminate),
            converged,
            iterations,
            inliers,
            rms_mm,
            noise_mm: fit.noise,
            weak_directions: weak,
            covariance: unscale * total.covariance(1.0) * unscale,
            centre_mm: self.centre.into(),
            arm_mm: self.arm,
        }
    }

    fn prior_violated(&self, pose: &Isometry3<f64>) -> Option<RegistrationFailure> {
        let distance = self.prior.as_ref()?.distance2(pose).sqrt();
        (distance > MOST_PRIOR_DISTANCE).then_some(RegistrationFailure::PriorViolated {
            distance,
            limit: MOST_PRIOR_DISTANCE,
        })
    }

    /// A toothing looks the same one pitch on. The pose found is only told from its rival by being nearer to where the
    /// cloud was expected, unless the rival fits clearly worse (a cloud that shows more than teeth).
    fn ambiguous(&self, fit: &Fit, reach_mm: f64, inliers: usize) -> Option<RegistrationFailure> {
        let pitch = std::f64::consts::TAU / f64::from(self.options.teeth?);
        let expected = self
            .options
            .prior
            .as_ref()
            .map_or(&self.options.initial, |prior| &prior.tool_from_cloud);
        let step = fit.samples.len().div_ceil(2_000);
        let probes: Vec<&FitSample> = fit.samples.iter().step_by(step).collect();
        // The turn about the axis that takes the expected places best to those found: of a whole ring its centre would say
        // nothing.
        let expected_from_found = expected.isometry() * fit.pose.inverse();
        let (mut sin, mut cos) = (0.0, 0.0);
        for probe in &probes {
            let found = Point3::from(probe.arm + self.centre);
            let start = expected_from_found * found;
            sin += start.x * found.y - start.y * found.x;
            cos += start.x * found.x + start.y * found.y;
        }
        let moved = sin.atan2(cos);
        let (moved_rad, rival_rad) = (moved.abs(), (pitch - moved.abs()).abs());
        if moved_rad <= RIVAL_RATIO * rival_rad {
            return None;
        }
        let back = Rotation3::from_axis_angle(&Vector3::z_axis(), -pitch * moved.signum());
        let near = probes
            .iter()
            .filter(|s| {
                let turned: [f64; 3] = (back * (s.arm + self.centre)).into();
                self.reference.distance_mm(turned) <= reach_mm
            })
            .count();
        let rival_ratio = near as f64 / probes.len() as f64;
        let own_ratio = inliers as f64 / fit.samples.len() as f64;
        (rival_ratio > 0.8 * own_ratio).then_some(RegistrationFailure::AmbiguousTooth {
            moved_rad,
            rival_rad,
            limit_ratio: RIVAL_RATIO,
        })
    }
}

/// 1.4826 times the median distance of the samples that take part.
fn robust_noise(samples: &[FitSample]) -> f64 {
    let mut sizes: Vec<f64> = samples
        .iter()
        .filter(|s| s.weight > 0.0)
        .map(|s| s.distance.abs())
        .collect();
    median(&mut sizes).map_or(LEAST_NOISE_MM, |size| {
        (SIGMA_PER_MAD * size).max(LEAST_NOISE_MM)
    })
}
