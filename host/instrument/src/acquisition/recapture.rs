//! Which views are captured a second time: one policy for checks, scans and calibrations.

use flankscope_protocol::Limits;

use super::error::{AcquisitionError, Progress, Stop};
use super::run::Run;
use super::session::Acquisition;
use crate::controller::Client;

/// Captures of a view: the first, and one more if the first cannot be used. A view that fails twice has a persistent cause which
/// a third capture would not remove, and the press is waiting.
const ATTEMPTS: usize = 2;

/// What to do after a capture that ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterStop {
    /// End the run, because the press waits.
    End,
    /// Make the second attempt, because hours of other views may depend on it.
    GoOn,
}

impl<O: Send + 'static> Acquisition<O> {
    /// Captures `views`, then a second time those that `settle` returns. `settle` receives the views of an attempt and why it
    /// ended early, if it did, and returns the views still without a result. Returns why the last attempt ended early, if it did.
    /// There is no second attempt after an interruption.
    pub async fn capture_settled<E: From<AcquisitionError>>(
        &mut self,
        client: &mut Client,
        run: &mut Run<O>,
        views: &[usize],
        after_stop: AfterStop,
        mut settle: impl FnMut(&mut Run<O>, &[usize], Option<&Stop>) -> Result<Vec<usize>, E>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, E> {
        let limits: Limits = client.identity().limits;
        let mut open = views.to_vec();
        let mut stopped = None;
        for attempt in 0..ATTEMPTS {
            if attempt > 0 {
                for &view in &open {
                    watch(Progress::Recapture(view));
                }
                run.counts.recaptured += open.len() as u32;
            }
            stopped = self.capture(client, run, &open, &limits, watch).await?;
            open = settle(run, &open, stopped.as_ref())?;
            let ends = match stopped {
                Some(Stop::Interrupted) => true,
                Some(_) => after_stop == AfterStop::End,
                None => false,
            };
            if open.is_empty() || ends {
                break;
            }
        }
        Ok(stopped)
    }
}
