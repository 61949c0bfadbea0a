//! Gauss–Newton over what the views share, with each view's own stray motion and the form of the piece under it eliminated
//! (Schur complement).

use nalgebra::{
    Isometry3, Matrix6, Point3, SMatrix, SVector, SymmetricEigen, Translation3, UnitQuaternion,
    Vector3, Vector6,
};

use super::model::{NAMES, PARAMETERS, Pose, Stages};
use super::view::{ViewInformation, offset};
use crate::frames::{Cloud, Rigid, Tool};
use crate::registration::Prior;

type Square = SMatrix<f64, PARAMETERS, PARAMETERS>;
type Column = SVector<f64, PARAMETERS>;

/// Steps of the solve; the model is so nearly linear that the third changes nothing.
const STEPS: usize = 4;
/// Step of the difference quotients, in standard deviations of the prior.
const DIFFERENCE: f64 = 1e-3;

/// How far a single view may stray from what all share, and how far the piece's form may make it look astray: standard
/// deviations.
#[derive(Debug, Clone, Copy)]
pub struct Local {
    /// Turn of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Height of the vertical stage, mm.
    pub vertical_mm: f64,
    /// Run-out: shift in any direction, mm.
    pub runout_mm: f64,
    /// Wobble: turn about any axis, rad.
    pub wobble_rad: f64,
    /// Form of the piece: its wall stands nearer to or farther from the axis over a whole view, mm. It looks like a shift
    /// of the view and is none: however many points say so, the view stays where it is and the form in its deviations.
    pub form_mm: f64,
    /// Form of the piece: its wall leans over a whole view, rad.
    pub form_rad: f64,
}

impl Default for Local {
    /// ±15 mdeg and ±5 µm, evenly distributed (data sheets); run-out and wobble of an air or cross-roller bearing stage; a
    /// form of 5 µm, and that over the half height of a die.
    fn default() -> Self {
        let even = 1.0 / 3f64.sqrt();
        Self {
            rotation_rad: 15e-3 * std::f64::consts::PI / 180.0 * even,
            vertical_mm: 5e-3 * even,
            runout_mm: 0.3e-3,
            wobble_rad: 5e-6,
            form_mm: 5e-3,
            form_rad: 5e-3 / 33.0,
        }
    }
}

impl Local {
    /// Covariance of the stray motion (rotation about `centre`, translation), tool frame.
    fn covariance(&self, centre: Vector3<f64>) -> Matrix6<f64> {
        let mut covariance = Matrix6::from_diagonal(&Vector6::new(
            self.wobble_rad.powi(2),
            self.wobble_rad.powi(2),
            self.wobble_rad.powi(2),
            self.runout_mm.powi(2),
            self.runout_mm.powi(2),
            self.runout_mm.powi(2) + self.vertical_mm.powi(2),
        ));
        let turn = Vector6::new(0.0, 0.0, 1.0, -centre.y, centre.x, 0.0) * self.rotation_rad;
        covariance += turn * turn.transpose();
        covariance
    }

    /// Covariance of the motion that the form of the piece looks like.
    fn form_covariance(&self, centre: Vector3<f64>) -> Matrix6<f64> {
        let lean = self.form_rad.powi(2);
        let mut covariance = Matrix6::from_diagonal(&Vector6::new(lean, lean, lean, 0.0, 0.0, 0.0));
        let radius_mm = centre.x.hypot(centre.y);
        if radius_mm > 0.0 {
            let (x, y) = (centre.x / radius_mm, centre.y / radius_mm);
            let outwards = Vector6::new(0.0, 0.0, 0.0, x, y, 0.0) * self.form_mm;
            covariance += outwards * outwards.transpose();
        }
        covariance
    }
}

/// A combination of shared parameters of which the views say less than was known before.
#[derive(Debug, Clone)]
pub struct Weak {
    /// Its largest part.
    pub name: &'static str,
    /// Share of the prior in what is known of it, 0.5..1.
    pub prior_share: f64,
}

/// Why there is no joint solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum JointError {
    /// The normal equations have no solution.
    #[error("the joint solve of {views} views broke down: a view's information is not positive")]
    NotPositive {
        /// Views.
        views: usize,
    },
}

/// The views together.
#[derive(Debug, Clone)]
pub struct Solution {
    /// What they share.
    pub stages: Stages,
    /// Pose of every view, its stray motion included.
    pub poses: Vec<Isometry3<f64>>,
    /// Stray motion of every view: rotation (rad) about its centre, translation (mm).
    pub strays: Vec<Vector6<f64>>,
    /// Combinations that stay where they were, weakest first.
    pub weak: Vec<Weak>,
    /// Ratio of the largest to the smallest eigenvalue of the information, prior included, in units of the prior.
    pub condition: f64,
    covariance: Square,
    local: Local,
}

impl Solution {
    /// What is known before any view.
    pub fn prior(stages: Stages, local: Local) -> Self {
        Self {
            stages,
            poses: Vec::new(),
            strays: Vec::new(),
            weak: Vec::new(),
            condition: 1.0,
            covariance: Square::identity(),
            local,
        }
    }

    /// Pose of one more view in its best place: what all share, and its own stray motion as far as its stages can be off.
    /// `None` when its information is not positive.
    pub fn settle(&self, view: &ViewInformation) -> Option<Isometry3<f64>> {
        let centre = Vector3::from(view.centre_mm);
        let pose = self.stages.tool_from_camera(view.at);
        let away = offset(&view.tool_from_camera, &pose, centre);
        let stray = Reduced::new(view, self.local)?.stray(view, &away);
        Some(moved(&pose, &stray, centre))
    }

    /// Where another view should be, and how well that is known.
    pub fn predict(&self, at: Pose) -> Prior {
        let pose = self.stages.tool_from_camera(at);
        let centre = pose.translation.vector;
        let slope = slope(&self.stages, at, &pose, centre);
        Prior {
            tool_from_cloud: Rigid::<Tool, Cloud>::from_isometry(pose),
            pivot_mm: centre.into(),
            covariance: slope * self.covariance * slope.transpose() + self.local.covariance(centre),
        }
    }
}

/// Solves for what all views share, from where `start` stands.
///
/// # Errors
/// The information of a view is no positive matrix.
pub fn solve(
    start: &Stages,
    views: &[ViewInformation],
    local: Local,
) -> Result<Solution, JointError> {
    let broken = || JointError::NotPositive { views: views.len() };
    let mut stages = start.clone();
    let reduced = views
        .iter()
        .map(|view| Reduced::new(view, local))
        .collect::<Option<Vec<_>>>()
        .ok_or_else(broken)?;
    let mut information = Square::identity();
    for _ in 0..STEPS {
        information = Square::identity();
        let mut gradient: Column = stages.parameters;
        for (view, reduced) in views.iter().zip(&reduced) {
            let pose = stages.tool_from_camera(view.at);
            let centre = Vector3::from(view.centre_mm);
            let away = offset(&view.tool_from_camera, &pose, centre);
            let slope = slope(&stages, view.at, &pose, centre);
            information += slope.transpose() * reduced.information * slope;
            gradient += slope.transpose() * (reduced.information * away + reduced.gradient);
        }
        let step = information.cholesky().ok_or_else(broken)?.solve(&gradient);
        stages.parameters -= step;
    }
    let strays: Vec<Vector6<f64>> = views
        .iter()
        .zip(&reduced)
        .map(|(view, reduced)| {
            let pose = stages.tool_from_camera(view.at);
            let away = offset(&view.tool_from_camera, &pose, view.centre_mm.into());
            reduced.stray(view, &away)
        })
        .collect();
    let poses = views
        .iter()
        .zip(&strays)
        .map(|(view, stray)| {
            moved(
                &stages.tool_from_camera(view.at),
                stray,
                view.centre_mm.into(),
            )
        })
        .collect();
    let eigen = SymmetricEigen::new(information);
    let mut weak: Vec<Weak> = (0..PARAMETERS)
        .filter(|&j| eigen.eigenvalues[j] < 2.0)
        .map(|j| Weak {
            name: NAMES[eigen.eigenvectors.column(j).iamax()],
            prior_share: 1.0 / eigen.eigenvalues[j].max(1.0),
        })
        .collect();
    weak.sort_by(|a, b| b.prior_share.total_cmp(&a.prior_share));
    Ok(Solution {
        stages,
        poses,
        strays,
        weak,
        condition: eigen.eigenvalues.max() / eigen.eigenvalues.min(),
        covariance: information.try_inverse().ok_or_else(broken)?,
        local,
    })
}

/// A view's information once its own stray motion and the form of the piece are eliminated.
struct Reduced {
    information: Matrix6<f64>,
    gradient: Vector6<f64>,
    /// What the view's own pull moves it by: P (P + F)⁻¹ of (H + (P + F)⁻¹)⁻¹, for the stray motion's covariance P and the
    /// form's F. The other share is form.
    gain: Matrix6<f64>,
}

impl Reduced {
    fn new(view: &ViewInformation, local: Local) -> Option<Self> {
        let stray = local.covariance(view.centre_mm.into());
        let both = stray + local.form_covariance(view.centre_mm.into());
        let prior = both.cholesky()?.inverse();
        let seen = (view.information + prior).cholesky()?.inverse();
        let kept = Matrix6::identity() - view.information * seen;
        let information = kept * view.information;
        Some(Self {
            information: 0.5 * (information + information.transpose()),
            gradient: kept * view.gradient,
            gain: stray * prior * seen,
        })
    }

    /// What the view adds to the pose that all share, which is `away` from where it was laid.
    fn stray(&self, view: &ViewInformation, away: &Vector6<f64>) -> Vector6<f64> {
        -self.gain * (view.information * away + view.gradient)
    }
}

/// How the pose at `centre` moves with the parameters.
fn slope(
    stages: &Stages,
    at: Pose,
    pose: &Isometry3<f64>,
    centre: Vector3<f64>,
) -> SMatrix<f64, 6, PARAMETERS> {
    let mut slope = SMatrix::<f64, 6, PARAMETERS>::zeros();
    for j in 0..PARAMETERS {
        let side = |step: f64| {
            let mut other = stages.clone();
            other.parameters[j] += step;
            offset(pose, &other.tool_from_camera(at), centre)
        };
        slope.set_column(
            j,
            &((side(DIFFERENCE) - side(-DIFFERENCE)) / (2.0 * DIFFERENCE)),
        );
    }
    slope
}

/// A pose after a small motion: rotation about `centre`, then translation.
fn moved(pose: &Isometry3<f64>, motion: &Vector6<f64>, centre: Vector3<f64>) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(motion[0], motion[1], motion[2]));
    let shift = Vector3::new(motion[3], motion[4], motion[5]);
    let translation = centre - (rotation * Point3::from(centre)).coords + shift;
    Isometry3::from_parts(Translation3::from(translation), rotation) * pose
}
