//! True mounting of die and head on the stages, which deviates from the files.

use super::optics::HeadOptics;
use super::random::{Normals, Purpose, stream};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Eccentricity of the die on the rotary stage, mm.
const ECCENTRICITY_MM: f64 = 0.5;
/// Tilt of the die's axis relative to the rotation axis, rad.
const TILT_RAD: f64 = 0.2 * DEGREE;
/// Error of the hand-eye transform in the head file: shift and rotation.
const HAND_EYE_MM: f64 = 0.5;
const HAND_EYE_RAD: f64 = 1.0 * DEGREE;
/// Amplitude of each harmonic of the rotary encoder's error: the sum of three stays within ±15 mdeg.
const HARMONIC_RAD: f64 = 5e-3 * DEGREE;
/// Standard deviation of the angle between vertical axis and rotation axis, rad: towards the die after alignment with a straight
/// edge, along its wall after assembly of the machine.
const VERTICAL_RAD: [f64; 2] = [10e-6, 200e-6];
/// Radius of a die's rim, mm.
const RIM_MM: f64 = 40.0;
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// What the rotary stage carries: die or head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Carries {
    /// The die, in front of a head that moves vertically only.
    #[default]
    Die,
    /// The head, which hangs from a vertical slide in a press.
    Head,
}

/// Poses of die, head and axes relative to those in the files.
#[derive(Clone, Debug, PartialEq)]
pub struct Mount {
    /// What turns.
    pub rotary_carries: Carries,
    /// Pose of the die on the rotary stage.
    pub table_from_die: Isometry3<f64>,
    /// The head's true pose relative to that in its file.
    pub nominal_from_camera: Isometry3<f64>,
    /// Lateral motion of the vertical stage per height, in x and y of the stage frame.
    pub vertical_slope: [f64; 2],
    /// Cosine and sine of the rotary encoder's error at one, two and three periods per revolution, rad.
    pub harmonics_rad: [[f64; 2]; 3],
    /// Sawtooth error, which low harmonics cannot describe.
    pub saw: Saw,
}

/// Sawtooth error of a rotary encoder: grows linearly and falls back several times per revolution, ± half of its amplitude. A
/// disc that was glued on with a gap has one period, a worn worm wheel as many as it has teeth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Saw {
    /// Periods per revolution.
    pub teeth: u32,
    /// Largest minus smallest error, rad.
    pub height_rad: f64,
}

impl Saw {
    /// The error at an angle, rad.
    #[must_use]
    pub fn at_rad(&self, rotation_rad: f64) -> f64 {
        let turns = rotation_rad * f64::from(self.teeth) / std::f64::consts::TAU;
        self.height_rad * (turns.rem_euclid(1.0) - 0.5)
    }
}

impl Mount {
    /// All poses as in the files.
    pub fn perfect() -> Self {
        Self {
            rotary_carries: Carries::Die,
            table_from_die: Isometry3::identity(),
            nominal_from_camera: Isometry3::identity(),
            vertical_slope: [0.0; 2],
            harmonics_rad: [[0.0; 2]; 3],
            saw: Saw::default(),
        }
    }

    /// A die placed by hand, and a head whose hand-eye transform is known only roughly; directions are drawn from `seed`.
    pub fn by_hand(seed: u64) -> Self {
        let mut random = Normals::new(stream(seed, Purpose::Mount));
        let mut direction = |flat: bool| {
            let mut vector = Vector3::from_fn(|_, _| random.next());
            if flat {
                vector.z = 0.0;
            }
            Unit::new_normalize(vector)
        };
        let shift = direction(true).into_inner() * ECCENTRICITY_MM;
        let tilt = UnitQuaternion::from_axis_angle(&direction(true), TILT_RAD);
        let head_shift = direction(false).into_inner() * HAND_EYE_MM;
        let head_turn = UnitQuaternion::from_axis_angle(&direction(false), HAND_EYE_RAD);
        let harmonics_rad = std::array::from_fn(|_| {
            let phase = direction(true);
            [phase.x * HARMONIC_RAD, phase.y * HARMONIC_RAD]
        });
        Self {
            rotary_carries: Carries::Die,
            table_from_die: Isometry3::from_parts(Translation3::from(shift), tilt),
            nominal_from_camera: Isometry3::from_parts(Translation3::from(head_shift), head_turn),
            vertical_slope: VERTICAL_RAD.map(|sigma| sigma * random.next().clamp(-3.0, 3.0)),
            harmonics_rad,
            saw: Saw::default(),
        }
    }

    /// Moves the die from where it was put: standard deviation of its shift along each axis, and of the shift of its rim by a turn about
    /// each axis, µm; drawn from `seed`.
    pub fn move_die(&mut self, sigma_um: f64, seed: u64) {
        let mut random = Normals::new(stream(seed, Purpose::Moved));
        let mut drawn = || Vector3::from_fn(|_, _| 1e-3 * sigma_um * random.next());
        let (shift, turn) = (drawn(), drawn() / RIM_MM);
        self.table_from_die *=
            Isometry3::from_parts(Translation3::from(shift), UnitQuaternion::new(turn));
    }

    /// Tool frame from camera frame with the rotary stage at `rotation_rad` and the head raised by `vertical_mm`.
    pub fn tool_from_camera(
        &self,
        optics: &HeadOptics,
        rotation_rad: f64,
        vertical_mm: f64,
    ) -> Isometry3<f64> {
        let turned_rad = rotation_rad
            + self.saw.at_rad(rotation_rad)
            + (1_u8..)
                .zip(self.harmonics_rad)
                .map(|(order, [cosine, sine])| {
                    let (sin, cos) = (f64::from(order) * rotation_rad).sin_cos();
                    cosine * cos + sine * sin
                })
                .sum::<f64>();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned_rad);
        let [along, across] = self.vertical_slope.map(|slope| slope * vertical_mm);
        let slide = Translation3::new(along, across, vertical_mm);
        let stands = match self.rotary_carries {
            // The table rotates, the slide is fixed in space.
            Carries::Die => turn.inverse() * slide,
            // The table is fixed in space, and the slide carries the rotary stage.
            Carries::Head => slide * turn,
        };
        self.table_from_die.inverse() * stands * optics.stage_from_camera * self.nominal_from_camera
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::HeadDesign;

    #[test]
    fn a_perfect_mount_is_what_the_files_say() {
        let optics = HeadDesign::demo().optics();
        let (said, is) = (
            optics.tool_from_camera(0.7, 12.0),
            Mount::perfect().tool_from_camera(&optics, 0.7, 12.0),
        );
        assert!((said.to_homogeneous() - is.to_homogeneous()).amax() < 1e-12);
    }

    #[test]
    fn a_saw_rises_evenly_and_falls_at_once_in_either_sense() {
        let saw = Saw {
            teeth: 4,
            height_rad: 1e-4,
        };
        let quarter = 0.25 * std::f64::consts::TAU;
        for tooth in -5..5 {
            let start = f64::from(tooth) * quarter;
            for (share, error) in [(0.001, -0.499), (0.25, -0.25), (0.5, 0.0), (0.999, 0.499)] {
                let at = saw.at_rad(start + share * quarter);
                assert!((at - 1e-4 * error).abs() < 1e-9, "{tooth} {share}");
            }
        }
        assert_eq!(Saw::default().at_rad(1.3), 0.0);
        let optics = HeadDesign::demo().optics();
        let mount = Mount {
            saw,
            ..Mount::perfect()
        };
        let [with, without] = [mount, Mount::perfect()]
            .map(|mount| mount.tool_from_camera(&optics, 0.1 * quarter, 0.0));
        let turned = (without.inverse() * with).rotation.angle();
        assert!((turned - 0.4e-4).abs() < 1e-9, "{turned}");
    }

    #[test]
    fn a_mount_by_hand_is_off_by_what_is_promised() {
        for seed in 0..20 {
            let mount = Mount::by_hand(seed);
            let die = mount.table_from_die;
            assert!((die.translation.vector.xy().norm() - ECCENTRICITY_MM).abs() < 1e-12);
            assert_eq!(die.translation.vector.z, 0.0, "it stands on the table");
            assert!((die.rotation.angle() - TILT_RAD).abs() < 1e-12);
            let head = mount.nominal_from_camera;
            assert!((head.translation.vector.norm() - HAND_EYE_MM).abs() < 1e-12);
            assert!((head.rotation.angle() - HAND_EYE_RAD).abs() < 1e-12);
            let largest: f64 = mount.harmonics_rad.iter().map(|[c, s]| c.hypot(*s)).sum();
            assert!(largest <= 15e-3 * DEGREE + 1e-15, "within the data sheet");
            assert_ne!(mount, Mount::by_hand(seed + 1));
        }
    }
}
