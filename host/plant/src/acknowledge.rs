//! Acknowledging a no-go: who may, with which reason, and of which check. The page and OPC UA do it the same way.

use std::path::PathBuf;

use flankscope_foundation::display::is_command;
use flankscope_record::history::{History, HistoryError};
use flankscope_record::seal::Seals;

use crate::access::User;

/// Longest reason of an acknowledgement, characters.
pub const MOST_REASON: usize = 200;

/// Why a no-go was not acknowledged.
#[derive(Debug, thiserror::Error)]
pub enum Refused {
    #[error("the role of {0} is to view, not to acknowledge")]
    NotAllowed(String),
    #[error("a reason of 1 to {MOST_REASON} characters is needed")]
    NoReason,
    /// No unacknowledged no-go has this number: a newer one stands, or somebody was faster.
    #[error(
        "check {0} is not the no-go that stands now: look again, a newer one may, or somebody acknowledged it"
    )]
    NotStanding(i64),
    #[error(transparent)]
    History(HistoryError),
}

impl From<HistoryError> for Refused {
    fn from(error: HistoryError) -> Self {
        match error {
            HistoryError::NotStanding { check, .. } => Self::NotStanding(check),
            HistoryError::NewerNoGo { seen, .. } => Self::NotStanding(seen),
            error => Self::History(error),
        }
    }
}

/// The history in which acknowledgements are stored.
#[derive(Clone, Debug)]
pub struct Acknowledging {
    pub history: PathBuf,
    pub seals: Seals,
}

impl Acknowledging {
    /// Stores the name of the person who acknowledged the no-go of a check, and the reason, if that no-go stands in the transaction that stores it and, where a tool is
    /// named, is that tool's. It waits for the disk. A watch that runs obeys it, and checks again at the next opening.
    ///
    /// # Errors
    /// The user may not, the reason is unusable, no such no-go stands, or the history cannot be written.
    pub fn store(
        &self,
        user: &User,
        check: i64,
        tool: Option<&str>,
        reason: &str,
    ) -> Result<(), Refused> {
        if !user.role.acknowledges() {
            return Err(Refused::NotAllowed(user.name.clone()));
        }
        let reason = reason.trim();
        if reason.is_empty() || reason.chars().count() > MOST_REASON || reason.contains(is_command)
        {
            return Err(Refused::NoReason);
        }
        let mut history = History::open(&self.history, &self.seals)?;
        history.acknowledge_no_go(check, tool, &format!("{}: {reason}", user.name))?;
        tracing::info!("{} acknowledged check {check}: {reason}", user.name);
        Ok(())
    }
}
