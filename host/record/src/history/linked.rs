//! Checks with their links of the chain, from a position on: what is copied elsewhere and compared with the history later.

use rusqlite::{Transaction, TransactionBehavior, params};

use super::error::HistoryError;
use super::rows::Check;
use super::store::History;

/// A stored check and its link.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkedCheck {
    pub check: Check,
    /// BLAKE3 of CAD and gear data.
    pub geometry: String,
    /// Number of its link.
    pub link: i64,
    /// Digest of that link: of the check and, by the link before it, of every row before it.
    pub digest: String,
}

/// Where and when a check was stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Whereabouts {
    /// Number of the check.
    pub check: i64,
    /// When: ISO 8601, UTC, by the host's clock.
    pub at: String,
    /// Name of the station.
    pub station: String,
}

impl History {
    /// Id of the history, created with the file; every copy of it has the same.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn id(&self) -> Result<String, HistoryError> {
        self.connection()
            .query_row("SELECT id FROM identity", [], |row| row.get(0))
            .map_err(self.because("read its id"))
    }

    /// Id of the station's key by which it is read.
    #[must_use]
    pub fn station_key(&self) -> String {
        self.seals().station()
    }

    /// Digest of the link with which a person last accepted the file as it is ([`History::trust`]), which makes all links anew.
    /// `None`: never. While it is the same, a link that was once read stays as it is.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn relinked(&self) -> Result<Option<String>, HistoryError> {
        let digests = self.rows(
            "SELECT digest FROM chain JOIN audit ON source = 'audit' AND key = CAST(id AS TEXT) \
             WHERE what = 'trust' ORDER BY id DESC LIMIT 1",
            [],
            |row| row.get(0),
        )?;
        Ok(digests.into_iter().next())
    }

    /// Where and when each check after `id` was stored, at most `most`, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn whereabouts_after(&self, id: i64, most: u32) -> Result<Vec<Whereabouts>, HistoryError> {
        self.rows(
            "SELECT id, at, station FROM inspection WHERE id > ?1 ORDER BY id LIMIT ?2",
            params![id, most],
            |row| {
                Ok(Whereabouts {
                    check: row.get(0)?,
                    at: row.get(1)?,
                    station: row.get(2)?,
                })
            },
        )
    }

    /// Names that the station had, in the order of their first check.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn station_names(&self) -> Result<Vec<String>, HistoryError> {
        self.rows(
            "SELECT station FROM inspection GROUP BY station ORDER BY min(id)",
            [],
            |row| row.get(0),
        )
    }

    /// The checks of these numbers with their links, in order, at one moment of the file. `after_link` is the link of a check before
    /// them, or 0: links are searched from there on.
    ///
    /// # Errors
    /// A check has no link behind that, or the file cannot be read.
    pub fn linked_checks(
        &self,
        ids: std::ops::RangeInclusive<i64>,
        after_link: i64,
    ) -> Result<Vec<LinkedCheck>, HistoryError> {
        // One snapshot of rows and links; a writer does not wait for it.
        let _moment = Transaction::new_unchecked(self.connection(), TransactionBehavior::Deferred)
            .map_err(self.because("read it"))?;
        let checks = self.checks_where("id BETWEEN ?1 AND ?2", [*ids.start(), *ids.end()])?;
        let mut geometry_and_link = self
            .connection()
            .prepare(
                "SELECT geometry, of.link, of.digest FROM inspection, \
                 (SELECT link, digest FROM chain WHERE link > ?2 AND source = 'inspection' AND key = CAST(?1 AS TEXT) LIMIT 1) AS of \
                 WHERE id = ?1",
            )
            .map_err(self.because("read its links"))?;
        let mut linked = Vec::with_capacity(checks.len());
        // Links are in the order of the checks.
        let mut before = after_link;
        for check in checks {
            let found = geometry_and_link.query_row(params![check.id, before], |row| {
                Ok((row.get(0)?, row.get(1)?, row.get(2)?))
            });
            let (geometry, link, digest) = match found {
                Ok(found) => found,
                Err(rusqlite::Error::QueryReturnedNoRows) => {
                    return Err(self.broken(format!("check {} has no link", check.id)));
                }
                Err(error) => return Err(self.because("read its links")(error)),
            };
            before = link;
            linked.push(LinkedCheck {
                check,
                geometry,
                link,
                digest,
            });
        }
        Ok(linked)
    }
}
