//! The camera process: renders each exposure into shared memory and hands it over when its readout ends.
//!
//! Rendering runs on its own thread, parallel to the simulation. A view is prepared as soon as the destination of the stages is
//! known, a frame as soon as its exposure has ended. If one of them is not finished when the camera should hand the frame over,
//! virtual time stops until it is, so that the bench's computing time never counts as the instrument's. The time for which it
//! stopped is reported.
//!
//! A [`FrameFault`] makes the camera lose, repeat or insert a frame, or send one that says what is not so.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use flankscope_frames::{
    FrameHeader, FrameLabel, FrameSink, FrameSlot, Labels, Ready, SealedFrame, monotonic_ns,
};
use flankscope_sim::{Hold, Remote};
use nalgebra::Isometry3;

use crate::ageing::Ageing;
use crate::arm::Arm;
use crate::devices::{Exposure, ExposureSink, TruePose};
use crate::truth::Truth;
use crate::world::{PatternSpec, ViewState, World};

/// A camera fault at one frame of every capture, or of the first capture only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameFault {
    pub kind: FrameFaultKind,
    /// Index of the frame since arming, from 0.
    pub frame: u32,
    /// Only in the first capture.
    pub once: bool,
}

/// Kinds of camera faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameFaultKind {
    /// The frame is exposed but never arrives.
    Lose,
    /// The frame arrives twice.
    Repeat,
    /// The camera exposes once more than it was triggered.
    Extra,
    /// The frame carries the number of a session that never was.
    Foreign,
    /// All times of the frame are the largest that its header can state.
    Timeless,
    /// The pixels are written again after the checksum was made.
    Rewritten,
}

impl std::str::FromStr for FrameFault {
    type Err = anyhow::Error;

    /// A kind and a frame, such as `lose:12`, with `:once` for the first capture only.
    fn from_str(text: &str) -> anyhow::Result<Self> {
        let mut words = text.split(':');
        let kind = match words.next() {
            Some("lose") => FrameFaultKind::Lose,
            Some("repeat") => FrameFaultKind::Repeat,
            Some("extra") => FrameFaultKind::Extra,
            Some("foreign") => FrameFaultKind::Foreign,
            Some("timeless") => FrameFaultKind::Timeless,
            Some("rewritten") => FrameFaultKind::Rewritten,
            _ => anyhow::bail!(
                "frame fault {text:?}: lose, repeat, extra, foreign, timeless or rewritten is needed, for example lose:12"
            ),
        };
        let frame = words.next().unwrap_or_default();
        let frame = frame
            .parse()
            .map_err(|_| anyhow::anyhow!("frame fault {text:?}: {frame:?} is no frame number"))?;
        let once = match (words.next(), words.next()) {
            (None, _) => false,
            (Some("once"), None) => true,
            _ => anyhow::bail!("frame fault {text:?}: only :once may follow"),
        };
        Ok(Self { kind, frame, once })
    }
}

/// Faults of camera and head.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Troubles {
    /// A lost, repeated or inserted frame.
    pub fault: Option<FrameFault>,
    /// Shift of the cores' image along the rows while the head warms up, px.
    pub core_drift_px: f64,
    /// Shift of the cores' image along the rows when the head is turned by a quarter of a turn, as the bundles twist, px.
    pub twist_px: f64,
    /// Share of the light that bent bundles lose when the head is turned by half a turn.
    pub twist_loss_ratio: f64,
}

/// Pose of a head that an arm carries.
#[derive(Debug)]
struct Carried {
    arm: Arm,
    /// Latest pose.
    tool_from_camera: Option<Isometry3<f64>>,
}

/// Prepared views that are kept: the present one and the next.
const VIEWS_KEPT: usize = 2;
/// Interval at which an idle camera checks whether it was armed.
const POLL: Duration = Duration::from_millis(1);

enum Job {
    Prepare {
        rotation_rad: f64,
        vertical_mm: f64,
    },
    Expose {
        exposure: Exposure,
        ended_monotonic_ns: u64,
    },
    /// The press began a stroke.
    Cycled(u32),
    /// The liquid lens was set to this voltage.
    Focused(Option<u16>),
    HandOver {
        counter: u32,
        _hold: Option<Hold>,
    },
    /// Ends the thread, which sends back the true values and its world.
    Finish(Sender<(Truth, Box<World>)>),
}

/// The simulation's side of the camera.
pub struct Camera {
    jobs: Sender<Job>,
    remote: Option<Remote>,
}

/// The camera's thread.
pub struct CameraThread {
    jobs: Sender<Job>,
    thread: Option<JoinHandle<()>>,
}

/// Lowers the priority of the calling thread; for threads that only compute.
pub(crate) fn give_way() {
    // If the system refuses, the thread runs at normal priority.
    let _ = rustix::process::nice(10);
}

/// Starts the camera thread for a world; frames go to the sink that `open` returns. With `gives_way`, it runs at low priority.
pub fn start<S: FrameSink>(
    world: World,
    patterns: Vec<PatternSpec>,
    ageing: Ageing,
    troubles: Troubles,
    arm: Option<Arm>,
    open: impl FnOnce() -> anyhow::Result<S> + Send + 'static,
    gives_way: bool,
) -> anyhow::Result<(CameraThread, Camera)> {
    let (jobs, queue) = channel();
    let (opened_sender, opened) = channel();
    let thread = std::thread::Builder::new()
        .name("camera".into())
        .spawn(move || {
            if gives_way {
                give_way();
            }
            // Shared-memory ports must stay on the thread that created them.
            match open() {
                Ok(sender) => {
                    let _ = opened_sender.send(Ok(()));
                    FrameRenderer::new(world, patterns, ageing, troubles, arm, sender).run(&queue);
                }
                Err(error) => drop(opened_sender.send(Err(error))),
            }
        })?;
    opened.recv()??;
    let camera = Camera {
        jobs: jobs.clone(),
        remote: None,
    };
    Ok((
        CameraThread {
            jobs,
            thread: Some(thread),
        },
        camera,
    ))
}

impl CameraThread {
    /// Ends the thread and returns the true poses of all frames, and the final world.
    ///
    /// # Errors
    /// The thread has ended already.
    pub fn finish(mut self) -> anyhow::Result<(Truth, Box<World>)> {
        let (sender, outcome) = channel();
        self.jobs.send(Job::Finish(sender))?;
        let outcome = outcome.recv()?;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        Ok(outcome)
    }
}

impl ExposureSink for Camera {
    fn attach(&mut self, remote: Remote) {
        self.remote = Some(remote);
    }

    fn moving_to(
        &mut self,
        TruePose {
            rotation_rad,
            vertical_mm,
        }: TruePose,
    ) {
        let _ = self.jobs.send(Job::Prepare {
            rotation_rad,
            vertical_mm,
        });
    }

    fn exposed(&mut self, exposure: Exposure) {
        let _ = self.jobs.send(Job::Expose {
            exposure,
            ended_monotonic_ns: monotonic_ns(),
        });
    }

    fn cycled(&mut self, count: u32) {
        let _ = self.jobs.send(Job::Cycled(count));
    }

    fn focused(&mut self, counts: Option<u16>) {
        let _ = self.jobs.send(Job::Focused(counts));
    }

    fn read_out(&mut self, counter: u32) {
        let _ = self.jobs.send(Job::HandOver {
            counter,
            _hold: self.remote.as_ref().map(Remote::hold),
        });
    }
}

/// State of the thread.
struct FrameRenderer<S: FrameSink> {
    world: World,
    patterns: Vec<PatternSpec>,
    sender: S,
    views: VecDeque<([u64; 2], ViewState)>,
    ready: VecDeque<(u32, SealedFrame<S::Slot>)>,
    labels: Labels,
    ageing: Ageing,
    /// Strokes of the press so far, and the number for which the world's die is valid.
    cycles: [u32; 2],
    /// Present setting of the liquid lens, and the one for which the world is valid.
    focus: [Option<u16>; 2],
    troubles: Troubles,
    /// Source of the pose, if the stages do not carry the head.
    carried: Option<Carried>,
    /// Number of captures armed so far.
    captures: u32,
    /// Number of frames exposed without a trigger.
    extra: u32,
    /// Index of the next frame.
    next: u32,
    /// Number of views prepared so far.
    prepared: u32,
    truth: Truth,
}

/// Time constant of warming up, in views: the drift has reached two thirds of its final value then.
const VIEWS_OF_WARMING: f64 = 3.0;

impl<S: FrameSink> FrameRenderer<S> {
    fn new(
        world: World,
        patterns: Vec<PatternSpec>,
        ageing: Ageing,
        troubles: Troubles,
        arm: Option<Arm>,
        sender: S,
    ) -> Self {
        Self {
            world,
            patterns,
            sender,
            views: VecDeque::new(),
            ready: VecDeque::new(),
            labels: Labels::default(),
            ageing,
            cycles: [0; 2],
            focus: [None; 2],
            troubles,
            carried: arm.map(|arm| Carried {
                arm,
                tool_from_camera: None,
            }),
            captures: 0,
            extra: 0,
            next: 0,
            prepared: 0,
            truth: Truth::default(),
        }
    }

    /// Sends the camera's identity and the armed session to the host.
    fn speak(&mut self, session: u32) {
        let [width, height] = self.world.size_px();
        let sensor = self.world.sensor();
        let word = Ready {
            session,
            counter: self.next,
            width_px: width as u32,
            height_px: height as u32,
            bits: sensor.bits,
            offset_dn: sensor.offset_dn,
            gain_e_per_dn: sensor.gain_e_per_dn(),
            model: Ready::text("simulated camera"),
            link: Ready::text("shared memory"),
            ..Ready::default()
        };
        if let Err(error) = self.sender.ready(word) {
            eprintln!("bench: {error}");
        }
    }

    /// Handles an arming. Every exposure of the previous capture is rendered by now; frames that were not read out are dropped.
    fn obey(&mut self) {
        if let Some(arm) = self.sender.armed() {
            self.ready.clear();
            self.labels.arm(arm);
            self.captures += 1;
            self.speak(arm.session);
        }
    }

    fn run(mut self, queue: &Receiver<Job>) {
        self.speak(0);
        // The stages start to move while the last frame of a view is still read out, so that frame is handled first.
        let mut announced = None;
        loop {
            let job = match queue.try_recv() {
                Ok(job) => job,
                Err(TryRecvError::Disconnected) => return,
                Err(TryRecvError::Empty) => {
                    self.obey();
                    if self.ready.is_empty()
                        && let Some((rotation_rad, vertical_mm)) = announced.take()
                        // Nothing is rendered for a retracted head.
                        && self.world.sees_die(vertical_mm)
                    {
                        self.prepare(rotation_rad, vertical_mm);
                        continue;
                    }
                    match queue.recv_timeout(POLL) {
                        Ok(job) => job,
                        Err(RecvTimeoutError::Timeout) => continue,
                        Err(RecvTimeoutError::Disconnected) => return,
                    }
                }
            };
            match job {
                Job::Prepare {
                    rotation_rad,
                    vertical_mm,
                } => announced = Some((rotation_rad, vertical_mm)),
                Job::Expose {
                    exposure,
                    ended_monotonic_ns,
                } => self.develop(&exposure, ended_monotonic_ns),
                Job::Cycled(count) => self.cycles[0] = count,
                Job::Focused(counts) => self.focus[0] = counts,
                Job::HandOver { counter, _hold } => self.hand_over(counter),
                Job::Finish(outcome) => {
                    return drop(outcome.send((self.truth, Box::new(self.world))));
                }
            }
        }
    }

    fn prepare(&mut self, rotation_rad: f64, vertical_mm: f64) {
        self.age();
        self.refocus();
        let key = [rotation_rad.to_bits(), vertical_mm.to_bits()];
        if self.views.iter().any(|(known, _)| *known == key) {
            return;
        }
        self.shift_and_dim(rotation_rad);
        match self
            .world
            .prepare(rotation_rad, vertical_mm, &self.patterns)
        {
            Ok(view) => {
                self.views.truncate(VIEWS_KEPT - 1);
                self.views.push_front((key, view));
            }
            Err(error) => eprintln!("bench: view at {rotation_rad} rad, {vertical_mm} mm: {error}"),
        }
    }

    /// Shifts the cores' image for a cold head in a warm die, with an exponential approach to the final value, and for bundles that
    /// twist and bend as the head turns: by a sine, and a loss that grows to half a turn.
    fn shift_and_dim(&mut self, rotation_rad: f64) {
        let Troubles {
            core_drift_px,
            twist_px,
            twist_loss_ratio,
            ..
        } = self.troubles;
        let share = 1.0 - (-f64::from(self.prepared) / VIEWS_OF_WARMING).exp();
        let shift_px = share * core_drift_px + twist_px * rotation_rad.sin();
        let light_ratio = 1.0 - 0.5 * twist_loss_ratio * (1.0 - rotation_rad.cos());
        let shifted = match core_drift_px == 0.0 && twist_px == 0.0 {
            true => Ok(()),
            false => self.world.shift_cores(shift_px),
        };
        if let Err(error) = shifted.and_then(|()| self.world.dim(light_ratio)) {
            eprintln!("bench: {error}");
        }
        self.prepared += 1;
    }

    /// Updates the die's wear to the strokes since the last view.
    fn age(&mut self) {
        let [cycles, shown] = self.cycles;
        if cycles == shown || self.ageing.per_cycle.is_empty() {
            return;
        }
        self.cycles[1] = cycles;
        self.views.clear();
        if let Err(error) = self.world.wear_to(&self.ageing.after(cycles)) {
            eprintln!("bench: after {cycles} cycles: {error}");
        }
    }

    /// Updates the lens to the controller's setting since the last view.
    fn refocus(&mut self) {
        let [given, shown] = self.focus;
        if given == shown {
            return;
        }
        self.focus[1] = given;
        self.views.clear();
        if let Err(error) = self.world.focus(given) {
            eprintln!("bench: lens at {given:?} counts: {error}");
        }
    }

    /// The exposure at the arm's pose, if an arm carries the head. Angle and height of the camera replace those of the stages.
    fn carried(&mut self, exposure: &Exposure) -> anyhow::Result<Exposure> {
        let Some(carried) = &mut self.carried else {
            return Ok(*exposure);
        };
        let pose = carried.arm.tool_from_camera()?;
        if carried.tool_from_camera != Some(pose) {
            carried.tool_from_camera = Some(pose);
            self.views.clear();
            self.world.carry(pose);
        }
        let place = pose.translation.vector;
        Ok(Exposure {
            rotation_rad: place.y.atan2(place.x),
            vertical_mm: place.z,
            ..*exposure
        })
    }

    /// Converts an exposure to frames: one, unless a fault is due.
    fn develop(&mut self, exposure: &Exposure, ended_monotonic_ns: u64) {
        let struck = |fault: &FrameFault| {
            fault.frame == self.labels.exposed() && !(fault.once && self.captures > 1)
        };
        let fault = self.troubles.fault.filter(struck).map(|fault| fault.kind);
        self.next = exposure.counter + self.extra + 1;
        let labelled = self.labels.take();
        let frame = self.expose(exposure, labelled, ended_monotonic_ns, fault);
        match fault {
            Some(FrameFaultKind::Lose) => {}
            Some(FrameFaultKind::Repeat) => {
                self.ready.extend(frame);
                let again = self.expose(exposure, labelled, ended_monotonic_ns, None);
                self.ready.extend(again);
            }
            Some(FrameFaultKind::Extra) => {
                self.ready.extend(frame);
                self.extra += 1;
                self.next += 1;
                let labelled = self.labels.take();
                let extra = self.expose(exposure, labelled, ended_monotonic_ns, None);
                self.ready.extend(extra);
            }
            // What is wrong lies in the frame itself.
            None
            | Some(
                FrameFaultKind::Foreign | FrameFaultKind::Timeless | FrameFaultKind::Rewritten,
            ) => self.ready.extend(frame),
        }
    }

    /// Renders an exposure into a slot of the shared memory, under its session and label.
    fn expose(
        &mut self,
        exposure: &Exposure,
        (session, label): (u32, FrameLabel),
        ended_monotonic_ns: u64,
        fault: Option<FrameFaultKind>,
    ) -> Option<(u32, SealedFrame<S::Slot>)> {
        let exposure = match self.carried(exposure) {
            Ok(exposure) => exposure,
            Err(error) => {
                eprintln!("bench: {error:#}");
                return None;
            }
        };
        let [width, height] = self.world.size_px();
        let frame = match self.sender.loan(width * height, exposure.counter) {
            Ok(frame) => frame,
            Err(error) => {
                eprintln!("bench: {error}");
                return None;
            }
        };
        let mut header = FrameHeader {
            session,
            counter: exposure.counter + self.extra,
            label,
            width_px: width as u32,
            height_px: height as u32,
            stride_px: width as u32,
            measured: FrameHeader::ALL_MEASURED,
            exposure_start_us: exposure.start_us,
            exposure_end_us: exposure.end_us,
            exposure_end_monotonic_ns: ended_monotonic_ns,
            ..FrameHeader::default()
        };
        self.prepare(exposure.rotation_rad, exposure.vertical_mm);
        let mut frame = self.render(&exposure, frame)?;
        match fault {
            Some(FrameFaultKind::Foreign) => header.session = !session,
            Some(FrameFaultKind::Timeless) => {
                header.exposure_start_us = u64::MAX;
                header.exposure_end_us = u64::MAX;
                header.exposure_end_monotonic_ns = u64::MAX;
            }
            _ => {}
        }
        let first = frame.pixels().as_mut_ptr();
        let frame = frame.seal(header);
        if fault == Some(FrameFaultKind::Rewritten) {
            // SAFETY: the slot's memory stays where it is while the slot is moved, its size was checked when it was loaned, and
            // nothing else of this process refers to its pixels.
            unsafe { *first ^= 1 };
        }
        Some((exposure.counter, frame))
    }

    fn render(&mut self, exposure: &Exposure, mut frame: S::Slot) -> Option<S::Slot> {
        let key = [
            exposure.rotation_rad.to_bits(),
            exposure.vertical_mm.to_bits(),
        ];
        let (_, view) = self.views.iter().find(|(known, _)| *known == key)?;
        let exposure_us = u32::try_from(exposure.end_us - exposure.start_us).unwrap_or(u32::MAX);
        let rendered = self.world.expose(
            view,
            exposure.shown,
            exposure_us,
            exposure.counter,
            frame.pixels(),
        );
        if let Err(error) = rendered {
            eprintln!("bench: frame {}: {error}", exposure.counter);
            return None;
        }
        self.truth.photographed(exposure, self.world.truth(view));
        Some(frame)
    }

    /// Hands over every frame of an exposure, and drops those that were not triggered.
    fn hand_over(&mut self, counter: u32) {
        while let Some((number, frame)) = self.ready.pop_front_if(|(number, _)| *number <= counter)
        {
            if number == counter
                && let Err(error) = self.sender.send(frame)
            {
                eprintln!("bench: {error}");
            }
        }
    }
}
