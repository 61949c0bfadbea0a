//! Where the presses stand: a table as a spreadsheet saves it, a line for each row of presses in the hall.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest file, bytes.
const MOST_BYTES: u64 = 1 << 20;
/// Most rows, and most columns.
const MOST: usize = 500;

/// Why a map cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HallError {
    #[error("map {}: {source}", path.display())]
    Io {
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    #[error("map {}: {bytes} bytes, at most {MOST_BYTES} are read", path.display())]
    TooLarge { path: PathBuf, bytes: u64 },
    #[error("map {}: {count} {what}, at most {MOST} are drawn", path.display())]
    TooWide {
        path: PathBuf,
        count: usize,
        what: &'static str,
    },
    #[error("map {}: \"{station}\" stands in line {first} and in line {second}; a press has one place", path.display())]
    Twice {
        path: PathBuf,
        station: String,
        first: usize,
        second: usize,
    },
    #[error("map {}: it names no station", path.display())]
    Empty { path: PathBuf },
}

/// Place of a press, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    pub row: usize,
    pub column: usize,
}

/// Places of the presses, by the names of their stations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hall(pub BTreeMap<String, Place>);

impl Hall {
    /// Reads a map: cells between commas, semicolons or tabs, each empty or the name of a station.
    ///
    /// # Errors
    /// It cannot be read, is too large, has a station twice or none.
    pub fn load(path: &Path) -> Result<Self, HallError> {
        let io = |source| HallError::Io {
            path: path.to_owned(),
            source,
        };
        let bytes = std::fs::metadata(path).map_err(io)?.len();
        if bytes > MOST_BYTES {
            let path = path.to_owned();
            return Err(HallError::TooLarge { path, bytes });
        }
        Self::parse(path, &std::fs::read_to_string(path).map_err(io)?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, HallError> {
        let too_wide = |count, what| HallError::TooWide {
            path: path.to_owned(),
            count,
            what,
        };
        let mut places: BTreeMap<String, Place> = BTreeMap::new();
        for (row, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
            for (column, cell) in line.split([',', ';', '\t']).enumerate() {
                let cell = cell.trim();
                let quoted = cell.strip_prefix('"').and_then(|c| c.strip_suffix('"'));
                let station = quoted.unwrap_or(cell);
                if station.is_empty() {
                    continue;
                }
                let place = Place {
                    row: row + 1,
                    column: column + 1,
                };
                if place.row > MOST {
                    return Err(too_wide(place.row, "rows"));
                }
                if place.column > MOST {
                    return Err(too_wide(place.column, "columns"));
                }
                if let Some(first) = places.insert(station.to_owned(), place) {
                    return Err(HallError::Twice {
                        path: path.to_owned(),
                        station: station.to_owned(),
                        first: first.row,
                        second: place.row,
                    });
                }
            }
        }
        if places.is_empty() {
            let path = path.to_owned();
            return Err(HallError::Empty { path });
        }
        Ok(Self(places))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Hall, String> {
        Hall::parse(Path::new("hall.csv"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn a_spreadsheet_is_a_map_whatever_separates_its_cells() {
        for separator in [",", ";", "\t"] {
            let text = ["press 1", "", "\"press 3\"\r\n", "press 4\r\n"].join(separator);
            let text = format!("\u{feff}{}", text.replace(&format!("\n{separator}"), "\n"));
            let place = |row, column| Place { row, column };
            let expected = [
                ("press 1", place(1, 1)),
                ("press 3", place(1, 3)),
                ("press 4", place(2, 1)),
            ];
            let expected = expected.map(|(name, place)| (name.to_owned(), place));
            assert_eq!(parse(&text).unwrap().0, BTreeMap::from(expected), "{text}");
        }
    }

    #[test]
    fn a_press_with_two_places_an_empty_map_and_one_without_end_are_refused() {
        let wide = format!("{}press", ",".repeat(MOST));
        let long = format!("{}press", "\n".repeat(MOST));
        for (text, why) in [
            ("a,b\nc,a\n", "\"a\" stands in line 1 and in line 2"),
            (" , \n;\n", "names no station"),
            (&wide, "501 columns, at most 500"),
            (&long, "501 rows, at most 500"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(why), "{error}");
        }
    }
}
