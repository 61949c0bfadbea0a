//! Positions of the stages for viewing a patch, and a check that the head sees it from there.
//!
//! Two axes, rotation and height, bring the centre of the head's volume to the centre of the patch's zone. The remaining distance
//! is how far the patch lies from the axis, which the head's mounting on the stage determines. Whether the zone lies in the
//! head's field and depth and faces it is checked here, before anything moves.

use flankscope_foundation::rigid::{Camera, Projector, Rigid, Stage};
use flankscope_metrology::patch::Patch;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::PlanningError;
use super::field::FieldOfView;
use flankscope_metrology::kinematics::tool_from_camera;
use flankscope_metrology::view::PlannedView;

/// Largest angle between viewing direction and a patch's normal, degrees: beyond it the patch is hardly lit. Flanks are seen at 60.
const MOST_SLANT_DEG: f64 = 75.0;
/// Smallest distance of the head's windows from the CAD, mm.
const CLEAR_MM: f64 = 0.5;
/// Step along the way at which distances are checked, mm.
const STEP_MM: f64 = 1.0;

/// Why a patch cannot be viewed.
#[derive(Debug, thiserror::Error)]
pub enum PatchViewError {
    /// The patch does not exist, or is not judged.
    #[error("{got} is no patch that is judged; the tool file has {}", numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(", "))]
    NoSuchPatch {
        /// Requested number.
        got: u32,
        /// Numbers of the judged patches.
        numbers: Vec<u32>,
    },
    /// The zone is too near or too far.
    #[error(
        "patch {name:?} lies outside the measuring volume: its zone is {:.2} to {:.2} mm from the camera, the head measures from {:.2} to {:.2} mm; \
         move the head (stage_from_camera of the head file) or the die nearer to or farther from the axis", depth_mm[0], depth_mm[1], volume_mm[0], volume_mm[1]
    )]
    Depth {
        /// Patch.
        name: String,
        /// Distances of the nearest and farthest corner of its zone.
        depth_mm: [f64; 2],
        /// Depths of the head's volume.
        volume_mm: [f64; 2],
    },
    /// The zone is larger than the field, or beside it.
    #[error(
        "patch {name:?}: its zone reaches {reach_mm:.2} mm from the middle of the head's field, which is {field_mm:.2} mm in radius there; \
         one view shows one patch: name several smaller ones"
    )]
    Field {
        name: String,
        /// Distance of the farthest corner from the field's centre.
        reach_mm: f64,
        /// The field's radius at its depth.
        field_mm: f64,
    },
    #[error(
        "patch {name:?} faces away: the head sees it at {slant_deg:.0} degrees from its normal, at most {MOST_SLANT_DEG} are possible"
    )]
    TurnedAway {
        name: String,
        /// Angle between viewing direction and normal.
        slant_deg: f64,
    },
    /// The head would come too near to the die.
    #[error(
        "the head's window comes within {off_mm:.1} mm of the CAD at ({:.1}, {:.1}, {:.1}) mm on its way through the views, {CLEAR_MM} mm are needed; \
         correct stage_from_camera of the head file, or name fewer patches", at_mm[0], at_mm[1], at_mm[2]
    )]
    InTheWay {
        /// Distance from the CAD, negative inside.
        off_mm: f64,
        /// Position in the tool frame.
        at_mm: [f64; 3],
    },
}

/// Positions of the stages that centre each of these patches in a view.
///
/// # Errors
/// A patch is not judged, or not visible to the head.
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

/// Checks that every view shows the patch that it is assigned to, from the positions of the stages.
///
/// # Errors
/// A patch is not judged, or not visible to the head from there.
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

/// Pose and field of the head.
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

/// Checks that the zone lies in field and depth, and faces the head.
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

/// Checks that the head's windows clear the CAD at all combinations of both axes between and above the views, because the axes
/// move at the same time.
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
