//! What a station says of its stages: accepted before anything moves, refused by name beyond the controller's limits, and then
//! what the stages do.

mod common;

use common::script::{self, Setup};
use common::{Host, plan, stages};
use flankscope_protocol::stage::STAGE_CONFIG_VERSION;
use flankscope_protocol::*;

const HELLO: Command = Command::Hello {
    protocol: PROTOCOL_VERSION,
    schema: SCHEMA_HASH,
};

fn told(change: impl FnOnce(&mut StageConfig)) -> Command {
    let mut stage = StageConfig::DEFAULT;
    change(&mut stage);
    Command::ConfigureStage {
        version: STAGE_CONFIG_VERSION,
        stage,
    }
}

/// Runs a script; returns its host's events and how often the stages were sent elsewhere. `line`: how the stage controller's port is set.
fn run<F: Future<Output = Host> + 'static>(
    line: Option<Line>,
    script: impl FnOnce(Host) -> F,
) -> (Vec<Event>, usize) {
    let setup = Setup {
        stage_line: line,
        ..Setup::default()
    };
    let record = script::run(setup, |host, _| script(host));
    // The press shows itself whatever the stages do.
    let of_press = |event: &Event| matches!(event, Event::PressOpen { .. });
    let events = record.events.into_iter().filter(|event| !of_press(event));
    (events.collect(), record.notes.moves())
}

fn ready(event: &Event) -> bool {
    let next = match event {
        Event::StateChanged { next, .. } => *next,
        _ => return false,
    };
    matches!(next, State::Ready | State::Faulted)
}

#[test]
fn nothing_moves_before_stages_were_accepted_in_this_session() {
    let (events, moves) = run(None, |mut host| async move {
        assert!(matches!(host.order(HELLO).await, Reply::Hello(_)));
        let unconfigured = Reply::Refused(Refusal::NotConfigured);
        for order in [
            Command::Home,
            Command::Start { session: 5 },
            Command::Retract,
        ] {
            assert_eq!(host.order(order).await, unconfigured);
        }
        // A refused one is none.
        let fast = told(|stage| stage.vertical.speed.0 = 300_001);
        let refused = StageError::Outside {
            what: StageValue::VerticalSpeed,
            got: 300_001,
            min: 1,
            max: 300_000,
        };
        assert_eq!(host.order(fast).await, Reply::Refused(refused.into()));
        let Command::ConfigureStage { version, stage } = stages() else {
            unreachable!()
        };
        let later = Command::ConfigureStage {
            version: version + 1,
            stage,
        };
        let refused = StageError::Version {
            got: version + 1,
            want: version,
        };
        assert_eq!(host.order(later).await, Reply::Refused(refused.into()));
        assert_eq!(host.order(Command::Home).await, unconfigured);
        host
    });
    assert_eq!((events.len(), moves), (0, 0));
}

/// Every number beyond its limit, both ways, and every travel that is none.
#[test]
fn every_number_beyond_its_limit_is_refused_and_nothing_moves() {
    type Change = fn(&mut StageConfig);
    let changes: [(StageValue, Change); 19] = [
        (StageValue::Baud, |s| s.line.baud = 19_199),
        (StageValue::Baud, |s| s.line.baud = u32::MAX),
        (StageValue::RotationNumber, |s| s.rotation.number = 0),
        (StageValue::RotationSpeed, |s| s.rotation.speed.0 = u32::MAX),
        (StageValue::RotationAcceleration, |s| {
            s.rotation.acceleration.0 = 0;
        }),
        (StageValue::RotationFrom, |s| s.rotation.from.0 = i32::MIN),
        (StageValue::RotationTo, |s| s.rotation.to.0 = i32::MAX),
        (StageValue::RotationTo, |s| s.rotation.to.0 = i32::MIN),
        (StageValue::RotationHome, |s| s.rotation.home.0 = 6_283_186),
        (StageValue::RotationHomeSpeed, |s| {
            s.rotation.home_speed.0 = 0
        }),
        (StageValue::RotationHomeSpeed, |s| {
            s.rotation.home_speed.0 = 1
        }),
        (StageValue::VerticalNumber, |s| s.vertical.number = u8::MAX),
        (StageValue::VerticalSpeed, |s| s.vertical.speed.0 = 0),
        (StageValue::VerticalAcceleration, |s| {
            s.vertical.acceleration.0 = 5_000_001;
        }),
        (StageValue::VerticalFrom, |s| s.vertical.from.0 = 1),
        (StageValue::VerticalTo, |s| s.vertical.to.0 = 150_001),
        (StageValue::VerticalHome, |s| s.vertical.home.0 = -150_001),
        (StageValue::VerticalHomeSpeed, |s| {
            s.vertical.home_speed.0 = 300_001
        }),
        (StageValue::VerticalSpeed, |s| s.vertical.speed.0 = 100),
    ];
    let (events, moves) = run(None, |mut host| async move {
        assert!(matches!(host.order(HELLO).await, Reply::Hello(_)));
        for (which, change) in changes {
            let Reply::Refused(Refusal::Stage(error)) = host.order(told(change)).await else {
                panic!("{which:?} was accepted")
            };
            let (StageError::Outside { what, .. }
            | StageError::Inverted { what, .. }
            | StageError::TooSlow { what, .. }) = error
            else {
                panic!("{which:?}: {error}")
            };
            assert_eq!(what, which, "{error}");
        }
        assert_eq!(
            host.order(Command::Home).await,
            Reply::Refused(Refusal::NotConfigured)
        );
        host
    });
    assert_eq!((events.len(), moves), (0, 0));
}

#[test]
fn other_stages_are_refused_while_they_move_and_need_a_new_home() {
    let (events, _) = run(None, |mut host| async move {
        host.prepare(plan()).await;
        let slow = told(|stage| stage.vertical.speed.0 = 50_000);
        let busy = |state| Reply::Refused(Refusal::Busy { state });
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Accepted
        );
        assert_eq!(host.order(slow.clone()).await, busy(State::Claiming));
        host.until(|event| {
            let next = State::Moving;
            matches!(event, Event::StateChanged { next: now, .. } if *now == next)
        })
        .await;
        assert_eq!(host.order(slow.clone()).await, busy(State::Moving));
        host.until(|event| matches!(event, Event::Triggered(_)))
            .await;
        assert_eq!(host.order(slow.clone()).await, busy(State::Capturing));
        // The same ones, too: nothing is looked at while they move.
        assert_eq!(host.order(stages()).await, busy(State::Capturing));
        host.until(|event| matches!(event, Event::CaptureDone { .. }))
            .await;
        // The same ones change nothing; others have no home, and no plan.
        assert_eq!(host.order(stages()).await, Reply::Accepted);
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        assert!(status.homed && status.plan.is_some());
        assert_eq!(host.order(slow).await, Reply::Accepted);
        let Reply::Status(status) = host.order(Command::Status).await else {
            panic!("no status")
        };
        assert_eq!((status.homed, status.plan), (false, None));
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Refused(Refusal::NotHomed)
        );
        // And a new session has none at all.
        assert!(matches!(host.order(HELLO).await, Reply::Hello(_)));
        assert_eq!(
            host.order(Command::Home).await,
            Reply::Refused(Refusal::NotConfigured)
        );
        host
    });
    let faults = events
        .iter()
        .filter(|event| matches!(event, Event::Fault { .. }));
    assert_eq!(faults.count(), 0, "{events:?}");
}

/// Time from home to the first view, by the controller's clock: 67 mm at the speed that the station says.
fn way_us(change: fn(&mut StageConfig)) -> u64 {
    let (events, _) = run(None, move |mut host| async move {
        assert!(matches!(host.order(HELLO).await, Reply::Hello(_)));
        assert_eq!(host.order(told(change)).await, Reply::Accepted);
        assert_eq!(host.order(Command::Home).await, Reply::Accepted);
        host.until(ready).await;
        assert_eq!(host.order(Command::LoadPlan(plan())).await, Reply::Accepted);
        assert_eq!(
            host.order(Command::Start { session: 5 }).await,
            Reply::Accepted
        );
        host.until(|event| matches!(event, Event::InPosition { .. } | Event::Fault { .. }))
            .await;
        host
    });
    let at = |of: fn(&Event) -> Option<u64>| {
        events
            .iter()
            .find_map(of)
            .unwrap_or_else(|| panic!("{events:?}"))
    };
    let begun = at(|event| match event {
        Event::StateChanged {
            next: State::Moving,
            at,
            ..
        } => Some(at.get()),
        _ => None,
    });
    let stood = at(|event| match event {
        Event::InPosition { at, .. } => Some(at.get()),
        _ => None,
    });
    stood - begun
}

#[test]
fn the_stages_move_as_the_station_says() {
    let view = plan().views[0];
    let from = StageConfig::DEFAULT;
    for change in [
        (|_| {}) as fn(&mut StageConfig),
        |stage| stage.vertical.speed.0 = 60_000,
        |stage| stage.vertical.acceleration.0 = 400_000,
        |stage| stage.rotation.speed.0 = 20_000,
    ] {
        let mut stage = from;
        change(&mut stage);
        let turn = stage
            .rotation
            .travel_time(stage.rotation.home, view.rotation);
        let lift = stage
            .vertical
            .travel_time(stage.vertical.home, view.vertical);
        let (closed, seen) = (u64::from(turn.max(lift).get()), way_us(change));
        // Asked every 5 ms whether they stand. On the wire: an order of up to 40 characters, questions and answers of a look that came
        // just too early, 16, and of the one that finds them standing, 91.
        let wire_us = (40 + 16 + 91) * stage.line.byte_ns() / 1_000;
        assert!(
            (closed..closed + 5_000 + wire_us).contains(&seen),
            "{closed} us by the closed form, {seen} us"
        );
    }
}

/// A station that says another line than the stage controller has: no answer is understood, a fault by name, nothing moves.
#[test]
fn a_line_that_differs_is_a_silent_stage() {
    let slow = Line {
        baud: 19_200,
        ..StageConfig::DEFAULT.line
    };
    for (said, works) in [(slow, true), (StageConfig::DEFAULT.line, false)] {
        let (events, moves) = run(Some(slow), move |mut host| async move {
            assert!(matches!(host.order(HELLO).await, Reply::Hello(_)));
            assert_eq!(
                host.order(told(move |stage| stage.line = said)).await,
                Reply::Accepted
            );
            assert_eq!(host.order(Command::Home).await, Reply::Accepted);
            host.until(ready).await;
            host
        });
        let faults: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                Event::Fault { fault, .. } => fault.known(),
                _ => None,
            })
            .collect();
        // A search for home ends where the stages stood.
        assert_eq!(moves, 0);
        let homed = events.iter().any(
            |event| matches!(event, Event::StateChanged { next, .. } if *next == State::Ready),
        );
        let silent = if works {
            vec![]
        } else {
            vec![Fault::StageSilent]
        };
        assert_eq!((homed, faults), (works, silent));
    }
}
