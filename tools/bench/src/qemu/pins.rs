//! The emulated controller's connection to the wiring: three sockets for two UARTs and the pins.

use std::cell::RefCell;
use std::io::{self, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::rc::Rc;
use std::sync::mpsc;

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::channel::Channel;
use embedded_hal_async::digital::Wait;
use embedded_io_async::Read;
use flankscope_controller::devices::{CurrentSetting, PatternPort};
use flankscope_controller::liveness::Task;
use flankscope_protocol::Milliamps;
use flankscope_sim::{Board, Line, Port, Remote, Sim, Wiring};

use super::machine::Machine;
use flankscope_pin_wire::{PinDecoder, PinMessage, Subject, injection, input_bytes};

/// Every message that came from the image, in order.
type Trace = Rc<RefCell<Vec<PinMessage>>>;

/// An emulated controller, connected to the wiring.
pub struct Emulated {
    trace: Trace,
    pins: Port,
}

impl Emulated {
    /// Every message that came from the image so far, in order.
    pub fn trace(&self) -> Vec<PinMessage> {
        self.trace.borrow().clone()
    }

    /// Orders the image to fail; only an image built for this obeys.
    pub fn inject(&self, fault: FaultInjection) {
        self.pins
            .send(&input_bytes(Subject::InjectFault, fault.number()));
    }
}

/// Failures of the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultInjection {
    /// This task is never polled again.
    Hang(Task),
    /// This task loops without end.
    Spin(Task),
    /// The program panics.
    Panic,
    /// The processor executes an undefined instruction.
    Fault,
}

impl FaultInjection {
    fn number(self) -> u8 {
        match self {
            Self::Hang(task) => injection::HANG | task as u8,
            Self::Spin(task) => injection::SPIN | task as u8,
            Self::Panic => injection::PANIC,
            Self::Fault => injection::FAULT,
        }
    }
}

/// Connects an emulated controller to the wiring. The machine must be kept as long as the simulation runs.
///
/// # Errors
/// The system has no thread or no file descriptor left.
pub fn join(sim: &Sim, wiring: &Wiring, machine: &Machine) -> io::Result<Emulated> {
    bridge(sim, "link", &machine.link, wiring.controller_link.clone())?;
    bridge(
        sim,
        "stage",
        &machine.stage,
        wiring.controller_stage.clone(),
    )?;
    let (pins, far_end) = Port::pair();
    bridge(sim, "pins", &machine.pins, far_end)?;
    sim.follow(machine.brake()?);

    let board = wiring.board.clone();
    // The image has no second projector.
    let [projector, _] = &board.projectors;
    let inputs = [
        (Subject::LedSense, projector.led_sense.clone()),
        (Subject::DmdReady, projector.dmd_ready.clone()),
        (Subject::CameraReady, board.camera_ready.clone()),
        (Subject::CameraExposing, board.camera_exposing.clone()),
        (Subject::PressOpenA, board.press.press_open_a.clone()),
        (Subject::PressOpenB, board.press.press_open_b.clone()),
        (Subject::DieClear, board.press.die_clear.clone()),
        (Subject::GuardClosed, board.press.guard_closed.clone()),
        (Subject::Cycle, board.press.cycle.clone()),
        (Subject::RetractSwitch, board.press.retract_switch.clone()),
    ];
    for (subject, line) in inputs.clone() {
        sim.spawn(forward(subject, line, pins.clone()));
    }
    let selections: Rc<Channel<NoopRawMutex, u16, 4>> = Rc::new(Channel::new());
    sim.spawn({
        let (selections, mut bus, pins) = (
            Rc::clone(&selections),
            projector.pattern_bus.clone(),
            pins.clone(),
        );
        let ready = projector.dmd_ready.clone();
        async move {
            loop {
                let taken = bus.select(selections.receive().await).await.is_ok();
                // On real wires, ready falls before the answer is on the bus; here the two messages are sent in sequence.
                pins.send(&input_bytes(Subject::DmdReady, u8::from(ready.level())));
                pins.send(&input_bytes(Subject::PatternTaken, u8::from(taken)));
            }
        }
    });
    let trace = Trace::default();
    let (told, orders) = (Rc::clone(&trace), pins.clone());
    sim.spawn(async move {
        let (mut port, mut decoder, mut buffer) = (pins.clone(), PinDecoder::new(), [0u8; 256]);
        loop {
            let Ok(count) = port.read(&mut buffer).await;
            for message in buffer
                .iter()
                .take(count)
                .filter_map(|&byte| decoder.push(byte))
            {
                if message.subject == Subject::Tick {
                    pins.send(&input_bytes(Subject::Tick, 0));
                    continue;
                }
                told.borrow_mut().push(message);
                if message.subject == Subject::SelectPattern {
                    let _full = selections.try_send(message.value);
                }
                hear(&board, &inputs, &pins, message);
            }
        }
    });
    Ok(Emulated {
        trace,
        pins: orders,
    })
}

/// Applies an output of the image.
fn hear(board: &Board, inputs: &[(Subject, Line)], pins: &Port, message: PinMessage) {
    let PinMessage {
        subject,
        value,
        at_us,
    } = message;
    let level = value != 0;
    let [projector, _] = &board.projectors;
    match subject {
        Subject::LedEnable => {
            projector.led_enable.set_at(level, at_us);
            if !level {
                // A view is complete, so statistics are requested now.
                pins.send(&input_bytes(Subject::StackUsed, 0));
                pins.send(&input_bytes(Subject::AlarmLatency, 0));
            }
        }
        Subject::LedCurrent => projector.led_current.clone().set(Milliamps(value)),
        Subject::DmdTrigger => projector.dmd_trigger.set_at(level, at_us),
        Subject::CameraTrigger => board.camera_trigger.set_at(level, at_us),
        Subject::HeadClear1 => board.press.head_clear_1.set_at(level, at_us),
        Subject::HeadClear2 => board.press.head_clear_2.set_at(level, at_us),
        Subject::Go => board.press.go.set_at(level, at_us),
        Subject::NoGo => board.press.no_go.set_at(level, at_us),
        Subject::VerdictBeat => board.press.beat.set_at(level, at_us),
        Subject::Started => {
            // The image knows no input level yet.
            for (subject, line) in inputs {
                pins.send(&input_bytes(*subject, u8::from(line.level())));
            }
        }
        Subject::SelectPattern
        | Subject::LedSense
        | Subject::DmdReady
        | Subject::CameraReady
        | Subject::CameraExposing
        | Subject::PatternTaken
        | Subject::PressOpenA
        | Subject::PressOpenB
        | Subject::DieClear
        | Subject::GuardClosed
        | Subject::Cycle
        | Subject::RetractSwitch
        | Subject::StackUsed
        | Subject::AlarmLatency
        | Subject::Tick
        | Subject::InjectFault => {}
    }
}

/// Sends every change of a line to the image.
async fn forward(subject: Subject, mut line: Line, pins: Port) {
    let mut told = false;
    loop {
        let Ok(()) = if told {
            line.wait_for_low().await
        } else {
            line.wait_for_high().await
        };
        told = !told;
        pins.send(&input_bytes(subject, u8::from(told)));
    }
}

/// Connects a socket and a port in both directions.
fn bridge(sim: &Sim, name: &str, socket: &UnixStream, port: Port) -> io::Result<()> {
    let (mut from, mut to) = (socket.try_clone()?, socket.try_clone()?);
    let (arriving, remote): (_, Remote) = (port.clone(), sim.remote());
    std::thread::Builder::new()
        .name(format!("{name}-read"))
        .spawn(move || {
            // The remote tells a stepped simulation that external input may still arrive.
            let _remote = remote;
            let mut buffer = [0u8; 512];
            while let Ok(count @ 1..) = from.read(&mut buffer) {
                arriving.send(&buffer[..count]);
            }
        })?;
    // Writing is done on a thread, because an emulator that does not read must not stop virtual time.
    let (outbox, queue) = mpsc::channel::<Vec<u8>>();
    std::thread::Builder::new()
        .name(format!("{name}-write"))
        .spawn(move || {
            for bytes in queue {
                if to.write_all(&bytes).is_err() {
                    break;
                }
            }
        })?;
    sim.spawn(async move {
        let (mut port, mut buffer) = (port, [0u8; 512]);
        loop {
            let Ok(count) = port.read(&mut buffer).await;
            if outbox.send(buffer[..count].to_vec()).is_err() {
                return;
            }
        }
    });
    Ok(())
}
