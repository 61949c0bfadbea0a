//! The log of all runs: every one is appended, whatever it found, reruns after a change included.
//!
//! Draws that follow from the commit did not exist when its code was written, so no constant can have been chosen with them in sight.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context as _;
use flankscope_foundation::files::write_whole;
use serde::{Deserialize, Serialize};

use super::setup::word;
use super::{Args, Subject};

/// Hexadecimal digits of a commit, and how many of them make a seed.
const COMMIT_DIGITS: usize = 40;
const SEED_DIGITS: usize = 16;

/// What a run counted. Flanks, but of neighbours whole checks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Counts {
    /// At or beyond the stop limit, of these go, of these indeterminate.
    pub beyond: usize,
    pub beyond_go: usize,
    pub beyond_indeterminate: usize,
    /// Below the warning limit, of these go.
    pub sound: usize,
    pub sound_go: usize,
    /// Stated intervals and lower bounds, of these the ones that do not hold the truth.
    pub claims: usize,
    pub claims_missed: usize,
}

/// A line of the log.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Run {
    date: String,
    commit: String,
    seed: u64,
    /// `commit`, or `chosen` by hand.
    seed_from: String,
    subject: String,
    head: String,
    surface: String,
    /// `--only`.
    rows: String,
    blocks: u32,
    captures: u32,
    beyond: usize,
    beyond_go: usize,
    beyond_indeterminate: usize,
    sound: usize,
    sound_go: usize,
    claims: usize,
    claims_missed: usize,
    why: String,
}

impl Run {
    fn new(args: &Args, counts: Counts) -> anyhow::Result<Self> {
        let subject = match args.subject {
            Subject::Verdicts => "verdicts",
            Subject::Resolution => "resolution",
            Subject::Families => "families",
            Subject::Press => "press",
        };
        let head = args.head.as_ref().map(|head| head.given.clone());
        let seed_from = if args.seed.is_some() {
            "chosen"
        } else {
            "commit"
        };
        Ok(Self {
            date: flankscope_foundation::date::now(),
            commit: args.commit.clone(),
            seed: args.seed()?,
            seed_from: seed_from.into(),
            subject: subject.into(),
            head: head.unwrap_or_else(|| "20mm".into()),
            surface: word(args.surface).into(),
            rows: args.only.clone().unwrap_or_default(),
            blocks: args.blocks,
            captures: args.captures,
            beyond: counts.beyond,
            beyond_go: counts.beyond_go,
            beyond_indeterminate: counts.beyond_indeterminate,
            sound: counts.sound,
            sound_go: counts.sound_go,
            claims: counts.claims,
            claims_missed: counts.claims_missed,
            why: args.why.clone().unwrap_or_default(),
        })
    }

    /// Whether it asked the same of the same sort of dies, by a head of the same kind.
    fn is_like(&self, other: &Self) -> bool {
        [&self.subject, &self.head, &self.surface] == [&other.subject, &other.head, &other.surface]
    }
}

/// The seed that follows from a commit: the first 16 digits of its hash.
pub(super) fn seed_of(commit: &str) -> anyhow::Result<u64> {
    let digits = commit
        .get(..SEED_DIGITS)
        .filter(|_| commit.len() == COMMIT_DIGITS && commit.bytes().all(|b| b.is_ascii_hexdigit()));
    let digits = digits.with_context(|| {
        format!("the seed follows from the commit, of which {COMMIT_DIGITS} hexadecimal digits are needed, not \"{commit}\"; or choose one by --seed")
    })?;
    Ok(u64::from_str_radix(digits, 16)?)
}

/// Appends a run to the log of `args`, if it has one; returns what a page says of where its draws come from, and of the runs before.
pub(super) fn append(args: &Args, counts: Counts) -> anyhow::Result<String> {
    let run = Run::new(args, counts)?;
    let mut runs = match &args.log {
        Some(path) => read(path)?,
        None => Vec::new(),
    };
    runs.push(run);
    if let Some(path) = &args.log {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for run in &runs {
            writer.serialize(run)?;
        }
        write_whole(path, &writer.into_inner()?)?;
    }
    Ok(told(&runs)?)
}

fn read(path: &Path) -> anyhow::Result<Vec<Run>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let named = || format!("the log {}", path.display());
    let mut reader = csv::Reader::from_path(path).with_context(named)?;
    let runs: Result<Vec<Run>, csv::Error> = reader.deserialize().collect();
    runs.with_context(named)
}

/// What the newest of the runs drew from, and a table of all that are like it.
fn told(runs: &[Run]) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    let Some(newest) = runs.last() else {
        return Ok(text);
    };
    match newest.seed_from.as_str() {
        "commit" => writeln!(
            text,
            "The seed {} is the first {SEED_DIGITS} digits of the commit's hash: these draws did not exist when its code was \
             written.\n",
            newest.seed
        )?,
        _ => writeln!(text, "The seed {} was chosen by hand.\n", newest.seed)?,
    }
    text.push_str(
        "All runs like it, the newest first (`log.csv` has every run):\n\n\
         | day | commit | seed | rows | blocks × captures | at or beyond the limit: go, indeterminate | below the warning limit: go | \
         claims that do not hold | why it was run |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for run in runs.iter().rev().filter(|run| run.is_like(newest)) {
        writeln!(
            text,
            "| {} | {} | {} ({}) | {} | {} × {} | {}, {} of {} | {} of {} | {} of {} | {} |",
            run.date.get(..10).unwrap_or(&run.date),
            run.commit.get(..8).unwrap_or(&run.commit),
            run.seed,
            run.seed_from,
            if run.rows.is_empty() {
                "all"
            } else {
                &run.rows
            },
            run.blocks,
            run.captures,
            run.beyond_go,
            run.beyond_indeterminate,
            run.beyond,
            run.sound_go,
            run.sound,
            run.claims_missed,
            run.claims,
            run.why.replace('|', "/"),
        )?;
    }
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    const COMMIT: &str = "f60becbf00000000000000000000000000000001";

    fn args(more: &[&str]) -> Args {
        let fixed = ["study", "families", "--out", "unused"];
        Line::parse_from(fixed.iter().chain(more)).args
    }

    #[test]
    fn the_seed_follows_from_the_commit_unless_it_is_chosen() {
        assert_eq!(
            args(&["--commit", COMMIT]).seed().unwrap(),
            0xf60b_ecbf_0000_0000
        );
        assert_eq!(
            args(&["--commit", COMMIT, "--seed", "7"]).seed().unwrap(),
            7
        );
        let dirty = format!("{COMMIT} with changes");
        for not_one in [
            "unknown",
            "f60becbf",
            dirty.as_str(),
            "éééééééééééééééééééé",
        ] {
            let error = args(&["--commit", not_one]).seed().unwrap_err();
            assert!(error.to_string().contains(not_one), "{error}");
        }
    }

    #[test]
    fn every_run_stays_in_the_log_and_a_page_shows_those_like_it() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log.csv");
        let log = log.to_str().unwrap();
        let run = |more: &[&str], beyond_go| {
            let logged = ["--commit", COMMIT, "--log", log];
            let args = args(&[&logged[..], more].concat());
            let counts = Counts {
                beyond: 91,
                beyond_go,
                ..Counts::default()
            };
            append(&args, counts).unwrap()
        };
        run(&["--why", "first, \"as it was\"", "--seed", "2"], 3);
        run(&["--why", "bare", "--surface", "ground"], 4);
        let page = run(&["--why", "after the change"], 1);
        assert!(page.contains("did not exist when its code was written"));
        let rows: Vec<&str> = page.lines().filter(|line| line.contains("of 91")).collect();
        let [newest, first] = rows[..] else {
            panic!("two runs are alike: {page}")
        };
        assert!(newest.contains("| 1, 0 of 91 |") && newest.contains("after the change"));
        assert!(first.contains("| 3, 0 of 91 |") && first.contains("2 (chosen)"));
        assert!(first.contains("first, \"as it was\""));
        assert_eq!(read(Path::new(log)).unwrap().len(), 3);
        // A log that somebody broke is no empty log.
        std::fs::write(log, "date,commit\nx,y\n").unwrap();
        let args = args(&["--commit", COMMIT, "--log", log, "--why", "-"]);
        assert!(append(&args, Counts::default()).is_err());
    }

    #[test]
    fn a_log_wants_to_know_why() {
        let fixed = ["study", "--out", "unused", "--log", "log.csv"];
        assert!(Line::try_parse_from(fixed).is_err());
    }
}
