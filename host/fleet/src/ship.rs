//! Copies the checks of a history into the lake.
//!
//! A history is cut at fixed places: behind every check whose number is a multiple of [`PART_CHECKS`], and where the day or the name
//! of the station changes. What lies between two cuts is a part, and a file. So the same checks give the same rows, the same bytes and
//! the same name, whoever ships them and however often; the lake itself says what is shipped, and nothing is remembered here.

use std::ops::RangeInclusive;

use flankscope_record::history::{History, HistoryError, LinkedCheck, Whereabouts};
use flankscope_record::seal::Seals;
use futures_util::StreamExt;

use crate::file::{FileError, LakeFile};
use crate::lake::{Lake, LakeError};
use crate::name::{FileName, Range};
use crate::retired::first_kept;
use crate::rows::{LakeCheck, NoTime, Stream};

/// Most checks of a part: an hour and a half of a check every three minutes.
pub const PART_CHECKS: i64 = 32;
/// Most parts that are on their way at a time; all that is kept in memory.
const IN_FLIGHT: usize = 8;

/// Why nothing more is shipped.
#[derive(Debug, thiserror::Error)]
pub enum ShipError {
    #[error(transparent)]
    History(#[from] HistoryError),
    #[error(transparent)]
    Lake(#[from] LakeError),
    #[error(transparent)]
    Time(#[from] NoTime),
    #[error("the rows cannot be written: {0}")]
    File(#[from] FileError),
    /// Two copies of the history went on apart, and both were shipped.
    #[error(
        "check {check} in the lake ({name}) is not that of this history: the history was copied, and the copy shipped, too; \
         ship the one that the station writes to, and move the other's files out of the lake"
    )]
    Diverged { check: i64, name: Box<FileName> },
    /// The history ends before the lake does.
    #[error(
        "the lake has check {check} ({name}), this history ends with {last}: it is an older copy"
    )]
    Behind {
        check: i64,
        name: Box<FileName>,
        last: i64,
    },
}

/// What a pass shipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shipped {
    pub files: u64,
    pub checks: u64,
    pub bytes: u64,
    /// Files that another shipper had put meanwhile.
    pub there_already: u64,
}

/// Ships one history.
#[derive(Debug)]
pub struct Shipper<'a> {
    history: History,
    seals: &'a Seals,
    lake: &'a Lake,
    stream: Stream,
    /// Checks that the lake holds, in order and apart.
    held: Vec<RangeInclusive<i64>>,
    /// Number and link of the last check that was read.
    last_read: (i64, i64),
    /// The last link that was verified; no check behind it is shipped.
    verified_link: i64,
}

impl<'a> Shipper<'a> {
    /// Looks at what the lake holds of a history, which was opened and with that verified. The newest file is read: its last link
    /// is that of the history, and with it every link before it.
    ///
    /// # Errors
    /// The lake cannot be read, or holds another course of the history.
    pub async fn new(
        history: History,
        seals: &'a Seals,
        lake: &'a Lake,
    ) -> Result<Self, ShipError> {
        let stream = Stream::of(&history)?;
        let mut names = Vec::new();
        for station in history.station_names()? {
            let listing = lake.list(Some(&station)).await?;
            let files = listing.files.into_iter().map(|file| file.name);
            names.extend(files.filter(|name| name.range.stream.history == stream.history));
        }
        let (own, of_other_epochs): (Vec<FileName>, Vec<FileName>) = names
            .into_iter()
            .partition(|name| name.range.stream == stream);
        let retired = lake.retired().await?;
        let mut shipper = Self {
            history,
            seals,
            lake,
            last_read: (0, 0),
            verified_link: 0,
            held: own
                .iter()
                .map(|name| name.range.first..=name.range.last)
                .collect(),
            stream,
        };
        let kept = first_kept(&retired, &shipper.stream);
        let begun = shipper.held_in_other_epochs(of_other_epochs).await?;
        shipper.held.push(1..=(kept - 1).max(begun));
        shipper.held = joined(std::mem::take(&mut shipper.held));
        if let Some(newest) = own.iter().max_by_key(|name| name.range.last) {
            shipper.compare_last(newest).await?;
        }
        Ok(shipper)
    }

    async fn compare_last(&mut self, newest: &FileName) -> Result<(), ShipError> {
        let file = self.lake.read(newest).await?;
        let Some(last) = file.checks.last() else {
            return Ok(());
        };
        let check = last.number();
        let stored = self.history.linked_checks(check..=check, 0)?;
        let name = || Box::new(newest.clone());
        match stored.first() {
            Some(stored) if stored.digest == last.text("chain_digest") => {
                // Links up to here are those that were verified when the history was opened.
                self.last_read = (check, stored.link);
                self.verified_link = stored.link;
                Ok(())
            }
            Some(_) => Err(ShipError::Diverged {
                check,
                name: name(),
            }),
            None => Err(ShipError::Behind {
                check,
                name: name(),
                last: self.history.ids()?.last().copied().unwrap_or(0),
            }),
        }
    }

    /// Number of the last check that was shipped before a person accepted the history as it is. Its links are others since; numbers
    /// and dates are the same up to where a restored copy ends.
    async fn held_in_other_epochs(&self, mut names: Vec<FileName>) -> Result<i64, ShipError> {
        names.sort_by_key(|name| -name.range.last);
        for name in names {
            let file = self.lake.read(&name).await?;
            let most = u32::try_from(name.range.checks()).unwrap_or(u32::MAX);
            let stored = self.history.whereabouts_after(name.range.first - 1, most)?;
            for (shipped, stored) in file.checks.iter().zip(&stored).rev() {
                let at = crate::rows::time_ms(stored.check, &stored.at)?;
                if shipped.number() == stored.check && shipped.integer("stored_at") == at {
                    return Ok(stored.check);
                }
            }
        }
        Ok(0)
    }

    /// Ships every closed part that the lake lacks, oldest first. A part is closed by its last number, by a check of another day or
    /// station behind it, or once its day is over (`today`: YYYY-MM-DD, UTC).
    ///
    /// # Errors
    /// The history cannot be read or is not believed, or the lake refuses a file. What was shipped is kept.
    pub async fn pass(&mut self, today: &str) -> Result<Shipped, ShipError> {
        let lake = self.lake;
        let mut behind = 0;
        let parts = std::iter::from_fn(|| {
            let range = match self.next_part(behind, today) {
                Ok(None) => return None,
                Ok(Some(range)) => range,
                Err(error) => return Some(Err(error.into())),
            };
            behind = range.last;
            Some(self.part(range))
        });
        let (shipped, put) = put_all(lake, parts).await?;
        self.held.extend(put);
        self.held = joined(std::mem::take(&mut self.held));
        Ok(shipped)
    }

    fn is_held(&self, check: i64) -> bool {
        self.held.iter().any(|range| range.contains(&check))
    }

    /// The first closed part behind a check of which the lake has nothing.
    fn next_part(&self, behind: i64, today: &str) -> Result<Option<Range>, HistoryError> {
        let mut first = behind + 1;
        while let Some(range) = self.held.iter().find(|range| range.contains(&first)) {
            first = range.end() + 1;
        }
        // One more than a part: the check behind it may close it.
        let most = u32::try_from(PART_CHECKS + 1).unwrap_or(u32::MAX);
        let stored = self.history.whereabouts_after(first - 1, most)?;
        let Some(begin) = stored.first().cloned() else {
            return Ok(None);
        };
        let end = last_of_block(begin.check);
        let with_it = |next: &&Whereabouts| {
            next.check <= end
                && (date(&next.at), &next.station) == (date(&begin.at), &begin.station)
                && !self.is_held(next.check)
        };
        let part: Vec<&Whereabouts> = stored.iter().take_while(with_it).collect();
        let last = part.last().map_or(begin.check, |last| last.check);
        let closed = last == end || part.len() < stored.len() || date(&begin.at) < today;
        Ok(closed.then(|| Range {
            stream: self.stream.clone(),
            first: begin.check,
            last,
            date: date(&begin.at).to_owned(),
            station: begin.station,
        }))
    }

    fn part(&mut self, range: Range) -> Result<LakeFile, ShipError> {
        let read = |shipper: &Self| {
            let (check, link) = shipper.last_read;
            let after_link = if check < range.first { link } else { 0 };
            let numbers = range.first..=range.last;
            shipper.history.linked_checks(numbers, after_link)
        };
        let mut linked = read(self)?;
        let last = |linked: &[LinkedCheck]| {
            linked
                .last()
                .map_or((0, 0), |last| (last.check.id, last.link))
        };
        if last(&linked).1 > self.verified_link {
            self.verified_link = self.history.verify_links_after(self.verified_link)?;
            linked = read(self)?;
        }
        self.last_read = last(&linked);
        let checks = linked
            .iter()
            .map(|check| LakeCheck::new(&self.stream, check));
        let checks = checks.collect::<Result<_, _>>()?;
        Ok(LakeFile::sealed(range, checks, self.seals))
    }

    /// Ranges of checks that the lake holds, in order.
    #[must_use]
    pub fn held(&self) -> &[RangeInclusive<i64>] {
        &self.held
    }

    /// Whether the links are still those that were read at the beginning; if not, a person has accepted the history as it is, and
    /// it is opened again.
    ///
    /// # Errors
    /// The history cannot be read.
    pub fn is_same_epoch(&self) -> Result<bool, HistoryError> {
        Ok(Stream::of(&self.history)? == self.stream)
    }
}

/// Puts files into a lake, some at a time, each once it is asked for; the checks that are there then.
///
/// # Errors
/// The first error of a file or of the lake; what was put by then is there.
pub async fn put_all(
    lake: &Lake,
    files: impl Iterator<Item = Result<LakeFile, ShipError>>,
) -> Result<(Shipped, Vec<RangeInclusive<i64>>), ShipError> {
    let put = |file: Result<LakeFile, ShipError>| async move {
        let file = file?;
        let bytes = file.encode()?;
        let size = bytes.len() as u64;
        let new = lake.put(&file.name().to_string(), bytes).await?;
        Ok::<_, ShipError>((file.range, new, size))
    };
    let mut all = futures_util::stream::iter(files.map(put)).buffer_unordered(IN_FLIGHT);
    let (mut shipped, mut there) = (Shipped::default(), Vec::new());
    while let Some(done) = all.next().await {
        let (range, new, bytes) = done?;
        if new {
            shipped.files += 1;
            shipped.checks += range.checks().unsigned_abs();
            shipped.bytes += bytes;
        } else {
            shipped.there_already += 1;
        }
        there.push(range.first..=range.last);
    }
    Ok((shipped, there))
}

/// Number of the last check that may be in a part with this one.
fn last_of_block(check: i64) -> i64 {
    (check + PART_CHECKS - 1) / PART_CHECKS * PART_CHECKS
}

/// Day of a date.
fn date(at: &str) -> &str {
    at.get(..10).unwrap_or(at)
}

/// Sorted, and joined where they touch or overlap.
fn joined(mut ranges: Vec<RangeInclusive<i64>>) -> Vec<RangeInclusive<i64>> {
    ranges.retain(|range| !range.is_empty());
    ranges.sort_by_key(|range| *range.start());
    let mut joined: Vec<RangeInclusive<i64>> = Vec::new();
    for range in ranges {
        match joined.last_mut() {
            Some(last) if *range.start() <= last.end() + 1 => {
                *last = *last.start()..=*last.end().max(range.end());
            }
            _ => joined.push(range),
        }
    }
    joined
}
