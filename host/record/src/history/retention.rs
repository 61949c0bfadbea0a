//! Which phasors are kept: by the number of checks stored since, and by the space that they take.
//!
//! Phasors of a "go" are deleted first, those of warnings and indeterminate checks later, those of a no-go never. A file is
//! deleted once no check that keeps its phasors refers to it.

use std::collections::BTreeMap;

use super::error::HistoryError;
use super::store::History;

/// Warnings and indeterminate checks keep their phasors for this many times as many later checks as a "go": they are examined
/// afterwards, and are fewer.
const LONGER: i64 = 10;
/// Fraction of the space above which the next deletions are announced.
const NEARLY_FULL: f64 = 0.8;

/// Limits for keeping phasors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// Number of later checks after which the phasors of a "go" are deleted.
    pub checks: u32,
    /// Largest total size of all phasors, bytes; those of no-gos are kept even above it.
    pub bytes: u64,
}

impl History {
    /// Deletes phasors that need not be kept once check `newest` is stored.
    pub(super) fn give_up(&self, newest: i64, keep: Retention) -> Result<(), HistoryError> {
        let checks = i64::from(keep.checks);
        let old = self.rows(
            "SELECT DISTINCT id FROM phasors JOIN inspection ON id = phasors.inspection \
             WHERE verdict = 'go' AND id <= ?1 OR verdict IN ('warn', 'indeterminate') AND id <= ?2 ORDER BY id",
            [newest - checks, newest - LONGER.saturating_mul(checks)],
            |row| row.get(0),
        )?;
        for id in old {
            self.forget(id)?;
        }
        let sizes = self.phasor_sizes();
        let mut bytes: u64 = sizes.values().sum();
        if bytes <= keep.bytes {
            return Ok(());
        }
        let next = self.rows(
            "SELECT DISTINCT id, verdict FROM phasors JOIN inspection ON id = phasors.inspection \
             WHERE verdict != 'no-go' AND id < ?1 \
             ORDER BY CASE verdict WHEN 'go' THEN 0 WHEN 'warn' THEN 1 ELSE 2 END, id",
            [newest],
            |row| row.get::<_, i64>(0),
        )?;
        for id in next {
            if bytes <= keep.bytes {
                return Ok(());
            }
            for hash in self.forget(id)? {
                bytes -= sizes.get(&hash).copied().unwrap_or_default();
            }
        }
        if bytes > keep.bytes {
            tracing::warn!(
                "the phasors of no-gos alone take {:.1} GB, more than the {:.1} GB of history.keep_phasors_gb: they stay",
                bytes as f64 / 1e9,
                keep.bytes as f64 / 1e9
            );
        }
        Ok(())
    }

    /// A sentence on what will be deleted next, if the space for phasors is nearly full.
    pub(super) fn room(&self, keep: Retention) -> Result<Option<String>, HistoryError> {
        let bytes: u64 = self.phasor_sizes().values().sum();
        if (bytes as f64) < NEARLY_FULL * keep.bytes as f64 {
            return Ok(None);
        }
        let checks = self.rows(
            "SELECT count(DISTINCT inspection) FROM phasors",
            [],
            |row| row.get::<_, i64>(0),
        )?;
        let checks = checks.first().copied().unwrap_or_default();
        Ok(Some(format!(
            "history {}: the phasors of {checks} checks take {:.2} of {:.2} GB; beyond that the oldest go gives its own up, \
             then the oldest warning, then what was indeterminate; a no-go keeps them",
            self.path().display(),
            bytes as f64 / 1e9,
            keep.bytes as f64 / 1e9
        )))
    }

    /// Drops a check's claim on its phasors and removes files that no other check needs. Returns their hashes.
    fn forget(&self, id: i64) -> Result<Vec<String>, HistoryError> {
        let hashes: Vec<String> = self.rows(
            "SELECT blake3 FROM phasors WHERE inspection = ?1 AND NOT EXISTS \
             (SELECT 1 FROM phasors AS other WHERE other.blake3 = phasors.blake3 AND other.inspection != ?1)",
            [id],
            |row| row.get(0),
        )?;
        let sql = "DELETE FROM phasors WHERE inspection = ?1";
        let done = self.connection().execute(sql, [id]);
        done.map_err(self.because("give up phasors"))?;
        for hash in &hashes {
            self.forget_phasors(hash);
        }
        Ok(hashes)
    }

    /// Size of every phasor file, bytes, by hash.
    fn phasor_sizes(&self) -> BTreeMap<String, u64> {
        let entries = std::fs::read_dir(self.phasors_folder());
        let files = entries.into_iter().flatten().flatten();
        files
            .filter_map(|file| {
                let name = file.file_name().to_string_lossy().into_owned();
                let hash = name.strip_suffix(".zz")?.to_owned();
                Some((hash, file.metadata().ok()?.len()))
            })
            .collect()
    }
}
