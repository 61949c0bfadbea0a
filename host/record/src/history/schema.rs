//! The tables of a history and which version of them this is.

/// Says in the file's header that it is a history of this instrument: "FLNK".
pub const APPLICATION_ID: i32 = 0x464C_4E4B;

/// Version of the tables. A file with a later one is refused, never guessed at; an earlier one is brought up to this.
///
/// | version | since then |
/// |---|---|
/// | 1 | |
/// | 2 | a check says where it comes from, and the file whether its checks are simulated |
/// | 3 | a check says which die it is of and how its head is known; the file has an id, and every row is a link of a chain |
/// | 4 | a row of `flank` may be of a patch |
pub const VERSION: i32 = 4;

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
    operator TEXT,
    geometry TEXT,
    serial TEXT,
    head_seal TEXT
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
    geometry TEXT,
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
INSERT INTO identity (one) VALUES (1);
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

/// From version 2 to 3. Which die the checks of version 2 are of is known by its name alone.
pub const FROM_2_TO_3: &str = "
ALTER TABLE inspection ADD COLUMN geometry TEXT;
ALTER TABLE inspection ADD COLUMN serial TEXT;
ALTER TABLE inspection ADD COLUMN head_seal TEXT;
ALTER TABLE acknowledgement ADD COLUMN geometry TEXT;
ALTER TABLE acknowledgement ADD COLUMN serial TEXT;
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
INSERT INTO identity (one) VALUES (1);
INSERT INTO audit (who, what, detail) SELECT 'flankscope', 'upgrade',
    count(*) || ' checks of an earlier release are taken over as they are' FROM inspection;
";

/// From version 3 to 4. SQLite changes no condition of a column: the rows move to a table that has it. A row without a patch is the
/// same link of the chain as before.
pub const FLANK_3_TO_4: &str = "
DROP TRIGGER IF EXISTS flank_keeps_UPDATE;
DROP TRIGGER IF EXISTS flank_keeps_DELETE;
ALTER TABLE flank RENAME TO flank_3;
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
INSERT INTO flank (inspection, tooth, flank, wear_um, u95_um, warn_um, limit_um, verdict, code)
    SELECT inspection, tooth, flank, wear_um, u95_um, warn_um, limit_um, verdict, code FROM flank_3;
DROP TABLE flank_3;
";

/// Which checks keep which phasors: no part of what was found, rows go with the files. Of a file without the table, all that
/// the documents name.
pub const PHASORS: &str = "
CREATE TABLE phasors (
    inspection INTEGER NOT NULL REFERENCES inspection (id),
    blake3 TEXT NOT NULL,
    PRIMARY KEY (inspection, blake3)
) STRICT, WITHOUT ROWID;
CREATE INDEX phasors_by_hash ON phasors (blake3);
INSERT OR IGNORE INTO phasors SELECT inspection.id, phasors.value FROM inspection,
    json_each(document, '$.evidence') AS view, json_each(view.value, '$.phasors') AS phasors;
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
