//! The instrument in a running press, in stepped time.

mod common;

use common::script::{Hands, Record, Setup};
use common::{Host, plan, script};
use flankscope_bench::devices::press::WaitForHead;
use flankscope_bench::devices::{DeviceConfig, DeviceFault, PressModel};
use flankscope_controller::sequence::Config;
use flankscope_protocol::*;
use flankscope_sim::{Board, now_us};
use std::cell::RefCell;
use std::rc::Rc;

fn run<F: Future<Output = Host> + 'static>(
    press: PressModel,
    script: impl FnOnce(Host, Hands) -> F,
) -> Record {
    let devices = DeviceConfig {
        press,
        ..DeviceConfig::default()
    };
    script::run(devices, script)
}

fn running() -> PressModel {
    PressModel {
        strokes_per_minute: 30.0,
        ..PressModel::default()
    }
}

fn over(event: &Event) -> bool {
    matches!(
        event,
        Event::CaptureDone { .. }
            | Event::StateChanged {
                next: State::Faulted,
                ..
            }
    )
}

#[test]
fn the_press_strokes_while_the_head_is_clear_and_stands_while_it_is_not() {
    let record = run(running(), |mut host, _| async move {
        host.prepare(plan()).await;
        let strokes = |host: &Host| {
            let mut cycles = host.events.iter().filter_map(|(_, event)| match event {
                Event::Cycle { count, .. } => Some(*count),
                _ => None,
            });
            cycles.next_back().unwrap_or(0)
        };
        for want in [3, 6] {
            while strokes(&host) < want {
                host.until(|event| matches!(event, Event::Cycle { .. }))
                    .await;
            }
            // The stroke that has begun is let through: refused until the press is seen to have closed and opened.
            let refused = host.order(Command::Start { session: 5 }).await;
            let fault = Fault::PressCycled.code();
            assert_eq!(refused, Reply::Refused(Refusal::Interlock { fault }));
            host.until(|event| matches!(event, Event::PressOpen { open: true, .. }))
                .await;
            assert_eq!(
                host.order(Command::Start { session: 5 }).await,
                Reply::Accepted
            );
            host.until(over).await;
        }
        host.until(|event| matches!(event, Event::Cycle { .. }))
            .await;
        host
    });
    let faults: Vec<_> = record
        .events
        .iter()
        .filter(|event| matches!(event, Event::Fault { .. }))
        .collect();
    assert_eq!(faults, Vec::<&Event>::new());
    let triggers = |event: &&Event| matches!(event, Event::Triggered(_));
    assert_eq!(record.events.iter().filter(triggers).count(), 150);

    // Never a stroke while the head is off its switch, and never both permissions at once.
    let (made, open) = (
        record.times("retract_switch", true),
        record.times("retract_switch", false),
    );
    assert_eq!(open.len(), 2);
    for (n, &left_us) in open.iter().enumerate() {
        let back_us = made[n + 1];
        for line in ["cycle", "press_open_a", "press_open_b", "head_clear_1"] {
            let inside = record
                .edges
                .iter()
                .find(|edge| edge.line == line && (left_us..=back_us).contains(&edge.at_us));
            assert_eq!(inside, None, "while the head was in the die");
        }
        // The press had its hold time before the head left.
        let dropped = record.times("head_clear_2", false)[n];
        assert!(left_us - dropped >= 100_000);
    }
    assert!(record.times("cycle", true).len() >= 7);
}

/// What goes wrong at the press while the head is in the die, with its fault.
const LOSSES: [(&str, bool, Fault); 6] = [
    ("press_open_a", false, Fault::PressNotOpen),
    ("press_open_b", true, Fault::PressNotOpen),
    ("die_clear", false, Fault::DieNotClear),
    ("guard_closed", false, Fault::GuardOpen),
    ("cycle", true, Fault::PressCycled),
    ("retract_switch", true, Fault::HeadSwitch),
];

fn line<'a>(board: &'a Board, name: &str) -> &'a flankscope_sim::Line {
    let press = &board.press;
    match name {
        "press_open_a" => &press.press_open_a,
        "press_open_b" => &press.press_open_b,
        "die_clear" => &press.die_clear,
        "guard_closed" => &press.guard_closed,
        "cycle" => &press.cycle,
        "retract_switch" => &press.retract_switch,
        other => panic!("no line {other}"),
    }
}

/// At several frames of the view: LED off and retract begun within the limits, fault latched, nothing starts again.
#[test]
fn every_loss_at_the_press_darkens_and_retracts_in_time_and_stays() {
    for (name, level, fault) in LOSSES {
        for frame in [0u16, 1, 7, 19, 24] {
            let lost_at = Rc::new(RefCell::new(0));
            let note = Rc::clone(&lost_at);
            let record = run(PressModel::default(), |mut host, hands| async move {
                host.prepare(plan()).await;
                host.order(Command::Start { session: 5 }).await;
                host.until(|event| matches!(event, Event::Triggered(t) if t.frame == frame))
                    .await;
                if name == "retract_switch" {
                    hands.world.switch_stuck.set(Some(true));
                }
                line(&hands.board, name).set(level);
                *note.borrow_mut() = now_us();
                host.until(|event| {
                    matches!(
                        event,
                        Event::StateChanged {
                            next: State::Faulted,
                            ..
                        }
                    )
                })
                .await;
                // All is well again: only an acknowledgement helps.
                line(&hands.board, name).set(!level);
                if name == "retract_switch" {
                    line(&hands.board, name).set(true);
                }
                let refused = host.order(Command::Start { session: 5 }).await;
                let code = fault.code();
                assert_eq!(refused, Reply::Refused(Refusal::Faulted { fault: code }));
                assert_eq!(host.order(Command::AcknowledgeFault).await, Reply::Accepted);
                host
            });
            let lost_us = *lost_at.borrow();
            let first = record.events.iter().find_map(|event| match event {
                Event::Fault { fault, .. } => fault.known(),
                _ => None,
            });
            assert_eq!(first, Some(fault), "{name} at frame {frame}");
            // A contradicting switch is given its time; everything else counts at once.
            let allowed_us = match fault {
                Fault::HeadSwitch => u64::from(Config::DEFAULT.interlock.contradiction.get()),
                _ => 0,
            };
            let off = record.times("led_enable", false);
            let off_us = off.iter().copied().find(|&at| at >= lost_us).expect("dark");
            assert!(
                off_us - lost_us <= 100_000 + allowed_us,
                "{name}: dark after {} us",
                off_us - lost_us
            );
            let retract_us = record.events.iter().find_map(|event| match event {
                Event::StateChanged {
                    next: State::Retracting,
                    at,
                    ..
                } if at.get() >= lost_us => Some(at.get()),
                _ => None,
            });
            assert!(retract_us.expect("retracts") - lost_us <= 250_000 + allowed_us);
            assert!(
                (record.pose.vertical_mm - 100.0).abs() < 0.01,
                "the head is out"
            );
        }
    }
}

/// Likewise with the head's position and with the host, from the moment that they are lost, not that it is noticed.
#[test]
fn losing_the_position_or_the_host_darkens_and_retracts_in_time() {
    for (lost, fault) in [
        (Some(DeviceFault::StageSilent), Fault::StageSilent),
        (Some(DeviceFault::StageBeside), Fault::OffPosition),
        (None, Fault::HostSilent),
    ] {
        for frame in [0u16, 1, 7, 19, 24] {
            let lost_at = Rc::new(RefCell::new(0));
            let note = Rc::clone(&lost_at);
            let record = run(PressModel::default(), |mut host, hands| async move {
                host.prepare(plan()).await;
                host.order(Command::Start { session: 5 }).await;
                host.until(|event| matches!(event, Event::Triggered(t) if t.frame == frame))
                    .await;
                *note.borrow_mut() = now_us();
                match lost {
                    Some(fault) => {
                        hands.world.faults.give(fault);
                        host.keep_company(400).await;
                    }
                    None => host.listen(400).await,
                }
                host
            });
            let lost_us = *lost_at.borrow();
            let first = record.events.iter().find_map(|event| match event {
                Event::Fault { fault, at, .. } => fault.known().zip(Some(at.get())),
                _ => None,
            });
            let what = format!("{fault} at frame {frame}");
            assert_eq!(first.map(|(fault, _)| fault), Some(fault), "{what}");
            // Behind the last frame of a view it is dark by itself.
            let lit = |at_us: u64| {
                let mut edges = record.edges.iter();
                let last = edges.rfind(|edge| edge.line == "led_enable" && edge.at_us <= at_us);
                last.is_some_and(|edge| edge.level)
            };
            assert!(lit(lost_us), "{what}");
            let dark_us = record.times("led_enable", false);
            let dark_us = dark_us.into_iter().find(|&at| at >= lost_us);
            assert!(
                dark_us.expect("dark") - lost_us <= 100_000,
                "{what}: {dark_us:?}"
            );
            assert!(!lit(lost_us + 100_000), "{what}: lit again");
            let retract_us = record.events.iter().find_map(|event| match event {
                Event::StateChanged {
                    next: State::Retracting,
                    at,
                    ..
                } => Some(at.get()),
                _ => None,
            });
            let retract_us = retract_us.expect("retracts") - lost_us;
            assert!(
                retract_us <= 250_000,
                "{what}: retracts after {retract_us} us"
            );
            println!(
                "{what}: dark after {} us, retract after {retract_us} us",
                dark_us.unwrap_or(0) - lost_us
            );
        }
    }
}

/// The host is alive and content; the controller alone ends a stay that is too long, and the press goes on by itself.
#[test]
fn a_press_is_never_held_beyond_the_limit_even_for_a_living_host() {
    let stay_us = 2_000_000;
    let mut config = Config::DEFAULT;
    config.interlock.stay = Microseconds(stay_us);
    let setup = Setup {
        controller: Some(config),
        ..Setup::default()
    };
    let record = script::run(setup, |mut host, _| async move {
        host.prepare(plan()).await;
        let started = host.order(Command::Start { session: 5 }).await;
        assert_eq!(started, Reply::Accepted);
        host.until(over).await;
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        assert!(status.press.head_clear, "let go without an acknowledgement");
        let refused = host.order(Command::Start { session: 5 }).await;
        let fault = Fault::HoldLimit.code();
        assert_eq!(refused, Reply::Refused(Refusal::Faulted { fault }));
        host
    });
    let faults: Vec<_> = record
        .faults()
        .into_iter()
        .map(|(fault, _)| fault)
        .collect();
    assert_eq!(faults, [Fault::HoldLimit]);
    let claimed_us = record.times("head_clear_1", false)[0];
    let over_us = claimed_us + u64::from(stay_us);
    // Between two views the LED is dark already; it must be so soon after the limit, and stay so.
    let mut led = record.edges.iter().filter(|edge| edge.line == "led_enable");
    let lit_us = led.rfind(|edge| edge.level).expect("was lit").at_us;
    assert!(lit_us < over_us);
    let dark_us = *record.times("led_enable", false).last().expect("dark");
    assert!(dark_us <= over_us + 100_000, "dark at {dark_us}");
    let released_us = *record.times("head_clear_1", true).last().expect("released");
    let limit_us = over_us + u64::from(config.interlock.withdraw.get());
    assert!(
        (over_us..=limit_us).contains(&released_us),
        "held from {claimed_us} to {released_us}"
    );
    assert!(
        (record.pose.vertical_mm - 100.0).abs() < 0.01,
        "the head is out"
    );
}

#[test]
fn a_verdict_is_shown_while_it_is_fresh() {
    let record = run(PressModel::default(), |mut host, _| async move {
        host.prepare(plan()).await;
        let shown = Command::ShowVerdict { go: true };
        assert_eq!(host.order(shown).await, Reply::Accepted);
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        assert!(status.press.go && status.press.open && status.press.head_clear);
        embassy_time::Timer::after_secs(10).await;
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        assert!(!status.press.go);
        host
    });
    let (on, off) = (record.times("go", true)[0], record.times("go", false)[0]);
    assert_eq!(
        off - on,
        u64::from(Config::DEFAULT.interlock.verdict_life.get())
    );
    // Power-up, then on with the fall of go.
    assert_eq!(record.times("no_go", true), [0, off]);
    assert_eq!(record.times("no_go", false), [on]);
    let beats = record.times("beat", true).len() + record.times("beat", false).len();
    assert_eq!(beats, 20);
}

/// A press that is faster than real time waits at the top for the check that is due, and goes on without it when none is ordered.
#[test]
fn a_press_that_waits_for_checks_waits_for_a_late_host_and_not_for_ever() {
    const EVERY: usize = 3;
    const PATIENCE_US: u64 = 60_000_000;
    let press = PressModel {
        waits: Some(WaitForHead {
            every: EVERY as u32,
            patience_us: PATIENCE_US,
        }),
        ..running()
    };
    let record = run(press, |mut host, _| async move {
        host.prepare(plan()).await;
        // A host that needs 20 s before it orders a check: ten strokes of a press that does not wait.
        for _ in 0..2 {
            host.keep_company(20_000).await;
            assert_eq!(
                host.order(Command::Start { session: 5 }).await,
                Reply::Accepted
            );
            host.until(over).await;
        }
        // From here on none is ordered.
        host.keep_company(2 * PATIENCE_US / 1000 + 30_000).await;
        host
    });
    let strokes = record.times("cycle", true);
    let left = record.times("retract_switch", false);
    let before = |at_us: u64| strokes.iter().filter(|&&stroke| stroke < at_us).count();
    // The first check comes after the first stroke, the next one after three more.
    assert_eq!(left.len(), 2);
    assert_eq!([before(left[0]), before(left[1])], [1, 1 + EVERY]);
    // Afterwards three strokes at a time, with the patience between them.
    let gaps = |of: &[u64]| {
        of.windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect::<Vec<_>>()
    };
    let waits = |us: &&u64| **us >= PATIENCE_US;
    let idle = gaps(&strokes[1 + EVERY..]);
    assert_eq!(idle.iter().filter(waits).count(), 2, "{idle:?}");
    assert_eq!(
        idle.iter().position(|us| waits(&us)),
        Some(EVERY - 1),
        "{idle:?}"
    );
    assert_eq!(
        idle.iter().rposition(|us| waits(&us)),
        Some(2 * EVERY - 1),
        "{idle:?}"
    );
}
