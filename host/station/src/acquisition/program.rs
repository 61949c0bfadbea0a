//! What stages, pattern projector and camera are to do, and how that is put to the controller.

use flankscope_profilometry::PatternSet;
use flankscope_protocol::{
    CapturePlan, FringeSet, Limits, Micrometres, Microradians, Microseconds, Milliamps, Timeouts,
    View,
};

use crate::settings::{Light, Timing};

/// Where the stages stand for a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePosition {
    /// Commanded angle of the rotary stage, rad.
    pub rotation_rad: f64,
    /// Commanded position of the vertical stage, mm.
    pub vertical_mm: f64,
}

/// All views of a run and how each is exposed.
#[derive(Clone, Debug)]
pub struct Program {
    /// Where the stages stand for each view.
    pub positions: Vec<StagePosition>,
    /// Fringe patterns.
    pub patterns: PatternSet,
    /// Exposure times, ascending, µs.
    pub exposures_us: Vec<u32>,
    /// Vertical position of the retracted head, mm.
    pub retract_mm: f64,
    /// How long everything settles.
    pub timing: Timing,
    /// How bright it is.
    pub light: Light,
}

/// What a capture plan cannot say.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProgramError {
    /// More than it holds.
    #[error("{got} {what} are too many for one capture; at most {limit}")]
    TooMany {
        /// Views, exposures or fringe sets.
        what: &'static str,
        /// How many were asked for.
        got: usize,
        /// How many a plan holds.
        limit: usize,
    },
    /// The controller shows fringes only.
    #[error(
        "pattern set \"{set}\" has a Gray code, which the controller's capture plan cannot ask for: recorded frames (--frames) may have one"
    )]
    GrayCode {
        /// The set.
        set: String,
    },
}

impl Program {
    /// The capture plan for some of its views, under a session number of its own.
    ///
    /// # Errors
    /// More views, sets or exposures than a plan holds, or a code.
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
            retract: Micrometres((self.retract_mm * 1e3).round() as i32),
            timeouts: Timeouts::default(),
        };
        let too_many = |what, got, limit| ProgramError::TooMany { what, got, limit };
        let limit = plan.views.capacity();
        for at in views.iter().filter_map(|&view| self.positions.get(view)) {
            let view = View {
                rotation: Microradians((at.rotation_rad * 1e6).round() as i32),
                vertical: Micrometres((at.vertical_mm * 1e3).round() as i32),
            };
            let pushed = plan.views.push(view);
            pushed.map_err(|_| too_many("views", views.len(), limit))?;
        }
        let limit = plan.exposures.capacity();
        for &exposure in &self.exposures_us {
            let pushed = plan.exposures.push(Microseconds(exposure));
            pushed.map_err(|_| too_many("exposures", self.exposures_us.len(), limit))?;
        }
        let limit = plan.fringes.capacity();
        for set in &self.patterns.sets {
            let set = FringeSet {
                periods: set.periods.round().clamp(0.0, f64::from(u16::MAX)) as u16,
                steps: u8::try_from(set.steps).unwrap_or(u8::MAX),
            };
            let pushed = plan.fringes.push(set);
            pushed.map_err(|_| too_many("fringe sets", self.patterns.sets.len(), limit))?;
        }
        Ok(plan)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program(views: usize) -> Program {
        Program {
            positions: (0..views)
                .map(|view| StagePosition {
                    rotation_rad: 1e-3 * view as f64,
                    vertical_mm: 33.0,
                })
                .collect(),
            patterns: PatternSet::named("article8").unwrap(),
            exposures_us: vec![10_000],
            retract_mm: 86.0,
            timing: Timing::default(),
            light: Light::default(),
        }
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
