//! The verdict at the press: two antivalent lines and a heartbeat, no-go unless a fresh go says otherwise.

use super::Timing;
use flankscope_protocol::Timestamp;

/// Levels of the verdict lines. All low, as without power, is no valid verdict.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct VerdictLines {
    /// High = go.
    pub go: bool,
    /// High = no-go; always the opposite of `go`.
    pub no_go: bool,
    /// Changes its level at a steady pace while a verdict is fresh.
    pub beat: bool,
}

/// What is shown, and until when.
#[derive(Debug, Clone)]
pub struct VerdictLamp {
    timing: Timing,
    go: bool,
    stale_at: Option<Timestamp>,
    beat: bool,
    beat_at: Timestamp,
}

impl VerdictLamp {
    /// No-go, without a heartbeat.
    #[must_use]
    pub fn new(timing: Timing) -> Self {
        Self {
            timing,
            go: false,
            stale_at: None,
            beat: false,
            beat_at: Timestamp(0),
        }
    }

    /// A verdict arrived.
    pub fn show(&mut self, now: Timestamp, go: bool) {
        if self.stale_at.is_none() {
            self.beat_at = now;
        }
        self.go = go;
        self.stale_at = Some(now.after(self.timing.verdict_life));
    }

    /// The lines at `now`.
    pub fn lines(&mut self, now: Timestamp) -> VerdictLines {
        if self.stale_at.is_some_and(|at| now >= at) {
            (self.go, self.stale_at) = (false, None);
        }
        if self.stale_at.is_some() && now >= self.beat_at {
            self.beat = !self.beat;
            self.beat_at = now.after(self.timing.verdict_beat);
        }
        VerdictLines {
            go: self.go,
            no_go: !self.go,
            beat: self.beat,
        }
    }

    /// When the lines change next by themselves.
    pub fn deadline(&self) -> Option<Timestamp> {
        Some(self.stale_at?.min(self.beat_at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn go_is_shown_only_while_it_is_fresh_and_the_lines_never_agree() {
        let mut lamp = VerdictLamp::new(Timing::DEFAULT);
        let life = u64::from(Timing::DEFAULT.verdict_life.get());
        let shown_at = 1_000_000;
        let mut beats = 0;
        let mut last = lamp.lines(Timestamp(0));
        assert!(!last.go && last.no_go);
        for now in (0..shown_at + 2 * life).step_by(1_000) {
            if now == shown_at {
                lamp.show(Timestamp(now), true);
            }
            let lines = lamp.lines(Timestamp(now));
            assert_ne!(lines.go, lines.no_go);
            assert_eq!(
                lines.go,
                (shown_at..shown_at + life).contains(&now),
                "at {now} us"
            );
            beats += u32::from(lines.beat != last.beat);
            last = lines;
        }
        // 5 s of life at 250 ms a beat, the first at once.
        assert_eq!(beats, 20);
        assert_eq!(lamp.deadline(), None);
    }

    #[test]
    fn a_no_go_takes_a_go_back_at_once() {
        let mut lamp = VerdictLamp::new(Timing::DEFAULT);
        lamp.show(Timestamp(0), true);
        assert!(lamp.lines(Timestamp(1)).go);
        lamp.show(Timestamp(2), false);
        assert!(!lamp.lines(Timestamp(2)).go);
    }
}
