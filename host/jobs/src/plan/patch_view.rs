//! Where the stages stand to look at a patch, and whether the head sees it from there.
//!
//! Two axes bring the middle of the head's volume to the middle of the patch's zone: a turn, and a lift. What is left between them
//! is how far the patch lies from the axis, which the head's place on the stage decides; whether the zone then lies in the head's
//! field and depth and faces it is checked here, before anything moves.

use flankscope_foundation::rigid::{Camera, Projector, Rigid, Stage};
use flankscope_metrology::patch::Patch;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::PlanningError;
use super::field::FieldOfView;
use flankscope_metrology::kinematics::tool_from_camera;
use flankscope_metrology::view::PlannedView;

/// A patch that turns farther away from the head than this is hardly lit, degrees from its normal. Flanks are seen at 60.
const MOST_SLANT_DEG: f64 = 75.0;
/// The head's windows stay so far from the CAD, mm.
const CLEAR_MM: f64 = 0.5;
/// The way is looked at in steps of so much, mm.
const STEP_MM: f64 = 1.0;

/// Why a patch cannot be looked at.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PatchViewError {
    /// No such patch, or one that is not judged.
    #[error("{got} is no patch that is judged; the tool file has {}", numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(", "))]
    NoSuchPatch {
        /// Asked for.
        got: u32,
        /// Those that are judged.
        numbers: Vec<u32>,
    },
    /// Too near or too far.
    #[error(
        "patch {name:?} lies outside the measuring volume: its zone is {:.2} to {:.2} mm from the camera, the head measures from {:.2} to {:.2} mm; \
         move the head (stage_from_camera of the head file) or the die nearer to or farther from the axis", depth_mm[0], depth_mm[1], volume_mm[0], volume_mm[1]
    )]
    Depth {
        /// Patch.
        name: String,
        /// Nearest and farthest corner of its zone.
        depth_mm: [f64; 2],
        /// Volume of the head.
        volume_mm: [f64; 2],
    },
    /// Larger than the field, or beside it.
    #[error(
        "patch {name:?}: its zone reaches {reach_mm:.2} mm from the middle of the head's field, which is {field_mm:.2} mm in radius there; \
         one view shows one patch: name several smaller ones"
    )]
    Field {
        /// Patch.
        name: String,
        /// Farthest corner.
        reach_mm: f64,
        /// The field's radius at its depth.
        field_mm: f64,
    },
    /// Turned away.
    #[error(
        "patch {name:?} faces away: the head sees it at {slant_deg:.0} degrees from its normal, at most {MOST_SLANT_DEG} are possible"
    )]
    TurnedAway {
        /// Patch.
        name: String,
        /// Angle between view and normal.
        slant_deg: f64,
    },
    /// The die is in the head's way.
    #[error(
        "the head's window comes within {off_mm:.1} mm of the CAD at ({:.1}, {:.1}, {:.1}) mm on its way through the views, {CLEAR_MM} mm are needed; \
         correct stage_from_camera of the head file, or name fewer patches", at_mm[0], at_mm[1], at_mm[2]
    )]
    InTheWay {
        /// Distance from the CAD, negative inside.
        off_mm: f64,
        /// Where, tool frame.
        at_mm: [f64; 3],
    },
}

/// Where the stages stand to have each of these patches in the middle of a view.
///
/// # Errors
/// A patch that is not judged, or that the head does not see.
pub(crate) fn nominal(
    tool: &Tool,
    head: &HeadModel,
    numbers: &[u32],
) -> Result<Vec<PlannedView>, PlanningError> {
    let eye = Eye::of(head)?;
    let view = |&number: &u32| {
        let patch = judged(tool, number)?;
        let [along, up] = patch.zone_mm.map(|[from, to]| 0.5 * (from + to));
        let middle = Point3::from(patch.point_mm([along, up]));
        let focus = Point3::from(eye.hand_eye.apply([0.0, 0.0, eye.field.reach_mm]));
        let planned = PlannedView {
            tooth: number,
            rotation_rad: focus.y.atan2(focus.x) - middle.y.atan2(middle.x),
            vertical_mm: middle.z - focus.z,
        };
        seen(patch, &planned, &eye)?;
        Ok(planned)
    };
    numbers.iter().map(view).collect()
}

/// Whether every view, from where the stages stood for it, shows the patch that it is said to be of.
///
/// # Errors
/// A patch that is not judged, or that the head does not see from there.
pub(crate) fn check_seen(
    tool: &Tool,
    head: &HeadModel,
    views: &[PlannedView],
) -> Result<(), PlanningError> {
    let eye = Eye::of(head)?;
    for view in views {
        seen(judged(tool, view.tooth)?, view, &eye)?;
    }
    Ok(())
}

/// What the head sees, and from where.
struct Eye {
    field: FieldOfView,
    volume_mm: [f64; 2],
    hand_eye: Rigid<Stage, Camera>,
}

impl Eye {
    fn of(head: &HeadModel) -> Result<Self, PlanningError> {
        let lacks = |what| PlanningError::HeadLacks { what };
        let volume = head.volume.ok_or(lacks("[volume]"))?;
        let hand_eye = head.stage_from_camera.ok_or(lacks("stage_from_camera"))?;
        Ok(Self {
            field: FieldOfView::of(head).map_err(|_| lacks("[volume]"))?,
            volume_mm: [volume.near_mm, volume.far_mm],
            hand_eye: hand_eye
                .rigid()
                .map_err(|_| lacks("stage_from_camera that is a rigid motion"))?,
        })
    }
}

fn judged(tool: &Tool, number: u32) -> Result<&Patch, PatchViewError> {
    let judged = tool.patches.get(number).filter(|patch| patch.is_judged());
    judged.ok_or_else(|| PatchViewError::NoSuchPatch {
        got: number,
        numbers: tool.patches.judged(),
    })
}

/// The zone lies in field and depth, and faces the head.
fn seen(patch: &Patch, planned: &PlannedView, eye: &Eye) -> Result<(), PatchViewError> {
    let Eye {
        field,
        volume_mm,
        hand_eye,
    } = eye;
    let name = || patch.name.clone();
    let pose = *tool_from_camera(planned.rotation_rad, planned.vertical_mm, *hand_eye).isometry();
    let camera = Vector3::from(pose.translation.vector);
    let [alongs, ups] = patch.zone_mm;
    let corners = alongs.map(|along| ups.map(|up| patch.point_mm([along, up])));
    let corners: Vec<Vector3<f64>> = corners
        .as_flattened()
        .iter()
        .map(|&corner| (pose.inverse() * Point3::from(corner)).coords)
        .collect();
    let depths = corners.iter().map(|corner| corner.z);
    let (near, far) = depths.fold((f64::INFINITY, f64::NEG_INFINITY), |(near, far), z| {
        (near.min(z), far.max(z))
    });
    if near < volume_mm[0] || far > volume_mm[1] {
        return Err(PatchViewError::Depth {
            name: name(),
            depth_mm: [near, far],
            volume_mm: *volume_mm,
        });
    }
    for corner in &corners {
        let (reach_mm, field_mm) = (corner.x.hypot(corner.y), field.slope * corner.z);
        if reach_mm > field_mm {
            return Err(PatchViewError::Field {
                name: name(),
                reach_mm,
                field_mm,
            });
        }
    }
    let [along, up] = patch.zone_mm.map(|[from, to]| 0.5 * (from + to));
    let towards = camera - Vector3::from(patch.point_mm([along, up]));
    let cosine = towards.normalize().dot(&Vector3::from(patch.axes[2]));
    let slant_deg = cosine.clamp(-1.0, 1.0).acos().to_degrees();
    if slant_deg > MOST_SLANT_DEG {
        return Err(PatchViewError::TurnedAway {
            name: name(),
            slant_deg,
        });
    }
    Ok(())
}

/// The head's windows clear the CAD wherever both axes may be between the views and above them: each may be anywhere on its way
/// while the other is.
///
/// # Errors
/// They do not.
pub(crate) fn check_way(
    tool: &Tool,
    views: &[PlannedView],
    out_mm: f64,
    hand_eye: Rigid<Stage, Camera>,
    projectors_from_camera: &[Rigid<Projector, Camera>],
) -> Result<(), PatchViewError> {
    let camera = hand_eye.isometry();
    let projectors = projectors_from_camera.iter();
    let projectors = projectors.map(|pose| camera * pose.isometry().inverse());
    let span = |of: fn(&PlannedView) -> f64| {
        let values = views.iter().map(of);
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
            [low.min(x), high.max(x)]
        })
    };
    let turns = span(|view| view.rotation_rad);
    let [low_mm, high_mm] = span(|view| view.vertical_mm);
    let steps = |[from, to]: [f64; 2], length: f64| {
        let count = (length / STEP_MM).ceil().max(1.0) as u32;
        (0..=count).map(move |i| from + (to - from) * f64::from(i) / f64::from(count))
    };
    for window in std::iter::once(*camera).chain(projectors) {
        let window = window.translation.vector;
        let out_mm = high_mm.max(out_mm);
        let around_mm = window.x.hypot(window.y) * (turns[1] - turns[0]);
        for turn in steps(turns, around_mm) {
            let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn);
            for lift in steps([low_mm, out_mm], out_mm - low_mm) {
                let at_mm: [f64; 3] = (turned * (window + Vector3::z() * lift)).into();
                let off_mm = tool.surface.closest(at_mm).signed_distance_mm;
                if off_mm < CLEAR_MM {
                    return Err(PatchViewError::InTheWay { off_mm, at_mm });
                }
            }
        }
    }
    Ok(())
}
