//! A head with two projectors: the controller lights and switches the one that the plan says.

mod common;

use common::{Host, Notebook, Notes, plan, stages};
use flankscope_bench::devices::{DeviceConfig, DeviceFault, spawn_all};
use flankscope_controller::sequence::Config;
use flankscope_protocol::{
    CapturePlan, Command, Event, Fault, PROTOCOL_VERSION, Projector, Refusal, Reply, SCHEMA_HASH,
    State,
};
use flankscope_sim::{Clock, Edge, Sim, Wiring, spawn_controller};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

fn by_both() -> CapturePlan {
    CapturePlan {
        projectors: 2,
        ..plan()
    }
}

/// Runs a plan on a controller with two projectors; a fault is given when the second one's LED is lit for the first time.
fn captured(plan: CapturePlan, spoil: Option<DeviceFault>) -> (Vec<Event>, Notes, Vec<Edge>) {
    let sim = Sim::new(Clock::Stepped);
    let wiring = Wiring::new(&sim);
    let devices = DeviceConfig {
        second_projector: true,
        ..DeviceConfig::default()
    };
    let notebook = Notebook::default();
    let world = spawn_all(&sim, &wiring, &devices, notebook.clone());
    spawn_controller(&sim, &wiring, Config::DEFAULT);
    let finished = Rc::new(RefCell::new(None));
    let (result, port) = (Rc::clone(&finished), wiring.host.clone());
    sim.spawn(async move {
        let mut host = Host::new(port);
        let session = plan.session;
        host.prepare(plan).await;
        let start = Command::Start { session };
        assert_eq!(host.order(start).await, Reply::Accepted);
        if let Some(fault) = spoil {
            host.until(|event| {
                matches!(
                    event,
                    Event::Led {
                        projector: Projector::Second,
                        on: true,
                        ..
                    }
                )
            })
            .await;
            world.faults.give(fault);
        }
        host.until(|event| {
            let Event::StateChanged { prev, .. } = event else {
                return false;
            };
            *prev == State::Retracting
        })
        .await;
        let events = host.events.into_iter().map(|(_, event)| event);
        *result.borrow_mut() = Some(events.collect::<Vec<_>>());
    });
    assert!(sim.run_until(|| finished.borrow().is_some()));
    let events = finished.take().expect("finished");
    let notes = notebook.0.borrow().clone();
    (events, notes, sim.edges())
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
    let (events, notes, edges) = captured(by_both(), None);
    let plan = by_both();
    let frames = usize::from(plan.frames_per_view());
    assert_eq!((frames, notes.exposures.len()), (49, 3 * 49));
    for (n, exposure) in notes.exposures.iter().enumerate() {
        let spec = plan.frame((n % frames) as u16).expect("of the plan");
        let mut shown = [None; 2];
        shown[spec.projector as usize] = Some(spec.pattern);
        assert_eq!(exposure.shown, shown, "frame {n}");
    }
    assert_eq!(never_both_lit(&edges), [true; 2]);
    let fired = events.iter().filter_map(|event| match event {
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
    let (_, notes, edges) = captured(plan(), None);
    assert!(notes.exposures.iter().all(|of| of.shown[1].is_none()));
    let second = |edge: &&Edge| edge.line.ends_with("_2") && edge.line != "head_clear_2";
    assert_eq!(edges.iter().find(second), None);
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
        let (events, notes, edges) = captured(by_both(), Some(trouble));
        let found: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                Event::Fault { fault, detail, .. } => fault.known().zip(Some(*detail)),
                _ => None,
            })
            .collect();
        assert_eq!(found, [(fault, 2)], "{trouble:?}");
        never_both_lit(&edges);
        let last = |line: &str| {
            let of_line = edges.iter().rev().find(|edge| edge.line == line);
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
        assert!((13..25).contains(&notes.exposures.len()), "{trouble:?}");
    }
}

#[test]
fn a_controller_with_one_projector_says_so_and_refuses_a_plan_for_two() {
    let sim = Sim::new(Clock::Stepped);
    let wiring = Wiring::new(&sim);
    spawn_all(&sim, &wiring, &DeviceConfig::default(), Notebook::default());
    spawn_controller(&sim, &wiring, Config::DEFAULT);
    let over = Rc::new(Cell::new(false));
    let (told, port) = (Rc::clone(&over), wiring.host.clone());
    sim.spawn(async move {
        let mut host = Host::new(port);
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
        told.set(true);
    });
    assert!(sim.run_until(|| over.get()));
}
