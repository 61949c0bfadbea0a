//! The controller's side of the serial line: from bytes to commands, answers, and waits that delay later commands.

use super::super::camera::ExposureSink;
use super::super::{DeviceFault, Faults, World};
use super::commands::{Wait, holds};
use super::{StageModel, TruePose};
use embassy_time::{Instant, Timer};
use embedded_io_async::{Read, Write};
use flankscope_sim::Port;
use std::cell::RefCell;
use std::rc::Rc;

/// The controller's input buffer, characters.
const LONGEST_LINE: usize = 80;

pub(in super::super) async fn run<S: ExposureSink>(
    port: Port,
    world: Rc<World>,
    sink: Rc<RefCell<S>>,
) {
    serve(port, &world.stage, &world.faults, |destination| {
        world.course.signal(());
        sink.borrow_mut().moving_to(destination);
    })
    .await;
}

/// Serves `port` for ever; `set_off` receives the destination of the stages when they start to move.
///
/// A carriage return ends a line; line feeds before or after it are ignored. Waits (`WS`, `WP`, `WT`) and an executed program
/// (`EX`) delay all following commands.
pub(in super::super) async fn serve(
    mut port: Port,
    stage: &RefCell<StageModel>,
    faults: &Faults,
    mut set_off: impl FnMut(TruePose),
) {
    let mut line = Vec::new();
    let mut buffer = [0u8; 64];
    loop {
        let Ok(count) = port.read(&mut buffer).await;
        for &byte in &buffer[..count] {
            match byte {
                b'\r' => {
                    let text = String::from_utf8_lossy(&line).into_owned();
                    line.clear();
                    carry_out(&mut port, stage, faults, &mut set_off, text).await;
                }
                b'\n' => {}
                byte if line.len() < LONGEST_LINE => line.push(byte),
                _ => {}
            }
        }
    }
}

async fn carry_out(
    port: &mut Port,
    stage: &RefCell<StageModel>,
    faults: &Faults,
    set_off: &mut impl FnMut(TruePose),
    mut rest: String,
) {
    while !rest.is_empty() {
        let (now, hold, later) = split_at_hold(&rest);
        spoil(stage, faults, now);
        let (mut answer, moved) = stage.borrow_mut().line(Instant::now().as_micros(), now);
        if !answer.is_empty() {
            if faults.spoils(DeviceFault::StageSilent) {
                answer.clear();
            } else if faults.spoils(DeviceFault::StageGarbage) {
                answer = "\u{7f}?#9,\r\n".into();
            } else if faults.spoils(DeviceFault::StageLate) {
                Timer::after_millis(300).await;
            }
        }
        let Ok(()) = port.write_all(answer.as_bytes()).await;
        if moved {
            let destination = stage.borrow().true_destination();
            set_off(destination);
        }
        let wait = hold.map(|command| stage.borrow_mut().hold(Instant::now().as_micros(), command));
        rest = match wait.flatten() {
            Some(Wait::Program(text)) => format!("{text};{later}"),
            Some(Wait::Time(ms)) => {
                Timer::after_millis(ms).await;
                later.to_owned()
            }
            Some(Wait::Stop { axis, then_ms }) => {
                until(stage, |stage, now_s| stage.stands(now_s, axis)).await;
                Timer::after_millis(then_ms).await;
                later.to_owned()
            }
            Some(Wait::Crossing {
                axis,
                place,
                from_below,
            }) => {
                until(stage, |stage, now_s| {
                    let here = stage.axes[axis].profile.position(now_s);
                    (here >= place) == from_below || stage.axes[axis].done(now_s)
                })
                .await;
                later.to_owned()
            }
            None => later.to_owned(),
        };
    }
}

/// Injects faults of the mechanics and the controller, just before a line is executed.
fn spoil(stage: &RefCell<StageModel>, faults: &Faults, line: &str) {
    let mut stage = stage.borrow_mut();
    let moving = line.contains("PA") && !line.contains('?');
    if moving && line.contains("1PA") && faults.spoils(DeviceFault::RotationStalls) {
        stage.axes[0].stalls = true;
    }
    if moving && line.contains("2PA") && faults.spoils(DeviceFault::VerticalStalls) {
        stage.axes[1].stalls = true;
    }
    if line == "TB?" && faults.spoils(DeviceFault::StageError) {
        stage.errors.push_front((7, "PARAMETER OUT OF RANGE"));
    }
    if stage.moves_vertically(line) && faults.spoils(DeviceFault::StageOvershoots) {
        stage.axes[1].overshoots_mm = 0.5;
    }
    if stage.moves_vertically(line) && faults.spoils(DeviceFault::StageLimit) {
        stage.axes[1].meets_limit = true;
    }
    if line == "2TP?" && faults.spoils(DeviceFault::StageBeside) {
        let reading_mm = 1.0;
        stage.axes[1].reads_beside_mm = reading_mm;
    }
}

/// Splits a line into the part that is executed at once, the command that delays the rest, and the rest.
fn split_at_hold(line: &str) -> (&str, Option<&str>, &str) {
    let mut start = 0;
    for command in line.split(';') {
        let end = start + command.len();
        if holds(command) {
            let later = line.get(end + 1..).unwrap_or_default();
            return (&line[..start], Some(command), later);
        }
        start = end + 1;
    }
    (line, None, "")
}

/// Completes when a condition on the stages is true, polled every millisecond.
async fn until(stage: &RefCell<StageModel>, so: impl Fn(&StageModel, f64) -> bool) {
    while !so(&stage.borrow(), Instant::now().as_micros() as f64 * 1e-6) {
        Timer::after_millis(1).await;
    }
}
