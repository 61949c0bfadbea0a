//! An acquisition whose frames come from a folder: from recorded views to their outcomes.

use std::sync::mpsc::{self, Receiver, Sender};

use flankscope_frames::{Arm, monotonic_ns};
use flankscope_profilometry::Decoder;
use flankscope_protocol::Event;

use super::RecordedView;
use super::source::{Camera, FolderSource, ImageProblem};
use crate::acquisition::error::{AcquisitionError, Progress, ViewError};
use crate::acquisition::recorder::{Order, Recorded};
use crate::acquisition::run::Run;
use crate::acquisition::session::Acquisition;

/// Sends a source of recorded frames the views that it has to read.
#[derive(Debug)]
pub struct Playback {
    next: Sender<Vec<RecordedView>>,
    problems: Receiver<(usize, ImageProblem)>,
}

impl Playback {
    /// A source of the frames that `decoder` takes, and the sender of the views to read.
    pub fn new(decoder: &Decoder, exposures_us: &[u32]) -> (Self, FolderSource) {
        let (next, to_read) = mpsc::channel();
        let (found, problems) = mpsc::channel();
        let camera = Camera {
            size_px: decoder.size_px(),
            full_scale: decoder.full_scale_dn(),
            exposures_us: exposures_us.to_vec(),
        };
        (
            Self { next, problems },
            FolderSource::new(camera, to_read, found),
        )
    }
}

impl<O: Send + 'static> Acquisition<O> {
    /// Processes the recorded frames of some views as frames of a camera would be.
    ///
    /// # Errors
    /// A thread ended early, or this acquisition takes its frames from a camera.
    pub async fn play(
        &mut self,
        run: &mut Run<O>,
        views: &[(usize, RecordedView)],
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), AcquisitionError> {
        let gone = || AcquisitionError::Thread { thread: "capture" };
        let session = monotonic_ns() as u32;
        let numbers: Vec<usize> = views.iter().map(|(view, _)| *view).collect();
        run.begin_session(&numbers);
        let recorded: Vec<RecordedView> = views.iter().map(|(_, of)| of.clone()).collect();
        let frames = recorded.first().map_or(0, RecordedView::frames);
        for (number, view) in recorded.iter().enumerate() {
            for trigger in view.triggers(session, number as u8, &self.program.exposures_us) {
                run.timeline.note(&Event::Triggered(trigger));
                run.triggered(trigger);
            }
        }
        let playback = self.playback.as_ref().ok_or_else(gone)?;
        playback.next.send(recorded).map_err(|_| gone())?;
        let arm = Arm {
            session,
            first_view: 0,
            views: views.len() as u16,
            exposures: self.program.exposures_us.len() as u16,
            patterns: (self.program.passes() * self.program.patterns.frames_per_exposure()) as u16,
        };
        self.order(Order::Arm(arm))?;
        if let Err(camera) = self.armed(run).await? {
            tracing::warn!(%camera, "recorded frames");
        }
        // Recorded frames have all been exposed, so there is nothing to wait for.
        self.order(Order::Close)?;
        let mut closed = false;
        while !closed || run.session.evaluating > 0 {
            tokio::select! {
                recorded = self.recorded.recv() => match recorded.ok_or_else(gone)? {
                    Recorded::View(view) => run.session.waiting.push(*view),
                    Recorded::Closed => closed = true,
                    Recorded::Armed(_) => {}
                    Recorded::Picture(view, picture) => run.pictured(view, picture),
                },
                outcome = self.outcomes.recv() => {
                    let (view, outcome) = outcome.ok_or(AcquisitionError::Thread { thread: "compute" })?;
                    watch(Progress::Evaluated(view));
                    run.evaluated(view, *outcome);
                }
            }
            self.evaluate_whole_views(run, frames as u16, None)?;
        }
        let problems = self.playback.iter().flat_map(|of| of.problems.try_iter());
        for (number, problem) in problems {
            if let Some(&view) = numbers.get(number) {
                run.spoil(view, ViewError::Image(problem));
            }
        }
        Ok(())
    }
}
