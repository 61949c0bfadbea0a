//! What is captured once more: one policy for checks, scans and calibrations.

use flankscope_protocol::Limits;

use super::error::{AcquisitionError, Progress, Stop};
use super::run::Run;
use super::session::Acquisition;
use crate::controller::Client;

/// Captures of a view: the first, and one more where the first cannot be used. What fails twice fails for a reason that a
/// third time does not take away, and the press waits.
const ATTEMPTS: usize = 2;

/// What follows on a capture that ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterStop {
    /// Nothing: the press waits.
    End,
    /// The other attempt: hours of views may depend on it.
    GoOn,
}

impl<O: Send + 'static> Acquisition<O> {
    /// Captures `views`, and once more those that `settle` returns: it is told the views of an attempt and why that ended
    /// early, if it did, and says which of them are still without a result. Returns why the last attempt ended early, if it
    /// did; after an interruption there is no other.
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
