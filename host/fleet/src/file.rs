//! A file of the lake: Parquet, one group of rows, and who answers for them in its metadata.
//!
//! ```text
//!  checks ──► digest of the rows ──► name          (anybody can compute it)
//!               └──► seal: digest with the station's key      (who has the key can compute it)
//! ```
//!
//! Rows are cut into parts by their place in the history (`ship`); a part is sealed once. A compacted file has the rows of several
//! parts and keeps their seals, so compacting needs no key.

use std::collections::HashMap;
use std::sync::Arc;

use bytes::Bytes;
use flankscope_record::seal::Seals;
use parquet::basic::{Compression, Encoding};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use serde::{Deserialize, Serialize};

use crate::name::{FileName, Range};
use crate::rows::{COLUMNS, Column, Kind, LakeCheck, Level, VERSION, Value, Values};

pub(crate) const VERSION_KEY: &str = "flankscope.lake";
const STATION_KEY: &str = "flankscope.station_key";
const PARTS_KEY: &str = "flankscope.parts";
/// Kind of the seal's digest.
const SEAL: &str = "part of a lake";
/// More rows than a file ever has: what claims more is not read.
const MOST_ROWS: i64 = 50_000_000;

/// Why a file is not believed.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("it is no whole Parquet file of this kind: {0}")]
    Parquet(#[from] ParquetError),
    #[error("the reader of Parquet gave up on it: it is damaged")]
    Unreadable,
    #[error(
        "it has version {got} of the table, this release reads up to {VERSION}; use a newer release"
    )]
    Version { got: String },
    #[error("it has a column \"{column}\", which this release does not know; use a newer release")]
    UnknownColumn { column: String },
    #[error("column \"{column}\" is missing")]
    MissingColumn { column: &'static str },
    #[error("column \"{column}\" has {got} values of {rows} rows, or of another type")]
    Values {
        column: &'static str,
        got: usize,
        rows: usize,
    },
    #[error("rows of check {check} disagree on what they have in common")]
    Disagree { check: i64 },
    #[error("its metadata are not as this program writes them: {0}")]
    Metadata(String),
    #[error("its rows have the digest {got}, its name says {expected}: it was edited or renamed")]
    Digest { got: String, expected: String },
    #[error("its checks are not those of its name")]
    OtherChecks,
    #[error(
        "part {first} to {last} is not sealed by the key of station {station_key}: it was edited"
    )]
    Seal {
        first: i64,
        last: i64,
        station_key: String,
    },
}

/// Checks that were cut out of a history together, and the seal of their station.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    pub first: i64,
    pub last: i64,
    /// Digest of its rows, with the station's key.
    pub seal: String,
}

/// Content of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LakeFile {
    pub range: Range,
    /// Id of the station's key.
    pub station_key: String,
    pub parts: Vec<Part>,
    pub checks: Vec<LakeCheck>,
}

/// Digest of a range and its rows.
#[must_use]
pub fn rows_digest(range: &Range, checks: &[LakeCheck]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let mut bytes = Vec::with_capacity(1 << 14);
    bytes.extend_from_slice(b"flankscope lake\n");
    for text in [&range.station, &range.date] {
        bytes.extend_from_slice(&(text.len() as u64).to_le_bytes());
        bytes.extend_from_slice(text.as_bytes());
    }
    for check in checks {
        check.append_to(&mut bytes);
        hasher.update(&bytes);
        bytes.clear();
    }
    hasher.update(&bytes);
    hasher.finalize()
}

fn seal(seals: &Seals, digest: &blake3::Hash) -> String {
    seals.digest(SEAL, [&digest.as_bytes()[..]])
}

impl LakeFile {
    /// A part, sealed.
    #[must_use]
    pub fn sealed(range: Range, checks: Vec<LakeCheck>, seals: &Seals) -> Self {
        let seal = seal(seals, &rows_digest(&range, &checks));
        Self {
            parts: vec![Part {
                first: range.first,
                last: range.last,
                seal,
            }],
            range,
            station_key: seals.station(),
            checks,
        }
    }

    /// Name of the file.
    #[must_use]
    pub fn name(&self) -> FileName {
        FileName::new(self.range.clone(), &rows_digest(&self.range, &self.checks))
    }

    /// The bytes of the file: the same for the same content and release.
    ///
    /// # Errors
    /// Errors of the writer; none occur when writing to memory.
    pub fn encode(&self) -> Result<Vec<u8>, FileError> {
        self.encode_without(&[])
    }

    /// As a release without some columns would.
    pub(crate) fn encode_without(&self, columns: &[&str]) -> Result<Vec<u8>, FileError> {
        let schema = Arc::new(parse_message_type(&schema(columns))?);
        let parts = serde_json::to_string(&self.parts)
            .map_err(|error| FileError::Metadata(error.to_string()))?;
        let metadata = vec![
            KeyValue::new(VERSION_KEY.into(), VERSION.to_string()),
            KeyValue::new(STATION_KEY.into(), self.station_key.clone()),
            KeyValue::new(PARTS_KEY.into(), parts),
        ];
        let mut file = SerializedFileWriter::new(Vec::new(), schema, properties(metadata))?;
        let mut group = file.next_row_group()?;
        let (mut of_check, mut of_flank) = (0, 0);
        for column in COLUMNS {
            let at = match column.level {
                Level::Check => &mut of_check,
                Level::Flank => &mut of_flank,
            };
            if !columns.contains(&column.name) {
                write_column(&mut group, column, &self.values(column.level, *at))?;
            }
            *at += 1;
        }
        group.close()?;
        Ok(file.into_inner()?)
    }

    /// A column's value in every row.
    fn values(&self, level: Level, at: usize) -> Vec<Option<&Value>> {
        let mut values = Vec::new();
        for check in &self.checks {
            match level {
                Level::Check => {
                    let rows = check.flanks.len().max(1);
                    values.extend(std::iter::repeat_n(check.values[at].as_ref(), rows));
                }
                Level::Flank if check.flanks.is_empty() => values.push(None),
                Level::Flank => values.extend(check.flanks.iter().map(|flank| flank[at].as_ref())),
            }
        }
        values
    }

    /// Reads a file and compares its rows with its name.
    ///
    /// # Errors
    /// It is damaged, cut short, edited, renamed, or of a newer release.
    pub fn decode(name: &FileName, bytes: Bytes) -> Result<Self, FileError> {
        // The reader is made for files that a program wrote; what a damaged one makes it do must not end a check of a whole lake.
        let read = std::panic::catch_unwind(|| Self::read(name, bytes));
        let file = read.unwrap_or(Err(FileError::Unreadable))?;
        let got = file.name().digest;
        if got != name.digest {
            return Err(FileError::Digest {
                got,
                expected: name.digest.clone(),
            });
        }
        let numbers = file.checks.iter().map(LakeCheck::number);
        let stream = &name.range.stream;
        let of_stream = |check: &LakeCheck| {
            check.text("history") == stream.history && check.text("epoch") == stream.epoch
        };
        let mut from = name.range.first;
        let joined = file.parts.iter().all(|part| {
            let follows = part.first == from && part.last >= part.first;
            from = part.last.saturating_add(1);
            follows
        });
        let right = numbers.eq(name.range.first..=name.range.last)
            && file.checks.iter().all(of_stream)
            && joined
            && from == name.range.last + 1;
        right.then_some(file).ok_or(FileError::OtherChecks)
    }

    fn read(name: &FileName, bytes: Bytes) -> Result<Self, FileError> {
        let reader = SerializedFileReader::new(bytes)?;
        let metadata = reader.metadata().file_metadata();
        let key_values: HashMap<&str, &str> = metadata
            .key_value_metadata()
            .into_iter()
            .flatten()
            .filter_map(|pair| Some((&pair.key[..], pair.value.as_deref()?)))
            .collect();
        check_version(key_values.get(VERSION_KEY).copied())?;
        let of = |key| key_values.get(key).copied().ok_or_else(|| missing(key));
        let parts = serde_json::from_str(of(PARTS_KEY)?)
            .map_err(|error| FileError::Metadata(error.to_string()))?;
        let station_key = of(STATION_KEY)?.to_owned();
        let groups = reader.num_row_groups();
        if groups != 1 || metadata.num_rows() > MOST_ROWS {
            return Err(FileError::Metadata(format!(
                "{groups} groups of {} rows, not one of at most {MOST_ROWS}",
                metadata.num_rows()
            )));
        }
        let group = reader.get_row_group(0)?;
        Ok(Self {
            range: name.range.clone(),
            station_key,
            parts,
            checks: read_checks(group.as_ref())?,
        })
    }

    /// Its checks from one number to another; none if it has not all of them.
    #[must_use]
    pub fn between(&self, first: i64, last: i64) -> &[LakeCheck] {
        let at = |number: i64| usize::try_from(number - self.range.first).unwrap_or(usize::MAX);
        let found = self.checks.get(at(first)..at(last).saturating_add(1));
        found.unwrap_or_default()
    }

    /// Verifies the seal of each part with the key of its station.
    ///
    /// # Errors
    /// A part is not as the station shipped it.
    pub fn verify_seals(&self, seals: &Seals) -> Result<(), FileError> {
        for part in &self.parts {
            let range = Range {
                first: part.first,
                last: part.last,
                ..self.range.clone()
            };
            let checks = self.between(part.first, part.last);
            if checks.is_empty() || seal(seals, &rows_digest(&range, checks)) != part.seal {
                return Err(FileError::Seal {
                    first: part.first,
                    last: part.last,
                    station_key: self.station_key.clone(),
                });
            }
        }
        Ok(())
    }
}

/// Without times and names of libraries, so that the same rows are the same bytes.
fn properties(metadata: Vec<KeyValue>) -> Arc<WriterProperties> {
    let mut builder = WriterProperties::builder()
        .set_created_by("flankscope-fleet".into())
        // Made without C; a tenth larger than zstd's.
        .set_compression(Compression::LZ4_RAW)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_max_row_group_row_count(None)
        .set_key_value_metadata(Some(metadata));
    // Measured figures do not repeat; their leading bytes do.
    for column in ["wear_um", "u95_um"] {
        builder = builder
            .set_column_dictionary_enabled(column.into(), false)
            .set_column_encoding(column.into(), Encoding::BYTE_STREAM_SPLIT);
    }
    Arc::new(builder.build())
}

fn schema(without: &[&str]) -> String {
    let mut text = String::from("message flanks {\n");
    for column in COLUMNS
        .iter()
        .filter(|column| !without.contains(&column.name))
    {
        let presence = if column.required {
            "REQUIRED"
        } else {
            "OPTIONAL"
        };
        let (physical, logical) = match (column.kind, column.level) {
            (Kind::Text, _) => ("BINARY", " (STRING)"),
            (Kind::Integer, Level::Flank) => ("INT32", ""),
            (Kind::Integer, Level::Check) => ("INT64", ""),
            (Kind::Digest, _) => ("BINARY", ""),
            (Kind::Real, _) => ("DOUBLE", ""),
            (Kind::Boolean, _) => ("BOOLEAN", ""),
            (Kind::Time, _) => ("INT64", " (TIMESTAMP(MILLIS,true))"),
        };
        text += &format!("    {presence} {physical} {}{logical};\n", column.name);
    }
    text + "}"
}

fn write_column(
    group: &mut SerializedRowGroupWriter<'_, Vec<u8>>,
    column: &'static Column,
    values: &[Option<&Value>],
) -> Result<(), FileError> {
    match (column.kind, column.level) {
        (Kind::Text, _) => write::<ByteArrayType>(group, column, values, |value| match value {
            Value::Text(text) => Some(ByteArray::from(&text[..])),
            _ => None,
        }),
        (Kind::Digest, _) => write::<ByteArrayType>(group, column, values, |value| match value {
            Value::Text(text) => {
                let digest = blake3::Hash::from_hex(text).ok()?;
                Some(ByteArray::from(digest.as_bytes().to_vec()))
            }
            _ => None,
        }),
        (Kind::Integer, Level::Flank) => {
            write::<Int32Type>(group, column, values, |value| match value {
                Value::Integer(number) => i32::try_from(*number).ok(),
                _ => None,
            })
        }
        (Kind::Integer | Kind::Time, _) => {
            write::<Int64Type>(group, column, values, |value| match value {
                Value::Integer(number) => Some(*number),
                _ => None,
            })
        }
        (Kind::Real, _) => write::<DoubleType>(group, column, values, |value| match value {
            Value::Real(number) => Some(*number),
            _ => None,
        }),
        (Kind::Boolean, _) => write::<BoolType>(group, column, values, |value| match value {
            Value::Boolean(is) => Some(*is),
            _ => None,
        }),
    }
}

fn write<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, Vec<u8>>,
    column: &'static Column,
    values: &[Option<&Value>],
    of: impl Fn(&Value) -> Option<T::T>,
) -> Result<(), FileError> {
    let given: Vec<&Value> = values.iter().copied().flatten().collect();
    let typed: Vec<T::T> = given.iter().filter_map(|value| of(value)).collect();
    if typed.len() != given.len() || (column.required && typed.len() != values.len()) {
        return Err(FileError::Values {
            column: column.name,
            got: typed.len(),
            rows: values.len(),
        });
    }
    let present: Vec<i16> = values.iter().map(|v| i16::from(v.is_some())).collect();
    let present = (!column.required).then_some(&present[..]);
    if let Some(mut writer) = group.next_column()? {
        writer.typed::<T>().write_batch(&typed, present, None)?;
        writer.close()?;
    }
    Ok(())
}

fn missing(key: &str) -> FileError {
    FileError::Metadata(format!("{key} is missing"))
}

/// Whether this release knows the version of the table that a file states.
pub(crate) fn check_version(version: Option<&str>) -> Result<(), FileError> {
    let version = version.ok_or_else(|| missing(VERSION_KEY))?;
    match version.parse() {
        Ok(0..=VERSION) => Ok(()),
        _ => Err(FileError::Version {
            got: version.to_owned(),
        }),
    }
}

/// Whether this release knows all columns of a file, and none is missing that every file has.
pub(crate) fn check_columns(names: &[&str]) -> Result<(), FileError> {
    let is_known = |name: &&&str| COLUMNS.iter().any(|column| column.name == **name);
    if let Some(strange) = names.iter().find(|name| !is_known(name)) {
        let column = (*strange).to_owned();
        return Err(FileError::UnknownColumn { column });
    }
    let missing = |column: &&Column| column.required && !names.contains(&column.name);
    match COLUMNS.iter().find(missing) {
        Some(Column { name: column, .. }) => Err(FileError::MissingColumn { column }),
        None => Ok(()),
    }
}

/// Reads all rows and joins those of each check.
fn read_checks(group: &dyn RowGroupReader) -> Result<Vec<LakeCheck>, FileError> {
    let metadata = group.metadata();
    let rows = usize::try_from(metadata.num_rows()).unwrap_or(0);
    let columns = metadata.columns().iter();
    let names: Vec<String> = columns
        .map(|column| column.column_path().string())
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    check_columns(&names)?;
    let at: HashMap<&str, usize> = names.into_iter().zip(0..).collect();
    let mut of_checks: Vec<Values> = Vec::new();
    let mut of_flanks: Vec<Values> = Vec::new();
    for column in COLUMNS {
        let values = match at.get(column.name) {
            Some(index) => read_column(group, *index, column, rows)?,
            // A file from before this column.
            None => vec![None; rows],
        };
        match column.level {
            Level::Check => of_checks.push(values),
            Level::Flank => of_flanks.push(values),
        }
    }
    let row_of = |columns: &mut [Values], row: usize| -> Values {
        let take = |column: &mut Values| column.get_mut(row).and_then(Option::take);
        columns.iter_mut().map(take).collect()
    };
    let mut checks: Vec<LakeCheck> = Vec::new();
    for row in 0..rows {
        let values = row_of(&mut of_checks, row);
        let flank = row_of(&mut of_flanks, row);
        let none = flank.iter().all(Option::is_none);
        let check = LakeCheck {
            values,
            flanks: Vec::new(),
        };
        match checks.last_mut() {
            Some(last) if last.number() == check.number() => {
                if last.values != check.values || last.flanks.is_empty() || none {
                    let check = check.number();
                    return Err(FileError::Disagree { check });
                }
                last.flanks.push(flank);
            }
            _ => {
                let flanks = if none { Vec::new() } else { vec![flank] };
                checks.push(LakeCheck { flanks, ..check });
            }
        }
    }
    Ok(checks)
}

fn read_column(
    group: &dyn RowGroupReader,
    index: usize,
    column: &'static Column,
    rows: usize,
) -> Result<Values, FileError> {
    let of_bytes = |bytes: ByteArray| Value::Text(String::from_utf8_lossy(bytes.data()).into());
    match (column.kind, column.level) {
        (Kind::Text, _) => read::<ByteArrayType>(group, index, column, rows, of_bytes),
        (Kind::Digest, _) => read::<ByteArrayType>(group, index, column, rows, |bytes| {
            let digest = blake3::Hash::from_slice(bytes.data());
            Value::Text(digest.map_or_else(|_| String::new(), |digest| digest.to_hex().to_string()))
        }),
        (Kind::Integer, Level::Flank) => read::<Int32Type>(group, index, column, rows, |number| {
            Value::Integer(number.into())
        }),
        (Kind::Integer | Kind::Time, _) => {
            read::<Int64Type>(group, index, column, rows, Value::Integer)
        }
        (Kind::Real, _) => read::<DoubleType>(group, index, column, rows, Value::Real),
        (Kind::Boolean, _) => read::<BoolType>(group, index, column, rows, Value::Boolean),
    }
}

fn read<T: DataType>(
    group: &dyn RowGroupReader,
    index: usize,
    column: &'static Column,
    rows: usize,
    of: impl Fn(T::T) -> Value,
) -> Result<Values, FileError> {
    let reader = group.get_column_reader(index)?;
    let wrong = |got| FileError::Values {
        column: column.name,
        got,
        rows,
    };
    let optional = group
        .metadata()
        .column(index)
        .column_descr()
        .max_def_level()
        > 0;
    let mut reader = T::get_column_reader(reader).ok_or_else(|| wrong(0))?;
    let (mut present, mut values) = (Vec::new(), Vec::new());
    let mut read = 0;
    while read < rows {
        let levels = optional.then_some(&mut present);
        let (records, _, _) = reader.read_records(rows - read, levels, None, &mut values)?;
        if records == 0 {
            return Err(wrong(read));
        }
        read += records;
    }
    let mut values = values.into_iter().map(of);
    Ok(match optional {
        false => (0..rows).map(|_| values.next()).collect(),
        true => present
            .into_iter()
            .map(|level| (level > 0).then(|| values.next()).flatten())
            .collect(),
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::rows::Stream;

    pub(crate) fn file() -> LakeFile {
        let values = |level| -> Values {
            crate::rows::columns_of(level)
                .map(|column| match (column.name, column.kind) {
                    ("history", _) => Some(Value::Text("a".repeat(32))),
                    ("epoch", _) => Some(Value::Text("0".repeat(8))),
                    ("operator" | "serial" | "code", _) => None,
                    (name, Kind::Text) => Some(name.into()),
                    ("check_number", _) | (_, Kind::Integer) => Some(7.into()),
                    (_, Kind::Time) => Some(983_661_120_000.into()),
                    (_, Kind::Real) => Some(0.1.into()),
                    (_, Kind::Boolean) => Some(Value::Boolean(true)),
                    (_, Kind::Digest) => Some(Value::Text("ab".repeat(32))),
                })
                .collect()
        };
        let check = LakeCheck {
            values: values(Level::Check),
            flanks: vec![values(Level::Flank), values(Level::Flank)],
        };
        let range = Range {
            stream: Stream {
                history: "a".repeat(32),
                epoch: "0".repeat(8),
            },
            first: 7,
            last: 7,
            station: "press 7".into(),
            date: "2001-03-03".into(),
        };
        LakeFile::sealed(range, vec![check], &Seals::passing().unwrap())
    }

    #[test]
    fn a_file_from_before_an_optional_column_has_the_same_rows_and_name() {
        let file = file();
        let old = file
            .encode_without(&["operator", "serial", "code"])
            .unwrap();
        assert_ne!(old, file.encode().unwrap());
        assert_eq!(LakeFile::decode(&file.name(), old.into()).unwrap(), file);
        let without = file.encode_without(&["tool"]).unwrap();
        let error = LakeFile::decode(&file.name(), without.into()).unwrap_err();
        assert!(
            matches!(error, FileError::MissingColumn { column: "tool" }),
            "{error}"
        );
    }

    #[test]
    fn a_file_of_a_newer_release_is_refused_by_name() {
        let file = file();
        let bytes = file.encode().unwrap();
        // Names of one length, so that nothing else moves.
        let changed = |from: &str, to: &str| {
            let mut bytes = bytes.clone();
            let places: Vec<usize> = (0..bytes.len() - from.len())
                .filter(|at| bytes[*at..].starts_with(from.as_bytes()))
                .collect();
            assert!(!places.is_empty());
            for at in places {
                bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
            }
            LakeFile::decode(&file.name(), bytes.into()).unwrap_err()
        };
        let error = changed("operator", "operated");
        assert!(
            matches!(&error, FileError::UnknownColumn { column } if column == "operated"),
            "{error}"
        );
        let error = changed("flankscope.lake\x18\x011", "flankscope.lake\x18\x012");
        assert!(
            matches!(&error, FileError::Version { got } if got == "2"),
            "{error}"
        );
    }
}
