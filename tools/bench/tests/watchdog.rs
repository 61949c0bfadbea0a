//! Each task hung in turn, in the middle of a capture: reset into the safe state, and the first hello says why.

mod common;

use common::{Host, Notebook, plan};
use embassy_time::Timer;
use flankscope_bench::devices::{DeviceConfig, spawn_all};
use flankscope_controller::liveness::Task;
use flankscope_controller::sequence::Config;
use flankscope_protocol::message::Boot;
use flankscope_protocol::*;
use flankscope_sim::{Clock, Controller, Sim, Wiring, now_us};
use std::cell::RefCell;
use std::rc::Rc;

const HELLO: Command = Command::Hello {
    protocol: PROTOCOL_VERSION,
    schema: SCHEMA_HASH,
};

#[test]
fn a_hung_task_ends_in_a_reset_and_the_safe_state() {
    for task in Task::ALL {
        for hang_at_ms in [1u64, 180, 700, 1_500, 2_300] {
            hang(task, hang_at_ms);
        }
    }
}

fn hang(task: Task, hang_at_ms: u64) {
    let what = format!("{task:?} hung {hang_at_ms} ms after the start");
    let sim = Sim::new(Clock::Stepped);
    let wiring = Rc::new(Wiring::new(&sim));
    let world = spawn_all(&sim, &wiring, &DeviceConfig::default(), Notebook::default());
    let controller = Controller::power_up(&sim, Rc::clone(&wiring), Config::DEFAULT);
    let finished = Rc::new(RefCell::new(None));
    let (hung, result) = (controller.clone(), Rc::clone(&finished));
    let mut host = Host::new(wiring.host.clone());
    sim.spawn(async move {
        host.prepare(plan()).await;
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Accepted
        );
        host.keep_company(hang_at_ms).await;
        hung.hang(task);
        let hung_us = now_us();
        Timer::after_millis(400).await;
        // What was under way on the wire belongs to the session that is lost.
        host.forget();
        let Reply::Hello(identity) = host.order(HELLO).await else {
            panic!("no hello")
        };
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        let start = host.order(Command::Start { session: 5 }).await;
        *result.borrow_mut() = Some((hung_us, identity, status, start));
    });
    sim.run_until(|| finished.borrow().is_some() || now_us() > 60_000_000);
    let (hung_us, identity, status, start) = finished.take().expect("finished");

    let resets = controller.resets_us();
    assert_eq!(resets.len(), 1, "{what}");
    // Shown life at most one beat ago, looked for a beat later, then the window.
    assert!(
        resets[0] - hung_us <= 300_000,
        "{what}: reset after {} us",
        resets[0] - hung_us
    );
    assert_eq!(identity.boot, Boot::Watchdog, "{what}");
    assert_eq!(status.state, State::Unhomed, "{what}");
    assert!(!status.homed && !status.led_on && !status.press.head_clear && !status.press.go);
    assert_eq!(start, Reply::Refused(Refusal::NotConfigured), "{what}");
    for line in [
        "led_enable",
        "led_sense",
        "camera_trigger",
        "head_clear_1",
        "head_clear_2",
    ] {
        let edges = sim.edges();
        let last = edges.iter().rfind(|edge| edge.line == line);
        assert!(
            last.is_none_or(|edge| !edge.level),
            "{what}: {line} stays high"
        );
    }
    // The stages were told to stop: what they do ends now, not at their old target.
    let stands = world.stage.borrow().true_destination();
    let now = world.stage.borrow().true_pose(now_us());
    assert_eq!(now, stands, "{what}");
}

#[test]
fn a_healthy_controller_is_never_reset() {
    let sim = Sim::new(Clock::Stepped);
    let wiring = Rc::new(Wiring::new(&sim));
    spawn_all(&sim, &wiring, &DeviceConfig::default(), Notebook::default());
    let controller = Controller::power_up(&sim, Rc::clone(&wiring), Config::DEFAULT);
    let finished = Rc::new(RefCell::new(false));
    let result = Rc::clone(&finished);
    let mut host = Host::new(wiring.host.clone());
    sim.spawn(async move {
        host.prepare(plan()).await;
        host.order(Command::Start { session: 5 }).await;
        host.until(|event| matches!(event, Event::CaptureDone { .. }))
            .await;
        *result.borrow_mut() = true;
    });
    sim.run_until(|| *finished.borrow() || now_us() > 60_000_000);
    assert!(*finished.borrow());
    assert!(controller.resets_us().is_empty());
}
