//! Order of the frames, and every limit of a plan.

mod common;

use common::short_plan;
use flankscope_protocol::plan::Wait;
use flankscope_protocol::*;

/// `insitu12` at two exposures.
fn plan() -> CapturePlan {
    CapturePlan {
        exposures: [10_000, 30_000].map(Microseconds).into_iter().collect(),
        fringes: [
            FringeSet {
                periods: 4,
                steps: 4,
            },
            FringeSet {
                periods: 48,
                steps: 8,
            },
        ]
        .into_iter()
        .collect(),
        ..short_plan()
    }
}

#[test]
fn frames_come_dark_first_then_by_exposure_then_by_pattern() {
    let plan = plan();
    let mut expected = vec![(0, 10_000)];
    for exposure in [10_000, 30_000] {
        expected.extend((1..=12).map(|pattern| (pattern, exposure)));
    }
    let frames: Vec<_> = (0..)
        .map_while(|i| plan.frame(i))
        .map(|f| (f.pattern, f.exposure.0))
        .collect();
    assert_eq!(frames, expected);
    assert_eq!(frames.len(), usize::from(plan.frames_per_view()));
}

#[test]
fn a_second_projector_shows_all_once_more_at_each_exposure() {
    let one = plan();
    let two = CapturePlan {
        projectors: 2,
        ..plan()
    };
    let frames = |plan: &CapturePlan| -> Vec<FrameSpec> {
        (0..).map_while(|index| plan.frame(index)).collect()
    };
    let [alone, shared] = [&one, &two].map(frames);
    assert_eq!((alone.len(), shared.len()), (1 + 2 * 12, 1 + 2 * 2 * 12));
    assert_eq!(shared.len(), usize::from(two.frames_per_view()));
    // The dark one and 12 at each exposure are those of a plan without it.
    let of = |wanted: Projector| {
        let frames = shared.iter().copied();
        frames
            .filter(move |frame| frame.projector == wanted)
            .collect::<Vec<_>>()
    };
    assert_eq!(of(Projector::First), alone);
    let again: Vec<FrameSpec> = alone[1..]
        .iter()
        .map(|&frame| FrameSpec {
            projector: Projector::Second,
            ..frame
        })
        .collect();
    assert_eq!(of(Projector::Second), again);
    // It comes after the first at each exposure.
    let turns: Vec<Projector> = shared[1..].iter().map(|frame| frame.projector).collect();
    let (first, second) = ([Projector::First; 12], [Projector::Second; 12]);
    assert_eq!(turns, [first, second, first, second].concat());
    // No LED is on for longer, and no DMD holds more.
    assert_eq!(two.led_on_per_view(), one.led_on_per_view());
    assert_eq!(two.pattern_count(), one.pattern_count());
}

#[test]
fn led_on_time_is_the_sum_over_the_frames() {
    let plan = plan();
    let sum: u32 = (0..plan.frames_per_view())
        .map(|i| {
            plan.frame(i).expect("a frame").exposure.0 + plan.dmd_settle.0 + plan.camera_readout.0
        })
        .sum();
    assert_eq!(plan.led_on_per_view(), Microseconds(sum));
}

#[test]
fn every_limit_is_refused_one_beyond_and_accepted_at_it() {
    let limits = Limits {
        patterns_max: 12,
        frames_max: 25,
        ..Limits::DEFAULT
    };
    assert_eq!(plan().validate(&limits), Ok(()));
    let at_limit = CapturePlan {
        led: limits.led_max,
        settle: limits.wait_max,
        retract: limits.vertical_max,
        exposures: [limits.exposure_min, limits.exposure_max]
            .into_iter()
            .collect(),
        focus: Some(Focus {
            counts: limits.lens_max,
            settle: limits.wait_max,
        }),
        ..plan()
    };
    assert_eq!(at_limit.validate(&limits), Ok(()));

    let us = Microseconds;
    let refused = |change: &dyn Fn(&mut CapturePlan)| {
        let mut plan = plan();
        change(&mut plan);
        plan.validate(&limits).expect_err("beyond a limit")
    };
    assert_eq!(refused(&|p| p.views.clear()), PlanError::NoViews);
    assert_eq!(refused(&|p| p.exposures.clear()), PlanError::NoExposures);
    assert_eq!(refused(&|p| p.fringes.clear()), PlanError::NoFringes);
    assert_eq!(
        refused(&|p| p.exposures[0] = us(999)),
        PlanError::ExposureTooShort {
            got: us(999),
            limit: us(1_000)
        }
    );
    assert_eq!(
        refused(&|p| p.exposures[1] = us(100_001)),
        PlanError::ExposureTooLong {
            got: us(100_001),
            limit: us(100_000)
        }
    );
    assert_eq!(
        refused(&|p| p.exposures[1] = us(10_000)),
        PlanError::ExposuresNotAscending {
            got: us(10_000),
            limit: us(10_000)
        }
    );
    assert_eq!(
        refused(&|p| p.fringes[1].steps = 2),
        PlanError::TooFewSteps { got: 2, limit: 3 }
    );
    assert_eq!(
        refused(&|p| p.fringes[0].periods = 0),
        PlanError::TooFewPeriods { got: 0, limit: 1 }
    );
    assert_eq!(
        refused(&|p| p.fringes[1].steps = 9),
        PlanError::TooManyPatterns { got: 13, limit: 12 }
    );
    assert_eq!(
        refused(&|p| p.exposures.push(us(40_000)).expect("room for a third")),
        PlanError::TooManyFrames { got: 37, limit: 25 }
    );
    assert_eq!(
        refused(&|p| p.led = Milliamps(3_001)),
        PlanError::LedCurrent {
            got: Milliamps(3_001),
            limit: Milliamps(3_000)
        }
    );
    assert_eq!(
        refused(&|p| p.camera_readout = us(2_000_000)),
        PlanError::LedOnTime {
            got: us(10_000 + 480_000 + 25 * 2_000_500),
            limit: us(4_000_000)
        }
    );
    assert_eq!(
        refused(&|p| p.views[0].rotation = Microradians(6_283_187)),
        PlanError::RotationOutOfTravel {
            got: Microradians(6_283_187),
            min: limits.rotation_min,
            max: limits.rotation_max
        }
    );
    for change in [
        (|p| p.views[0].vertical = Micrometres(-150_001)) as fn(&mut CapturePlan),
        |p| p.retract = Micrometres(-150_001),
    ] {
        assert_eq!(
            refused(&change),
            PlanError::VerticalOutOfTravel {
                got: Micrometres(-150_001),
                min: limits.vertical_min,
                max: limits.vertical_max
            }
        );
    }
    for (which, limit, change) in [
        (
            Wait::Settle,
            2_000_000,
            (|p| p.settle.0 = 2_000_001) as fn(&mut CapturePlan),
        ),
        (Wait::MotionTimeout, 60_000_000, |p| {
            p.timeouts.motion.0 = 60_000_001
        }),
        (Wait::LedTimeout, 1_000_000, |p| {
            p.timeouts.led.0 = 1_000_001
        }),
        (Wait::DmdTimeout, 1_000_000, |p| {
            p.timeouts.dmd.0 = 1_000_001
        }),
        (Wait::CameraTimeout, 1_000_000, |p| {
            p.timeouts.camera.0 = 1_000_001
        }),
        (Wait::FocusSettle, 2_000_000, |p| {
            p.focus = Some(Focus {
                counts: LensCounts(500),
                settle: Microseconds(2_000_001),
            });
        }),
    ] {
        assert_eq!(
            refused(&change),
            PlanError::WaitTooLong {
                which,
                got: us(limit + 1),
                limit: us(limit)
            }
        );
    }
    for got in [0, 3] {
        assert_eq!(
            refused(&|p| p.projectors = got),
            PlanError::Projectors { got, limit: 2 }
        );
    }
    // Both projectors' frames count.
    assert_eq!(
        refused(&|p| p.projectors = 2),
        PlanError::TooManyFrames { got: 49, limit: 25 }
    );
    for counts in [199, 801].map(LensCounts) {
        let settle = us(0);
        assert_eq!(
            refused(&|p| p.focus = Some(Focus { counts, settle })),
            PlanError::FocusOutOfRange {
                got: counts,
                min: LensCounts(200),
                max: LensCounts(800)
            }
        );
    }
    assert_eq!(
        refused(&|p| p.timeouts.dmd = us(999)),
        PlanError::WaitTooShort {
            which: Wait::DmdTimeout,
            got: us(999),
            limit: us(1_000)
        }
    );
}
