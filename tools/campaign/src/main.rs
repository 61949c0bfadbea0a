//! Mutants of every file that the instrument reads: refused by name or read right, never a crash, a hang or a go.
//!
//! ```text
//! cargo xtask campaign                    100 000 mutants
//! cargo xtask campaign --seconds 60       as many as a minute allows, as CI does
//! cargo xtask campaign --seed 7           others
//! cargo xtask campaign --kills 1000       kills of a check instead, in each of its phases (see [`kills`])
//! ```
//! Readers run in this process, where a panic is caught, memory is bounded and a mutant that takes five minutes ends the campaign
//! with its file's name. One mutant in 500 is an image of a recorded check of a worn die, judged by the program itself: whatever
//! it says, it is not go.

mod kills;
mod mutate;
mod originals;
mod readers;
mod seeds;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Parser;
use rand::RngExt;
use rand_pcg::Pcg64;
use rustix::process::{Resource, Rlimit, setrlimit};

use crate::mutate::{Structure, mutate};
use crate::originals::{FILES, Originals};
use crate::readers::{Outcome, Readers};

/// One mutant in so many is an image that the program judges.
const JUDGED: u64 = 500;
/// A calibration from captures takes three seconds, and on a busy machine half a minute; everything else is faster.
const LONGEST: Duration = Duration::from_secs(300);
/// A reader that wants more than the files' sizes allow fails here, instead of taking the machine with it.
const MOST_MEMORY: u64 = 8 << 30;

/// Mutation campaign over every file that the instrument reads.
#[derive(Parser)]
struct Args {
    /// The program to be attacked.
    #[arg(long)]
    program: PathBuf,
    /// How many mutants.
    #[arg(long, default_value_t = 100_000)]
    mutants: u64,
    /// End after so many seconds, however many that were.
    #[arg(long)]
    seconds: Option<u64>,
    /// Kill so many checks instead, in each of their phases.
    #[arg(long, conflicts_with_all = ["mutants", "seconds"])]
    kills: Option<u64>,
    /// Of the mutants and kills.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where mutants that showed something are kept.
    #[arg(long, default_value = "target/campaign")]
    keep: PathBuf,
}

/// What is known of the mutants of one file.
#[derive(Clone, Copy, Default)]
struct Count {
    mutants: u64,
    refused: u64,
    /// Refused by what a command does with the file after reading it.
    later: u64,
    slowest_us: u128,
}

struct Campaign<'a> {
    args: &'a Args,
    originals: &'a Originals,
    contents: BTreeMap<&'static str, Vec<u8>>,
    next: AtomicU64,
    started: Instant,
    counts: Mutex<BTreeMap<&'static str, Count>>,
    findings: Mutex<Vec<String>>,
}

fn main() -> anyhow::Result<()> {
    let args = Args::parse();
    let most = Rlimit {
        current: Some(MOST_MEMORY),
        maximum: Some(MOST_MEMORY),
    };
    setrlimit(Resource::As, most)?;
    let program = args
        .program
        .canonicalize()
        .with_context(|| args.program.display().to_string())?;
    let folder = tempfile::Builder::new()
        .prefix("flankscope-campaign-")
        .tempdir()?;
    if let Some(kills) = args.kills {
        return kills::run(&program, kills, args.seed, folder.path());
    }
    let originals = Originals::make(&program, folder.path())?;
    let read = |&(name, ..): &(&'static str, Structure, u32)| {
        anyhow::Ok((
            name,
            std::fs::read(originals.folder.join(name)).with_context(|| name.to_owned())?,
        ))
    };
    let campaign = Campaign {
        contents: FILES.iter().map(read).collect::<anyhow::Result<_>>()?,
        args: &args,
        originals: &originals,
        next: AtomicU64::new(0),
        started: Instant::now(),
        counts: Mutex::default(),
        findings: Mutex::default(),
    };
    // A panic is a finding, told with its mutant, not a page of text.
    std::panic::set_hook(Box::new(|_| {}));
    campaign.run(folder.path())?;
    campaign.report()
}

impl Campaign<'_> {
    fn run(&self, folder: &Path) -> anyhow::Result<()> {
        let workers = std::thread::available_parallelism().map_or(1, usize::from);
        let since: Vec<AtomicU64> = (0..workers).map(|_| AtomicU64::new(0)).collect();
        let busy: Vec<Mutex<(u64, &'static str)>> =
            (0..workers).map(|_| Mutex::default()).collect();
        // The originals themselves are read, or nothing is tested.
        let own = Readers::new(self.originals, &folder.join("originals"))?;
        for (name, content) in &self.contents {
            let outcome = own
                .read(name, content)
                .with_context(|| (*name).to_owned())?;
            anyhow::ensure!(
                outcome == Outcome::Accepted,
                "the original {name}: {outcome:?}"
            );
        }
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..workers)
                .map(|n| {
                    let (since, busy) = (&since[n], &busy[n]);
                    let own = folder.join(n.to_string());
                    scope.spawn(move || self.work(&own, since, busy))
                })
                .collect();
            while !threads
                .iter()
                .all(std::thread::ScopedJoinHandle::is_finished)
            {
                std::thread::sleep(Duration::from_millis(200));
                let now = self.started.elapsed().as_millis() as u64;
                for (since, busy) in since.iter().zip(&busy) {
                    let began = since.load(Ordering::Relaxed);
                    if began != 0 && now.saturating_sub(began) > LONGEST.as_millis() as u64 {
                        let (number, name) = *locked(busy);
                        eprintln!(
                            "no end after {} s: mutant {number}, {name}",
                            LONGEST.as_secs()
                        );
                        std::process::exit(1);
                    }
                }
            }
            threads
                .into_iter()
                .try_for_each(|thread| match thread.join() {
                    Ok(result) => result,
                    Err(_) => bail!("a worker ended in a panic"),
                })
        })
    }

    fn work(
        &self,
        folder: &Path,
        since: &AtomicU64,
        busy: &Mutex<(u64, &'static str)>,
    ) -> anyhow::Result<()> {
        let readers = Readers::new(self.originals, folder)?;
        let all: u32 = FILES.iter().map(|(.., weight)| weight).sum();
        loop {
            let number = self.next.fetch_add(1, Ordering::Relaxed);
            let over = self
                .args
                .seconds
                .is_some_and(|limit| self.started.elapsed().as_secs() >= limit);
            if over || number >= self.args.mutants && self.args.seconds.is_none() {
                return Ok(());
            }
            // Every mutant has a stream of its own: it is the same however many workers there are.
            let mut random = Pcg64::new(u128::from(self.args.seed), u128::from(number));
            let began = Instant::now();
            since.store(
                self.started.elapsed().as_millis().max(1) as u64,
                Ordering::Relaxed,
            );
            if number % JUDGED == JUDGED - 1 {
                self.judge(folder, &mut random)?;
            } else {
                let mut drawn = random.random_range(0..all);
                let chosen = FILES.iter().find(|(.., weight)| {
                    let here = drawn < *weight;
                    drawn = drawn.saturating_sub(*weight);
                    here
                });
                let &(name, structure, _) = chosen.unwrap_or(&FILES[0]);
                let mutant = mutate(&self.contents[name], structure, &mut random);
                *locked(busy) = (number, name);
                let read = catch_unwind(AssertUnwindSafe(|| readers.read(name, &mutant)));
                let outcome = match read {
                    Ok(Ok(outcome)) => outcome,
                    Ok(Err(error)) => self.find(number, name, &mutant, &format!("{error:#}")),
                    Err(panic) => self.find(number, name, &mutant, &said(&*panic)),
                };
                self.count(name, &outcome, began);
            }
            since.store(0, Ordering::Relaxed);
        }
    }

    /// An image of the worn die is changed, and the program judges it.
    fn judge(&self, folder: &Path, random: &mut Pcg64) -> anyhow::Result<()> {
        let began = Instant::now();
        let frames = folder.join("frames");
        let worn = self.originals.folder.join("worn");
        copy(&worn, &frames)?;
        let images = frames.join("capture-0001");
        let mut names: Vec<PathBuf> = std::fs::read_dir(&images)?
            .flatten()
            .map(|entry| entry.path())
            .collect();
        names.sort();
        let number = random.random_range(0..names.len());
        let content = std::fs::read(&names[number])?;
        let mutant = mutate(&content, Structure::Bytes, random);
        std::fs::write(&names[number], &mutant)?;
        let frames = frames.to_string_lossy();
        let arguments = [
            "inspect", "--frames", &frames, "--tool", "tool", "--quiet", "--json", "-",
        ];
        let status = self.originals.command(&arguments).status()?;
        // No-go, indeterminate, or could not run.
        let outcome = match status.code() {
            Some(1) => Outcome::Accepted,
            Some(2 | 3) => Outcome::Refused(status.to_string()),
            _ => self.find(
                number as u64,
                "judged.pgm",
                &mutant,
                &format!("image {number}: a worn die ended with {status}"),
            ),
        };
        self.count("judged images", &outcome, began);
        Ok(())
    }

    fn count(&self, name: &'static str, outcome: &Outcome, began: Instant) {
        let mut counts = locked(&self.counts);
        let count = counts.entry(name).or_default();
        count.mutants += 1;
        count.refused += u64::from(matches!(outcome, Outcome::Refused(_)));
        count.later += u64::from(matches!(outcome, Outcome::RefusedLater(_)));
        count.slowest_us = count.slowest_us.max(began.elapsed().as_micros());
    }

    /// Keeps the mutant; what is found counts as not refused.
    fn find(&self, number: u64, name: &str, mutant: &[u8], what: &str) -> Outcome {
        let kept = self
            .args
            .keep
            .join(format!("{number}-{}", name.replace('/', "-")));
        // What cannot be kept can be made again from its number.
        let _ =
            std::fs::create_dir_all(&self.args.keep).and_then(|()| std::fs::write(&kept, mutant));
        let what: String = what.chars().take(1000).collect();
        locked(&self.findings).push(format!("mutant {number}, {}: {what}", kept.display()));
        Outcome::Accepted
    }

    fn report(&self) -> anyhow::Result<()> {
        let counts = locked(&self.counts);
        let mut sum = Count::default();
        println!(
            "{:<22} {:>8} {:>8} {:>8} {:>8} {:>12}",
            "file", "mutants", "refused", "later", "taken", "slowest, ms"
        );
        for (name, count) in counts.iter() {
            let Count {
                mutants,
                refused,
                later,
                slowest_us,
            } = *count;
            println!(
                "{name:<22} {mutants:>8} {refused:>8} {later:>8} {:>8} {:>12}",
                mutants - refused - later,
                slowest_us / 1000
            );
            sum.mutants += mutants;
            sum.refused += refused;
            sum.later += later;
        }
        let findings = locked(&self.findings);
        for finding in findings.iter() {
            println!("{finding}");
        }
        println!(
            "{} mutants in {:.0} s, seed {}: {} refused, {} refused after they were read, {} taken, {} findings",
            sum.mutants,
            self.started.elapsed().as_secs_f64(),
            self.args.seed,
            sum.refused,
            sum.later,
            sum.mutants - sum.refused - sum.later,
            findings.len()
        );
        if !findings.is_empty() {
            bail!("{} mutants showed something", findings.len());
        }
        Ok(())
    }
}

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

fn said(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
    format!("panic: {}", text.unwrap_or_default())
}

fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)?.flatten() {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target)?;
        } else {
            std::fs::copy(entry.path(), &target)?;
        }
    }
    Ok(())
}
