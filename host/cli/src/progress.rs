//! Progress of a run, on standard error.

use std::time::{Duration, Instant};

use flankscope_instrument::acquisition::Progress;

use crate::output::say;

/// Prints the progress of a run, a line for every step.
pub struct Watcher {
    quiet: bool,
    start: Instant,
    views: Steps,
}

impl Watcher {
    /// Silent if `quiet`. `names` are those of the plan's views; views without a name are numbered.
    pub fn new(quiet: bool, names: Vec<String>) -> Self {
        Self {
            quiet,
            start: Instant::now(),
            views: Steps::new(names),
        }
    }

    /// Prints a step.
    pub fn show(&mut self, progress: Progress) {
        let line = self.views.step(progress).filter(|_| !self.quiet);
        if let Some(line) = line {
            say(&format!(
                "{:6.2} s  {line}",
                self.start.elapsed().as_secs_f64()
            ));
        }
    }
}

/// Says what a run does now, with the names of its views.
pub struct Steps {
    names: Vec<String>,
    /// The view that the head is at.
    at: usize,
}

impl Steps {
    /// `names` are those of the plan's views; views without a name are numbered.
    pub fn new(names: Vec<String>) -> Self {
        Self { names, at: 0 }
    }

    /// What begins with this progress, if anything that people follow does.
    pub fn step(&mut self, progress: Progress) -> Option<String> {
        Some(match progress {
            Progress::Connected => "controller answered".into(),
            Progress::Homing => "stages reference".into(),
            Progress::Planned(time) => format!("plan: {time}"),
            Progress::Moving { view, number, of } => {
                self.at = view;
                format!(
                    "head moves to {} (view {} of {of})",
                    self.name(view),
                    number + 1
                )
            }
            Progress::Exposed { frame: 0, of } => {
                format!("LED on, {of} frames of {}", self.name(self.at))
            }
            Progress::Exposed { .. } => return None,
            Progress::Recapture(view) => format!("{} is captured again", self.name(view)),
            Progress::Repeat(view) => format!(
                "{} is too near to a limit and is measured again",
                self.name(view)
            ),
            Progress::Further(view) => format!(
                "{} is not seen well enough and is looked at from the side",
                self.name(view)
            ),
            Progress::Retracting => "head retracts".into(),
            Progress::Evaluated(view) => format!("{} evaluated", self.name(view)),
        })
    }

    fn name(&self, view: usize) -> String {
        let named = self.names.get(view).cloned();
        named.unwrap_or_else(|| format!("view {}", view + 1))
    }
}

/// Prints how many of many alike steps are done and what time remains, now and then.
pub struct Countdown {
    quiet: bool,
    what: &'static str,
    of: usize,
    begun: Instant,
    printed: Instant,
}

impl Countdown {
    /// Time between two lines.
    const BETWEEN: Duration = Duration::from_secs(2);

    /// Silent if `quiet`, and in the first two seconds. `what` are the steps, as in "views".
    pub fn new(quiet: bool, what: &'static str, of: usize) -> Self {
        let begun = Instant::now();
        Self {
            quiet,
            what,
            of,
            begun,
            printed: begun,
        }
    }

    /// A step is done, the number `done` of them.
    pub fn step(&mut self, done: usize) {
        if self.quiet || self.printed.elapsed() < Self::BETWEEN {
            return;
        }
        self.printed = Instant::now();
        let pace = self.begun.elapsed() / u32::try_from(done.max(1)).unwrap_or(u32::MAX);
        say_remaining(self.what, [done, self.of], pace * (self.of - done) as u32);
    }
}

/// Prints a line of progress: steps done, of how many, and the remaining time.
pub fn say_remaining(what: &str, [done, of]: [usize; 2], remaining: Duration) {
    let seconds = remaining.as_secs_f64().round();
    say(&format!("{done:>4} of {of} {what}, {seconds} s to go"));
}
