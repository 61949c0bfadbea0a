//! Captures of a list of stage positions.

use std::path::Path;
use std::sync::Arc;

use flankscope_profilometry::calibrate::{StagePose, Target};
use flankscope_profilometry::{
    Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel, PatternSet,
};

use crate::controller::{Client, ClientSettings};
use crate::inspection::{
    InspectError, Itinerary, PlannedView, PlanningError, Progress, Run, Station,
};
use flankscope_frames::SharedRoot;

/// Why there are no captures.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SurveyError {
    /// The instrument does not work.
    #[error(transparent)]
    Instrument(#[from] InspectError),
    /// A view that could not be captured, twice.
    #[error("view {view} was lost: {why}")]
    Lost {
        /// Its number.
        view: usize,
        /// Why.
        why: String,
    },
}

/// The instrument's host side for captures that are no check, one result `O` per position.
#[derive(Debug)]
pub struct Surveyor<O> {
    station: Station<O, ()>,
}

impl<O: Send + 'static> Surveyor<O> {
    /// Starts the threads for a head before a target. `make` is what becomes of a view's sums.
    ///
    /// # Errors
    /// The head is unfit, or shared memory is refused.
    pub fn open(
        head: &HeadModel,
        options: DecodeOptions,
        target: &Target,
        positions: &[StagePose],
        root: Arc<SharedRoot>,
        mut make: impl FnMut(&Decoder, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, SurveyError> {
        let unfit = |error: PlanningError| SurveyError::from(InspectError::from(error));
        let lacks = PlanningError::HeadLacks {
            what: "pattern_set",
        };
        let name = head.pattern_set.as_deref().ok_or(lacks).map_err(unfit)?;
        let patterns = PatternSet::named(name).map_err(|error| unfit(error.into()))?;
        let exposures_us = vec![target.exposure_us];
        let unfit = |error: DecodeError| SurveyError::from(InspectError::from(error));
        let decoder = Decoder::new(head, &patterns, &exposures_us, options).map_err(unfit)?;
        let decoder = Arc::new(decoder);
        let views = positions.iter().map(|at| PlannedView {
            tooth: 0,
            rotation_rad: at.rotation_rad,
            vertical_mm: at.vertical_mm,
        });
        let itinerary = Arc::new(Itinerary {
            views: views.collect(),
            patterns,
            exposures_us,
            retract_mm: target.retract_mm,
        });
        let own = Arc::clone(&decoder);
        let station = Station::start((), itinerary, decoder, root, move |_, sums| {
            make(&own, sums)
        })?;
        Ok(Self { station })
    }

    /// Captures every position in the order given, a lost one once more.
    ///
    /// # Errors
    /// The capture could not begin, or a view stayed lost.
    pub fn survey(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        mut watch: impl FnMut(Progress),
    ) -> Result<Vec<O>, SurveyError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|_| InspectError::Thread { thread: "I/O" })?;
        runtime.block_on(async {
            let client = Client::connect(port, settings).await;
            let mut client = client.map_err(InspectError::from)?;
            watch(Progress::Connected);
            self.station.make_ready(&mut client, &mut watch).await?;
            let limits = client.identity().limits;
            let wanted: Vec<usize> = (0..self.station.itinerary.views.len()).collect();
            let mut run = Run::new(wanted.clone(), None);
            for views in wanted.chunks(flankscope_protocol::plan::MAX_VIEWS) {
                let mut open = views.to_vec();
                for _ in 0..2 {
                    let stopped = self
                        .station
                        .capture(&mut client, &mut run, &open, &limits, &mut watch)
                        .await?;
                    if let Some(why) = stopped {
                        let view = open.first().copied().unwrap_or_default();
                        return Err(SurveyError::Lost { view, why });
                    }
                    open.retain(|view| !run.outcomes.contains_key(view));
                    if open.is_empty() {
                        break;
                    }
                    open.iter()
                        .for_each(|&view| watch(Progress::Recapture(view)));
                }
                if let Some(&view) = open.first() {
                    let why = run.problems.get(&view).cloned();
                    let why = why.unwrap_or_else(|| "it was not captured".into());
                    return Err(SurveyError::Lost { view, why });
                }
            }
            Ok(run.outcomes.into_values().collect())
        })
    }
}
