//! The tables of a history and which version of them this is.

/// Says in the file's header that it is a history of this instrument: "FLNK".
pub const APPLICATION_ID: i32 = 0x464C_4E4B;

/// Version of the tables. A file with a later one is refused, never guessed at; an earlier one is brought up to this.
///
/// | version | since then |
/// |---|---|
/// | 1 | |
/// | 2 | a check says where it comes from, and the file whether its checks are simulated |
pub const VERSION: i32 = 2;

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
    document TEXT NOT NULL,
    link TEXT,
    simulated INTEGER CHECK (simulated IN (0, 1)),
    head TEXT,
    head_blake3 TEXT,
    station TEXT,
    operator TEXT
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
CREATE TABLE kind (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1))
) STRICT;
";

/// From version 1 to 2. Where the checks of version 1 come from is not known and stays empty.
pub const FROM_1_TO_2: &str = "
ALTER TABLE inspection ADD COLUMN link TEXT;
ALTER TABLE inspection ADD COLUMN simulated INTEGER CHECK (simulated IN (0, 1));
ALTER TABLE inspection ADD COLUMN head TEXT;
ALTER TABLE inspection ADD COLUMN head_blake3 TEXT;
ALTER TABLE inspection ADD COLUMN station TEXT;
ALTER TABLE inspection ADD COLUMN operator TEXT;
CREATE TABLE kind (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    at TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now')),
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1))
) STRICT;
";

/// Tables whose rows nobody may change or remove.
pub const KEPT: [&str; 6] = [
    "baseline",
    "inspection",
    "flank",
    "acknowledgement",
    "audit",
    "kind",
];
