//! The chain of a history: every row has a link, a keyed digest over the row and the previous link.
//!
//! The digest is computed of the data to be stored, before storing; the row in the file is then compared with it in the same
//! transaction. Changing, adding or removing a row breaks the chain. If the last rows are cut off together with their links, the
//! chain is shorter than the station remembers ([`crate::seal::Anchor`]), for every copy of the history.

use std::path::Path;

use rusqlite::types::{Value, ValueRef};
use rusqlite::{
    Connection, OptionalExtension, Transaction, TransactionBehavior, params, params_from_iter,
};

use super::error::HistoryError;
use super::store::{History, real_name};
use crate::seal::{Alone, Anchor, Seals, TrustEntry};

/// Tables whose rows have links, with the column that identifies a row, in the order in which [`History::trust`] links them again.
pub(super) const LINKED: [(&str, &str); 6] = [
    ("identity", "one"),
    ("kind", "one"),
    ("baseline", "blake3"),
    ("inspection", "id"),
    ("acknowledgement", "id"),
    ("audit", "id"),
];

/// A row to be stored: each column with its value, in the table's order.
pub(super) struct Row {
    pub table: &'static str,
    pub values: Vec<(&'static str, Value)>,
}

impl Row {
    fn insert(&self, connection: &Connection) -> rusqlite::Result<()> {
        let names: Vec<&str> = self.values.iter().map(|(name, _)| *name).collect();
        let places = vec!["?"; names.len()].join(", ");
        let sql = format!(
            "INSERT INTO {} ({}) VALUES ({places})",
            self.table,
            names.join(", ")
        );
        let values = params_from_iter(self.values.iter().map(|(_, value)| value));
        connection.prepare(&sql)?.execute(values).map(drop)
    }

    fn append_to(&self, bytes: &mut Vec<u8>) {
        append_row(
            self.values
                .iter()
                .map(|(name, value)| (*name, ValueRef::from(value))),
            bytes,
        );
    }

    /// The value that identifies the row in its table.
    fn key(&self) -> String {
        let column = key_column(self.table);
        let value = self.values.iter().find(|(name, _)| *name == column);
        match value {
            Some((_, Value::Integer(number))) => number.to_string(),
            Some((_, Value::Text(text))) => text.clone(),
            _ => String::new(),
        }
    }
}

/// Adds a row, the flanks that belong to it, and its link, whose digest is of the data to be stored. False if the row then in the
/// file differs, because a trigger or similar changed it.
pub(super) fn add(
    connection: &Connection,
    seals: &Seals,
    row: &Row,
    flanks: &[Row],
) -> rusqlite::Result<bool> {
    let mut meant = Vec::new();
    let mut sorted: Vec<&Row> = flanks.iter().collect();
    sorted.sort_by_cached_key(|flank| flank_place(flank));
    for row in std::iter::once(row).chain(sorted) {
        row.append_to(&mut meant);
        row.insert(connection)?;
    }
    let key = row.key();
    let digest = link(connection, seals, (row.table, &key), &meant)?;
    let stored = content(connection, row.table, &key)?;
    let last = last(connection)?.map(|(_, digest)| digest);
    Ok(stored == meant && last == Some(digest))
}

/// Flanks are linked in the order in which they are read.
fn flank_place(flank: &Row) -> (i64, String) {
    let mut place = (0, String::new());
    for (name, value) in &flank.values {
        match (*name, value) {
            ("tooth", Value::Integer(tooth)) => place.0 = *tooth,
            ("flank", Value::Text(flank)) => place.1.clone_from(flank),
            _ => {}
        }
    }
    place
}

/// Adds a link to the chain; returns its digest.
fn link(
    connection: &Connection,
    seals: &Seals,
    (table, key): (&str, &str),
    content: &[u8],
) -> rusqlite::Result<String> {
    let (link, before) = last(connection)?.unwrap_or_default();
    let digest = digest(seals, &before, (link + 1, table, key), content);
    connection.execute(
        "INSERT INTO chain (link, source, key, digest, station) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![link + 1, table, key, digest, seals.station()],
    )?;
    Ok(digest)
}

/// Links every existing row; the chain must be empty.
pub(super) fn link_all(connection: &Connection, seals: &Seals) -> rusqlite::Result<()> {
    for (table, column) in LINKED {
        let mut rows =
            connection.prepare(&format!("SELECT {column} FROM {table} ORDER BY {column}"))?;
        let keys: Vec<String> = rows
            .query_map([], |row| {
                Ok(match row.get_ref(0)? {
                    ValueRef::Integer(number) => number.to_string(),
                    other => other.as_str()?.to_owned(),
                })
            })?
            .collect::<rusqlite::Result<_>>()?;
        for key in keys {
            let content = content(connection, table, &key)?;
            link(connection, seals, (table, &key), &content)?;
        }
    }
    Ok(())
}

/// Number and digest of the last link.
fn last(connection: &Connection) -> rusqlite::Result<Option<(i64, String)>> {
    connection
        .query_row(
            "SELECT link, digest FROM chain ORDER BY link DESC LIMIT 1",
            [],
            |row| Ok((row.get(0)?, row.get(1)?)),
        )
        .optional()
}

fn digest(
    seals: &Seals,
    before: &str,
    (number, table, key): (i64, &str, &str),
    content: &[u8],
) -> String {
    let parts = [
        &number.to_le_bytes()[..],
        before.as_bytes(),
        table.as_bytes(),
        key.as_bytes(),
        content,
    ];
    seals.digest("history", parts)
}

/// Content of a row, with the flanks of a check: every value with its column's name, type and length. Null values are left out.
fn content(connection: &Connection, table: &str, key: &str) -> rusqlite::Result<Vec<u8>> {
    let column = key_column(table);
    let mut bytes = Vec::new();
    append(
        connection,
        &format!("SELECT * FROM {table} WHERE {column} = ?1"),
        key,
        &mut bytes,
    )?;
    if table == "inspection" {
        append(
            connection,
            "SELECT * FROM flank WHERE inspection = CAST(?1 AS INTEGER) ORDER BY tooth, flank",
            key,
            &mut bytes,
        )?;
    }
    Ok(bytes)
}

fn key_column(table: &str) -> &'static str {
    let found = LINKED.iter().find(|(name, _)| *name == table);
    found.map_or("id", |(_, column)| *column)
}

fn append(
    connection: &Connection,
    sql: &str,
    key: &str,
    bytes: &mut Vec<u8>,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare(sql)?;
    let names: Vec<String> = statement.column_names().map(str::to_owned).collect();
    let mut rows = statement.query([key])?;
    while let Some(row) = rows.next()? {
        let mut values = Vec::with_capacity(names.len());
        for (at, name) in names.iter().enumerate() {
            values.push((&name[..], row.get_ref(at)?));
        }
        append_row(values.into_iter(), bytes);
    }
    Ok(())
}

fn append_row<'a>(values: impl Iterator<Item = (&'a str, ValueRef<'a>)>, bytes: &mut Vec<u8>) {
    bytes.push(b'{');
    for (name, value) in values {
        let number_bytes;
        let (kind, value): (u8, &[u8]) = match value {
            ValueRef::Null => continue,
            ValueRef::Integer(number) => {
                number_bytes = number.to_le_bytes();
                (b'i', &number_bytes)
            }
            ValueRef::Real(number) => {
                number_bytes = number.to_bits().to_le_bytes();
                (b'r', &number_bytes)
            }
            ValueRef::Text(text) => (b't', text),
            ValueRef::Blob(blob) => (b'b', blob),
        };
        bytes.extend_from_slice(name.as_bytes());
        bytes.push(kind);
        bytes.extend_from_slice(&(value.len() as u64).to_le_bytes());
        bytes.extend_from_slice(value);
    }
    bytes.push(b'}');
}

struct Link {
    number: i64,
    table: String,
    key: String,
    digest: String,
    station: String,
}

impl History {
    /// Verifies the whole chain: every row is as this station wrote it, and none was added or removed. Also that the file defines
    /// only what this program creates, and that its indices contain every row, because rows are looked up by them.
    ///
    /// # Errors
    /// [`HistoryError::Broken`] with the first mismatch, or the file cannot be read.
    pub fn verify(&self) -> Result<(), HistoryError> {
        // One snapshot, even if another process writes meanwhile.
        let _moment = Transaction::new_unchecked(self.connection(), TransactionBehavior::Deferred)
            .map_err(self.because("read it"))?;
        self.verify_definitions()?;
        let damage = self.rows("PRAGMA integrity_check(1)", [], |row| {
            row.get::<_, String>(0)
        })?;
        if let Some(damage) = damage.into_iter().find(|said| said != "ok") {
            return Err(self.broken(damage));
        }
        self.verify_links()
    }

    /// Whether the file defines something that could change or hide added rows.
    pub(super) fn verify_definitions(&self) -> Result<(), HistoryError> {
        let strange = super::schema::strange(self.connection());
        match strange.map_err(self.because("read what it consists of"))? {
            Some(strange) => Err(self.broken(strange)),
            None => Ok(()),
        }
    }

    pub(super) fn broken(&self, why: impl Into<String>) -> HistoryError {
        HistoryError::Broken {
            path: self.path().to_owned(),
            why: why.into(),
        }
    }

    /// Verifies the links after one that was verified before (0: every link), and the rows that they are of. Returns the last one's number.
    ///
    /// # Errors
    /// As [`History::verify`].
    pub fn verify_links_after(&self, link: i64) -> Result<i64, HistoryError> {
        let before = self.rows("SELECT digest FROM chain WHERE link = ?1", [link], |row| {
            row.get::<_, String>(0)
        })?;
        let mut before = match (before.into_iter().next(), link) {
            (Some(digest), _) => digest,
            (None, 0) => String::new(),
            (None, _) => return Err(self.broken(format!("link {link} is gone"))),
        };
        let links = self.rows(
            "SELECT link, source, key, digest, station FROM chain WHERE ?1 = 0 OR link > ?1 ORDER BY link",
            [link],
            |row| {
                Ok(Link {
                    number: row.get(0)?,
                    table: row.get(1)?,
                    key: row.get(2)?,
                    digest: row.get(3)?,
                    station: row.get(4)?,
                })
            },
        )?;
        let own = self.seals().station();
        let mut verified = link;
        for link in links {
            let named = format!("link {} ({} {})", link.number, link.table, link.key);
            if link.station != own {
                return Err(self.broken(format!(
                    "{named} was written by station {}, this is station {own}",
                    link.station
                )));
            }
            if !LINKED.iter().any(|(table, _)| *table == link.table) {
                return Err(self.broken(format!("{named} is of no table whose rows are linked")));
            }
            let content = content(self.connection(), &link.table, &link.key)
                .map_err(self.because("read its rows"))?;
            let place = (link.number, &link.table[..], &link.key[..]);
            let right = digest(self.seals(), &before, place, &content);
            if right != link.digest {
                return Err(self.broken(format!(
                    "{named} is not as it was written, or a row before it is gone"
                )));
            }
            before = link.digest;
            verified = link.number;
        }
        Ok(verified)
    }

    fn verify_links(&self) -> Result<(), HistoryError> {
        self.verify_links_after(0)?;
        for (table, column) in LINKED {
            let strange = self.rows(
                &format!(
                    "SELECT CAST({column} AS TEXT) FROM {table} WHERE CAST({column} AS TEXT) NOT IN \
                     (SELECT key FROM chain WHERE source = '{table}') LIMIT 1"
                ),
                [],
                |row| row.get::<_, String>(0),
            )?;
            if let Some(key) = strange.first() {
                return Err(
                    self.broken(format!("{table} {key} was added without the station's key"))
                );
            }
        }
        let strange = self.rows(
            "SELECT inspection FROM flank WHERE inspection NOT IN (SELECT id FROM inspection) LIMIT 1",
            [],
            |row| row.get::<_, i64>(0),
        )?;
        match strange.first() {
            Some(id) => Err(self.broken(format!("flanks of check {id}, which is not there"))),
            None => Ok(()),
        }
    }

    /// Checks that it has all rows that this station has written to the history, in this file or a copy.
    pub(super) fn holds_anchor(&self) -> Result<(), HistoryError> {
        let id = self.id()?;
        if let Some(anchor) = self.seals().anchor_at(self.path())?
            && anchor.id != id
        {
            return Err(self.broken("it is not the history that this station last wrote to here"));
        }
        let Some(anchor) = self.seals().anchor(&id)? else {
            return Ok(());
        };
        let there = self.rows(
            "SELECT digest FROM chain WHERE link = ?1",
            [anchor.link],
            |row| row.get::<_, String>(0),
        )?;
        if there.first() == Some(&anchor.digest) {
            return Ok(());
        }
        Err(self.broken(format!(
            "it lacks link {}, which this station wrote to {}: an older copy, or rows were cut off{}",
            anchor.link,
            anchor.file.display(),
            no_gos_there(&anchor),
        )))
    }

    /// Records in the station's memory how far the history is. The rows are on disk already; if this fails, only the removal of
    /// its last rows goes undetected.
    pub(super) fn remember(&self, alone: &Alone) {
        if let Err(error) = self.try_remember(alone) {
            tracing::error!(%error, "how far the history is cannot be remembered");
        }
    }

    fn try_remember(&self, alone: &Alone) -> Result<(), HistoryError> {
        let last = last(self.connection()).map_err(self.because("read its last link"))?;
        let Some((link, digest)) = last else {
            return Ok(());
        };
        let anchor = Anchor {
            id: self.id()?,
            file: self.path().to_owned(),
            link,
            digest,
            simulated: self.kind()?.map(|(simulated, _)| simulated),
            stands: self.standing_no_gos()?,
        };
        Ok(self.seals().drop_anchor(alone, anchor)?)
    }

    /// Accepts a history as it is on the word of a named person: changed, from another station, or restored from an older copy.
    /// Every row is linked again with this station's key, and the last row records this with the name. From then on every other
    /// copy is behind.
    ///
    /// # Errors
    /// The file is not a history, or cannot be written.
    pub fn trust(path: &Path, seals: &Seals, by: &str) -> Result<(), HistoryError> {
        let path = &real_name(path);
        let note = |digest: &str| {
            seals.note_trust(&TrustEntry {
                digest: digest.to_owned(),
                what: "history".into(),
                file: path.to_owned(),
                by: by.to_owned(),
                date: flankscope_foundation::date::now(),
            })
        };
        if !path.exists() {
            let Some(id) = seals.history_at(path)? else {
                let source = std::io::ErrorKind::NotFound.into();
                let path = path.to_owned();
                return Err(crate::seal::SealError::Memory { path, source }.into());
            };
            // The history was moved or removed: the next check begins a new one.
            note(&id)?;
            return Ok(seals.forget_anchor(path)?);
        }
        let history = Self::open_unchecked(path, seals)?;
        let alone = seals.alone(&history.id()?)?;
        let anchor = seals.anchor(&history.id()?)?;
        let behind = match anchor {
            Some(anchor) if history.holds_anchor().is_err() => format!(
                "; it lacked link {} of {}{}",
                anchor.link,
                anchor.file.display(),
                no_gos_there(&anchor)
            ),
            _ => String::new(),
        };
        let relink = || -> rusqlite::Result<()> {
            let connection = history.connection();
            let transaction =
                Transaction::new_unchecked(connection, TransactionBehavior::Immediate)?;
            super::schema::restore(connection)?;
            connection.execute("DELETE FROM chain", [])?;
            connection.execute(
                "INSERT INTO audit (who, what, detail) SELECT ?1, 'trust', count(*) || ' checks are believed as they are' || ?2 \
                 FROM inspection",
                [by, &behind],
            )?;
            connection.execute_batch("REINDEX")?;
            link_all(connection, seals)?;
            transaction.commit()
        };
        relink().map_err(history.because("link its rows anew"))?;
        history.verify()?;
        history.try_remember(&alone)?;
        Ok(note(&history.id()?)?)
    }
}

/// No-gos that accepting an older copy would remove.
fn no_gos_there(anchor: &Anchor) -> String {
    let stands: Vec<String> = anchor.stands.iter().map(ToString::to_string).collect();
    if stands.is_empty() {
        return String::new();
    }
    format!("; there a no-go stands ({})", stands.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_the_file_is_compared_with_what_was_meant() {
        const FREE: &str = "DROP TRIGGER audit_keeps_UPDATE; DROP TRIGGER chain_keeps_UPDATE;";
        for (plant, right) in [
            ("", true),
            (
                "CREATE TRIGGER e AFTER INSERT ON audit BEGIN UPDATE audit SET who = 'nobody'; END",
                false,
            ),
            (
                "CREATE TRIGGER e BEFORE INSERT ON audit BEGIN SELECT raise(IGNORE); END",
                false,
            ),
            (
                "CREATE TRIGGER e BEFORE INSERT ON chain BEGIN SELECT raise(IGNORE); END",
                false,
            ),
            (
                "CREATE TRIGGER e AFTER INSERT ON chain BEGIN UPDATE chain SET digest = ''; END",
                false,
            ),
        ] {
            let connection = Connection::open_in_memory().unwrap();
            super::super::schema::make(&connection).unwrap();
            connection.execute_batch(FREE).unwrap();
            connection.execute_batch(plant).unwrap();
            let text = |text: &str| Value::from(text.to_owned());
            let row = Row {
                table: "audit",
                values: vec![
                    ("id", 1.into()),
                    ("at", text("2026-01-31T12:00:00.000Z")),
                    ("who", text("Ada")),
                    ("what", text("open")),
                    ("detail", text("")),
                ],
            };
            let added = add(&connection, &Seals::passing().unwrap(), &row, &[]).unwrap();
            assert_eq!(added, right, "{plant}");
        }
    }
}
