//! The tables of a history and which version of them this is.

/// Says in the file's header that it is a history of this instrument: "FLNK".
pub const APPLICATION_ID: i32 = 0x464C_4E4B;

/// Version of the tables. A file with a later one is refused, never guessed at.
pub const VERSION: i32 = 1;

/// What was written stays as it was written: rows are added, none is changed or removed.
pub const TABLES: &str = "
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
    document TEXT NOT NULL
) STRICT;
CREATE INDEX inspection_of_tool ON inspection (tool, id);
CREATE TABLE flank (
    inspection INTEGER NOT NULL REFERENCES inspection (id),
    tooth INTEGER NOT NULL,
    flank TEXT NOT NULL CHECK (flank IN ('left', 'right')),
    wear_um REAL,
    u95_um REAL,
    warn_um REAL NOT NULL,
    limit_um REAL NOT NULL,
    verdict TEXT NOT NULL CHECK (verdict IN ('go', 'warn', 'no-go', 'indeterminate')),
    code TEXT,
    PRIMARY KEY (inspection, tooth, flank)
) STRICT, WITHOUT ROWID;
CREATE TABLE acknowledgement (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    tool TEXT NOT NULL,
    who TEXT NOT NULL,
    inspection INTEGER REFERENCES inspection (id)
) STRICT;
CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    who TEXT NOT NULL,
    what TEXT NOT NULL,
    detail TEXT NOT NULL
) STRICT;
";

/// Tables whose rows nobody may change or remove.
pub const KEPT: [&str; 5] = [
    "baseline",
    "inspection",
    "flank",
    "acknowledgement",
    "audit",
];
