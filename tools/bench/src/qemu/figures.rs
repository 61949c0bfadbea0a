//! Timing accuracy of the emulated controller, by its own clock.

use serde::{Deserialize, Serialize};

use flankscope_pin_wire::{PinMessage, Subject};

/// Range of one kind of interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Spread {
    /// Number of intervals.
    pub count: u64,
    /// Shortest, us.
    pub min_us: u64,
    /// Longest, us.
    pub max_us: u64,
}

impl Spread {
    fn of(intervals_us: impl IntoIterator<Item = u64>) -> Option<Self> {
        intervals_us.into_iter().fold(None, |spread, us| {
            let Self {
                count,
                min_us,
                max_us,
            } = spread.unwrap_or(Self {
                count: 0,
                min_us: us,
                max_us: us,
            });
            Some(Self {
                count: count + 1,
                min_us: min_us.min(us),
                max_us: max_us.max(us),
            })
        })
    }

    /// Longest minus shortest, us.
    pub fn width_us(&self) -> u64 {
        self.max_us - self.min_us
    }
}

/// Results of one run. `None`: it did not occur.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Figures {
    /// Number of starts of the image; more than one means a reset.
    pub starts: usize,
    /// Largest stack usage, bytes.
    pub stack_bytes: Option<u16>,
    /// Longest delay of the interrupt after an alarm that ends an exposure, µs.
    pub timer_interrupt_us: Option<u16>,
    /// Delay from an input's interrupt to the output that follows immediately (DMD ready -> DMD trigger released).
    pub reaction: Option<Spread>,
    /// Excess of the camera trigger pulse over the commanded exposure, which is a multiple of 0.1 ms.
    pub pulse_excess: Option<Spread>,
    /// DMD trigger -> camera trigger of the same frame: switching and settling time, and the bench's answers in between.
    pub dmd_to_camera: Option<Spread>,
    /// DMD ready received -> camera trigger, for exposures longer than a readout. Their start waits for settling alone, so the
    /// shortest interval is the settling time, and the excess is lateness.
    pub ready_to_camera: Option<Spread>,
    /// Jitter (longest - shortest) of the trigger period between frames of one exposure; the largest of all exposures, µs.
    pub period_jitter_us: Option<u64>,
    /// The same jitter for triggers that waited only for the readout of the previous frame, without a late answer of the bench:
    /// the controller's own jitter.
    pub held_period_jitter_us: Option<u64>,
}

/// Exposures are commanded in multiples of this, µs.
const EXPOSURE_STEP_US: u64 = 100;
/// The camera's readout takes 12.5 ms.
const LONGER_THAN_READOUT_US: u64 = 13_000;
/// A trigger this much later than the settling of its pattern was waiting for the readout, µs.
const HELD_US: u64 = 100;
/// Frames further apart than this belong to different views.
const SAME_VIEW_US: u64 = 200_000;

impl Figures {
    /// Evaluates a trace.
    #[must_use]
    pub fn of(trace: &[PinMessage]) -> Self {
        let all = |subject: Subject| {
            trace
                .iter()
                .filter(move |message| message.subject == subject)
        };
        let last = |subject| {
            let mut newest_first = trace.iter().rev();
            newest_first
                .find(|message| message.subject == subject)
                .map(|message| message.value)
        };
        let pulses = pulses(trace);
        let settled = Spread::of(settled(trace, &pulses));
        let periods = periods(&pulses);
        let held = settled.map(|settle| {
            let waits = |&(_, at, _): &Period| {
                let ready = all(Subject::DmdReady).rfind(|told| told.value == 1 && told.at_us < at);
                ready.is_some_and(|ready| at - ready.at_us > settle.min_us + HELD_US)
            };
            periods.iter().copied().filter(waits).collect::<Vec<_>>()
        });
        Self {
            starts: all(Subject::Started).count(),
            stack_bytes: last(Subject::StackUsed),
            timer_interrupt_us: last(Subject::AlarmLatency),
            reaction: Spread::of(reactions(trace)),
            pulse_excess: Spread::of(
                pulses
                    .iter()
                    .map(|(_, width)| width.saturating_sub(nominal(*width))),
            ),
            dmd_to_camera: Spread::of(between(trace, Subject::DmdTrigger, Subject::CameraTrigger)),
            ready_to_camera: settled,
            period_jitter_us: jitter(&periods),
            held_period_jitter_us: held.and_then(|held| jitter(&held)),
        }
    }
}

/// The commanded exposure of a pulse.
fn nominal(width_us: u64) -> u64 {
    width_us / EXPOSURE_STEP_US * EXPOSURE_STEP_US
}

/// Start and width of every camera trigger pulse.
fn pulses(trace: &[PinMessage]) -> Vec<(u64, u64)> {
    let mut rise = None;
    let mut pulses = Vec::new();
    for message in trace
        .iter()
        .filter(|message| message.subject == Subject::CameraTrigger)
    {
        match (message.value, rise.take()) {
            (1, _) => rise = Some(message.at_us),
            (_, Some(start)) => pulses.push((start, message.at_us - start)),
            _ => {}
        }
    }
    pulses
}

/// Exposure of two successive frames of a view, time of the second trigger, and interval between both.
type Period = (u64, u64, u64);

fn periods(pulses: &[(u64, u64)]) -> Vec<Period> {
    let mut periods = Vec::new();
    for pair in pulses.windows(2) {
        let [(start, width), (next, next_width)] = [pair[0], pair[1]];
        if nominal(width) == nominal(next_width) && next - start < SAME_VIEW_US {
            periods.push((nominal(width), next, next - start));
        }
    }
    periods
}

/// The largest of all exposures.
fn jitter(periods: &[Period]) -> Option<u64> {
    let of = |exposure: u64| {
        let same = periods.iter().filter(move |period| period.0 == exposure);
        Spread::of(same.map(|period| period.2))
    };
    let spreads = periods.iter().filter_map(|period| of(period.0));
    spreads.map(|spread| spread.width_us()).max()
}

/// Intervals from each rise of one output to the next rise of another.
fn between(trace: &[PinMessage], first: Subject, second: Subject) -> Vec<u64> {
    let mut since = None;
    let mut intervals = Vec::new();
    for message in trace.iter().filter(|message| message.value == 1) {
        if message.subject == first {
            since = Some(message.at_us);
        } else if message.subject == second
            && let Some(since) = since.take()
        {
            intervals.push(message.at_us - since);
        }
    }
    intervals
}

/// Intervals from DMD ready received to the camera trigger, where that waits for no readout.
fn settled(trace: &[PinMessage], pulses: &[(u64, u64)]) -> Vec<u64> {
    let long = |start: &u64| {
        let mut of_start = pulses.iter().filter(|(at, _)| at == start);
        of_start.any(|(_, width)| *width > LONGER_THAN_READOUT_US)
    };
    let mut ready = None;
    let mut intervals = Vec::new();
    for message in trace.iter().filter(|message| message.value == 1) {
        match message.subject {
            Subject::DmdReady => ready = Some(message.at_us),
            Subject::CameraTrigger if long(&message.at_us) => {
                intervals.extend(ready.take().map(|ready| message.at_us - ready));
            }
            _ => {}
        }
    }
    intervals
}

/// Intervals from DMD ready received to DMD trigger released.
fn reactions(trace: &[PinMessage]) -> Vec<u64> {
    let mut seen = None;
    let mut intervals = Vec::new();
    for message in trace {
        match (message.subject, message.value) {
            (Subject::DmdReady, 1) => seen = Some(message.at_us),
            (Subject::DmdTrigger, 0) => {
                intervals.extend(seen.take().map(|seen| message.at_us - seen));
            }
            _ => {}
        }
    }
    intervals
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(subject: Subject, value: u16, at_us: u64) -> PinMessage {
        PinMessage {
            subject,
            value,
            at_us,
        }
    }

    #[test]
    fn intervals_are_taken_between_the_edges_that_belong_together() {
        let mut trace = vec![message(Subject::Started, 0, 1)];
        // Two frames of 10 ms, 15.000 and 15.040 ms apart, each at most 7 µs too long.
        for (start, excess) in [(100_000, 3), (115_000, 7), (130_040, 5)] {
            trace.extend([
                message(Subject::DmdTrigger, 1, start - 700),
                message(Subject::DmdReady, 1, start - 200),
                message(Subject::DmdTrigger, 0, start - 190 + excess),
                message(Subject::CameraTrigger, 1, start),
                message(Subject::CameraTrigger, 0, start + 10_000 + excess),
            ]);
        }
        trace.push(message(Subject::StackUsed, 3000, 200_000));
        let figures = Figures::of(&trace);
        let spread = |min_us, max_us| {
            Some(Spread {
                count: 3,
                min_us,
                max_us,
            })
        };
        assert_eq!(figures.starts, 1);
        assert_eq!(figures.stack_bytes, Some(3000));
        assert_eq!(figures.timer_interrupt_us, None);
        assert_eq!(figures.reaction, spread(13, 17));
        assert_eq!(figures.pulse_excess, spread(3, 7));
        assert_eq!(figures.dmd_to_camera, spread(700, 700));
        assert_eq!(figures.period_jitter_us, Some(40));
    }

    #[test]
    fn a_late_answer_is_not_in_the_controllers_own_jitter() {
        let mut trace = Vec::new();
        let mut frame = |ready: u64, start: u64, exposure: u64| {
            trace.extend([
                message(Subject::DmdReady, 1, ready),
                message(Subject::CameraTrigger, 1, start),
                message(Subject::CameraTrigger, 0, start + exposure),
            ]);
        };
        // Paced by the readout, except the fourth, whose pattern was late.
        frame(98_000, 100_000, 10_000);
        frame(110_500, 112_500, 10_000);
        frame(123_000, 125_002, 10_000);
        frame(137_800, 138_000, 10_000);
        frame(148_500, 150_501, 10_000);
        // Longer than the readout: they start when the pattern has settled.
        frame(161_800, 162_000, 30_000);
        frame(193_800, 194_000, 30_000);
        let figures = Figures::of(&trace);
        assert_eq!(
            figures.ready_to_camera.map(|spread| spread.min_us),
            Some(200)
        );
        assert_eq!(figures.period_jitter_us, Some(12_998 - 12_500));
        assert_eq!(figures.held_period_jitter_us, Some(2));
    }

    #[test]
    fn nothing_measured_is_no_figure() {
        let figures = Figures::of(&[]);
        assert_eq!(
            (figures.starts, figures.reaction, figures.period_jitter_us),
            (0, None, None)
        );
    }
}
