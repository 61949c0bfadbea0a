//! The file: one SQLite database, written in transactions that are synchronised to disk before they count.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::config::DbConfig;
use rusqlite::types::Value;
use rusqlite::{
    Connection, OpenFlags, OptionalExtension, Transaction, TransactionBehavior, params,
};

use super::chain::{self, Row};
use super::dates::dated_before;
use super::error::HistoryError;
use super::rows::not_recorded;
use super::same_die::same_as_asked;
use super::schema::{self, APPLICATION_ID, VERSION};
use crate::beside::beside;
use crate::die::DieKey;
use crate::document::Inspection;
use crate::origin::{Origin, OriginKind};
use crate::seal::{Seals, StandingNoGo};

/// How long a writer waits for another one. Readers neither wait nor block a writer.
const PATIENCE: Duration = Duration::from_secs(2);

/// Name of the operation that stores an acknowledgement, for messages.
const ACKNOWLEDGING: &str = "note the acknowledgement";

/// A history: one writer and any number of readers at a time.
#[derive(Debug)]
pub struct History {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    seals: Seals,
}

impl History {
    /// Opens a history for writing; creates it if missing.
    ///
    /// # Errors
    /// The file cannot be opened, is not of this instrument, has another layout, was changed by others, or is a copy that lacks rows.
    pub fn open(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        let path = &real_name(path);
        if !std::fs::metadata(path).is_ok_and(|meta| meta.len() > 0) {
            let anchor = seals.anchor_at(path)?;
            if let Some(stands) = anchor.and_then(|anchor| anchor.stands.into_iter().next()) {
                let path = path.to_owned();
                let stands = Box::new(stands);
                return Err(HistoryError::Gone { path, stands });
            }
            seals.forget_anchor(path)?;
        }
        Self::open_unchecked(path, seals)?.believed()
    }

    /// Verifies the chain before anything is read.
    fn believed(self) -> Result<Self, HistoryError> {
        self.holds_anchor()?;
        self.verify()?;
        Ok(self)
    }

    pub(super) fn open_unchecked(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        close_to_others(path);
        only_name(path)?;
        let history = Self::connect(
            path,
            OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE,
            seals,
        )?;
        let sql = |doing| history.because(doing);
        let connection = &history.connection;
        // A database of another program is left unchanged.
        if history.number("schema_version")? != 0 {
            history.check_layout()?;
        }
        // Readers see the last committed state while a check is being stored; a commit returns once it is on disk.
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

    /// Opens an existing history for reading; a watch may write to it meanwhile.
    pub fn read(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        let path = &real_name(path);
        only_name(path)?;
        // A reader without write permission cannot remove the journal; a process with it does so when the last one closes the file.
        let mut history = Self::connect(path, OpenFlags::SQLITE_OPEN_READ_WRITE, seals)?;
        let only = history.connection.pragma_update(None, "query_only", "on");
        only.map_err(history.because("open it"))?;
        // In a read-only folder no journal can be shared. Without a journal, no process is writing.
        if history.number("schema_version").is_err() && journal_is_empty(path) {
            history = Self::connect_unchanging(path, seals)?;
        }
        history.check_layout()?;
        history.believed()
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
        // No trigger or view of the file is executed while this program reads or writes, and nothing writes to the schema directly.
        for (setting, on) in [
            (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
            (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
            (DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
            (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
        ] {
            connection.set_db_config(setting, on).map_err(failed)?;
        }
        Ok(Self {
            connection,
            path: path.to_owned(),
            seals: seals.clone(),
        })
    }

    /// Opens a file as immutable, without lock or journal.
    fn connect_unchanging(path: &Path, seals: &Seals) -> Result<Self, HistoryError> {
        use std::fmt::Write;
        let mut uri = String::from("file:");
        for byte in path.as_os_str().as_encoded_bytes() {
            // Characters with a meaning in a URI, and non-ASCII ones, are percent-encoded.
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

    /// Path of the file.
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

    /// Creates the tables of an empty file, all or none.
    fn make_tables(&self) -> Result<(), HistoryError> {
        let make = || {
            // Another process may be creating them too, so the lock is taken before the check.
            self.connection.execute_batch("BEGIN IMMEDIATE")?;
            let objects: i64 =
                self.connection
                    .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
            if objects == 0 {
                schema::make(&self.connection)?;
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

    /// Refuses simulated checks in a history of a press, and the reverse.
    ///
    /// # Errors
    /// It has checks of the other kind, or cannot be read.
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

    /// Whether its checks are simulated, and since when; `None` while it has no check.
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

    /// Stores a check atomically; on return it is on disk. Returns its number.
    ///
    /// `tool_cycles` is the number of cycles done with the tool. Without it, cycles are counted on from the last stored check by
    /// the controller's counter, which starts at zero at its power-up. Recordings do not change the count of checks at the press.
    ///
    /// # Errors
    /// The disk is full, the file is locked for too long, has checks of the other kind, or another error occurred. Nothing of the
    /// check is stored then.
    pub fn record(
        &mut self,
        inspection: &Inspection,
        tool_cycles: Option<u32>,
    ) -> Result<i64, HistoryError> {
        let simulated = inspection.origin.simulated;
        self.takes(simulated)?;
        let document =
            serde_json::to_value(inspection).map_err(|source| HistoryError::Document {
                path: self.path.clone(),
                source,
            })?;
        self.write("store the check", |history| {
            // The first check determines whether the file is simulated.
            if history.kind()?.is_none() {
                let values = vec![
                    ("one", 1.into()),
                    ("at", history.now()?),
                    ("simulated", simulated.into()),
                ];
                history.add_linked("kind", values, &[])?;
            }
            // Another process may have stored a first check of the other kind meanwhile.
            history.takes(simulated)?;
            history.insert(inspection, tool_cycles, document)
        })
    }

    fn insert(
        &self,
        inspection: &Inspection,
        tool_cycles: Option<u32>,
        mut document: serde_json::Value,
    ) -> Result<i64, HistoryError> {
        let failed = self.because("store the check");
        let DieKey {
            tool,
            geometry,
            serial,
        } = &inspection.die;
        let counter = i64::from(inspection.press_cycles);
        let counted = match inspection.origin.kind() {
            OriginKind::Recording => "TRUE".into(),
            OriginKind::Press | OriginKind::Bench => not_recorded(),
        };
        let last: Option<(i64, i64)> = self
            .connection
            .query_row(
                &format!(
                    "SELECT tool_cycles, press_cycles FROM inspection WHERE {} AND {counted} ORDER BY id DESC LIMIT 1",
                    same_as_asked("inspection")
                ),
                params![tool, geometry, serial],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )
            .optional()
            .map_err(failed)?;
        let tool_cycles = match (tool_cycles, last) {
            (Some(cycles), _) => i64::from(cycles),
            (None, None) => counter,
            (None, Some((cycles, before))) if counter >= before => cycles + (counter - before),
            // The controller was switched off since the last check.
            (None, Some((cycles, _))) => cycles + counter,
        };
        // The transaction excludes other writers, so the number of the next row is known in advance.
        let id = self.next_id("inspection")?;
        document["id"] = id.into();
        let at = self.now()?;
        let before: Option<(i64, String)> = self
            .connection
            .query_row(
                "SELECT id, at FROM inspection ORDER BY id DESC LIMIT 1",
                [],
                |row| Ok((row.get(0)?, row.get(1)?)),
            )
            .optional()
            .map_err(failed)?;
        if let (Some((last, dated)), Value::Text(at)) = (before, &at)
            && let Some(said) = dated_before((last, &dated), (id, at))
        {
            tracing::warn!("{said}");
        }
        let Origin {
            link,
            simulated,
            head,
            station,
            operator,
            recording: _, // in the document
        } = &inspection.origin;
        let values = vec![
            ("id", id.into()),
            ("at", at),
            ("tool", tool.clone().into()),
            ("tool_cycles", tool_cycles.into()),
            ("press_cycles", counter.into()),
            (
                "baseline",
                inspection.hashes.get("baseline").cloned().into(),
            ),
            ("verdict", inspection.verdict.as_str().to_owned().into()),
            ("reason", inspection.reason.clone().into()),
            ("document", document.to_string().into()),
            ("link", link.clone().into()),
            ("simulated", (*simulated).into()),
            ("head", head.name.clone().into()),
            ("head_blake3", head.blake3.clone().into()),
            ("head_seal", head.seal.clone().into()),
            ("station", station.clone().into()),
            ("operator", operator.clone().into()),
            ("geometry", geometry.clone().into()),
            ("serial", serial.clone().into()),
        ];
        // SQLite stores no negative zero, and NaN becomes null.
        let real = |value: f64| (!value.is_nan()).then_some(value + 0.0);
        let flanks: Vec<Row> = inspection
            .features
            .iter()
            .map(|feature| Row {
                table: "flank",
                values: vec![
                    ("inspection", id.into()),
                    ("tooth", i64::from(feature.id.tooth).into()),
                    ("flank", feature.id.flank.word().to_owned().into()),
                    ("wear_um", feature.wear_um.and_then(real).into()),
                    ("u95_um", feature.u95_um.and_then(real).into()),
                    ("warn_um", real(feature.warn_um).into()),
                    ("limit_um", real(feature.limit_um).into()),
                    ("verdict", feature.verdict.as_str().to_owned().into()),
                    (
                        "code",
                        feature.code.map(|code| code.word().to_owned()).into(),
                    ),
                    ("patch", feature.id.patch.clone().into()),
                ],
            })
            .collect();
        self.add_linked("inspection", values, &flanks)?;
        for blake3 in inspection.evidence.iter().flat_map(|view| &view.phasors) {
            self.connection
                .execute(
                    "INSERT OR IGNORE INTO phasors (inspection, blake3) VALUES (?1, ?2)",
                    params![id, blake3],
                )
                .map_err(failed)?;
        }
        Ok(id)
    }

    /// The host's time, as SQLite formats it.
    fn now(&self) -> Result<Value, HistoryError> {
        let now = "SELECT strftime('%Y-%m-%dT%H:%M:%fZ', 'now')";
        let now = self.connection.query_row(now, [], |row| row.get(0));
        now.map_err(self.because("ask for the time"))
    }

    /// Number of the next row, never used before.
    fn next_id(&self, table: &str) -> Result<i64, HistoryError> {
        let sql = format!(
            "SELECT 1 + max(coalesce((SELECT seq FROM sqlite_sequence WHERE name = '{table}'), 0), \
             coalesce((SELECT max(id) FROM {table}), 0))"
        );
        let next = self.connection.query_row(&sql, [], |row| row.get(0));
        next.map_err(self.because("number a row"))
    }

    /// Adds a row with its link, and reads back the stored row.
    fn add_linked(
        &self,
        table: &'static str,
        values: Vec<(&'static str, Value)>,
        flanks: &[Row],
    ) -> Result<(), HistoryError> {
        let row = Row { table, values };
        let stored = chain::add(&self.connection, &self.seals, &row, flanks);
        if stored.map_err(self.because("add a row"))? {
            Ok(())
        } else {
            let why = format!(
                "a row of {table} is not in it as it was to be stored: something in it changes what is added"
            );
            Err(self.broken(why))
        }
    }

    /// Runs a transaction; on return it is on disk. Nothing is added to a file that was changed by others, and no two copies of a
    /// history are written at the same time.
    fn write<T>(
        &self,
        doing: &'static str,
        work: impl FnOnce(&Self) -> Result<T, HistoryError>,
    ) -> Result<T, HistoryError> {
        let alone = self.seals.alone(&self.id()?)?;
        let transaction =
            Transaction::new_unchecked(&self.connection, TransactionBehavior::Immediate)
                .map_err(self.because(doing))?;
        self.verify_definitions()?;
        self.holds_anchor()?;
        let done = work(self)?;
        transaction.commit().map_err(self.because(doing))?;
        self.remember(&alone);
        Ok(done)
    }

    /// Stores the baseline that the following checks are compared with.
    pub fn keep_baseline(
        &mut self,
        blake3: &str,
        tool: &str,
        document: &str,
    ) -> Result<(), HistoryError> {
        self.write("keep the baseline", |history| {
            if history.baseline(blake3)?.is_some() {
                return Ok(());
            }
            let values = vec![
                ("blake3", blake3.to_owned().into()),
                ("at", history.now()?),
                ("tool", tool.to_owned().into()),
                ("document", document.to_owned().into()),
            ];
            history.add_linked("baseline", values, &[])
        })
    }

    /// Stores who acknowledged the verdicts of a die up to check `seen`, the newest one that this person saw. Later checks stay
    /// open. Whether a newer no-go stands is determined in the transaction that stores the entry.
    ///
    /// # Errors
    /// [`HistoryError::NewerNoGo`] if there is an unacknowledged no-go after `seen`; else as [`History::record`]. Without a stored
    /// entry, nothing is acknowledged.
    pub fn acknowledge(&mut self, die: &DieKey, seen: i64, who: &str) -> Result<(), HistoryError> {
        self.write(ACKNOWLEDGING, |history| {
            history.note_acknowledgement(die, seen, who)
        })
    }

    /// Stores who acknowledged the no-go of a check, which must stand and be the newest of its die; with `tool`, its check must be
    /// of that tool.
    ///
    /// # Errors
    /// [`HistoryError::NotStanding`] if no such no-go stands when the entry is stored; else as [`History::acknowledge`].
    pub fn acknowledge_no_go(
        &mut self,
        check: i64,
        tool: Option<&str>,
        who: &str,
    ) -> Result<(), HistoryError> {
        self.write(ACKNOWLEDGING, |history| {
            let is_meant = |no_go: &StandingNoGo| {
                no_go.check == check && tool.is_none_or(|tool| tool == no_go.die.tool)
            };
            let found = history.standing_no_gos()?.into_iter().find(is_meant);
            let no_go = found.ok_or_else(|| HistoryError::NotStanding {
                path: history.path.clone(),
                check,
            })?;
            history.note_acknowledgement(&no_go.die, check, who)
        })
    }

    fn note_acknowledgement(&self, die: &DieKey, seen: i64, who: &str) -> Result<(), HistoryError> {
        let mut newer = self.standing_no_gos()?;
        newer.retain(|no_go| no_go.check > seen && no_go.die.is_same(die));
        if let Some(newest) = newer.into_iter().next() {
            return Err(HistoryError::NewerNoGo {
                path: self.path.clone(),
                seen,
                newest: Box::new(newest),
            });
        }
        // An entry refers to a check that exists; before the first check there is none.
        let seen = (seen > 0).then_some(seen);
        let values = vec![
            ("id", self.next_id("acknowledgement")?.into()),
            ("at", self.now()?),
            ("tool", die.tool.clone().into()),
            ("who", who.to_owned().into()),
            ("inspection", seen.into()),
            ("geometry", die.geometry.clone().into()),
            ("serial", die.serial.clone().into()),
        ];
        self.add_linked("acknowledgement", values, &[])
    }

    /// Adds an entry to the audit log.
    pub fn audit(&mut self, who: &str, what: &str, detail: &str) -> Result<(), HistoryError> {
        self.write("write its audit", |history| {
            let values = vec![
                ("id", history.next_id("audit")?.into()),
                ("at", history.now()?),
                ("who", who.to_owned().into()),
                ("what", what.to_owned().into()),
                ("detail", detail.to_owned().into()),
            ];
            history.add_linked("audit", values, &[])
        })
    }
}

/// Journal and locks are named after the file, so a file with several names would be written without mutual exclusion.
fn only_name(path: &Path) -> Result<(), HistoryError> {
    use std::os::unix::fs::MetadataExt;
    match std::fs::metadata(path) {
        Ok(meta) if meta.is_file() && meta.nlink() > 1 => Err(HistoryError::SeveralNames {
            path: path.to_owned(),
            names: meta.nlink(),
        }),
        Ok(meta) if !meta.is_file() => Err(HistoryError::NoFile {
            path: path.to_owned(),
        }),
        // A link whose target does not exist.
        Err(_) if std::fs::symlink_metadata(path).is_ok() => Err(HistoryError::NoFile {
            path: path.to_owned(),
        }),
        // SQLite reports a missing file.
        _ => Ok(()),
    }
}

/// The target of a link, so that files belonging to a history are always beside the file itself.
pub(super) fn real_name(path: &Path) -> PathBuf {
    let link = std::fs::symlink_metadata(path).is_ok_and(|meta| meta.is_symlink());
    let real = if link { path.canonicalize().ok() } else { None };
    real.unwrap_or_else(|| path.to_owned())
}

/// Whether all data are in the file itself, none in the journal.
fn journal_is_empty(path: &Path) -> bool {
    std::fs::metadata(beside(path, "-wal")).map_or(true, |meta| meta.len() == 0)
}

/// Restricts a history to its user and group; SQLite gives the journal the same permissions.
fn close_to_others(path: &Path) {
    use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
    let mode = 0o640;
    let made = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(mode)
        .open(path);
    // An existing file that others may read, such as a copy. The permissions of another user's file cannot be changed.
    if made.is_err()
        && let Ok(meta) = std::fs::metadata(path)
        && meta.is_file()
        && meta.permissions().mode() & 0o027 != 0
    {
        let closed = meta.permissions().mode() & 0o750;
        let _ = std::fs::set_permissions(path, std::fs::Permissions::from_mode(closed));
    }
}
