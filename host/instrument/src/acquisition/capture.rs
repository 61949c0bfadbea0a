//! One capture, from its plan to its last view: commands to the controller, its events, the camera's frames, complete views.

use std::time::Duration;

use flankscope_frames::Arm;
use flankscope_protocol::{CapturePlan, Command, Event, FaultClass, State};
use tokio::time::Instant;

use super::error::{AcquisitionError, CameraError, Progress, Stop, ViewError};
use super::pairing::{Lateness, PairingError, lateness, pair};
use super::recorder::{CapturedView, Order, Recorded};
use super::run::Run;
use super::session::Acquisition;
use crate::controller::Client;

/// Longest wait for the capture thread after the last trigger was fired.
const FRAME_PATIENCE: Duration = Duration::from_secs(5);

impl<O: Send + 'static> Acquisition<O> {
    /// Brings a controller without a fault to `Ready`: sends it the configuration of the stages, and references them if they are not.
    pub async fn make_ready(
        &self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let status = client.status().await?;
        if let Some(fault) = status.fault {
            return Err(AcquisitionError::Faulted { fault });
        }
        if self.program.lens.is_some() && !client.identity().lens {
            return Err(AcquisitionError::NoLens);
        }
        let (needed, fitted) = (self.program.projectors, client.identity().projectors);
        if needed > usize::from(fitted) {
            return Err(AcquisitionError::TooFewProjectors { needed, fitted });
        }
        client.configure(&self.program.stage).await?;
        if client.status().await?.homed {
            return Ok(());
        }
        self.reference(client, watch).await
    }

    /// References the stages of a controller that is ready for it.
    pub async fn reference(
        &self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        watch(Progress::Homing);
        client.order(&Command::Home).await?;
        let mut interrupt = client.interrupt();
        let silence = client.silence();
        let mut other = None;
        loop {
            let event = tokio::select! {
                event = client.event(silence) => event?,
                () = interrupt.requested() => {
                    client.order(&Command::Abort).await?;
                    return Err(AcquisitionError::Interrupted);
                }
            };
            match event {
                Event::StateChanged {
                    next: State::Ready, ..
                } => return Ok(()),
                Event::Fault { fault, .. } => {
                    return Err(other.unwrap_or(AcquisitionError::Faulted { fault }));
                }
                event => {
                    other = other.or(AcquisitionError::other_stage(&event, &self.program.stage));
                }
            }
        }
    }

    /// Captures `views`; returns why the capture stopped early, if it did.
    pub async fn capture(
        &mut self,
        client: &mut Client,
        run: &mut Run<O>,
        views: &[usize],
        limits: &flankscope_protocol::Limits,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, AcquisitionError> {
        if client.interrupt().is_requested() {
            return Ok(Some(Stop::Interrupted));
        }
        let plan = self.program.capture_plan(views, limits)?;
        plan.validate(limits)?;
        run.begin_session(views);
        // Events that the controller sent before it answers this command belong to an earlier capture.
        client.status().await?;
        client.forget_events();
        self.order(Order::Arm(Arm::of(&plan)))?;
        if let Err(camera) = self.armed(run).await? {
            return Ok(Some(camera.into()));
        }
        client.order(&Command::LoadPlan(plan.clone())).await?;
        client
            .order(&Command::Start {
                session: plan.session,
            })
            .await?;
        // The press is held from here on, so its counter tells how many cycles the die has seen.
        run.counts.press_cycles = client.status().await?.press.cycles;
        match self.follow(client, run, &plan, watch).await {
            Ok(stopped) => Ok(stopped),
            // The capture had begun: a link that breaks now leaves views without a result instead of ending the program.
            Err(error) => Ok(Some(error.into())),
        }
    }

    /// Waits until the camera reports that it is armed for the new plan and its queue is empty: a frame of the old plan would be
    /// counted for the new one.
    pub(super) async fn armed(
        &mut self,
        run: &mut Run<O>,
    ) -> Result<Result<(), CameraError>, AcquisitionError> {
        let gone = AcquisitionError::Thread { thread: "capture" };
        loop {
            match self.recorded.recv().await {
                Some(Recorded::Armed(armed)) => return Ok(armed),
                Some(Recorded::Picture(view, picture)) => run.pictured(view, picture),
                Some(Recorded::View(_) | Recorded::Closed) => {}
                None => return Err(gone),
            }
        }
    }

    /// Follows events and frames until the capture is done or has failed and every complete view is evaluated. Returns why it
    /// failed, if it did.
    async fn follow(
        &mut self,
        client: &mut Client,
        run: &mut Run<O>,
        plan: &CapturePlan,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, AcquisitionError> {
        let frames = plan.frames_per_view();
        let mut failure = None;
        let leaving = self.program.leaving_time();
        // Set once the controller sends no more events, to the time by which the capture thread must have answered.
        let mut captured: Option<Instant> = None;
        let (mut closing, mut closed) = (false, false);
        let silence = client.silence();
        let mut interrupt = client.interrupt();
        loop {
            self.evaluate_whole_views(run, frames, client.stall_limit())?;
            match captured {
                Some(_) if closed && run.session.evaluating == 0 => return Ok(failure),
                Some(limit) if !closed && Instant::now() > limit => {
                    return Ok(Some(Stop::Stalled));
                }
                _ => {}
            }
            tokio::select! {
                recorded = self.recorded.recv() => match recorded.ok_or(AcquisitionError::Thread { thread: "capture" })? {
                    Recorded::View(view) => run.session.waiting.push(*view),
                    Recorded::Closed => closed = true,
                    Recorded::Armed(_) => {}
                    Recorded::Picture(view, picture) => run.pictured(view, picture),
                },
                outcome = self.outcomes.recv() => {
                    let (view, outcome) = outcome.ok_or(AcquisitionError::Thread { thread: "compute" })?;
                    watch(Progress::Evaluated(view));
                    run.evaluated(view, *outcome);
                }
                () = tokio::time::sleep(Duration::from_millis(200)), if captured.is_some() => {}
                () = interrupt.requested(), if captured.is_none() && failure.is_none() => {
                    // The stages retract the head; the controller's events are followed until it is out.
                    failure = Some(Stop::Interrupted);
                    client.order(&Command::Abort).await?;
                }
                event = client.event(silence), if captured.is_none() => {
                    let (mut done, mut retracting) = (false, false);
                    // No event comes before the head is in position and still.
                    let mut until_next_event = Duration::ZERO;
                    match event {
                        Err(error) => {
                            failure.get_or_insert(Stop::Broken(error.into()));
                            done = true;
                        }
                        Ok(event) => {
                            tracing::debug!(?event);
                            run.timeline.note(&event);
                            if let Some(other) = AcquisitionError::other_stage(&event, &self.program.stage) {
                                failure.get_or_insert(Stop::Broken(other));
                            }
                            match event {
                                Event::StateChanged { next: State::Moving, .. } => {
                                    let begun = run.session.begun();
                                    let next = run.session.views.get(begun);
                                    if let Some(&view) = next {
                                        let last = begun.checked_sub(1).and_then(|last| run.session.views.get(last));
                                        until_next_event =
                                            last.map_or(Duration::ZERO, |&last| self.program.moving_time(last, view));
                                        let (number, of) = (run.number(view), run.wanted.len());
                                        watch(Progress::Moving { view, number, of });
                                    }
                                }
                                Event::StateChanged { next: State::Retracting, .. } => {
                                    watch(Progress::Retracting);
                                    retracting = true;
                                }
                                Event::Triggered(trigger) => {
                                    watch(Progress::Exposed { frame: trigger.frame, of: frames });
                                    run.triggered(trigger);
                                }
                                Event::Fault { fault, .. }
                                    if fault.known().is_none_or(|f| f.class() != FaultClass::Limit) =>
                                {
                                    failure.get_or_insert(Stop::Fault(fault));
                                }
                                Event::EventsLost { count, .. } => {
                                    failure.get_or_insert(Stop::EventsLost { count });
                                }
                                Event::CaptureDone { .. }
                                | Event::StateChanged { next: State::Faulted | State::Ready, .. } => done = true,
                                _ => {}
                            }
                        }
                    }
                    // All triggers have been fired once the head retracts, so the last views need not wait for more.
                    if (retracting || done) && !closing {
                        self.order(Order::Close)?;
                        closing = true;
                    }
                    // The press is released even if views are still missing; a head on its way out is left alone.
                    let needed = run.timeline.elapsed() + until_next_event + leaving;
                    if !closing && run.hold_limit.is_some_and(|limit| needed > limit) {
                        run.hold_limit = None;
                        failure.get_or_insert(Stop::HoldLimit);
                        client.order(&Command::Abort).await?;
                    }
                    if done {
                        captured = Some(Instant::now() + FRAME_PATIENCE);
                    }
                }
            }
        }
    }

    /// Sends every view whose triggers and frames are complete and pair one to one to the compute thread.
    pub(super) fn evaluate_whole_views(
        &mut self,
        run: &mut Run<O>,
        frames_per_view: u16,
        stall_limit: Option<Duration>,
    ) -> Result<(), AcquisitionError> {
        let work = self
            .work
            .as_ref()
            .ok_or(AcquisitionError::Thread { thread: "compute" })?;
        for captured in run.session.take_complete(frames_per_view) {
            let CapturedView {
                view,
                sums,
                frames,
                handover_ns,
                problem,
                saved,
                levels,
            } = captured;
            let Some(view_number) = run.session.views.get(usize::from(view)).copied() else {
                // One frame more than was triggered. Which of the frames is the extra one is unknown, so no view of the session is used.
                run.spoil_session();
                if let Some(saved) = saved {
                    self.saved.retain(|of| of.session != saved.session());
                    saved.discard();
                }
                self.order(Order::Recycle(sums))?;
                continue;
            };
            let triggers = run
                .session
                .triggers
                .get(usize::from(view))
                .map_or(&[][..], Vec::as_slice);
            let arrived_ns = run.session.arrived_ns.get(usize::from(view));
            let arrived_ns = arrived_ns.map_or(&[][..], Vec::as_slice);
            let late = lateness(triggers, arrived_ns, &frames, &handover_ns);
            let late = late.filter(|_| stall_limit.is_some());
            run.counts.late_ms = run
                .counts
                .late_ms
                .max(late.map_or(0.0, |late| late.late_ms));
            let result = match problem {
                Some(problem) => Err(problem),
                None => pair(triggers, &frames)
                    .and_then(|()| timely(late, stall_limit))
                    .map_err(ViewError::from),
            };
            match result {
                Ok(()) => {
                    run.counts.received += frames.len() as u64;
                    run.counts.handover_ns.extend(handover_ns);
                    let ended = frames
                        .last()
                        .map_or(0, |frame| frame.exposure_end_monotonic_ns);
                    run.counts.last_exposure_ns = run.counts.last_exposure_ns.max(ended);
                    let saved = saved.map(|saved| saved.of_view(view_number, triggers));
                    self.saved.extend(saved);
                    run.levels
                        .extend(levels.map(|levels| (view_number, levels)));
                    run.session.evaluating += 1;
                    work.send((view_number, sums))
                        .map_err(|_| AcquisitionError::Thread { thread: "compute" })?;
                }
                Err(problem) => {
                    tracing::warn!(view = run.number(view_number) + 1, %problem, "view refused");
                    run.spoil(view_number, problem);
                    if let Some(saved) = saved {
                        saved.discard();
                    }
                    self.order(Order::Recycle(sums))?;
                }
            }
        }
        Ok(())
    }
}

/// Checks that no leg from trigger to host was later than `limit`.
fn timely(late: Option<Lateness>, limit: Option<Duration>) -> Result<(), PairingError> {
    let (Some(late), Some(limit)) = (late, limit) else {
        return Ok(());
    };
    let limit_ms = limit.as_secs_f64() * 1e3;
    if late.late_ms <= limit_ms {
        return Ok(());
    }
    let Lateness {
        frame,
        leg,
        late_ms,
    } = late;
    Err(PairingError::Stalled {
        frame,
        leg,
        late_ms,
        limit_ms,
    })
}
