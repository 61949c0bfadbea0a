//! Camera in trigger-width mode: exposed while the trigger is high; readout overlaps with the next exposure.

use super::{DeviceFault, World};
use embassy_futures::select::{Either, select};
use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::digital::Wait;
use flankscope_protocol::Projector;
use flankscope_sim::Board;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// Times of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CameraTiming {
    /// Trigger edge to exposure edge: an opto-coupled input takes a few microseconds.
    pub latency_us: u64,
    /// Exposure end to the last row: 1920x1200 at 16 bit and 80 frames per second over USB 3.
    pub readout_us: u64,
    /// Exposures begin and end between two lines of the sensor, so they last whole lines. 1200 lines are read out in 12.5 ms,
    /// i.e. 10 µs each, which is the order in data sheets of such sensors.
    pub line_us: u64,
}

impl Default for CameraTiming {
    fn default() -> Self {
        Self {
            latency_us: 5,
            readout_us: 12_500,
            line_us: 10,
        }
    }
}

/// One exposed frame, with all data that its picture depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// Frames since the camera was switched on, counted from 0.
    pub counter: u32,
    /// Start of the exposure, by the controller's clock.
    pub start_us: u64,
    /// End of the exposure, by the same clock: whole lines after its start.
    pub end_us: u64,
    /// DMD pattern index of each projector, 0 is black; `None` if its LED was not on during the whole exposure.
    pub shown: [Option<u16>; 2],
    /// True angle of the rotary stage, including its error.
    pub rotation_rad: f64,
    /// True position of the vertical stage, including its error.
    pub vertical_mm: f64,
    /// End of the readout, virtual time.
    pub readout_done_us: u64,
}

/// Why a triggered frame does not exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lost {
    /// Its exposure ended while the previous frame was still being read out.
    Readout,
}

/// Receives the camera's exposures. Called on the simulation's thread, so long computations must run on other threads.
pub trait ExposureSink {
    /// Called before the simulation starts; `remote` can stop its time.
    fn attach(&mut self, remote: flankscope_sim::Remote) {
        let _ = remote;
    }
    /// The stages start to move and will stop at this true pose: allows its view to be prepared.
    fn moving_to(&mut self, pose: super::TruePose) {
        let _ = pose;
    }
    /// The liquid lens was set to this voltage, or switched off.
    fn focused(&mut self, counts: Option<u16>) {
        let _ = counts;
    }
    /// A frame was exposed; it is not read out yet.
    fn exposed(&mut self, exposure: Exposure);
    /// The frame with this counter is read out and must be handed over.
    fn read_out(&mut self, counter: u32) {
        let _ = counter;
    }
    /// The press began its stroke number `count`, from 1.
    fn cycled(&mut self, count: u32) {
        let _ = count;
    }
    /// A triggered frame was lost; its counter value is skipped.
    fn lost(&mut self, counter: u32, why: Lost) {
        let _ = (counter, why);
    }
}

pub(super) async fn run<S: ExposureSink>(
    board: Board,
    timing: CameraTiming,
    world: Rc<World>,
    sink: Rc<RefCell<S>>,
) {
    let (mut trigger, ready, exposing) = (
        board.camera_trigger,
        board.camera_ready,
        board.camera_exposing,
    );
    let latency = Duration::from_micros(timing.latency_us);
    let mut counter = 0;
    let mut reading: VecDeque<(u32, u64)> = VecDeque::new();
    // End of the latest readout, by the controller's clock, which may differ from ours.
    let mut read_out_us = 0;
    ready.set(true);
    loop {
        // Idle: waits for a trigger; meanwhile hands over frames that are read out.
        until(&mut trigger, true, &mut reading, &sink).await;
        if world.faults.spoils(DeviceFault::CameraDeaf) {
            until(&mut trigger, false, &mut reading, &sink).await;
            continue;
        }
        ready.set(false);
        Timer::after(latency).await;
        exposing.set(true);
        let start_us = trigger.changed_us() + timing.latency_us;
        let begun = world.shown();
        until(&mut trigger, false, &mut reading, &sink).await;
        Timer::after(latency).await;
        if world.faults.spoils(DeviceFault::CameraStuck) {
            return core::future::pending().await;
        }
        exposing.set(false);
        let closed_us = trigger.changed_us() + timing.latency_us;
        let width_us = closed_us.saturating_sub(start_us);
        let end_us = start_us + width_us - width_us % timing.line_us.max(1);
        let ended_us = now_us();
        let readout_done_us = ended_us + timing.readout_us;
        if closed_us < read_out_us {
            sink.borrow_mut().lost(counter, Lost::Readout);
        } else {
            read_out_us = closed_us + timing.readout_us;
            // By that clock, all earlier frames have been read out.
            for (counter, _) in reading.drain(..) {
                sink.borrow_mut().read_out(counter);
            }
            let pose = world.stage.borrow().true_pose(ended_us);
            sink.borrow_mut().exposed(Exposure {
                counter,
                start_us,
                end_us,
                shown: world.still_shown(begun),
                rotation_rad: pose.rotation_rad,
                vertical_mm: pose.vertical_mm,
                readout_done_us,
            });
            reading.push_back((counter, readout_done_us));
        }
        counter += 1;
        if world.faults.spoils(DeviceFault::CameraExtraTrigger) {
            // Late enough that the previous frame is read out.
            exposing.set(true);
            let readout = Duration::from_micros(timing.readout_us);
            Timer::after(readout).await;
            exposing.set(false);
            for (counter, _) in reading.drain(..) {
                sink.borrow_mut().read_out(counter);
            }
            let pose = world.stage.borrow().true_pose(now_us());
            read_out_us = closed_us + 2 * timing.readout_us;
            sink.borrow_mut().exposed(Exposure {
                counter,
                start_us: closed_us,
                end_us: closed_us + timing.readout_us,
                shown: world.still_shown(begun),
                rotation_rad: pose.rotation_rad,
                vertical_mm: pose.vertical_mm,
                readout_done_us: now_us() + timing.readout_us,
            });
            reading.push_back((counter, now_us() + timing.readout_us));
            counter += 1;
        }
        if world.faults.spoils(DeviceFault::CameraNotReady) {
            return core::future::pending().await;
        }
        ready.set(true);
    }
}

impl World {
    /// Pattern that each projector shows now.
    fn shown(&self) -> [Option<u16>; 2] {
        Projector::ALL.map(|of| {
            let is_lit = self.lit[of as usize].get();
            is_lit.then(|| self.displayed[of as usize].get())
        })
    }

    /// Patterns shown at the beginning of an exposure whose light is still on.
    fn still_shown(&self, begun: [Option<u16>; 2]) -> [Option<u16>; 2] {
        let [first, second] = &self.lit;
        let [one, two] = begun;
        [one.filter(|_| first.get()), two.filter(|_| second.get())]
    }
}

/// Waits for a trigger level; readouts that end meanwhile are handed over on time.
async fn until<S: ExposureSink>(
    trigger: &mut flankscope_sim::Line,
    level: bool,
    reading: &mut VecDeque<(u32, u64)>,
    sink: &Rc<RefCell<S>>,
) {
    loop {
        let readout = async {
            match reading.front() {
                Some(&(_, done_us)) => Timer::at(Instant::from_micros(done_us)).await,
                None => core::future::pending().await,
            }
        };
        let edge = async {
            let Ok(()) = if level {
                trigger.wait_for_high().await
            } else {
                trigger.wait_for_low().await
            };
        };
        match select(readout, edge).await {
            Either::First(()) => {
                if let Some((counter, _)) = reading.pop_front() {
                    sink.borrow_mut().read_out(counter);
                }
            }
            Either::Second(()) => return,
        }
    }
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}
