//! Files that people write: read with a size limit, complained about with file and line.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::files::read_regular;

/// No head or plan file comes near this; a lying or wrong file must not fill the memory.
pub const MAX_BYTES: u64 = 4 << 20;

/// Why a text file (head, plan, calibration) could not be used. Lines count from 1.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TextFileError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Too large to be such a file.
    #[error("{} has more than {limit_bytes} bytes: no head, plan or calibration file is that large", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// The limit.
        limit_bytes: u64,
    },
    /// Not UTF-8.
    #[error("{} is not text (byte {offset} is not UTF-8): expected TOML, or OpenCV XML/YAML", path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// Where the text ends.
        offset: usize,
    },
    /// Grammar, unknown or missing keys, wrong types. The message names the keys that would be right.
    #[error("{}:{line}: {message}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The parser's message.
        message: String,
    },
    /// A value outside its limits.
    #[error("{}:{line}: {key} = {got}: {expected}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The line of the key (of its table, if the key is absent).
        line: usize,
        /// Which value, as `table.key`.
        key: String,
        /// What was found.
        got: String,
        /// What would be right.
        expected: Cow<'static, str>,
    },
}

/// A complaint about a value, before it is known in which file and line it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct BadValue {
    /// Which value, as `table.key`.
    pub key: String,
    /// What was found.
    pub got: String,
    /// What would be right.
    pub expected: Cow<'static, str>,
}

impl BadValue {
    /// A complaint.
    pub fn new(
        key: impl Into<String>,
        got: impl std::fmt::Debug,
        expected: impl Into<Cow<'static, str>>,
    ) -> Self {
        Self {
            key: key.into(),
            got: format!("{got:?}"),
            expected: expected.into(),
        }
    }

    /// The complaint with its file, and the line of the key in the text of it.
    pub fn in_file(self, path: &Path, text: &str) -> TextFileError {
        TextFileError::Value {
            path: path.to_owned(),
            line: line_of_key(text, &self.key),
            key: self.key,
            got: self.got,
            expected: self.expected,
        }
    }
}

/// Condition on a value of a file: whether it holds, key, value, and what would be right.
pub type Requirement<'a> = (bool, &'a str, &'a dyn std::fmt::Debug, &'static str);

/// Complains about the first value of a table whose condition does not hold.
///
/// # Errors
/// [`BadValue`] of that row.
pub fn require(table: &[Requirement<'_>]) -> Result<(), BadValue> {
    match table.iter().find(|(holds, ..)| !holds) {
        Some(&(_, key, got, expected)) => Err(BadValue::new(key, got, expected)),
        None => Ok(()),
    }
}

/// Reads a text file of at most [`MAX_BYTES`].
///
/// # Errors
/// [`TextFileError::Read`], [`TextFileError::TooLarge`], [`TextFileError::NotText`].
pub fn read(path: &Path) -> Result<String, TextFileError> {
    read_up_to(path, MAX_BYTES)
}

/// Reads a text file of at most `limit_bytes`.
///
/// # Errors
/// As [`read`].
pub fn read_up_to(path: &Path, limit_bytes: u64) -> Result<String, TextFileError> {
    let failed = |source| TextFileError::Read {
        path: path.to_owned(),
        source,
    };
    let bytes = match read_regular(path, limit_bytes) {
        Err(error) if error.kind() == std::io::ErrorKind::FileTooLarge => {
            return Err(TextFileError::TooLarge {
                path: path.to_owned(),
                limit_bytes,
            });
        }
        bytes => bytes.map_err(failed)?,
    };
    String::from_utf8(bytes).map_err(|error| TextFileError::NotText {
        path: path.to_owned(),
        offset: error.utf8_error().valid_up_to(),
    })
}

/// Reads a TOML file of at most `limit_bytes` and has its values checked. Returns its text too, for whoever needs its hash.
///
/// # Errors
/// As [`read`] and [`parse_toml`]; [`TextFileError::Value`] with the line of what `check` complains about.
pub fn load_toml<T: serde::de::DeserializeOwned>(
    path: &Path,
    limit_bytes: u64,
    check: impl FnOnce(&T) -> Result<(), BadValue>,
) -> Result<(T, String), TextFileError> {
    let text = read_up_to(path, limit_bytes)?;
    let value = parse_toml(path, &text)?;
    check(&value).map_err(|bad| bad.in_file(path, &text))?;
    Ok((value, text))
}

/// Parses TOML, with file and line on errors.
///
/// # Errors
/// [`TextFileError::Syntax`].
pub fn parse_toml<T: serde::de::DeserializeOwned>(
    path: &Path,
    text: &str,
) -> Result<T, TextFileError> {
    toml::from_str(text).map_err(|error| TextFileError::Syntax {
        path: path.to_owned(),
        line: error
            .span()
            .map_or(1, |span| line_of_offset(text, span.start)),
        message: error.message().to_owned(),
    })
}

/// The line, from 1, on which the byte at `offset` stands.
pub fn line_of_offset(text: &str, offset: usize) -> usize {
    1 + text.as_bytes()[..offset.min(text.len())]
        .iter()
        .filter(|&&byte| byte == b'\n')
        .count()
}

/// The line on which `table.key` (or `key`) is set; the table's own line if the key is not there; else 1.
///
/// An index as in `set[2].periods` counts the `[[set]]` headers from 0.
fn line_of_key(text: &str, key: &str) -> usize {
    let (table, name) = key.rsplit_once('.').unwrap_or(("", key));
    let (table, index) = match table.split_once('[') {
        Some((table, rest)) => (table, rest.trim_end_matches(']').parse().unwrap_or(0)),
        None => (table, 0usize),
    };
    let name = name.split('[').next().unwrap_or(name);
    let mut inside = table.is_empty();
    let mut seen = 0;
    let mut table_line = 1;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.starts_with('[') {
            let header = line
                .trim_start_matches('[')
                .split(']')
                .next()
                .unwrap_or("")
                .trim();
            inside = header == table && seen == index;
            if header == table {
                seen += 1;
            }
            if inside {
                table_line = number + 1;
            }
        } else if inside
            && line
                .split('=')
                .next()
                .is_some_and(|left| left.trim() == name)
        {
            return number + 1;
        }
    }
    table_line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_found_in_its_own_table() {
        let text = "name = 'x'\n[camera]\nwidth_px = 3\n[projector]\nwidth_px = 4\n[[set]]\nsteps = 3\n[[set]]\nsteps = 2\n";
        assert_eq!(line_of_key(text, "name"), 1);
        assert_eq!(line_of_key(text, "camera.width_px"), 3);
        assert_eq!(line_of_key(text, "projector.width_px"), 5);
        assert_eq!(line_of_key(text, "set[1].steps"), 9);
        assert_eq!(line_of_key(text, "projector.absent"), 4);
    }
}
