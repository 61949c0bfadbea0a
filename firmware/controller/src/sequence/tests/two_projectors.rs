//! Captures by two projectors.

use super::*;

/// One view, so that every step of it can be disturbed.
pub(super) fn plan() -> CapturePlan {
    let one = super::plan();
    CapturePlan {
        views: one.views.iter().copied().take(1).collect(),
        projectors: 2,
        ..one
    }
}

/// What a projector's lines did, in order.
fn lines(rig: &Rig) -> Vec<Action> {
    let actions = rig.log.iter().map(|(_, action)| *action);
    actions
        .filter(|action| {
            matches!(
                action,
                Action::LedOn(..)
                    | Action::LedOff
                    | Action::SelectPattern(..)
                    | Action::CameraTrigger(true)
            )
        })
        .collect()
}

#[test]
fn each_frame_has_the_light_of_the_projector_that_the_plan_says() {
    let mut rig = Rig::started(config(), plan());
    rig.run();
    assert_eq!((rig.faults(), rig.sequence.state()), (vec![], State::Ready));
    let pass = |projector, patterns: core::ops::RangeInclusive<u16>| {
        let frames = patterns.flat_map(move |n| {
            [
                Action::SelectPattern(projector, n),
                Action::CameraTrigger(true),
            ]
        });
        [Action::LedOn(projector, plan().led)]
            .into_iter()
            .chain(frames)
            .chain([Action::LedOff])
    };
    let expected: Vec<Action> = [
        pass(Projector::First, 0..=12),
        pass(Projector::Second, 1..=12),
        pass(Projector::First, 1..=12),
        pass(Projector::Second, 1..=12),
    ]
    .into_iter()
    .flatten()
    .collect();
    assert_eq!(lines(&rig), expected);
    // Counted on as every frame of the view is.
    let counted: Vec<u16> = rig.triggers().iter().map(|frame| frame.pattern).collect();
    let twice: Vec<u16> = [0].into_iter().chain(1..=24).chain(1..=24).collect();
    assert_eq!(counted, twice);
}

#[test]
fn an_led_waits_until_the_others_current_is_gone() {
    let mut rig = Rig::started(config(), plan());
    let (mut waited, mut lit_at_last) = (0, None);
    loop {
        let [first, second] = rig.world.leds.map(|led| led.on);
        assert!(!(first && second));
        if let Step::Darkening {
            then: Dark::NextProjector,
        } = rig.sequence.step
        {
            waited += 1;
            // One that does not go out is a fault, and the other never shines.
            let mut stuck = rig.clone();
            for led in &mut stuck.world.leds {
                led.flips_at = Timestamp(u64::MAX);
            }
            let off = stuck.sequence.lamps.awaits();
            stuck.run();
            assert_eq!(stuck.sequence.fault(), Some(Fault::LedStuckOn), "{off:?}");
            let lit = |rig: &Rig| {
                let on = |(_, action): &&(Timestamp, Action)| matches!(action, Action::LedOn(..));
                rig.log.iter().filter(on).count()
            };
            assert_eq!(lit(&stuck), lit(&rig));
        }
        if first || second {
            lit_at_last = Some([first, second]);
        }
        if !rig.advance() {
            break;
        }
    }
    assert_eq!(lit_at_last, Some([false, true]));
    assert!(waited >= 3, "{waited}");
}

#[test]
fn a_projector_that_does_not_answer_is_told_by_its_own_detail() {
    let mut seen = Vec::new();
    for mut rig in steps_of(plan()) {
        if !matches!(rig.sequence.step, Step::Switching { .. }) {
            continue;
        }
        let shows = rig.sequence.shows();
        rig.log.clear();
        rig.world.frozen = true;
        rig.run();
        assert!(rig.dark());
        let first = rig.events().find_map(|event| match event {
            Event::Fault { fault, detail, .. } => Some((fault.known(), detail)),
            _ => None,
        });
        assert_eq!(first, Some((Some(Fault::DmdNotReady), shows.detail())));
        seen.push(shows);
    }
    for projector in Projector::ALL {
        assert!(seen.contains(&projector));
    }
}

#[test]
fn an_led_that_shines_beside_the_other_puts_out_both() {
    let mut provoked = [0; 2];
    for mut rig in steps_of(plan()) {
        if rig.sequence.state() != State::Capturing {
            continue;
        }
        let shows = rig.sequence.shows();
        let other = Projector::ALL.into_iter().find(|of| *of != shows);
        rig.log.clear();
        rig.input(Input::LedSense(other.expect("another"), true));
        assert_eq!(rig.sequence.fault(), Some(Fault::LedStuckOn));
        assert!(rig.dark());
        let detail = rig.events().find_map(|event| match event {
            Event::Fault { detail, .. } => Some(detail),
            _ => None,
        });
        assert_eq!(detail, other.map(Projector::detail));
        provoked[shows as usize] += 1;
    }
    assert!(provoked.iter().all(|&n| n > 50), "{provoked:?}");
}

#[test]
fn each_led_has_a_budget_of_its_own() {
    let hot = |projectors| {
        let limits = Limits {
            // One projector's frames of a view, and none of a second view.
            led_on_max: plan().led_on_per_view(),
            led_duty_permille: 500,
            ..Limits::DEFAULT
        };
        let plan = CapturePlan {
            projectors,
            ..super::plan()
        };
        let mut rig = Rig::started(Config { limits, ..config() }, plan);
        while rig.advance() {
            for projector in Projector::ALL {
                let used_us = rig.sequence.lamps.of(projector).budget().used_us(rig.now);
                assert!(used_us <= u64::from(limits.led_on_max.get()));
            }
        }
        assert_eq!(rig.sequence.fault(), None);
        let cooled = rig.faults();
        assert!(cooled.iter().all(|fault| *fault == Fault::LedCooling));
        (cooled.len(), rig.triggers().len())
    };
    assert_eq!((hot(1).1, hot(2).1), (75, 147));
    assert_eq!(hot(1).0, 2);
}
