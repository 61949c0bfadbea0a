//! Files of daily sums: what the view `sums` of `questions.sql` says of a day that is over, so that questions need not read its rows.
//!
//! They are a cache. A file's name has the digest of everything that it was made of, the names of the day's files that count and the
//! view's own text, so that it stands for no other rows: when a file comes late, is joined or given up, or a release defines the sums
//! otherwise, the name does not match and the rows are read. It has the digest of its bytes, too, so that what was cut short or edited is
//! not believed. Names of rows have digests of rows, and sums are made of files that were compared with theirs.

use std::collections::BTreeMap;
use std::fmt;

use crate::name::FileName;

/// Views and named questions, for people and for DuckDB, too.
pub const QUESTIONS_SQL: &str = include_str!("questions.sql");

/// Where the view stands whose rows are kept.
pub(crate) const VIEW: &str = "CREATE VIEW sums AS";

/// Characters of a digest in a name: 128 bits, as in names of rows.
const DIGEST_CHARACTERS: usize = 32;

/// Name of a day's sums, without an ending: no pattern for Parquet files finds them among the rows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SumsName {
    /// Day: YYYY-MM-DD.
    pub date: String,
    /// Digest of what they were made of.
    pub source: String,
    /// Digest of the file's bytes.
    pub content: String,
}

impl SumsName {
    /// Folder of the sums; readers of Parquet pass over names that begin with `_`.
    pub const FOLDER: &'static str = "_sums";

    /// The name of these bytes.
    #[must_use]
    pub fn new(date: &str, source: &str, bytes: &[u8]) -> Self {
        Self {
            date: date.to_owned(),
            source: source.to_owned(),
            content: digits(&blake3::hash(bytes)),
        }
    }

    /// Whether these are its bytes.
    #[must_use]
    pub fn is_of(&self, bytes: &[u8]) -> bool {
        self.content == digits(&blake3::hash(bytes))
    }

    /// Reads a name, below the lake's root.
    #[must_use]
    pub fn parse(path: &str) -> Option<Self> {
        let name = path.strip_prefix(Self::FOLDER)?.strip_prefix('/')?;
        let mut words = name.rsplitn(3, '-').map(str::to_owned);
        let (content, source, date) = (words.next()?, words.next()?, words.next()?);
        let well = content.len() == DIGEST_CHARACTERS
            && source.len() == DIGEST_CHARACTERS
            && date.parse::<jiff::civil::Date>().is_ok();
        let name = Self {
            date,
            source,
            content,
        };
        (well && name.to_string() == path).then_some(name)
    }
}

impl fmt::Display for SumsName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            date,
            source,
            content,
        } = self;
        write!(f, "{}/{date}-{source}-{content}", Self::FOLDER)
    }
}

fn digits(digest: &blake3::Hash) -> String {
    digest.to_hex()[..DIGEST_CHARACTERS].to_owned()
}

/// A day of a lake.
#[derive(Debug)]
pub struct Day<'a> {
    /// Its files that count, of all stations, sorted.
    pub files: Vec<&'a FileName>,
    /// Digest of what its sums are made of.
    pub source: String,
}

impl Day<'_> {
    /// Whether a file is one of its files.
    #[must_use]
    pub fn has(&self, name: &FileName) -> bool {
        self.files.binary_search(&name).is_ok()
    }
}

/// The days of the files that count.
#[must_use]
pub fn days<'a>(current: impl IntoIterator<Item = &'a FileName>) -> BTreeMap<&'a str, Day<'a>> {
    let mut files: BTreeMap<&str, Vec<&FileName>> = BTreeMap::new();
    for name in current {
        files.entry(&name.range.date).or_default().push(name);
    }
    let day = |(date, mut files): (&'a str, Vec<&'a FileName>)| {
        files.sort();
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"flankscope sums\n");
        hasher.update(definition().as_bytes());
        for name in &files {
            hasher.update(format!("\n{name}").as_bytes());
        }
        let source = digits(&hasher.finalize());
        (date, Day { files, source })
    };
    files.into_iter().map(day).collect()
}

/// The views that say what the sums are.
fn definition() -> &'static str {
    let end = QUESTIONS_SQL.find(VIEW).and_then(|view| {
        let end = QUESTIONS_SQL[view..].find(";\n")?;
        Some(view + end)
    });
    &QUESTIONS_SQL[..end.unwrap_or(QUESTIONS_SQL.len())]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written_and_in_no_other_form() {
        let name = SumsName::new("2026-01-31", &"a".repeat(32), b"sums");
        let text = name.to_string();
        assert_eq!(SumsName::parse(&text), Some(name.clone()));
        assert!(name.is_of(b"sums") && !name.is_of(b"sum"));
        for (from, to) in [
            ("_sums/", "_sums/x/"),
            ("_sums/", "sums/"),
            ("2026-01-31", "2026-01-32"),
            ("2026-01-31", "2026-1-31"),
            ("aaaa", "aaa"),
            ("aaa-", "aaa-a"),
        ] {
            assert_eq!(SumsName::parse(&text.replacen(from, to, 1)), None, "{to}");
        }
    }

    #[test]
    fn the_definition_ends_with_the_view() {
        let definition = definition();
        assert!(definition.contains("CREATE VIEW readings AS"));
        assert!(definition.contains(VIEW) && !definition.contains("CREATE VIEW days AS"));
        assert!(definition.ends_with("tooth, flank, patch"), "{definition}");
    }
}
