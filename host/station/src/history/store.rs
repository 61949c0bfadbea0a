//! The file: one SQLite database, written in whole transactions that are on the disk before they count.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use flankscope_metrology::verdict::{Code, Word};
use rusqlite::types::Type;
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, TransactionBehavior, params};

use super::error::HistoryError;
use super::schema::{APPLICATION_ID, FROM_1_TO_2, KEPT, TABLES, VERSION};
use crate::inspection::Inspection;
use crate::origin::{HeadId, Origin};

/// How long a writer waits for another one. Readers never wait and never keep a writer waiting.
const PATIENCE: Duration = Duration::from_secs(2);

/// A history: opened by one writer, read by any number beside it.
#[derive(Debug)]
pub struct History {
    connection: Connection,
    path: PathBuf,
}

/// A stored check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Check {
    /// Number, from 1.
    pub id: i64,
    /// When it was stored: ISO 8601, UTC, by the host's clock.
    pub at: String,
    /// Name of the tool.
    pub tool: String,
    /// Press cycles that the tool has done.
    pub tool_cycles: i64,
    /// The controller's own counter, since its power-up.
    pub press_cycles: i64,
    /// BLAKE3 of the baseline that wear is the difference to; absent where it is the deviation from CAD.
    pub baseline: Option<String>,
    /// Its verdict.
    pub verdict: Word,
    /// Why.
    pub reason: String,
    /// Where it comes from; nothing is known of the checks of layout 1.
    #[serde(flatten)]
    pub origin: Origin,
    /// One entry per inspected flank.
    pub flanks: Vec<FlankRow>,
}

/// A flank of a stored check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FlankRow {
    /// Tooth, from 1.
    pub tooth: u32,
    /// `left` or `right`.
    pub flank: String,
    /// Wear, µm; absent when it was not measured.
    pub wear_um: Option<f64>,
    /// Its expanded uncertainty (95 %), µm.
    pub u95_um: Option<f64>,
    /// Warn limit, µm.
    pub warn_um: f64,
    /// Stop limit, µm.
    pub limit_um: f64,
    /// Its verdict.
    pub verdict: Word,
    /// What kind of reason, where it is indeterminate.
    pub code: Option<Code>,
}

/// Somebody took note of a verdict.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Acknowledgement {
    /// When.
    pub at: String,
    /// Name of the tool.
    pub tool: String,
    /// Who.
    pub who: String,
    /// The check that stood at the press.
    pub inspection: Option<i64>,
}

impl History {
    /// Opens a history for writing; makes it where there is none, and brings an earlier layout up to this one.
    ///
    /// # Errors
    /// The file cannot be opened, is none of this instrument, or of a later release.
    pub fn open(path: &Path) -> Result<Self, HistoryError> {
        let history = Self::connect(
            path,
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE,
        )?;
        let sql = |doing| history.because(doing);
        let connection = &history.connection;
        // A reader sees the last whole state while a check is being stored, and a commit counts when it is on the disk.
        connection
            .pragma_update_and_check(None, "journal_mode", "wal", |_| Ok(()))
            .map_err(sql("set its journal"))?;
        for (name, value) in [("synchronous", "full"), ("foreign_keys", "on")] {
            connection
                .pragma_update(None, name, value)
                .map_err(sql("set it up"))?;
        }
        history.make_tables()?;
        history.check_layout()?;
        Ok(history)
    }

    /// Opens a history that is there, for reading only; a watch may write to it meanwhile.
    ///
    /// # Errors
    /// As [`History::open`].
    pub fn read(path: &Path) -> Result<Self, HistoryError> {
        let history = Self::connect(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        history.check_layout()?;
        Ok(history)
    }

    fn connect(path: &Path, flags: OpenFlags) -> Result<Self, HistoryError> {
        let failed = |source| HistoryError::Database {
            path: path.to_owned(),
            doing: "open it",
            source,
        };
        let flags = flags | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).map_err(failed)?;
        connection.busy_timeout(PATIENCE).map_err(failed)?;
        Ok(Self {
            connection,
            path: path.to_owned(),
        })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn because(
        &self,
        doing: &'static str,
    ) -> impl Fn(rusqlite::Error) -> HistoryError + Copy + use<'_> {
        move |source| HistoryError::Database {
            path: self.path.clone(),
            doing,
            source,
        }
    }

    fn number(&self, pragma: &str) -> Result<i32, HistoryError> {
        self.connection
            .pragma_query_value(None, pragma, |row| row.get(0))
            .map_err(self.because("read its header"))
    }

    /// Makes the tables of an empty file, all or none of them.
    fn make_tables(&self) -> Result<(), HistoryError> {
        let pragma = |name: &str| -> rusqlite::Result<i32> {
            self.connection
                .pragma_query_value(None, name, |row| row.get(0))
        };
        let make = || {
            // Another process may be making them at the same time: the lock comes before the look.
            self.connection.execute_batch("BEGIN IMMEDIATE")?;
            let objects: i64 =
                self.connection
                    .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
            if objects == 0 {
                self.connection.execute_batch(TABLES)?;
                KEPT.into_iter().try_for_each(|table| self.protect(table))?;
                self.connection
                    .pragma_update(None, "application_id", APPLICATION_ID)?;
                self.connection
                    .pragma_update(None, "user_version", VERSION)?;
            } else if pragma("application_id")? == APPLICATION_ID && pragma("user_version")? == 1 {
                self.connection.execute_batch(FROM_1_TO_2)?;
                self.protect("kind")?;
                self.connection.pragma_update(None, "user_version", 2)?;
            }
            self.connection.execute_batch("COMMIT")
        };
        make().map_err(|error| {
            let _ = self.connection.execute_batch("ROLLBACK");
            self.because("make its tables")(error)
        })
    }

    /// Rows of this table are only added.
    fn protect(&self, table: &str) -> rusqlite::Result<()> {
        for event in ["UPDATE", "DELETE"] {
            self.connection.execute_batch(&format!(
                "CREATE TRIGGER {table}_keeps_{event} BEFORE {event} ON {table} \
                 BEGIN SELECT RAISE(ABORT, 'a history is only added to'); END"
            ))?;
        }
        Ok(())
    }

    fn check_layout(&self) -> Result<(), HistoryError> {
        let path = || self.path.clone();
        match (self.number("application_id")?, self.number("user_version")?) {
            (APPLICATION_ID, 1..=VERSION) => Ok(()),
            (APPLICATION_ID, got) => Err(HistoryError::Newer {
                path: path(),
                got,
                known: VERSION,
            }),
            (got, _) => Err(HistoryError::Foreign {
                path: path(),
                got,
                expected: APPLICATION_ID,
            }),
        }
    }

    /// Refuses checks of the simulated bench in a history of a press, and the other way around.
    ///
    /// # Errors
    /// It holds checks of the other kind, or cannot be read.
    pub fn takes(&self, simulated: bool) -> Result<(), HistoryError> {
        match self.kind()? {
            Some((holds, since)) if holds != simulated => Err(HistoryError::OtherKind {
                path: self.path.clone(),
                simulated: holds,
                since,
            }),
            _ => Ok(()),
        }
    }

    /// Whether its checks are of the simulated bench, and since when; none while it has no check that says so.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn kind(&self) -> Result<Option<(bool, String)>, HistoryError> {
        if self.number("user_version")? < 2 {
            return Ok(None);
        }
        self.connection
            .query_row("SELECT simulated, at FROM kind", [], |row| {
                Ok((row.get(0)?, row.get(1)?))
            })
            .optional()
            .map_err(self.because("read what it is of"))
    }

    /// How many of its checks may be of the simulated bench or of a press: an earlier release stored them.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of_unknown_origin(&self) -> Result<i64, HistoryError> {
        let unknown = if self.number("user_version")? < 2 {
            "SELECT count(*) FROM inspection"
        } else {
            "SELECT count(*) FROM inspection WHERE simulated IS NULL"
        };
        self.connection
            .query_row(unknown, [], |row| row.get(0))
            .map_err(self.because("read it"))
    }

    /// Stores a check, whole or not at all; when this returns, it is on the disk. Returns its number.
    ///
    /// `tool_cycles` says how many cycles the tool has done. Without it they are counted on from the last stored check by
    /// the controller's counter, which begins at zero with its power-up.
    ///
    /// # Errors
    /// The disk is full, the file is locked for too long, it holds checks of the other kind, or worse. Nothing of the check
    /// is stored then.
    pub fn record(
        &mut self,
        inspection: &Inspection,
        tool_cycles: Option<u32>,
    ) -> Result<i64, HistoryError> {
        let simulated = inspection.origin.simulated;
        simulated.map_or(Ok(()), |simulated| self.takes(simulated))?;
        let document =
            serde_json::to_value(inspection).map_err(|source| HistoryError::Document {
                path: self.path.clone(),
                source,
            })?;
        let path = self.path.clone();
        let stored = self.insert(inspection, tool_cycles, document);
        let stored = stored.map_err(|source| HistoryError::Database {
            path: path.clone(),
            doing: "store the check",
            source,
        })?;
        match stored {
            Ok(id) => Ok(id),
            // Somebody else stored the first check meanwhile, of the other kind.
            Err((simulated, since)) => Err(HistoryError::OtherKind {
                path,
                simulated,
                since,
            }),
        }
    }

    fn insert(
        &mut self,
        inspection: &Inspection,
        tool_cycles: Option<u32>,
        mut document: serde_json::Value,
    ) -> rusqlite::Result<Result<i64, (bool, String)>> {
        let transaction = self
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)?;
        // The first check decides whether the file is of the simulated bench.
        if let Some(simulated) = inspection.origin.simulated {
            transaction.execute(
                "INSERT OR IGNORE INTO kind (one, simulated) VALUES (1, ?1)",
                [simulated],
            )?;
            let kind = "SELECT simulated, at FROM kind";
            let (holds, since) =
                transaction.query_row(kind, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
            if holds != simulated {
                return Ok(Err((holds, since)));
            }
        }
        let tool = &inspection.tool;
        let counter = i64::from(inspection.press_cycles);
        let last: Option<(i64, i64)> = transaction
            .query_row(
                "SELECT tool_cycles, press_cycles FROM inspection WHERE tool = ?1 ORDER BY id DESC LIMIT 1",
                [tool],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )
            .optional()?;
        let tool_cycles = match (tool_cycles, last) {
            (Some(cycles), _) => i64::from(cycles),
            (None, None) => counter,
            (None, Some((cycles, before))) if counter >= before => cycles + (counter - before),
            // The controller was switched off in between.
            (None, Some((cycles, _))) => cycles + counter,
        };
        // Nobody else adds a row meanwhile: the check knows its number before it has one.
        let id: i64 = transaction.query_row(
            "SELECT 1 + coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'inspection'), 0)",
            [],
            |row| row.get(0),
        )?;
        document["id"] = id.into();
        let Origin {
            link,
            simulated,
            head,
            station,
            operator,
            recording: _, // in the document
        } = &inspection.origin;
        transaction.execute(
            "INSERT INTO inspection (id, tool, tool_cycles, press_cycles, baseline, verdict, reason, document, \
             link, simulated, head, head_blake3, station, operator) \
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)",
            params![
                id,
                tool,
                tool_cycles,
                counter,
                inspection.hashes.get("baseline"),
                inspection.verdict.as_str(),
                inspection.reason,
                document.to_string(),
                link,
                simulated,
                head.as_ref().map(|head| &head.name),
                head.as_ref().map(|head| &head.blake3),
                station,
                operator
            ],
        )?;
        {
            let mut row = transaction.prepare(
                "INSERT INTO flank (inspection, tooth, flank, wear_um, u95_um, warn_um, limit_um, verdict, code) \
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
            )?;
            for feature in &inspection.features {
                row.execute(params![
                    id,
                    feature.tooth,
                    feature.flank,
                    feature.wear_um,
                    feature.u95_um,
                    feature.warn_um,
                    feature.limit_um,
                    feature.verdict.as_str(),
                    feature.code.map(Code::word)
                ])?;
            }
        }
        transaction.commit()?;
        Ok(Ok(id))
    }

    /// Keeps the baseline that following checks are judged by.
    ///
    /// # Errors
    /// As [`History::record`].
    pub fn keep_baseline(
        &mut self,
        blake3: &str,
        tool: &str,
        document: &str,
    ) -> Result<(), HistoryError> {
        self.connection
            .execute(
                "INSERT OR IGNORE INTO baseline (blake3, tool, document) VALUES (?1, ?2, ?3)",
                [blake3, tool, document],
            )
            .map_err(self.because("keep the baseline"))?;
        Ok(())
    }

    /// Notes who acknowledged what stood at the press.
    ///
    /// # Errors
    /// As [`History::record`]; what is not noted is not acknowledged.
    pub fn acknowledge(&mut self, tool: &str, who: &str) -> Result<(), HistoryError> {
        self.connection
            .execute(
                "INSERT INTO acknowledgement (tool, who, inspection) \
                 VALUES (?1, ?2, (SELECT max(id) FROM inspection WHERE tool = ?1))",
                [tool, who],
            )
            .map_err(self.because("note the acknowledgement"))?;
        Ok(())
    }

    /// Notes that somebody did something.
    ///
    /// # Errors
    /// As [`History::record`].
    pub fn audit(&mut self, who: &str, what: &str, detail: &str) -> Result<(), HistoryError> {
        self.connection
            .execute(
                "INSERT INTO audit (who, what, detail) VALUES (?1, ?2, ?3)",
                [who, what, detail],
            )
            .map_err(self.because("write its audit"))?;
        Ok(())
    }

    /// Names of the tools, the one checked last first.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn tools(&self) -> Result<Vec<String>, HistoryError> {
        self.rows(
            "SELECT tool FROM inspection GROUP BY tool ORDER BY max(id) DESC",
            [],
            |row| row.get(0),
        )
    }

    /// Every check of a tool, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn checks(&self, tool: &str) -> Result<Vec<Check>, HistoryError> {
        // A file of layout 1 that is only read stays as it is.
        let origin = if self.number("user_version")? < 2 {
            "NULL, NULL, NULL, NULL, NULL, NULL"
        } else {
            "link, simulated, head, head_blake3, station, operator"
        };
        let mut checks = self.rows(
            &format!(
                "SELECT id, at, tool, tool_cycles, press_cycles, baseline, verdict, reason, {origin} FROM inspection \
                 WHERE tool = ?1 ORDER BY id"
            ),
            [tool],
            |row| {
                let (name, blake3): (Option<String>, Option<String>) = (row.get(10)?, row.get(11)?);
                let head = name.map(|name| HeadId {
                    name,
                    blake3: blake3.unwrap_or_default(),
                });
                Ok(Check {
                    id: row.get(0)?,
                    at: row.get(1)?,
                    tool: row.get(2)?,
                    tool_cycles: row.get(3)?,
                    press_cycles: row.get(4)?,
                    baseline: row.get(5)?,
                    verdict: parsed(row, 6)?,
                    reason: row.get(7)?,
                    origin: Origin {
                        link: row.get(8)?,
                        simulated: row.get(9)?,
                        head,
                        station: row.get(12)?,
                        operator: row.get(13)?,
                        recording: None,
                    },
                    flanks: Vec::new(),
                })
            },
        )?;
        let flanks = self.rows(
            "SELECT inspection, tooth, flank, wear_um, u95_um, warn_um, limit_um, flank.verdict, code FROM flank \
             JOIN inspection ON inspection.id = inspection WHERE tool = ?1 ORDER BY inspection, tooth, flank",
            [tool],
            |row| {
                let flank = FlankRow {
                    tooth: row.get(1)?,
                    flank: row.get(2)?,
                    wear_um: row.get(3)?,
                    u95_um: row.get(4)?,
                    warn_um: row.get(5)?,
                    limit_um: row.get(6)?,
                    verdict: parsed(row, 7)?,
                    code: parsed_or_none(row, 8)?,
                };
                Ok((row.get::<_, i64>(0)?, flank))
            },
        )?;
        let mut flanks = flanks.into_iter().peekable();
        for check in &mut checks {
            while let Some((_, flank)) = flanks.next_if(|(id, _)| *id <= check.id) {
                check.flanks.push(flank);
            }
        }
        Ok(checks)
    }

    /// The result document of a check, as it was stored.
    ///
    /// # Errors
    /// There is no such check, or the file cannot be read.
    pub fn document(&self, id: i64) -> Result<String, HistoryError> {
        let found = self
            .connection
            .query_row(
                "SELECT document FROM inspection WHERE id = ?1",
                [id],
                |row| row.get(0),
            )
            .optional()
            .map_err(self.because("read a check"))?;
        match found {
            Some(document) => Ok(document),
            None => {
                let last = self
                    .connection
                    .query_row("SELECT max(id) FROM inspection", [], |row| row.get(0))
                    .map_err(self.because("read a check"))?;
                Err(HistoryError::NoSuchCheck {
                    path: self.path.clone(),
                    id,
                    last,
                })
            }
        }
    }

    /// The text of a baseline, by its hash.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn baseline(&self, blake3: &str) -> Result<Option<String>, HistoryError> {
        self.connection
            .query_row(
                "SELECT document FROM baseline WHERE blake3 = ?1",
                [blake3],
                |row| row.get(0),
            )
            .optional()
            .map_err(self.because("read a baseline"))
    }

    /// Hashes of the phasors of a check that ended in go; none for another verdict, or when there is no such check.
    pub(super) fn phasors_of_go(&self, id: i64) -> Result<Vec<String>, HistoryError> {
        self.rows(
            "SELECT phasors.value FROM inspection, json_each(document, '$.evidence') AS view, \
             json_each(view.value, '$.phasors') AS phasors WHERE inspection.id = ?1 AND verdict = 'go'",
            [id],
            |row| row.get(0),
        )
    }

    /// The acknowledgements of a tool, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn acknowledgements(&self, tool: &str) -> Result<Vec<Acknowledgement>, HistoryError> {
        self.rows(
            "SELECT at, tool, who, inspection FROM acknowledgement WHERE tool = ?1 ORDER BY id",
            [tool],
            |row| {
                Ok(Acknowledgement {
                    at: row.get(0)?,
                    tool: row.get(1)?,
                    who: row.get(2)?,
                    inspection: row.get(3)?,
                })
            },
        )
    }

    /// The verdicts of a tool since it was last acknowledged, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn open_verdicts(&self, tool: &str) -> Result<Vec<Word>, HistoryError> {
        self.rows(
            "SELECT verdict FROM inspection WHERE tool = ?1 AND id > coalesce( \
             (SELECT inspection FROM acknowledgement WHERE tool = ?1 ORDER BY id DESC LIMIT 1), 0) ORDER BY id",
            [tool],
            |row| parsed(row, 0),
        )
    }

    fn rows<T>(
        &self,
        sql: &str,
        parameters: impl rusqlite::Params,
        row: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, HistoryError> {
        let read = || -> rusqlite::Result<Vec<T>> {
            let mut statement = self.connection.prepare(sql)?;
            statement.query_map(parameters, row)?.collect()
        };
        read().map_err(self.because("read it"))
    }
}

/// A word of a closed list: one that is not in it is an error, never taken for another.
fn parsed<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<T>
where
    T: FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    let word: String = row.get(column)?;
    word.parse().map_err(|error| {
        rusqlite::Error::FromSqlConversionFailure(column, Type::Text, Box::new(error))
    })
}

/// The same where there may be none.
fn parsed_or_none<T>(row: &Row<'_>, column: usize) -> rusqlite::Result<Option<T>>
where
    T: FromStr<Err: std::error::Error + Send + Sync + 'static>,
{
    match row.get_ref(column)? {
        rusqlite::types::ValueRef::Null => Ok(None),
        _ => parsed(row, column).map(Some),
    }
}
