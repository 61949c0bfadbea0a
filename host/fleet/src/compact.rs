//! Joins the small files of past days, and gives up old days.
//!
//! Every step leaves a lake in which each check counts once, by the rule of [`cover`]:
//!
//! 1. A joined file is put beside the files that it was made of. It begins with the first of them and reaches farther, so from then on
//!    it counts and they do not.
//! 2. Files that do not count are removed, once the one that does is as old as `grace` (a reader may have listed them before it came)
//!    and was read again and found to have the same checks.
//! 3. What is given up is first marked ([`Retired`]), then removed. What is marked does not count.
//!
//! 4. Sums of days ([`sums`](crate::sums)) whose files changed are removed, and made anew where this build has the engine.
//!
//! A kill between any two steps leaves work that the next run finds by itself. Files are joined within fixed ranges of
//! [`JOINED_CHECKS`] numbers, so that two runs at a time join the same or nested ranges.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, SystemTime};

use jiff::civil::Date;
use jiff::{Span, Timestamp};

use crate::file::{FileError, LakeFile};
use crate::lake::{Lake, LakeError, Listed};
use crate::name::{Cover, FileName, Range, cover};
#[cfg(feature = "query")]
use crate::query::{QueryError, sums::of_rows};
use crate::retired::{Retired, first_kept, kept};
use crate::rows::Stream;
#[cfg(feature = "query")]
use crate::sums::Day;
use crate::sums::{SumsName, days};

/// Most checks of a joined file: four days of a check every three minutes, less where the day changes.
pub const JOINED_CHECKS: i64 = 2048;

/// Why compaction ends early. What it has done is whole.
#[derive(Debug, thiserror::Error)]
pub enum CompactError {
    #[error(transparent)]
    Lake(#[from] LakeError),
    #[error("the rows cannot be written: {0}")]
    File(#[from] FileError),
    #[cfg(feature = "query")]
    #[error("the sums of a day cannot be made: {0}")]
    Sums(#[from] QueryError),
}

/// What is compacted.
#[derive(Clone, Debug)]
pub struct Compaction {
    /// Days before this one are joined.
    pub join_before: Date,
    /// Days before this one are given up.
    pub retire_before: Option<Date>,
    /// Age of a joined file before those that it was made of are removed.
    pub grace: Duration,
    /// Now, by this host's clock.
    pub now: Timestamp,
}

impl Compaction {
    /// Joins days that lie so many days back or more (1: all but today), and gives up those that lie farther back.
    #[must_use]
    pub fn of_days(older_than: u32, retire: Option<u32>, grace: Duration, now: Timestamp) -> Self {
        let today = now.to_zoned(jiff::tz::TimeZone::UTC).date();
        let before = |days: u32| {
            let days = Span::new().try_days(i64::from(days) - 1);
            days.and_then(|days| today.checked_sub(days))
                .unwrap_or(Date::MIN)
        };
        Self {
            join_before: before(older_than),
            retire_before: retire.map(before),
            grace,
            now,
        }
    }
}

/// What was done.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Compacted {
    /// Files that were joined, and into how many.
    pub joined: u64,
    pub into: u64,
    /// Files removed because others have their checks.
    pub removed: u64,
    /// Files removed because they were given up.
    pub retired: u64,
    /// Days whose sums were made, and files of sums that were removed because they stand for nothing any more.
    pub summed: u64,
    pub sums_removed: u64,
    /// Files left alone, and why.
    pub left: Vec<(FileName, String)>,
}

/// Compacts a lake.
///
/// # Errors
/// The lake cannot be read or written.
pub async fn compact(lake: &Lake, what: &Compaction) -> Result<Compacted, CompactError> {
    let mut done = Compacted::default();
    if let Some(folder) = lake.folder() {
        remove_unfinished(folder, folder, what.grace);
    }
    let listing = lake.list(None).await?;
    let mut retired = listing.retired;
    retired.extend(mark(lake, what, &listing.files, &retired).await?);
    for file in &listing.files {
        if file.name.range.last < first_kept(&retired, &file.name.range.stream) {
            lake.remove(&file.name).await?;
            done.retired += 1;
        }
    }
    let names = listing.files.iter().map(|file| file.name.clone());
    let Cover {
        current,
        redundant,
        doubled,
    } = cover(kept(names, &retired));
    for (one, other) in doubled {
        let why = format!("its checks are also in {one}, in part or with other content");
        done.left.push((other, why));
    }
    remove_redundant(
        lake,
        what,
        (&current, &redundant),
        &listing.files,
        &mut done,
    )
    .await?;
    for run in runs(current, what.join_before) {
        join(lake, &run, &mut done).await?;
    }
    renew_sums(lake, what, &mut done).await?;
    Ok(done)
}

/// Removes sums that stand for nothing any more, and makes those of days that are over and have none.
async fn renew_sums(
    lake: &Lake,
    what: &Compaction,
    done: &mut Compacted,
) -> Result<(), CompactError> {
    let listing = lake.list(None).await?;
    let current = listing.cover().current;
    let mut days = days(&current);
    for name in &listing.sums {
        let is_of = days
            .get(&name.date[..])
            .is_some_and(|day| day.source == name.source);
        if is_of && lake.read_sums(name).await?.is_some() {
            days.remove(&name.date[..]);
        } else {
            lake.remove(name).await?;
            done.sums_removed += 1;
        }
    }
    #[cfg(not(feature = "query"))]
    let _ = what;
    #[cfg(feature = "query")]
    for (date, day) in days {
        if day
            .files
            .iter()
            .all(|name| is_before(name, what.join_before))
        {
            make_sums(lake, (date, day), &listing.files, done).await?;
        }
    }
    Ok(())
}

/// Makes the sums of a day, if all its files have the rows that their names say.
#[cfg(feature = "query")]
async fn make_sums(
    lake: &Lake,
    (date, day): (&str, Day<'_>),
    files: &[Listed],
    done: &mut Compacted,
) -> Result<(), CompactError> {
    for name in &day.files {
        match lake.read(name).await {
            Ok(_) => {}
            Err(LakeError::File { source, .. }) => {
                if !done.left.iter().any(|(left, _)| left == *name) {
                    done.left.push(((*name).clone(), source.to_string()));
                }
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        }
    }
    let of_day = files.iter().filter(|file| day.has(&file.name));
    let bytes = of_rows(lake, of_day.cloned().collect()).await?;
    let name = SumsName::new(date, &day.source, &bytes);
    lake.put(&name.to_string(), bytes).await?;
    done.summed += 1;
    Ok(())
}

/// Marks what is given up: of each history the files before the first one of a day that is kept.
async fn mark(
    lake: &Lake,
    what: &Compaction,
    files: &[Listed],
    retired: &[Retired],
) -> Result<Vec<Retired>, CompactError> {
    let Some(before) = what.retire_before else {
        return Ok(Vec::new());
    };
    let mut marks: Vec<Retired> = Vec::new();
    let names = files.iter().map(|file| file.name.clone());
    let mut streams: BTreeMap<Stream, Vec<FileName>> = BTreeMap::new();
    for name in cover(kept(names, retired)).current {
        streams
            .entry(name.range.stream.clone())
            .or_default()
            .push(name);
    }
    for (stream, names) in streams {
        let old = |name: &&FileName| is_before(name, before);
        let given_up: Vec<&FileName> = names.iter().take_while(old).collect();
        if let Some(last) = given_up.last() {
            let mark = Retired {
                kept: last.range.last + 1,
                stream,
            };
            lake.put(&mark.to_string(), Vec::new()).await?;
            marks.push(mark);
        }
    }
    Ok(marks)
}

fn is_before(name: &FileName, day: Date) -> bool {
    name.range.date.parse().is_ok_and(|date: Date| date < day)
}

async fn remove_redundant(
    lake: &Lake,
    what: &Compaction,
    (current, redundant): (&[FileName], &[FileName]),
    files: &[Listed],
    done: &mut Compacted,
) -> Result<(), CompactError> {
    let grace_ms = i64::try_from(what.grace.as_millis()).unwrap_or(i64::MAX);
    let newest_ms = what.now.as_millisecond().saturating_sub(grace_ms);
    for whole in current {
        let parts: Vec<&FileName> = redundant
            .iter()
            .filter(|part| part.lies_in(whole))
            .collect();
        let old = files
            .iter()
            .any(|file| file.name == *whole && file.put_ms <= newest_ms);
        if parts.is_empty() || !old {
            continue;
        }
        let file = match lake.read(whole).await {
            Ok(file) => file,
            Err(LakeError::File { source, .. }) => {
                done.left.push((whole.clone(), source.to_string()));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        for part in parts {
            match lake.read(part).await {
                Ok(read) if read.checks != file.between(part.range.first, part.range.last) => {
                    let why = format!("its checks have other content than in {whole}");
                    done.left.push((part.clone(), why));
                    continue;
                }
                // A damaged one is not needed any more.
                Ok(_) | Err(LakeError::File { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            lake.remove(part).await?;
            done.removed += 1;
        }
    }
    Ok(())
}

/// Files of one folder and one fixed range that follow one another, two or more.
fn runs(current: Vec<FileName>, before: Date) -> Vec<Vec<FileName>> {
    let mut runs: Vec<Vec<FileName>> = Vec::new();
    for name in current.into_iter().filter(|name| is_before(name, before)) {
        let block = |number: i64| (number - 1) / JOINED_CHECKS;
        let follows = |last: &FileName| {
            let (last, this) = (&last.range, &name.range);
            (&last.stream, &last.station, &last.date) == (&this.stream, &this.station, &this.date)
                && last.last + 1 == this.first
                && block(last.first) == block(this.last)
        };
        match runs.last_mut() {
            Some(run) if run.last().is_some_and(follows) => run.push(name),
            _ => runs.push(vec![name]),
        }
    }
    runs.retain(|run| run.len() > 1);
    runs
}

async fn join(lake: &Lake, run: &[FileName], done: &mut Compacted) -> Result<(), CompactError> {
    let mut whole: Option<LakeFile> = None;
    for name in run {
        let part = match lake.read(name).await {
            Ok(part) => part,
            Err(LakeError::File { source, .. }) => {
                done.left.push((name.clone(), source.to_string()));
                return Ok(());
            }
            Err(error) => return Err(error.into()),
        };
        whole = Some(match whole {
            None => part,
            Some(whole) if whole.station_key != part.station_key => {
                let why = format!(
                    "station {} wrote it, the file before it station {}",
                    part.station_key, whole.station_key
                );
                done.left.push((name.clone(), why));
                return Ok(());
            }
            Some(whole) => joined(whole, part),
        });
    }
    if let Some(whole) = whole {
        lake.put(&whole.name().to_string(), whole.encode()?).await?;
        done.joined += run.len() as u64;
        done.into += 1;
    }
    Ok(())
}

fn joined(mut whole: LakeFile, part: LakeFile) -> LakeFile {
    whole.parts.extend(part.parts);
    whole.checks.extend(part.checks);
    let range = Range {
        last: part.range.last,
        ..whole.range
    };
    LakeFile { range, ..whole }
}

/// Removes what killed processes had begun to write into a folder: `NAME#1` and the like, which no listing shows. What cannot be
/// removed is left to the next run.
fn remove_unfinished(lake: &Path, folder: &Path, grace: Duration) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let Ok(meta) = entry.metadata() else {
            continue;
        };
        let path = entry.path();
        let below = path.strip_prefix(lake).ok().and_then(Path::to_str);
        let number = below.and_then(|below| below.rsplit_once('#'));
        let unfinished = number.is_some_and(|(name, number)| {
            let is_of_lake = FileName::parse(name).is_some()
                || SumsName::parse(name).is_some()
                || Retired::parse(name).is_some();
            is_of_lake && number.parse::<u32>().is_ok()
        });
        let age = meta
            .modified()
            .ok()
            .and_then(|at| SystemTime::now().duration_since(at).ok());
        if meta.is_dir() {
            remove_unfinished(lake, &path, grace);
        } else if unfinished && age.is_some_and(|age| age >= grace) {
            let _ = std::fs::remove_file(path);
        }
    }
}
