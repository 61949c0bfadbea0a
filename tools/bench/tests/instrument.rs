//! The whole instrument in stepped time: a host's orders in, pin edges, exposures and events out.

mod common;

use common::plan;
use common::script::{Record, run};
use flankscope_bench::devices::{DeviceConfig, DmdTiming, LedTiming};
use flankscope_protocol::*;

fn capture(devices: DeviceConfig) -> Record {
    run(devices, |mut host, _| async move {
        host.prepare(plan()).await;
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Accepted
        );
        host.until(|event| {
            matches!(
                event,
                Event::CaptureDone { .. }
                    | Event::StateChanged {
                        next: State::Faulted,
                        ..
                    }
            )
        })
        .await;
        host
    })
}

fn triggers(record: &Record) -> Vec<Trigger> {
    record
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Triggered(trigger) => Some(*trigger),
            _ => None,
        })
        .collect()
}

#[test]
fn a_capture_of_three_views_is_exposed_as_planned() {
    let record = capture(DeviceConfig::default());
    let (plan, triggers) = (plan(), triggers(&record));
    let frames = usize::from(plan.frames_per_view());
    println!(
        "3 views, {} frames: {:.3} s of virtual time, homing included",
        3 * frames,
        record.end_us as f64 * 1e-6
    );

    // Every frame of the plan, in its order, exists as trigger, as exposure and as frame read out.
    assert_eq!(
        (triggers.len(), record.notes.exposures.len()),
        (3 * frames, 3 * frames)
    );
    assert_eq!(record.notes.lost, []);
    for (n, (trigger, exposure)) in triggers.iter().zip(&record.notes.exposures).enumerate() {
        let spec = plan
            .frame((n % frames) as u16)
            .expect("a frame of the plan");
        assert_eq!(
            (usize::from(trigger.view), usize::from(trigger.frame)),
            (n / frames, n % frames)
        );
        assert_eq!(
            (trigger.pattern, trigger.exposure),
            (spec.pattern, spec.exposure)
        );
        // What the camera saw is what the controller said, not merely what it meant to do.
        assert_eq!(
            (exposure.counter, exposure.shown),
            (n as u32, [Some(spec.pattern), None])
        );
        assert_eq!(
            exposure.end_us - exposure.start_us,
            u64::from(spec.exposure.get())
        );
        assert_eq!(exposure.start_us, trigger.camera_at.get() + 5);
        // At the commanded pose but for the stage errors.
        let view = plan.views[n / frames];
        let off_rad = exposure.rotation_rad - f64::from(view.rotation.get()) * 1e-6;
        let off_mm = exposure.vertical_mm - f64::from(view.vertical.get()) * 1e-3;
        assert!(off_rad.abs() <= 0.015f64.to_radians() + 1e-6 && off_mm.abs() <= 0.005 + 1e-6);
    }
    let exposures = record.notes.exposures.iter();
    assert_eq!(
        record.notes.read_out,
        exposures
            .map(|e| (e.counter, e.readout_done_us))
            .collect::<Vec<_>>()[..75]
    );
    for pair in record.notes.exposures.windows(2) {
        assert!(
            pair[1].end_us >= pair[0].readout_done_us,
            "{pair:?} conflict"
        );
    }
    // No event is missing: they count from 1.
    let count = record.numbers.len() as u16;
    assert_eq!(record.numbers, (1..=count).collect::<Vec<_>>());
}

#[test]
fn the_led_is_lit_only_between_settle_and_the_next_move() {
    let record = capture(DeviceConfig::default());
    let (on, off) = (
        record.times("led_enable", true),
        record.times("led_enable", false),
    );
    assert_eq!((on.len(), off.len()), (3, 3));
    let mut stands = Vec::new();
    let mut leaves = Vec::new();
    for event in &record.events {
        match event {
            Event::InPosition { at, .. } => stands.push(at.get()),
            Event::StateChanged {
                prev: State::Darkening,
                at,
                ..
            } => leaves.push(at.get()),
            _ => {}
        }
    }
    for view in 0..3 {
        assert_eq!(on[view], stands[view] + 50_000);
        assert!(on[view] < off[view] && off[view] < leaves[view]);
    }
    // Every trigger falls into a time when the current was proven to flow.
    let (lit, dark) = (
        record.times("led_sense", true),
        record.times("led_sense", false),
    );
    for trigger in triggers(&record) {
        let view = usize::from(trigger.view);
        assert!(lit[view] <= trigger.dmd_at.get() && trigger.end_at.get() <= dark[view]);
    }
    assert!(
        (record.pose.vertical_mm - 100.0).abs() <= 0.005 + 1e-6,
        "the head is out"
    );
}

#[test]
fn the_same_run_has_the_same_trace() {
    let (first, second) = (
        capture(DeviceConfig::default()),
        capture(DeviceConfig::default()),
    );
    assert_eq!(first.edges, second.edges);
    assert_eq!(first.events, second.events);
}

#[test]
fn a_dmd_that_is_never_ready_ends_dark_and_retracted() {
    let dead = DmdTiming {
        dead_from_trigger: Some(30),
        ..DmdTiming::default()
    };
    let record = capture(DeviceConfig {
        dmd: dead,
        ..DeviceConfig::default()
    });
    ends_in_fault(&record, Fault::DmdNotReady, 30);
    // Dark as soon as the timeout has passed, in the same microsecond.
    let trigger = *record.times("dmd_trigger", true).last().expect("triggered");
    let off = *record
        .times("led_enable", false)
        .last()
        .expect("switched off");
    assert_eq!(off, trigger + u64::from(plan().timeouts.dmd.get()));
}

#[test]
fn an_open_led_ends_without_a_frame() {
    let open = LedTiming {
        open: true,
        ..LedTiming::default()
    };
    let record = capture(DeviceConfig {
        led: open,
        ..DeviceConfig::default()
    });
    ends_in_fault(&record, Fault::LedNotOn, 0);
}

#[test]
fn a_stalled_rotation_ends_retracted() {
    let mut devices = DeviceConfig::default();
    // The reference run is its first order, the views follow.
    devices.axes.rotation.stalls_at_move = Some(2);
    let record = capture(devices);
    ends_in_fault(&record, Fault::MotionTimeout, 25);
}

fn ends_in_fault(record: &Record, fault: Fault, frames: usize) {
    let faults = record.faults();
    assert_eq!(
        faults.first().map(|(first, _)| *first),
        Some(fault),
        "{faults:?}"
    );
    assert_eq!(triggers(record).len(), frames);
    for line in ["led_enable", "led_sense", "camera_trigger"] {
        let last = record.edges.iter().rfind(|edge| edge.line == line);
        assert!(last.is_none_or(|edge| !edge.level), "{line} stays high");
    }
    assert!(
        (record.pose.vertical_mm - 100.0).abs() <= 0.005 + 1e-6,
        "the head is out"
    );
}

#[test]
fn a_host_that_falls_silent_loses_the_instrument_within_its_limit() {
    let record = run(DeviceConfig::default(), |mut host, _| async move {
        host.prepare(plan()).await;
        host.order(Command::Start { session: 5 }).await;
        host.until(|event| matches!(event, Event::Triggered(trigger) if trigger.frame == 7))
            .await;
        // From here on only listening.
        while !host.events.iter().any(|(_, e)| {
            matches!(
                e,
                Event::StateChanged {
                    next: State::Faulted,
                    ..
                }
            )
        }) {
            host.receive().await;
        }
        host
    });
    let frames = triggers(&record).len();
    ends_in_fault(&record, Fault::HostSilent, frames);
    assert!((8..25).contains(&frames));
}

#[test]
fn a_command_sent_three_times_is_done_once() {
    let record = run(DeviceConfig::default(), |mut host, _| async move {
        host.prepare(plan()).await;
        let mut replies = Vec::new();
        for _ in 0..3 {
            host.send(0xC0FFEE, 1_000, &Command::Start { session: 5 })
                .await;
        }
        while replies.len() < 3 {
            replies.extend(host.receive().await);
        }
        assert_eq!(replies, vec![(1_000, Reply::Accepted); 3]);
        // A fourth one under a new number is a new command, and refused.
        host.send(0xC0FFEE, 1_001, &Command::Start { session: 5 })
            .await;
        let refused = Reply::Refused(Refusal::Busy {
            state: State::Claiming,
        });
        assert_eq!(host.receive().await, [(1_001, refused)]);
        host
    });
    let starts = record.events.iter().filter(|e| {
        matches!(
            e,
            Event::StateChanged {
                why: Why::Start,
                ..
            }
        )
    });
    assert_eq!(starts.count(), 1);
}

#[test]
fn strangers_and_bad_plans_are_refused_by_name_and_nothing_moves() {
    let record = run(DeviceConfig::default(), |mut host, _| async move {
        let old = Command::Hello {
            protocol: PROTOCOL_VERSION + 1,
            schema: SCHEMA_HASH,
        };
        let want = PROTOCOL_VERSION;
        assert_eq!(
            host.order(old).await,
            Reply::Refused(Refusal::ProtocolVersion {
                got: want + 1,
                want
            })
        );
        let other = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: !SCHEMA_HASH,
        };
        let want = SCHEMA_HASH;
        assert_eq!(
            host.order(other).await,
            Reply::Refused(Refusal::SchemaHash { got: !want, want })
        );
        assert_eq!(
            host.order(Command::Home).await,
            Reply::Refused(Refusal::NoSession { got: 0xC0FFEE })
        );

        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        assert!(matches!(host.order(hello).await, Reply::Hello(_)));
        let mut far = plan();
        far.views[2].vertical = Micrometres(200_000);
        let refused = far.validate(&Limits::DEFAULT).expect_err("too far");
        assert_eq!(
            host.order(Command::LoadPlan(far)).await,
            Reply::Refused(Refusal::Plan(refused))
        );
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Refused(Refusal::NotConfigured)
        );
        assert_eq!(
            host.order(Command::Retract).await,
            Reply::Refused(Refusal::NotConfigured)
        );
        assert_eq!(host.order(common::stages()).await, Reply::Accepted);
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Refused(Refusal::NotHomed)
        );
        assert_eq!(
            host.order(Command::Retract).await,
            Reply::Refused(Refusal::NotHomed)
        );
        host
    });
    assert_eq!(record.notes.moves(), 0);
    // What the controller drives stays as it was; only the devices and the press have shown themselves.
    for line in [
        "led_enable",
        "camera_trigger",
        "dmd_trigger",
        "head_clear_1",
        "head_clear_2",
        "go",
    ] {
        assert!(record.times(line, true).is_empty(), "{line} rose");
    }
}

/// What an earlier session said is refused once another one is open, word by word.
#[test]
fn a_session_that_is_over_orders_nothing() {
    const OLD: u32 = 0xC0FFEE;
    let record = run(DeviceConfig::default(), |mut host, _| async move {
        host.prepare(plan()).await;
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        let again = [
            common::stages(),
            Command::Home,
            Command::LoadPlan(plan()),
            Command::Start { session: 5 },
            Command::ShowVerdict { go: true },
        ];
        let said = core::iter::once((OLD + 1, hello)).chain(again.map(|order| (OLD, order)));
        for (sequence, (session, order)) in (1000..).zip(said) {
            host.send(session, sequence, &order).await;
            let reply = loop {
                let replies = host.receive().await;
                if let Some((_, reply)) = replies.into_iter().find(|(ack, _)| *ack == sequence) {
                    break reply;
                }
            };
            match order {
                Command::Hello { .. } => assert!(matches!(reply, Reply::Hello(_)), "{reply:?}"),
                _ => assert_eq!(reply, Reply::Refused(Refusal::NoSession { got: OLD })),
            }
        }
        host.keep_company(2_000).await;
        host
    });
    assert_eq!(record.notes.exposures.len(), 0);
    assert!(record.times("go", true).is_empty());
}
