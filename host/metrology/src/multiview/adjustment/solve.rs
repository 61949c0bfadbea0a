//! Gauss–Newton over what the views share, with each view's own pose residual and the form of the piece under it eliminated
//! (Schur complement).
//!
//! ```text
//!  CAD      each view:  where it lies = what all share + its residual + form of the piece (of the whole, and under it)
//!  overlap  each pair:  how it lies against the other = what all share + both pose residuals
//! ```

use nalgebra::{
    Isometry3, Matrix6, Point3, SMatrix, SVector, SymmetricEigen, Translation3, UnitQuaternion,
    Vector3, Vector6,
};

use super::CameraPose;
use super::blocks::{Between, BlockCholesky};
use super::form::{self, FORMS, SharedForm};
use super::local::{Believed, Local};
use super::model::{self, PARAMETERS, Pose, Stages};
use super::overlap::Overlap;
use super::view::{ViewInformation, offset};
use crate::registration::Prior;
use flankscope_foundation::rigid::{Cloud, Rigid, Tool};

/// Everything that is shared: the stages' parameters, then the form's.
const SHARED: usize = PARAMETERS + FORMS;
type Square = SMatrix<f64, SHARED, SHARED>;
/// Six rows of the normal equations: a column for everything shared, and the right side.
type Rows = SMatrix<f64, 6, { SHARED + 1 }>;
type StageSlope = SMatrix<f64, 6, PARAMETERS>;

/// Steps of the solve; the model is so nearly linear that the third changes nothing.
const STEPS: usize = 4;
/// Step of the difference quotients, in standard deviations of the prior.
const DIFFERENCE: f64 = 1e-3;

/// A combination of shared parameters on which the prior holds more information than the views.
#[derive(Debug, Clone)]
pub struct Weak {
    /// Its largest part.
    pub name: &'static str,
    /// Share of the prior in what is known of it, 0.5..1.
    pub prior_share: f64,
}

/// Reasons for which the adjustment has no solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AdjustmentError {
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
    /// Geometry that they share.
    pub stages: Stages,
    /// Pose of every view, its pose residual included.
    pub poses: Vec<CameraPose>,
    /// Stray motion of every view: rotation (rad) about its centre, translation (mm).
    pub pose_residuals: Vec<Vector6<f64>>,
    /// Combinations that stay where they were, weakest first.
    pub weak: Vec<Weak>,
    /// Ratio of the largest to the smallest eigenvalue of the information, prior included, in units of the prior.
    pub condition: f64,
    covariance: Square,
    form: SharedForm,
    local: Local,
}

impl Solution {
    /// Solution by the prior alone, without a view.
    pub fn prior(stages: Stages, local: Local) -> Self {
        Self {
            stages,
            poses: Vec::new(),
            pose_residuals: Vec::new(),
            weak: Vec::new(),
            condition: 1.0,
            covariance: Square::identity(),
            form: SharedForm::none(0.0),
            local,
        }
    }

    /// Pose of one more view in its best place: what all share, and its own pose residual as far as its stages can be off.
    /// `None` when its information is not positive.
    pub fn settle(&self, view: &ViewInformation) -> Option<CameraPose> {
        let centre = Vector3::from(view.centre_mm);
        let pose = self.stages.tool_from_camera(view.at);
        let form = self.form.slope(centre) * self.form.parameters;
        let away = view.motion_to(&pose) + form;
        let Believed {
            information,
            gradient,
        } = self.local.without_form(view)?;
        let prior = self.local.covariance(centre).cholesky()?.inverse();
        let held = (information + prior).cholesky()?;
        let residual = -held.solve(&(information * away + gradient));
        Some(moved(&pose, &residual, centre))
    }

    /// Expected pose of another view, with its covariance.
    pub fn predict(&self, at: Pose) -> Prior {
        let pose = self.stages.tool_from_camera(at);
        let centre = pose.isometry().translation.vector;
        let slope = slope(&self.stages, at, &pose, centre);
        let of_stages = self.covariance.fixed_view::<PARAMETERS, PARAMETERS>(0, 0);
        Prior {
            tool_from_cloud: Rigid::<Tool, Cloud>::from_isometry(*pose.isometry()),
            pivot_mm: centre.into(),
            covariance: slope * of_stages * slope.transpose() + self.local.covariance(centre),
        }
    }

    /// Uncertainty of a view's pose: covariance of a motion (rotation about the view's centre, translation) by what is
    /// left of the shared parameters and of its own pose residual. `None` when its information is not positive.
    pub fn pose_covariance(&self, view: &ViewInformation) -> Option<Matrix6<f64>> {
        let centre = Vector3::from(view.centre_mm);
        let pose = self.stages.tool_from_camera(view.at);
        let slope = slope(&self.stages, view.at, &pose, centre);
        let of_stages = self.covariance.fixed_view::<PARAMETERS, PARAMETERS>(0, 0);
        let tolerance = self.local.covariance(centre).cholesky()?.inverse();
        let held = self.local.without_form(view)?.information + tolerance;
        Some(slope * of_stages * slope.transpose() + held.cholesky()?.inverse())
    }

    /// Claims no more of what is shared than another solution does, one without overlaps: what they add there rests on the
    /// calibration of the field.
    #[must_use]
    pub fn no_surer_than(self, other: &Self) -> Self {
        Self {
            weak: other.weak.clone(),
            condition: other.condition,
            covariance: other.covariance,
            ..self
        }
    }

    /// Standard uncertainty of the distance between the walls that two views see, along the line between their centres, mm:
    /// what is left of the shared parameters, and a run-out of either.
    pub fn distance_sigma_mm(&self, [first, second]: [&ViewInformation; 2]) -> f64 {
        let centres = [first, second].map(|view| Vector3::from(view.centre_mm));
        let Some(along) = (centres[1] - centres[0]).try_normalize(0.0) else {
            return 0.0;
        };
        let [here, there] = [0, 1].map(|k: usize| {
            let at = [first, second][k].at;
            let pose = self.stages.tool_from_camera(at);
            let slope = slope(&self.stages, at, &pose, centres[k]);
            slope.fixed_rows::<3>(3).transpose() * along
        });
        let change = there - here;
        let of_stages = self.covariance.fixed_view::<PARAMETERS, PARAMETERS>(0, 0);
        let shared_mm2 = (change.transpose() * of_stages * change)[0].max(0.0);
        (shared_mm2 + 2.0 * self.local.runout_mm.powi(2)).sqrt()
    }

    /// Standard uncertainty of the piece's ovality and of its taper over a height, mm: what noise, the stages and the form
    /// under single views leave open. How far the vertical axis leans towards the wall is no more than its prior, and looks
    /// like a taper.
    pub fn form_sigma_mm(&self, over_mm: f64) -> [f64; 2] {
        let of_form = self
            .covariance
            .fixed_view::<FORMS, FORMS>(PARAMETERS, PARAMETERS)
            .into_owned();
        form::sigma_mm(&of_form, over_mm)
    }
}

/// Standard uncertainties of the errors of die and stages that all views share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageSigma {
    /// Of the die's eccentricity, mm.
    pub eccentricity_mm: f64,
    /// Of its tilt, rad.
    pub tilt_rad: f64,
    /// Of the lean of the vertical axis, along the wall and towards it, rad.
    pub vertical_lean_rad: [f64; 2],
    /// Of the encoder's harmonics, cosine and sine, rad.
    pub harmonics_rad: [[f64; 2]; 3],
}

impl Solution {
    /// Standard uncertainties of the errors of die and stages, priors included.
    pub fn stage_sigma(&self) -> StageSigma {
        let between = |i, j| self.covariance[(i, j)] * model::SIGMA[i] * model::SIGMA[j];
        let of = |i: usize| between(i, i).max(0.0).sqrt();
        // Along the direction in which the two parts point: what their root of squares changes by.
        let of_length = |i: usize, j: usize| {
            let (a, b) = (self.stages.value(i), self.stages.value(j));
            let length = a.hypot(b);
            if length <= 0.0 {
                return of(i).max(of(j));
            }
            let (a, b) = (a / length, b / length);
            let variance =
                a * a * between(i, i) + 2.0 * a * b * between(i, j) + b * b * between(j, j);
            variance.max(0.0).sqrt()
        };
        StageSigma {
            eccentricity_mm: of_length(3, 4),
            tilt_rad: of_length(0, 1),
            vertical_lean_rad: [of(12), of(13)],
            harmonics_rad: std::array::from_fn(|m| [of(14 + 2 * m), of(15 + 2 * m)]),
        }
    }
}

/// Solves for what all views share and for each view's own pose residual, from where `start` stands. Overlaps tie the views
/// to each other; without them each is held by the CAD alone.
///
/// # Errors
/// The information of a view is no positive matrix.
pub fn solve(
    start: &Stages,
    views: &[ViewInformation],
    overlaps: &[Overlap],
    local: Local,
) -> Result<Solution, AdjustmentError> {
    let broken = || AdjustmentError::NotPositive { views: views.len() };
    let system = System::new(views, overlaps, local).ok_or_else(broken)?;
    let height_mm = views.iter().map(|v| v.centre_mm[2]).sum::<f64>() / views.len().max(1) as f64;
    let (mut stages, mut form) = (start.clone(), SharedForm::none(height_mm));
    let mut information = Square::identity();
    for _ in 0..STEPS {
        let normal = system.normal(&stages, &form);
        information = Square::identity() + normal.fixed_columns::<SHARED>(0);
        information = 0.5 * (information + information.transpose());
        let mut gradient: SVector<f64, SHARED> = normal.column(SHARED).into_owned();
        for (k, value) in stages.parameters.iter().chain(&form.parameters).enumerate() {
            gradient[k] += value;
        }
        let step = information.cholesky().ok_or_else(broken)?.solve(&gradient);
        stages.parameters -= step.fixed_rows::<PARAMETERS>(0);
        form.parameters -= step.fixed_rows::<FORMS>(PARAMETERS);
    }
    let pose_residuals = system.pose_residuals(&stages, &form);
    let poses = views
        .iter()
        .zip(&pose_residuals)
        .map(|(view, residual)| {
            moved(
                &stages.tool_from_camera(view.at),
                residual,
                view.centre_mm.into(),
            )
        })
        .collect();
    let eigen = SymmetricEigen::new(information);
    let name = |k: usize| {
        let names = model::NAMES.iter().chain(&form::NAMES);
        names.copied().nth(k).unwrap_or_default()
    };
    let mut weak: Vec<Weak> = (0..SHARED)
        .filter(|&j| eigen.eigenvalues[j] < 2.0)
        .map(|j| Weak {
            name: name(eigen.eigenvectors.column(j).iamax()),
            prior_share: 1.0 / eigen.eigenvalues[j].max(1.0),
        })
        .collect();
    weak.sort_by(|a, b| b.prior_share.total_cmp(&a.prior_share));
    Ok(Solution {
        stages,
        poses,
        pose_residuals,
        weak,
        condition: eigen.eigenvalues.max() / eigen.eigenvalues.min(),
        covariance: information.try_inverse().ok_or_else(broken)?,
        form,
        local,
    })
}

/// Terms that stay constant from step to step.
struct System<'a> {
    views: &'a [ViewInformation],
    overlaps: &'a [Overlap],
    /// Information of each view about its pose on the CAD, with the form under it eliminated.
    believed: Vec<Believed>,
    /// Of what all of them, overlaps and stage tolerances say of the pose residuals.
    factor: BlockCholesky,
}

impl<'a> System<'a> {
    fn new(views: &'a [ViewInformation], overlaps: &'a [Overlap], local: Local) -> Option<Self> {
        let believed = views.iter().map(|view| local.without_form(view));
        let believed = believed.collect::<Option<Vec<_>>>()?;
        let mut diagonal = Vec::with_capacity(views.len());
        for (view, of) in views.iter().zip(&believed) {
            let tolerance = local.covariance(view.centre_mm.into()).cholesky()?;
            diagonal.push(of.information + tolerance.inverse());
        }
        let mut between = Between::new();
        for overlap in overlaps {
            for (side, &view) in overlap.views.iter().enumerate() {
                *diagonal.get_mut(view)? += overlap.block(side, side);
            }
            *between.entry(overlap.views).or_insert_with(Matrix6::zeros) += overlap.block(0, 1);
        }
        // Folded: a ring's neighbours are near each other when both halves are counted from the same end.
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by(|&a, &b| {
            let key = |view: usize| {
                [
                    views[view].at.rotation_rad.abs(),
                    views[view].at.vertical_mm,
                ]
            };
            let ([turn, up], [other_turn, other_up]) = (key(a), key(b));
            turn.total_cmp(&other_turn).then(up.total_cmp(&other_up))
        });
        Some(Self {
            views,
            overlaps,
            factor: BlockCholesky::new(&diagonal, &between, &order)?,
            believed,
        })
    }

    /// Motion of every view from its registered pose to that of the shared model, and its derivatives by the stages' parameters.
    fn away(&self, stages: &Stages) -> Vec<(Vector6<f64>, StageSlope)> {
        let of = |view: &ViewInformation| {
            let pose = stages.tool_from_camera(view.at);
            let centre = Vector3::from(view.centre_mm);
            let away = view.motion_to(&pose);
            (away, slope(stages, view.at, &pose, centre))
        };
        self.views.iter().map(of).collect()
    }

    /// The views' own rows of the normal equations: what CAD and overlaps make of everything shared and of where the views
    /// are, before any pose residual.
    fn rows(
        &self,
        away: &[(Vector6<f64>, StageSlope)],
        form: &SharedForm,
    ) -> (Vec<Rows>, Vec<Rows>) {
        let motions: Vec<Rows> = away
            .iter()
            .map(|(away, slope)| {
                let mut rows = Rows::zeros();
                rows.fixed_columns_mut::<PARAMETERS>(0).copy_from(slope);
                rows.set_column(SHARED, away);
                rows
            })
            .collect();
        let of_cad = |((view, believed), motion): ((&ViewInformation, &Believed), &Rows)| {
            let mut motion = *motion;
            let slope = form.slope(view.centre_mm.into());
            motion
                .fixed_columns_mut::<FORMS>(PARAMETERS)
                .copy_from(&slope);
            let mut right = motion.column_mut(SHARED);
            right += slope * form.parameters;
            let mut rows = believed.information * motion;
            let mut right = rows.column_mut(SHARED);
            right += believed.gradient;
            rows
        };
        let by_cad: Vec<Rows> = self
            .views
            .iter()
            .zip(&self.believed)
            .zip(&motions)
            .map(of_cad)
            .collect();
        let mut by_overlap = vec![Rows::zeros(); self.views.len()];
        for overlap in self.overlaps {
            for (side, &view) in overlap.views.iter().enumerate() {
                for (other, &there) in overlap.views.iter().enumerate() {
                    by_overlap[view] += overlap.block(side, other) * motions[there];
                }
                let mut right = by_overlap[view].column_mut(SHARED);
                right += overlap.gradient.fixed_rows::<6>(6 * side);
            }
        }
        (by_cad, by_overlap)
    }

    /// Information and gradient (last column) of everything shared, the pose residuals eliminated.
    fn normal(&self, stages: &Stages, form: &SharedForm) -> SMatrix<f64, SHARED, { SHARED + 1 }> {
        let away = self.away(stages);
        let (by_cad, by_overlap) = self.rows(&away, form);
        let mut normal = SMatrix::<f64, SHARED, { SHARED + 1 }>::zeros();
        for ((view, (_, slope)), (cad, overlap)) in self
            .views
            .iter()
            .zip(&away)
            .zip(by_cad.iter().zip(&by_overlap))
        {
            let of_form = form.slope(view.centre_mm.into());
            let mut stages = normal.fixed_rows_mut::<PARAMETERS>(0);
            stages += slope.transpose() * (cad + overlap);
            let mut forms = normal.fixed_rows_mut::<FORMS>(PARAMETERS);
            forms += of_form.transpose() * cad;
        }
        let together: Vec<Rows> = by_cad.iter().zip(&by_overlap).map(|(a, b)| a + b).collect();
        let mut solved = together.clone();
        self.factor.solve(&mut solved);
        for (rows, solved) in together.iter().zip(&solved) {
            normal -= rows.fixed_columns::<SHARED>(0).transpose() * solved;
        }
        normal
    }

    /// Residual of every view's pose against the shared model.
    fn pose_residuals(&self, stages: &Stages, form: &SharedForm) -> Vec<Vector6<f64>> {
        let (by_cad, by_overlap) = self.rows(&self.away(stages), form);
        let right = |(cad, overlap): (&Rows, &Rows)| -> Vector6<f64> {
            -(cad.column(SHARED) + overlap.column(SHARED))
        };
        let mut pose_residuals: Vec<Vector6<f64>> =
            by_cad.iter().zip(&by_overlap).map(right).collect();
        self.factor.solve(&mut pose_residuals);
        pose_residuals
    }
}

/// Derivatives of the pose at `centre` by the parameters.
fn slope(stages: &Stages, at: Pose, pose: &CameraPose, centre: Vector3<f64>) -> StageSlope {
    let mut slope = StageSlope::zeros();
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
fn moved(pose: &CameraPose, motion: &Vector6<f64>, centre: Vector3<f64>) -> CameraPose {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(motion[0], motion[1], motion[2]));
    let shift = Vector3::new(motion[3], motion[4], motion[5]);
    let translation = centre - (rotation * Point3::from(centre)).coords + shift;
    let motion = Isometry3::from_parts(Translation3::from(translation), rotation);
    Rigid::from_isometry(motion * pose.isometry())
}
