//! Writes the frames of a job as a recording, and reads recorded frames as the source of a job.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_foundation::files::write_whole;
use flankscope_profilometry::{FringeSet, PatternSet};

use super::Job;
use crate::plan::ViewPlan;
use flankscope_instrument::acquisition::{
    AcquisitionError, FrameIndex, IndexedView, RecordedIndex, RecordedView, Recording,
};
use flankscope_record::origin::RecordingId;

/// Identity of a recording of frames, as results state it.
#[must_use]
pub fn recording_id(recording: &Recording) -> RecordingId {
    RecordingId {
        taken: recording.index.taken,
        blake3: recording.blake3().to_owned(),
        simulated: recording.index.simulated,
    }
}

/// The captures of a recording that a job has not played yet.
#[derive(Debug)]
pub struct RecordedFrames {
    /// Every capture with its view of the plan, in the order of capture.
    pub(crate) captures: Vec<(usize, RecordedView)>,
    /// Day of capture, if the index states it.
    pub(super) taken: Option<Date>,
    /// Press cycles by the controller's counter.
    pub(crate) press_cycles: u32,
}

impl RecordedFrames {
    pub(crate) fn new(recording: &Recording, captures: Vec<(usize, RecordedView)>) -> Self {
        Self {
            captures,
            taken: recording.index.taken,
            press_cycles: recording.index.press_cycles.unwrap_or_default(),
        }
    }

    /// Takes the next capture of each of these views that has one left, in the order of capture.
    pub(crate) fn next_of(&mut self, views: &[usize]) -> Vec<(usize, RecordedView)> {
        let mut wanted: BTreeSet<usize> = views.iter().copied().collect();
        let next = |(view, _): &mut (usize, RecordedView)| wanted.remove(view);
        self.captures.extract_if(.., next).collect()
    }
}

/// Why saved frames could not be made a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The operating system returned an error.
    #[error("the frames are not recorded: cannot write {}: {source}", path.display())]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    /// Index or plan cannot be written as TOML.
    #[error("the frames are not recorded: {0}")]
    Toml(#[from] toml::ser::Error),
}

/// `PLAN.toml` of a recording: the patterns of its frames.
#[derive(serde::Serialize)]
struct PlanOfFrames<'a> {
    /// Name of a pattern set known to the instrument.
    pattern_set: Option<&'a str>,
    /// Name of any other set.
    name: Option<&'a str>,
    exposures_us: &'a [u32],
    dark_first: bool,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    set: &'a [FringeSet],
}

impl<'a> From<&'a ViewPlan> for PlanOfFrames<'a> {
    fn from(plan: &'a ViewPlan) -> Self {
        let patterns = &plan.patterns;
        let known = PatternSet::named(&patterns.name).is_ok();
        let name = Some(patterns.name.as_str());
        Self {
            pattern_set: name.filter(|_| known),
            name: name.filter(|_| !known),
            exposures_us: &plan.exposures_us,
            dark_first: plan.dark_frame,
            set: if known { &[] } else { &patterns.sets },
        }
    }
}

impl<O: Send + 'static> Job<O> {
    /// Also writes the frames of all following captures into `folder`, which must exist.
    ///
    /// # Errors
    /// A thread ended early.
    pub fn save_frames(&mut self, folder: &Path) -> Result<(), AcquisitionError> {
        self.acquisition.save_frames(folder)
    }

    /// Writes plan and index of the captures that were saved in `folder`, which makes it a recording. `head` is the head file in
    /// it; `note` adds index entries specific to a check or scan.
    pub(crate) fn write_recording(
        &mut self,
        folder: &Path,
        head: &Path,
        note: FrameIndex,
    ) -> Result<(), RecordError> {
        let mut views = Vec::new();
        for saved in self.acquisition.take_saved() {
            if let Some(source) = saved.failed {
                let path = folder.join(saved.index.folder);
                return Err(RecordError::Write { path, source });
            }
            let stood = self.plan.all_views().nth(saved.view);
            views.push(IndexedView {
                tooth: stood.map(|stood| stood.tooth),
                rotation_rad: stood.map(|stood| stood.rotation_rad),
                vertical_mm: stood.map(|stood| stood.vertical_mm),
                ..saved.index
            });
        }
        let index = FrameIndex {
            simulated: self.setting.link.is_simulated(),
            taken: Some(Date::today()),
            plan: "PLAN.toml".into(),
            head: Some(head.to_owned()),
            tool_temperature_degc: self.subject.temperature_degc,
            lit_ratios: self.plan.lit_ratios.clone(),
            view: views,
            ..note
        };
        let plan = format!(
            "# The dark frame, then exposure by exposure (and pass by pass) the patterns, in the order of the images' names.\n\
             {}",
            toml::to_string(&PlanOfFrames::from(&*self.plan))?
        );
        for (name, text) in [
            ("PLAN.toml", plan),
            (FrameIndex::FILE, toml::to_string(&index)?),
        ] {
            let path = folder.join(name);
            write_whole(&path, text.as_bytes())
                .map_err(|source| RecordError::Write { path, source })?;
        }
        Ok(())
    }
}
