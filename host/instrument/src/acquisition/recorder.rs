//! The capture thread: adds each frame, read in shared memory, to its view's phasors, then releases its slot.
//!
//! Frames are summed while the next ones are exposed, so after a view's last exposure only the solution is left to compute.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::time::{Duration, Instant};

use flankscope_profilometry::head::{ImageCircle, Sensor};
use flankscope_profilometry::{FrameView, Picture};

use super::error::{CameraError, ViewError};
use super::levels::ViewLevels;
use super::recording::{SavedCapture, Saver};
use super::sums::{PlannedFrame, ViewSums};
use flankscope_frames::{Arm, BorrowedFrame, FrameHeader, FrameSource, Ready, ReceiveError};

/// How long the thread waits for a frame before it checks for orders.
const PATIENCE: Duration = Duration::from_millis(5);

/// A frame that arrives later than this after the last trigger counts as lost: its readout takes 13 ms, and a busy camera process
/// adds some tens of ms.
const LAST_FRAME_PATIENCE: Duration = Duration::from_millis(500);

/// A frame that was not triggered arrives within two readouts of the last one; a later one does not belong to this capture.
const EXTRA_FRAME_PATIENCE: Duration = Duration::from_millis(30);

/// A camera that has sent frames for so long, none of which is one of those still missing, never ends.
const DRAINING: Duration = Duration::from_secs(2);

/// A camera that has not reported within this time that it is armed counts as absent: a process takes a second to start, a camera
/// some tenths of a second to empty its queue.
const CAMERA_PATIENCE: Duration = Duration::from_secs(5);

/// Number of earlier sessions that are remembered: a frame of one of them is late, a frame of any other session is foreign.
const EARLIER_SESSIONS: usize = 16;

/// What the job tells the recorder.
#[derive(Debug)]
pub enum Order {
    /// Frames of this plan follow.
    Arm(Arm),
    /// All triggers of the armed plan were fired: views without all frames are incomplete.
    Close,
    /// Sums that may be used again for another view.
    Recycle(ViewSums),
    /// From here on, frames are also written to files.
    Save(Saver),
    /// From here on, pixel levels are counted in this circle, or over the whole frame without one.
    CountLevels(Option<ImageCircle>),
}

/// All frames of one view, summed.
#[derive(Debug)]
pub struct CapturedView {
    /// View number in the session.
    pub view: u16,
    pub sums: ViewSums,
    /// Headers of the frames, in order of arrival.
    pub frames: Vec<FrameHeader>,
    /// Time from hand-over by the camera process to reception by the host, per frame, ns.
    pub handover_ns: Vec<u64>,
    /// Why the view cannot be used, if it cannot.
    pub problem: Option<ViewError>,
    /// Files of its frames, if they are saved.
    pub saved: Option<SavedCapture>,
    /// Pixel levels of its frames, if they are counted.
    pub levels: Option<ViewLevels>,
}

/// What the recorder tells the job.
#[derive(Debug)]
pub enum Recorded {
    /// A view's last frame was added, or the view was given up.
    View(Box<CapturedView>),
    /// Answer to [`Order::Arm`]: the camera is armed and its queue empty, or why it cannot be used.
    Armed(Result<(), CameraError>),
    /// Answer to [`Order::Close`]: no view is open any more.
    Closed,
    /// One frame of a view (its number in the session), reduced to a picture for the report.
    Picture(u16, Picture),
}

/// Views of a session of which a picture is made: as many as a report shows beside each other. A scan has hundreds.
const MOST_PICTURES: u16 = 12;

/// Which frame of a view to keep as the report's picture.
#[derive(Clone, Copy, Debug)]
pub struct Keepsake {
    /// Exposure step.
    pub exposure: u16,
    /// Pattern, 1.. .
    pub pattern: u16,
}

/// Settings for checking frames and for the pictures that are kept.
#[derive(Clone, Copy, Debug)]
pub struct RecorderSettings {
    /// Pixels above this level count as lit, DN.
    pub lit_dn: f64,
    /// The frame of each view that the report shows.
    pub keepsake: Keepsake,
    /// Full scale of the sensor, DN.
    pub full_scale_dn: u16,
    /// Properties of the camera in the head file.
    pub camera: HeadCamera,
}

/// The camera as the head file describes it.
#[derive(Clone, Copy, Debug)]
pub struct HeadCamera {
    /// Width and height, px.
    pub size_px: [u32; 2],
    /// Bits, offset and gain of its sensor, if the file gives them.
    pub sensor: Option<Sensor>,
}

/// Largest relative difference between the camera's gain and the calibrated one: makers state the gain to a few per cent.
const GAIN_TOLERANCE: f64 = 0.1;
/// Largest difference of the offset from the calibrated one, DN: it drifts with temperature.
const OFFSET_TOLERANCE_DN: f64 = 20.0;

impl HeadCamera {
    /// Compares the properties that the camera reports with the head file; properties that it does not report are not compared.
    fn fits(&self, word: &Ready) -> Result<(), CameraError> {
        let differs = |of: &'static str, got: String, expected: String| CameraError::Differs {
            model: word.model(),
            of,
            got,
            expected,
        };
        let size_px = [word.width_px, word.height_px];
        if size_px != self.size_px {
            let words = |[width, height]: [u32; 2]| format!("{width} x {height}");
            return Err(differs("px", words(size_px), words(self.size_px)));
        }
        let Some(sensor) = self.sensor else {
            return Ok(());
        };
        if word.bits != 0 && word.bits != sensor.bits {
            let (got, expected) = (word.bits.to_string(), sensor.bits.to_string());
            return Err(differs("bits", got, expected));
        }
        let (gain, calibrated) = (word.gain_e_per_dn, sensor.gain_e_per_dn);
        if (gain - calibrated).abs() > GAIN_TOLERANCE * calibrated {
            return Err(differs(
                "electrons per count",
                format!("{gain:.3}"),
                format!("{calibrated:.3}"),
            ));
        }
        let (offset, calibrated) = (word.offset_dn, sensor.offset_dn);
        if (offset - calibrated).abs() > OFFSET_TOLERANCE_DN {
            return Err(differs(
                "counts in the dark",
                format!("{offset:.1}"),
                format!("{calibrated:.1}"),
            ));
        }
        Ok(())
    }
}

/// The thread's state.
pub struct Recorder<'a, S: FrameSource> {
    source: S,
    settings: RecorderSettings,
    planned: Vec<PlannedFrame>,
    orders: Receiver<Order>,
    events: tokio::sync::mpsc::UnboundedSender<Recorded>,
    fresh: Box<dyn Fn() -> ViewSums + 'a>,
    spare: Vec<ViewSums>,
    arm: Option<Arm>,
    /// Frames since arming.
    arrived: u32,
    open: Option<CapturedView>,
    saver: Option<Saver>,
    /// Where pixel levels are counted, if they are.
    counted: Option<Option<ImageCircle>>,
    /// Sessions before this one, the latest last, because their frames may still arrive late.
    earlier: VecDeque<u32>,
}

impl<'a, S: FrameSource> Recorder<'a, S> {
    /// A recorder of frames from `source`; `planned` are a view's frames in their order, `fresh` makes empty sums.
    pub fn new(
        source: S,
        settings: RecorderSettings,
        planned: Vec<PlannedFrame>,
        orders: Receiver<Order>,
        events: tokio::sync::mpsc::UnboundedSender<Recorded>,
        fresh: impl Fn() -> ViewSums + 'a,
    ) -> Self {
        let spare = vec![fresh(), fresh()];
        Self {
            source,
            settings,
            planned,
            orders,
            events,
            fresh: Box::new(fresh),
            spare,
            arm: None,
            arrived: 0,
            open: None,
            saver: None,
            counted: None,
            earlier: VecDeque::new(),
        }
    }

    /// Runs until the job closes its channel.
    pub fn run(mut self) {
        loop {
            match self.orders.try_recv() {
                Ok(Order::Arm(arm)) => self.start(arm),
                Ok(Order::Close) => {
                    self.drain();
                    self.close();
                    let _ = self.events.send(Recorded::Closed);
                }
                Ok(Order::Recycle(mut sums)) => {
                    sums.reset();
                    self.spare.push(sums);
                }
                Ok(Order::Save(saver)) => self.saver = Some(saver),
                Ok(Order::CountLevels(circle)) => self.counted = Some(circle),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return,
            }
            match self.source.receive(PATIENCE) {
                Ok(Some(frame)) => self.add(frame),
                Ok(None) => {}
                Err(error) => self.fail(error.into()),
            }
        }
    }

    fn start(&mut self, arm: Arm) {
        self.close();
        if let Some(before) = self.arm.replace(arm) {
            if self.earlier.len() == EARLIER_SESSIONS {
                self.earlier.pop_front();
            }
            self.earlier.push_back(before.session);
        }
        self.arrived = 0;
        let armed = self.arm_camera(arm);
        let _ = self.events.send(Recorded::Armed(armed));
    }

    /// Sends the plan to the camera and waits until it reports that it is armed and its queue is empty. Frames that arrive
    /// meanwhile belong to an earlier session.
    fn arm_camera(&mut self, arm: Arm) -> Result<(), CameraError> {
        let unreachable = |error: ReceiveError| CameraError::Unreachable {
            reason: error.to_string(),
        };
        self.source.arm(arm).map_err(unreachable)?;
        let end = Instant::now() + CAMERA_PATIENCE;
        let mut heard = None;
        while Instant::now() < end {
            if let Some(word) = self.source.ready().map_err(unreachable)? {
                heard = Some(word.session);
                if word.session == arm.session {
                    return self.settings.camera.fits(&word);
                }
            }
            match self.source.receive(PATIENCE) {
                Ok(late) => drop(late),
                Err(error) => tracing::warn!(%error, "a frame before arming"),
            }
        }
        Err(CameraError::NotReady {
            patience_ms: CAMERA_PATIENCE.as_millis(),
            state: match heard {
                Some(0) => {
                    "its process is there, but cannot arm it, and says why on standard error"
                }
                Some(_) => "its process is there, but armed for another capture",
                None => "its process has not come, or has ended",
            },
        })
    }

    fn add(&mut self, frame: S::Frame) {
        let header = *frame.header();
        let Some(arm) = self.arm else { return }; // nobody asked for this frame
        if header.session != arm.session && self.earlier.contains(&header.session) {
            tracing::debug!(header.session, header.counter, "a late frame is dropped");
            return;
        }
        self.arrived += 1;
        if self.arrived > arm.frames() + 1 {
            return; // the first one too many has already spoiled the capture
        }
        if self
            .open
            .as_ref()
            .is_some_and(|open| open.view != header.label.view)
        {
            self.close();
        }
        if self.open.is_none() {
            let sums = self.spare.pop().unwrap_or_else(|| (self.fresh)());
            self.open = Some(CapturedView {
                view: header.label.view,
                sums,
                frames: Vec::with_capacity(self.planned.len()),
                handover_ns: Vec::with_capacity(self.planned.len()),
                problem: None,
                saved: self.saver.as_mut().map(Saver::begin),
                levels: self.counted.map(|_| ViewLevels::default()),
            });
        }
        let settings = self.settings;
        let Some(open) = self.open.as_mut() else {
            return;
        };
        open.frames.push(header);
        open.handover_ns.push(
            frame
                .received_monotonic_ns()
                .saturating_sub(header.published_monotonic_ns),
        );
        if open.problem.is_none() {
            open.problem = match self.planned.get(usize::from(header.label.in_view)) {
                _ if header.session != arm.session => Some(ViewError::Session {
                    got: header.session,
                    expected: arm.session,
                }),
                None => Some(ViewError::Incomplete {
                    got: open.frames.len(),
                    planned: self.planned.len(),
                }),
                Some(&planned) => {
                    if let (Some(circle), Some(levels)) = (&self.counted, &mut open.levels) {
                        levels.count(view_of(&frame), planned.kind, circle.as_ref());
                    }
                    let added = open.sums.add(view_of(&frame), planned);
                    added.err().map(ViewError::from)
                }
            };
        }
        if let (Some(saver), Some(saved)) = (&mut self.saver, &mut open.saved) {
            saver.add(saved, &frame);
        }
        if (header.label.exposure, header.label.pattern)
            == (settings.keepsake.exposure, settings.keepsake.pattern)
            && header.label.view < MOST_PICTURES
        {
            // While the view's last frames are exposed.
            let shown = picture(view_of(&frame), settings);
            let _ = self
                .events
                .send(Recorded::Picture(header.label.view, shown));
        }
        if open.frames.len() == self.planned.len() && open.problem.is_none() {
            self.close();
        }
    }

    /// Takes the frames that are still on their way, and checks whether more arrive than were triggered.
    fn drain(&mut self) {
        let planned = self.arm.map_or(0, |arm| arm.frames());
        let mut end = Instant::now() + DRAINING;
        while Instant::now() < end {
            let before = self.arrived;
            let patience = if self.arrived < planned {
                LAST_FRAME_PATIENCE
            } else {
                EXTRA_FRAME_PATIENCE
            };
            match self.source.receive(patience) {
                Ok(Some(frame)) => self.add(frame),
                Ok(None) => return,
                Err(error) => self.fail(error.into()),
            }
            if before < self.arrived && self.arrived <= planned {
                end = Instant::now() + DRAINING;
            }
        }
    }

    /// Hands the open view to the job.
    fn close(&mut self) {
        let Some(mut view) = self.open.take() else {
            return;
        };
        if view.problem.is_none() && view.frames.len() < self.planned.len() {
            view.problem = Some(ViewError::Incomplete {
                got: view.frames.len(),
                planned: self.planned.len(),
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
}

/// A frame as an image in shared memory, without a copy.
fn view_of(frame: &impl BorrowedFrame) -> FrameView<'_> {
    let header = frame.header();
    FrameView {
        pixels: frame.pixels(),
        width: header.width_px as usize,
        height: header.height_px as usize,
        stride: header.stride_px as usize,
    }
}

/// An 8-bit grey picture of the lit part of a frame, which is read in place.
fn picture(view: FrameView<'_>, settings: RecorderSettings) -> Picture {
    let row = |y: usize| {
        view.pixels
            .get(y * view.stride..)
            .and_then(|rest| rest.get(..view.width))
            .unwrap_or_default()
    };
    let lit = |dn: u16| f64::from(dn) > settings.lit_dn;
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    let mut histogram = vec![0_usize; usize::from(settings.full_scale_dn) + 1];
    for y in 0..view.height {
        for (x, &dn) in row(y).iter().enumerate().filter(|&(_, &dn)| lit(dn)) {
            low = [low[0].min(x), low[1].min(y)];
            high = [high[0].max(x + 1), high[1].max(y + 1)];
            histogram[usize::from(dn.min(settings.full_scale_dn))] += 1;
        }
    }
    if low[0] > high[0] {
        return Picture {
            width: 1,
            height: 1,
            grey: vec![0],
        };
    }
    // White is the count that one pixel in a thousand exceeds, so that highlights and hot pixels do not darken the rest.
    let mut brighter = histogram.iter().sum::<usize>() / 1000;
    let white = histogram.iter().rposition(|&count| {
        let here = brighter < count;
        brighter = brighter.saturating_sub(count);
        here
    });
    let black = settings.lit_dn.min(f64::from(settings.full_scale_dn));
    let span = (white.unwrap_or(0) as f64 - black).max(1.0);
    let grey = |dn: u16| ((f64::from(dn) - black) / span * 255.0).clamp(0.0, 255.0) as u8;
    let grey = (low[1]..high[1])
        .flat_map(|y| row(y)[low[0]..high[0]].iter().map(|&dn| grey(dn)))
        .collect();
    Picture {
        width: high[0] - low[0],
        height: high[1] - low[1],
        grey,
    }
}

/// Sender of orders, kept by the job.
pub type Orders = Sender<Order>;

#[cfg(test)]
mod tests;
