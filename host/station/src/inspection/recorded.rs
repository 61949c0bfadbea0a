//! The check on recorded frames: everything after the camera as in a live one, and nothing before it.

use std::sync::Arc;

use flankscope_foundation::date::Date;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Reason;
use flankscope_profilometry::HeadModel;

use super::failure;
use super::job::{InspectError, Station, Subject};
use super::plan::{PlannedView, PlanningError, ViewPlan};
use super::views::ViewOutcome;
use crate::acquisition::{
    AcquisitionError, Playback, Progress, RecordedView, Recording, Run, ViewError,
};
use crate::origin::Setting;
use crate::sink::ResultSink;
use flankscope_frames::monotonic_ns;

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
        store: &mut impl ResultSink<super::Inspection>,
        mut watch: impl FnMut(Progress),
    ) -> Result<super::Inspection, InspectError> {
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

    /// Every view's first capture, and as in a live check the others of those that stay too near to a limit.
    async fn play(
        &mut self,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let plan = Arc::clone(&self.station.plan);
        for (view, captures) in self.captures.iter().enumerate() {
            if captures.is_empty() {
                let tooth = plan.views[view].tooth;
                run.problems.insert(view, ViewError::NotRecorded { tooth });
            }
        }
        let inspect = self.station.subject.tool.inspect.as_ref();
        for attempt in 0..=inspect.map_or(0, |inspect| inspect.remeasure as usize) {
            let wanted = |view: usize| {
                let open = || run.outcomes.get(&view).is_some_and(ViewOutcome::is_open);
                let capture = self.captures[view].get(attempt)?;
                (attempt == 0 || open()).then(|| (view, capture.clone()))
            };
            let views: Vec<_> = (0..self.captures.len()).filter_map(wanted).collect();
            let before = std::mem::take(&mut run.outcomes);
            for some in views.chunks(flankscope_protocol::plan::MAX_VIEWS) {
                let acquisition = &mut self.station.acquisition;
                acquisition.play(&self.playback, run, some, watch).await?;
            }
            run.outcomes = ViewOutcome::joined(before, std::mem::take(&mut run.outcomes));
        }
        Ok(())
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
    let gear = tool.gear.as_ref().ok_or(PlanningError::NoGear)?;
    let mut seen = Vec::with_capacity(recording.index.view.len());
    for (at, view) in recording.index.view.iter().enumerate() {
        let by_angle = view.rotation_rad.map(|angle| gear.tooth_at(-angle));
        match (view.tooth, by_angle) {
            (Some(said), Some(seen)) if said != seen => {
                return Err(PlanningError::OtherTooth {
                    view: at + 1,
                    said,
                    seen,
                });
            }
            (tooth, by_angle) => seen.extend(tooth.or(by_angle)),
        }
    }
    let mut all: Vec<u32> = Vec::new();
    for &tooth in &seen {
        if !all.contains(&tooth) {
            all.push(tooth);
        }
    }
    let asked = teeth.or(recording.index.teeth.as_deref()).unwrap_or(&all);
    let mut views = ViewPlan::nominal(tool, asked)?;
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
    let plan = ViewPlan {
        views,
        patterns: recording.plan.patterns.clone(),
        exposures_us: recording.plan.exposures_us.clone(),
        dark_frame: recording.plan.dark_frame,
        sensor: recording.plan.sensor.filter(|of| head.sensor != Some(*of)),
        top_mm: gear.height_mm[1],
    };
    Ok((plan, of_views))
}
