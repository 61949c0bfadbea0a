//! Host side of the instrument: the threads that frames and sums pass through, independent of what is measured.

use std::path::Path;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;

use flankscope_frames::{FrameReceiver, FrameSource, SharedRoot};
use flankscope_profilometry::head::{ImageCircle, LensDrive};
use flankscope_profilometry::{Accumulator, Decoder};
use tokio::sync::mpsc as channel;

use super::error::AcquisitionError;
use super::program::Program;
use super::recorder::{HeadCamera, Keepsake, Order, Orders, Recorded, Recorder, RecorderSettings};
use super::recording::{Playback, SavedView, Saver};
use super::sums::{ViewSums, planned_frames};

/// The running threads and the shared memory in which frames arrive. `O` is the outcome of a view's evaluation.
///
/// Made before the camera process starts, so that the shared-memory services exist when it connects.
#[derive(Debug)]
pub struct Acquisition<O> {
    pub(super) program: Program,
    full_scale_dn: u16,
    /// Requests views from the source of recorded frames; `None` if frames come from a camera.
    pub(super) playback: Option<Playback>,
    orders: Option<Orders>,
    pub(super) recorded: channel::UnboundedReceiver<Recorded>,
    capture: Option<JoinHandle<()>>,
    pub(super) work: Option<mpsc::Sender<(usize, ViewSums)>>,
    pub(super) outcomes: channel::UnboundedReceiver<(usize, Box<O>)>,
    compute: Option<JoinHandle<()>>,
    /// Captures that were saved to files, if requested.
    pub(super) saved: Vec<SavedView>,
}

impl<O: Send + 'static> Acquisition<O> {
    /// Starts the capture thread with the frames that a camera process writes below `camera`, or without one with recorded
    /// frames ([`Self::play`]), and the compute thread, which calls `evaluate` for the sums of each view.
    ///
    /// # Errors
    /// Shared memory or a thread cannot be created.
    pub fn start(
        program: Program,
        decoder: &Arc<Decoder>,
        camera: Option<Arc<SharedRoot>>,
        evaluate: impl FnMut(usize, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, AcquisitionError> {
        let Some(root) = camera else {
            let (playback, source) = Playback::new(decoder, &program.exposures_us);
            let mut acquisition = Self::fed_by(program, decoder, move || Ok(source), evaluate)?;
            acquisition.playback = Some(playback);
            return Ok(acquisition);
        };
        let source = move || Ok(FrameReceiver::create(&root)?);
        Self::fed_by(program, decoder, source, evaluate)
    }

    fn fed_by<S: FrameSource>(
        program: Program,
        decoder: &Arc<Decoder>,
        source: impl FnOnce() -> Result<S, AcquisitionError> + Send + 'static,
        mut evaluate: impl FnMut(usize, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, AcquisitionError> {
        let settings = RecorderSettings {
            lit_dn: decoder.dark_limit_dn(),
            keepsake: Keepsake {
                exposure: program.exposures_us.len() as u16 / 2,
                // The first pattern of the finest fringes: the picture is made before the view's last frame has come.
                pattern: 1 + {
                    let sets = program.patterns.sets.iter().rev().skip(1);
                    sets.map(|set| set.steps as u16).sum::<u16>()
                },
            },
            full_scale_dn: decoder.full_scale_dn(),
            camera: HeadCamera {
                size_px: decoder.size_px(),
                sensor: Some(decoder.sensor()),
            },
        };
        let (order_sender, order_receiver) = mpsc::channel();
        let (recorded_sender, recorded) = channel::unbounded_channel();
        let (ready_sender, ready) = mpsc::channel();
        let capture_decoder = Arc::clone(decoder);
        let lit_ratios = program.lit_ratios.clone();
        // Shared-memory ports must stay on the thread that created them.
        let capture = std::thread::Builder::new()
            .name("capture".into())
            .spawn(move || {
                let source = match source() {
                    Ok(source) => source,
                    Err(error) => return drop(ready_sender.send(Err(error))),
                };
                let _ = ready_sender.send(Ok(()));
                let fresh = || ViewSums::new(&capture_decoder, lit_ratios.len());
                Recorder::new(
                    source,
                    settings,
                    planned_frames(&capture_decoder, &lit_ratios),
                    order_receiver,
                    recorded_sender,
                    fresh,
                )
                .run();
            });
        let capture = capture.map_err(|_| AcquisitionError::Thread { thread: "capture" })?;
        ready
            .recv()
            .map_err(|_| AcquisitionError::Thread { thread: "capture" })??;
        let (work, to_do) = mpsc::channel::<(usize, ViewSums)>();
        let (outcome_sender, outcomes) = channel::unbounded_channel();
        let recycle = order_sender.clone();
        let compute_decoder = Arc::clone(decoder);
        let compute = std::thread::Builder::new()
            .name("compute".into())
            .spawn(move || {
                while let Ok((view, mut sums)) = to_do.recv() {
                    let outcome = evaluate(view, sums.joined(&compute_decoder));
                    let _ = recycle.send(Order::Recycle(sums));
                    if outcome_sender.send((view, Box::new(outcome))).is_err() {
                        return;
                    }
                }
            });
        let compute = compute.map_err(|_| AcquisitionError::Thread { thread: "compute" })?;
        Ok(Self {
            program,
            full_scale_dn: decoder.full_scale_dn(),
            playback: None,
            orders: Some(order_sender),
            recorded,
            capture: Some(capture),
            work: Some(work),
            outcomes,
            compute: Some(compute),
            saved: Vec::new(),
        })
    }

    /// Sets how the lens is driven from the next capture on.
    pub fn drive(&mut self, lens: LensDrive) {
        self.program.lens = Some(lens);
    }

    /// What stages, projector and camera are to do.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Also writes all following frames into `folder`.
    pub fn save_frames(&self, folder: &Path) -> Result<(), AcquisitionError> {
        self.order(Order::Save(Saver::new(folder, self.full_scale_dn)))
    }

    /// Also counts the pixel levels of all following frames, in this circle or over the whole frame.
    ///
    /// # Errors
    /// A thread ended early.
    pub fn count_levels(&self, circle: Option<ImageCircle>) -> Result<(), AcquisitionError> {
        self.order(Order::CountLevels(circle))
    }

    /// The captures that were saved since the last call, in their order.
    pub fn take_saved(&mut self) -> Vec<SavedView> {
        std::mem::take(&mut self.saved)
    }

    pub(super) fn order(&self, order: Order) -> Result<(), AcquisitionError> {
        let gone = AcquisitionError::Thread { thread: "capture" };
        self.orders.as_ref().ok_or(gone).and_then(|orders| {
            orders
                .send(order)
                .map_err(|_| AcquisitionError::Thread { thread: "capture" })
        })
    }
}

impl<O> Drop for Acquisition<O> {
    fn drop(&mut self) {
        // The threads end when their channel of orders is closed.
        self.orders = None;
        self.work = None;
        for thread in [self.compute.take(), self.capture.take()]
            .into_iter()
            .flatten()
        {
            let _ = thread.join();
        }
    }
}
