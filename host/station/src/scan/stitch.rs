//! All views of a session to one map: joint solve, laid on the CAD anew until nothing moves, merged by quality.
//!
//! What needs all points of a view was done when it was captured. Here the joint solve works on the views' 6x6 information and
//! a sample of their points, and the cells of each view are moved with it to where it ends; only a view that moved far is
//! laid on the CAD again. Once the views lie well, what neighbours say of each other joins in.

use std::collections::BTreeMap;
use std::time::Instant;

use flankscope_metrology::multiview::adjustment::{
    Local, Overlap, Solution, Stages, ViewInformation, compress, solve,
};
use flankscope_metrology::multiview::cylinder::{
    CellObservation, CylinderMap, FieldQuality, Layout,
};
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use nalgebra::{Isometry3, Point3};
use rayon::prelude::*;

use super::job::ScanError;
use super::lay::Laid;
use super::overlaps::{Steps, overlaps};
use super::patches::Patches;
use super::session::{Session, SessionError};
use super::view::{SAMPLE, coordinates, place, unlike_cad};
use crate::inspection::{EvaluatorError, Itinerary, field_slope, reach_mm};

/// Rounds of solving and laying on, each time: for every view alone, then for neighbours together.
const MOST_ROUNDS: usize = 6;
/// A view that moved across the axis by less than this need not be laid on anew, mm: its information is linear to some nm.
const SETTLED_MM: f64 = 1e-3;
/// A view that moved across the axis by more is laid on the CAD again with all its points, mm.
const RELAY_MM: f64 = 10e-3;
/// From the middle of a view to its edge, about, mm.
const FIELD_MM: f64 = 5.0;

/// Views that were laid on the CAD together.
pub(super) struct Stitched {
    /// Views that took part, with how they lie.
    pub views: Vec<(usize, ViewInformation)>,
    /// Views that do not fit the others.
    pub refused: Vec<(usize, String)>,
    pub joint: Solution,
    pub rounds: usize,
    pub settled: bool,
    /// How far apart neighbours lie, before and after that counts.
    pub steps: Steps,
    /// Views that were laid on the CAD once more.
    pub relaid: usize,
    pub map: CylinderMap,
    /// Of every view, root mean square of its cells' deviations about the form of the whole bore, mm; none where the map has
    /// no form, or the view no cell.
    pub rms_about_form_mm: Vec<Option<f64>>,
    pub quality: FieldQuality,
    /// Time of each part, ms.
    pub elapsed_ms: BTreeMap<&'static str, f64>,
}

/// The information of views that are done, each at its first pose.
pub(super) fn first_information(
    session: &Session,
    tool: &Tool,
    itinerary: &Itinerary,
) -> Result<BTreeMap<usize, ViewInformation>, ScanError> {
    let done: Vec<usize> = session.views().map(|(view, _)| view).collect();
    let found = done.into_par_iter().map(|view| {
        let Some(pose) = session.pose(view).filter(|_| view < itinerary.views.len()) else {
            return Ok(None);
        };
        let sample = coordinates(&session.sample(view, SAMPLE)?, SAMPLE);
        let at = place(itinerary, view);
        Ok(compress(&tool.surface, &sample, at, pose).map(|info| (view, info)))
    });
    let found: Result<Vec<_>, ScanError> = found.collect();
    Ok(found?.into_iter().flatten().collect())
}

/// What stitching asks of the head.
#[derive(Clone, Copy, Debug)]
pub(super) struct Optics {
    /// Half the field's width per distance.
    pub field_slope: f64,
    /// Nearest and farthest distance at which it measures, mm.
    pub reach_mm: [f64; 2],
}

impl Optics {
    /// # Errors
    /// The head file has no volume.
    pub fn of(head: &HeadModel) -> Result<Self, EvaluatorError> {
        Ok(Self {
            field_slope: field_slope(head),
            reach_mm: reach_mm(head)?,
        })
    }
}

/// Stitches views, as each was laid on first.
pub(super) fn stitch(
    session: &Session,
    patches: &mut Patches,
    first: BTreeMap<usize, ViewInformation>,
    tool: &Tool,
    nominal: &Stages,
    layout: Layout,
    optics: Optics,
) -> Result<Stitched, ScanError> {
    let mut elapsed_ms = BTreeMap::new();
    let mut clock = Instant::now();
    let mut lap = |what| {
        elapsed_ms.insert(what, clock.elapsed().as_secs_f64() * 1e3);
        clock = Instant::now();
    };
    let mut common = Common::new(session, tool, first, nominal)?;
    common.settle(|_| Ok(Vec::new()))?;
    lap("solve");
    let relaid = common.lay(patches, &layout, optics.reach_mm)?;
    lap("lay");
    let (alone, sure) = (common.poses(), common.joint.clone());
    let pairs = common.settle(|views| overlaps(patches, &layout, views, &alone))?;
    let Common {
        views,
        joint,
        refused,
        rounds,
        settled,
        ..
    } = common;
    let steps = Steps::of(&pairs, &views, &alone, &joint);
    let joint = joint.no_surer_than(&sure);
    lap("overlaps");
    let of_views = |take: &mut dyn FnMut(&Isometry3<f64>, Vec<CellObservation>)| {
        for ((view, _), pose) in views.iter().zip(&joint.poses) {
            take(pose, patches.moved_to(*view, pose, &layout)?);
        }
        Ok::<_, SessionError>(())
    };
    let (map, quality) = merge(layout, optics.field_slope, of_views)?;
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
        joint,
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

/// The views on the CAD with what they share, on the way to where nothing moves.
struct Common<'a> {
    session: &'a Session,
    tool: &'a Tool,
    views: Vec<(usize, ViewInformation)>,
    joint: Solution,
    refused: Vec<(usize, String)>,
    rounds: usize,
    settled: bool,
}

impl<'a> Common<'a> {
    fn new(
        session: &'a Session,
        tool: &'a Tool,
        first: BTreeMap<usize, ViewInformation>,
        nominal: &Stages,
    ) -> Result<Self, ScanError> {
        let views: Vec<(usize, ViewInformation)> = first.into_iter().collect();
        Ok(Self {
            session,
            tool,
            joint: solved(&views, &[], nominal)?,
            views,
            refused: Vec::new(),
            rounds: 1,
            settled: false,
        })
    }

    /// Lays the views on the CAD where the solution puts them and solves again, with what they then say of each other, until
    /// nothing moves. Returns the overlaps of the last round.
    fn settle(
        &mut self,
        overlaps: impl Fn(&[(usize, ViewInformation)]) -> Result<Vec<Overlap>, SessionError>,
    ) -> Result<Vec<Overlap>, ScanError> {
        let mut pairs = Vec::new();
        self.settled = false;
        for _ in 0..MOST_ROUNDS {
            let (laid, dropped) = laid_anew(self.session, self.tool, &self.views, &self.joint)?;
            // A view that drops out moves the others: another round then.
            let whole = dropped.is_empty();
            self.refused.extend(dropped);
            pairs = overlaps(&laid)?;
            self.joint = solved(&laid, &pairs, &self.joint.stages)?;
            self.views = laid;
            self.rounds += 1;
            let moved = |((_, info), pose): (&(usize, ViewInformation), &Isometry3<f64>)| {
                moved_mm(info, &info.tool_from_camera, pose)
            };
            self.settled = whole
                && self
                    .views
                    .iter()
                    .zip(&self.joint.poses)
                    .map(moved)
                    .all(|mm| mm < SETTLED_MM);
            if self.settled {
                break;
            }
        }
        Ok(pairs)
    }

    /// Lays views that moved far on the CAD again with all their points; returns how many.
    fn lay(
        &self,
        patches: &mut Patches,
        layout: &Layout,
        reach_mm: [f64; 2],
    ) -> Result<usize, SessionError> {
        let mut relaid = 0;
        for ((view, info), pose) in self.views.iter().zip(&self.joint.poses) {
            let moved = patches.pose(*view).map(|was| moved_mm(info, was, pose));
            if moved.is_none_or(|mm| mm > RELAY_MM) {
                let kept = self.session.points(*view)?;
                let laid = Laid::new(&self.tool.surface, *pose, &kept);
                let flanks = match &self.tool.gear {
                    Some(gear) => laid.flanks(gear, reach_mm),
                    None => BTreeMap::new(),
                };
                patches.keep(*view, *pose, &laid.cell_observations(layout), &flanks)?;
                relaid += 1;
            }
        }
        Ok(relaid)
    }

    /// Where every view is, by its number.
    fn poses(&self) -> BTreeMap<usize, Isometry3<f64>> {
        let views = self.views.iter().zip(&self.joint.poses);
        views.map(|((view, _), pose)| (*view, *pose)).collect()
    }
}

/// Merges views by what their noise says first, learns from that what calibration adds in which part of the field, and merges
/// once more by both.
fn merge(
    layout: Layout,
    field_slope: f64,
    of_views: impl Fn(&mut dyn FnMut(&Isometry3<f64>, Vec<CellObservation>)) -> Result<(), SessionError>,
) -> Result<(CylinderMap, FieldQuality), SessionError> {
    let in_camera = |pose: &Isometry3<f64>, observation: &CellObservation| -> [f64; 3] {
        let point = Point3::from(observation.point.map(f64::from));
        pose.inverse_transform_point(&point).into()
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
) -> Result<Solution, ScanError> {
    let views: Vec<ViewInformation> = views.iter().map(|(_, info)| info.clone()).collect();
    Ok(solve(start, &views, overlaps, Local::default())?)
}

type LaidAnew = (Vec<(usize, ViewInformation)>, Vec<(usize, String)>);

/// Every view that moved, its sample laid on the surface where the solution puts it; and those that do not fit there, with
/// why.
fn laid_anew(
    session: &Session,
    tool: &Tool,
    views: &[(usize, ViewInformation)],
    joint: &Solution,
) -> Result<LaidAnew, SessionError> {
    let fits: Result<Vec<_>, SessionError> = views
        .par_iter()
        .zip(&joint.poses)
        .map(|((view, info), pose)| {
            if moved_mm(info, &info.tool_from_camera, pose) < SETTLED_MM {
                return Ok((*view, Ok(info.clone())));
            }
            let sample = coordinates(&session.sample(*view, SAMPLE)?, SAMPLE);
            let laid = match compress(&tool.surface, &sample, info.at, *pose) {
                None => Err("no point lies on the CAD".to_string()),
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

/// How far any part of a view moves across the axis from one pose to another, mm. A shift along it changes nothing: the teeth
/// are straight.
fn moved_mm(info: &ViewInformation, from: &Isometry3<f64>, to: &Isometry3<f64>) -> f64 {
    let centre = Point3::from(info.centre_mm);
    let motion = to * from.inverse();
    (motion * centre - centre).xy().norm() + motion.rotation.angle() * FIELD_MM
}
