//! All views of a session to one map: joint solve, laid on the CAD anew until nothing moves, merged by quality.

use flankscope_metrology::cylinder::{CylinderMap, Layout};
use flankscope_metrology::joint::{Local, Solution, Stages, ViewInformation, compress, solve};
use flankscope_metrology::tool::Tool;
use nalgebra::{Isometry3, Point3};

use super::job::ScanError;
use super::session::Session;
use super::view::{Kept, SAMPLE, coordinates, place, unlike_cad};
use crate::inspection::Itinerary;

/// Rounds of solving and laying on.
const MOST_ROUNDS: usize = 6;
/// Poses that move less than this have settled, mm.
const SETTLED_MM: f64 = 0.1e-3;
/// Cells around per tooth, and their height, mm.
const COLUMNS_PER_TOOTH: usize = 24;
const ROW_MM: f64 = 0.25;

/// Views that were laid on the CAD together.
pub(super) struct Stitched {
    /// Views that took part, with how they lie.
    pub views: Vec<(usize, ViewInformation)>,
    /// Views that do not fit the others.
    pub refused: Vec<(usize, String)>,
    pub joint: Solution,
    pub rounds: usize,
    pub settled: bool,
    pub map: CylinderMap,
}

/// The information of views that are done, each at its first pose.
pub(super) fn first_information(
    session: &Session,
    tool: &Tool,
    itinerary: &Itinerary,
) -> Result<Vec<(usize, ViewInformation)>, ScanError> {
    let mut found = Vec::new();
    for (view, _) in session.views() {
        let Some(pose) = session.pose(view).filter(|_| view < itinerary.views.len()) else {
            continue;
        };
        let sample = coordinates(&session.points(view)?, SAMPLE);
        let at = place(itinerary, view);
        found.extend(compress(&tool.surface, &sample, at, pose).map(|info| (view, info)));
    }
    Ok(found)
}

/// Stitches the session's views.
pub(super) fn stitch(
    session: &Session,
    tool: &Tool,
    itinerary: &Itinerary,
    nominal: &Stages,
    height_mm: [f64; 2],
    teeth: u32,
) -> Result<Stitched, ScanError> {
    let mut views = first_information(session, tool, itinerary)?;
    let solved = |views: &[(usize, ViewInformation)], start: &Stages| {
        let informations: Vec<ViewInformation> =
            views.iter().map(|(_, info)| info.clone()).collect();
        solve(start, &informations, Local::default())
    };
    let mut joint = solved(&views, nominal)?;
    let mut refused = Vec::new();
    let (mut rounds, mut settled) = (1, false);
    while rounds < MOST_ROUNDS && !settled {
        let mut laid = Vec::with_capacity(views.len());
        for ((view, info), pose) in views.iter().zip(&joint.poses) {
            let sample = coordinates(&session.points(*view)?, SAMPLE);
            match compress(&tool.surface, &sample, info.at, *pose) {
                None => refused.push((*view, "no point lies on the CAD".to_string())),
                Some(info) => match unlike_cad(&info) {
                    Some(why) => refused.push((*view, why)),
                    None => laid.push((*view, info)),
                },
            }
        }
        let next = solved(&laid, &joint.stages)?;
        // A view that dropped out moves the others: another round then.
        settled = laid.len() == views.len()
            && laid
                .iter()
                .zip(&next.poses)
                .all(|((_, info), pose)| moved_mm(info, pose) < SETTLED_MM);
        (views, joint) = (laid, next);
        rounds += 1;
    }
    let mut map = empty_map(height_mm, teeth);
    for ((view, _), pose) in views.iter().zip(&joint.poses) {
        let points = session.points(*view)?;
        let located: Vec<[f64; 3]> = points.iter().map(|p| located(pose, p)).collect();
        let sigma: Vec<f32> = points.iter().map(|p| p[3]).collect();
        map.add_view(&tool.surface.closest_many(&located), &sigma);
    }
    Ok(Stitched {
        views,
        refused,
        joint,
        rounds,
        settled,
        map,
    })
}

/// The unrolled bore with nothing seen of it yet.
pub(super) fn empty_map(height_mm: [f64; 2], teeth: u32) -> CylinderMap {
    CylinderMap::new(Layout {
        columns: COLUMNS_PER_TOOTH * teeth as usize,
        rows: ((height_mm[1] - height_mm[0]) / ROW_MM)
            .ceil()
            .clamp(1.0, 1e4) as usize,
        height_mm,
    })
}

fn located(pose: &Isometry3<f64>, &[x, y, z, ..]: &Kept) -> [f64; 3] {
    (pose * Point3::new(f64::from(x), f64::from(y), f64::from(z))).into()
}

/// How far the middle of a view moves from where it was laid on to `pose`, mm.
fn moved_mm(info: &ViewInformation, pose: &Isometry3<f64>) -> f64 {
    let centre = Point3::from(info.centre_mm);
    let here = pose * info.tool_from_camera.inverse_transform_point(&centre);
    (here - centre).norm()
}
