//! The check with recorded frames: everything after the camera is as in a live check.

use std::path::Path;

use flankscope_metrology::gear::GearData;
use flankscope_metrology::tool::Tool;
use flankscope_profilometry::HeadModel;

use super::job::InspectError;
use super::outcome::ViewOutcome;
use super::views::hand_eye;
use crate::job::{Job, RecordError, RecordedFrames};
use crate::plan::{PlanningError, ViewPlan, check_seen, further_views};
use crate::subject::Subject;
use flankscope_instrument::acquisition::{
    AcquisitionError, FrameIndex, IndexedView, Progress, Recording, Run, ViewError,
};
use flankscope_instrument::poses::PoseTable;
use flankscope_metrology::view::{FurtherView, PlannedView};
use flankscope_record::document::Inspection;
use flankscope_record::origin::Setting;

/// Teeth by which a further view's middle may lie beside its tooth: a field shows about three.
const FURTHER_TEETH: u32 = 2;

impl Job<ViewOutcome> {
    /// Starts the threads of a check of these frames, or of those of some `teeth`. Results state `setting` as their origin.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, or an image is missing or differs from plan and head file.
    pub fn check_recorded(
        subject: Subject,
        setting: Setting,
        recording: &Recording,
        teeth: Option<&[u32]>,
    ) -> Result<(Self, RecordedFrames), InspectError> {
        let captures = recording.views(&subject.head)?;
        let (plan, view_of) = plan(&subject.tool, &subject.head, recording, teeth)?;
        if let Some(table) = recording.poses() {
            plan.take_poses(&PoseTable::load(&table)?, hand_eye(&subject)?)?;
        }
        let captures = view_of.into_iter().zip(captures);
        let captures = captures.filter_map(|(view, capture)| Some((view?, capture)));
        let frames = RecordedFrames::new(recording, captures.collect());
        let job = Self::start_check(subject, setting, plan, None)?;
        Ok((job, frames))
    }

    /// Plays every view's first capture; then, as a live check would, the next one of views that must be repeated or are too near
    /// to a limit.
    pub(super) async fn play_check(
        &mut self,
        frames: &mut RecordedFrames,
        run: &mut Run<ViewOutcome>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let mut planned = self.view_names();
        planned.truncate(self.plan.views.len());
        for (view, of) in planned.into_iter().enumerate() {
            if frames
                .captures
                .iter()
                .all(|(captured, _)| *captured != view)
            {
                run.problems.insert(view, ViewError::NotRecorded { of });
            }
        }
        let inspect = self.subject.tool.inspect.as_ref();
        let repetitions = inspect.map_or(0, |inspect| inspect.remeasure);
        let all = run.wanted.clone();
        self.play_next(frames, run, &all, watch).await?;
        let retaken = views_that(run, |outcome| outcome.retake);
        self.play_next(frames, run, &retaken, watch).await?;
        for _ in 0..repetitions {
            let mut again = views_that(run, ViewOutcome::is_open);
            for outcome in run.outcomes.values() {
                again.extend(outcome.further_wanted(&self.plan));
            }
            let before = std::mem::take(&mut run.outcomes);
            self.play_next(frames, run, &again, watch).await?;
            let again = std::mem::take(&mut run.outcomes);
            run.outcomes = ViewOutcome::joined(before, again, &self.plan);
        }
        Ok(())
    }

    /// Plays the next capture of each of these views that has one left.
    async fn play_next(
        &mut self,
        frames: &mut RecordedFrames,
        run: &mut Run<ViewOutcome>,
        views: &[usize],
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        for some in frames
            .next_of(views)
            .chunks(flankscope_protocol::plan::MAX_VIEWS)
        {
            self.acquisition.play(run, some, watch).await?;
        }
        Ok(())
    }

    /// Writes the index of the frames that were saved for a check. `head` is the head file in the same folder.
    ///
    /// # Errors
    /// A file was not written.
    pub fn record_check(
        &mut self,
        of: &Inspection,
        folder: &Path,
        head: &Path,
    ) -> Result<(), RecordError> {
        let teeth = self.plan.views.iter().map(|view| view.tooth).collect();
        let note = FrameIndex {
            teeth: Some(teeth),
            press_cycles: Some(of.press_cycles),
            ..FrameIndex::default()
        };
        self.write_recording(folder, head, note)
    }
}

/// Views of a run whose outcome satisfies `is`.
fn views_that(run: &Run<ViewOutcome>, is: impl Fn(&ViewOutcome) -> bool) -> Vec<usize> {
    let outcomes = run.outcomes.iter().filter(|(_, outcome)| is(outcome));
    outcomes.map(|(&view, _)| view).collect()
}

/// The tooth in the middle of a view of an index, by its entry and by its angle.
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

/// Whether a view of an index shows its tooth from the side: another view has that tooth in the middle, this one a tooth near it.
fn is_from_the_side(gear: &GearData, view: &IndexedView, all: &[IndexedView]) -> bool {
    let (Some(tooth), Some(angle_rad)) = (view.tooth, view.rotation_rad) else {
        return false;
    };
    let in_middle = |angle_rad: f64| gear.tooth_at(-angle_rad);
    let apart = in_middle(angle_rad).abs_diff(tooth);
    let apart = apart.min(gear.teeth.saturating_sub(apart));
    let has_tooth_in_middle = |of: &IndexedView| {
        let angle_rad = of.rotation_rad;
        of.tooth == Some(tooth) && angle_rad.is_none_or(|angle_rad| in_middle(angle_rad) == tooth)
    };
    (1..=FURTHER_TEETH).contains(&apart) && all.iter().any(has_tooth_in_middle)
}

/// The views of recorded frames: those of `teeth`, else of the teeth in the index, else all. Also, for each view of the index,
/// its position among them, if it is one of them.
fn plan(
    tool: &Tool,
    head: &HeadModel,
    recording: &Recording,
    teeth: Option<&[u32]>,
) -> Result<(ViewPlan, Vec<Option<usize>>), PlanningError> {
    let is_further = |view: &IndexedView| {
        let gear = tool.gear.as_ref();
        gear.is_some_and(|gear| is_from_the_side(gear, view, &recording.index.view))
    };
    let in_middle = |(at, view): (usize, &IndexedView)| match &tool.gear {
        Some(_) if is_further(view) => view.tooth.ok_or(PlanningError::NoTeeth),
        Some(gear) => tooth_in_middle(gear, at, view),
        None if tool.patches.is_empty() => Err(PlanningError::NoGear),
        // Several patches may be in one view, so the index must name the patch.
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
    let mut view_of = vec![None; seen.len()];
    let count = views.len();
    let mut aside: Vec<(usize, PlannedView)> = Vec::new();
    for (place, planned) in views.iter_mut().enumerate() {
        let nominal = planned.clone();
        let of_tooth = |at: &usize| seen[*at] == nominal.tooth;
        let mut captures: Vec<usize> = (0..seen.len()).filter(of_tooth).collect();
        captures.sort_by_key(|&at| is_further(&recording.index.view[at]));
        for at in captures {
            let said = &recording.index.view[at];
            let stood = PlannedView {
                rotation_rad: said.rotation_rad.unwrap_or(nominal.rotation_rad),
                vertical_mm: said.vertical_mm.unwrap_or(nominal.vertical_mm),
                ..nominal.clone()
            };
            if view_of.contains(&Some(place)) && *planned != stood {
                if tool.gear.is_none() {
                    let tooth = planned.tooth;
                    return Err(PlanningError::Elsewhere { tooth });
                }
                aside.push((at, stood));
                continue;
            }
            *planned = stood;
            view_of[at] = Some(place);
        }
    }
    // The further views that a live check would have, and those from other places.
    let mut further = further_views(tool, head, &views);
    for (at, view) in aside {
        let known = further.iter().position(|of| of.view == view);
        view_of[at] = Some(count + known.unwrap_or(further.len()));
        if known.is_none() {
            let flank = None;
            further.push(FurtherView { flank, view });
        }
    }
    if tool.gear.is_none() {
        check_seen(tool, head, &views)?;
    }
    Ok((
        ViewPlan::of_recording(recording, (views, further), tool, head),
        view_of,
    ))
}
