//! The check on recorded frames: everything after the camera as in a live one, and nothing before it.

use std::path::{Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Reason;
use flankscope_profilometry::{FringeSet, HeadModel, PatternSet};

use super::failure;
use super::job::{InspectError, Station};
use super::outcome::ViewOutcome;
use super::patch_view;
use super::plan::{PlanningError, ViewPlan};
use super::views::hand_eye;
use crate::subject::Subject;
use flankscope_foundation::files::write_whole;
use flankscope_frames::monotonic_ns;
use flankscope_instrument::acquisition::{
    AcquisitionError, FrameIndex, IndexedView, Playback, Progress, RecordedView, Recording, Run,
    SavedView, ViewError,
};
use flankscope_instrument::poses::PoseTable;
use flankscope_metrology::view::PlannedView;
use flankscope_record::document::Inspection;
use flankscope_record::origin::{RecordingId, Setting};
use flankscope_record::sink::ResultSink;

/// The host's side for a check of recorded frames.
#[derive(Debug)]
pub struct RecordedCheck {
    station: Station,
    playback: Playback,
    /// Of every planned view, its captures in the order in which they were taken.
    captures: Vec<Vec<RecordedView>>,
    press_cycles: u32,
    taken: Option<Date>,
}

impl RecordedCheck {
    /// What is in the middle of every view.
    #[must_use]
    pub fn view_names(&self) -> Vec<String> {
        self.station.view_names()
    }

    /// Prepares a check of these frames, or of those of some `teeth`. Results say that they come from `setting`.
    ///
    /// # Errors
    /// The subject is unfit, or an image is not there or not what plan and head say.
    pub fn open(
        subject: Subject,
        setting: Setting,
        recording: &Recording,
        teeth: Option<&[u32]>,
    ) -> Result<Self, InspectError> {
        let views = recording.views(&subject.head)?;
        let (plan, of_views) = plan(&subject.tool, &subject.head, recording, teeth)?;
        if let Some(table) = recording.poses() {
            plan.take_poses(&PoseTable::load(&table)?, hand_eye(&subject)?)?;
        }
        let captures = of_views
            .iter()
            .map(|of| of.iter().filter_map(|&at| views.get(at).cloned()).collect());
        let (station, playback) = Station::of_recording(subject, setting, plan)?;
        Ok(Self {
            captures: captures.collect(),
            station,
            playback,
            press_cycles: recording.index.press_cycles.unwrap_or_default(),
            taken: recording.index.taken,
        })
    }

    /// Name of the tool that is checked.
    #[must_use]
    pub fn tool(&self) -> &str {
        self.station.tool()
    }

    /// Runs the check; the verdict waits for `store`.
    ///
    /// # Errors
    /// A thread ended early, or what was found cannot be kept.
    pub fn inspect(
        &mut self,
        store: &mut impl ResultSink<Inspection>,
        mut watch: impl FnMut(Progress),
    ) -> Result<Inspection, InspectError> {
        let begun_ns = monotonic_ns();
        let mut run = Run::new((0..self.captures.len()).collect(), None);
        run.counts.press_cycles = self.press_cycles;
        // The frames are as good as the head was when they were taken.
        let day = self.taken.unwrap_or_else(Date::today);
        let unfit = self.station.subject.head.fit_on(day).err();
        if unfit.is_none() {
            let runtime = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build();
            let runtime = runtime.map_err(|_| AcquisitionError::Thread { thread: "I/O" })?;
            runtime.block_on(self.play(&mut run, &mut watch))?;
        }
        let stopped: Option<Reason> = unfit.as_ref().map(failure::unfit);
        let mut inspection = self.station.conclude(run, stopped, begun_ns, None);
        store.put(&mut inspection)?;
        Ok(inspection)
    }

    /// Every view's first capture, and as in a live check the next of those that must be taken again or stay too near to a limit.
    async fn play(
        &mut self,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let names = self.view_names().into_iter();
        for (view, (captures, of)) in self.captures.iter().zip(names).enumerate() {
            if captures.is_empty() {
                run.problems.insert(view, ViewError::NotRecorded { of });
            }
        }
        let inspect = self.station.subject.tool.inspect.as_ref();
        let repetitions = inspect.map_or(0, |inspect| inspect.remeasure);
        let mut played = vec![0; self.captures.len()];
        let all: Vec<usize> = (0..played.len()).collect();
        self.play_next(run, &all, &mut played, watch).await?;
        let retaken = views_that(run, |outcome| outcome.retake);
        self.play_next(run, &retaken, &mut played, watch).await?;
        for _ in 0..repetitions {
            let open = views_that(run, ViewOutcome::is_open);
            let before = std::mem::take(&mut run.outcomes);
            self.play_next(run, &open, &mut played, watch).await?;
            run.outcomes = ViewOutcome::joined(before, std::mem::take(&mut run.outcomes));
        }
        Ok(())
    }

    /// Plays the next capture of each of these views that has one left; `played` counts them by view.
    async fn play_next(
        &mut self,
        run: &mut Run<ViewOutcome>,
        views: &[usize],
        played: &mut [usize],
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let next = |&view: &usize| Some((view, self.captures[view].get(played[view])?.clone()));
        let mut next: Vec<(usize, RecordedView)> = views.iter().filter_map(next).collect();
        // As they were taken, by the controller's clock.
        next.sort_by_key(|(_, capture)| capture.number);
        for some in next.chunks(flankscope_protocol::plan::MAX_VIEWS) {
            let acquisition = &mut self.station.acquisition;
            acquisition.play(&self.playback, run, some, watch).await?;
        }
        for (view, _) in next {
            played[view] += 1;
        }
        Ok(())
    }
}

/// Identity of a recording of frames, as results state it.
#[must_use]
pub fn recording_id(recording: &Recording) -> RecordingId {
    RecordingId {
        taken: recording.index.taken,
        blake3: recording.blake3().to_owned(),
        simulated: recording.index.simulated,
    }
}

/// Views of a run whose outcome is such.
fn views_that(run: &Run<ViewOutcome>, is: impl Fn(&ViewOutcome) -> bool) -> Vec<usize> {
    let outcomes = run.outcomes.iter().filter(|(_, outcome)| is(outcome));
    outcomes.map(|(&view, _)| view).collect()
}

/// Why a recording has no index, and is none.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The operating system refuses.
    #[error("the frames are not recorded: cannot write {}: {source}", path.display())]
    Write {
        /// File or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The index cannot be put into words.
    #[error("the frames are not recorded: {0}")]
    Toml(#[from] toml::ser::Error),
}

/// `PLAN.toml` of a recording: which patterns its frames are of.
#[derive(serde::Serialize)]
struct PlanOfFrames<'a> {
    /// Of a set that the instrument knows.
    pattern_set: Option<&'a str>,
    /// Of any other.
    name: Option<&'a str>,
    exposures_us: &'a [u32],
    dark_first: bool,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    set: &'a [FringeSet],
}

impl<'a> PlanOfFrames<'a> {
    fn of(plan: &'a ViewPlan) -> Self {
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

/// What a recording says beside its frames.
#[derive(Debug)]
pub(crate) struct RecordingNotes<'a> {
    pub subject: &'a Subject,
    pub setting: &'a Setting,
    pub plan: &'a ViewPlan,
    /// Teeth that were to be checked.
    pub teeth: Option<Vec<u32>>,
    /// Grid of a scan.
    pub grid: Option<String>,
    pub press_cycles: Option<u32>,
}

impl RecordingNotes<'_> {
    /// Writes plan and index of captures that were saved in `folder`: what makes a recording of them. The head is a file in it.
    pub fn write(
        &self,
        folder: &Path,
        head: &Path,
        saved: Vec<SavedView>,
    ) -> Result<(), RecordError> {
        let mut views = Vec::with_capacity(saved.len());
        for of in saved {
            if let Some(source) = of.failed {
                let path = folder.join(of.index.folder);
                return Err(RecordError::Write { path, source });
            }
            let stood = self.plan.views.get(of.view);
            views.push(IndexedView {
                tooth: stood.map(|stood| stood.tooth),
                rotation_rad: stood.map(|stood| stood.rotation_rad),
                vertical_mm: stood.map(|stood| stood.vertical_mm),
                ..of.index
            });
        }
        let index = FrameIndex {
            poses: None,
            simulated: self.setting.link.is_simulated(),
            taken: Some(Date::today()),
            plan: "PLAN.toml".into(),
            head: Some(head.to_owned()),
            images: None,
            teeth: self.teeth.clone(),
            grid: self.grid.clone(),
            press_cycles: self.press_cycles,
            tool_temperature_degc: self.subject.temperature_degc,
            lit_ratios: self.plan.lit_ratios.clone(),
            view: views,
        };
        let plan = format!(
            "# The dark frame, then exposure by exposure (and pass by pass) the patterns, in the order of the images' names.\n\
             {}",
            toml::to_string(&PlanOfFrames::of(self.plan))?
        );
        for (name, text) in [("PLAN.toml", plan), (FrameIndex::FILE, index.to_toml()?)] {
            let path = folder.join(name);
            write_whole(&path, text.as_bytes())
                .map_err(|source| RecordError::Write { path, source })?;
        }
        Ok(())
    }
}

impl Station {
    /// Has the frames of every capture that follows written into `folder`, which is there, beside being judged.
    ///
    /// # Errors
    /// A thread ended early.
    pub fn save_frames(&mut self, folder: &Path) -> Result<(), InspectError> {
        let full_scale_dn = self.full_scale_dn;
        Ok(self.acquisition.save_frames(folder, full_scale_dn)?)
    }

    /// Makes a recording of the frames that were saved for a check. `head` is the head's file in the same folder.
    ///
    /// # Errors
    /// Something was not written.
    pub fn record(
        &mut self,
        of: &Inspection,
        folder: &Path,
        head: &Path,
    ) -> Result<(), RecordError> {
        let saved = self.acquisition.take_saved();
        let notes = RecordingNotes {
            subject: &self.subject,
            setting: &self.setting,
            plan: &self.plan,
            teeth: Some(self.plan.views.iter().map(|view| view.tooth).collect()),
            grid: None,
            press_cycles: Some(of.press_cycles),
        };
        notes.write(folder, head, saved)
    }
}

/// The tooth in the middle of a view of an index, by its name and by its angle.
pub(crate) fn tooth_in_middle(
    gear: &GearData,
    at: usize,
    view: &IndexedView,
) -> Result<u32, PlanningError> {
    let by_angle = view.rotation_rad.map(|angle| gear.tooth_at(-angle));
    match (view.tooth, by_angle) {
        (Some(said), Some(seen)) if said != seen => Err(PlanningError::OtherTooth {
            view: at + 1,
            said,
            seen,
        }),
        (Some(tooth), _) | (None, Some(tooth)) => Ok(tooth),
        (None, None) => Err(PlanningError::NoTeeth),
    }
}

/// The views of recorded frames, and which of the index's they are: those of `teeth`, else of the teeth that the index names,
/// else all.
fn plan(
    tool: &Tool,
    head: &HeadModel,
    recording: &Recording,
    teeth: Option<&[u32]>,
) -> Result<(ViewPlan, Vec<Vec<usize>>), PlanningError> {
    let in_middle = |(at, view): (usize, &IndexedView)| match &tool.gear {
        Some(gear) => tooth_in_middle(gear, at, view),
        None if tool.patches.is_empty() => Err(PlanningError::NoGear),
        // Several patches may be in one view: it says itself of which it is.
        None => view.tooth.ok_or(PlanningError::Unnamed { view: at + 1 }),
    };
    let views = recording.index.view.iter().enumerate();
    let seen: Vec<u32> = views.map(in_middle).collect::<Result<_, _>>()?;
    let mut all: Vec<u32> = Vec::new();
    for &tooth in &seen {
        if !all.contains(&tooth) {
            all.push(tooth);
        }
    }
    let asked = teeth.or(recording.index.teeth.as_deref()).unwrap_or(&all);
    let mut views = ViewPlan::looking_at(tool, head, asked)?;
    let mut of_views = Vec::with_capacity(views.len());
    for planned in &mut views {
        let of = |at: &usize| seen.get(*at) == Some(&planned.tooth);
        let of: Vec<usize> = (0..seen.len()).filter(of).collect();
        let nominal = planned.clone();
        for (nth, &at) in of.iter().enumerate() {
            let said = &recording.index.view[at];
            let stood = PlannedView {
                rotation_rad: said.rotation_rad.unwrap_or(nominal.rotation_rad),
                vertical_mm: said.vertical_mm.unwrap_or(nominal.vertical_mm),
                ..nominal.clone()
            };
            if nth == 0 {
                *planned = stood;
            } else if *planned != stood {
                let tooth = planned.tooth;
                return Err(PlanningError::Elsewhere { tooth });
            }
        }
        of_views.push(of);
    }
    if tool.gear.is_none() {
        patch_view::check_seen(tool, head, &views)?;
    }
    Ok((
        ViewPlan::of_recording(recording, views, tool, head),
        of_views,
    ))
}
