//! Triggers against frames: a view counts only if every exposure the controller fired is the frame the host got.

use flankscope_frames::{EXPOSURE_TOLERANCE_US, FrameHeader};
use flankscope_protocol::Trigger;

/// Largest difference between the controller's and the camera's clock within one view, µs: two crystals of 50 ppm drift
/// apart by 200 µs in 2 s, and each edge may be seen 100 µs late.
const INTERVAL_TOLERANCE_US: u64 = 400;

/// Why a view cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PairingError {
    /// Not one frame per trigger.
    #[error("{triggers} triggers were fired, {frames} frames came")]
    Count {
        /// Triggers reported by the controller.
        triggers: usize,
        /// Frames received.
        frames: usize,
    },
    /// The camera skipped or repeated a number.
    #[error("frame {got} came where frame {expected} was due")]
    Counter {
        /// Counter that came.
        got: u32,
        /// Counter expected.
        expected: u32,
    },
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
        /// Commanded exposure.
        commanded_us: u64,
    },
    /// The exposures did not happen when the triggers did.
    #[error("frame {frame} began {got_us} us after the view's first, its trigger {fired_us} us")]
    Interval {
        /// Position in the view.
        frame: usize,
        /// By the camera's clock.
        got_us: u64,
        /// By the controller's clock.
        fired_us: u64,
    },
}

/// Checks that the frames of a view are its triggers, one for one: by count, number, pattern, length and time.
///
/// # Errors
/// The first thing that does not fit.
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
        if got_us.abs_diff(commanded_us) > EXPOSURE_TOLERANCE_US {
            return Err(PairingError::Exposure {
                frame: i,
                got_us,
                commanded_us,
            });
        }
        let got_us = frame
            .exposure_start_us
            .saturating_sub(first_frame.exposure_start_us);
        let fired_us = trigger.camera_at.since_us(first_trigger.camera_at);
        if got_us.abs_diff(fired_us) > INTERVAL_TOLERANCE_US {
            return Err(PairingError::Interval {
                frame: i,
                got_us,
                fired_us,
            });
        }
    }
    Ok(())
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
                    exposure_start_us: camera_start,
                    exposure_end_us: camera_start + 10_001,
                    ..FrameHeader::default()
                };
                (trigger, frame)
            })
            .unzip()
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
                // One lost and another one extra: the count is right, the times are not.
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
}
