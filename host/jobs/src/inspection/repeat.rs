//! Repeats measurements of wear that is too near to a limit, and looks from further places where too little was seen, while there is
//! time. Approaches the views of a baseline anew.

use std::collections::BTreeMap;
use std::time::Duration;

use flankscope_metrology::wear::{Approaches, PoseEvidence};
use flankscope_protocol::{Event, Refusal};
use tokio::time::Instant;

use super::job::InspectError;
use super::outcome::ViewOutcome;
use crate::job::Job;
use flankscope_instrument::acquisition::{AcquisitionError, Progress, Run, Stop};
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
    /// References the stages and captures all planned views again, as often as a baseline asks for it: what differs is what the stages do not
    /// repeat. Returns why that stopped early, if it did; a press that closes just leaves fewer approaches.
    pub(super) async fn approach_again(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        if self.further_approaches == 0 {
            return Ok(None);
        }
        let views: Vec<usize> = (0..self.plan.views.len()).collect();
        let mut approaches: BTreeMap<usize, Vec<PoseEvidence>> = BTreeMap::new();
        let mut keep = |outcomes: &BTreeMap<usize, ViewOutcome>| {
            for (&view, outcome) in outcomes {
                let evidence = outcome.pose.clone();
                approaches.entry(view).or_default().extend(evidence);
            }
        };
        keep(&run.outcomes);
        let mut ended = Repeated::Whole;
        for _ in 0..self.further_approaches {
            ended = match self.acquisition.reference(client, watch).await {
                Ok(()) => {
                    self.capture_again(client, run, &views, watch, &mut keep)
                        .await?
                }
                Err(AcquisitionError::Interrupted) => Repeated::Stopped(Stop::Interrupted),
                Err(AcquisitionError::Client(ClientError::Refused(Refusal::Interlock {
                    ..
                }))) => Repeated::NotLetIn,
                // The check had begun: what was measured is kept.
                Err(error) => Repeated::Stopped(error.into()),
            };
            if !matches!(ended, Repeated::Whole) {
                break;
            }
        }
        for (view, approaches) in &approaches {
            if let Some(outcome) = run.outcomes.get_mut(view) {
                outcome.pose = PoseEvidence::of_approaches(approaches);
            }
        }
        let views: Vec<Vec<PoseEvidence>> = approaches.into_values().collect();
        let sigma_rad = self.subject.station.stages.approach_sigma().0;
        self.approaches = Approaches::from_views(&views, sigma_rad);
        Ok(match ended {
            Repeated::Stopped(why) => Some(why),
            Repeated::Whole | Repeated::NotLetIn => None,
        })
    }

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
        let leaving = self.acquisition.program().leaving_time();
        for _ in 0..inspect.map_or(0, |inspect| inspect.remeasure) {
            let in_time = |views: usize| {
                let needed = visit * (views as u32 + 1) + leaving;
                let limit = run.hold_limit;
                limit.is_none_or(|limit| run.timeline.elapsed() + needed <= limit)
            };
            let is_open = |view: &usize| run.outcomes.get(view).is_some_and(ViewOutcome::is_open);
            let planned = run.wanted.iter().copied();
            let planned = planned.filter(|view| *view < self.plan.views.len());
            let mut again: Vec<usize> = planned.filter(is_open).collect();
            let further = self.further_wanted(run);
            if in_time(again.len() + further.len()) {
                again.extend(further);
            }
            again.truncate(flankscope_protocol::plan::MAX_VIEWS);
            if again.is_empty() || !in_time(again.len()) {
                return Ok(None);
            }
            for &view in &again {
                if view < self.plan.views.len() {
                    watch(Progress::Repeat(view));
                } else {
                    watch(Progress::Further(view));
                    run.wanted.push(view);
                }
            }
            let captured = self.capture_again(client, run, &again, watch, |_| {});
            match captured.await? {
                Repeated::Whole => {}
                Repeated::Stopped(why) => return Ok(Some(why)),
                Repeated::NotLetIn => return Ok(None),
            }
        }
        Ok(None)
    }

    /// Numbers of the further views that could decide a flank and that the stages reach. Nothing is known of the way there if
    /// something else than the stages moves the head.
    fn further_wanted(&self, run: &Run<ViewOutcome>) -> Vec<usize> {
        if !self.plan.stated.all().is_empty() {
            return Vec::new();
        }
        let positions = &self.acquisition.program().positions;
        let [from, to] = self
            .subject
            .station
            .stages
            .rotation
            .travel_deg
            .map(f64::to_radians);
        let is_reached = |view: &usize| {
            let at = positions.get(*view);
            at.is_some_and(|at| (from..=to).contains(&at.rotation_rad))
        };
        let outcomes = run.outcomes.values();
        let wanted = outcomes.flat_map(|outcome| outcome.further_wanted(&self.plan));
        wanted.filter(is_reached).collect()
    }

    /// Captures views once more and joins their outcomes with those before; `look` is shown the new ones. A view that fails now keeps its
    /// earlier outcome.
    async fn capture_again(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        views: &[usize],
        watch: &mut impl FnMut(Progress),
        look: impl FnOnce(&BTreeMap<usize, ViewOutcome>),
    ) -> Result<Repeated, InspectError> {
        let before = std::mem::take(&mut run.outcomes);
        let captured = self.capture_when_open(client, run, views, watch).await;
        let again = std::mem::take(&mut run.outcomes);
        look(&again);
        run.outcomes = ViewOutcome::joined(before, again, &self.plan);
        captured
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
