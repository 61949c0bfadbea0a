//! The instrument's host side: the threads that frames and sums pass through, whatever is measured.

use std::sync::Arc;
use std::sync::mpsc;
use std::thread::JoinHandle;

use flankscope_frames::{FrameReceiver, SharedRoot};
use flankscope_profilometry::{Accumulator, Decoder, FrameKind};
use tokio::sync::mpsc as channel;

use super::job::{InspectError, Subject};
use super::plan::Itinerary;
use super::recorder::{Keepsake, Order, Orders, Recorded, Recorder, RecorderSettings};
use super::views::ViewOutcome;
use crate::history::Keeper;
use crate::origin::Setting;

/// The instrument's host side: its threads run, frames have a place to arrive.
///
/// Made before the camera process starts, so that the services are there when it comes.
#[derive(Debug)]
pub struct Station<O = ViewOutcome, S = Subject> {
    pub(crate) subject: S,
    orders: Option<Orders>,
    pub(super) recorded: channel::UnboundedReceiver<Recorded>,
    capture: Option<JoinHandle<()>>,
    pub(super) work: Option<mpsc::Sender<(usize, Accumulator)>>,
    pub(super) outcomes: channel::UnboundedReceiver<(usize, Box<O>)>,
    compute: Option<JoinHandle<()>>,
    pub(crate) itinerary: Arc<Itinerary>,
    /// Where checks are stored, if they are.
    pub(crate) keeper: Option<Keeper>,
    /// Where it works; not told where nobody asks.
    pub(crate) setting: Option<Setting>,
}

impl<O: Send + 'static, S> Station<O, S> {
    /// Starts the capture thread, and the compute thread with what it makes of a view's sums.
    pub(crate) fn start(
        subject: S,
        itinerary: Arc<Itinerary>,
        decoder: Arc<Decoder>,
        root: Arc<SharedRoot>,
        mut evaluate: impl FnMut(usize, &Accumulator) -> O + Send + 'static,
    ) -> Result<Self, InspectError> {
        let settings = RecorderSettings {
            dark_limit_dn: decoder.dark_limit_dn(),
            keepsake: Keepsake {
                exposure: itinerary.exposures_us.len() as u16 / 2,
                pattern: itinerary.patterns.frames_per_exposure() as u16,
            },
            full_scale_dn: decoder.full_scale_dn(),
        };
        let (order_sender, order_receiver) = mpsc::channel();
        let (recorded_sender, recorded) = channel::unbounded_channel();
        let (ready_sender, ready) = mpsc::channel();
        let capture_decoder = Arc::clone(&decoder);
        // Ports stay on the thread that made them.
        let capture = std::thread::Builder::new()
            .name("capture".into())
            .spawn(move || {
                let receiver = match FrameReceiver::create(&root) {
                    Ok(receiver) => receiver,
                    Err(error) => return drop(ready_sender.send(Err(error))),
                };
                let _ = ready_sender.send(Ok(()));
                let kinds: Vec<FrameKind> = capture_decoder.capture_order().collect();
                let fresh = || capture_decoder.begin();
                Recorder::new(
                    receiver,
                    settings,
                    kinds,
                    order_receiver,
                    recorded_sender,
                    fresh,
                )
                .run();
            });
        let capture = capture.map_err(|_| InspectError::Thread { thread: "capture" })?;
        ready
            .recv()
            .map_err(|_| InspectError::Thread { thread: "capture" })??;
        let (work, to_do) = mpsc::channel::<(usize, Accumulator)>();
        let (outcome_sender, outcomes) = channel::unbounded_channel();
        let recycle = order_sender.clone();
        let compute = std::thread::Builder::new()
            .name("compute".into())
            .spawn(move || {
                while let Ok((view, accumulator)) = to_do.recv() {
                    let outcome = evaluate(view, &accumulator);
                    let _ = recycle.send(Order::Recycle(accumulator));
                    if outcome_sender.send((view, Box::new(outcome))).is_err() {
                        return;
                    }
                }
            });
        let compute = compute.map_err(|_| InspectError::Thread { thread: "compute" })?;
        Ok(Self {
            subject,
            orders: Some(order_sender),
            recorded,
            capture: Some(capture),
            work: Some(work),
            outcomes,
            compute: Some(compute),
            itinerary,
            keeper: None,
            setting: None,
        })
    }

    pub(super) fn order(&self, order: Order) -> Result<(), InspectError> {
        let gone = InspectError::Thread { thread: "capture" };
        self.orders.as_ref().ok_or(gone).and_then(|orders| {
            orders
                .send(order)
                .map_err(|_| InspectError::Thread { thread: "capture" })
        })
    }
}

impl<O, S> Drop for Station<O, S> {
    fn drop(&mut self) {
        // The threads end when their orders end.
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
