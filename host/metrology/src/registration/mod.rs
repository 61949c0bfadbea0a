//! Laying a cloud on CAD, or on another cloud.
//!
//! [`register`] minimises the distances of the points to the surface itself (point to triangle), robustly, from coarse to
//! fine, with the physical prior of the stages where there is one. It names the directions that the points do not determine,
//! leaves those where they were, and reports success only when the pose deserves it.

mod article;
mod observe;
mod pairs;
mod periodicity;
mod phase;
mod prior;
mod reference;
mod response;
pub mod scale;
mod solve;
pub mod stretch;

pub use article::{ArticleOptions, ArticleReference, register_by_article, register_to_reference};
pub use pairs::{Pair, PairsError, fit_pairs, pairs_rms, parse_pairs};
pub use periodicity::detect_teeth;
pub use phase::search_phase;
pub use prior::Prior;
pub use reference::{Foot, RegistrationTarget};
pub use response::{Answer, Contact, Response};
pub use solve::register;

use flankscope_foundation::display::Number;
use nalgebra::Matrix6;

use flankscope_foundation::rigid::{Cloud, Rigid, Tool};

/// Settings of a registration. Lengths mm, angles rad.
#[derive(Debug, Clone)]
pub struct Options {
    /// Pose from which the iteration starts.
    pub initial: Rigid<Tool, Cloud>,
    /// Expected pose with its covariance, from the stages' positions; none for a foreign cloud.
    pub prior: Option<Prior>,
    /// Number of teeth of a toothing about z, when poses one pitch apart may look alike.
    pub teeth: Option<u32>,
    /// Least number of points.
    pub least_points: usize,
    /// Standard deviation that a point is expected to have, at most: steps far below it end the search.
    pub noise_mm: f64,
    /// A point farther from the surface than this does not take part.
    pub capture_mm: f64,
    /// A point farther from the surface than this after the fit is no inlier, whatever the noise.
    pub most_inlier_mm: f64,
    /// Least share of inliers among the points.
    pub least_inlier_ratio: f64,
    /// A direction is well observed below this standard deviation.
    pub observed_mm: f64,
    /// A direction is not observed at all above this standard deviation: without a prior it is not moved.
    pub unobserved_mm: f64,
    /// Mean number of points that share one error (1 per fibre core, about 10 per camera pixel grid).
    pub correlated_points: f64,
    /// Most steps on the full cloud.
    pub most_iterations: usize,
}

/// Standard deviation of a point of the heads that this was made for, at most, mm.
pub const TYPICAL_NOISE_MM: f64 = 0.02;

impl Default for Options {
    fn default() -> Self {
        Self::for_noise(TYPICAL_NOISE_MM)
    }
}

impl Options {
    /// Limits in proportion to the noise of a point: a cloud of a car is not asked for what one of a tooth is.
    pub fn for_noise(noise_mm: f64) -> Self {
        Self {
            initial: Rigid::from_isometry(nalgebra::Isometry3::identity()),
            prior: None,
            teeth: None,
            least_points: 100,
            noise_mm,
            capture_mm: 250.0 * noise_mm,
            most_inlier_mm: 7.5 * noise_mm,
            least_inlier_ratio: 0.5,
            observed_mm: 0.05 * noise_mm,
            unobserved_mm: 0.5 * noise_mm,
            correlated_points: 1.0,
            most_iterations: 30,
        }
    }
}

/// Whether the pose may be used, and if not, the reason.
#[derive(Debug, Clone, PartialEq)]
pub enum Status {
    /// It may.
    Registered,
    /// It may not.
    Indeterminate(RegistrationFailure),
}

/// Reasons for which a pose is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegistrationFailure {
    /// Not enough points.
    #[error("{points} points, at least {least} are needed")]
    TooFewPoints {
        /// Points given.
        points: usize,
        /// Least number.
        least: usize,
    },
    /// A coordinate or a sigma that is no usable number.
    #[error("point {index} has a non-finite coordinate or a sigma that is not positive")]
    NotFinite {
        /// The first such point.
        index: usize,
    },
    /// One sigma per point was promised.
    #[error("{sigmas} sigmas for {points} points; one per point is needed")]
    SigmaCount {
        /// Sigmas given.
        sigmas: usize,
        /// Points given.
        points: usize,
    },
    /// The start is too far away.
    #[error("only {:.0} % of the points start within {capture_mm} mm of the surface, at least {:.0} % are needed: the cloud and the CAD are disjoint; give a start pose", Number(100.0 * ratio), Number(100.0 * least_ratio), capture_mm = Number(*capture_mm))]
    Disjoint {
        /// Share of points within reach.
        ratio: f64,
        /// Least share.
        least_ratio: f64,
        /// Reach.
        capture_mm: f64,
    },
    /// The fit explains too little of the cloud.
    #[error("only {inliers} of {points} points lie within {reach_mm:.4} mm of the surface after the fit, at least {:.0} % are needed", Number(100.0 * least_ratio), reach_mm = Number(*reach_mm))]
    TooFewInliers {
        /// Points on the surface.
        inliers: usize,
        /// All points.
        points: usize,
        /// Distance up to which a point counts.
        reach_mm: f64,
        /// Least share.
        least_ratio: f64,
    },
    /// The steps did not die out.
    #[error(
        "not converged after {iterations} steps: the last one was {step_mm:.6} mm, below {limit_mm} mm is needed", step_mm = Number(*step_mm), limit_mm = Number(*limit_mm))]
    NotConverged {
        /// Steps taken.
        iterations: usize,
        /// Length of the last step.
        step_mm: f64,
        /// Limit.
        limit_mm: f64,
    },
    /// The data leave too much open.
    #[error(
        "{unobserved} directions are not observed (standard deviation above {limit_mm} mm); at most 2 may be open without a prior", limit_mm = Number(*limit_mm))]
    Unconstrained {
        /// Number of open directions.
        unobserved: usize,
        /// Limit.
        limit_mm: f64,
    },
    /// No direction is well observed: whatever pose was found, another would do about as well.
    #[error(
        "none of the six directions is observed well: the best has a standard deviation of {best_mm:.6} mm, below {limit_mm} mm is needed; \
         more points, a larger part of the surface, or a start nearer to it", best_mm = Number(*best_mm), limit_mm = Number(*limit_mm))]
    AllWeak {
        /// Standard deviation along the best known direction.
        best_mm: f64,
        /// Limit.
        limit_mm: f64,
    },
    /// Another tooth fits as well.
    #[error(
        "ambiguous tooth: the pose found is {moved_rad:.5} rad from the start, its rival one pitch on is {rival_rad:.5} rad away; a ratio of at most {limit_ratio} is needed", moved_rad = Number(*moved_rad), rival_rad = Number(*rival_rad), limit_ratio = Number(*limit_ratio))]
    AmbiguousTooth {
        /// Angle between start and pose about the tool axis.
        moved_rad: f64,
        /// Angle between start and rival.
        rival_rad: f64,
        /// Largest accepted ratio of the two.
        limit_ratio: f64,
    },
    /// The pose contradicts the stages.
    #[error(
        "the pose is {distance:.1} standard deviations off what the stages say, at most {limit} are accepted", distance = Number(*distance), limit = Number(*limit))]
    PriorViolated {
        /// Mahalanobis distance.
        distance: f64,
        /// Limit.
        limit: f64,
    },
    /// The prior's covariance is not positive definite.
    #[error("the prior's covariance is not positive definite")]
    BadPrior,
}

/// A direction that the points do not fix well.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakDirection {
    /// Unit 6-vector (rotation about x, y, z times [`Registration::arm_mm`], translation along x, y, z) in tool
    /// coordinates about [`Registration::centre_mm`].
    pub vector: [f64; 6],
    /// Standard deviation along it from the points alone, mm; infinite when they do not determine it.
    pub sigma_mm: f64,
    /// Share of the prior in the information along it: 0 without a prior, near 1 where the points do not determine it.
    pub prior_share: f64,
}

/// The result of a registration.
#[derive(Debug, Clone)]
pub struct Registration {
    /// Takes cloud points to tool (CAD) coordinates.
    pub tool_from_cloud: Rigid<Tool, Cloud>,
    /// Registered, or refused with a reason.
    pub status: Status,
    /// Whether the last step was below the limits of convergence.
    pub converged: bool,
    /// Steps over all levels.
    pub iterations: usize,
    /// Points on the surface: within three robust standard deviations and within [`Options::most_inlier_mm`].
    pub inliers: usize,
    /// Root mean square distance of the inliers, mm.
    pub rms_mm: f64,
    /// Robust standard deviation of the distances (1.4826 times their median size), mm.
    pub noise_mm: f64,
    /// Directions that the points leave weak, weakest first.
    pub weak_directions: Vec<WeakDirection>,
    /// Covariance of (rotation rad, translation mm) about [`Registration::centre_mm`]; 1 mm2 (and the rotation that moves
    /// a point by 1 mm) stands for directions of which nothing is known.
    pub covariance: Matrix6<f64>,
    /// Centre of the cloud in tool coordinates, mm.
    pub centre_mm: [f64; 3],
    /// Root mean square distance of the points from the centre: turns rotations into lengths, mm.
    pub arm_mm: f64,
}

impl Registration {
    /// Whether the pose may be used, and if not, the reason.
    pub fn is_registered(&self) -> bool {
        self.status == Status::Registered
    }

    /// A result without a pose better than the start.
    pub(crate) fn refused(initial: Rigid<Tool, Cloud>, reason: RegistrationFailure) -> Self {
        Self {
            tool_from_cloud: initial,
            status: Status::Indeterminate(reason),
            converged: false,
            iterations: 0,
            inliers: 0,
            rms_mm: f64::NAN,
            noise_mm: f64::NAN,
            weak_directions: Vec::new(),
            covariance: Matrix6::identity(),
            centre_mm: [0.0; 3],
            arm_mm: 1.0,
        }
    }
}
