//! What ends a capture early: the host, the press, devices that fail.

use super::*;

#[test]
fn an_abort_or_retract_at_any_step_darkens_at_once_and_brings_the_head_out() {
    for rig in every_step() {
        for stop in [true, false] {
            let mut rig = rig.clone();
            let (capturing, before) = (rig.sequence.capturing(), rig.log.len());
            rig.order(|sequence, now, out| {
                if stop {
                    sequence.abort(now, out)
                } else {
                    sequence.retract(now, out)
                }
            });
            let halted = rig.log[before..]
                .iter()
                .any(|(_, action)| *action == Action::StopStages);
            assert_eq!(halted, stop && capturing);
            assert!(rig.dark(), "in {:?}", rig.sequence.step);
            let taken = rig.triggers().len();
            rig.run();
            assert_eq!(
                rig.triggers().len(),
                taken,
                "a frame was taken after the order"
            );
            assert_eq!(
                (rig.sequence.state(), rig.world.pose.vertical),
                (State::Ready, RETRACTED)
            );
            assert_eq!(rig.faults(), []);
        }
    }
}

#[test]
fn a_host_that_falls_silent_at_any_step_ends_the_capture_in_time() {
    let mut silenced = 0;
    for mut rig in every_step() {
        rig.world.host_alive = false;
        let capturing = rig.sequence.capturing();
        let limit = rig.sequence.host_heard.after(config().host_silence);
        for _ in 0..10_000 {
            if !rig.sequence.capturing() || !rig.advance() {
                break;
            }
        }
        if capturing && rig.sequence.fault().is_some() {
            assert_eq!(
                (rig.sequence.fault(), rig.now),
                (Some(Fault::HostSilent), limit)
            );
            assert!(rig.dark());
            silenced += 1;
        } else if capturing {
            assert!(
                rig.now <= limit,
                "the capture went on without a host until {:?}",
                rig.now
            );
        }
        rig.run();
        assert_eq!(rig.world.pose.vertical, RETRACTED);
    }
    assert!(silenced > 300, "only {silenced} captures were ended");
}

#[test]
fn devices_that_stop_answering_at_any_step_end_in_the_right_fault() {
    let mut seen = Vec::new();
    for mut rig in every_step() {
        let state = rig.sequence.step;
        rig.world.frozen = true;
        let begun = rig.now;
        rig.run();
        if state == Step::Ready {
            continue;
        }
        let cause = rig.sequence.fault().expect("a fault");
        let expected = match state {
            Step::Moving { .. } => vec![Fault::MotionTimeout],
            Step::Settling { .. } | Step::Lighting => vec![Fault::LedNotOn],
            // The selection follows the light in the same step, the next frame the end of the last.
            Step::Selecting { .. } | Step::Loading { .. } => vec![Fault::DmdSelect],
            Step::Switching { .. } => vec![Fault::DmdNotReady],
            Step::Standing { .. } | Step::Holding { .. } | Step::Arming { .. } => {
                vec![Fault::CameraNotReady]
            }
            Step::Exposing {
                begin_by: Some(_), ..
            } => vec![Fault::CameraNoExposure],
            Step::Exposing { begin_by: None, .. } | Step::Closing { .. } => {
                vec![Fault::CameraStuck]
            }
            Step::Darkening { .. } => vec![Fault::LedStuckOn],
            // The LED's fall may still be unconfirmed.
            Step::Retracting { .. } => vec![Fault::RetractFailed, Fault::LedStuckOn],
            other => panic!("{other:?} in a capture"),
        };
        assert!(expected.contains(&cause), "{cause:?} out of {state:?}");
        assert!(rig.dark());
        // Nothing came out: the position is not known, and homing is needed before anything else.
        assert!(!rig.sequence.homed());
        assert_eq!(rig.sequence.state(), State::Faulted);
        let longest = u64::from(plan().timeouts.motion.get())
            + u64::from(config().retract_timeout.get())
            + 200_000;
        assert!(rig.now.since_us(begun) <= longest);
        seen.push(cause);
    }
    for fault in [
        Fault::MotionTimeout,
        Fault::LedNotOn,
        Fault::DmdNotReady,
        Fault::CameraNotReady,
        Fault::CameraNoExposure,
        Fault::CameraStuck,
        Fault::LedStuckOn,
        Fault::RetractFailed,
    ] {
        assert!(seen.contains(&fault), "{fault:?} was never provoked");
    }
}

#[test]
fn a_fault_at_any_step_darkens_at_once_retracts_and_waits() {
    let disturbances: [fn(&Sequence) -> Input; 3] = [
        |sequence| Input::StageFailed {
            ticket: sequence.ticket,
            fault: Fault::StageError,
            detail: 106,
        },
        |_| Input::EventsLost,
        |sequence| {
            let projector = sequence.shows();
            Input::LedSense(projector, sequence.lamps.enabled() != Some(projector))
        },
    ];
    let mut provoked = 0;
    for rig in every_step() {
        for disturb in disturbances {
            let mut rig = rig.clone();
            let retracting = matches!(rig.sequence.step, Step::Retracting { .. });
            let input = disturb(&rig.sequence);
            rig.input(input);
            if rig.sequence.fault().is_none() {
                if retracting && matches!(input, Input::StageFailed { .. }) {
                    // The head must come out: tried again.
                    rig.run();
                    assert_eq!(rig.sequence.fault(), None);
                    assert_eq!(rig.world.pose.vertical, RETRACTED);
                    continue;
                }
                // The sense may still be on its way to where it should be.
                assert!(matches!(input, Input::LedSense(..)));
                continue;
            }
            provoked += 1;
            assert!(rig.dark(), "after {input:?}");
            let cause = rig.sequence.fault();
            let taken = rig.triggers().len();
            rig.run();
            assert_eq!(rig.triggers().len(), taken);
            assert_eq!(
                (rig.sequence.state(), rig.sequence.fault()),
                (State::Faulted, cause)
            );
            let stage_died = retracting && matches!(input, Input::StageFailed { .. });
            assert_eq!(rig.sequence.homed(), !stage_died);
            if !stage_died {
                assert_eq!(rig.world.pose.vertical, RETRACTED);
            }
            rig.order(|sequence, now, out| sequence.acknowledge(now, out));
            let next = if stage_died {
                State::Unhomed
            } else {
                State::Ready
            };
            assert_eq!((rig.sequence.state(), rig.sequence.fault()), (next, None));
        }
    }
    assert!(provoked > 1_000, "only {provoked} faults");
}

#[test]
fn an_led_that_goes_its_own_way_is_a_fault() {
    let mut provoked = (0, 0);
    for mut rig in every_step() {
        match rig.sequence.state() {
            State::Capturing => {
                rig.input(Input::LedSense(rig.sequence.shows(), false));
                assert_eq!(rig.sequence.fault(), Some(Fault::LedLost));
                provoked.0 += 1;
            }
            State::Moving | State::Settling => {
                rig.input(Input::LedSense(Projector::First, true));
                assert_eq!(rig.sequence.fault(), Some(Fault::LedStuckOn));
                provoked.1 += 1;
            }
            _ => {}
        }
    }
    assert!(provoked.0 > 300 && provoked.1 >= 6, "{provoked:?}");
}

#[test]
fn a_current_that_flows_after_a_reset_has_its_time_to_be_gone() {
    for (gone_ms, fault) in [(0, None), (49, None), (51, Some(Fault::LedStuckOn))] {
        let mut rig = Rig::new(config());
        rig.world.leds[0].flips_at = Timestamp(gone_ms * 1_000);
        rig.run();
        assert_eq!(rig.sequence.fault(), fault, "gone after {gone_ms} ms");
        // Once it is gone it stays so.
        rig.input(Input::LedSense(Projector::First, true));
        assert_eq!(rig.sequence.fault(), Some(Fault::LedStuckOn));
    }
}

#[test]
fn a_stage_that_stops_beside_its_target_is_a_fault() {
    for (rotation, vertical, fault) in [
        (786, 15, None),
        (787, 0, Some(Fault::OffPosition)),
        (0, -16, Some(Fault::OffPosition)),
    ] {
        let mut rig = Rig::started(config(), plan());
        let (_, ticket, view) = rig.world.motion.take().expect("moving");
        rig.input(Input::InPosition {
            ticket,
            rotation: Microradians(view.rotation.get() + rotation),
            vertical: Micrometres(view.vertical.get() + vertical),
        });
        assert_eq!(rig.sequence.fault(), fault);
    }
}

#[test]
fn an_answer_to_an_overtaken_request_is_ignored() {
    let mut rig = Rig::started(config(), plan());
    let (_, ticket, view) = rig.world.motion.expect("moving");
    rig.order(|sequence, now, out| sequence.abort(now, out));
    let before = rig.sequence.step;
    rig.input(Input::InPosition {
        ticket,
        rotation: view.rotation,
        vertical: view.vertical,
    });
    rig.input(Input::StageFailed {
        ticket,
        fault: Fault::StageError,
        detail: 1,
    });
    assert_eq!((rig.sequence.step, rig.sequence.fault()), (before, None));
}

#[test]
fn a_hot_led_cools_before_the_next_view_and_never_exceeds_its_budget() {
    let limits = Limits {
        led_on_max: Microseconds(900_000),
        led_duty_permille: 200,
        ..Limits::DEFAULT
    };
    let mut rig = Rig::started(Config { limits, ..config() }, plan());
    while rig.advance() {
        assert!(
            rig.sequence
                .lamps
                .of(Projector::First)
                .budget()
                .used_us(rig.now)
                <= 900_000
        );
    }
    assert_eq!(rig.faults(), [Fault::LedCooling, Fault::LedCooling]);
    assert_eq!(rig.triggers().len(), 75);
    assert_eq!(
        (rig.sequence.state(), rig.sequence.fault()),
        (State::Ready, None)
    );
}

#[test]
fn devices_that_dawdle_use_up_the_led_budget() {
    let limits = Limits {
        led_on_max: Microseconds(820_000),
        ..Limits::DEFAULT
    };
    let mut rig = Rig::started(Config { limits, ..config() }, plan());
    // Each pattern takes 40 ms instead of 0.7, still within its timeout.
    rig.world.dmd_switch_us = 40_000;
    rig.run();
    assert_eq!(rig.sequence.fault(), Some(Fault::LedBudget));
    assert!(rig.dark());
}

#[test]
fn an_exposure_that_comes_out_too_long_is_a_fault() {
    for (lateness_us, fault) in [(100, None), (101, Some(Fault::ExposureWidth))] {
        let mut rig = Rig::started(config(), plan());
        while !matches!(rig.sequence.step, Step::Exposing { begin_by: None, .. }) {
            rig.advance();
        }
        rig.world.lateness_us = lateness_us;
        while matches!(rig.sequence.step, Step::Exposing { .. }) {
            rig.advance();
        }
        assert_eq!(rig.sequence.fault(), fault);
    }
}

#[test]
fn a_press_that_is_never_held_is_a_fault_and_nothing_moves() {
    let mut rig = Rig::new(config());
    rig.order(|sequence, now, out| sequence.home(now, out));
    rig.run();
    rig.sequence.store(plan());
    rig.log.clear();
    rig.order(|sequence, now, out| sequence.start(now, out));
    let begun = rig.now;
    // Nobody says that the head may enter.
    rig.world.host_alive = true;
    while rig.sequence.state() == State::Claiming {
        rig.now = rig.now.after(Microseconds(50_000));
        rig.input(Input::HostAlive);
    }
    assert_eq!(rig.sequence.fault(), Some(Fault::InterlockLocked));
    assert_eq!(
        rig.now.since_us(begun),
        u64::from(config().claim_timeout.get())
    );
    assert!(
        !rig.log
            .iter()
            .any(|(_, action)| matches!(action, Action::Move { .. }))
    );
}

#[test]
fn an_unsafe_press_darkens_and_retracts_in_the_same_step_at_every_step() {
    for mut rig in every_step() {
        if !rig.sequence.capturing() {
            continue;
        }
        rig.log.clear();
        let at = rig.now;
        rig.input(Input::Unsafe(Fault::PressNotOpen));
        assert_eq!(rig.sequence.lamps.enabled(), None);
        let retract = rig
            .log
            .iter()
            .find(|(_, action)| matches!(action, Action::Retract { .. }));
        assert_eq!(retract.expect("a retract").0, at);
        assert_eq!(rig.sequence.fault(), Some(Fault::PressNotOpen));
    }
}
