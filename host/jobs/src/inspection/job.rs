//! The check from connecting to the verdict: views are captured, evaluated as they arrive, and combined into one verdict.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use flankscope_foundation::date;
use flankscope_metrology::verdict::Reason;
use flankscope_profilometry::{Accumulator, DecodeError};

use super::findings::Findings;
use super::outcome::ViewOutcome;
use super::recipe::recipe;
use super::views::{Evaluator, EvaluatorError, hand_eye};
use crate::bookkeeping::{frame_count, last_exposure, peak_memory_mb, timing};
use crate::job::{self, Job, RecordedFrames, Source, connect, runtime};
use crate::plan::{PlanningError, ViewPlan};
use crate::subject::Subject;
use flankscope_frames::{SharedRoot, monotonic_ns};
use flankscope_instrument::acquisition::{
    AcquisitionError, AfterStop, Progress, RecordingError, Route, Run, Stop, ViewError,
};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_instrument::patterns::PatternLight;
use flankscope_instrument::poses::{PoseError, PoseSource};
use flankscope_protocol::View;
use flankscope_record::document::Phasors;
use flankscope_record::document::{Inspection, Pictures, Toothing};
use flankscope_record::origin::Setting;
use flankscope_record::sink::{ResultSink, SinkError};

/// Why a check could not run at all. Errors after it has begun give an indeterminate verdict instead.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The result cannot be stored, and the verdict does not state it.
    #[error(transparent)]
    Store(#[from] SinkError),
    /// Controller or camera cannot be used.
    #[error(transparent)]
    Acquisition(#[from] AcquisitionError),
    /// The recorded frames cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No plan of views follows from this tool and head.
    #[error(transparent)]
    Planning(#[from] PlanningError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The tool or head lacks data for the evaluation.
    #[error(transparent)]
    Evaluator(#[from] EvaluatorError),
    /// No source of camera poses.
    #[error(transparent)]
    Pose(#[from] PoseError),
}

impl Job<ViewOutcome> {
    /// Starts the threads of a check of the tool's teeth, or of `teeth`, with frames arriving below `root`. Results state
    /// `setting` as their origin. `light` describes pictures other than the plain ones.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, or shared memory cannot be created.
    pub fn check_live(
        subject: Subject,
        setting: Setting,
        teeth: Option<&[u32]>,
        light: Option<PatternLight>,
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
        let job = Self::start_check(subject, setting, plan, Some(root))?;
        Ok(Self { poses, ..job })
    }

    pub(super) fn start_check(
        subject: Subject,
        setting: Setting,
        plan: ViewPlan,
        camera: Option<Arc<SharedRoot>>,
    ) -> Result<Self, InspectError> {
        let decoder = Arc::new(plan.decoder(&subject.head, None)?);
        let evaluator = Evaluator::new(&subject, Arc::clone(&decoder), &plan)?;
        let evaluate = move |view, sums: &Accumulator| {
            let (mut outcome, phasors) =
                rayon::join(|| evaluator.evaluate(view, sums), || Phasors::of(sums));
            outcome.phasors.push(phasors);
            outcome
        };
        let plan = Arc::new(plan);
        Ok(Self::start(
            subject, setting, plan, &decoder, camera, evaluate,
        )?)
    }

    /// Runs one check through the controller at `port`; the verdict waits until `store` has it. For a baseline each view is left and
    /// approached so many times in all.
    ///
    /// # Errors
    /// The check could not begin. Errors after that give an indeterminate verdict.
    pub fn inspect(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        approaches: u32,
        store: &mut impl ResultSink<Inspection>,
        mut watch: impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        runtime()?.block_on(async {
            let mut client = connect(&self.acquisition, port, settings, &mut watch).await?;
            self.further_approaches = approaches.saturating_sub(1);
            let source = Source::Live(&mut client);
            self.check(source, None, store, &mut watch).await
        })
    }

    /// Runs one check of recorded frames; the verdict waits until `store` has it.
    ///
    /// # Errors
    /// A thread ended early, or the result cannot be stored.
    pub fn inspect_recorded(
        &mut self,
        frames: &mut RecordedFrames,
        store: &mut impl ResultSink<Inspection>,
        mut watch: impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        runtime()?.block_on(self.check(Source::Recorded(frames), None, store, &mut watch))
    }

    /// Runs one check and stores it. With a hold limit, by the controller's clock, the head leaves the die in time, whether the
    /// check is complete or not.
    pub(crate) async fn check(
        &mut self,
        mut source: Source<'_>,
        hold_limit: Option<Duration>,
        store: &mut impl ResultSink<Inspection>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        let begun_ns = monotonic_ns();
        let mut run = match &mut source {
            Source::Live(client) => {
                let order = self.quickest_order(client, watch).await?;
                Run::new(order, hold_limit)
            }
            Source::Recorded(frames) => {
                let mut run = Run::new((0..self.plan.views.len()).collect(), None);
                run.counts.press_cycles = frames.press_cycles;
                run
            }
        };
        // With a head that must not judge, the press is not held at all.
        let stopped = match (self.unfit(&source), &mut source) {
            (Some(why), _) => Some(why),
            (None, Source::Live(client)) => {
                let stopped = self.capture(client, &mut run, watch).await?;
                stopped.as_ref().map(job::stopped)
            }
            (None, Source::Recorded(frames)) => {
                self.play_check(frames, &mut run, watch).await?;
                None
            }
        };
        let mut inspection = self.conclude(run, stopped, begun_ns, source.firmware());
        store.put(&mut inspection)?;
        Ok(inspection)
    }

    /// The order of the views that takes the least time from the present position of the stages.
    async fn quickest_order(
        &self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Vec<usize>, AcquisitionError> {
        let status = client.status().await?;
        let stands = View {
            rotation: status.rotation,
            vertical: status.vertical,
        };
        let count = self.plan.views.len();
        let Route { order, time } = self.acquisition.program().quickest_from(stands, count);
        watch(Progress::Planned(time));
        Ok(order)
    }

    /// Captures the views; then again those that were lost or are too near to a limit.
    async fn capture(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        if self.poses.is_some() {
            return self.capture_where_told(client, run, watch).await;
        }
        let wanted = run.wanted.clone();
        let captured = self.acquisition.capture_settled(
            client,
            run,
            &wanted,
            AfterStop::End,
            to_be_retaken,
            watch,
        );
        if let Some(stopped) = captured.await? {
            return Ok(Some(stopped));
        }
        if let Some(stopped) = self.approach_again(client, run, watch).await? {
            return Ok(Some(stopped));
        }
        self.repeat_open_views(client, run, watch).await
    }

    /// Captures one view after the other, each at the pose that the pose program states. A view without a pose is not captured;
    /// none is repeated, because the camera has moved on.
    async fn capture_where_told(
        &mut self,
        client: &mut Client,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<Stop>, InspectError> {
        let stage_from_camera = hand_eye(&self.subject)?;
        if let Some(program) = &mut self.poses {
            program.begin_check();
        }
        for view in &run.wanted.clone() {
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

    /// The result of a check; `firmware` is that of the controller, if there was one.
    pub(super) fn conclude(
        &self,
        mut run: Run<ViewOutcome>,
        stopped: Option<Reason>,
        begun_ns: u64,
        firmware: Option<[u8; 3]>,
    ) -> Inspection {
        let problems = run.problems.iter();
        let problems = problems
            .map(|(&view, why)| (view, job::view_lost(why)))
            .collect();
        let found = Findings::of(
            &self.subject.tool,
            &self.plan,
            std::mem::take(&mut run.outcomes),
            &problems,
            stopped.as_ref(),
            self.subject.baseline.as_deref(),
        );
        let mut versions = BTreeMap::new();
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        if let Some([major, minor, patch]) = firmware {
            versions.insert("firmware", format!("{major}.{minor}.{patch}"));
        }
        let names = self.view_names();
        let frames = std::mem::take(&mut run.pictures).into_iter();
        let frames = frames
            .filter_map(|(view, picture)| Some((names.get(view)?.clone(), picture)))
            .collect();
        let last_exposure = last_exposure(&run, &self.setting.link);
        let recipe = recipe(&self.subject, &self.plan);
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
            timing_ms: timing(&run, begun_ns, run.counts.last_outcome_ns),
            press_cycles: run.counts.press_cycles,
            frames: frame_count(run.counts),
            peak_memory_mb: peak_memory_mb(),
            registration: found.registration,
            origin: self.subject.origin(&self.setting),
            date: date::now(),
            last_exposure,
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
            approaches: self.approaches,
            pictures: Pictures {
                maps: found.maps,
                deviations_um: found.deviations_um,
                activities: run.timeline.activities(),
                moves: self.subject.station.stages.moves,
                frames,
                toothing: Toothing::of(&self.subject.tool),
            },
        }
    }
}

/// Views of an attempt to be captured again: those without an outcome, and those whose exposures disagree.
fn to_be_retaken(
    run: &mut Run<ViewOutcome>,
    views: &[usize],
    _: Option<&Stop>,
) -> Result<Vec<usize>, AcquisitionError> {
    let again = |view: &usize| run.outcomes.get(view).is_none_or(|outcome| outcome.retake);
    Ok(views.iter().copied().filter(again).collect())
}
