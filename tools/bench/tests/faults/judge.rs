//! What a run did not keep of its promise.

use crate::promises::{Injection, Promise, Safe};
use crate::run::Record;
use flankscope_bench::devices::DeviceFault;
use flankscope_protocol::{Event, State};

fn unfaulted(record: &Record) -> bool {
    !record
        .events
        .iter()
        .any(|event| matches!(event, Event::Fault { .. }))
}

/// What the run did not keep of its promise.
pub fn broken(promise: &Promise, record: &Record) -> Option<String> {
    let Some(fired_us) = record.fired_us else {
        return Some("never fired".into());
    };
    let level_at_end = |line: &str| {
        let mut edges = record.edges.iter();
        edges
            .rfind(|edge| edge.line == line)
            .is_some_and(|edge| edge.level)
    };
    for line in ["led_enable", "camera_trigger", "dmd_trigger"] {
        if level_at_end(line) {
            return Some(format!("{line} stays high"));
        }
    }
    // Enabled at some time after the fault had its time: not dark.
    let limit_us = fired_us + promise.dark_ms * 1_000;
    let mut lit = false;
    if promise.safe != Safe::Unharmed
        && !(promise.safe == Safe::RetractedOrOvercome && unfaulted(record))
    {
        for edge in record.edges.iter().filter(|edge| edge.line == "led_enable") {
            if edge.at_us > limit_us && (lit || edge.level) {
                return Some(format!(
                    "LED switched {} us after its limit",
                    edge.at_us - limit_us
                ));
            }
            lit = edge.level;
        }
    }
    let first = record.events.iter().find_map(|event| match event {
        Event::Fault { fault, .. } if fault.0 < 96 => fault.known(),
        _ => None,
    });
    let safe_at = record.events.iter().rev().find_map(|event| match event {
        Event::StateChanged {
            next: State::Faulted,
            at,
            ..
        } => Some(at.get()),
        _ => None,
    });
    let (both, out) = (
        (level_at_end("head_clear_1"), level_at_end("head_clear_2")),
        record.vertical_mm >= 79.9 && record.standing,
    );
    let overcome = promise.safe == Safe::RetractedOrOvercome && first.is_none();
    match promise.safe {
        _ if overcome => {
            if record.captures == 0 || !out {
                return Some("neither faulted nor overcome".into());
            }
        }
        Safe::Unharmed => {
            if let Some(fault) = first {
                return Some(format!("harmed: {fault}"));
            }
            if record.captures == 0 {
                return Some("no capture was completed".into());
            }
        }
        Safe::Restarted(want) => {
            if record.boot != Some(want) {
                return Some(format!("says {:?} after the restart", record.boot));
            }
            if record.resets_us.len() != 1
                || record.resets_us[0] > fired_us + promise.safe_ms * 1_000
            {
                return Some(format!(
                    "resets at {:?}, fired at {fired_us}",
                    record.resets_us
                ));
            }
            if both != (false, false) || !record.standing {
                return Some(format!("head-clear {both:?}, standing {}", record.standing));
            }
        }
        Safe::Retracted | Safe::RetractedOrOvercome | Safe::Held => {
            if !first.is_some_and(|fault| promise.faults.contains(&fault)) {
                return Some(format!("first fault {first:?}"));
            }
            match safe_at {
                None => return Some("never faulted".into()),
                Some(at) if at > fired_us + promise.safe_ms * 1_000 => {
                    return Some(format!(
                        "safe {} ms after the fault",
                        (at - fired_us) / 1_000
                    ));
                }
                Some(_) => {}
            }
            if promise.safe != Safe::Held && !out {
                return Some(format!("the head stands at {} mm", record.vertical_mm));
            }
            if promise.safe == Safe::Held && both != (false, false) {
                return Some("head-clear although the head is not proven out".into());
            }
        }
    }
    if let Some(what) = unpaired(promise, record) {
        return Some(what);
    }
    // Always: both channels alike, and never high while the head is not proven out.
    if both.0 != both.1 || (both.0 && !out) {
        return Some(format!(
            "head-clear {both:?} with the head at {} mm",
            record.vertical_mm
        ));
    }
    None
}

/// The host takes a view only if every frame of it is the one that was triggered, and takes every view that is whole.
fn unpaired(promise: &Promise, record: &Record) -> Option<String> {
    let frame_fault = matches!(promise.injection, Injection::Frame(_));
    let spoiled =
        frame_fault || promise.injection == Injection::Device(DeviceFault::CameraExtraTrigger);
    for view in &record.received {
        if view.accepted && !view.true_to_triggers {
            return Some("the host took a frame for another".into());
        }
        if !view.accepted && !spoiled {
            return Some("the host refused a view that is whole".into());
        }
        if frame_fault && view.accepted == view.struck {
            let what = if view.struck {
                "took a spoiled"
            } else {
                "refused a whole"
            };
            return Some(format!("the host {what} view"));
        }
    }
    if spoiled && record.received.iter().all(|view| view.accepted) {
        return Some("the host saw nothing of the spoiled frame".into());
    }
    None
}
