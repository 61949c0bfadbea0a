//! The tables of a history and which version of them this is.

/// Says in the file's header that it is a history of this instrument: "FLNK".
pub const APPLICATION_ID: i32 = 0x464C_4E4B;

/// Version of the tables. A file with another one is refused, never guessed at.
pub const VERSION: i32 = 1;

/// Rows are added to the tables of [`KEPT`], none is changed or removed. `phasors` says which checks keep which files of phasors, which are
/// no part of what was found: its rows go with the files.
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

/// The chain of a history that somebody trusts is made anew.
pub const CHAIN_ANEW: &str = "
DROP TRIGGER IF EXISTS chain_keeps_UPDATE;
DROP TRIGGER IF EXISTS chain_keeps_DELETE;
DROP TABLE IF EXISTS chain;
CREATE TABLE chain (
    link INTEGER PRIMARY KEY AUTOINCREMENT,
    source TEXT NOT NULL,
    key TEXT NOT NULL,
    digest TEXT NOT NULL,
    station TEXT NOT NULL
) STRICT;
CREATE TRIGGER chain_keeps_UPDATE BEFORE UPDATE ON chain
    BEGIN SELECT RAISE(ABORT, 'a history is only added to'); END;
CREATE TRIGGER chain_keeps_DELETE BEFORE DELETE ON chain
    BEGIN SELECT RAISE(ABORT, 'a history is only added to'); END;
";

/// Tables whose rows nobody may change or remove.
pub const KEPT: [&str; 8] = [
    "baseline",
    "inspection",
    "flank",
    "acknowledgement",
    "audit",
    "kind",
    "identity",
    "chain",
];
