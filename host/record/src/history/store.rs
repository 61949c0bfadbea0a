//! The file: one SQLite database, written in whole transactions that are on the disk before they count.

use std::path::{Path, PathBuf};
use std::time::Duration;

use flankscope_metrology::verdict::Code;
use rusqlite::{Connection, OpenFlags, OptionalExtension, TransactionBehavior, params};

use super::chain;
use super::error::HistoryError;
use super::same_die::same_as_asked;
use super::schema::{APPLICATION_ID, KEPT, TABLES, VERSION};
use crate::die::DieKey;
use crate::document::Inspection;
use crate::origin::Origin;
use crate::seal::Seals;

/// How long a writer waits for another one. Readers never wait and never keep a writer waiting.
const PATIENCE: Duration = Duration::from_secs(2);

/// A history: opened by one writer, read by any number beside it.
#[derive(Debug)]
pub struct History {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    seals: Seals,
}

impl History {
    /// Opens a history for writing; makes it where there is none.
    ///
    /// # Errors
    /// The file cannot be opened, is none of this instrument, of another layout, or not the one that this station last
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
            (APPLICATION_ID, VERSION) => Ok(()),
            (APPLICATION_ID, got) => Err(HistoryError::Layout {
                path: path(),
                got,
                expected: VERSION,
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
        self.connection
            .query_row("SELECT simulated, at FROM kind", [], |row| {
                Ok((row.get(0)?, row.get(1)?))
            })
            .optional()
            .map_err(self.because("read what it is of"))
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
        self.takes(inspection.origin.simulated)?;
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
        let begun = transaction.execute(
            "INSERT OR IGNORE INTO kind (one, simulated) VALUES (1, ?1)",
            [inspection.origin.simulated],
        )?;
        if begun > 0 {
            chain::link(&transaction, &self.seals, "kind", "1")?;
        }
        let kind = "SELECT simulated, at FROM kind";
        let (holds, since) =
            transaction.query_row(kind, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
        if holds != inspection.origin.simulated {
            return Ok(Err((holds, since)));
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
                head.name,
                head.blake3,
                station,
                operator,
                geometry,
                serial,
                head.seal
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
                    feature.id.flank.word(),
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
    // One that others may read, such as a copy. Another user's cannot be closed by this one.
    if made.is_err()
        && let Ok(meta) = std::fs::metadata(path)
        && meta.is_file()
        && meta.permissions().mode() & 0o027 != 0
    {
        let closed = meta.permissions().mode() & 0o750;
        let _ = std::fs::set_permissions(path, std::fs::Permissions::from_mode(closed));
    }
}
