//! The check from hello to verdict: views captured, evaluated as they come, joined to one verdict.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use flankscope_foundation::date::{self, Date};
use flankscope_metrology::verdict::Reason;
use flankscope_profilometry::{Accumulator, DecodeError, Decoder};

use super::evidence::{Phasors, Recipe};
use super::failure;
use super::findings::Findings;
use super::outcome::ViewOutcome;
use super::plan::{Light, PlanningError, ViewPlan};
use super::result::{FrameCount, Inspection, Pictures, Timing, Toothing};
use super::views::{Evaluator, EvaluatorError, hand_eye};
use crate::acquisition::{
    Acquisition, AcquisitionError, AfterStop, Playback, Progress, RecordingError, Route, Run, Stop,
    ViewError,
};
use crate::baseline::Baseline;
use crate::controller::{Client, ClientSettings};
use crate::die::DieKey;
use crate::origin::{HeadId, Origin, Setting};
use crate::poses::{PoseError, PoseProgram, PoseSource};
use crate::seal::Seals;
use crate::settings::StationSettings;
use crate::sink::{ResultSink, SinkError};
use flankscope_frames::{FrameReceiver, FrameSource, SharedRoot, monotonic_ns};
use flankscope_protocol::View;

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
    /// The instrument that looks at it.
    pub station: Arc<StationSettings>,
    /// How the head is known, in words: signed, trusted by somebody, or unsigned.
    pub head_seal: String,
    /// The station's key, and what it believes.
    pub seals: Seals,
    /// BLAKE3 of the files they came from.
    pub hashes: BTreeMap<&'static str, String>,
}

impl Subject {
    /// What the die is known by.
    #[must_use]
    pub fn die(&self) -> DieKey {
        // A gear is names and numbers: nothing of it can fail to be JSON.
        let gear = serde_json::to_string(&self.tool.gear).unwrap_or_default();
        let cad = self.hashes.get("cad").map_or("", String::as_str);
        DieKey {
            tool: self.tool.name.clone(),
            geometry: crate::files::hash(format!("{cad} {gear}").as_bytes()),
            serial: self.tool.serial.clone(),
        }
    }

    /// What a result says of where it comes from, found in this setting.
    pub(crate) fn origin(&self, setting: &Setting) -> Origin {
        Origin::new(setting, self.head_id())
    }

    /// The head that looks, and how it is known.
    #[must_use]
    pub fn head_id(&self) -> HeadId {
        HeadId {
            name: self.head.name.clone(),
            blake3: self.hashes.get("head").cloned().unwrap_or_default(),
            seal: self.head_seal.clone(),
        }
    }
}

/// Why a check could not run at all. What goes wrong once it runs ends in an indeterminate verdict instead.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InspectError {
    /// What was found cannot be kept, and the store does not say so in the verdict.
    #[error(transparent)]
    Store(#[from] SinkError),
    /// Controller or camera cannot be worked with.
    #[error(transparent)]
    Acquisition(#[from] AcquisitionError),
    /// The recorded frames cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No plan from this tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The tool cannot be evaluated.
    #[error(transparent)]
    Evaluator(#[from] EvaluatorError),
    /// Nobody can say where the camera stands.
    #[error(transparent)]
    Pose(#[from] PoseError),
}

/// The instrument's host side for checks: its threads run, frames have a place to arrive.
#[derive(Debug)]
pub struct Station {
    pub(crate) subject: Subject,
    pub(crate) plan: Arc<ViewPlan>,
    pub(crate) acquisition: Acquisition<ViewOutcome>,
    /// Where it works.
    pub(super) setting: Setting,
    /// Largest count of the camera.
    pub(super) full_scale_dn: u16,
    /// Who is asked where the camera stands.
    poses: Option<PoseProgram>,
}

impl Station {
    /// Starts the capture and compute threads for one subject, with frames arriving below `root`. Results say that they
    /// come from `setting`. `light` is that of pictures other than the plain ones.
    ///
    /// # Errors
    /// The subject is unfit, or shared memory is refused.
    pub fn open(
        subject: Subject,
        setting: Setting,
        teeth: Option<&[u32]>,
        light: Option<Light>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, InspectError> {
        let plain = ViewPlan::new(&subject.tool, &subject.head, teeth)?;
        let plan = match light {
            Some(light) => plain.lit(light),
            None => plain,
        };
        plan.check_way(&subject.tool, &subject.head, &subject.station)?;
        let poses = match subject.station.stages.poses.open()? {
            Some(PoseSource::Table(table)) => {
                table.fits(subject.station.stages.moves, plan.views.len())?;
                plan.take_poses(&table, hand_eye(&subject)?)?;
                None
            }
            Some(PoseSource::Program(program)) => Some(program),
            None => None,
        };
        let decoder = Arc::new(plan.decoder(&subject.head, None)?);
        let source = move || Ok(FrameReceiver::create(&root)?);
        let station = Self::fed_by(source, subject, setting, plan, decoder)?;
        Ok(Self { poses, ..station })
    }

    /// The same for frames that were recorded, and the end at which they are called for.
    pub(super) fn of_recording(
        subject: Subject,
        setting: Setting,
        plan: ViewPlan,
    ) -> Result<(Self, Playback), InspectError> {
        let decoder = Arc::new(plan.decoder(&subject.head, None)?);
        let camera = &subject.head.camera;
        let size_px = [camera.width_px, camera.height_px];
        let (playback, source) =
            Playback::new(size_px, decoder.full_scale_dn(), &plan.exposures_us);
        let station = Self::fed_by(move || Ok(source), subject, setting, plan, decoder)?;
        Ok((station, playback))
    }

    fn fed_by<S: FrameSource>(
        source: impl FnOnce() -> Result<S, AcquisitionError> + Send + 'static,
        subject: Subject,
        setting: Setting,
        plan: ViewPlan,
        decoder: Arc<Decoder>,
    ) -> Result<Self, InspectError> {
        let evaluator = Evaluator::new(&subject, Arc::clone(&decoder), &plan)?;
        let evaluate = move |view, sums: &Accumulator| {
            let mut outcome = evaluator.evaluate(view, sums);
            outcome.phasors.push(Phasors::of(sums));
            outcome
        };
        let program = plan.program(&subject.station);
        let acquisition = Acquisition::start(program, &decoder, source, evaluate)?;
        Ok(Self {
            subject,
            plan: Arc::new(plan),
            acquisition,
            setting,
            full_scale_dn: decoder.full_scale_dn(),
            poses: None,
        })
    }

    /// Name of the tool that is checked.
    #[must_use]
    pub fn tool(&self) -> &str {
        &self.subject.tool.name
    }

    /// What the die is known by.
    #[must_use]
    pub fn die(&self) -> DieKey {
        self.subject.die()
    }

    /// What is in the middle of every view of the plan: a tooth, or a patch.
    #[must_use]
    pub fn view_names(&self) -> Vec<String> {
        let features = self.subject.tool.features();
        let views = self.plan.views.iter();
        views.map(|view| features.name(view.tooth)).collect()
    }

    /// Runs one check through the controller at `port`; the verdict waits for `store`.
    ///
    /// # Errors
    /// The check could not begin. Once it has begun, every trouble ends in an indeterminate verdict.
    pub fn inspect(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        store: &mut impl ResultSink<Inspection>,
        mut watch: impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|_| AcquisitionError::Thread { thread: "I/O" })?;
        runtime.block_on(async {
            let client = Client::connect(port, settings).await;
            let mut client = client.map_err(AcquisitionError::from)?;
            watch(Progress::Connected);
            self.acquisition.make_ready(&mut client, &mut watch).await?;
            let mut inspection = self.check(&mut client, None, &mut watch).await?;
            store.put(&mut inspection)?;
            Ok(inspection)
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
        let status = client.status().await.map_err(AcquisitionError::from)?;
        let stands = View {
            rotation: status.rotation,
            vertical: status.vertical,
        };
        let Route { order, time } = self.acquisition.program().quickest_from(stands);
        watch(Progress::Planned(time));
        let mut run = Run::new(order.clone(), hold_limit);
        // What a head that must not judge would measure is not worth the press's time.
        let stopped = match self.subject.head.fit_on(Date::today()) {
            Err(why) => Some(failure::unfit(&why)),
            Ok(()) => {
                let stopped = self.capture(client, &mut run, &order, watch).await?;
                stopped.as_ref().map(Reason::from)
            }
        };
        let firmware = client.identity().firmware;
        Ok(self.conclude(run, stopped, begun_ns, Some(firmware)))
    }

    /// Captures the views, and again what was lost or is too near to a limit.
    async fn capture(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        order: &[usize],
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        if self.poses.is_some() {
            return self.capture_where_told(client, run, order, watch).await;
        }
        let captured = self.acquisition.capture_settled(
            client,
            run,
            order,
            AfterStop::End,
            to_be_retaken,
            watch,
        );
        if let Some(stopped) = captured.await? {
            return Ok(Some(stopped));
        }
        self.repeat_open_views(client, run, watch).await
    }

    /// Captures one view after the other, each where somebody says that the camera stands. A view without a pose is not captured;
    /// none is measured again, for the camera has gone on.
    async fn capture_where_told(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        order: &[usize],
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        let stage_from_camera = hand_eye(&self.subject)?;
        for view in order {
            let wanted = self.plan.wanted(*view, stage_from_camera);
            self.plan.stated.remove(*view);
            let Some(program) = &mut self.poses else {
                break;
            };
            match program.reach(&wanted, &client.interrupt()).await {
                Ok(pose) => self.plan.stated.insert(*view, pose),
                Err(PoseError::Interrupted { .. }) => return Ok(Some(Stop::Interrupted)),
                Err(why) => {
                    tracing::warn!(view, %why, "no pose");
                    run.problems.insert(*view, ViewError::Pose(why.to_string()));
                    continue;
                }
            }
            let views = std::slice::from_ref(view);
            let captured = self.acquisition.capture_settled(
                client,
                run,
                views,
                AfterStop::End,
                to_be_retaken,
                watch,
            );
            if let Some(stopped) = captured.await? {
                return Ok(Some(stopped));
            }
        }
        Ok(None)
    }

    /// The result of a check, by a controller with this firmware if there was one.
    pub(super) fn conclude(
        &self,
        mut run: Run<ViewOutcome>,
        stopped: Option<Reason>,
        begun_ns: u64,
        firmware: Option<[u8; 3]>,
    ) -> Inspection {
        let problems = run.problems.iter();
        let problems = problems.map(|(&view, why)| (view, why.into())).collect();
        let found = Findings::of(
            &self.subject.tool,
            &self.plan,
            std::mem::take(&mut run.outcomes),
            &problems,
            stopped.as_ref(),
            self.subject.baseline.as_deref(),
        );
        let positioning = run.timeline.positioning_ms();
        let exposure = run.timeline.exposure_ms();
        let mut versions = BTreeMap::new();
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        if let Some([major, minor, patch]) = firmware {
            versions.insert("firmware", format!("{major}.{minor}.{patch}"));
        }
        let since = |from: u64, to: u64| to.saturating_sub(from) as f64 / 1e6;
        let recipe = Recipe::of(&self.subject, &self.plan);
        let mut hashes = self.subject.hashes.clone();
        hashes.insert("recipe", recipe.hash());
        Inspection {
            id: None,
            verdict: found.verdict,
            reason: found.reason,
            features: found.features,
            in_view: found.in_view,
            missing_teeth: found.missing_teeth,
            tooth_identity: found.tooth_identity,
            timing_ms: Timing {
                total: since(begun_ns, monotonic_ns()),
                positioning,
                exposure,
                last_exposure_to_verdict: since(
                    run.counts.last_exposure_ns,
                    run.counts.last_outcome_ns,
                ),
            },
            press_cycles: run.counts.press_cycles,
            frames: FrameCount::of(run.counts),
            peak_memory_mb: peak_memory_mb(),
            registration: found.registration,
            origin: self.subject.origin(&self.setting),
            date: date::now(),
            tool: self.subject.tool.name.clone(),
            die: self.subject.die(),
            temperature_degc: self.subject.temperature_degc,
            versions,
            hashes,
            recipe,
            evidence: found.evidence,
            truth: None,
            stopped: stopped.as_ref().map(Reason::to_string),
            stopped_code: stopped.as_ref().map(Reason::code),
            phasors: found.phasors,
            fields: found.fields,
            neighbours: found.neighbours,
            poses: found.poses,
            pictures: Pictures {
                maps: found.maps,
                deviations_um: found.deviations_um,
                activities: run.timeline.activities(),
                moves: self.subject.station.stages.moves,
                frame: run.picture,
                toothing: Toothing::of(&self.subject.tool),
            },
        }
    }
}

/// Views of an attempt that are to be captured once more: those without an outcome, and those whose exposures disagree.
fn to_be_retaken(
    run: &mut Run<ViewOutcome>,
    views: &[usize],
    _: Option<&Stop>,
) -> Result<Vec<usize>, AcquisitionError> {
    let again = |view: &usize| run.outcomes.get(view).is_none_or(|outcome| outcome.retake);
    Ok(views.iter().copied().filter(again).collect())
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
