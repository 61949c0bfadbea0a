//! Follows the history from a thread of its own: looks every second whether something was committed or the file was changed, and
//! publishes what stands.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use flankscope_record::history::{History, HistoryError};
use flankscope_record::seal::{Seals, StandingNoGo};
use tokio::sync::watch;

use crate::history::HistoryFile;
use crate::settings::Settings;
use crate::statement::{Facts, Moment, Standing, Tracker};

/// How often it looks.
const EVERY: Duration = Duration::from_secs(1);

/// Begins to follow the history. One that cannot be read is a fault that is shown, and it is tried again.
///
/// # Errors
/// No thread can be started.
pub fn follow(
    settings: &Settings,
    seals: Seals,
) -> std::io::Result<watch::Receiver<Arc<Standing>>> {
    let stale_after = Duration::from_secs(settings.stale_after_s.into());
    let mut follower = Follower {
        file: HistoryFile::new(&settings.history, seals.clone()),
        path: settings.history.clone(),
        seals,
        tracker: Tracker::default(),
    };
    let (publish, standing) = watch::channel(Arc::new(Standing::unread(stale_after)));
    thread::Builder::new()
        .name("follow".into())
        .spawn(move || {
            while !publish.is_closed() {
                let before = Arc::clone(&publish.borrow());
                if let Some(now) = follower.look(&before) {
                    publish.send_replace(Arc::new(now));
                }
                thread::sleep(EVERY);
            }
        })?;
    Ok(standing)
}

struct Follower {
    file: HistoryFile,
    path: PathBuf,
    seals: Seals,
    tracker: Tracker,
}

impl Follower {
    /// Looks at the history; returns what stands if that differs from the last look.
    fn look(&mut self, before: &Standing) -> Option<Standing> {
        let now = Moment::now();
        let went_back = self.tracker.clock_went_back(&now);
        if went_back {
            tracing::warn!(
                "clock_set_back: the clock went back to {}; a check counts again once it was made after that",
                now.wall
            );
        }
        let is_new = went_back || before.fault().is_some();
        match self.facts(is_new) {
            Ok(Some(facts)) => Some(before.with_facts(&facts, &mut self.tracker, &now)),
            Ok(None) => {
                before.looked(&now);
                None
            }
            Err(error) => {
                self.file.close();
                let fault = error.to_string();
                if before.fault().is_some_and(|before| **before == *fault) {
                    return None;
                }
                tracing::warn!("{fault}");
                Some(before.with_fault(&fault, &self.remembered()))
            }
        }
    }

    /// Reads the facts of the history, if they may have changed since the last look or if `always` is set.
    fn facts(&mut self, always: bool) -> Result<Option<Facts>, HistoryError> {
        let (history, is_changed) = self.file.verified()?;
        (is_changed || always).then(|| facts(history)).transpose()
    }

    /// No-gos of this history in the station's own memory.
    fn remembered(&self) -> Vec<StandingNoGo> {
        let anchor = self.seals.anchor_at(&self.path);
        anchor
            .ok()
            .flatten()
            .map_or(Vec::new(), |anchor| anchor.stands)
    }
}

fn facts(history: &History) -> Result<Facts, HistoryError> {
    let mut tools = Vec::new();
    for checks in history.last_checks()? {
        let counts = history.verdict_counts(&checks.die.tool)?;
        tools.push((checks, counts));
    }
    Ok(Facts {
        tools,
        open_no_gos: history.standing_no_gos()?,
        newest_date: history.newest_date()?,
    })
}
