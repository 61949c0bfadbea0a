//! Repeats measurements of wear that is too near to a limit, while there is time.

use std::time::Duration;

use flankscope_protocol::{Event, Refusal};
use tokio::time::Instant;

use super::job::InspectError;
use super::outcome::ViewOutcome;
use crate::job::Job;
use flankscope_instrument::acquisition::{AcquisitionError, Progress, RETRACT_RESERVE, Run, Stop};
use flankscope_instrument::controller::{Client, ClientError};

/// How the repeated capture of views ended.
enum Repeated {
    /// All views were captured.
    Whole,
    /// It ended early, for this reason.
    Stopped(Stop),
    /// The press did not open within the wait.
    NotLetIn,
}

impl Job<ViewOutcome> {
    /// Repeats, as often as the tool file allows and while there is time, the views whose wear is too near to a limit. Returns
    /// why that stopped early, if it did.
    pub(super) async fn repeat_open_views(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        let inspect = self.subject.tool.inspect.as_ref();
        // The time of one way in and out, and of a visit to each view.
        let visit = run.timeline.elapsed() / (run.wanted.len() as u32 + 1);
        for _ in 0..inspect.map_or(0, |inspect| inspect.remeasure) {
            let is_open = |view: &usize| run.outcomes.get(view).is_some_and(ViewOutcome::is_open);
            let open: Vec<usize> = run.wanted.iter().copied().filter(is_open).collect();
            let needed = visit * (open.len() as u32 + 1) + RETRACT_RESERVE;
            let in_time = run
                .hold_limit
                .is_none_or(|limit| run.timeline.elapsed() + needed <= limit);
            if open.is_empty() || !in_time {
                return Ok(None);
            }
            for &view in &open {
                watch(Progress::Repeat(view));
            }
            let before = std::mem::take(&mut run.outcomes);
            let captured = self.capture_when_open(client, run, &open, watch).await;
            // A view that fails now keeps its earlier outcome.
            run.outcomes = ViewOutcome::joined(before, std::mem::take(&mut run.outcomes));
            match captured? {
                Repeated::Whole => {}
                Repeated::Stopped(why) => return Ok(Some(why)),
                Repeated::NotLetIn => return Ok(None),
            }
        }
        Ok(None)
    }

    /// Captures views at the next opening of the press, if it has gone on meanwhile.
    async fn capture_when_open(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        views: &[usize],
        watch: &mut impl FnMut(Progress),
    ) -> Result<Repeated, InspectError> {
        let limits = client.identity().limits;
        let press = &self.subject.station.press;
        let patience = Duration::from_secs_f64(press.opening_patience_s);
        for _ in 0..press.openings {
            let captured = self.acquisition.capture(client, run, views, &limits, watch);
            match captured.await {
                Ok(None) => return Ok(Repeated::Whole),
                Ok(Some(why)) => return Ok(Repeated::Stopped(why)),
                Err(AcquisitionError::Client(ClientError::Refused(Refusal::Interlock {
                    ..
                }))) => {}
                Err(error) => return Err(error.into()),
            }
            let end = Instant::now() + patience;
            loop {
                let patience = end.saturating_duration_since(Instant::now());
                let mut interrupt = client.interrupt();
                let event = tokio::select! {
                    event = client.event(patience) => event,
                    () = interrupt.requested() => return Ok(Repeated::Stopped(Stop::Interrupted)),
                };
                match event {
                    Ok(Event::PressOpen { open: true, .. }) => break,
                    Ok(_) => {}
                    Err(ClientError::NoEvent { .. }) => return Ok(Repeated::NotLetIn),
                    Err(error) => return Err(AcquisitionError::from(error).into()),
                }
            }
        }
        Ok(Repeated::NotLetIn)
    }
}
