//! From one captured view to points and a first pose, which is predicted from the earlier views.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_foundation::display::Number;
use flankscope_foundation::rigid::Rigid;
use flankscope_metrology::cloud::outlier;
use flankscope_metrology::deviation::{Order, SampleTree};
use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::multiview::adjustment::{
    CameraPose, Local, Pose, Solution, Stages, ViewInformation, compress, solve,
};
use flankscope_metrology::multiview::cylinder::{CellObservation, Layout};
use flankscope_metrology::registration::{self, Options, Status, register, search_phase};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_metrology::wear::FlankView;
use flankscope_profilometry::{Accumulator, Decoder};
use nalgebra::{Matrix6, Vector6};

use super::cell_observations::{Laid, layout};
use crate::inspection::{
    EvaluatorError, OUTLIER_NEIGHBOURS, OUTLIER_RATIO, exposures_disagree, hand_eye,
    rays_without_point,
};
use crate::plan::{FieldOfView, ViewPlan};
use crate::subject::Subject;
use flankscope_article::ViewPoint;

/// Number of points that represent a view's pose; the first ones, because points are stored in random order.
pub(super) const SAMPLE: usize = 4_000;
/// Number of points of the view's own registration.
const FIRST_POSE: usize = 12_000;
/// Tolerance for the form error of the workpiece while a view finds its own pose: shift (mm) and rotation (rad).
const BEND_MM: f64 = 30e-3;
const BEND_RAD: f64 = 2e-3;
/// If the position is known worse than this fraction of the pitch, it is searched for.
const SEARCH_PITCH: f64 = 0.1;
/// A first pose is accepted if its last step was shorter than this, mm.
const NEARLY_MM: f64 = 10e-3;
/// A view whose points are farther from the CAD shows another part, mm.
const MOST_RMS_MM: f64 = 0.05;
/// A view with a smaller fraction of its points on the CAD shows another part, too.
const LEAST_SHARE: f64 = 0.6;
/// Up to this number of views the adjustment is updated at each one, then at every such number.
const EAGER_VIEWS: usize = 24;
const LAZY_VIEWS: usize = 12;

/// Stored data of a view.
#[derive(Clone, Debug, Default)]
pub(super) struct KeptView {
    /// Its points, in random order.
    pub points: Vec<ViewPoint>,
    /// Directions of the rays without a point: x and y at z = 1, camera frame.
    pub without_point: Vec<[f32; 2]>,
}

/// One view of a scan, decoded and registered by itself.
#[derive(Debug)]
pub(super) struct ScannedView {
    /// Its points and rays without a point.
    pub kept: KeptView,
    /// First pose, tool frame from camera frame.
    pub tool_from_camera: CameraPose,
    /// The registered view, or why it must not be used.
    pub laid: Result<LaidView, Reason>,
}

/// A view registered to the CAD.
#[derive(Debug)]
pub(crate) struct LaidView {
    /// Information on its pose, at the best pose given the other views at that time.
    pub information: ViewInformation,
    /// Its contribution to the map at this pose.
    pub cell_observations: Vec<CellObservation>,
    /// Its points on every flank at this pose.
    pub flanks: BTreeMap<(u32, Flank), FlankView>,
}

/// State of the compute thread.
pub(super) struct ViewScanner {
    tool: Arc<Tool>,
    gear: GearData,
    layout: Layout,
    decoder: Arc<Decoder>,
    plan: Arc<ViewPlan>,
    adjustment: Solution,
    /// Deviation of a single view from the common parameters.
    single: Local,
    field: FieldOfView,
    known: BTreeMap<usize, ViewInformation>,
}

impl ViewScanner {
    /// Starts with the views that are `known` from an earlier part of the scan.
    pub fn new(
        subject: &Subject,
        decoder: Arc<Decoder>,
        plan: Arc<ViewPlan>,
        known: BTreeMap<usize, ViewInformation>,
    ) -> Result<Self, EvaluatorError> {
        let what = "[gear] in the tool file";
        let gear = subject.tool.gear.as_ref();
        let gear = gear.ok_or(EvaluatorError::Missing { what })?;
        let nominal = Stages::nominal(hand_eye(subject)?);
        let single = subject.station.stages.of_single_view();
        let mut scanner = Self {
            tool: Arc::clone(&subject.tool),
            layout: layout(gear),
            gear: gear.clone(),
            decoder,
            plan,
            adjustment: Solution::prior(nominal, single),
            single,
            field: FieldOfView::of(&subject.head)?,
            known,
        };
        scanner.solve();
        Ok(scanner)
    }

    /// Decodes a view and registers it to the CAD.
    pub fn scan(&mut self, view: usize, sums: &Accumulator) -> ScannedView {
        let decoded = self.decoder.finish(sums);
        let decoded = decoded.map_err(|error| Reason::instrument(Code::Decoding, error));
        let decoded = decoded.and_then(|view| match exposures_disagree(&view) {
            Some(why) => Err(why),
            None => Ok(view),
        });
        let decoded_view = match decoded {
            Ok(decoded) => decoded,
            Err(why) => {
                let expected = self.adjustment.predict((&self.plan.views[view]).into());
                return ScannedView {
                    kept: KeptView::default(),
                    tool_from_camera: Rigid::from_isometry(*expected.tool_from_cloud.isometry()),
                    laid: Err(why),
                };
            }
        };
        let decoded = &decoded_view.cloud;
        let (order, dropped) = fair_order(&decoded.points_mm);
        let without_point = rays_without_point(&self.decoder, &decoded_view, &dropped)
            .map(|[x, y, z]| [(x / z) as f32, (y / z) as f32])
            .collect();
        let points: Vec<ViewPoint> = order
            .iter()
            .map(|&at| {
                let [x, y, z] = decoded.points_mm[at].map(|c| c as f32);
                [x, y, z, decoded.sigma_z_mm[at], decoded.fringes_dn[at]]
            })
            .collect();
        self.lay_on(
            view,
            KeptView {
                points,
                without_point,
            },
        )
    }

    /// Registers points with known positions (camera frame) and uncertainties, but without frames. They have no fringe
    /// modulation, and a ray of the head without a point within half a cell counts as unmeasured.
    pub fn lay_cloud(
        &mut self,
        view: usize,
        points_mm: &[[f64; 3]],
        sigma_mm: &[f32],
    ) -> ScannedView {
        let (order, _) = fair_order(points_mm);
        let points: Vec<ViewPoint> = order
            .iter()
            .map(|&at| {
                let [x, y, z] = points_mm[at].map(|c| c as f32);
                [x, y, z, sigma_mm[at], f32::NAN]
            })
            .collect();
        let without_point = rays_far_from(&self.decoder, &points);
        self.lay_on(
            view,
            KeptView {
                points,
                without_point,
            },
        )
    }

    /// Registers a view to the CAD, starting at the pose predicted from the stages and the earlier views.
    fn lay_on(&mut self, view: usize, kept: KeptView) -> ScannedView {
        let at = Pose::from(&self.plan.views[view]);
        let mut prior = self.adjustment.predict(at);
        let expected = prior.tool_from_cloud;
        let first = coordinates(&kept.points, FIRST_POSE);
        let surface = &self.tool.surface;
        let pitch_mm = self.gear.pitch_rad() * self.gear.pitch_radius_mm();
        let start =
            if place_sigma_mm(&prior.covariance, self.field.reach_mm) > SEARCH_PITCH * pitch_mm {
                search_phase(surface, &first, &expected, self.gear.teeth)
            } else {
                expected
            };
        let bend = [BEND_RAD, BEND_RAD, BEND_RAD, BEND_MM, BEND_MM, BEND_MM].map(|s| s * s);
        prior.covariance += Matrix6::from_diagonal(&Vector6::from(bend));
        let options = Options {
            initial: start,
            prior: Some(prior),
            teeth: Some(self.gear.teeth),
            ..Options::default()
        };
        let registration = register(surface, &first, None, &options);
        let tool_from_camera = Rigid::from_isometry(*registration.tool_from_cloud.isometry());
        let sample = coordinates(&kept.points, SAMPLE);
        let information = compress(surface, &sample, at, tool_from_camera);
        let laid = match (&registration.status, information) {
            (Status::Indeterminate(reason), _) if !nearly_settled(reason) => {
                Err(Reason::instrument(reason.into(), reason))
            }
            (_, None) => Err(off_cad("no point lies on the CAD")),
            (_, Some(information)) => match unlike_cad(&information) {
                Some(why) => Err(why),
                None => Ok(self.lay(view, information, &kept)),
            },
        };
        ScannedView {
            kept,
            tool_from_camera,
            laid,
        }
    }

    /// Adds a view to the adjustment, and registers its points at the resulting pose.
    fn lay(&mut self, view: usize, information: ViewInformation, kept: &KeptView) -> LaidView {
        self.known.insert(view, information.clone());
        if self.known.len() <= EAGER_VIEWS || self.known.len().is_multiple_of(LAZY_VIEWS) {
            self.solve();
        }
        let settled = self.adjustment.settle(&information);
        let tool_from_camera = settled.unwrap_or(information.tool_from_camera);
        let laid = Laid::new(&self.tool.surface, tool_from_camera, kept);
        let information = laid.information(information.at).unwrap_or(information);
        self.known.insert(view, information.clone());
        LaidView {
            cell_observations: laid.cell_observations(&self.layout),
            flanks: laid.flanks(&self.gear, self.field.range_mm),
            information,
        }
    }

    fn solve(&mut self) {
        let views: Vec<ViewInformation> = self.known.values().cloned().collect();
        // If the solution fails, the prediction stays unchanged; the final solution reports the error.
        if let Ok(adjustment) = solve(&self.adjustment.stages, &views, &[], self.single) {
            self.adjustment = adjustment;
        }
    }
}

/// The points without outliers, in a reproducible random order, so that the first thousand are a fair sample; and the outliers.
fn fair_order(points_mm: &[[f64; 3]]) -> (Vec<usize>, Vec<usize>) {
    let kept = outlier::statistical(points_mm, OUTLIER_NEIGHBOURS, OUTLIER_RATIO);
    let (mut order, dropped): (Vec<usize>, Vec<usize>) =
        (0..points_mm.len()).partition(|&i| kept.get(i).copied().unwrap_or(false));
    order.sort_unstable_by_key(|&i| (i as u32).wrapping_mul(0x9E37_79B9));
    (order, dropped)
}

/// Directions of the head's rays without a point within half a cell, at z = 1.
fn rays_far_from(decoder: &Decoder, points: &[ViewPoint]) -> Vec<[f32; 2]> {
    let directions = (0..).map_while(|cell| decoder.direction(cell));
    let rays: Vec<[f64; 3]> = directions.map(|[x, y]| [x, y, 0.0]).collect();
    let seen: Vec<[f64; 3]> = coordinates(points, points.len())
        .iter()
        .map(|[x, y, z]| [x / z, y / z, 0.0])
        .collect();
    let far = match SampleTree::new(&seen) {
        Ok(tree) => tree.distances(&rays, Order::Infinity),
        // The cloud has no points.
        Err(_) => vec![f64::INFINITY; rays.len()],
    };
    let is_without = |(_, far): &(&[f64; 3], &f64)| **far > 0.5 * decoder.cell_by_depth();
    let without = rays.iter().zip(&far).filter(is_without);
    without
        .map(|([x, y, _], _)| [*x as f32, *y as f32])
        .collect()
}

/// Whether a view's registration converged to within some µm: at a rim, points enter and leave with every step. The adjustment
/// continues from there.
fn nearly_settled(reason: &registration::RegistrationFailure) -> bool {
    matches!(reason, registration::RegistrationFailure::NotConverged { step_mm, .. } if *step_mm < NEARLY_MM)
}

/// Reason for a view that does not fit the CAD.
pub(super) fn off_cad(sentence: impl std::fmt::Display) -> Reason {
    Reason::instrument(Code::OffCad, sentence)
}

/// Why a view cannot show this part of the CAD.
pub(super) fn unlike_cad(view: &ViewInformation) -> Option<Reason> {
    // NaN does not fit.
    let fits = view.rms_mm <= MOST_RMS_MM && view.share >= LEAST_SHARE;
    (!fits).then(|| {
        off_cad(format_args!(
            "the points do not fit the CAD: {:.0} % of them lie on it with {:.0} µm rms; at least {:.0} % and at most {:.0} µm are needed",
            Number(100.0 * view.share),
            Number(1e3 * view.rms_mm),
            100.0 * LEAST_SHARE,
            1e3 * MOST_RMS_MM,
        ))
    })
}

/// The first `most` points, mm.
pub(super) fn coordinates(points: &[ViewPoint], most: usize) -> Vec<[f64; 3]> {
    points
        .iter()
        .take(most)
        .map(|&[x, y, z, ..]| [x, y, z].map(f64::from))
        .collect()
}

/// Uncertainty of the position that the head looks at, mm.
fn place_sigma_mm(covariance: &Matrix6<f64>, reach_mm: f64) -> f64 {
    let turn: f64 = (0..3).map(|i| covariance[(i, i)]).sum();
    let shift: f64 = (3..6).map(|i| covariance[(i, i)]).sum();
    (turn * reach_mm * reach_mm + shift).sqrt()
}
