//! Which stages answer: the station's, or others, which nothing may move.

use super::signals::{Action, Actions, push};
use super::{Sequence, Step};
use crate::stage_fault::StageFault;
use flankscope_protocol::{Event, Fault, StageName, Timestamp, Why};

impl Sequence {
    /// Tells the host what the stages answered. Who waits for it, a reference run or a capture, goes on or has failed.
    pub(super) fn stages_are(
        &mut self,
        now: Timestamp,
        outcome: Result<[StageName; 2], StageFault>,
        out: &mut Actions,
    ) {
        let answers = outcome.map_or_else(
            |failed| [Err(failed.fault.code()); 2],
            |names| names.map(Ok),
        );
        for ((axis, _), answer) in self.stage_to_be().models().into_iter().zip(answers) {
            let at = now;
            push(
                out,
                Action::Report(Event::StageIdentity { axis, answer, at }),
            );
        }
        let waits = match self.step {
            Step::Identifying { .. } => true,
            Step::Claiming { .. } => !self.stages_known,
            _ => false,
        };
        if !waits {
            return;
        }
        let other = outcome.map(|names| self.stage.other_model(&names));
        match other {
            Ok(None) if matches!(self.step, Step::Identifying { .. }) => {
                self.search_home(now, Why::Sequence, out);
            }
            Ok(None) => {
                self.stages_known = true;
                self.enter_die(now, out);
            }
            Ok(Some(axis)) => {
                // Where another stage stands nobody knows, and it must not move to be retracted either.
                (self.homed, self.parked) = (false, false);
                self.fail(now, Fault::OtherStage, u32::from(axis), out);
            }
            Err(StageFault { fault, detail }) => self.fail(now, fault, detail, out),
        }
    }

    /// Off to the first view, once the head may enter and the stages are the station's.
    pub(super) fn enter_die(&mut self, now: Timestamp, out: &mut Actions) {
        if let Step::Claiming { .. } = self.step
            && self.may_enter
            && self.stages_known
        {
            self.move_to_view(now, Why::Sequence, out);
        }
    }
}
