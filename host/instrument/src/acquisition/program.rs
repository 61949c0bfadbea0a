//! What stages, pattern projector and camera have to do in a run, and its conversion to the controller's capture plan.

use flankscope_profilometry::PatternSet;
use flankscope_profilometry::head::LensDrive;
use flankscope_protocol::{
    CapturePlan, Focus, FringeSet, LensCounts, Limits, Micrometres, Microradians, Microseconds,
    Milliamps, StageConfig, Timeouts, View,
};

use crate::settings::{Light, Stages, Timing};

/// Position of the stages for a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePosition {
    /// Commanded angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Commanded position of the vertical stage, mm.
    pub vertical_mm: f64,
}

impl StagePosition {
    /// Position of the axes for a die turned by `turn_rad` relative to the head. The station file says whether the rotary stage
    /// turns the die or the head. An angle beyond the travel is shifted by a whole turn if it then lies within. Axes that carry
    /// neither die nor head stay at home.
    #[must_use]
    pub fn of(turn_rad: f64, vertical_mm: f64, stages: &Stages) -> Self {
        let Some(axis_rad) = stages.moves.axis_rad(turn_rad) else {
            return Self {
                rotation_rad: stages.rotation.home_deg.to_radians(),
                vertical_mm: stages.vertical.home_mm,
            };
        };
        let [from, to] = stages.rotation.travel_deg.map(f64::to_radians);
        let back_rad = match axis_rad {
            angle if angle > to => angle - std::f64::consts::TAU,
            angle if angle < from => angle + std::f64::consts::TAU,
            angle => angle,
        };
        let within = back_rad >= from && back_rad <= to;
        Self {
            rotation_rad: if within { back_rad } else { axis_rad },
            vertical_mm,
        }
    }
}

/// All views of a run and how each is exposed.
#[derive(Clone, Debug)]
pub struct Program {
    /// Position of the stages for each view.
    pub positions: Vec<StagePosition>,
    /// Fringe pattern set.
    pub patterns: PatternSet,
    /// Fraction of the light of all mirrors that each pass gives, if the patterns are shown in passes; empty: shown once by all mirrors.
    pub lit_ratios: Vec<f64>,
    /// Exposure times, ascending, µs.
    pub exposures_us: Vec<u32>,
    /// Vertical position of the retracted head, mm.
    pub retract_mm: f64,
    /// Settling times of stages and projector, and readout time of the camera.
    pub timing: Timing,
    /// LED current.
    pub light: Light,
    /// Configuration of the stages, as the controller is told.
    pub stage: StageConfig,
    /// The head's liquid lens, if it has one.
    pub lens: Option<LensDrive>,
    /// Number of projectors, which show the passes one after the other.
    pub projectors: usize,
}

/// Why a program cannot be written as a capture plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProgramError {
    /// More entries than a plan holds.
    #[error("{got} {what} are too many for one capture; at most {limit}")]
    TooMany {
        /// Views, exposures or fringe sets.
        what: &'static str,
        /// How many were asked for.
        got: usize,
        /// How many a plan holds.
        limit: usize,
    },
    /// The pattern set has a Gray code, but the controller's plan knows only fringes.
    #[error(
        "pattern set \"{set}\" has a Gray code, which the controller's capture plan cannot ask for: recorded frames (--frames) may have one"
    )]
    GrayCode {
        /// Name of the set.
        set: String,
    },
}

impl StagePosition {
    /// The position in the units of the wire protocol.
    pub fn view(&self) -> View {
        View {
            rotation: Microradians((self.rotation_rad * 1e6).round() as i32),
            vertical: micrometres(self.vertical_mm),
        }
    }
}

impl Program {
    /// Time for the frames of a view, s. Each takes an exposure with the pattern's settling time before it, or the readout of the
    /// frame before it if that is longer.
    pub fn exposure_s(&self) -> f64 {
        let patterns: u32 = self.patterns.sets.iter().map(|set| set.steps).sum();
        let frame_us = |&exposure_us: &u32| {
            let shown_us = exposure_us.saturating_add(self.timing.pattern_settle_us);
            f64::from(shown_us.max(self.timing.camera_readout_us))
        };
        let dark_us = self.exposures_us.first().map_or(0.0, frame_us);
        let fringes_us: f64 = self.exposures_us.iter().map(frame_us).sum();
        (dark_us + fringes_us * f64::from(patterns) * self.passes() as f64) / 1e6
    }

    /// How many times the pattern set is shown per view.
    pub fn passes(&self) -> usize {
        self.lit_ratios.len().max(1)
    }

    /// Settling time of stages and die after a move, s.
    pub fn settling_s(&self) -> f64 {
        f64::from(self.timing.settle_ms) / 1e3
    }

    /// The capture plan for some of the program's views, under its own session number.
    ///
    /// # Errors
    /// The plan has too many views, sets or exposures, or the pattern set has a Gray code.
    pub(super) fn capture_plan(
        &self,
        views: &[usize],
        limits: &Limits,
    ) -> Result<CapturePlan, ProgramError> {
        if self.patterns.code.is_some() {
            return Err(ProgramError::GrayCode {
                set: self.patterns.name.clone(),
            });
        }
        let timing = &self.timing;
        let mut plan = CapturePlan {
            session: flankscope_frames::monotonic_ns() as u32,
            views: Default::default(),
            exposures: Default::default(),
            fringes: Default::default(),
            led: Milliamps(self.light.led_ma).min(limits.led_max),
            settle: Microseconds::from_millis(timing.settle_ms),
            dmd_settle: Microseconds(timing.pattern_settle_us),
            camera_readout: Microseconds(timing.camera_readout_us),
            retract: micrometres(self.retract_mm),
            timeouts: Timeouts {
                motion: Timeouts::default().motion.max(self.stage.motion_timeout()),
                dmd: Microseconds(Timeouts::default().dmd.get() + 1_000 * timing.pattern_load_ms),
                ..Timeouts::default()
            },
            focus: self.lens.map(|lens| Focus {
                counts: LensCounts(lens.counts),
                settle: Microseconds::from_millis(lens.settle_ms),
            }),
            projectors: u8::try_from(self.projectors).unwrap_or(u8::MAX),
        };
        let too_many = |what, got, limit| ProgramError::TooMany { what, got, limit };
        let limit = plan.views.capacity();
        for at in views.iter().filter_map(|&view| self.positions.get(view)) {
            let pushed = plan.views.push(at.view());
            pushed.map_err(|_| too_many("views", views.len(), limit))?;
        }
        let limit = plan.exposures.capacity();
        for &exposure in &self.exposures_us {
            let pushed = plan.exposures.push(Microseconds(exposure));
            pushed.map_err(|_| too_many("exposures", self.exposures_us.len(), limit))?;
        }
        let limit = plan.fringes.capacity();
        let sets = &self.patterns.sets;
        // The controller repeats the patterns on each projector by itself.
        let times = self.passes() / self.projectors.max(1);
        let shown = std::iter::repeat_n(sets, times).flatten();
        for set in shown {
            let set = FringeSet {
                periods: set.periods.round().clamp(0.0, f64::from(u16::MAX)) as u16,
                steps: u8::try_from(set.steps).unwrap_or(u8::MAX),
            };
            let pushed = plan.fringes.push(set);
            pushed.map_err(|_| too_many("fringe sets", times * sets.len(), limit))?;
        }
        Ok(plan)
    }
}

pub(super) fn micrometres(mm: f64) -> Micrometres {
    Micrometres((mm * 1e3).round() as i32)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use flankscope_metrology::kinematics::Moves;

    fn program(views: usize) -> Program {
        Program {
            positions: (0..views)
                .map(|view| StagePosition {
                    rotation_rad: 1e-3 * view as f64,
                    vertical_mm: 33.0,
                })
                .collect(),
            patterns: PatternSet::named("article8").unwrap(),
            lit_ratios: Vec::new(),
            exposures_us: vec![10_000],
            retract_mm: 86.0,
            timing: Timing::default(),
            light: Light::default(),
            stage: StageConfig::DEFAULT,
            lens: None,
            projectors: 1,
        }
    }

    #[test]
    fn a_second_projector_is_commanded_and_its_patterns_are_told_once() {
        let one = program(1);
        let two = Program {
            lit_ratios: vec![1.0; 2],
            projectors: 2,
            ..program(1)
        };
        let plan = |program: &Program| program.capture_plan(&[0], &Limits::DEFAULT).unwrap();
        let (one, by_two) = (plan(&one), plan(&two));
        assert_eq!((one.projectors, by_two.projectors), (1, 2));
        assert_eq!(by_two.fringes, one.fringes);
        // The plan must have as many frames as the host adds up, pass by pass.
        assert_eq!(
            by_two.frames_per_view(),
            1 + 2 * (one.frames_per_view() - 1)
        );
        assert_eq!(two.passes(), 2);
    }

    #[test]
    fn views_are_put_to_the_controller_in_its_units_and_too_many_are_named() {
        let limit = flankscope_protocol::plan::MAX_VIEWS;
        let program = program(limit + 1);
        let plan = program.capture_plan(&[3, 1], &Limits::DEFAULT).unwrap();
        let at: Vec<i32> = plan.views.iter().map(|view| view.rotation.get()).collect();
        assert_eq!(at, [3_000, 1_000]);
        assert_eq!(plan.retract, Micrometres(86_000));
        let all: Vec<usize> = (0..=limit).collect();
        let error = program.capture_plan(&all, &Limits::DEFAULT).unwrap_err();
        let named = format!(
            "{} views are too many for one capture; at most {limit}",
            limit + 1
        );
        assert_eq!(error.to_string(), named);
    }

    #[test]
    fn times_of_moves_are_those_of_the_slower_axis_and_of_the_lowest_view() {
        // 2 mm at 1 mm/s reached within 1 s: 3 s. 0.4 rad at 2 rad/s², never at full speed: 2 sqrt(0.2) s.
        let mut stages = Stages::default();
        (
            stages.vertical.speed_mm_s,
            stages.vertical.acceleration_mm_s2,
        ) = (1.0, 1.0);
        (
            stages.rotation.speed_deg_s,
            stages.rotation.acceleration_deg_s2,
        ) = (10_f64.to_degrees(), 2_f64.to_degrees());
        let mut program = program(3);
        program.stage = stages.config();
        program.timing.settle_ms = 50;
        let at = |rotation_rad, vertical_mm| StagePosition {
            rotation_rad,
            vertical_mm,
        };
        program.positions = vec![at(0.0, 33.0), at(0.4, 33.0), at(0.4, 31.0)];
        let near = |time: Duration, s: f64| (time.as_secs_f64() - s).abs() < 1e-3;
        assert!(near(program.moving_time(0, 1), 2.0 * 0.2_f64.sqrt() + 0.05));
        assert!(near(program.moving_time(0, 2), 3.05));
        assert!(near(program.moving_time(2, 1), 3.05));
        assert!(near(program.leaving_time(), 86.0 - 31.0 + 1.0 + 0.7));
    }

    #[test]
    fn angles_beyond_the_travel_are_taken_a_turn_back_where_that_lies_within() {
        let mut stages = Stages::default();
        let at = |turn_deg: f64, stages: &Stages| {
            let at = StagePosition::of(turn_deg.to_radians(), 33.0, stages);
            at.rotation_rad.to_degrees().round()
        };
        assert_eq!(at(-181.0, &stages), -181.0);
        stages.rotation.travel_deg = [-180.0, 180.0];
        assert_eq!(at(-181.0, &stages), 179.0);
        stages.moves = Moves::Head;
        assert_eq!(at(-170.0, &stages), 170.0);
        assert_eq!(at(-181.0, &stages), -179.0);
        // An angle that no whole turn brings within the travel is left as it is; the controller then refuses it by name.
        stages.rotation.travel_deg = [-90.0, 90.0];
        assert_eq!(at(170.0, &stages), -170.0);
        let mut program = program(1);
        program.positions[0].rotation_rad = -2.97;
        program.stage = stages.config();
        let limits = Limits::DEFAULT.within(&program.stage);
        let plan = program.capture_plan(&[0], &limits).unwrap();
        let refused = plan.validate(&limits).unwrap_err().to_string();
        assert_eq!(
            refused,
            "rotation -2970000 urad is outside -1570796 urad .. 1570796 urad"
        );
    }

    #[test]
    fn a_code_is_refused_by_name() {
        let mut program = program(1);
        let code = flankscope_profilometry::gray::GrayCode {
            bits: 6,
            stripes: 48.0,
            origin_px: -0.5,
            complement: false,
        };
        program.patterns = program.patterns.with_code(Some(code)).unwrap();
        let error = program.capture_plan(&[0], &Limits::DEFAULT).unwrap_err();
        let set = "article8".to_owned();
        assert_eq!(error, ProgramError::GrayCode { set });
    }
}
