//! Captures at a list of stage positions.

use std::path::Path;
use std::sync::Arc;

use flankscope_profilometry::calibrate::{StagePose, Target};
use flankscope_profilometry::head::LensDrive;
use flankscope_profilometry::pattern::PatternError;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel};

use crate::job::{connect, runtime};
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::{
    Acquisition, AcquisitionError, AfterStop, Program, Progress, Run, StagePosition, Stop,
};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_instrument::patterns::PatternLight;
use flankscope_instrument::settings::StationSettings;

/// Why a survey failed.
#[derive(Debug, thiserror::Error)]
pub enum SurveyError {
    /// The instrument failed.
    #[error(transparent)]
    Instrument(#[from] AcquisitionError),
    #[error("the head file has no {what}; a capture needs it (see docs/formats/head.md)")]
    HeadLacks {
        /// The missing entry.
        what: &'static str,
    },
    /// The pattern set's name is unknown.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The head model cannot decode.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// The operator interrupted it.
    #[error("interrupted after {done} of {of} views; no head is written")]
    Interrupted {
        /// Views that were captured.
        done: usize,
        /// Number of views.
        of: usize,
    },
    /// A view could not be captured in two attempts.
    #[error("view {view} was lost: {why}")]
    Lost {
        /// Its number.
        view: usize,
        /// Reason.
        why: String,
    },
}

/// Host side of the instrument for captures other than checks; one result `O` per position.
#[derive(Debug)]
pub struct Surveyor<O> {
    acquisition: Acquisition<O>,
    views: usize,
}

impl<O: Send + 'static> Surveyor<O> {
    /// Starts the threads for a head in front of a target. `make` computes a result from the sums of a view.
    ///
    /// # Errors
    /// The head lacks what the job needs, or shared memory cannot be created.
    pub fn open(
        head: &HeadModel,
        options: DecodeOptions,
        target: &Target,
        positions: &[StagePose],
        (station, root): (&StationSettings, Arc<SharedRoot>),
        make: impl FnMut(&Decoder, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, SurveyError> {
        let lacks = || SurveyError::HeadLacks {
            what: "pattern_set",
        };
        let patterns = head.patterns()?.ok_or_else(lacks)?;
        let exposures_us = vec![target.exposure_us];
        let decoder = Decoder::new(head, &patterns, &exposures_us, options)?;
        let decoder = Arc::new(decoder);
        let positions = positions
            .iter()
            .map(|at| StagePosition::of(at.rotation_rad, at.vertical_mm, &station.stages));
        let program = Program {
            positions: positions.collect(),
            patterns,
            lit_ratios: PatternLight::of(head).lit_ratios,
            exposures_us,
            retract_mm: target.retract_mm,
            timing: station.timing.clone(),
            light: station.light.clone(),
            stage: station.stages.config(),
            lens: head.lens,
            projectors: head.projectors(),
        };
        Self::start(program, decoder, root, make)
    }

    /// Starts the threads for the views of a program. `make` computes a result from the sums of a view.
    ///
    /// # Errors
    /// Shared memory cannot be created.
    pub(super) fn start(
        program: Program,
        decoder: Arc<Decoder>,
        root: Arc<SharedRoot>,
        mut make: impl FnMut(&Decoder, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, SurveyError> {
        let views = program.positions.len();
        let own = Arc::clone(&decoder);
        let make = move |_, sums: &Accumulator| make(&own, sums);
        let acquisition = Acquisition::start(program, &decoder, Some(root), make)?;
        Ok(Self { acquisition, views })
    }

    /// Captures every position in the given order; a lost one is captured once more.
    ///
    /// # Errors
    /// The capture could not begin, or a view was lost twice.
    pub fn survey(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        mut watch: impl FnMut(Progress),
    ) -> Result<Vec<O>, SurveyError> {
        runtime()?.block_on(async {
            let mut client = connect(&self.acquisition, port, settings, &mut watch).await?;
            self.capture_all(&mut client, &mut watch).await
        })
    }

    /// Captures every position with the lens driven as `next` says, in repeated passes, until `next` returns nothing more. `next`
    /// receives the results of the previous pass.
    ///
    /// # Errors
    /// As [`Self::survey`], and errors of `next`.
    pub fn through<E: From<SurveyError>>(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        mut watch: impl FnMut(Progress),
        mut next: impl FnMut(Vec<O>) -> Result<Vec<LensDrive>, E>,
    ) -> Result<(), E> {
        runtime().map_err(SurveyError::from)?.block_on(async {
            let client = connect(&self.acquisition, port, settings, &mut watch).await;
            let mut client = client.map_err(SurveyError::from)?;
            let mut outcomes = Vec::new();
            loop {
                let lenses = next(std::mem::take(&mut outcomes))?;
                if lenses.is_empty() {
                    return Ok(());
                }
                for lens in lenses {
                    self.acquisition.drive(lens);
                    outcomes.extend(self.capture_all(&mut client, &mut watch).await?);
                }
            }
        })
    }

    async fn capture_all(
        &mut self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Vec<O>, SurveyError> {
        let wanted: Vec<usize> = (0..self.views).collect();
        let mut run = Run::new(wanted.clone(), None);
        for views in wanted.chunks(flankscope_protocol::plan::MAX_VIEWS) {
            let missing = |run: &mut Run<O>, views: &[usize], _: Option<&Stop>| {
                Ok::<_, AcquisitionError>(run.without_outcome(views))
            };
            let captured = self.acquisition.capture_settled(
                client,
                &mut run,
                views,
                AfterStop::End,
                missing,
                watch,
            );
            let stopped = captured.await?;
            if let Some(Stop::Interrupted) = stopped {
                return Err(SurveyError::Interrupted {
                    done: run.outcomes.len(),
                    of: self.views,
                });
            }
            let lost = run.without_outcome(views).first().copied();
            if let Some(view) = lost.or(stopped.is_some().then_some(views[0])) {
                let why = match (stopped, run.problems.get(&view)) {
                    (Some(stopped), _) => stopped.to_string(),
                    (None, Some(problem)) => problem.to_string(),
                    (None, None) => "it was not captured".into(),
                };
                return Err(SurveyError::Lost { view, why });
            }
        }
        Ok(run.outcomes.into_values().collect())
    }
}
