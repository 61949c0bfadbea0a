//! The interlock with its clock, by hand-stepped time.

use super::*;

const OPEN: Levels = Levels {
    press_open_a: true,
    press_open_b: false,
    die_clear: true,
    guard_closed: true,
    cycle: false,
    retract_switch: true,
};
const OUT: Head = Head {
    position: Position::Retracted,
    host_alive: true,
};
const IN: Head = Head {
    position: Position::Away,
    host_alive: true,
};
const RELEASE: Orders = Orders {
    release: true,
    enter: false,
    retract: false,
};
const ENTER: Orders = Orders {
    release: false,
    enter: true,
    retract: false,
};
const NONE: Orders = Orders {
    release: false,
    enter: false,
    retract: false,
};

fn ms(ms: u64) -> Timestamp {
    Timestamp(ms * 1_000)
}

/// Entered at 300 ms, with the head away from its switch.
fn entered() -> Interlock {
    let mut interlock = Interlock::new(Timing::DEFAULT);
    interlock.sample_inputs(ms(0), OPEN, OUT, RELEASE);
    interlock.sample_inputs(ms(1), OPEN, OUT, NONE);
    assert!(interlock.outputs().head_clear);
    interlock.sample_inputs(ms(200), OPEN, OUT, ENTER);
    assert_eq!(interlock.outputs(), Outputs::default());
    assert_eq!(interlock.deadline(ms(200)), Some(ms(300)));
    assert!(!interlock.sample_inputs(ms(299), OPEN, OUT, NONE).entered);
    assert!(interlock.sample_inputs(ms(300), OPEN, OUT, NONE).entered);
    let away = Levels {
        retract_switch: false,
        ..OPEN
    };
    interlock.sample_inputs(ms(400), away, IN, NONE);
    assert!(interlock.outputs().may_enter);
    interlock
}

#[test]
fn one_channel_alone_starts_the_retract_at_once_and_locks() {
    for (a, b) in [(true, true), (false, false), (false, true)] {
        let mut interlock = entered();
        let lost = Levels {
            press_open_a: a,
            press_open_b: b,
            retract_switch: false,
            ..OPEN
        };
        let change = interlock.sample_inputs(ms(500), lost, IN, NONE);
        assert_eq!(change.fault, Some(Fault::PressNotOpen));
        assert_eq!(change.press_open, Some(false));
        assert!(interlock.outputs().retract);
        // Out again, and well again: still locked, whatever is ordered but a release.
        interlock.sample_inputs(ms(900), OPEN, OUT, NONE);
        for orders in [NONE, ENTER] {
            interlock.sample_inputs(ms(901), OPEN, OUT, orders);
            assert_eq!(
                interlock.state().phase,
                Phase::Locked(Some(Fault::PressNotOpen))
            );
        }
        assert_eq!(interlock.objection(), Some(Fault::PressNotOpen));
        interlock.sample_inputs(ms(902), OPEN, OUT, RELEASE);
        interlock.sample_inputs(ms(903), OPEN, OUT, NONE);
        assert!(interlock.outputs().head_clear);
    }
}

#[test]
fn channels_may_disagree_for_the_discrepancy_time_and_no_longer() {
    let clear = || {
        let mut interlock = Interlock::new(Timing::DEFAULT);
        interlock.sample_inputs(ms(0), OPEN, OUT, RELEASE);
        interlock.sample_inputs(ms(1), OPEN, OUT, NONE);
        interlock
    };
    let both = Levels {
        press_open_b: true,
        ..OPEN
    };
    let mut brief = clear();
    brief.sample_inputs(ms(100), both, OUT, NONE);
    assert_eq!(brief.deadline(ms(100)), Some(ms(600)));
    brief.sample_inputs(ms(599), OPEN, OUT, NONE);
    brief.sample_inputs(ms(10_000), OPEN, OUT, NONE);
    assert!(brief.outputs().head_clear);

    let mut long = clear();
    long.sample_inputs(ms(100), both, OUT, NONE);
    let change = long.sample_inputs(ms(600), both, OUT, NONE);
    assert_eq!(change.fault, Some(Fault::PressSignal));
    assert!(!long.outputs().head_clear);
}

#[test]
fn press_is_open_only_where_both_channels_say_so() {
    for (a, b, is_open) in [
        (false, false, false),
        (false, true, false),
        (true, true, false),
        (true, false, true),
    ] {
        let levels = Levels {
            press_open_a: a,
            press_open_b: b,
            ..OPEN
        };
        let interlock = Interlock::new(Timing::DEFAULT);
        let inputs = interlock.inputs(levels, NONE, Expired::default(), false);
        assert_eq!(inputs.press_open(), is_open, "{a} {b}");
    }
}

#[test]
fn expired_time_without_effect_is_not_waited_for_again() {
    // Never released, so that the channels' disagreement has nothing left to lock.
    let mut interlock = Interlock::new(Timing::DEFAULT);
    let disagreeing = Levels {
        press_open_b: true,
        ..OPEN
    };
    interlock.sample_inputs(ms(100), disagreeing, OUT, NONE);
    assert_eq!(interlock.deadline(ms(100)), Some(ms(600)));
    interlock.sample_inputs(ms(600), disagreeing, OUT, NONE);
    assert_eq!(interlock.deadline(ms(600)), None);
}

#[test]
fn a_head_that_does_not_come_out_locks_with_head_clear_low() {
    let mut interlock = entered();
    let away = Levels {
        retract_switch: false,
        ..OPEN
    };
    let retract = Orders {
        retract: true,
        ..NONE
    };
    interlock.sample_inputs(ms(500), away, IN, retract);
    assert_eq!(interlock.deadline(ms(500)), Some(ms(6_500)));
    let change = interlock.sample_inputs(ms(6_500), away, IN, retract);
    assert_eq!(change.fault, Some(Fault::RetractFailed));
    assert_eq!(interlock.outputs(), Outputs::default());
}

#[test]
fn a_press_held_for_too_long_is_let_go_whatever_the_host_says() {
    // Entered at 300 ms; the time runs from 200 ms, when the press lost head-clear.
    let mut interlock = entered();
    let away = Levels {
        retract_switch: false,
        ..OPEN
    };
    assert_eq!(interlock.deadline(ms(400)), Some(ms(60_200)));
    assert_eq!(
        interlock.sample_inputs(ms(60_199), away, IN, NONE),
        Change::default()
    );
    let change = interlock.sample_inputs(ms(60_200), away, IN, NONE);
    assert_eq!(change.fault, Some(Fault::HoldLimit));
    assert!(interlock.outputs().retract);
    // Said once only, and an order to enter changes nothing.
    assert_eq!(
        interlock.sample_inputs(ms(60_300), away, IN, ENTER).fault,
        None
    );
    interlock.sample_inputs(ms(61_000), OPEN, OUT, NONE);
    assert!(interlock.outputs().head_clear);
    // The next stay has its whole time again.
    interlock.sample_inputs(ms(62_000), OPEN, OUT, ENTER);
    assert_eq!(interlock.deadline(ms(62_000)), Some(ms(62_100)));
    assert!(interlock.sample_inputs(ms(62_100), OPEN, OUT, NONE).entered);
    assert_eq!(interlock.deadline(ms(62_100)), Some(ms(122_000)));
}

#[test]
fn cycles_are_counted_by_their_rising_edge() {
    let mut interlock = Interlock::new(Timing::DEFAULT);
    for n in 0..10u64 {
        let levels = Levels {
            cycle: n % 3 == 1,
            ..OPEN
        };
        interlock.sample_inputs(ms(n), levels, OUT, NONE);
        interlock.sample_inputs(ms(n), levels, OUT, NONE);
    }
    assert_eq!(interlock.cycles(), 3);
}
