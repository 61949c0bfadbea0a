//! The tables of a history, their version, and detection of definitions that this program did not create.

use rusqlite::Connection;

/// Application id in the file's header, marks a history of this instrument: "FLNK".
pub const APPLICATION_ID: i32 = 0x464C_4E4B;

/// Version of the tables. A file with another version is refused.
pub const VERSION: i32 = 1;

/// Rows are added to the tables of [`KEPT`]; none is changed or removed. `phasors` lists which checks keep which phasor files.
/// These are not part of a result, so their rows are removed with the files.
/// no part of what was found: its rows go with the files.
const TABLES: &str = "
CREATE TABLE baseline (
    blake3 TEXT PRIMARY KEY,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    tool TEXT NOT NULL,
    document TEXT NOT NULL
) STRICT;
CREATE TABLE inspection (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    tool TEXT NOT NULL,
    tool_cycles INTEGER NOT NULL CHECK (tool_cycles >= 0),
    press_cycles INTEGER NOT NULL CHECK (press_cycles >= 0),
    baseline TEXT REFERENCES baseline (blake3),
    verdict TEXT NOT NULL CHECK (verdict IN ('go', 'warn', 'no-go', 'indeterminate')),
    reason TEXT NOT NULL,
    document TEXT NOT NULL,
    link TEXT NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
    head TEXT NOT NULL,
    head_blake3 TEXT NOT NULL,
    head_seal TEXT NOT NULL,
    station TEXT NOT NULL,
    operator TEXT,
    geometry TEXT NOT NULL,
    serial TEXT
) STRICT;
CREATE INDEX inspection_of_tool ON inspection (tool, id);
CREATE TABLE flank (
    inspection INTEGER NOT NULL REFERENCES inspection (id),
    tooth INTEGER NOT NULL,
    flank TEXT NOT NULL CHECK (flank IN ('left', 'right', 'face')),
    wear_um REAL,
    u95_um REAL,
    warn_um REAL NOT NULL,
    limit_um REAL NOT NULL,
    verdict TEXT NOT NULL CHECK (verdict IN ('go', 'warn', 'no-go', 'indeterminate')),
    code TEXT,
    patch TEXT CHECK ((patch IS NOT NULL) = (flank = 'face')),
    PRIMARY KEY (inspection, tooth, flank)
) STRICT, WITHOUT ROWID;
CREATE TABLE acknowledgement (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    tool TEXT NOT NULL,
    who TEXT NOT NULL,
    inspection INTEGER REFERENCES inspection (id),
    geometry TEXT NOT NULL,
    serial TEXT
) STRICT;
CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    who TEXT NOT NULL,
    what TEXT NOT NULL,
    detail TEXT NOT NULL
) STRICT;
CREATE TABLE kind (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1))
) STRICT;
CREATE TABLE identity (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    id TEXT NOT NULL DEFAULT (lower(hex(randomblob(16))))
) STRICT;
CREATE TABLE chain (
    link INTEGER PRIMARY KEY AUTOINCREMENT,
    source TEXT NOT NULL,
    key TEXT NOT NULL,
    digest TEXT NOT NULL,
    station TEXT NOT NULL
) STRICT;
CREATE TABLE phasors (
    inspection INTEGER NOT NULL REFERENCES inspection (id),
    blake3 TEXT NOT NULL,
    PRIMARY KEY (inspection, blake3)
) STRICT, WITHOUT ROWID;
CREATE INDEX phasors_by_hash ON phasors (blake3);
INSERT INTO identity (one) VALUES (1);
";

/// Tables whose rows triggers protect against accidental change or removal by other programs.
const KEPT: [&str; 8] = [
    "baseline",
    "inspection",
    "flank",
    "acknowledgement",
    "audit",
    "kind",
    "identity",
    "chain",
];

/// Creates all definitions of a history in an empty file.
pub fn make(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute_batch(TABLES)?;
    KEPT.into_iter().try_for_each(|table| {
        ["UPDATE", "DELETE"].into_iter().try_for_each(|event| {
            connection.execute_batch(&format!(
                "CREATE TRIGGER {table}_keeps_{event} BEFORE {event} ON {table} \
                 BEGIN SELECT RAISE(ABORT, 'a history is only added to'); END"
            ))
        })
    })
}

/// A table, index, trigger or view, as the file defines it.
#[derive(Debug, PartialEq, Eq)]
struct Object {
    kind: String,
    name: String,
    table: String,
    /// With single blanks; `None` for an index that SQLite creates itself.
    definition: Option<String>,
}

impl Object {
    fn same_name(&self, other: &Self) -> bool {
        (&self.kind, &self.name) == (&other.kind, &other.name)
    }

    fn words(&self) -> String {
        let Self {
            kind, name, table, ..
        } = self;
        if name == table {
            format!("{kind} {name}")
        } else {
            format!("{kind} {name} on {table}")
        }
    }
}

fn objects(connection: &Connection) -> rusqlite::Result<Vec<Object>> {
    let mut all = connection.prepare("SELECT type, name, tbl_name, sql FROM sqlite_schema")?;
    all.query_map([], |row| {
        let definition: Option<String> = row.get(3)?;
        Ok(Object {
            kind: row.get(0)?,
            name: row.get(1)?,
            table: row.get(2)?,
            definition: definition.map(|sql| sql.split_whitespace().collect::<Vec<_>>().join(" ")),
        })
    })?
    .collect()
}

/// Definitions in the file that this program does not create, and missing ones.
struct Differences {
    foreign: Vec<Object>,
    missing: Vec<Object>,
}

fn differences(connection: &Connection) -> rusqlite::Result<Differences> {
    let own = Connection::open_in_memory()?;
    make(&own)?;
    let mut foreign = objects(connection)?;
    let mut missing = objects(&own)?;
    missing.retain(|object| {
        let found = foreign.iter().position(|there| there == object);
        found.map(|at| foreign.swap_remove(at)).is_none()
    });
    Ok(Differences { foreign, missing })
}

/// Describes how the file's definitions differ from those that this program creates: a foreign trigger may change an added row.
pub fn strange(connection: &Connection) -> rusqlite::Result<Option<String>> {
    let Differences { foreign, missing } = differences(connection)?;
    let among = |objects: &[Object], one: &Object| objects.iter().any(|other| other.same_name(one));
    let mut said = Vec::new();
    for object in &foreign {
        let what = if among(&missing, object) {
            "is not as this program makes it"
        } else {
            "is none of this program's"
        };
        said.push(format!("{} {what}", object.words()));
    }
    for object in missing.iter().filter(|object| !among(&foreign, object)) {
        said.push(format!("{} is missing", object.words()));
    }
    Ok((!said.is_empty()).then(|| said.join(", ")))
}

/// Removes foreign triggers, views and indices, and creates missing ones again; tables are left unchanged.
pub fn restore(connection: &Connection) -> rusqlite::Result<()> {
    let Differences { foreign, missing } = differences(connection)?;
    let not_table = |object: &&Object| object.kind != "table" && object.definition.is_some();
    for Object { kind, name, .. } in foreign.iter().filter(not_table) {
        let name = name.replace('"', "\"\"");
        connection.execute_batch(&format!("DROP {kind} \"{name}\""))?;
    }
    for sql in missing.iter().filter(not_table).flat_map(|o| &o.definition) {
        connection.execute_batch(sql)?;
    }
    Ok(())
}
