//! The file: one SQLite database, written in whole transactions that are on the disk before they count.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use flankscope_metrology::verdict::{Code, Word};
use rusqlite::types::Type;
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, TransactionBehavior, params};

use super::chain;
use super::error::HistoryError;
use super::same_die::{columns, same, same_as_asked};
use super::schema::{
    APPLICATION_ID, FLANK_3_TO_4, FROM_1_TO_2, FROM_2_TO_3, KEPT, PHASORS, TABLES, VERSION,
};
use crate::die::DieKey;
use crate::inspection::{FeatureId, Inspection};
use crate::origin::{HeadId, Origin};
use crate::seal::Seals;

/// How long a writer waits for another one. Readers never wait and never keep a writer waiting.
const PATIENCE: Duration = Duration::from_secs(2);

/// A history: opened by one writer, read by any number beside it.
#[derive(Debug)]
pub struct History {
    connection: Connection,
    path: PathBuf,
    seals: Seals,
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
    /// Serial number of the tool, where its file names one.
    pub serial: Option<String>,
    /// One entry per inspected flank or patch.
    pub flanks: Vec<FlankRow>,
}

/// A flank or patch of a stored check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FlankRow {
    /// Which one.
    #[serde(flatten)]
    pub id: FeatureId,
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
    /// The file cannot be opened, is none of this instrument, of a later release, or not the one that this station last
    /// wrote to here.
    pub fn open(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        let mut anchor = seals.anchor(path)?;
        if !std::fs::metadata(path).is_ok_and(|meta| meta.len() > 0) {
            if let Some(stands) = anchor.take().and_then(|anchor| anchor.stands) {
                let path = path.to_owned();
                return Err(HistoryError::Gone { path, stands });
            }
            seals.forget_anchor(path)?;
        }
        let history = Self::open_unchecked(path, seals)?;
        history.holds_anchor(anchor.as_ref())?;
        Ok(history)
    }

    pub(super) fn open_unchecked(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        close_to_others(path);
        let history = Self::connect(
            path,
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE,
            seals,
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
        history.not_set_back()?;
        history.make_tables()?;
        history.check_layout()?;
        Ok(history)
    }

    /// Opens a history that is there, for reading only; a watch may write to it meanwhile.
    ///
    /// # Errors
    /// As [`History::open`].
    pub fn read(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        let mut history = Self::connect(path, OpenFlags::SQLITE_OPEN_READ_ONLY, seals)?;
        // In a folder that only may be read no journal can be shared. Where there is none either, nobody writes.
        if history.number("schema_version").is_err() && journal_is_empty(path) {
            history = Self::connect_unchanging(path, seals)?;
        }
        history.check_layout()?;
        history.holds_anchor(seals.anchor(path)?.as_ref())?;
        Ok(history)
    }

    fn connect(path: &Path, flags: OpenFlags, seals: &Seals) -> Result<Self, HistoryError> {
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
            seals: seals.clone(),
        })
    }

    /// A file that cannot change, with neither lock nor journal.
    fn connect_unchanging(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        use std::fmt::Write;
        let mut uri = String::from("file:");
        for byte in path.as_os_str().as_encoded_bytes() {
            // What means something in a URI, and what is no ASCII, is told by its number.
            if byte.is_ascii_alphanumeric() || b"/.-_~".contains(byte) {
                uri.push(char::from(*byte));
            } else {
                let _ = write!(uri, "%{byte:02X}");
            }
        }
        uri += "?immutable=1";
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
        let mut history = Self::connect(Path::new(&uri), flags, seals)?;
        history.path = path.to_owned();
        Ok(history)
    }

    pub(super) fn seals(&self) -> &Seals {
        &self.seals
    }

    pub(super) fn connection(&self) -> &Connection {
        &self.connection
    }

    pub(super) fn connection_mut(&mut self) -> &mut Connection {
        &mut self.connection
    }

    /// Version of its tables.
    pub(super) fn layout(&self) -> Result<i32, HistoryError> {
        self.number("user_version")
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn because(
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
                chain::link_all(&self.connection, &self.seals)?;
                self.connection
                    .pragma_update(None, "application_id", APPLICATION_ID)?;
                self.connection
                    .pragma_update(None, "user_version", VERSION)?;
            } else if pragma("application_id")? == APPLICATION_ID {
                let layout = pragma("user_version")?;
                if layout == 1 {
                    self.connection.execute_batch(FROM_1_TO_2)?;
                    self.protect("kind")?;
                }
                if layout == 1 || layout == 2 {
                    self.connection.execute_batch(FROM_2_TO_3)?;
                    ["identity", "chain"]
                        .into_iter()
                        .try_for_each(|table| self.protect(table))?;
                    chain::link_all(&self.connection, &self.seals)?;
                }
                if (1..4).contains(&layout) {
                    self.connection.execute_batch(FLANK_3_TO_4)?;
                    self.protect("flank")?;
                    self.connection
                        .pragma_update(None, "user_version", VERSION)?;
                }
            }
            let ours = pragma("application_id")? == APPLICATION_ID;
            if ours && pragma("user_version")? == VERSION && !self.has_table("phasors")? {
                self.connection.execute_batch(PHASORS)?;
            }
            self.connection.execute_batch("COMMIT")
        };
        make().map_err(|error| {
            let _ = self.connection.execute_batch("ROLLBACK");
            self.because("make its tables")(error)
        })
    }

    fn has_table(&self, name: &str) -> rusqlite::Result<bool> {
        let sql = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name = ?1";
        self.connection.query_row(sql, [name], |row| row.get(0))
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

    /// Before layout 3 nothing was signed: a number that was set back would have everything believed.
    fn not_set_back(&self) -> Result<(), HistoryError> {
        let layout = self.number("user_version")?;
        let unsigned = self.number("application_id")? == APPLICATION_ID && (1..3).contains(&layout);
        if unsigned
            && self
                .has_table("chain")
                .map_err(self.because("read its layout"))?
        {
            return Err(HistoryError::Broken {
                path: self.path.clone(),
                why: format!(
                    "it says that it has layout {layout}, which has no chain, and it has one"
                ),
            });
        }
        Ok(())
    }

    fn check_layout(&self) -> Result<(), HistoryError> {
        self.not_set_back()?;
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
            Ok(id) => {
                self.remember();
                Ok(id)
            }
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
            let begun = transaction.execute(
                "INSERT OR IGNORE INTO kind (one, simulated) VALUES (1, ?1)",
                [simulated],
            )?;
            if begun > 0 {
                chain::link(&transaction, &self.seals, "kind", "1")?;
            }
            let kind = "SELECT simulated, at FROM kind";
            let (holds, since) =
                transaction.query_row(kind, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
            if holds != simulated {
                return Ok(Err((holds, since)));
            }
        }
        let DieKey {
            tool,
            geometry,
            serial,
        } = &inspection.die;
        let counter = i64::from(inspection.press_cycles);
        let last: Option<(i64, i64)> = transaction
            .query_row(
                &format!(
                    "SELECT tool_cycles, press_cycles FROM inspection WHERE {} ORDER BY id DESC LIMIT 1",
                    same_as_asked("inspection")
                ),
                params![tool, geometry, serial],
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
             link, simulated, head, head_blake3, station, operator, geometry, serial, head_seal) \
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17)",
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
                operator,
                geometry,
                serial,
                head.as_ref().and_then(|head| head.seal.as_ref())
            ],
        )?;
        {
            let mut row = transaction.prepare(
                "INSERT INTO flank (inspection, tooth, flank, wear_um, u95_um, warn_um, limit_um, verdict, code, patch) \
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
            )?;
            for feature in &inspection.features {
                row.execute(params![
                    id,
                    feature.id.tooth,
                    feature.id.flank,
                    feature.wear_um,
                    feature.u95_um,
                    feature.warn_um,
                    feature.limit_um,
                    feature.verdict.as_str(),
                    feature.code.map(Code::word),
                    feature.id.patch
                ])?;
            }
        }
        for blake3 in inspection.evidence.iter().flat_map(|view| &view.phasors) {
            transaction.execute(
                "INSERT OR IGNORE INTO phasors (inspection, blake3) VALUES (?1, ?2)",
                params![id, blake3],
            )?;
        }
        chain::link(&transaction, &self.seals, "inspection", &id.to_string())?;
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
        self.add(
            "keep the baseline",
            "baseline",
            "INSERT OR IGNORE INTO baseline (blake3, tool, document) VALUES (?1, ?2, ?3) RETURNING blake3",
            [blake3, tool, document],
        )
    }

    /// Adds a row, linked, and on the disk when this returns.
    fn add(
        &mut self,
        doing: &'static str,
        table: &'static str,
        sql: &str,
        parameters: impl rusqlite::Params,
    ) -> Result<(), HistoryError> {
        let Self {
            connection, seals, ..
        } = self;
        let add = || -> rusqlite::Result<()> {
            let transaction =
                connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let key: Option<String> = transaction
                .query_row(sql, parameters, |row| {
                    Ok(match row.get_ref(0)? {
                        rusqlite::types::ValueRef::Integer(number) => number.to_string(),
                        other => other.as_str()?.to_owned(),
                    })
                })
                .optional()?;
            if let Some(key) = key {
                chain::link(&transaction, seals, table, &key)?;
            }
            transaction.commit()
        };
        let added = add();
        added.map_err(self.because(doing))?;
        self.remember();
        Ok(())
    }

    /// Notes who acknowledged what stood at the press.
    ///
    /// # Errors
    /// As [`History::record`]; what is not noted is not acknowledged.
    pub fn acknowledge(&mut self, die: &DieKey, who: &str) -> Result<(), HistoryError> {
        let sql = format!(
            "INSERT INTO acknowledgement (tool, geometry, serial, who, inspection) \
             VALUES (?1, ?2, ?3, ?4, (SELECT max(id) FROM inspection WHERE {})) RETURNING id",
            same_as_asked("inspection")
        );
        self.add(
            "note the acknowledgement",
            "acknowledgement",
            &sql,
            params![die.tool, die.geometry, die.serial, who],
        )
    }

    /// Notes that somebody did something.
    ///
    /// # Errors
    /// As [`History::record`].
    pub fn audit(&mut self, who: &str, what: &str, detail: &str) -> Result<(), HistoryError> {
        self.add(
            "write its audit",
            "audit",
            "INSERT INTO audit (who, what, detail) VALUES (?1, ?2, ?3) RETURNING id",
            [who, what, detail],
        )
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
        self.checks_where("tool = ?1", tool)
    }

    /// The row of a check.
    ///
    /// # Errors
    /// There is no such check, or the file cannot be read.
    pub fn check(&self, id: i64) -> Result<Check, HistoryError> {
        let found = self.checks_where("id = ?1", id)?;
        found
            .into_iter()
            .next()
            .ok_or_else(|| self.no_such_check(id))
    }

    /// Numbers of all checks, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn ids(&self) -> Result<Vec<i64>, HistoryError> {
        self.rows("SELECT id FROM inspection ORDER BY id", [], |row| {
            row.get(0)
        })
    }

    fn checks_where(
        &self,
        condition: &str,
        parameter: impl rusqlite::ToSql + Copy,
    ) -> Result<Vec<Check>, HistoryError> {
        // A file of layout 1 that is only read stays as it is.
        let origin = match self.layout()? {
            ..2 => "NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL",
            2 => "link, simulated, head, head_blake3, station, operator, NULL, NULL",
            _ => "link, simulated, head, head_blake3, station, operator, serial, head_seal",
        };
        let mut checks = self.rows(
            &format!(
                "SELECT id, at, tool, tool_cycles, press_cycles, baseline, verdict, reason, {origin} FROM inspection \
                 WHERE {condition} ORDER BY id"
            ),
            [parameter],
            |row| {
                let (name, blake3): (Option<String>, Option<String>) = (row.get(10)?, row.get(11)?);
                let head = name.map(|name| HeadId {
                    name,
                    blake3: blake3.unwrap_or_default(),
                    seal: row.get(15).unwrap_or_default(),
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
                    serial: row.get(14)?,
                    flanks: Vec::new(),
                })
            },
        )?;
        let patch = if self.layout()? < 4 { "NULL" } else { "patch" };
        let flanks = self.rows(
            &format!(
                "SELECT inspection, tooth, flank, {patch}, wear_um, u95_um, warn_um, limit_um, flank.verdict, code FROM flank \
                 JOIN inspection ON inspection.id = inspection WHERE {condition} ORDER BY inspection, tooth, flank"
            ),
            [parameter],
            |row| {
                let flank = FlankRow {
                    id: FeatureId {
                        tooth: row.get(1)?,
                        flank: row.get(2)?,
                        patch: row.get(3)?,
                    },
                    wear_um: row.get(4)?,
                    u95_um: row.get(5)?,
                    warn_um: row.get(6)?,
                    limit_um: row.get(7)?,
                    verdict: parsed(row, 8)?,
                    code: parsed_or_none(row, 9)?,
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
        found.ok_or_else(|| self.no_such_check(id))
    }

    fn no_such_check(&self, id: i64) -> HistoryError {
        let last = "SELECT max(id) FROM inspection";
        match self.connection.query_row(last, [], |row| row.get(0)) {
            Ok(last) => HistoryError::NoSuchCheck {
                path: self.path.clone(),
                id,
                last,
            },
            Err(source) => self.because("read a check")(source),
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

    /// The verdicts of a die that nobody has acknowledged, in order.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn open_verdicts(&self, die: &DieKey) -> Result<Vec<Word>, HistoryError> {
        self.rows(
            &format!(
                "SELECT verdict FROM inspection WHERE {} AND NOT {} ORDER BY id",
                same_as_asked("inspection"),
                acknowledged()
            ),
            params![die.tool, die.geometry, die.serial],
            |row| parsed(row, 0),
        )
    }

    /// A no-go of any die that nobody has acknowledged: of which tool, and when.
    pub(super) fn standing_no_go(&self) -> Result<Option<String>, HistoryError> {
        let found = self.rows(
            &format!(
                "SELECT tool || ', check ' || id || ' of ' || at FROM inspection WHERE verdict = 'no-go' AND NOT {} \
                 ORDER BY id DESC LIMIT 1",
                acknowledged()
            ),
            [],
            |row| row.get(0),
        )?;
        Ok(found.into_iter().next())
    }

    /// Refuses a head without a digest where a check was made with a signed one of its name.
    ///
    /// # Errors
    /// [`HistoryError::Stripped`], or the file cannot be read.
    pub fn takes_head(&self, head: &HeadId) -> Result<(), HistoryError> {
        if head.seal.as_deref() != Some("unsigned") {
            return Ok(());
        }
        let signed = self.rows(
            "SELECT id, at FROM inspection WHERE head = ?1 AND head_seal = 'signed' ORDER BY id DESC LIMIT 1",
            [&head.name],
            |row| Ok((row.get(0)?, row.get(1)?)),
        )?;
        match signed.into_iter().next() {
            None => Ok(()),
            Some((id, at)) => Err(HistoryError::Stripped {
                head: head.name.clone(),
                id,
                at,
            }),
        }
    }

    pub(super) fn rows<T>(
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

/// Whether somebody has taken note of a check: later, and of the same die.
fn acknowledged() -> String {
    let [checks, notes] = ["inspection", "noted"].map(columns);
    let [a, b, c] = &checks;
    let [d, e, f] = &notes;
    format!(
        "EXISTS (SELECT 1 FROM acknowledgement AS noted WHERE noted.inspection >= inspection.id AND {})",
        same([a, b, c], [d, e, f])
    )
}

/// Whether everything is in the file itself.
fn journal_is_empty(path: &Path) -> bool {
    let mut journal = path.as_os_str().to_owned();
    journal.push("-wal");
    std::fs::metadata(&journal).map_or(true, |meta| meta.len() == 0)
}

/// A history and its journal are for its user and group: SQLite gives the journal the rights of the file.
fn close_to_others(path: &Path) {
    use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
    let mode = 0o640;
    let made = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(path);
    // One of an earlier release, which everybody could read. Whose it is not cannot be closed by this user.
    if made.is_err()
        && let Ok(meta) = std::fs::metadata(path)
        && meta.is_file()
        && meta.permissions().mode() & 0o027 != 0
    {
        let closed = meta.permissions().mode() & 0o750;
        let _ = std::fs::set_permissions(path, std::fs::Permissions::from_mode(closed));
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
