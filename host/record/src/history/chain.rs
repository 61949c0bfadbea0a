//! The chain of a history: every row that is written is a link, with a keyed digest over the row and the link before it.
//!
//! A row that is changed, added or removed breaks it. Rows that are cut off its end with their links are missed against what
//! the station remembers of the file ([`crate::seal::Anchor`]).

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OptionalExtension, params};

use super::error::HistoryError;
use super::store::History;
use crate::seal::{Anchor, Seals};

/// Tables whose rows are links, with the column that names a row, in the order in which [`History::trust`] links them anew.
pub(super) const LINKED: [(&str, &str); 6] = [
    ("identity", "one"),
    ("kind", "one"),
    ("baseline", "blake3"),
    ("inspection", "id"),
    ("acknowledgement", "id"),
    ("audit", "id"),
];

/// Links a row that has just been added.
pub(super) fn link(
    connection: &Connection,
    seals: &Seals,
    table: &str,
    key: &str,
) -> rusqlite::Result<()> {
    let (link, before) = last(connection)?.unwrap_or_default();
    let place = (link + 1, table, key);
    let digest = digest(seals, &before, place, &content(connection, table, key)?);
    connection.execute(
        "INSERT INTO chain (link, source, key, digest, station) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![link + 1, table, key, digest, seals.station()],
    )?;
    Ok(())
}

/// Links every row that is there, in a chain that is empty.
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
            link(connection, seals, table, &key)?;
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

/// All that a row says, with the flanks of a check: every value with its column's name, type and length. What is null is left
/// out.
fn content(connection: &Connection, table: &str, key: &str) -> rusqlite::Result<Vec<u8>> {
    let column = LINKED
        .iter()
        .find(|(name, _)| *name == table)
        .map_or("id", |(_, column)| *column);
    let mut bytes = Vec::new();
    append(
        connection,
        &format!("SELECT * FROM {table} WHERE CAST({column} AS TEXT) = ?1"),
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
        bytes.push(b'{');
        for (at, name) in names.iter().enumerate() {
            let number_bytes;
            let (kind, value): (u8, &[u8]) = match row.get_ref(at)? {
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
    Ok(())
}

struct Link {
    number: i64,
    table: String,
    key: String,
    digest: String,
    station: String,
}

impl History {
    /// Looks through all of the chain: every row is what this station wrote, and none was added or removed.
    ///
    /// # Errors
    /// [`HistoryError::Broken`] with the first place that is not, or the file cannot be read.
    pub fn verify(&self) -> Result<(), HistoryError> {
        let broken = |why: String| HistoryError::Broken {
            path: self.path().to_owned(),
            why,
        };
        let links = self.rows(
            "SELECT link, source, key, digest, station FROM chain ORDER BY link",
            [],
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
        let mut before = String::new();
        for link in links {
            let named = format!("link {} ({} {})", link.number, link.table, link.key);
            if link.station != own {
                return Err(broken(format!(
                    "{named} was written by station {}, this is station {own}",
                    link.station
                )));
            }
            let content = content(self.connection(), &link.table, &link.key)
                .map_err(self.because("read its rows"))?;
            let place = (link.number, &link.table[..], &link.key[..]);
            let right = digest(self.seals(), &before, place, &content);
            if right != link.digest {
                return Err(broken(format!(
                    "{named} is not as it was written, or a row before it is gone"
                )));
            }
            before = link.digest;
        }
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
                return Err(broken(format!(
                    "{table} {key} was added without the station's key"
                )));
            }
        }
        let strange = self.rows(
            "SELECT inspection FROM flank WHERE inspection NOT IN (SELECT id FROM inspection) LIMIT 1",
            [],
            |row| row.get::<_, i64>(0),
        )?;
        match strange.first() {
            Some(id) => Err(broken(format!("flanks of check {id}, which is not there"))),
            None => Ok(()),
        }
    }

    /// Whether it is the history that this station last wrote to at this place, and as long as it was.
    pub(super) fn holds_anchor(&self, anchor: Option<&Anchor>) -> Result<(), HistoryError> {
        let Some(anchor) = anchor else {
            return Ok(());
        };
        let broken = |why: String| {
            Err(HistoryError::Broken {
                path: self.path().to_owned(),
                why,
            })
        };
        if self.id()? != anchor.id {
            return broken("it is not the history that this station last wrote to here".into());
        }
        let there = self.rows(
            "SELECT digest FROM chain WHERE link = ?1",
            [anchor.link],
            |row| row.get::<_, String>(0),
        )?;
        if there.first() != Some(&anchor.digest) {
            return broken(format!(
                "it ends before link {}, which this station wrote: an older copy, or rows were cut off",
                anchor.link
            ));
        }
        Ok(())
    }

    /// Its own id, made with the file.
    pub(super) fn id(&self) -> Result<String, HistoryError> {
        self.connection()
            .query_row("SELECT id FROM identity", [], |row| row.get(0))
            .map_err(self.because("read its id"))
    }

    /// Remembers how far it is. What was written is on the disk already: where nothing can be remembered, only cutting off
    /// its last rows stays unseen.
    pub(super) fn remember(&self) {
        if let Err(error) = self.try_remember(false) {
            tracing::error!(%error, "how far the history is cannot be remembered");
        }
    }

    pub(super) fn try_remember(&self, afresh: bool) -> Result<(), HistoryError> {
        let last = last(self.connection()).map_err(self.because("read its last link"))?;
        let Some((link, digest)) = last else {
            return Ok(());
        };
        let anchor = Anchor {
            id: self.id()?,
            file: self.path().to_owned(),
            link,
            digest,
            stands: self.standing_no_go()?,
        };
        let seals = self.seals();
        Ok(seals.drop_anchor(self.path(), anchor, afresh)?)
    }

    /// Somebody says that a history is to be believed as it is: every row is linked anew with this station's key, and that,
    /// with the name, is its last row.
    ///
    /// # Errors
    /// It is no history, or cannot be written.
    pub fn trust(path: &std::path::Path, seals: &Seals, by: &str) -> Result<(), HistoryError> {
        if !path.exists() {
            if seals.anchor(path)?.is_none() {
                let source = std::io::ErrorKind::NotFound.into();
                let path = path.to_owned();
                return Err(crate::seal::SealError::Memory { path, source }.into());
            }
            // It was moved away or removed: the next check begins it anew.
            return Ok(seals.forget_anchor(path)?);
        }
        let mut history = Self::open_unchecked(path, seals)?;
        let relink = |history: &mut Self| -> rusqlite::Result<()> {
            let transaction = history.connection_mut().transaction()?;
            transaction.execute_batch(super::schema::CHAIN_ANEW)?;
            transaction.execute(
                "INSERT INTO audit (who, what, detail) SELECT ?1, 'trust', count(*) || ' checks are believed as they are' \
                 FROM inspection",
                [by],
            )?;
            link_all(&transaction, seals)?;
            transaction.commit()
        };
        let result = relink(&mut history);
        result.map_err(history.because("link its rows anew"))?;
        history.try_remember(true)
    }
}
