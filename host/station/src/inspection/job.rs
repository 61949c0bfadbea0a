//! The check from hello to verdict: orders to the controller, frames to sums, sums to flanks.
//!
//! ```text
//!  I/O runtime           capture thread            compute thread
//!  ───────────           ──────────────            ──────────────
//!  hello, home, plan ──► armed
//!  start ──────────────► frame, frame, … summed
//!  triggers collected    view ───────────► pair ─► points, registration, wear
//!  retracting                                      └► outcome ─► verdict
//! ```

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use flankscope_profilometry::date::Date;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, FrameKind};
use flankscope_protocol::{CapturePlan, Command, Event, FaultClass, FaultCode, PlanError, State};
use tokio::sync::mpsc as channel;
use tokio::time::Instant;

use super::evidence::{Phasors, Recipe};
use super::findings::Findings;
use super::pairing::pair;
use super::plan::{Itinerary, PlanningError, capture_plan};
use super::recorder::{
    CapturedView, Keepsake, Order, Orders, Recorded, Recorder, RecorderSettings, ViewError,
};
use super::result::{FrameCount, Handover, Inspection, Pictures, Timing};
use super::run::Run;
use super::views::{Evaluator, EvaluatorError, ViewOutcome};
use crate::baseline::Baseline;
use crate::capture::{Arm, Frame, FrameReceiver, ServiceError, SharedRoot, monotonic_ns};
use crate::controller::{Client, ClientError, ClientSettings};
use crate::history::{HistoryError, Keeper};

/// Longest silence of the controller during a capture: the longest move of the plan's timeouts, and a margin.
const EVENT_PATIENCE: Duration = Duration::from_secs(15);
/// Patience for the capture thread once every trigger was fired.
const FRAME_PATIENCE: Duration = Duration::from_secs(5);

/// Part of a hold limit that is kept for the way out: LED off, at most 0.3 s to stop, 0.8 s to retract, and a margin.
pub(super) const RETRACT_RESERVE: Duration = Duration::from_millis(1500);

/// What is inspected, with what.
#[derive(Clone, Debug)]
pub struct Subject {
    /// The tool.
    pub tool: Arc<flankscope_metrology::tool::Tool>,
    /// The head.
    pub head: Arc<flankscope_profilometry::HeadModel>,
    /// Temperature of the tool, degrees C, where it is known.
    pub temperature_degc: Option<f64>,
    /// The tool as it was when new; wear is then the difference to it.
    pub baseline: Option<Arc<Baseline>>,
    /// BLAKE3 of the files they came from.
    pub hashes: BTreeMap<&'static str, String>,
}

/// Why a check could not run at all. What goes wrong once it runs ends in an indeterminate verdict instead.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InspectError {
    /// No frames.
    #[error(transparent)]
    Services(#[from] ServiceError),
    /// No controller.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// No plan from this tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The plan breaks the controller's limits.
    #[error("the controller's limits do not allow the plan: {0}")]
    Plan(#[from] PlanError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The tool cannot be evaluated.
    #[error(transparent)]
    Evaluator(#[from] EvaluatorError),
    /// A thread ended early.
    #[error("the {thread} thread ended early")]
    Thread {
        /// Which.
        thread: &'static str,
    },
    /// What was found cannot be kept.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// The controller waits for somebody.
    #[error("the controller stands in {fault}; clear the cause and acknowledge it")]
    Faulted {
        /// Its fault.
        fault: FaultCode,
    },
}

/// How far a running check is; for somebody who watches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The controller answered.
    Connected,
    /// The stages reference.
    Homing,
    /// The head moves to a view (its number, of how many).
    Moving(usize, usize),
    /// A frame was exposed (view, frame of the view, of how many).
    Exposed(usize, u16, u16),
    /// A view is being captured again.
    Recapture(usize),
    /// A view's figures are too near to a limit: it is measured again.
    Repeat(usize),
    /// The stages retract.
    Retracting,
    /// A view's flanks are known.
    Evaluated(usize),
}

/// The instrument's host side: its threads run, frames have a place to arrive.
///
/// Made before the camera process starts, so that the services are there when it comes.
#[derive(Debug)]
pub struct Station<O = ViewOutcome, S = Subject> {
    pub(crate) subject: S,
    orders: Option<Orders>,
    recorded: channel::UnboundedReceiver<Recorded>,
    capture: Option<JoinHandle<()>>,
    work: Option<mpsc::Sender<(usize, Accumulator)>>,
    outcomes: channel::UnboundedReceiver<(usize, Box<O>)>,
    compute: Option<JoinHandle<()>>,
    pub(crate) itinerary: Arc<Itinerary>,
    /// Where checks are stored, if they are.
    pub(crate) keeper: Option<Keeper>,
}

impl Station {
    /// Starts the capture and compute threads for one subject, with frames arriving below `root`.
    ///
    /// # Errors
    /// The subject is unfit, or shared memory is refused.
    pub fn open(
        subject: Subject,
        teeth: Option<&[u32]>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, InspectError> {
        let itinerary = Arc::new(Itinerary::new(&subject.tool, &subject.head, teeth)?);
        let options = DecodeOptions::for_head(&subject.head);
        let decoder = Decoder::new(
            &subject.head,
            &itinerary.patterns,
            &itinerary.exposures_us,
            options,
        )?;
        let decoder = Arc::new(decoder);
        let evaluator = Evaluator::new(&subject, Arc::clone(&decoder), Arc::clone(&itinerary))?;
        let evaluate = move |view, sums: &Accumulator| {
            let mut outcome = evaluator.evaluate(view, sums);
            outcome.phasors.push(Phasors::of(sums));
            outcome
        };
        Self::start(subject, itinerary, decoder, root, evaluate)
    }

    /// Stores every check from now on: a verdict is then only given once it is on the disk.
    ///
    /// # Errors
    /// The history cannot be written.
    pub fn keep(&mut self, mut keeper: Keeper) -> Result<(), InspectError> {
        keeper.begin(&self.subject.tool.name, self.subject.baseline.as_deref())?;
        self.keeper = Some(keeper);
        Ok(())
    }

    /// Runs one check through the controller at `port`.
    ///
    /// # Errors
    /// The check could not begin. Once it has begun, every trouble ends in an indeterminate verdict.
    pub fn inspect(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        watch: impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|_| InspectError::Thread { thread: "I/O" })?;
        runtime.block_on(async {
            let mut client = Client::connect(port, settings).await?;
            let mut watch = watch;
            watch(Progress::Connected);
            self.make_ready(&mut client, &mut watch).await?;
            self.check(&mut client, None, &mut watch).await
        })
    }

    /// Runs one check with a controller that is ready. With a hold limit, counted by the controller's clock, the head is
    /// out again by then, done or not.
    pub(crate) async fn check(
        &mut self,
        client: &mut Client,
        hold_limit: Option<Duration>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        let begun_ns = monotonic_ns();
        let rotation_rad = f64::from(client.status().await?.rotation.get()) * 1e-6;
        let limits = client.identity().limits;
        let order = self.itinerary.order_from(rotation_rad);
        let mut run = Run::new(order.clone(), hold_limit);
        // What a head that must not judge would measure is not worth the press's time.
        let unfit = self.subject.head.fit_on(Date::today()).err();
        let mut stopped = match unfit {
            Some(unfit) => Some(unfit.to_string()),
            None => {
                self.capture(client, &mut run, &order, &limits, watch)
                    .await?
            }
        };
        let again = run.missing();
        if stopped.is_none() && !again.is_empty() {
            for &view in &again {
                watch(Progress::Recapture(view));
            }
            run.recaptured += again.len() as u32;
            stopped = self
                .capture(client, &mut run, &again, &limits, watch)
                .await?;
        }
        if stopped.is_none() {
            stopped = self
                .repeat_open_views(client, &mut run, &limits, watch)
                .await?;
        }
        let mut inspection = self.conclude(run, stopped, begun_ns, client);
        if let Some(keeper) = &mut self.keeper {
            keeper.keep(&mut inspection);
        }
        Ok(inspection)
    }

    fn conclude(
        &self,
        mut run: Run<ViewOutcome>,
        stopped: Option<String>,
        begun_ns: u64,
        client: &Client,
    ) -> Inspection {
        let found = Findings::of(
            &self.subject.tool,
            &self.itinerary,
            std::mem::take(&mut run.outcomes),
            &run.problems,
            stopped.as_deref(),
        );
        let positioning = run.timeline.positioning_ms();
        let exposure = run.timeline.exposure_ms();
        let mut versions = BTreeMap::new();
        let [major, minor, patch] = client.identity().firmware;
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        versions.insert("firmware", format!("{major}.{minor}.{patch}"));
        let since = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
        let recipe = Recipe::of(&self.subject, &self.itinerary);
        let mut hashes = self.subject.hashes.clone();
        hashes.insert("recipe", recipe.hash());
        Inspection {
            id: None,
            verdict: found.verdict.to_string(),
            reason: found.reason,
            features: found.features,
            timing_ms: Timing {
                total: since(begun_ns, monotonic_ns()),
                positioning,
                exposure,
                last_exposure_to_verdict: since(run.last_exposure_ns, run.verdict_ns),
            },
            frames: FrameCount {
                triggered: run.triggered,
                received: run.received,
                bytes_copied: Frame::bytes_copied(),
                recaptured_views: run.recaptured,
                handover_us: Handover::of(&mut run.handover_ns),
            },
            press_cycles: run.press_cycles,
            peak_memory_mb: peak_memory_mb(),
            registration: found.registration,
            tool: self.subject.tool.name.clone(),
            temperature_degc: self.subject.temperature_degc,
            versions,
            hashes,
            recipe,
            evidence: found.evidence,
            stopped,
            phasors: found.phasors,
            fields: found.fields,
            pictures: Pictures {
                maps: found.maps,
                deviations_um: found.deviations_um,
                lanes: run.timeline.lanes(),
                frame: run.picture,
            },
        }
    }
}

impl<O: Send + 'static, S> Station<O, S> {
    /// Starts the capture thread, and the compute thread with what it makes of a view's sums.
    pub(crate) fn start(
        subject: S,
        itinerary: Arc<Itinerary>,
        decoder: Arc<Decoder>,
        root: Arc<SharedRoot>,
        mut evaluate: impl FnMut(usize, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, InspectError> {
        let settings = RecorderSettings {
            dark_limit_dn: decoder.dark_limit_dn(),
            keepsake: Keepsake {
                exposure: itinerary.exposures_us.len() as u16 / 2,
                pattern: itinerary.patterns.frames_per_exposure() as u16,
            },
            full_scale_dn: decoder.full_scale_dn(),
        };
        let (order_sender, order_receiver) = mpsc::channel();
        let (recorded_sender, recorded) = channel::unbounded_channel();
        let (ready_sender, ready) = mpsc::channel();
        let capture_decoder = Arc::clone(&decoder);
        // Ports stay on the thread that made them.
        let capture = std::thread::Builder::new()
            .name("capture".into())
            .spawn(move || {
                let receiver = match FrameReceiver::create(&root) {
                    Ok(receiver) => receiver,
                    Err(error) => return drop(ready_sender.send(Err(error))),
                };
                let _ = ready_sender.send(Ok(()));
                let kinds: Vec<FrameKind> = capture_decoder.capture_order().collect();
                let fresh = || capture_decoder.begin();
                Recorder::new(
                    &receiver,
                    settings,
                    kinds,
                    order_receiver,
                    recorded_sender,
                    fresh,
                )
                .run();
            });
        let capture = capture.map_err(|_| InspectError::Thread { thread: "capture" })?;
        ready
            .recv()
            .map_err(|_| InspectError::Thread { thread: "capture" })??;
        let (work, to_do) = mpsc::channel::<(usize, Accumulator)>();
        let (outcome_sender, outcomes) = channel::unbounded_channel();
        let recycle = order_sender.clone();
        let compute = std::thread::Builder::new()
            .name("compute".into())
            .spawn(move || {
                while let Ok((view, accumulator)) = to_do.recv() {
                    let outcome = evaluate(view, &accumulator);
                    let _ = recycle.send(Order::Recycle(accumulator));
                    if outcome_sender.send((view, Box::new(outcome))).is_err() {
                        return;
                    }
                }
            });
        let compute = compute.map_err(|_| InspectError::Thread { thread: "compute" })?;
        Ok(Self {
            subject,
            orders: Some(order_sender),
            recorded,
            capture: Some(capture),
            work: Some(work),
            outcomes,
            compute: Some(compute),
            itinerary,
            keeper: None,
        })
    }

    /// Brings a controller without a fault to `Ready`: references its stages if they are not.
    pub(crate) async fn make_ready(
        &self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), InspectError> {
        let status = client.status().await?;
        if let Some(fault) = status.fault {
            return Err(InspectError::Faulted { fault });
        }
        if status.homed {
            return Ok(());
        }
        watch(Progress::Homing);
        client.order(&Command::Home).await?;
        loop {
            match client.event(EVENT_PATIENCE).await? {
                Event::StateChanged {
                    next: State::Ready, ..
                } => return Ok(()),
                Event::Fault { fault, .. } => return Err(InspectError::Faulted { fault }),
                _ => {}
            }
        }
    }

    /// Captures `views`; returns why the capture stopped early, if it did.
    pub(crate) async fn capture(
        &mut self,
        client: &mut Client,
        run: &mut Run<O>,
        views: &[usize],
        limits: &flankscope_protocol::Limits,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<String>, InspectError> {
        let plan = capture_plan(&self.itinerary, views, limits)?;
        plan.validate(limits)?;
        run.begin_session(views);
        // Whatever the controller did before it answers this belongs to an earlier capture.
        client.status().await?;
        client.forget_events();
        self.order(Order::Arm(arm_of(&plan)))?;
        self.armed(run).await?;
        client.order(&Command::LoadPlan(plan.clone())).await?;
        client
            .order(&Command::Start {
                session: plan.session,
            })
            .await?;
        // The press is held from here on: this is how many cycles the die has seen.
        run.press_cycles = client.status().await?.press.cycles;
        match self.follow(client, run, &plan, watch).await {
            Ok(stopped) => Ok(stopped),
            // The check had begun: a link that breaks now leaves the verdict open instead of ending the program.
            Err(error) => Ok(Some(error.to_string())),
        }
    }

    /// Waits until frames are labelled for the new plan: an earlier one would count for the old.
    async fn armed(&mut self, run: &mut Run<O>) -> Result<(), InspectError> {
        let gone = InspectError::Thread { thread: "capture" };
        loop {
            match self.recorded.recv().await {
                Some(Recorded::Armed) => return Ok(()),
                Some(Recorded::Picture(picture)) => run.picture = Some(picture),
                Some(Recorded::View(_) | Recorded::Closed) => {}
                None => return Err(gone),
            }
        }
    }

    /// Follows events and frames until the capture is done or has failed and every whole view is evaluated; returns
    /// why it failed, if it did.
    async fn follow(
        &mut self,
        client: &mut Client,
        run: &mut Run<O>,
        plan: &CapturePlan,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<String>, InspectError> {
        let frames = plan.frames_per_view();
        let mut failure = None;
        // Set when the controller has nothing more to say, to the time by which the capture thread must have answered.
        let mut captured: Option<Instant> = None;
        let (mut closing, mut closed) = (false, false);
        loop {
            self.evaluate_whole_views(run, frames)?;
            match captured {
                Some(_) if closed && run.evaluating == 0 => return Ok(failure),
                Some(limit) if !closed && Instant::now() > limit => {
                    return Ok(Some("the capture thread does not answer".into()));
                }
                _ => {}
            }
            tokio::select! {
                recorded = self.recorded.recv() => match recorded.ok_or(InspectError::Thread { thread: "capture" })? {
                    Recorded::View(view) => run.waiting.push(*view),
                    Recorded::Closed => closed = true,
                    Recorded::Armed => {}
                    Recorded::Picture(picture) => run.picture = Some(picture),
                },
                outcome = self.outcomes.recv() => {
                    let (view, outcome) = outcome.ok_or(InspectError::Thread { thread: "compute" })?;
                    watch(Progress::Evaluated(view));
                    run.evaluated(view, *outcome);
                }
                () = tokio::time::sleep(Duration::from_millis(200)), if captured.is_some() => {}
                event = client.event(EVENT_PATIENCE), if captured.is_none() => {
                    let (mut done, mut retracting) = (false, false);
                    match event {
                        Err(error) => {
                            failure.get_or_insert(error.to_string());
                            done = true;
                        }
                        Ok(event) => {
                            tracing::debug!(?event);
                            run.timeline.note(&event);
                            match event {
                                Event::StateChanged { next: State::Moving, .. } => {
                                    watch(Progress::Moving(run.views_begun(), run.session.len()));
                                }
                                Event::StateChanged { next: State::Retracting, .. } => {
                                    watch(Progress::Retracting);
                                    retracting = true;
                                }
                                Event::Triggered(trigger) => {
                                    watch(Progress::Exposed(usize::from(trigger.view), trigger.frame, frames));
                                    run.triggered(trigger);
                                }
                                Event::Fault { fault, .. }
                                    if fault.known().is_none_or(|f| f.class() != FaultClass::Limit) =>
                                {
                                    failure.get_or_insert(fault.to_string());
                                }
                                Event::EventsLost { count, .. } => {
                                    failure.get_or_insert(format!("{count} events were lost in the controller"));
                                }
                                Event::CaptureDone { .. }
                                | Event::StateChanged { next: State::Faulted | State::Ready, .. } => done = true,
                                _ => {}
                            }
                        }
                    }
                    // The press is not held any longer, whatever is still missing.
                    if !done && run.hold_limit.is_some_and(|limit| run.timeline.elapsed() + RETRACT_RESERVE > limit) {
                        run.hold_limit = None;
                        failure.get_or_insert("the check did not fit into the time for which the press may be held".into());
                        client.order(&Command::Abort).await?;
                    }
                    // Every trigger has been fired when the head begins to retract: the last views need not wait longer.
                    if (retracting || done) && !closing {
                        self.order(Order::Close)?;
                        closing = true;
                    }
                    if done {
                        captured = Some(Instant::now() + FRAME_PATIENCE);
                    }
                }
            }
        }
    }

    /// Sends every view whose triggers and frames are complete and pair to the compute thread.
    fn evaluate_whole_views(
        &self,
        run: &mut Run<O>,
        frames_per_view: u16,
    ) -> Result<(), InspectError> {
        let work = self
            .work
            .as_ref()
            .ok_or(InspectError::Thread { thread: "compute" })?;
        for captured in run.take_complete(frames_per_view) {
            let CapturedView {
                view,
                accumulator,
                frames,
                handover_ns,
                problem,
            } = captured;
            let Some(view_number) = run.session.get(usize::from(view)).copied() else {
                // A frame beyond the plan: one more than was triggered, and nobody knows before which of the others.
                run.spoil_session("the camera sent a frame beyond the plan");
                self.order(Order::Recycle(accumulator))?;
                continue;
            };
            let triggers = run
                .triggers
                .get(usize::from(view))
                .map_or(&[][..], Vec::as_slice);
            let result = match problem {
                Some(problem) => Err(problem),
                None => pair(triggers, &frames).map_err(ViewError::from),
            };
            match result {
                Ok(()) => {
                    run.received += frames.len() as u64;
                    run.handover_ns.extend(handover_ns);
                    let ended = frames
                        .last()
                        .map_or(0, |frame| frame.exposure_end_monotonic_ns);
                    run.last_exposure_ns = run.last_exposure_ns.max(ended);
                    run.evaluating += 1;
                    work.send((view_number, accumulator))
                        .map_err(|_| InspectError::Thread { thread: "compute" })?;
                }
                Err(problem) => {
                    tracing::warn!(view = view_number, %problem, "view refused");
                    run.spoil(view_number, &problem.to_string());
                    self.order(Order::Recycle(accumulator))?;
                }
            }
        }
        Ok(())
    }

    fn order(&self, order: Order) -> Result<(), InspectError> {
        let gone = InspectError::Thread { thread: "capture" };
        self.orders.as_ref().ok_or(gone).and_then(|orders| {
            orders
                .send(order)
                .map_err(|_| InspectError::Thread { thread: "capture" })
        })
    }
}

impl<O, S> Drop for Station<O, S> {
    fn drop(&mut self) {
        // The threads end when their orders end.
        self.orders = None;
        self.work = None;
        for thread in [self.compute.take(), self.capture.take()]
            .into_iter()
            .flatten()
        {
            let _ = thread.join();
        }
    }
}

/// High-water mark of this process's resident memory, from the kernel.
pub(crate) fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let kilobytes = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    kilobytes
        .trim()
        .trim_end_matches(" kB")
        .parse::<f64>()
        .ok()
        .map(|kb| kb / 1024.0)
}

fn arm_of(plan: &CapturePlan) -> Arm {
    Arm {
        session: plan.session,
        first_view: 0,
        views: plan.views.len() as u16,
        exposures: plan.exposures.len() as u16,
        patterns: plan.pattern_count(),
    }
}
