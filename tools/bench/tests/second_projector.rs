//! A head with two projectors: the controller lights and switches the one that the plan says.

mod common;

use common::script::{Record, capture_until_retract, run};
use common::{plan, stages};
use flankscope_bench::devices::{DeviceConfig, DeviceFault};
use flankscope_protocol::{
    CapturePlan, Command, Event, Fault, PROTOCOL_VERSION, Projector, Refusal, Reply, SCHEMA_HASH,
};
use flankscope_sim::Edge;

fn by_both() -> CapturePlan {
    CapturePlan {
        projectors: 2,
        ..plan()
    }
}

/// Runs a plan on a controller with two projectors; a fault is given when the second one's LED is lit for the first time.
fn captured(plan: CapturePlan, spoil: Option<DeviceFault>) -> Record {
    let devices = DeviceConfig {
        second_projector: true,
        ..DeviceConfig::default()
    };
    let second_lit = |event: &Event| {
        matches!(
            event,
            Event::Led {
                projector: Projector::Second,
                on: true,
                ..
            }
        )
    };
    capture_until_retract(devices, plan, second_lit, spoil)
}

/// Asserts that no LED was ever enabled while the other was, or while the other's current still flowed; which ever had current.
fn never_both_lit(edges: &[Edge]) -> [bool; 2] {
    let lines = [["led_enable", "led_sense"], ["led_enable_2", "led_sense_2"]];
    let (mut levels, mut ever) = ([[false; 2]; 2], [false; 2]);
    for edge in edges {
        for (of, names) in lines.iter().enumerate() {
            if let Some(at) = names.iter().position(|name| *name == edge.line) {
                levels[of][at] = edge.level;
                ever[of] |= edge.level;
            }
        }
        let [first, second] = levels.map(|levels| levels.contains(&true));
        assert!(!(first && second), "{edge:?}");
    }
    ever
}

/// What was exposed by the device models is what the plan says of each frame, and no light but that.
#[test]
fn every_exposure_has_the_light_of_one_projector_and_it_is_the_plans() {
    let record = captured(by_both(), None);
    let plan = by_both();
    let frames = usize::from(plan.frames_per_view());
    assert_eq!((frames, record.notes.exposures.len()), (49, 3 * 49));
    for (n, exposure) in record.notes.exposures.iter().enumerate() {
        let spec = plan.frame((n % frames) as u16).expect("of the plan");
        let mut shown = [None; 2];
        shown[spec.projector as usize] = Some(spec.pattern);
        assert_eq!(exposure.shown, shown, "frame {n}");
    }
    assert_eq!(never_both_lit(&record.edges), [true; 2]);
    let fired = record.events.iter().filter_map(|event| match event {
        Event::Triggered(trigger) => Some((trigger.frame, trigger.pattern)),
        _ => None,
    });
    let order = plan.order();
    for (frame, pattern) in fired {
        assert_eq!(order.place(frame).map(|place| place.pattern), Some(pattern));
    }
}

/// One projector's plan leaves the other in peace.
#[test]
fn a_plan_for_one_projector_never_touches_the_second() {
    let record = captured(plan(), None);
    assert!(
        record
            .notes
            .exposures
            .iter()
            .all(|of| of.shown[1].is_none())
    );
    let second = |edge: &&Edge| edge.line.ends_with("_2") && edge.line != "head_clear_2";
    assert_eq!(record.edges.iter().find(second), None);
}

#[test]
fn what_goes_wrong_with_the_second_ends_the_capture_with_both_dark() {
    for (trouble, fault) in [
        (DeviceFault::LedOpen, Fault::LedNotOn),
        (DeviceFault::LedOverheats, Fault::LedLost),
        (DeviceFault::DmdSilent, Fault::DmdSelect),
        (DeviceFault::DmdRefuses, Fault::DmdSelect),
        (DeviceFault::DmdNotReady, Fault::DmdNotReady),
    ] {
        let record = captured(by_both(), Some(trouble));
        assert_eq!(record.faults(), [(fault, 2)], "{trouble:?}");
        never_both_lit(&record.edges);
        let last = |line: &str| {
            let of_line = record.edges.iter().rev().find(|edge| edge.line == line);
            of_line.map(|edge| edge.level)
        };
        for line in [
            "led_enable",
            "led_enable_2",
            "dmd_trigger",
            "camera_trigger",
        ] {
            assert_eq!(last(line), Some(false), "{trouble:?}: {line}");
        }
        assert_ne!(last("dmd_trigger_2"), Some(true));
        // The first one's frames of the first exposure, and perhaps some of the second's.
        assert!(
            (13..25).contains(&record.notes.exposures.len()),
            "{trouble:?}"
        );
    }
}

#[test]
fn a_controller_with_one_projector_says_so_and_refuses_a_plan_for_two() {
    run(DeviceConfig::default(), |mut host, _| async move {
        let hello = Command::Hello {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA_HASH,
        };
        let Reply::Hello(identity) = host.order(hello).await else {
            panic!("refused")
        };
        assert_eq!(identity.projectors, 1);
        assert_eq!(host.order(stages()).await, Reply::Accepted);
        let refused = host.order(Command::LoadPlan(by_both())).await;
        let lacks = Refusal::TooFewProjectors { got: 2, fitted: 1 };
        assert_eq!(refused, Reply::Refused(lacks));
        assert_eq!(host.order(Command::LoadPlan(plan())).await, Reply::Accepted);
        host
    });
}
