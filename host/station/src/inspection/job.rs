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
use std::time::Duration;

use flankscope_frames::{Frame, ServiceError, SharedRoot, monotonic_ns};
use flankscope_profilometry::date::Date;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder};
use flankscope_protocol::{FaultCode, PlanError};

use super::evidence::{Phasors, Recipe};
use super::findings::Findings;
use super::plan::{Itinerary, PlanningError};
use super::result::{FrameCount, Handover, Inspection, Pictures, Timing};
use super::run::Run;
use super::station::Station;
use super::views::{Evaluator, EvaluatorError, ViewOutcome};
use crate::baseline::Baseline;
use crate::controller::{Client, ClientError, ClientSettings};
use crate::history::{HistoryError, Keeper};
use crate::origin::{self, HeadId, Origin, Setting};

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

impl Subject {
    /// What a result says of where it comes from, found in this setting.
    pub(crate) fn origin(&self, setting: Option<&Setting>) -> Origin {
        let head = HeadId {
            name: self.head.name.clone(),
            blake3: self.hashes.get("head").cloned().unwrap_or_default(),
        };
        Origin::new(setting, head)
    }
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

impl Station {
    /// Starts the capture and compute threads for one subject, with frames arriving below `root`. Results say that they
    /// come from `setting`.
    ///
    /// # Errors
    /// The subject is unfit, or shared memory is refused.
    pub fn open(
        subject: Subject,
        setting: Setting,
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
        let mut station = Self::start(subject, itinerary, decoder, root, evaluate)?;
        station.setting = Some(setting);
        Ok(station)
    }

    /// Stores every check from now on: a verdict is then only given once it is on the disk.
    ///
    /// # Errors
    /// The history cannot be written, or is of the simulated bench where this is a press, or the other way around.
    pub fn keep(&mut self, mut keeper: Keeper) -> Result<(), InspectError> {
        let simulated = self.setting.as_ref().map(|s| s.link.is_simulated());
        let baseline = self.subject.baseline.as_deref();
        keeper.begin(&self.subject.tool.name, simulated, baseline)?;
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
            self.subject.baseline.is_some(),
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
            origin: self.subject.origin(self.setting.as_ref()),
            date: origin::now(),
            tool: self.subject.tool.name.clone(),
            temperature_degc: self.subject.temperature_degc,
            versions,
            hashes,
            recipe,
            evidence: found.evidence,
            stopped,
            phasors: found.phasors,
            fields: found.fields,
            poses: found.poses,
            pictures: Pictures {
                maps: found.maps,
                deviations_um: found.deviations_um,
                lanes: run.timeline.lanes(),
                frame: run.picture,
            },
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
