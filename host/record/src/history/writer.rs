//! Stores checks: a verdict counts only after it is stored.

use flankscope_metrology::verdict::{Code, Latch, Reason};
use rayon::prelude::*;

use super::error::HistoryError;
use super::hold::{Hold, hold};
use super::phasors::pack;
use super::retention::Retention;
use super::store::History;
use crate::baseline::Baseline;
use crate::check_request::take_check_request;
use crate::die::DieKey;
use crate::document::Inspection;
use crate::sink::{ResultSink, SinkError};

/// The sink that a verdict waits for.
#[derive(Debug)]
pub struct HistoryWriter {
    history: History,
    /// Cycles of the tool at the next check, if stated by the operator.
    tool_cycles: Option<u32>,
    keep: Retention,
    operator: String,
    simulated: bool,
}

impl HistoryWriter {
    /// Stores checks in `history`. `tool_cycles` are the cycles of the tool at the next check, if known better than from the last
    /// check. `operator` runs the instrument.
    #[must_use]
    pub fn new(
        history: History,
        tool_cycles: Option<u32>,
        keep: Retention,
        operator: String,
    ) -> Self {
        Self {
            history,
            tool_cycles,
            keep,
            operator,
            simulated: false,
        }
    }

    /// A sentence on what will be deleted next, if the space for phasors is nearly full.
    ///
    /// # Errors
    /// The history cannot be read.
    pub fn room(&self) -> Result<Option<String>, HistoryError> {
        self.history.room(self.keep)
    }

    /// Records that the instrument starts with this tool, on the simulated bench or not, and stores the baseline that it uses.
    ///
    /// # Errors
    /// The history cannot be written, or is simulated while the instrument is not (or the reverse).
    pub fn begin(
        &mut self,
        die: &DieKey,
        simulated: bool,
        baseline: Option<&Baseline>,
    ) -> Result<(), HistoryError> {
        self.history.takes(simulated)?;
        self.simulated = simulated;
        if let Some(baseline) = baseline {
            self.history
                .keep_baseline(&baseline.hash(), &die.tool, &baseline.document())?;
        }
        let version = concat!("flankscope ", env!("CARGO_PKG_VERSION"));
        self.history
            .audit(&self.operator, "open", &format!("{version}, {}", die.tool))
    }

    /// Stores a check; its phasors first, so that they exist for every stored check.
    fn store(&mut self, inspection: &mut Inspection) -> Result<i64, HistoryError> {
        let phasors = std::mem::take(&mut inspection.phasors);
        let history = &self.history;
        let packed: Vec<_> = phasors.par_iter().map(|p| pack(&p.bytes)).collect();
        for (phasors, packed) in phasors.iter().zip(packed) {
            let packed = packed.map_err(|source| HistoryError::Phasors {
                path: history.phasors_folder(),
                source,
            })?;
            history.keep_phasors(&phasors.blake3, &packed)?;
        }
        let id = self.history.record(inspection, self.tool_cycles)?;
        // The check is stored; keeping old phasors longer does no harm.
        if let Err(error) = self.history.give_up(id, self.keep) {
            tracing::warn!(%error, "old phasors are not removed");
        }
        Ok(id)
    }

    /// Stores an acknowledgement of the checks up to `seen`, in the operator's name if no other is given.
    ///
    /// # Errors
    /// As [`History::acknowledge`].
    pub fn acknowledge(&mut self, die: &DieKey, seen: i64, name: &str) -> Result<(), HistoryError> {
        let who = if name.is_empty() {
            self.operator.clone()
        } else {
            name.to_owned()
        };
        self.history.acknowledge(die, seen, &who)
    }

    /// Verdicts that were still unacknowledged when the instrument was last switched off.
    pub fn latch(&self, die: &DieKey) -> Result<Latch, HistoryError> {
        Ok(Latch::resumed(&self.history.open_verdicts(die)?))
    }

    /// Number of the newest check of a die; 0 before the first.
    ///
    /// # Errors
    /// The history cannot be read.
    pub fn newest_check(&self, die: &DieKey) -> Result<i64, HistoryError> {
        self.history.newest_check(die)
    }

    /// Number of acknowledgements of a die, by this process or another one.
    ///
    /// # Errors
    /// The history cannot be read.
    pub fn acknowledgement_count(&self, die: &DieKey) -> Result<i64, HistoryError> {
        self.history.acknowledgement_count(die)
    }

    /// Takes away a request for a check, and returns who made it.
    #[must_use]
    pub fn take_check_request(&self) -> Option<String> {
        take_check_request(self.history.path())
    }

    /// Locks a die for a watch, after verifying the history's chain. `None` if the station keeps no folder in which another watch
    /// could see the lock.
    ///
    /// # Errors
    /// The chain is broken, another watch runs on the die, or another history of this station has an unacknowledged no-go for it.
    pub fn hold(&self, die: &DieKey) -> Result<Option<Hold>, HistoryError> {
        self.history.verify()?;
        let seals = self.history.seals();
        // On the simulated bench, every history is of a die of its own.
        if !self.simulated
            && let Some((elsewhere, stands)) = seals.stands_elsewhere(die, &self.history.id()?)?
        {
            return Err(HistoryError::StandsElsewhere {
                path: self.history.path().to_owned(),
                elsewhere,
                stands: Box::new(stands),
            });
        }
        let folder = seals.place_for("watches");
        hold(folder, self.history.path(), die, &self.operator)
    }
}

impl ResultSink<Inspection> for HistoryWriter {
    /// Stores a finished check and numbers it. If that fails, "go" and "warn" are revoked; a no-go stays.
    fn put(&mut self, inspection: &mut Inspection) -> Result<(), SinkError> {
        match self.store(inspection) {
            Ok(id) => {
                inspection.id = Some(id);
                self.tool_cycles = None;
            }
            Err(error) => {
                tracing::error!(%error, "the check is not stored");
                inspection.withhold(&Reason::instrument(Code::NotStored, error));
            }
        }
        Ok(())
    }
}
