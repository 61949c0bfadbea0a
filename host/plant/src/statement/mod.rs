//! The one type for what an outlet may say. [`Standing`] holds the facts of the history; [`Standing::statement`] turns them into a
//! [`StationStatement`] for one moment, and every outlet renders that and nothing else.
//!
//! ```text
//!  history ──► Facts ──► Tracker (when was each check first seen, did the clock go back) ──► Standing ──► StationStatement
//!                                                                       page, Modbus, OPC UA, MQTT, metrics ◄──┘
//! ```
//!
//! It is made in this crate and not in `record`, because the age of a check depends on when this process first saw it, and on its
//! setting `stale_after_s`.
//!
//! | file | holds |
//! |---|---|
//! | `age` | age of a check by a clock that is never set, and steps of the wall clock |
//! | `model` | tests: every short sequence of events against what may be said |

mod age;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{Check, FlankRow, LastChecks};
use flankscope_record::origin::OriginKind;
use flankscope_record::seal::StandingNoGo;
use jiff::Timestamp;

use age::Sight;
pub use age::{Doubt, Moment, Tracker};

/// Time after which a look at the history no longer proves what it showed.
const LOOK_LIFE: Duration = Duration::from_secs(30);

/// Content of the history, read at one moment.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Newest checks of every tool and its checks by verdict; tools that the press or the bench checked last come first.
    pub tools: Vec<(LastChecks, Vec<(Word, u64)>)>,
    /// No-gos of all dies that are not acknowledged, the newest first.
    pub open_no_gos: Vec<StandingNoGo>,
    /// Date of the newest row.
    pub newest_date: Option<String>,
}

/// The facts of the history, with the moment at which this process first saw each check. Outlets get them as a
/// [`StationStatement`] only.
#[derive(Clone, Debug)]
pub struct Standing {
    dies: Vec<SeenDie>,
    open_no_gos: Vec<StandingNoGo>,
    fault: Option<Arc<str>>,
    stale_after: Duration,
    /// When the history was last looked at, ms since the computer started. Shared by all that is published.
    looked_ms: Arc<AtomicU64>,
}

/// The newest checks of a tool.
#[derive(Clone, Debug)]
struct SeenDie {
    /// The newest check of the press or the bench; the newest recording if there is no other.
    last: Arc<Check>,
    /// Age of that check; none for a recording.
    sight: Option<Sight>,
    latched: Option<StandingNoGo>,
    recording: Option<Arc<Check>>,
    counts: Vec<(Word, u64)>,
}

/// Statement about a station at one moment.
#[derive(Clone, Debug)]
pub struct StationStatement {
    /// Why the history cannot be read or believed: then nothing is said of any die.
    pub fault: Option<Arc<str>>,
    /// Verdict of the station as a whole: no-go while a no-go of any die is not acknowledged, else the verdict of the die that
    /// was checked last.
    pub verdict: Option<Word>,
    /// No-gos of all dies that are not acknowledged, the newest first; those known last while the history cannot be read.
    pub open_no_gos: Vec<StandingNoGo>,
    /// Dies, the most recently checked first; none while the history cannot be read.
    pub dies: Vec<DieStatement>,
    /// Age from which a verdict no longer counts.
    pub stale_after: Duration,
}

/// Statement about one die.
#[derive(Clone, Debug)]
pub struct DieStatement {
    /// The verdict that stands: a no-go however old it is, and while one is latched; another one only while it counts.
    pub verdict: Option<Word>,
    /// Whether the verdict of the last check counts.
    pub worth: Worth,
    /// The last check of the press or the bench; the last recording if there is no other, which never counts.
    pub last: Arc<Check>,
    /// Origin of that check.
    pub origin: OriginKind,
    /// When its last exposure ended, by the wall clock.
    pub exposed_at: Option<Timestamp>,
    /// Time since then; none if it is not known.
    pub age: Option<Duration>,
    /// Time for which this statement stays true without a further look: zero if the verdict does not count.
    pub valid_for: Duration,
    /// When the verdict stops counting, by the wall clock at the moment when the check was first seen.
    pub counts_until: Option<Timestamp>,
    /// The newest no-go of this die that is not acknowledged.
    pub latched: Option<StandingNoGo>,
    /// The newest recording, if it was stored after the last check. It is shown and never stands.
    pub recording: Option<Arc<Check>>,
    /// Stored checks by verdict, recordings included.
    pub counts: Vec<(Word, u64)>,
}

/// Whether the verdict of a check counts now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worth {
    Counts,
    /// It is too old.
    Stale,
    /// Its age cannot be proven, or it is a recording.
    Unknown(Doubt),
}

impl Worth {
    /// Why the age is not proven, if it is not.
    pub fn doubt(self) -> Option<Doubt> {
        match self {
            Self::Unknown(doubt) => Some(doubt),
            Self::Counts | Self::Stale => None,
        }
    }
}

impl Standing {
    /// Nothing is known yet.
    pub fn unread(stale_after: Duration) -> Self {
        Self {
            dies: Vec::new(),
            open_no_gos: Vec::new(),
            fault: Some("the history has not been read yet".into()),
            stale_after,
            looked_ms: Arc::default(),
        }
    }

    /// State of the station after the history was read.
    pub fn with_facts(&self, facts: &Facts, tracker: &mut Tracker, now: &Moment) -> Self {
        let sights = tracker.see(facts, now);
        let dies = facts.tools.iter().zip(sights);
        let dies = dies.filter_map(|((checks, counts), sight)| {
            let last = checks.check.clone().or(checks.recording.clone())?;
            let recording = checks.recording.clone().filter(|_| checks.check.is_some());
            let is_of_die = |no_go: &&StandingNoGo| {
                no_go.die.tool == checks.die.tool || no_go.die.is_same(&checks.die)
            };
            Some(SeenDie {
                last: Arc::new(last),
                sight,
                latched: facts.open_no_gos.iter().find(is_of_die).cloned(),
                recording: recording.map(Arc::new),
                counts: counts.clone(),
            })
        });
        let standing = Self {
            dies: dies.collect(),
            open_no_gos: facts.open_no_gos.clone(),
            fault: None,
            stale_after: self.stale_after,
            looked_ms: Arc::clone(&self.looked_ms),
        };
        standing.looked(now);
        standing
    }

    /// State of the station while the history cannot be read. What is latched stays; `remembered` are the no-gos that the station's
    /// memory knows, for a process that has not read the history yet.
    pub fn with_fault(&self, fault: &str, remembered: &[StandingNoGo]) -> Self {
        let mut open_no_gos = self.open_no_gos.clone();
        if open_no_gos.is_empty() {
            open_no_gos.extend_from_slice(remembered);
        }
        Self {
            dies: Vec::new(),
            open_no_gos,
            fault: Some(fault.into()),
            stale_after: self.stale_after,
            looked_ms: Arc::clone(&self.looked_ms),
        }
    }

    /// Notes that the history was looked at and is as it was.
    pub fn looked(&self, now: &Moment) {
        self.looked_ms
            .store(now.boot.since_boot_ms, Ordering::Relaxed);
    }

    /// Why the history cannot be read, if it cannot.
    pub fn fault(&self) -> Option<&Arc<str>> {
        self.fault.as_ref()
    }

    /// Statement at this moment.
    pub fn statement(&self, now: &Moment) -> StationStatement {
        let fault = self.fault.clone().or_else(|| self.unlooked(now));
        let dies = match fault {
            Some(_) => Vec::new(),
            None => self.dies.iter().map(|die| self.of_die(die, now)).collect(),
        };
        let verdict = if self.open_no_gos.is_empty() {
            dies.first().and_then(|die: &DieStatement| die.verdict)
        } else {
            Some(Word::NoGo)
        };
        StationStatement {
            fault,
            verdict,
            open_no_gos: self.open_no_gos.clone(),
            dies,
            stale_after: self.stale_after,
        }
    }

    /// The fault that nothing looked at the history for too long, for example because its disk does not answer.
    fn unlooked(&self, now: &Moment) -> Option<Arc<str>> {
        let looked_ms = self.looked_ms.load(Ordering::Relaxed);
        let since = Duration::from_millis(now.boot.since_boot_ms.saturating_sub(looked_ms));
        let why = || {
            format!(
                "the history was not read for {} s, the limit is {} s",
                since.as_secs(),
                LOOK_LIFE.as_secs()
            )
        };
        (since > LOOK_LIFE).then(|| why().into())
    }

    fn of_die(&self, die: &SeenDie, now: &Moment) -> DieStatement {
        let age = match &die.sight {
            Some(sight) => sight.age(now),
            None => Err(Doubt::Recording),
        };
        let worth = match age {
            Ok(age) if age > self.stale_after => Worth::Stale,
            Ok(_) => Worth::Counts,
            Err(doubt) => Worth::Unknown(doubt),
        };
        let is_recording = die.sight.is_none();
        let verdict = die.last.verdict;
        let is_no_go = die.latched.is_some() || (verdict == Word::NoGo && !is_recording);
        let counts = worth == Worth::Counts;
        let remaining = age.map_or(Duration::ZERO, |age| self.stale_after.saturating_sub(age));
        let sight = die.sight.as_ref();
        DieStatement {
            verdict: match is_no_go {
                true => Some(Word::NoGo),
                false => counts.then_some(verdict),
            },
            worth,
            last: Arc::clone(&die.last),
            origin: die.last.origin.kind(),
            exposed_at: sight.and_then(|sight| sight.exposed_at),
            age: age.ok(),
            valid_for: if counts { remaining } else { Duration::ZERO },
            counts_until: sight.and_then(|sight| sight.counts_until(self.stale_after)),
            latched: die.latched.clone(),
            recording: die.recording.clone(),
            counts: die.counts.clone(),
        }
    }
}

/// The flank with the most wear in a check, if any was measured.
pub fn most_worn(check: &Check) -> Option<&FlankRow> {
    let measured = check
        .flanks
        .iter()
        .filter_map(|flank| Some((flank.wear_um?, flank)));
    measured
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, flank)| flank)
}
