//! The one kinematic chain of a check: what the axes do to the camera before the tool.
//!
//! In a press the die stands still and the head turns about the axis and goes in along it; offline the die turns on its table and
//! the head is raised before it. What a view sees depends on neither but on the **turn**: the angle by which the die is turned as
//! seen from the head. Everything inside counts by turns; the axis' own angle is what the controller is told and tells.
//!
//! ```text
//! die moves:   room_from_tool = Rz(axis)         room_from_camera = Tz(lift) S             turn =  axis
//! head moves:  room_from_tool = 1                room_from_camera = Tz(lift) Rz(axis) S    turn = -axis
//! both:        tool_from_camera = Rz(-turn) Tz(lift) S          S: the head file's stage_from_camera
//! ```
//! A turn about an axis and a way along it can be done in either order, so both chains are one, mirrored.

use flankscope_foundation::rigid::{Camera, Projector, Rigid, Stage, Tool};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// What the rotary axis turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Moves {
    /// The die, on its table before the head.
    #[default]
    Die,
    /// The head, in a press before a die that stands still.
    Head,
    /// Nothing: a robot arm carries the head, and says where it stands. The stages stay at home.
    Outside,
}

impl Moves {
    /// The axis' angle at which the die is turned by so much before the head, and the turn of an angle; none where no axis turns
    /// anything.
    #[must_use]
    pub fn axis_rad(self, turn_rad: f64) -> Option<f64> {
        match self {
            Self::Die => Some(turn_rad),
            Self::Head => Some(-turn_rad),
            Self::Outside => None,
        }
    }
}

/// Where the camera stands in the tool with the die turned by `turn_rad` before the head, and the head raised by `lift_mm`.
#[must_use]
pub fn tool_from_camera(
    turn_rad: f64,
    lift_mm: f64,
    stage_from_camera: Rigid<Stage, Camera>,
) -> Rigid<Tool, Camera> {
    // Seen from the die, the stage turns the other way.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn_rad);
    let tool_from_stage: Rigid<Tool, Stage> =
        Rigid::from_isometry(Isometry3::from_parts(Translation3::identity(), turn));
    let lift = Translation3::new(0.0, 0.0, lift_mm);
    let lifted: Rigid<Stage, Camera> = Rigid::from_isometry(lift * stage_from_camera.isometry());
    tool_from_stage * lifted
}

/// The space that the head takes in the tool on its way through the views: a sector of a ring about the axis, between two heights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweptVolume {
    /// Farthest of the camera's and the projectors' windows from the axis, mm.
    pub reach_mm: f64,
    /// Nearest of them, mm.
    pub nearest_mm: f64,
    /// Lowest window, and the highest one on the way out, mm.
    pub heights_mm: [f64; 2],
    /// Angle of the press that the head passes through, rad; none where the die turns before a head that only goes up and down.
    pub sector_rad: f64,
}

impl SweptVolume {
    /// Of a head that visits these turns and lifts, and comes out to `retract_mm`.
    #[must_use]
    pub fn of(
        moves: Moves,
        views: impl Iterator<Item = (f64, f64)>,
        retract_mm: f64,
        stage_from_camera: Rigid<Stage, Camera>,
        projectors_from_camera: &[Rigid<Projector, Camera>],
    ) -> Self {
        let camera = stage_from_camera.isometry();
        let projectors = projectors_from_camera.iter();
        let projectors = projectors.map(|pose| camera * pose.isometry().inverse());
        let windows: Vec<Vector3<f64>> = std::iter::once(*camera)
            .chain(projectors)
            .map(|window| window.translation.vector)
            .collect();
        let (mut low, mut high) = (f64::INFINITY, retract_mm);
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        for (turn_rad, lift_mm) in views {
            (low, high) = (low.min(lift_mm), high.max(lift_mm));
            (first, last) = (first.min(turn_rad), last.max(turn_rad));
        }
        let span = |of: fn(&Vector3<f64>) -> f64| {
            let values = windows.iter().map(of);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
                [low.min(x), high.max(x)]
            })
        };
        let [below, above] = span(|window| window.z);
        let [nearest_mm, reach_mm] = span(|window| window.x.hypot(window.y));
        Self {
            reach_mm,
            nearest_mm,
            heights_mm: [low + below, high + above],
            sector_rad: match moves {
                Moves::Head | Moves::Outside => (last - first).clamp(0.0, std::f64::consts::TAU),
                Moves::Die => 0.0,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(21.3, -0.4, 1.7),
            UnitQuaternion::from_euler_angles(0.3, 1.2, -0.7),
        )
    }

    fn turned(angle_rad: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad);
        Isometry3::from_parts(Translation3::identity(), turn)
    }

    fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        (a.to_homogeneous() - b.to_homogeneous()).norm()
    }

    /// By the room: where tool and camera each stand in it, with nothing of the code above.
    fn by_the_room(moves: Moves, axis_rad: f64, lift_mm: f64) -> Isometry3<f64> {
        let lift = Translation3::new(0.0, 0.0, lift_mm);
        let (room_from_tool, room_from_camera) = match moves {
            Moves::Die => (turned(axis_rad), lift * head()),
            _ => (Isometry3::identity(), lift * turned(axis_rad) * head()),
        };
        room_from_tool.inverse() * room_from_camera
    }

    #[test]
    fn chains_are_those_of_the_room() {
        let head: Rigid<Stage, Camera> = Rigid::from_isometry(head());
        for moves in [Moves::Die, Moves::Head] {
            for axis_rad in [-3.0, -0.4, 0.0, 1.1, 6.0] {
                for lift_mm in [-40.0, 0.0, 33.0] {
                    let ours = tool_from_camera(moves.axis_rad(axis_rad).unwrap(), lift_mm, head);
                    let off = apart(ours.isometry(), &by_the_room(moves, axis_rad, lift_mm));
                    assert!(off < 1e-12, "{moves:?} {axis_rad} {lift_mm}: {off}");
                }
            }
        }
    }

    /// The same axes command mirrored chains; from a view to the next the camera makes the opposite turn about the axis, and the
    /// same way along it: R_die(a)⁻¹ R_die(b) = Rz(a - b), R_head(a)⁻¹ R_head(b) = Rz(b - a), seen in the stage's frame.
    #[test]
    fn the_same_axes_make_mirrored_chains() {
        let seen_in_stage = |moves, axis_rad, lift_mm| {
            // Without the head's own place: the chain of the axes alone.
            by_the_room(moves, axis_rad, lift_mm) * head().inverse()
        };
        for (a, b) in [((0.3, 10.0), (-1.2, 33.0)), ((2.9, -5.0), (-2.9, 0.0))] {
            for (moves, sign) in [(Moves::Die, -1.0), (Moves::Head, 1.0)] {
                let step =
                    seen_in_stage(moves, a.0, a.1).inverse() * seen_in_stage(moves, b.0, b.1);
                let closed = Translation3::new(0.0, 0.0, b.1 - a.1) * turned(sign * (b.0 - a.0));
                assert!(apart(&step, &closed) < 1e-12, "{moves:?}");
            }
            // And opposite axes the same pose.
            let (die, head) = (
                by_the_room(Moves::Die, a.0, a.1),
                by_the_room(Moves::Head, -a.0, a.1),
            );
            assert!(apart(&die, &head) < 1e-12);
        }
        for moves in [Moves::Die, Moves::Head] {
            let back = moves.axis_rad(0.7).and_then(|axis| moves.axis_rad(axis));
            assert_eq!(back, Some(0.7));
        }
    }

    #[test]
    fn a_head_that_turns_sweeps_a_sector_and_one_that_does_not_a_line() {
        let head: Rigid<Stage, Camera> =
            Rigid::from_isometry(Translation3::new(20.0, 0.0, 1.0).into());
        let projector = Rigid::from_isometry(Isometry3::from(Translation3::new(-3.0, -4.0, 0.0)));
        let views = [(-0.5, 33.0), (1.0, 20.0)];
        let of = |moves| SweptVolume::of(moves, views.into_iter(), 86.0, head, &[projector]);
        let swept = of(Moves::Head);
        assert!((swept.reach_mm - 23f64.hypot(4.0)).abs() < 1e-12);
        assert!((swept.nearest_mm - 20.0).abs() < 1e-12);
        assert_eq!(swept.heights_mm, [21.0, 87.0]);
        assert!((swept.sector_rad - 1.5).abs() < 1e-12);
        assert_eq!(of(Moves::Die).sector_rad, 0.0);
    }
}
