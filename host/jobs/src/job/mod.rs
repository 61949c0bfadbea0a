//! Common parts of every job: a subject, the plan of its views, and the threads that evaluate the frames of each view.
//!
//! Frames come from one of two sources: a ready controller or recorded frames. Checks and scans differ only in planning, evaluation of
//! a view, and conclusion.
//!
//! | file | holds |
//! |---|---|
//! | `failure` | errors of frames, controller and head as reasons of a verdict |
//! | `recording` | writes the frames of a job as a recording, and reads recorded frames as a source |

mod failure;
mod recording;

use std::path::Path;
use std::sync::Arc;

use flankscope_foundation::date::Date;
use flankscope_metrology::verdict::Reason;
use flankscope_metrology::wear::Approaches;
use flankscope_profilometry::{Accumulator, Decoder};
use tokio::runtime::Runtime;

use crate::plan::ViewPlan;
use crate::subject::Subject;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::{Acquisition, AcquisitionError, Progress};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_instrument::poses::PoseProgram;
use flankscope_profilometry::head::HeadDates;
use flankscope_record::die::DieKey;
use flankscope_record::origin::Setting;

pub(crate) use failure::{stopped, view_lost};
pub use recording::{RecordError, RecordedFrames, recording_id};

/// A job with running threads. `O` is the outcome of one view.
#[derive(Debug)]
pub struct Job<O> {
    pub(crate) subject: Subject,
    /// Station, link and operator, as results state them.
    pub(crate) setting: Setting,
    pub(crate) plan: Arc<ViewPlan>,
    pub(crate) acquisition: Acquisition<O>,
    /// Program that states the camera poses; for checks only, if the station file names one.
    pub(crate) poses: Option<PoseProgram>,
    /// Approaches of each view after the first one; for a baseline only.
    pub(crate) further_approaches: u32,
    /// Repeatability of the rotary stage that they showed.
    pub(crate) approaches: Option<Approaches>,
}

/// Source of a job's frames.
pub(crate) enum Source<'a> {
    /// A controller that is ready, and the camera that it triggers.
    Live(&'a mut Client),
    /// A folder of recorded frames.
    Recorded(&'a mut RecordedFrames),
}

impl Source<'_> {
    /// Firmware version of the controller, if there is one.
    pub fn firmware(&self) -> Option<[u8; 3]> {
        match self {
            Self::Live(client) => Some(client.identity().firmware),
            Self::Recorded(_) => None,
        }
    }
}

impl<O: Send + 'static> Job<O> {
    /// Starts the threads. Frames come from the camera process below `camera`, or from a recording if this is `None`.
    pub(crate) fn start(
        subject: Subject,
        setting: Setting,
        plan: Arc<ViewPlan>,
        decoder: &Arc<Decoder>,
        camera: Option<Arc<SharedRoot>>,
        evaluate: impl FnMut(usize, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, AcquisitionError> {
        let program = plan.program(&subject.station);
        Ok(Self {
            acquisition: Acquisition::start(program, decoder, camera, evaluate)?,
            subject,
            setting,
            plan,
            poses: None,
            further_approaches: 0,
            approaches: None,
        })
    }

    /// Key of the die in a history.
    pub fn die(&self) -> DieKey {
        self.subject.die()
    }

    /// When the head has to be calibrated and tested again.
    pub fn head_dates(&self) -> HeadDates {
        HeadDates::of(&self.subject.head)
    }

    /// For every view of the plan, the tooth or patch that it is for; the further views come last.
    pub fn view_names(&self) -> Vec<String> {
        let features = self.subject.tool.features();
        let views = self.plan.all_views();
        views.map(|view| features.name(view.tooth)).collect()
    }

    /// Why the head must not judge frames of this source, if so. For recorded frames, the head's validity on the day of capture counts.
    pub(crate) fn unfit(&self, source: &Source<'_>) -> Option<Reason> {
        let taken = match source {
            Source::Live(_) => None,
            Source::Recorded(frames) => frames.taken,
        };
        self.unfit_on(taken)
    }

    /// Why the head must not judge frames captured on this day; `None` means today.
    pub(crate) fn unfit_on(&self, day: Option<Date>) -> Option<Reason> {
        let fit = self.subject.head.fit_on(day.unwrap_or_else(Date::today));
        fit.err().as_ref().map(failure::unfit)
    }
}

/// Connects to the controller at `port` and makes it and the camera ready to capture.
pub(crate) async fn connect<O: Send + 'static>(
    acquisition: &Acquisition<O>,
    port: &Path,
    settings: ClientSettings,
    watch: &mut impl FnMut(Progress),
) -> Result<Client, AcquisitionError> {
    let mut client = Client::connect(port, settings).await?;
    watch(Progress::Connected);
    acquisition.make_ready(&mut client, watch).await?;
    Ok(client)
}

/// Runtime for the I/O of a job, on the calling thread.
pub(crate) fn runtime() -> Result<Runtime, AcquisitionError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.map_err(|_| AcquisitionError::Thread { thread: "I/O" })
}
