//! Names of files: they say which checks a file has, so that a listing shows what the lake holds and which files are redundant.
//!
//! `station=press%207/date=2026-01-31/HISTORY-EPOCH-FIRST-LAST-DIGEST.parquet`

use std::collections::BTreeMap;
use std::fmt;

use crate::rows::Stream;

const ENDING: &str = ".parquet";
/// Characters of a digest in a name: 128 bits.
const DIGEST_CHARACTERS: usize = 32;

/// Which checks a file has, of which station and day.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Range {
    pub stream: Stream,
    /// Number of the first check.
    pub first: i64,
    /// Number of the last check.
    pub last: i64,
    /// Name of the station.
    pub station: String,
    /// Day of all its checks, UTC: YYYY-MM-DD.
    pub date: String,
}

impl Range {
    /// Number of checks.
    #[must_use]
    pub fn checks(&self) -> i64 {
        self.last - self.first + 1
    }

    fn same_folder(&self, other: &Self) -> bool {
        (&self.station, &self.date) == (&other.station, &other.date)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "checks {} to {} of {} (station {}, history {}, epoch {})",
            self.first, self.last, self.date, self.station, self.stream.history, self.stream.epoch
        )
    }
}

/// Name of a file: its checks, and the digest of its rows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileName {
    pub range: Range,
    /// First 32 hexadecimal digits of the digest.
    pub digest: String,
}

impl FileName {
    /// The name of rows with this digest.
    #[must_use]
    pub fn new(range: Range, digest: &blake3::Hash) -> Self {
        let digest = digest.to_hex()[..DIGEST_CHARACTERS].to_owned();
        Self { range, digest }
    }

    /// Whether all its checks are in another file of its folder, by the names.
    #[must_use]
    pub fn lies_in(&self, whole: &Self) -> bool {
        let (part, whole) = (&self.range, &whole.range);
        part.stream == whole.stream
            && part.same_folder(whole)
            && whole.first <= part.first
            && part.last <= whole.last
    }

    /// Folder of a station, below the lake's root.
    #[must_use]
    pub fn station_folder(station: &str) -> String {
        format!("station={}", encoded(station))
    }

    /// Reads a name, below the lake's root; `None` if it is none of a file of this program.
    #[must_use]
    pub fn parse(path: &str) -> Option<Self> {
        let mut segments = path.split('/');
        let station = decoded(segments.next()?.strip_prefix("station=")?)?;
        let date = segments.next()?.strip_prefix("date=")?.to_owned();
        let file = segments.next()?.strip_suffix(ENDING)?;
        if segments.next().is_some() {
            return None;
        }
        let words: Vec<&str> = file.split('-').collect();
        let &[history, epoch, first, last, digest] = &words[..] else {
            return None;
        };
        let range = Range {
            stream: Stream {
                history: history.to_owned(),
                epoch: epoch.to_owned(),
            },
            first: first.parse().ok()?,
            last: last.parse().ok()?,
            station,
            date,
        };
        let digest = digest.to_owned();
        let name = Self { range, digest };
        // Another way to write the same name would hold the same rows a second time.
        let well = name.range.first >= 1
            && name.range.first <= name.range.last
            && name.digest.len() == DIGEST_CHARACTERS
            && name.to_string() == path;
        well.then_some(name)
    }
}

impl fmt::Display for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { range, digest } = self;
        write!(
            f,
            "{}/date={}/{}-{}-{:010}-{:010}-{digest}{ENDING}",
            Self::station_folder(&range.station),
            range.date,
            range.stream.history,
            range.stream.epoch,
            range.first,
            range.last
        )
    }
}

/// Percent-encoded but for letters, digits, `_`, `.` and `-`, as readers of such folders decode it.
pub(crate) fn encoded(text: &str) -> String {
    let mut encoded = String::new();
    for byte in text.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'_' | b'.' | b'-' => {
                encoded.push(char::from(byte));
            }
            other => encoded.push_str(&format!("%{other:02X}")),
        }
    }
    encoded
}

fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::new();
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let mut digit = || char::from(rest.next()?).to_digit(16);
            let (high, low) = (digit()?, digit()?);
            bytes.push(u8::try_from(high * 16 + low).ok()?);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

/// Which files of a listing count.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Cover {
    /// Together they have every check once.
    pub current: Vec<FileName>,
    /// All their checks are in current files of the same folder.
    pub redundant: Vec<FileName>,
    /// Pairs of which only one can be right: the same checks with other content, in another folder, or overlapping in part.
    pub doubled: Vec<(FileName, FileName)>,
}

/// Applies the rule of the lake: of the files of one history and epoch begin at the lowest check; of those that begin there take the
/// one that reaches farthest; go on behind its last check. A file whose checks are all in a taken one of its folder is redundant.
#[must_use]
pub fn cover(names: impl IntoIterator<Item = FileName>) -> Cover {
    let mut streams: BTreeMap<Stream, Vec<FileName>> = BTreeMap::new();
    for name in names {
        let stream = name.range.stream.clone();
        streams.entry(stream).or_default().push(name);
    }
    let mut cover = Cover::default();
    for mut files in streams.into_values() {
        files.sort_by(|a, b| {
            let place = |name: &FileName| (name.range.first, -name.range.last);
            place(a).cmp(&place(b)).then_with(|| a.cmp(b))
        });
        let mut taken: Option<FileName> = None;
        for name in files {
            match &taken {
                Some(taken) if name.range.first <= taken.range.last => {
                    let inside = name.range.last <= taken.range.last
                        && name.range.same_folder(&taken.range)
                        && (name.range != taken.range || name.digest == taken.digest);
                    match inside {
                        true => cover.redundant.push(name),
                        false => cover.doubled.push((taken.clone(), name)),
                    }
                }
                _ => {
                    cover.current.extend(taken.replace(name));
                }
            }
        }
        cover.current.extend(taken);
    }
    cover
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(first: i64, last: i64, date: &str, rows: &str) -> FileName {
        let range = Range {
            stream: Stream {
                history: "a".repeat(32),
                epoch: "0".repeat(8),
            },
            first,
            last,
            station: "press 7/ä=%".into(),
            date: date.into(),
        };
        FileName::new(range, &blake3::hash(rows.as_bytes()))
    }

    #[test]
    fn names_are_read_as_they_are_written_and_in_no_other_form() {
        let name = name(33, 64, "2026-01-31", "rows");
        let text = name.to_string();
        assert!(
            text.starts_with("station=press%207%2F%C3%A4%3D%25/date=2026-01-31/aaaa"),
            "{text}"
        );
        assert_eq!(FileName::parse(&text), Some(name));
        for (from, to) in [
            ("0000000033", "33"),
            ("0000000033", "0000000065"),
            ("%2F", "%2f"),
            (".parquet", ".parquet#1"),
            ("date=", "day="),
            ("/date", "/x/date"),
        ] {
            assert_eq!(FileName::parse(&text.replace(from, to)), None, "{to}");
        }
    }

    /// Against a count of every check, over all sets of nested files of two days.
    #[test]
    fn current_files_have_every_check_once() {
        let (one, two) = ("2026-01-31", "2026-02-01");
        let files: Vec<FileName> = [
            (1, 4, one),
            (5, 8, one),
            (9, 12, one),
            (1, 8, one),
            (1, 12, one),
            (13, 16, two),
            (17, 20, two),
            (13, 20, two),
        ]
        .map(|(first, last, date)| name(first, last, date, &format!("{first} {last}")))
        .into();
        for set in 0_u32..1 << files.len() {
            let there: Vec<FileName> = (0..)
                .zip(&files)
                .filter(|(bit, _)| set >> bit & 1 == 1)
                .map(|(_, file)| file.clone())
                .collect();
            let count = |files: &[FileName], check: i64| {
                let holds =
                    |file: &&FileName| (file.range.first..=file.range.last).contains(&check);
                files.iter().filter(holds).count()
            };
            let found = cover(there.clone());
            assert!(found.doubled.is_empty());
            assert_eq!(found.current.len() + found.redundant.len(), there.len());
            for check in 1..=20 {
                let expected = count(&there, check).min(1);
                assert_eq!(
                    count(&found.current, check),
                    expected,
                    "{check} of {there:?}"
                );
            }
        }
    }

    #[test]
    fn what_cannot_both_be_right_is_named() {
        let day = "2026-01-31";
        for other in [
            name(1, 32, day, "other rows"),
            name(1, 32, "2026-02-01", "rows"),
            name(20, 40, day, "overlaps"),
            name(5, 8, "2026-02-01", "inside, of another day"),
        ] {
            let found = cover([name(1, 32, day, "rows"), other.clone()]);
            assert_eq!(
                (found.current.len(), found.doubled.len()),
                (1, 1),
                "{other}"
            );
        }
    }
}
