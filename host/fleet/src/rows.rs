//! The rows of the lake: columns, their version, and the bytes of which digests are made.
//!
//! One table of columns ([`COLUMNS`]) drives writing, reading and digests. A column that is added later must be optional, and empty
//! values do not go into digests: so an old file has the same digest for a newer program.

use flankscope_record::history::{FlankRow, History, HistoryError, LinkedCheck};
use jiff::Timestamp;

/// Version of the table. It grows when a column gets another meaning, not when an optional one is added.
pub const VERSION: u32 = 1;

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Text,
    Integer,
    Real,
    Boolean,
    /// A BLAKE3: hexadecimal digits here, bytes in the file.
    Digest,
    /// Milliseconds since 1970, UTC.
    Time,
}

/// What a value belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// The same in every row of a check.
    Check,
    /// Of one flank or patch; empty in the only row of a check without any.
    Flank,
}

/// A column of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    pub name: &'static str,
    pub kind: Kind,
    pub level: Level,
    /// Whether every check has a value.
    pub required: bool,
}

const fn column(name: &'static str, kind: Kind, level: Level, required: bool) -> Column {
    Column {
        name,
        kind,
        level,
        required,
    }
}

/// All columns, in the order of the file.
pub const COLUMNS: &[Column] = &[
    column("history", Kind::Text, Level::Check, true),
    column("epoch", Kind::Text, Level::Check, true),
    column("check_number", Kind::Integer, Level::Check, true),
    column("stored_at", Kind::Time, Level::Check, true),
    column("tool", Kind::Text, Level::Check, true),
    column("geometry", Kind::Text, Level::Check, true),
    column("serial", Kind::Text, Level::Check, false),
    column("tool_cycles", Kind::Integer, Level::Check, true),
    column("press_cycles", Kind::Integer, Level::Check, true),
    column("baseline", Kind::Text, Level::Check, false),
    column("check_verdict", Kind::Text, Level::Check, true),
    column("reason", Kind::Text, Level::Check, true),
    column("tooth", Kind::Integer, Level::Flank, false),
    column("flank", Kind::Text, Level::Flank, false),
    column("patch", Kind::Text, Level::Flank, false),
    column("wear_um", Kind::Real, Level::Flank, false),
    column("u95_um", Kind::Real, Level::Flank, false),
    column("warn_um", Kind::Real, Level::Flank, false),
    column("limit_um", Kind::Real, Level::Flank, false),
    column("verdict", Kind::Text, Level::Flank, false),
    column("code", Kind::Text, Level::Flank, false),
    column("link", Kind::Text, Level::Check, true),
    column("simulated", Kind::Boolean, Level::Check, true),
    column("head", Kind::Text, Level::Check, true),
    column("head_blake3", Kind::Text, Level::Check, true),
    column("head_seal", Kind::Text, Level::Check, true),
    column("operator", Kind::Text, Level::Check, false),
    column("chain_link", Kind::Integer, Level::Check, true),
    column("chain_digest", Kind::Digest, Level::Check, true),
];

/// A value of a column.
#[derive(Clone, Debug)]
pub enum Value {
    Text(String),
    /// Integers and times.
    Integer(i64),
    Real(f64),
    Boolean(bool),
}

/// The same bits, as digests have it: a figure that is no number equals itself.
impl PartialEq for Value {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Text(one), Self::Text(other)) => one == other,
            (Self::Integer(one), Self::Integer(other)) => one == other,
            (Self::Real(one), Self::Real(other)) => one.to_bits() == other.to_bits(),
            (Self::Boolean(one), Self::Boolean(other)) => one == other,
            _ => false,
        }
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<i64> for Value {
    fn from(number: i64) -> Self {
        Self::Integer(number)
    }
}

impl From<f64> for Value {
    fn from(number: f64) -> Self {
        Self::Real(number)
    }
}

impl Value {
    /// Type, length and bytes, so that values cannot run together.
    fn append_to(&self, bytes: &mut Vec<u8>) {
        let mut append = |kind: u8, value: &[u8]| {
            bytes.push(kind);
            bytes.extend_from_slice(&(value.len() as u64).to_le_bytes());
            bytes.extend_from_slice(value);
        };
        match self {
            Self::Text(text) => append(b't', text.as_bytes()),
            Self::Integer(number) => append(b'i', &number.to_le_bytes()),
            Self::Real(number) => append(b'r', &number.to_bits().to_le_bytes()),
            Self::Boolean(is) => append(b'b', &[u8::from(*is)]),
        }
    }
}

/// Values of the columns of one level, in the order of [`COLUMNS`].
pub type Values = Vec<Option<Value>>;

/// The columns of a level, in the order of the file.
pub fn columns_of(level: Level) -> impl Iterator<Item = &'static Column> {
    COLUMNS.iter().filter(move |column| column.level == level)
}

/// A check in the lake.
#[derive(Clone, Debug, PartialEq)]
pub struct LakeCheck {
    /// Values that all its rows have.
    pub values: Values,
    /// One entry per flank or patch.
    pub flanks: Vec<Values>,
}

/// The history that a check is of: its id, and how often its links were made anew.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stream {
    /// Id of the history: 32 hexadecimal digits.
    pub history: String,
    /// First 8 digits of the digest with which a person last accepted the history as it is; zeros: never. The chain is one within
    /// an epoch, and a restored copy gives numbers of checks a second time only in another one.
    pub epoch: String,
}

impl Stream {
    /// # Errors
    /// The history cannot be read.
    pub fn of(history: &History) -> Result<Self, HistoryError> {
        let relinked = history.relinked()?.unwrap_or_else(|| "0".repeat(64));
        Ok(Self {
            history: history.id()?,
            epoch: relinked.chars().take(8).collect(),
        })
    }
}

/// A stored date is not in the form that a history has.
#[derive(Debug, thiserror::Error)]
#[error("check {check} is dated \"{at}\"; right would be a date like 2026-01-31T12:00:00.000Z")]
pub struct NoTime {
    check: i64,
    at: String,
}

/// Milliseconds since 1970 of a history's date, which can be written back to the same text.
///
/// # Errors
/// The text has another form.
pub fn time_ms(check: i64, at: &str) -> Result<i64, NoTime> {
    let no_time = || NoTime {
        check,
        at: at.to_owned(),
    };
    let time: Timestamp = at.parse().map_err(|_| no_time())?;
    let same = time.strftime("%Y-%m-%dT%H:%M:%S%.3fZ").to_string() == at;
    same.then(|| time.as_millisecond()).ok_or_else(no_time)
}

impl LakeCheck {
    /// # Errors
    /// Its date is none.
    pub fn new(stream: &Stream, linked: &LinkedCheck) -> Result<Self, NoTime> {
        let LinkedCheck {
            check,
            geometry,
            link,
            digest,
        } = linked;
        let text = |text: &str| Some(Value::from(text));
        let origin = &check.origin;
        let values = vec![
            text(&stream.history),
            text(&stream.epoch),
            Some(check.id.into()),
            Some(time_ms(check.id, &check.at)?.into()),
            text(&check.tool),
            text(geometry),
            check.serial.as_deref().map(Value::from),
            Some(check.tool_cycles.into()),
            Some(check.press_cycles.into()),
            check.baseline.as_deref().map(Value::from),
            text(check.verdict.as_str()),
            text(&check.reason),
            text(&origin.link),
            Some(Value::Boolean(origin.simulated)),
            text(&origin.head.name),
            text(&origin.head.blake3),
            text(&origin.head.seal),
            origin.operator.as_deref().map(Value::from),
            Some((*link).into()),
            text(digest),
        ];
        Ok(Self {
            values,
            flanks: check.flanks.iter().map(flank_values).collect(),
        })
    }

    /// A value that all rows of the check have.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<&Value> {
        let at = columns_of(Level::Check).position(|column| column.name == name)?;
        self.values.get(at)?.as_ref()
    }

    /// Gives all its rows another value of a column; none if there is no such column.
    pub fn set(&mut self, name: &str, value: Value) {
        let at = columns_of(Level::Check).position(|column| column.name == name);
        if let Some(there) = at.and_then(|at| self.values.get_mut(at)) {
            *there = Some(value);
        }
    }

    /// Its number in the history.
    #[must_use]
    pub fn number(&self) -> i64 {
        self.integer("check_number")
    }

    /// An integer that all rows of the check have; 0 if it is none.
    #[must_use]
    pub fn integer(&self, name: &str) -> i64 {
        match self.value(name) {
            Some(Value::Integer(number)) => *number,
            _ => 0,
        }
    }

    /// A text that all rows of the check have; empty if it is none.
    #[must_use]
    pub fn text(&self, name: &str) -> &str {
        match self.value(name) {
            Some(Value::Text(text)) => text,
            _ => "",
        }
    }

    /// Appends what digests are made of: names and values that are not empty, of the check and then of each flank.
    pub fn append_to(&self, bytes: &mut Vec<u8>) {
        append_values(Level::Check, &self.values, bytes);
        for flank in &self.flanks {
            append_values(Level::Flank, flank, bytes);
        }
    }
}

fn flank_values(flank: &FlankRow) -> Values {
    vec![
        Some(i64::from(flank.id.tooth).into()),
        Some(flank.id.flank.word().into()),
        flank.id.patch.as_deref().map(Value::from),
        flank.wear_um.map(Value::from),
        flank.u95_um.map(Value::from),
        Some(flank.warn_um.into()),
        Some(flank.limit_um.into()),
        Some(flank.verdict.as_str().into()),
        flank.code.map(|code| code.word().into()),
    ]
}

fn append_values(level: Level, values: &Values, bytes: &mut Vec<u8>) {
    bytes.push(b'{');
    for (column, value) in columns_of(level).zip(values) {
        if let Some(value) = value {
            bytes.extend_from_slice(column.name.as_bytes());
            value.append_to(bytes);
        }
    }
    bytes.push(b'}');
}
