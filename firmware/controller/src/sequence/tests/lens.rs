//! Captures through a liquid lens.

use super::*;
use crate::lens::LensFault;
use flankscope_protocol::{Focus, LensCounts};

const FOCUS: Focus = Focus {
    counts: LensCounts(541),
    // Longer than a move and its settle together.
    settle: Microseconds(900_000),
};

fn focused() -> CapturePlan {
    CapturePlan {
        focus: Some(FOCUS),
        ..plan()
    }
}

fn spoiled(fault: Fault) -> Result<(), LensFault> {
    Err(LensFault { fault, detail: 7 })
}

#[test]
fn the_lens_has_its_voltage_from_before_the_first_move_and_rests_before_the_first_light() {
    let mut rig = Rig::started(config(), focused());
    rig.run();
    let step = |wanted: fn(&Action) -> bool| {
        let found = rig.log.iter().position(|(_, action)| wanted(action));
        found.expect("it happened")
    };
    let set = step(|action| *action == Action::SetLens(FOCUS.counts));
    assert!(set < step(|action| matches!(action, Action::Move { .. })));
    let lit = step(|action| matches!(action, Action::LedOn(..)));
    let [(set, _), (lit, _)] = [rig.log[set], rig.log[lit]];
    assert!(lit >= set.after(FOCUS.settle), "{set} {lit}");
    let checks = |(_, action): &&(Timestamp, Action)| *action == Action::CheckLens(FOCUS.counts);
    assert_eq!(rig.log.iter().filter(checks).count(), focused().views.len());
    assert_eq!((rig.world.lens, rig.faults()), (None, vec![]));
    assert_eq!(rig.sequence.state(), State::Ready);
    // All else is as without a lens.
    let mut plain = Rig::started(config(), plan());
    plain.run();
    let shown = |rig: &Rig| -> Vec<_> {
        let frames = rig.triggers().into_iter();
        frames.map(|frame| (frame.view, frame.pattern)).collect()
    };
    assert_eq!(shown(&rig), shown(&plain));
    assert!(!plain.log.iter().any(|(_, action)| matches!(
        action,
        Action::SetLens(_) | Action::CheckLens(_) | Action::LensOff
    )));
}

#[test]
fn a_lens_that_fails_at_the_start_moves_nothing_towards_the_die() {
    let mut rig = Rig::homed(config(), focused());
    rig.world.lens_says = spoiled(Fault::LensOpen);
    rig.order(|sequence, now, out| sequence.start(now, out));
    rig.run();
    assert_eq!(rig.faults(), [Fault::LensOpen]);
    assert_eq!(rig.sequence.state(), State::Faulted);
    let moved = |(_, action): &(Timestamp, Action)| matches!(action, Action::Move { .. });
    assert!(!rig.log.iter().any(moved));
    assert_eq!(rig.world.lens, None);
}

#[test]
fn however_a_capture_ends_the_lens_is_off_behind_it() {
    let mut rig = Rig::started(config(), focused());
    let (mut ends, mut lost) = (0, 0);
    loop {
        let mut aborted = rig.clone();
        aborted.order(|sequence, now, out| sequence.abort(now, out));
        let mut hot = rig.clone();
        hot.world.lens_says = spoiled(Fault::LensHot);
        for (end, mut rig) in [("abort", aborted), ("lens", hot)] {
            rig.run();
            assert_eq!(rig.world.lens, None, "{end} in {:?}", rig.sequence.step);
            assert!(rig.dark());
            lost += u32::from(rig.faults() == [Fault::LensHot]);
        }
        ends += 1;
        if !rig.advance() {
            break;
        }
    }
    // Asked before each view: it is found in every step but those from the last question on.
    let last = rig
        .log
        .iter()
        .rposition(|(_, action)| matches!(action, Action::CheckLens(_)));
    assert!(
        last.is_some() && lost > ends / 2 && lost < ends,
        "{lost} of {ends}"
    );
}
