//! The scan of recorded frames: everything after the camera is as in a live scan.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason};

use super::grid::Grid;
use super::job::{Captured, Progress, ScanError, Scanner, keep};
use super::view_pipeline::PlannedScan;
use crate::inspection::{InspectError, tooth_in_middle};
use crate::job::RecordedFrames;
use crate::plan::{PlanningError, ViewPlan};
use crate::subject::Subject;
use flankscope_instrument::acquisition::{IndexedView, RecordedView, Recording};
use flankscope_metrology::view::PlannedView;
use flankscope_record::origin::Setting;

/// Positions nearer to each other than this are equal: rad and mm, far below the resolution of a stage.
const SAME_PLACE: f64 = 1e-9;

impl Scanner {
    /// Prepares a scan of these frames in `folder`, which may hold an earlier part of it. The result states `setting` as its origin.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, the folder belongs to another scan, or an image is missing or differs from plan and head file.
    pub fn open_recorded(
        subject: Subject,
        setting: Setting,
        recording: &Recording,
        folder: &Path,
    ) -> Result<(Self, RecordedFrames), ScanError> {
        if let Some(poses) = recording.poses() {
            return Err(ScanError::PosesFromTable { poses });
        }
        let recorded = recording.views(&subject.head);
        let recorded = recorded.map_err(InspectError::from)?;
        let (tool, index) = (&subject.tool, &recording.index);
        let (views, of) = planned(tool, index.grid.as_deref(), &index.view)?;
        let name = name_of(index.grid.as_deref(), &views);
        let planned = PlannedScan {
            name,
            plan: ViewPlan::of_recording(recording, (views, Vec::new()), tool, &subject.head),
        };
        let same = BTreeMap::from([("recording".to_owned(), recording.blake3.clone())]);
        let frames = RecordedFrames::new(recording, of.into_iter().zip(recorded).collect());
        let scanner = Self::start(subject, setting, planned, (folder, &same), None)?;
        Ok((scanner, frames))
    }

    /// Plays every capture in order; a further one of a view is used if none before it was kept.
    pub(super) async fn play_scan(
        &mut self,
        frames: &mut RecordedFrames,
        Captured { run, lost, .. }: &mut Captured,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), ScanError> {
        let of = self.job.plan.views.len();
        for view in 0..of {
            if !self.is_kept(view) {
                let why = format!("the recording has no frames of view {}", view + 1);
                lost.insert(view, Reason::instrument(Code::NotCaptured, why));
            }
        }
        let resumed = of - lost.len();
        let begun = Instant::now();
        let mut rest = std::mem::take(&mut frames.captures).into_iter().peekable();
        while rest.peek().is_some() {
            let mut some: Vec<(usize, RecordedView)> = Vec::new();
            while let Some((view, _)) = rest.peek()
                && some.len() < flankscope_protocol::plan::MAX_VIEWS
                && some.iter().all(|(other, _)| other != view)
            {
                some.extend(rest.next().filter(|(view, _)| !self.is_kept(*view)));
            }
            let views: Vec<usize> = some.iter().map(|(view, _)| *view).collect();
            self.job.acquisition.play(run, &some, &mut |_| {}).await?;
            keep(&mut self.store, lost, run, &views, None)?;
            let done = (0..of).filter(|&view| self.is_kept(view)).count();
            let new = done.saturating_sub(resumed).max(1);
            watch(Progress::Views {
                done,
                of,
                remaining: begun.elapsed() / new as u32 * (of - done) as u32,
            });
        }
        Ok(())
    }

    fn is_kept(&self, view: usize) -> bool {
        self.store.session.pose(view).is_some()
    }
}

/// The views of a recorded scan: those of its grid, or else those in its index. Also, for each view of the index, its position among them.
pub(super) fn planned(
    tool: &Tool,
    grid: Option<&str>,
    index: &[IndexedView],
) -> Result<(Vec<PlannedView>, Vec<usize>), ScanError> {
    let gear = tool.gear.as_ref();
    let gear = gear.ok_or(InspectError::from(PlanningError::NoGear))?;
    let mut views: Vec<PlannedView> = Vec::new();
    if let Some(grid) = grid {
        views = grid.parse::<Grid>()?.views(gear);
    }
    let mut of = Vec::with_capacity(index.len());
    for (at, said) in index.iter().enumerate() {
        let tooth = tooth_in_middle(gear, at, said).map_err(InspectError::from)?;
        let nominal = ViewPlan::nominal(tool, &[tooth]);
        let nominal = nominal.map_err(InspectError::from)?.swap_remove(0);
        let stood = PlannedView {
            tooth,
            rotation_rad: said.rotation_rad.unwrap_or(nominal.rotation_rad),
            vertical_mm: said.vertical_mm.unwrap_or(nominal.vertical_mm),
        };
        let same = |view: &PlannedView| {
            (view.rotation_rad - stood.rotation_rad).abs() < SAME_PLACE
                && (view.vertical_mm - stood.vertical_mm).abs() < SAME_PLACE
        };
        of.push(match (views.iter().position(same), grid) {
            (Some(place), _) => place,
            (None, None) => {
                views.push(stood);
                views.len() - 1
            }
            (None, Some(grid)) => {
                return Err(ScanError::OffGrid {
                    view: at + 1,
                    grid: grid.to_owned(),
                });
            }
        });
    }
    Ok((views, of))
}

/// Name of a recording's set of views.
pub(super) fn name_of(grid: Option<&str>, views: &[PlannedView]) -> String {
    grid.map_or_else(|| format!("{} recorded views", views.len()), str::to_owned)
}
