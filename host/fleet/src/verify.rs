//! Looks at every file of a lake: what is missing, edited, cut short, of another station or there twice.

use std::collections::{BTreeMap, BTreeSet};

use flankscope_record::history::{History, HistoryError};
use flankscope_record::seal::{SealError, Seals};

use crate::file::LakeFile;
use crate::lake::{Lake, LakeError, Listing};
use crate::name::{Cover, FileName};
#[cfg(feature = "query")]
use crate::query::{QueryError, sums::are_of_rows};
use crate::retired::{Retired, first_kept};
use crate::rows::{LakeCheck, NoTime, Stream};
use crate::sums::{Day, SumsName, days};

/// Why a lake cannot be verified; what is wrong with it is a [`Finding`] instead.
#[derive(Debug, thiserror::Error)]
pub enum VerifyError {
    #[error(transparent)]
    Lake(#[from] LakeError),
    #[error(transparent)]
    Seal(#[from] SealError),
    #[error(transparent)]
    History(#[from] HistoryError),
    #[error(transparent)]
    Time(#[from] NoTime),
    #[cfg(feature = "query")]
    #[error("the sums of a day cannot be compared with its rows: {0}")]
    Sums(#[from] QueryError),
}

/// Something that is not as it was shipped.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Finding {
    /// Checks that no file has.
    Missing {
        stream: Stream,
        first: i64,
        last: i64,
    },
    /// A file that is edited, renamed, cut short or otherwise not believed.
    Damaged { name: FileName, why: String },
    /// Two files of which only one can be right.
    Doubled { one: FileName, other: FileName },
    /// Two stations use one name at the same time.
    TwoStations { station: String, keys: Vec<String> },
    /// The lake's last link is not that of the station.
    OtherChain { name: FileName, why: String },
    /// Checks that are not as the history has them.
    NotOfHistory { name: FileName, check: i64 },
    /// Sums of a day that are not what its files say.
    Sums { name: SumsName, why: &'static str },
    /// An object that this program does not write.
    Foreign { path: String },
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Missing {
                stream,
                first,
                last,
            } => write!(
                f,
                "missing: checks {first} to {last} of history {}, epoch {}; `ship` puts them again from the station's history",
                stream.history, stream.epoch
            ),
            Self::Damaged { name, why } => write!(
                f,
                "damaged: {name}: {why}; remove it, and `ship` puts its checks again from the station's history"
            ),
            Self::Doubled { one, other } => write!(
                f,
                "doubled: {one} and {other} have the same checks with other content or of another day: a copy of the history was \
                 shipped, too; keep the one that the station's history agrees with (`verify --history`)"
            ),
            Self::TwoStations { station, keys } => write!(
                f,
                "two stations: \"{station}\" is the name of the stations with the keys {} at the same time; give one another name",
                keys.join(", ")
            ),
            Self::OtherChain { name, why } => write!(f, "other chain: {name}: {why}"),
            Self::NotOfHistory { name, check } => write!(
                f,
                "not of the history: check {check} of {name} is not as the history has it"
            ),
            Self::Sums { name, why } => write!(
                f,
                "sums: {name}: {why}; remove it, and `compact` makes it anew from the rows"
            ),
            Self::Foreign { path } => write!(f, "foreign: {path} is none of this program's files"),
        }
    }
}

/// What was looked at, and what was found.
#[derive(Debug, Default)]
pub struct Report {
    pub findings: Vec<Finding>,
    /// Files that count.
    pub current: u64,
    /// Files that compaction has yet to remove.
    pub redundant: u64,
    /// Checks of the files that count.
    pub checks: u64,
    /// Flank rows of these.
    pub flanks: u64,
    /// Checks whose station's key was given, and whose seal is right.
    pub sealed: u64,
    /// Checks that retention removed on purpose.
    pub retired: u64,
    /// Links that a station wrote, by its memory beside its key, behind the last one in the lake.
    pub links_behind: i64,
}

/// First and last day.
type Days = (String, String);

/// A verification of a lake.
#[derive(Debug)]
pub struct Verifier<'a> {
    lake: &'a Lake,
    keys: &'a [Seals],
    report: Report,
    /// Days of each station's name and key.
    days: BTreeMap<(String, String), Days>,
}

impl<'a> Verifier<'a> {
    #[must_use]
    pub fn new(lake: &'a Lake, keys: &'a [Seals]) -> Self {
        Self {
            lake,
            keys,
            report: Report::default(),
            days: BTreeMap::new(),
        }
    }

    /// Reads every file. With a history, its rows are compared, too.
    ///
    /// # Errors
    /// The lake or the history cannot be read.
    pub async fn run(mut self, history: Option<&History>) -> Result<Report, VerifyError> {
        let listing = self.lake.list(None).await?;
        let Cover {
            current,
            redundant,
            doubled,
        } = listing.cover();
        for path in &listing.foreign {
            let path = path.clone();
            self.report.findings.push(Finding::Foreign { path });
        }
        self.report.current = current.len() as u64;
        self.report.redundant = redundant.len() as u64;
        for (one, other) in doubled {
            self.report.findings.push(Finding::Doubled { one, other });
        }
        let mut newest: BTreeMap<Stream, (FileName, LakeCheck)> = BTreeMap::new();
        for name in &current {
            let Some(file) = self.read(name).await? else {
                continue;
            };
            self.compare_redundant(&file, name, &redundant).await?;
            if let Some(history) = history {
                self.compare_history(&file, name, history)?;
            }
            if let Some(last) = file.checks.last() {
                newest.insert(name.range.stream.clone(), (name.clone(), last.clone()));
            }
        }
        self.compare_sums(&listing, &current).await?;
        self.missing(&current, &listing.retired);
        self.two_stations();
        self.compare_anchors(&newest)?;
        self.report.findings.sort();
        Ok(self.report)
    }

    /// A file with right rows and, where its station's key is known, right seals.
    async fn read(&mut self, name: &FileName) -> Result<Option<LakeFile>, VerifyError> {
        let file = match self.lake.read(name).await {
            Ok(file) => file,
            Err(LakeError::File { source, .. }) => {
                self.damaged(name, source);
                return Ok(None);
            }
            Err(other) => return Err(other.into()),
        };
        let checks = file.checks.len() as u64;
        self.report.checks += checks;
        self.report.flanks += file
            .checks
            .iter()
            .map(|check| check.flanks.len() as u64)
            .sum::<u64>();
        if let Some(seals) = self
            .keys
            .iter()
            .find(|seals| seals.station() == file.station_key)
        {
            match file.verify_seals(seals) {
                Ok(()) => self.report.sealed += checks,
                Err(why) => {
                    self.damaged(name, why);
                    return Ok(None);
                }
            }
        }
        let day = &file.range.date;
        let key = (file.range.station.clone(), file.station_key.clone());
        let days = self
            .days
            .entry(key)
            .or_insert_with(|| (day.clone(), day.clone()));
        if *day < days.0 {
            days.0.clone_from(day);
        }
        if *day > days.1 {
            days.1.clone_from(day);
        }
        Ok(Some(file))
    }

    fn damaged(&mut self, name: &FileName, why: impl std::fmt::Display) {
        self.report.findings.push(Finding::Damaged {
            name: name.clone(),
            why: why.to_string(),
        });
    }

    /// Compares the redundant files whose checks are in a file.
    async fn compare_redundant(
        &mut self,
        file: &LakeFile,
        name: &FileName,
        redundant: &[FileName],
    ) -> Result<(), VerifyError> {
        for other in redundant.iter().filter(|other| other.lies_in(name)) {
            match self.lake.read(other).await {
                Ok(part) if part.checks == file.between(other.range.first, other.range.last) => {}
                Ok(_) => self.report.findings.push(Finding::Doubled {
                    one: name.clone(),
                    other: other.clone(),
                }),
                Err(LakeError::File { source, .. }) => self.damaged(other, source),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn compare_history(
        &mut self,
        file: &LakeFile,
        name: &FileName,
        history: &History,
    ) -> Result<(), VerifyError> {
        let stream = &name.range.stream;
        if *stream != Stream::of(history)? {
            return Ok(());
        }
        let linked = history.linked_checks(name.range.first..=name.range.last, 0)?;
        let mut stored = Vec::with_capacity(linked.len());
        for linked in &linked {
            stored.push(LakeCheck::new(stream, linked)?);
        }
        for (at, check) in file.checks.iter().enumerate() {
            if stored.get(at) != Some(check) {
                self.report.findings.push(Finding::NotOfHistory {
                    name: name.clone(),
                    check: check.number(),
                });
            }
        }
        Ok(())
    }

    /// Compares sums with the rows of their days. Sums of files that do not count any more are read by nobody.
    async fn compare_sums(
        &mut self,
        listing: &Listing,
        current: &[FileName],
    ) -> Result<(), VerifyError> {
        let days = days(current);
        for name in &listing.sums {
            let day = days.get(&name.date[..]);
            let Some(day) = day.filter(|day| day.source == name.source) else {
                continue;
            };
            let why = match self.lake.read_sums(name).await? {
                None => Some("it was cut short or edited"),
                Some(_) if self.is_damaged(day) => None,
                #[cfg(feature = "query")]
                Some(bytes) => {
                    let of_day = listing.files.iter().filter(|file| day.has(&file.name));
                    let of_day = of_day.cloned().collect();
                    let same = are_of_rows(self.lake, of_day, bytes).await?;
                    (!same).then_some("its sums are not those of the rows")
                }
                #[cfg(not(feature = "query"))]
                Some(_) => None,
            };
            if let Some(why) = why {
                let name = name.clone();
                self.report.findings.push(Finding::Sums { name, why });
            }
        }
        Ok(())
    }

    /// Whether one of its files is named already.
    fn is_damaged(&self, day: &Day<'_>) -> bool {
        let mut findings = self.report.findings.iter();
        findings.any(|finding| match finding {
            Finding::Damaged { name, .. } => day.has(name),
            _ => false,
        })
    }

    /// Checks between the files of each history, and before the first one.
    fn missing(&mut self, current: &[FileName], retired: &[Retired]) {
        let mut last_of_history: BTreeMap<&str, i64> = BTreeMap::new();
        for name in current {
            let last = last_of_history
                .entry(&name.range.stream.history)
                .or_default();
            *last = name.range.last.max(*last);
        }
        let streams: BTreeSet<&Stream> = current.iter().map(|name| &name.range.stream).collect();
        for stream in streams {
            let kept = first_kept(retired, stream);
            self.report.retired += kept.abs_diff(1);
            let mut next = kept;
            let of_stream = current.iter().filter(|name| name.range.stream == *stream);
            for (at, name) in of_stream.enumerate() {
                // An epoch goes on where another one of the history ends.
                let goes_on = at == 0
                    && current.iter().any(|other| {
                        other.range.stream != *stream
                            && other.range.stream.history == stream.history
                            && (other.range.first..=other.range.last)
                                .contains(&(name.range.first - 1))
                    });
                if name.range.first > next && !goes_on {
                    self.report.findings.push(Finding::Missing {
                        stream: stream.clone(),
                        first: next,
                        last: name.range.first - 1,
                    });
                }
                next = name.range.last + 1;
            }
        }
    }

    fn two_stations(&mut self) {
        let mut keys_of: BTreeMap<&str, Vec<(&str, &Days)>> = BTreeMap::new();
        for ((station, key), days) in &self.days {
            keys_of.entry(station).or_default().push((key, days));
        }
        for (station, keys) in keys_of {
            let overlaps = keys.iter().enumerate().any(|(at, (_, one))| {
                keys[..at]
                    .iter()
                    .any(|(_, other)| one.0 <= other.1 && other.0 <= one.1)
            });
            if overlaps {
                self.report.findings.push(Finding::TwoStations {
                    station: station.to_owned(),
                    keys: keys.iter().map(|(key, _)| (*key).to_owned()).collect(),
                });
            }
        }
    }

    /// Compares the newest link of each history with what its station remembers beside its key.
    fn compare_anchors(
        &mut self,
        newest: &BTreeMap<Stream, (FileName, LakeCheck)>,
    ) -> Result<(), VerifyError> {
        for (stream, (name, check)) in newest {
            // The station remembers the newest epoch only.
            let same_history = |other: &&Stream| other.history == stream.history;
            if newest.keys().filter(same_history).count() > 1 {
                continue;
            }
            for seals in self.keys {
                let Some(anchor) = seals.anchor(&stream.history)? else {
                    continue;
                };
                let link = check.integer("chain_link");
                let why = if link > anchor.link {
                    Some(format!(
                        "its last link is {link}, the station has written {} links",
                        anchor.link
                    ))
                } else if link == anchor.link && check.text("chain_digest") != anchor.digest {
                    Some(format!("link {link} is not that of the station"))
                } else {
                    None
                };
                self.report.links_behind += (anchor.link - link).max(0);
                if let Some(why) = why {
                    let name = name.clone();
                    self.report.findings.push(Finding::OtherChain { name, why });
                }
            }
        }
        Ok(())
    }
}
