//! Stitches all views of a session to one map: adjustment, repeated registration to the CAD until convergence, and a weighted merge.
//!
//! Work that needs all points of a view was done after its capture. Here the adjustment uses the views' 6x6 information and a
//! sample of their points, and the cells of each view move with it; only a view that moved far is registered to the CAD again.
//! After convergence, the relative poses of overlapping views are included.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use flankscope_metrology::multiview::adjustment::{
    CameraPose, Local, Overlap, Solution, Stages, ViewInformation, compress, solve,
};
use flankscope_metrology::multiview::cylinder::{
    CellObservation, CylinderMap, FieldQuality, Layout,
};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Reason;
use nalgebra::Point3;
use rayon::prelude::*;

use super::cell_observations::Laid;
use super::job::ScanError;
use super::overlaps::{overlaps, steps};
use super::patches::Patches;
use super::session::{Session, SessionError};
use super::view::{SAMPLE, coordinates, off_cad, unlike_cad};
use crate::plan::{FieldOfView, ViewPlan};
use flankscope_article::{JointSolve, MethodResult};
use flankscope_metrology::view::PlannedView;
use flankscope_record::document::scan::Steps;

/// Largest number of rounds of solving and registration, in both phases: for every view alone, then with neighbours.
const MOST_ROUNDS: usize = 6;
/// A view that moved less than this across the axis need not be registered again, mm: its information is linear to a few nm.
const SETTLED_MM: f64 = 1e-3;
/// A view that moved more than this across the axis is registered again with all its points, mm.
const RELAY_MM: f64 = 10e-3;

/// Cell layout and tolerances for the adjustment.
pub(super) struct Frame {
    /// Cells of the unrolled bore.
    pub layout: Layout,
    pub field: FieldOfView,
    /// Deviation of a single view from the common parameters.
    pub single: Local,
}

/// Views that were registered to the CAD together.
pub(super) struct Stitched {
    /// Views used, with their information.
    pub views: Vec<(usize, ViewInformation)>,
    /// Views that do not fit the others, with reasons.
    pub refused: Vec<(usize, Reason)>,
    pub adjustment: Solution,
    pub rounds: usize,
    pub settled: bool,
    /// Steps between neighbours, before and after the overlaps were used.
    pub steps: Steps,
    /// Number of views that were registered again.
    pub relaid: usize,
    pub map: CylinderMap,
    /// For every view, root mean square of its cells' deviations from the form of the whole bore, mm; `None` if the map has no
    /// form, or the view no cell.
    pub rms_about_form_mm: Vec<Option<f64>>,
    pub quality: FieldQuality,
    /// Duration of each step, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

impl Stitched {
    /// The part that the article's figures and comparison use.
    pub fn solve(&self) -> JointSolve<'_> {
        JointSolve {
            views: &self.views,
            adjustment: &self.adjustment,
            rms_about_form_mm: &self.rms_about_form_mm,
            map: &self.map,
        }
    }

    /// Figures of both methods for it.
    pub fn figures(
        &self,
        session: &Session,
        tool: &Tool,
        planned: &[PlannedView],
        took: Duration,
    ) -> Result<MethodResult, SessionError> {
        let sample = match self.views.first() {
            Some((view, _)) => coordinates(&session.points(*view)?.points, SAMPLE),
            None => Vec::new(),
        };
        let solve = self.solve();
        Ok(MethodResult::of_surface(
            solve, &sample, tool, planned, took,
        ))
    }
}

/// The information of finished views, each at its first pose.
pub(super) fn first_information(
    session: &Session,
    tool: &Tool,
    plan: &ViewPlan,
) -> Result<BTreeMap<usize, ViewInformation>, ScanError> {
    let done: Vec<usize> = session.views().map(|(view, _)| view).collect();
    let found = done.into_par_iter().map(|view| {
        let Some(pose) = session.pose(view).filter(|_| view < plan.views.len()) else {
            return Ok(None);
        };
        let sample = coordinates(&session.sample(view, SAMPLE)?, SAMPLE);
        let at = (&plan.views[view]).into();
        Ok(compress(&tool.surface, &sample, at, pose).map(|info| (view, info)))
    });
    let found: Result<Vec<_>, ScanError> = found.collect();
    Ok(found?.into_iter().flatten().collect())
}

/// Stitches views, starting at their first poses.
pub(super) fn stitch(
    session: &Session,
    patches: &mut Patches,
    first: BTreeMap<usize, ViewInformation>,
    tool: &Tool,
    nominal: &Stages,
    frame: &Frame,
) -> Result<Stitched, ScanError> {
    let layout = frame.layout;
    let mut elapsed_ms = BTreeMap::new();
    let mut clock = Instant::now();
    let mut lap = |what| {
        elapsed_ms.insert(what, clock.elapsed().as_secs_f64() * 1e3);
        clock = Instant::now();
    };
    let mut common = Common::new(session, tool, first, nominal, frame)?;
    common.settle(|_| Ok(Vec::new()))?;
    lap("solve");
    let relaid = common.lay(patches, &layout)?;
    lap("lay");
    let (alone, sure) = (common.poses(), common.adjustment.clone());
    let pairs =
        common.settle(|views| overlaps(patches, &layout, views, &alone, frame.field.width_mm))?;
    let Common {
        views,
        adjustment,
        refused,
        rounds,
        settled,
        ..
    } = common;
    let steps = steps(&pairs, &views, &alone, &adjustment);
    let adjustment = adjustment.no_surer_than(&sure);
    lap("overlaps");
    let of_views = |take: &mut dyn FnMut(&CameraPose, Vec<CellObservation>)| {
        for ((view, _), pose) in views.iter().zip(&adjustment.poses) {
            take(pose, patches.moved_to(*view, pose, &layout)?);
        }
        Ok::<_, SessionError>(())
    };
    let (map, quality) = merge(layout, frame.field.slope, of_views)?;
    let form = map.form();
    let mut rms_about_form_mm = Vec::with_capacity(views.len());
    of_views(&mut |_, view| {
        let form = form.filter(|_| !view.is_empty());
        rms_about_form_mm.push(form.map(|form| {
            let off_mm = |w: &CellObservation| {
                let form_mm = form.deviation_mm(w.point.map(f64::from), w.normal.map(f64::from));
                f64::from(w.deviation_mm) - form_mm
            };
            let squares: f64 = view.iter().map(|w| off_mm(w).powi(2)).sum();
            (squares / view.len() as f64).sqrt()
        }));
    })?;
    lap("merge");
    Ok(Stitched {
        views,
        refused,
        adjustment,
        rounds,
        settled,
        steps,
        relaid,
        map,
        rms_about_form_mm,
        quality,
        elapsed_ms,
    })
}

/// The registered views with their common parameters, before convergence.
struct Common<'a> {
    session: &'a Session,
    tool: &'a Tool,
    frame: &'a Frame,
    views: Vec<(usize, ViewInformation)>,
    adjustment: Solution,
    refused: Vec<(usize, Reason)>,
    rounds: usize,
    settled: bool,
}

impl<'a> Common<'a> {
    fn new(
        session: &'a Session,
        tool: &'a Tool,
        first: BTreeMap<usize, ViewInformation>,
        nominal: &Stages,
        frame: &'a Frame,
    ) -> Result<Self, ScanError> {
        let views: Vec<(usize, ViewInformation)> = first.into_iter().collect();
        Ok(Self {
            session,
            tool,
            frame,
            adjustment: solved(&views, &[], nominal, frame)?,
            views,
            refused: Vec::new(),
            rounds: 1,
            settled: false,
        })
    }

    /// Registers the views at the poses of the solution and solves again, including overlaps, until convergence. Returns the
    /// overlaps of the last round.
    fn settle(
        &mut self,
        overlaps: impl Fn(&[(usize, ViewInformation)]) -> Result<Vec<Overlap>, SessionError>,
    ) -> Result<Vec<Overlap>, ScanError> {
        let mut pairs = Vec::new();
        self.settled = false;
        for _ in 0..MOST_ROUNDS {
            let (laid, dropped) = laid_anew(self, &self.views, &self.adjustment)?;
            // A view that drops out changes the others, so another round is needed.
            let whole = dropped.is_empty();
            self.refused.extend(dropped);
            pairs = overlaps(&laid)?;
            self.adjustment = solved(&laid, &pairs, &self.adjustment.stages, self.frame)?;
            self.views = laid;
            self.rounds += 1;
            let moved = |((_, info), pose): (&(usize, ViewInformation), &CameraPose)| {
                self.moved_mm(info, &info.tool_from_camera, pose)
            };
            self.settled = whole
                && self
                    .views
                    .iter()
                    .zip(&self.adjustment.poses)
                    .map(moved)
                    .all(|mm| mm < SETTLED_MM);
            if self.settled {
                break;
            }
        }
        Ok(pairs)
    }

    /// Registers views that moved far again with all their points; returns their number.
    fn lay(&self, patches: &mut Patches, layout: &Layout) -> Result<usize, SessionError> {
        let mut relaid = 0;
        for ((view, info), pose) in self.views.iter().zip(&self.adjustment.poses) {
            let moved = patches
                .pose(*view)
                .map(|was| self.moved_mm(info, was, pose));
            if moved.is_none_or(|mm| mm > RELAY_MM) {
                let kept = self.session.points(*view)?;
                let laid = Laid::new(&self.tool.surface, *pose, &kept);
                let flanks = match &self.tool.gear {
                    Some(gear) => laid.flanks(gear, self.frame.field.range_mm),
                    None => BTreeMap::new(),
                };
                patches.keep(*view, *pose, &laid.cell_observations(layout), &flanks)?;
                relaid += 1;
            }
        }
        Ok(relaid)
    }

    /// Largest motion of any part of a view across the axis between two poses, mm. Motion along the axis has no effect, because
    /// the teeth are straight.
    fn moved_mm(&self, info: &ViewInformation, from: &CameraPose, to: &CameraPose) -> f64 {
        let to_edge_mm = 0.5 * self.frame.field.width_mm;
        let centre = Point3::from(info.centre_mm);
        let motion = to.isometry() * from.isometry().inverse();
        (motion * centre - centre).xy().norm() + motion.rotation.angle() * to_edge_mm
    }

    /// Pose of every view, by its number.
    fn poses(&self) -> BTreeMap<usize, CameraPose> {
        let views = self.views.iter().zip(&self.adjustment.poses);
        views.map(|((view, _), pose)| (*view, *pose)).collect()
    }
}

/// Merges views weighted by their noise, estimates from the result the calibration error in each part of the field, and merges
/// again weighted by both.
fn merge(
    layout: Layout,
    field_slope: f64,
    of_views: impl Fn(&mut dyn FnMut(&CameraPose, Vec<CellObservation>)) -> Result<(), SessionError>,
) -> Result<(CylinderMap, FieldQuality), SessionError> {
    let in_camera = |pose: &CameraPose, observation: &CellObservation| -> [f64; 3] {
        let point = Point3::from(observation.point.map(f64::from));
        pose.isometry().inverse_transform_point(&point).into()
    };
    let mut by_noise = CylinderMap::new(layout);
    of_views(&mut |_, view| by_noise.add_view(&view, |_| 0.0))?;
    let mut quality = FieldQuality::new(field_slope);
    of_views(&mut |pose, view| quality.add_view(&by_noise, &view, |w| in_camera(pose, w)))?;
    let mut map = CylinderMap::new(layout);
    of_views(&mut |pose, view| {
        map.add_view(&view, |w| quality.variance_mm2(in_camera(pose, w)));
    })?;
    Ok((map, quality))
}

fn solved(
    views: &[(usize, ViewInformation)],
    overlaps: &[Overlap],
    start: &Stages,
    frame: &Frame,
) -> Result<Solution, ScanError> {
    let views: Vec<ViewInformation> = views.iter().map(|(_, info)| info.clone()).collect();
    Ok(solve(start, &views, overlaps, frame.single)?)
}

type LaidAnew = (Vec<(usize, ViewInformation)>, Vec<(usize, Reason)>);

/// The moved views with their samples registered at the poses of the solution; and those that do not fit there, with reasons.
fn laid_anew(
    common: &Common<'_>,
    views: &[(usize, ViewInformation)],
    adjustment: &Solution,
) -> Result<LaidAnew, SessionError> {
    let fits: Result<Vec<_>, SessionError> = views
        .par_iter()
        .zip(&adjustment.poses)
        .map(|((view, info), pose)| {
            if common.moved_mm(info, &info.tool_from_camera, pose) < SETTLED_MM {
                return Ok((*view, Ok(info.clone())));
            }
            let sample = coordinates(&common.session.sample(*view, SAMPLE)?, SAMPLE);
            let laid = match compress(&common.tool.surface, &sample, info.at, *pose) {
                None => Err(off_cad("no point lies on the CAD")),
                Some(info) => unlike_cad(&info).map_or(Ok(info), Err),
            };
            Ok((*view, laid))
        })
        .collect();
    let (mut laid, mut refused) = (Vec::new(), Vec::new());
    for (view, fit) in fits? {
        match fit {
            Ok(info) => laid.push((view, info)),
            Err(why) => refused.push((view, why)),
        }
    }
    Ok((laid, refused))
}
