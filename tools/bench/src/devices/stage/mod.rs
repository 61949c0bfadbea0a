//! Both stages with an emulated Newport ESP301: its text protocol on a UART, trapezoidal motion, stage errors.
//!
//! It implements the commands in the ESP300 and ESP301 user's manuals for motion, trajectory, limits, motor and feedback
//! settings, servo filters, waiting, aborting, errors, status and stored programs. Groups, digital I/O, data acquisition and
//! master-slave modes are not emulated: these commands give error 27. Commands that are not in the manuals give error 6.

mod commands;
pub(crate) mod errors;
mod serve;
pub(crate) mod settings;

pub(crate) use commands::NO_MEMORY;
pub(super) use serve::{run, serve};

use super::axis::{Axis, AxisModel};
use super::motion::Dynamics;
use errors::Refusal;
use std::collections::{BTreeMap, VecDeque};

/// Both axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisModels {
    /// Axis 1.
    pub rotation: AxisModel,
    /// Axis 2.
    pub vertical: AxisModel,
}

impl Default for AxisModels {
    /// URS150BCC and IMS300V. Position errors as the instrument's authors state them (±15 mdeg, ±5 µm); rated speeds of the
    /// stages. Assumed are the accelerations (full speed within 0.25 s and 0.125 s) and what of the errors does not repeat.
    fn default() -> Self {
        Self {
            rotation: AxisModel {
                name: "URS150BCC",
                unit: 7,
                dynamics: Dynamics {
                    speed: 80.0,
                    acceleration: 320.0,
                    deceleration: 320.0,
                },
                travel: (-361.0, 361.0),
                home: 0.0,
                error: 0.015,
                repeatability: 0.002,
                backlash: 0.0,
                stalls_at_move: None,
            },
            vertical: AxisModel {
                name: "IMS300V",
                unit: 2,
                dynamics: Dynamics {
                    speed: 100.0,
                    acceleration: 800.0,
                    deceleration: 800.0,
                },
                travel: (-150.0, 150.0),
                home: 100.0,
                error: 0.005,
                repeatability: 0.001,
                backlash: 0.0,
                stalls_at_move: None,
            },
        }
    }
}

/// True positions of the stages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePose {
    /// Rotary stage.
    pub rotation_rad: f64,
    /// Vertical stage.
    pub vertical_mm: f64,
}

/// The stages and the state of their controller.
#[derive(Debug, Clone)]
pub struct StageModel {
    /// The controller has three connectors; nothing is connected to the third.
    axes: [Axis; 3],
    seed: u64,
    errors: VecDeque<Refusal>,
    programs: BTreeMap<u32, Vec<String>>,
    /// The program that records commands instead of executing them.
    recording: Option<u32>,
}

impl StageModel {
    /// State after switching on, at the home switches.
    #[must_use]
    pub fn new(models: AxisModels, seed: u64) -> Self {
        Self {
            axes: [
                Axis::new(1, models.rotation),
                Axis::new(2, models.vertical),
                Axis::new(3, AxisModel::NONE),
            ],
            seed,
            errors: VecDeque::new(),
            programs: BTreeMap::new(),
            recording: None,
        }
    }

    /// True positions of the stages at a time.
    #[must_use]
    pub fn true_pose(&self, now_us: u64) -> TruePose {
        let now_s = now_us as f64 * 1e-6;
        self.pose_of(|axis| axis.profile.position(now_s))
    }

    /// True positions of the stages after the present move.
    pub fn true_destination(&self) -> TruePose {
        self.pose_of(|axis| axis.profile.target())
    }

    /// Next time after `now_us` at which the vertical axis crosses `vertical_mm`, to a millisecond; `None` if it does not.
    pub(super) fn vertical_crossing_us(&self, now_us: u64, vertical_mm: f64) -> Option<u64> {
        let profile = &self.axes[1].profile;
        let above = |at_us: u64| profile.position(at_us as f64 * 1e-6) >= vertical_mm;
        let (level, end_us) = (above(now_us), (profile.end_s() * 1e6).ceil() as u64 + 1_000);
        (now_us..=end_us)
            .step_by(1_000)
            .skip(1)
            .find(|&at_us| above(at_us) != level)
    }

    /// Whether the line moves the vertical axis by at least a millimetre.
    fn moves_vertically(&self, line: &str) -> bool {
        let axis = &self.axes[1];
        let mut commands = line.split(';');
        let target: Option<f64> =
            commands.find_map(|command| command.trim().strip_prefix("2PA")?.parse().ok());
        target.is_some_and(|target| (target + axis.zero - axis.profile.target()).abs() >= 1.0)
    }

    fn pose_of(&self, position: impl Fn(&Axis) -> f64) -> TruePose {
        let [rotation, vertical] = [0, 1].map(|n| {
            let axis = &self.axes[n];
            let target = axis.profile.target();
            let repeats = axis.model.repeatability;
            let astray = (axis.model.error - repeats) * systematic_error(n, target)
                + repeats * self.unit_error(n, axis.approaches);
            position(axis) + astray - 0.5 * axis.model.backlash * axis.sent
        });
        TruePose {
            rotation_rad: rotation.to_radians(),
            vertical_mm: vertical,
        }
    }

    /// Uniform in -1..1, reproducible for the same seed, axis and number of the approach.
    fn unit_error(&self, axis: usize, approach: u32) -> f64 {
        let of_approach = (u64::from(approach) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.seed ^ of_approach ^ ((axis as u64 + 1) << 56);
        // SplitMix64's finaliser (Steele, Lea, Flood 2014).
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Error of an axis that repeats with every approach, -1..1, by position: three harmonics of one turn of the rotary table, or of
/// 60 mm of the vertical spindle. It does not depend on the seed: every run has the same stages.
fn systematic_error(axis: usize, position: f64) -> f64 {
    let turns = position / [360.0, 60.0][axis];
    (1..=3)
        .map(|harmonic| {
            let phase = f64::from(harmonic) * turns + 0.37 * f64::from(harmonic * harmonic);
            (std::f64::consts::TAU * phase).sin() / 3.0
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(stage: &mut StageModel, now_us: u64, line: &str) -> String {
        stage.line(now_us, line).0
    }

    #[test]
    fn a_move_is_accepted_at_once_and_done_later() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        assert_eq!(
            ask(&mut stage, 0, "1MO;2MO;1PA8;2PA33;TB?"),
            "0, 0, NO ERROR DETECTED\r\n"
        );
        // 67 mm at 100 mm/s plus one ramp of 0.125 s.
        assert_eq!(ask(&mut stage, 794_000, "1MD?;2MD?"), "1\r\n0\r\n");
        assert_eq!(
            ask(&mut stage, 796_000, "2MD?;2TP?;1TP?"),
            "1\r\n33.000000\r\n8.000000\r\n"
        );
    }

    #[test]
    fn a_stop_brings_an_axis_to_rest_short_of_its_target() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        ask(&mut stage, 0, "2MO;2PA0");
        ask(&mut stage, 500_000, "2ST");
        // Braking from 100 mm/s takes 0.125 s and 6.25 mm; 0.5 s of travel were 43.75 mm.
        assert_eq!(ask(&mut stage, 626_000, "2MD?;2TP?"), "1\r\n50.000000\r\n");
    }

    #[test]
    fn what_is_wrong_is_refused_with_its_number_and_moves_nothing() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        for (line, code) in [
            ("2PA1", 213),
            ("1XY", 6),
            ("PA1", 37),
            ("3PA1", 300),
            ("3MO", 300),
            ("4PA1", 9),
            ("1PA", 38),
            ("2PAnan", 38),
            ("1VA1000", 110),
        ] {
            assert_eq!(ask(&mut stage, 0, line), "");
            assert_eq!(ask(&mut stage, 0, "TE?"), format!("{code}\r\n"), "{line}");
        }
        ask(&mut stage, 0, "2MO;2PA151;2PA-151");
        assert_eq!(
            ask(&mut stage, 0, "TE?;TE?;TE?;2MD?;2TP?"),
            "206\r\n207\r\n0\r\n1\r\n100.000000\r\n"
        );
    }

    /// Whoever asks every axis of the controller gets an answer from the one without a stage, too.
    #[test]
    fn a_connector_without_a_stage_answers() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        assert_eq!(
            ask(&mut stage, 0, "3ID?;3SN?;3QM?;3MO?;3MD?;3TP?;TS?;TX?;TE?"),
            "Unknown\r\n0\r\n0\r\n0\r\n1\r\n0.000000\r\n@\r\n@\r\n0\r\n"
        );
        // Nor does it keep the others waiting.
        assert!(stage.stands(0.0, None));
    }

    #[test]
    fn what_the_manual_lists_and_is_not_emulated_is_not_allowed() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        for (line, code) in [
            ("1HN1,2", 27),
            ("BO1", 27),
            ("1SS2", 27),
            ("1ZQ?", 6),
            ("*CLS", 6),
            ("X", 6),
        ] {
            assert_eq!(
                ask(&mut stage, 0, &format!("{line};TE?")),
                format!("{code}\r\n"),
                "{line}"
            );
        }
        assert_eq!(ask(&mut stage, 0, "*IDN?"), ask(&mut stage, 0, "VE?"));
    }

    #[test]
    fn an_abort_takes_the_current_where_the_axis_is_set_so() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        // Bits 0 and 2: it stops with AE and keeps its current. Bits 0 and 1 (default): it loses its current.
        ask(&mut stage, 0, "1MO;2MO;2ZE5H;2AE1600;1PA90;2PA0");
        ask(&mut stage, 500_000, "AB");
        assert_eq!(ask(&mut stage, 500_000, "1MO?;2MO?"), "0\r\n1\r\n");
        // 43.75 mm in half a second, and 100² / 3200 mm to rest.
        assert_eq!(ask(&mut stage, 600_000, "2MD?;2TP?"), "1\r\n53.125000\r\n");
        assert_eq!(ask(&mut stage, 600_000, "TE?"), "0\r\n");
    }

    #[test]
    fn limits_hold_as_they_are_set() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        assert_eq!(ask(&mut stage, 0, "2SL1;2SR-1;TE?;TE?"), "201\r\n201\r\n");
        ask(&mut stage, 0, "2MO;2SR120;2PA130");
        assert_eq!(ask(&mut stage, 0, "TE?"), "206\r\n");
        // Unlimited upward motion ends at the software limit with an error.
        ask(&mut stage, 0, "2MV+");
        assert_eq!(ask(&mut stage, 100_000, "2MV?;TX?;TS?"), "0\r\nP\r\nR\r\n");
        assert_eq!(
            ask(&mut stage, 1_000_000, "2TP?;2MV?;TE?"),
            "120.000000\r\n1\r\n206\r\n"
        );
        // Without the software limit, it ends at the limit switch, which cuts the current.
        ask(&mut stage, 1_000_000, "2ZS0;2PA200");
        assert_eq!(
            ask(&mut stage, 3_000_000, "2TP?;TE?;2MO?;PH?"),
            "151.000000\r\n204\r\n0\r\n18000002H, 3H\r\n"
        );
    }

    #[test]
    fn what_is_found_reads_as_the_home_preset() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        ask(&mut stage, 0, "2MO;2SH-40;2OR4");
        assert_eq!(
            ask(&mut stage, 5_000_000, "2MD?;2TP?;TE?"),
            "1\r\n-40.000000\r\n0\r\n"
        );
        assert!((stage.true_pose(5_000_000).vertical_mm + 151.0).abs() < 0.006);
        ask(&mut stage, 5_000_000, "2SH7;2OR2");
        assert_eq!(ask(&mut stage, 9_000_000, "2TP?"), "7.000000\r\n");
        assert!((stage.true_pose(9_000_000).vertical_mm - 100.0).abs() < 0.006);
        // To the position that reads 0.
        ask(&mut stage, 9_000_000, "2SH0;2OR0");
        assert!((stage.true_pose(12_000_000).vertical_mm - 93.0).abs() < 0.006);
    }

    #[test]
    fn ramps_and_speed_are_those_that_are_set() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        ask(&mut stage, 0, "2MO;2VU50;2VA60");
        assert_eq!(
            ask(&mut stage, 0, "TE?;2VA50;2AC500;2AG100;2PA0"),
            "210\r\n"
        );
        // 2.5 mm up within 0.1 s, 12.5 mm down within 0.5 s, 85 mm between.
        assert_eq!(
            ask(&mut stage, 1_000_000, "2TV?;2DP?"),
            "-50.000000\r\n0.000000\r\n"
        );
        assert_eq!(ask(&mut stage, 2_299_000, "2MD?"), "0\r\n");
        assert_eq!(ask(&mut stage, 2_301_000, "2MD?;2TP?"), "1\r\n0.000000\r\n");
        // Saved settings outlive a reset, others do not.
        ask(&mut stage, 3_000_000, "SM;2AC400;RS");
        assert_eq!(
            ask(&mut stage, 3_000_000, "2AC?;2MO?;2TP?"),
            "500.0\r\n0\r\n0.000000\r\n"
        );
    }

    #[test]
    fn a_table_with_play_stands_elsewhere_when_it_came_from_the_other_side() {
        let mut axes = AxisModels::default();
        axes.rotation.backlash = 0.02;
        axes.vertical.backlash = 0.01;
        let stood = |way: &str| {
            let mut stage = StageModel::new(axes, 3);
            ask(&mut stage, 0, "1MO;2MO");
            for (number, target) in (1..).zip(way.split(' ')) {
                ask(
                    &mut stage,
                    number * 100_000_000,
                    &format!("1PA{target};2PA{target}"),
                );
            }
            stage.true_pose(1_000_000_000)
        };
        let [below, above, again] = ["5 10", "20 10", "20 10 10"].map(stood);
        let turned = (above.rotation_rad - below.rotation_rad).to_degrees();
        assert!((turned - 0.02).abs() < 1e-9, "{turned}");
        assert!((above.vertical_mm - below.vertical_mm - 0.01).abs() < 1e-9);
        assert_eq!(above, again, "a move to where it stands moves nothing");
    }

    #[test]
    fn stage_errs_alike_in_every_run_but_for_its_repeatability() {
        let axes = AxisModels::default();
        let error_deg = |seed: u64, target: f64| {
            let mut stage = StageModel::new(axes, seed);
            ask(&mut stage, 0, &format!("1MO;1PA{target}"));
            let pose = stage.true_pose(100_000_000);
            pose.rotation_rad.to_degrees() - target
        };
        let mut largest = 0.0_f64;
        for target in (0..90).map(|n| 4.0 * f64::from(n) - 180.0) {
            let [one, other] = [3, 4].map(|seed| error_deg(seed, target));
            assert!((one - other).abs() <= 0.004, "{one} {other}");
            assert!(one.abs() <= 0.015 + 1e-9, "{one}");
            assert_ne!(one, other);
            largest = largest.max(one.abs());
        }
        assert!(largest > 0.005, "{largest}");
    }

    #[test]
    fn position_is_approached_anew_with_another_error() {
        let mut stage = StageModel::new(AxisModels::default(), 3);
        ask(&mut stage, 0, "1MO;1PA12.5");
        let mut stood = vec![stage.true_pose(100_000_000).rotation_rad];
        for n in 1..200 {
            let at_us = 200_000_000 * n;
            let way = ["1PA12.5", "1PA0;1WS;1PA12.5"][usize::from(n > 1)];
            for command in way.split(';') {
                ask(&mut stage, at_us, command);
            }
            stood.push(stage.true_pose(at_us + 100_000_000).rotation_rad);
        }
        assert_eq!(stood[0], stood[1], "it did not move");
        let stood = &stood[1..];
        let mean = stood.iter().sum::<f64>() / stood.len() as f64;
        let squares: f64 = stood.iter().map(|at| (at - mean) * (at - mean)).sum();
        let sigma_mdeg = 1e3 * (squares / stood.len() as f64).sqrt().to_degrees();
        // Uniform within 2 mdeg: 1.155 of standard deviation, known to 3 % from 199; four times that.
        assert!((sigma_mdeg / 1.155 - 1.0).abs() < 0.12, "{sigma_mdeg}");
    }

    #[test]
    fn errors_are_repeatable_bounded_and_spread() {
        let mut axes = AxisModels::default();
        axes.vertical.repeatability = axes.vertical.error;
        let pose = |seed: u64, target: f64| {
            let mut stage = StageModel::new(axes, seed);
            ask(&mut stage, 0, &format!("1MO;2MO;1PA{target};2PA{target}"));
            stage.true_pose(100_000_000)
        };
        assert_eq!(pose(3, 12.5), pose(3, 12.5));
        assert_ne!(pose(3, 12.5), pose(4, 12.5));
        let errors: Vec<f64> = (0..1000_u32)
            .map(|n| pose(u64::from(n), f64::from(n) * 0.1).vertical_mm - f64::from(n) * 0.1)
            .collect();
        assert!(errors.iter().all(|error| error.abs() <= 0.005 + 1e-9));
        let mean = errors.iter().sum::<f64>() / 1000.0;
        let deviation = (errors.iter().map(|error| error * error).sum::<f64>() / 1000.0).sqrt();
        // Uniform: standard deviation 5/sqrt(3) um; of the mean of 1000, 0.09 um.
        assert!(mean.abs() < 4.0 * 0.09e-3, "mean {mean} mm");
        assert!(
            (deviation - 0.005 / 3f64.sqrt()).abs() < 0.3e-3,
            "deviation {deviation} mm"
        );
    }
}
