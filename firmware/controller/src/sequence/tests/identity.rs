//! Stages that are asked what they are before they move.

use super::*;

fn name(text: &str) -> StageName {
    StageName::of(text.as_bytes()).expect("printable")
}

/// The station names both models.
fn named() -> StageConfig {
    let mut stage = StageConfig::DEFAULT;
    stage.rotation.model = Some(name("URS150BCC"));
    stage.vertical.model = Some(name("IMS300V"));
    stage
}

const OURS: [&str; 2] = ["URS150BCC, SN0001", "IMS300V, SN0002"];

fn answering(names: [&str; 2]) -> Result<[StageName; 2], StageFault> {
    Ok(names.map(name))
}

/// Configured, and told to home, before stages that answer so.
fn homing(answer: Result<[StageName; 2], StageFault>) -> Rig {
    let mut rig = Rig::new(config());
    rig.world.stages_are = answer;
    rig.sequence.configure(&named());
    rig.order(|sequence, now, out| sequence.home(now, out));
    rig
}

fn moved(rig: &Rig) -> bool {
    let motion = |action: &Action| {
        matches!(
            action,
            Action::Home { .. } | Action::Move { .. } | Action::Retract { .. }
        )
    };
    rig.log.iter().any(|(_, action)| motion(action))
}

/// Axis numbers and answers that the host was told.
fn told(rig: &Rig) -> Vec<(u8, Result<StageName, Fault>)> {
    let told = rig.events().filter_map(|event| match event {
        Event::StageIdentity { axis, answer, .. } => {
            Some((axis, answer.map_err(|code| code.known().expect("known"))))
        }
        _ => None,
    });
    told.collect()
}

#[test]
fn stages_that_answer_as_the_stations_are_referenced_and_captured_with() {
    let mut rig = homing(answering(OURS));
    assert_eq!(rig.sequence.state(), State::Homing);
    rig.run();
    assert_eq!((rig.sequence.state(), rig.faults()), (State::Ready, vec![]));
    let both = [(1, Ok(name(OURS[0]))), (2, Ok(name(OURS[1])))];
    assert_eq!(told(&rig), both);
    rig.sequence.store(plan());
    rig.order(|sequence, now, out| sequence.start(now, out));
    rig.run();
    assert_eq!(rig.faults(), []);
    assert_eq!(told(&rig), [both, both].concat(), "before each capture");
    assert_eq!(rig.triggers().len(), 75);
}

#[test]
fn another_model_moves_nothing_and_is_named() {
    for (names, axis) in [
        (["URS100BCC, SN0001", OURS[1]], 1),
        ([OURS[0], "IMS300LM, SN0001"], 2),
        (["Unknown", "Unknown"], 1),
        // A model is all of what stands before the comma.
        (["URS150BCCV6, SN0001", OURS[1]], 1),
        (["URS150, BCC", OURS[1]], 1),
        (["urs150bcc, SN0001", OURS[1]], 1),
    ] {
        let mut rig = homing(answering(names));
        rig.run();
        assert!(!moved(&rig), "{names:?}");
        assert_eq!(rig.faults(), [Fault::OtherStage]);
        assert_eq!(rig.sequence.state(), State::Faulted);
        let detail = rig.events().find_map(|event| match event {
            Event::Fault { detail, .. } => Some(detail),
            _ => None,
        });
        assert_eq!(detail, Some(axis));
        assert_eq!(told(&rig).len(), 2);
        // Acknowledged, it is as never homed, and asked again.
        rig.order(|sequence, now, out| sequence.acknowledge(now, out));
        assert_eq!(rig.sequence.state(), State::Unhomed);
        rig.world.stages_are = answering(OURS);
        rig.order(|sequence, now, out| sequence.home(now, out));
        rig.run();
        assert_eq!(rig.sequence.state(), State::Ready);
    }
}

#[test]
fn stages_that_do_not_answer_move_nothing() {
    for fault in [Fault::StageSilent, Fault::StageReply] {
        let mut rig = homing(Err(StageFault { fault, detail: 0 }));
        rig.run();
        assert!(!moved(&rig));
        assert_eq!(rig.faults(), [fault]);
        assert_eq!(told(&rig), [(1, Err(fault)), (2, Err(fault))]);
    }
    let mut rig = Rig::new(config());
    rig.world.stages_mute = true;
    rig.sequence.configure(&named());
    rig.order(|sequence, now, out| sequence.home(now, out));
    rig.run();
    assert!(!moved(&rig));
    assert_eq!(rig.faults(), [Fault::StageSilent], "within its time");
}

/// Somebody changed a stage while the controller ran on: it was homed, and must not even be retracted.
#[test]
fn stages_that_were_changed_between_two_captures_do_not_move() {
    let mut rig = homing(answering(OURS));
    rig.run();
    rig.sequence.store(plan());
    rig.log.clear();
    rig.world.stages_are = answering([OURS[0], "IMS100V, SN0001"]);
    // Whichever comes first, the answer or the interlock's leave.
    for leave_first in [true, false] {
        let mut rig = rig.clone();
        rig.world.stages_mute = leave_first;
        rig.order(|sequence, now, out| sequence.start(now, out));
        if leave_first {
            rig.input(Input::MayEnter);
            assert_eq!(rig.sequence.state(), State::Claiming);
            let (ticket, outcome) = (rig.sequence.ticket, rig.world.stages_are);
            rig.input(Input::StagesAre { ticket, outcome });
        }
        rig.run();
        assert!(!moved(&rig), "{leave_first}");
        assert_eq!(rig.faults(), [Fault::OtherStage]);
        assert!(!rig.sequence.homed());
    }
}

#[test]
fn a_station_that_names_none_asks_nobody() {
    let mut rig = Rig::started(config(), plan());
    rig.world.stages_are = answering(["Unknown", "Unknown"]);
    rig.run();
    assert_eq!((told(&rig), rig.faults()), (vec![], vec![]));
    assert_eq!(rig.triggers().len(), 75);
}

#[test]
fn who_only_asks_moves_nothing_and_spoils_nothing() {
    for answer in [
        answering(["Unknown", "Unknown"]),
        Err(StageFault {
            fault: Fault::StageSilent,
            detail: 0,
        }),
    ] {
        let mut fresh = Rig::new(config());
        fresh.sequence.configure(&named());
        let ready = Rig::homed(config(), plan());
        for mut rig in [fresh, ready] {
            let state = rig.sequence.state();
            rig.world.stages_are = answer;
            rig.order(|sequence, _, out| sequence.identify(out));
            rig.run();
            assert!(!moved(&rig));
            assert_eq!((rig.sequence.state(), rig.faults()), (state, vec![]));
            assert_eq!(told(&rig).len(), 2);
        }
    }
}
