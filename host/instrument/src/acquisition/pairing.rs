//! Pairs triggers with frames: a view counts only if every exposure that the controller fired is the frame that the host received.

use flankscope_frames::{EXPOSURE_TOLERANCE_US, FrameHeader};
use flankscope_protocol::Trigger;

/// Largest difference between the controller's and the camera's clock within one view, µs: two crystals of 50 ppm drift
/// apart by 200 µs in 2 s, and each edge may be seen 100 µs late.
const INTERVAL_TOLERANCE_US: u64 = 400;

/// Why the triggers and frames of a view do not match.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PairingError {
    /// The number of frames differs from the number of triggers.
    #[error("{triggers} triggers were fired, {frames} frames came")]
    Count {
        /// Triggers reported by the controller.
        triggers: usize,
        /// Frames received.
        frames: usize,
    },
    /// The camera skipped or repeated a number.
    #[error("frame {got} came where frame {expected} was due")]
    Counter { got: u32, expected: u32 },
    /// Controller and camera name different patterns.
    #[error(
        "the controller fired pattern {fired} as frame {frame} of the view, the camera took it for pattern {taken}"
    )]
    Pattern {
        /// Position in the view.
        frame: usize,
        /// Controller's pattern.
        fired: u16,
        /// Camera's pattern.
        taken: u16,
    },
    /// The exposure has another length than commanded.
    #[error("frame {frame} was exposed for {got_us} us, commanded were {commanded_us} us")]
    Exposure {
        /// Position in the view.
        frame: usize,
        /// Camera's exposure.
        got_us: u64,
        commanded_us: u64,
    },
    /// A trigger or frame was late by more than the limit.
    #[error(
        "{leg} {late_ms:.0} ms late (frame {frame} of the view), at most {limit_ms:.0} ms may be: something stood still"
    )]
    Stalled {
        /// Position in the view.
        frame: usize,
        /// Part of the way that was late.
        leg: Leg,
        /// Delay, ms.
        late_ms: f64,
        /// Largest delay allowed, ms.
        limit_ms: f64,
    },
    /// The interval between two exposures differs from that between their triggers.
    #[error("frame {frame} began {got_us} us after the view's first, its trigger {fired_us} us")]
    Interval {
        /// Position in the view.
        frame: usize,
        /// Interval by the camera's clock.
        got_us: u64,
        /// Interval by the controller's clock.
        fired_us: u64,
    },
}

/// Which part of the way from trigger to host was late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leg {
    /// The controller reported a trigger late: the reports are further apart than the triggers.
    Trigger,
    /// The camera process handed a frame over late after its exposure.
    Camera,
    /// The host received a frame late after it was handed over.
    Host,
}

impl std::fmt::Display for Leg {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Trigger => "the controller's word of the trigger came",
            Self::Camera => "the camera handed the frame over",
            Self::Host => "the host saw the frame",
        })
    }
}

/// Largest delay of a frame within a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lateness {
    /// Position in the view.
    pub frame: usize,
    /// Part of the way that was late.
    pub leg: Leg,
    /// Delay, ms.
    pub late_ms: f64,
}

/// The largest delay of a frame within a view, by the host's clock. `arrived_ns` says when the controller's report of each
/// trigger arrived, `handover_ns` how long each frame took from the camera process to the host.
///
/// Controller, camera process and host have clocks of their own, and a process that is suspended sees no delay by its own clock.
/// So the intervals each device reports are compared with the intervals that the host observed. `None` without frames.
pub fn lateness(
    triggers: &[Trigger],
    arrived_ns: &[u64],
    frames: &[FrameHeader],
    handover_ns: &[u64],
) -> Option<Lateness> {
    let of = |frame, leg, late_ns: u64| Lateness {
        frame,
        leg,
        late_ms: late_ns as f64 / 1e6,
    };
    let words = triggers.windows(2).zip(arrived_ns.windows(2)).enumerate();
    let words = words.map(|(i, (fired, arrived))| {
        let fired_ns = 1000 * fired[1].camera_at.since_us(fired[0].camera_at);
        let late_ns = arrived[1]
            .saturating_sub(arrived[0])
            .saturating_sub(fired_ns);
        of(i + 1, Leg::Trigger, late_ns)
    });
    let cameras = frames.iter().enumerate().map(|(i, frame)| {
        let late_ns = frame
            .published_monotonic_ns
            .saturating_sub(frame.exposure_end_monotonic_ns);
        of(i, Leg::Camera, late_ns)
    });
    let hosts = handover_ns
        .iter()
        .enumerate()
        .map(|(i, &late_ns)| of(i, Leg::Host, late_ns));
    words
        .chain(cameras)
        .chain(hosts)
        .max_by(|a, b| a.late_ms.total_cmp(&b.late_ms))
}

/// Checks that the frames of a view match its triggers one to one: by count, number, pattern, length and time.
///
/// An exposure length that the camera did not measure is not compared with the commanded one. If the camera reports when an
/// exposure ended, that time is used; otherwise the frame's arrival is, with a tolerance of half the interval to the next
/// trigger.
///
/// # Errors
/// The first mismatch.
pub fn pair(triggers: &[Trigger], frames: &[FrameHeader]) -> Result<(), PairingError> {
    if triggers.len() != frames.len() {
        return Err(PairingError::Count {
            triggers: triggers.len(),
            frames: frames.len(),
        });
    }
    let (Some(first_trigger), Some(first_frame)) = (triggers.first(), frames.first()) else {
        return Ok(());
    };
    for (i, (trigger, frame)) in triggers.iter().zip(frames).enumerate() {
        let expected = first_frame.counter.wrapping_add(i as u32);
        if frame.counter != expected {
            return Err(PairingError::Counter {
                got: frame.counter,
                expected,
            });
        }
        if trigger.pattern != frame.label.pattern {
            return Err(PairingError::Pattern {
                frame: i,
                fired: trigger.pattern,
                taken: frame.label.pattern,
            });
        }
        let commanded_us = u64::from(trigger.exposure.get());
        let got_us = frame
            .exposure_end_us
            .saturating_sub(frame.exposure_start_us);
        let length = frame.measured & FrameHeader::EXPOSURE_MEASURED != 0;
        if length && got_us.abs_diff(commanded_us) > EXPOSURE_TOLERANCE_US {
            return Err(PairingError::Exposure {
                frame: i,
                got_us,
                commanded_us,
            });
        }
        let end = frame.measured & FrameHeader::END_MEASURED != 0;
        let (got_us, fired_us) = match length {
            true => (
                frame
                    .exposure_start_us
                    .saturating_sub(first_frame.exposure_start_us),
                trigger.camera_at.since_us(first_trigger.camera_at),
            ),
            false => (
                frame
                    .exposure_end_us
                    .saturating_sub(first_frame.exposure_end_us),
                trigger.end_at.since_us(first_trigger.end_at),
            ),
        };
        let tolerance_us = match end {
            true => INTERVAL_TOLERANCE_US,
            false => half_a_step_us(triggers),
        };
        if got_us.abs_diff(fired_us) > tolerance_us {
            return Err(PairingError::Interval {
                frame: i,
                got_us,
                fired_us,
            });
        }
    }
    Ok(())
}

/// Half of the shortest time between two triggers: a frame that is off by less belongs to no other trigger.
fn half_a_step_us(triggers: &[Trigger]) -> u64 {
    let steps = triggers.windows(2);
    let steps = steps.map(|two| two[1].end_at.since_us(two[0].end_at));
    steps.min().unwrap_or(u64::MAX) / 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_frames::FrameLabel;
    use flankscope_protocol::{Microseconds, Timestamp};

    /// Five exposures of 10 ms, 15 ms apart; the camera's clock starts elsewhere and runs 50 ppm fast.
    fn view() -> (Vec<Trigger>, Vec<FrameHeader>) {
        (0..5_u16)
            .map(|i| {
                let start = 1_000 + u64::from(i) * 15_000;
                let trigger = Trigger {
                    session: 1,
                    view: 0,
                    frame: i,
                    pattern: i,
                    exposure: Microseconds(10_000),
                    dmd_at: Timestamp(start - 500),
                    camera_at: Timestamp(start),
                    end_at: Timestamp(start + 10_000),
                };
                let camera_start = 777_000 + start + start / 20_000;
                let frame = FrameHeader {
                    session: 1,
                    counter: 40 + u32::from(i),
                    label: FrameLabel {
                        view: 0,
                        in_view: i,
                        exposure: 0,
                        pattern: i,
                    },
                    measured: FrameHeader::ALL_MEASURED,
                    exposure_start_us: camera_start,
                    exposure_end_us: camera_start + 10_001,
                    ..FrameHeader::default()
                };
                (trigger, frame)
            })
            .unzip()
    }

    #[test]
    fn what_stands_still_anywhere_on_the_way_is_late() {
        let (triggers, mut frames) = view();
        // Every report arrives 2 ms after its trigger; every frame is handed over 13 ms after its exposure and received in 0.1 ms.
        let arrived: Vec<u64> = (0..5).map(|i| 7_000_000 + 15_000_000 * i).collect();
        let handover = vec![100_000; 5];
        for (i, frame) in (0..).zip(&mut frames) {
            frame.exposure_end_monotonic_ns = 5_000_000 + 15_000_000 * i;
            frame.published_monotonic_ns = frame.exposure_end_monotonic_ns + 13_000_000;
        }
        let all_well = lateness(&triggers, &arrived, &frames, &handover).unwrap();
        assert!(all_well.late_ms <= 13.0, "{all_well:?}");
        let stall_ns = 5_000_000_000;
        for i in 0..5 {
            let mut late = arrived.clone();
            late[i..].iter_mut().for_each(|at| *at += stall_ns);
            let found = lateness(&triggers, &late, &frames, &handover).unwrap();
            if i > 0 {
                // The head still moved before the first trigger, so no delay is defined for it.
                assert_eq!((found.frame, found.leg), (i, Leg::Trigger));
                assert!((found.late_ms - 5000.0).abs() < 1.0, "{found:?}");
            }
            let mut late = frames.clone();
            late[i].published_monotonic_ns += stall_ns;
            let found = lateness(&triggers, &arrived, &late, &handover).unwrap();
            assert_eq!((found.frame, found.leg), (i, Leg::Camera));
            let mut late = handover.clone();
            late[i] += stall_ns;
            let found = lateness(&triggers, &arrived, &frames, &late).unwrap();
            assert_eq!((found.frame, found.leg), (i, Leg::Host));
        }
        assert_eq!(lateness(&[], &[], &[], &[]), None);
    }

    #[test]
    fn a_whole_view_pairs() {
        let (triggers, frames) = view();
        assert_eq!(pair(&triggers, &frames), Ok(()));
    }

    #[test]
    fn every_single_disturbance_is_refused() {
        let (triggers, frames) = view();
        let disturb = |change: &dyn Fn(&mut Vec<Trigger>, &mut Vec<FrameHeader>)| {
            let (mut triggers, mut frames) = (triggers.clone(), frames.clone());
            change(&mut triggers, &mut frames);
            pair(&triggers, &frames)
        };
        for i in 0..5 {
            assert!(
                disturb(&|_, f| _ = f.remove(i)).is_err(),
                "frame {i} missing"
            );
            assert!(
                disturb(&|_, f| f.insert(i, f[i])).is_err(),
                "frame {i} twice"
            );
            assert!(
                disturb(&|t, _| _ = t.remove(i)).is_err(),
                "trigger {i} missing"
            );
            assert!(
                disturb(&|_, f| f[i].label.pattern += 1).is_err(),
                "pattern of frame {i} wrong"
            );
            assert!(
                disturb(&|_, f| f[i].exposure_end_us += 5_000).is_err(),
                "exposure of frame {i} too long"
            );
            if i > 0 {
                assert!(
                    disturb(&|_, f| f.swap(i - 1, i)).is_err(),
                    "frames {} and {i} swapped",
                    i - 1
                );
                // One frame lost and one extra: the count is right, the times are not.
                let late = disturb(&|_, f| {
                    f[i].exposure_start_us += 15_000;
                    f[i].exposure_end_us += 15_000;
                });
                assert!(
                    matches!(late, Err(PairingError::Interval { .. })),
                    "frame {i} late: {late:?}"
                );
            }
        }
    }

    /// One camera reports when exposures ended but not their length, another reports neither.
    #[test]
    fn what_was_not_measured_is_not_believed() {
        let (triggers, frames) = view();
        let of = |measured: u32, change: &dyn Fn(&mut Vec<FrameHeader>)| {
            let mut frames = frames.clone();
            for frame in &mut frames {
                frame.measured = measured;
                frame.exposure_start_us = frame.exposure_end_us;
            }
            change(&mut frames);
            pair(&triggers, &frames)
        };
        let later = |frame: &mut FrameHeader, us| {
            frame.exposure_start_us += us;
            frame.exposure_end_us += us;
        };
        let end = FrameHeader::END_MEASURED;
        assert_eq!(of(end, &|_| ()), Ok(()));
        assert_eq!(of(0, &|_| ()), Ok(()));
        // Without exposure times, arrival is checked to half an interval only.
        for i in 1..5 {
            assert!(of(end, &|f| later(&mut f[i], 5_000)).is_err());
            assert_eq!(of(0, &|f| later(&mut f[i], 5_000)), Ok(()));
            assert!(of(0, &|f| later(&mut f[i], 15_000)).is_err());
            assert!(of(0, &|f| _ = f.remove(i)).is_err());
        }
    }
}
