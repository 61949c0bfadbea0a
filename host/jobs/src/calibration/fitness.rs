//! Fitness test of a calibrated head: the target's blank plate and its sphere are captured and measured.

use std::path::Path;
use std::sync::Arc;

use flankscope_foundation::date::Date;
use flankscope_profilometry::calibrate::{SelfTestError, StagePose, Target};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::head::SelfTest;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder, HeadModel};

use super::job::{CalibrationError, SaveError, write};
use super::survey::Surveyor;
use flankscope_frames::SharedRoot;
use flankscope_instrument::acquisition::Progress;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::StationSettings;

/// Captures of plane and spheres, and their evaluation.
#[derive(Debug)]
pub struct FitnessSurvey {
    surveyor: Surveyor<Result<Vec<Vec<CellColumn>>, DecodeError>>,
    head: HeadModel,
    target: Target,
}

impl FitnessSurvey {
    /// Starts the threads, with frames arriving below `root`.
    ///
    /// # Errors
    /// The head lacks what the job needs, the target has no sphere, or shared memory cannot be created.
    pub fn open(
        head: HeadModel,
        target: Target,
        station: &StationSettings,
        root: Arc<SharedRoot>,
    ) -> Result<Self, CalibrationError> {
        let lacks = SelfTestError::Lacks {
            what: "[sphere] in the target",
        };
        target.sphere.ok_or(lacks)?;
        let spheres = target.spheres();
        let spheres = spheres.iter().map(|at| at.stood);
        let at: Vec<StagePose> = target.planes().into_iter().chain(spheres).collect();
        let options = DecodeOptions::for_head(&head);
        let to_cells = |decoder: &Decoder, sums: &Accumulator| decoder.columns_of_each(sums);
        Ok(Self {
            surveyor: Surveyor::open(&head, options, &target, &at, (station, root), to_cells)?,
            head,
            target,
        })
    }

    /// Captures and measures both.
    ///
    /// # Errors
    /// A capture failed, or shows too few points.
    pub fn test(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        date: Date,
        watch: impl FnMut(Progress),
    ) -> Result<SelfTest, CalibrationError> {
        let captured = self.surveyor.survey(port, settings, watch)?.into_iter();
        let captured: Vec<Vec<Vec<CellColumn>>> = captured.collect::<Result<_, _>>()?;
        let (planes, spheres) = captured.split_at(captured.len() / 2);
        let test = SelfTest::measure(&self.head, &self.target, planes, spheres, date);
        Ok(test?)
    }
}

/// Writes a self-test beside the head file.
pub fn save_self_test(test: &SelfTest, head: &Path) -> Result<(), SaveError> {
    write(SelfTest::path_of(head), test.to_toml()?.as_bytes())
}
