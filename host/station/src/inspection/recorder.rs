//! The capture thread: takes each frame where it lies, adds it to its view's phasors, gives the slot back.
//!
//! Frames are summed while the next ones are exposed, so that after a view's last exposure only the solving is left.

use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::time::Duration;

use flankscope_profilometry::{Accumulator, FrameError, FrameKind};

use super::pairing::PairingError;
use crate::capture::{Arm, Frame, FrameHeader, FrameReceiver, ReceiveError};

/// How long the thread sleeps for a frame before it looks for orders.
const PATIENCE: Duration = Duration::from_millis(5);

/// A frame that does not come for so long after the last trigger is lost: its readout takes 13 ms, a busy camera process
/// some tens more.
const LAST_FRAME_PATIENCE: Duration = Duration::from_millis(500);

/// What the job tells the recorder.
#[derive(Debug)]
pub enum Order {
    /// Frames of this plan follow.
    Arm(Arm),
    /// All triggers of the armed plan were fired: whatever is still open is incomplete.
    Close,
    /// An accumulator that may be used again.
    Recycle(Accumulator),
}

/// Why a view's frames cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// A frame did not fit the plan, or showed the wrong thing.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A frame could not be read.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// Triggers and frames do not pair.
    #[error(transparent)]
    Pairing(#[from] PairingError),
    /// The camera process is labelling another session.
    #[error("a frame of session {got} came during session {expected}")]
    Session {
        /// Session of the frame.
        got: u32,
        /// Session armed.
        expected: u32,
    },
    /// Frames are missing at the end.
    #[error("only {got} of {planned} frames came")]
    Incomplete {
        /// Frames that came.
        got: usize,
        /// Frames planned.
        planned: usize,
    },
}

/// All frames of one view, summed.
#[derive(Debug)]
pub struct CapturedView {
    /// View number in the session.
    pub view: u16,
    /// The sums.
    pub accumulator: Accumulator,
    /// Headers of the frames, in order of arrival.
    pub frames: Vec<FrameHeader>,
    /// Why it cannot be used.
    pub problem: Option<ViewError>,
}

/// What the recorder tells the job.
#[derive(Debug)]
pub enum Recorded {
    /// A view's last frame was added, or the view was given up.
    View(Box<CapturedView>),
    /// After [`Order::Close`]: nothing is open any more.
    Closed,
    /// A frame for the report: width, height, 8-bit grey.
    Picture(usize, usize, Vec<u8>),
}

/// Which frame to keep for the report.
#[derive(Clone, Copy, Debug)]
pub struct Keepsake {
    /// Exposure step.
    pub exposure: u16,
    /// Pattern, 1.. .
    pub pattern: u16,
}

/// How frames are judged and kept.
#[derive(Clone, Copy, Debug)]
pub struct RecorderSettings {
    /// A dark frame's mean must stay below this, every fringe frame's above, DN.
    pub dark_limit_dn: f64,
    /// The frame that the report shows.
    pub keepsake: Keepsake,
    /// Full scale of the sensor, DN.
    pub full_scale_dn: u16,
}

/// The thread's state.
pub struct Recorder<'a> {
    receiver: &'a FrameReceiver,
    settings: RecorderSettings,
    kinds: Vec<FrameKind>,
    orders: Receiver<Order>,
    events: tokio::sync::mpsc::UnboundedSender<Recorded>,
    fresh: Box<dyn Fn() -> Accumulator + 'a>,
    spare: Vec<Accumulator>,
    arm: Option<Arm>,
    /// Frames since arming.
    arrived: u32,
    open: Option<CapturedView>,
    kept: Option<Frame>,
}

impl<'a> Recorder<'a> {
    /// A recorder of frames from `receiver`; `kinds` is the order of a view's frames, `fresh` makes empty sums.
    pub fn new(
        receiver: &'a FrameReceiver,
        settings: RecorderSettings,
        kinds: Vec<FrameKind>,
        orders: Receiver<Order>,
        events: tokio::sync::mpsc::UnboundedSender<Recorded>,
        fresh: impl Fn() -> Accumulator + 'a,
    ) -> Self {
        let spare = vec![fresh(), fresh()];
        Self {
            receiver,
            settings,
            kinds,
            orders,
            events,
            fresh: Box::new(fresh),
            spare,
            arm: None,
            arrived: 0,
            open: None,
            kept: None,
        }
    }

    /// Runs until the job hangs up.
    pub fn run(mut self) {
        loop {
            match self.orders.try_recv() {
                Ok(Order::Arm(arm)) => self.start(arm),
                Ok(Order::Close) => {
                    self.drain();
                    self.close();
                    self.show();
                    let _ = self.events.send(Recorded::Closed);
                }
                Ok(Order::Recycle(mut accumulator)) => {
                    accumulator.reset();
                    self.spare.push(accumulator);
                }
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return,
            }
            match self.receiver.receive(PATIENCE) {
                Ok(Some(frame)) => self.add(frame),
                Ok(None) => {}
                Err(error) => self.fail(error.into()),
            }
        }
    }

    fn start(&mut self, arm: Arm) {
        self.close();
        self.arm = Some(arm);
        self.arrived = 0;
        if let Err(error) = self.receiver.arm(arm) {
            self.fail(error.into());
        }
    }

    fn add(&mut self, frame: Frame) {
        let header = *frame.header();
        let Some(arm) = self.arm else { return }; // nobody asked for this frame
        self.arrived += 1;
        if self
            .open
            .as_ref()
            .is_some_and(|open| open.view != header.label.view)
        {
            self.close();
        }
        if self.open.is_none() {
            let accumulator = self.spare.pop().unwrap_or_else(|| (self.fresh)());
            self.open = Some(CapturedView {
                view: header.label.view,
                accumulator,
                frames: Vec::new(),
                problem: None,
            });
        }
        let settings = self.settings;
        let Some(open) = self.open.as_mut() else {
            return;
        };
        open.frames.push(header);
        if open.problem.is_none() {
            open.problem = match self.kinds.get(usize::from(header.label.in_view)) {
                _ if header.session != arm.session => Some(ViewError::Session {
                    got: header.session,
                    expected: arm.session,
                }),
                None => Some(ViewError::Incomplete {
                    got: open.frames.len(),
                    planned: self.kinds.len(),
                }),
                Some(&kind) => open
                    .accumulator
                    .add(frame.view(), kind)
                    .and_then(|level| level.check_content(kind, settings.dark_limit_dn))
                    .err()
                    .map(ViewError::from),
            };
        }
        if (header.label.exposure, header.label.pattern)
            == (settings.keepsake.exposure, settings.keepsake.pattern)
            && self.kept.is_none()
        {
            self.kept = Some(frame);
        }
        if open.frames.len() == self.kinds.len() && open.problem.is_none() {
            self.close();
        }
    }

    /// Takes the frames that are still on their way.
    fn drain(&mut self) {
        let planned = self
            .arm
            .map_or(0, |arm| u32::from(arm.views) * arm.frames_per_view());
        while self.arrived < planned {
            match self.receiver.receive(LAST_FRAME_PATIENCE) {
                Ok(Some(frame)) => self.add(frame),
                Ok(None) => return,
                Err(error) => self.fail(error.into()),
            }
        }
    }

    /// Hands the open view to the job.
    fn close(&mut self) {
        let Some(mut view) = self.open.take() else {
            return;
        };
        if view.problem.is_none() && view.frames.len() < self.kinds.len() {
            view.problem = Some(ViewError::Incomplete {
                got: view.frames.len(),
                planned: self.kinds.len(),
            });
        }
        let _ = self.events.send(Recorded::View(Box::new(view)));
    }

    fn fail(&mut self, error: ViewError) {
        match self.open.as_mut() {
            Some(open) => drop(open.problem.get_or_insert(error)),
            None => tracing::warn!(%error, "a frame outside any view"),
        }
    }

    /// Draws the kept frame out of the shared memory, as 8-bit grey, and releases it.
    fn show(&mut self) {
        let Some(frame) = self.kept.take() else {
            return;
        };
        let view = frame.view();
        let full = u32::from(self.settings.full_scale_dn.max(1));
        let grey = view
            .pixels
            .chunks(view.stride)
            .take(view.height)
            .flat_map(|row| row.iter().take(view.width))
            .map(|&dn| (u32::from(dn) * 255 / full).min(255) as u8)
            .collect();
        let _ = self
            .events
            .send(Recorded::Picture(view.width, view.height, grey));
    }
}

/// The sending ends that the job keeps.
pub type Orders = Sender<Order>;
