//! Kills of a check at a random moment of each of its phases, as its own words tell them: the history opens and is whole, no file
//! that it wrote is half written, the next start sweeps what was left, and no verdict was given that is not stored and earned.

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{bail, ensure};
use flankscope_record::history::History;
use flankscope_record::seal::Seals;
use rand::RngExt;
use rand_pcg::Pcg64;
use serde_json::Value;

use crate::locked;

/// A phase, the words that begin it, and how often they were said by then.
const PHASES: [(&str, &str, usize); 12] = [
    ("start", "", 0),
    ("link", "head     ", 1),
    ("arming", "controller answered", 1),
    ("to view 1", "(view 1 of 2)", 1),
    ("frames 1", "LED on", 1),
    ("to view 2", "(view 2 of 2)", 1),
    ("frames 2", "LED on", 2),
    ("retracting", "head retracts", 1),
    ("evaluation", "evaluated", 1),
    ("storing", "evaluated", 2),
    ("report", "stored as check", 1),
    ("end", "report: ", 1),
];
/// From this phase on, an earlier run's litter is swept.
const SWEPT: usize = 2;
/// No check takes so long on a busy machine.
const LONGEST: Duration = Duration::from_secs(120);

/// What became of the kills in one phase.
#[derive(Clone, Copy, Default)]
struct Tally {
    kills: u64,
    /// The check had ended by itself.
    late: u64,
    /// The check was in the history afterwards.
    stored: u64,
    /// A verdict had been shown.
    shown: u64,
}

impl Tally {
    fn add(&mut self, other: Self) {
        self.kills += other.kills;
        self.late += other.late;
        self.stored += other.stored;
        self.shown += other.shown;
    }

    fn print(self, name: &str) {
        let Self {
            kills,
            late,
            stored,
            shown,
        } = self;
        println!("{name:<12} {kills:>6} {late:>6} {stored:>6} {shown:>6}");
    }
}

/// Kills `kills` checks, half of them of a worn die, by as many stations at a time as there are processors.
pub fn run(program: &Path, kills: u64, seed: u64, folder: &Path) -> anyhow::Result<()> {
    let next = AtomicU64::new(0);
    let tallies = Mutex::new([Tally::default(); PHASES.len()]);
    let findings = Mutex::new(Vec::new());
    let began = Instant::now();
    let work = &|folder: PathBuf| {
        let mut station = Station::new(program, &folder)?;
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= kills {
                return station.last_one();
            }
            let mut random = Pcg64::new(u128::from(seed), u128::from(number));
            let phase = (number % PHASES.len() as u64) as usize;
            let worn = random.random_bool(0.5);
            match station.kill(phase, worn, random.random_range(0.0..1.0)) {
                Ok(tally) => locked(&tallies)[phase].add(tally),
                Err(error) => {
                    let name = PHASES[phase].0;
                    locked(&findings).push(format!("kill {number}, {name}: {error:#}"));
                }
            }
        }
    };
    std::thread::scope(|scope| {
        let workers = std::thread::available_parallelism().map_or(1, usize::from);
        let threads: Vec<_> = (0..workers)
            .map(|n| scope.spawn(move || work(folder.join(n.to_string()))))
            .collect();
        for thread in threads {
            match thread.join() {
                Ok(Ok(())) => {}
                Ok(Err(error)) => locked(&findings).push(format!("{error:#}")),
                Err(_) => locked(&findings).push("a worker ended in a panic".to_owned()),
            }
        }
    });
    println!(
        "{:<12} {:>6} {:>6} {:>6} {:>6}",
        "phase", "kills", "late", "stored", "shown"
    );
    let mut sum = Tally::default();
    for ((name, ..), tally) in PHASES.iter().zip(*locked(&tallies)) {
        tally.print(name);
        sum.add(tally);
    }
    sum.print("all");
    let findings = locked(&findings);
    for finding in findings.iter() {
        println!("{finding}");
    }
    println!(
        "{} kills in {:.0} s, seed {seed}: {} findings",
        sum.kills,
        began.elapsed().as_secs_f64(),
        findings.len()
    );
    ensure!(
        findings.is_empty(),
        "{} kills showed something",
        findings.len()
    );
    Ok(())
}

/// A check that runs, and what it says.
struct Check {
    child: Child,
    said: mpsc::Receiver<String>,
    heard: Vec<String>,
}

impl Check {
    fn says(&self, word: &str) -> bool {
        self.heard.iter().any(|line| line.contains(word))
    }

    /// Takes what it says until `word` was said so often in all; false if it ended before.
    fn hear(&mut self, word: &str, times: usize) -> anyhow::Result<bool> {
        let end = Instant::now() + LONGEST;
        while self.heard.iter().filter(|line| line.contains(word)).count() < times {
            if !self.hear_line(end)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Takes all that it says until it ends.
    fn hear_out(&mut self) -> anyhow::Result<()> {
        let end = Instant::now() + LONGEST;
        while self.hear_line(end)? {}
        Ok(())
    }

    /// Takes its next line; false if it ended.
    fn hear_line(&mut self, end: Instant) -> anyhow::Result<bool> {
        match self
            .said
            .recv_timeout(end.saturating_duration_since(Instant::now()))
        {
            Ok(line) => self.heard.push(line),
            Err(RecvTimeoutError::Disconnected) => return Ok(false),
            Err(RecvTimeoutError::Timeout) => bail!("no end: {:?}", self.heard),
        }
        Ok(true)
    }

    fn reach(&mut self, phase: usize) -> anyhow::Result<()> {
        let (name, word, times) = PHASES[phase];
        ensure!(
            self.hear(word, times)?,
            "{name} was never reached: {:?}",
            self.heard
        );
        Ok(())
    }
}

/// A station of its own, with two dies that have a history each.
struct Station<'a> {
    program: &'a Path,
    folder: PathBuf,
    /// Sockets lie below it, whose names must be short.
    runtime: tempfile::TempDir,
    seals: Seals,
    /// How long each phase takes.
    lasts: [Duration; PHASES.len()],
    /// What each history told last.
    told: [Vec<String>; 2],
    /// Names of what the latest kill left in the runtime folder.
    left: BTreeSet<String>,
}

impl<'a> Station<'a> {
    fn new(program: &'a Path, folder: &Path) -> anyhow::Result<Self> {
        std::fs::create_dir_all(folder.join("out"))?;
        let mut station = Self {
            program,
            folder: folder.to_owned(),
            runtime: tempfile::Builder::new().prefix("k").tempdir_in("/tmp")?,
            seals: Seals::open(&folder.join("state"))?,
            lasts: [Duration::ZERO; PHASES.len()],
            told: [const { Vec::new() }; 2],
            left: BTreeSet::new(),
        };
        // Uninterrupted checks tell how long each phase takes.
        for worn in [false, true] {
            let mut check = station.start(worn)?;
            let mut begun = Instant::now();
            for phase in 1..PHASES.len() {
                check.reach(phase)?;
                station.lasts[phase - 1] = begun.elapsed();
                begun = Instant::now();
            }
            let code = check.child.wait()?.code();
            station.lasts[PHASES.len() - 1] = begun.elapsed();
            ensure!(code == Some(i32::from(worn)), "{code:?}: {:?}", check.heard);
            ensure!(station.judge(worn, &check)? == 1, "it is stored");
        }
        Ok(station)
    }

    fn history(&self, worn: bool) -> PathBuf {
        self.folder.join(if worn { "worn.db" } else { "new.db" })
    }

    fn start(&self, worn: bool) -> anyhow::Result<Check> {
        let (reader, writer) = std::io::pipe()?;
        let mut command = Command::new(self.program);
        command
            .args([
                "inspect", "--link", "sim", "--teeth", "12,40", "--speed", "max",
            ])
            .args(["--json", "out/check.json", "--report", "out", "--history"])
            .arg(self.history(worn))
            .current_dir(&self.folder)
            .env("XDG_RUNTIME_DIR", self.runtime.path())
            .env("FLANKSCOPE_STATE", self.folder.join("state"))
            .stdin(Stdio::null())
            .stdout(writer.try_clone()?)
            .stderr(writer);
        if worn {
            command.args(["--wear", "40:left:80"]);
        }
        let child = command.spawn()?;
        drop(command);
        let (sender, said) = mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(reader).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Check {
            child,
            said,
            heard: Vec::new(),
        })
    }

    /// Kills a check a `part` of the phase's time after it began, and looks at what is there then.
    fn kill(&mut self, phase: usize, worn: bool, part: f64) -> anyhow::Result<Tally> {
        let mut check = self.start(worn)?;
        check.reach(phase)?;
        std::thread::sleep(self.lasts[phase].mul_f64(part));
        let late = check.child.try_wait()?;
        check.child.kill()?;
        let status = check.child.wait()?;
        // What it said before it died.
        check.hear_out()?;
        if let Some(ended) = late {
            ensure!(
                ended.code() == Some(i32::from(worn)),
                "{status}: {:?}",
                check.heard
            );
        }
        let stored = self.judge(worn, &check)?;
        let names = names(&self.runtime.path().join("flankscope"), "flankscope_");
        if phase >= SWEPT {
            let kept: Vec<_> = self.left.intersection(&names).collect();
            ensure!(kept.is_empty(), "an earlier run's {kept:?} are still there");
        }
        self.left = names;
        Ok(Tally {
            kills: 1,
            late: u64::from(late.is_some()),
            stored,
            shown: u64::from(check.says("GO: ")),
        })
    }

    /// Compares the history and every file with what may be there; how many checks were stored since the last look.
    fn judge(&mut self, worn: bool, check: &Check) -> anyhow::Result<u64> {
        let heard = &check.heard;
        let path = self.history(worn);
        let told = &mut self.told[usize::from(worn)];
        let mut now = Vec::new();
        if path.exists() {
            let history = History::read(&path, &self.seals)?;
            history.verify()?;
            for id in history.ids()? {
                let document: Value = serde_json::from_str(&history.document(id)?)?;
                let verdict = &document["verdict"];
                // Nothing interrupted these checks but a death, which stores nothing.
                let earned = if worn { "no-go" } else { "go" };
                ensure!(
                    verdict == earned,
                    "check {id} is stored as {verdict}: {heard:?}"
                );
                now.push(format!("{:?}", history.check(id)?));
            }
        }
        ensure!(
            now.starts_with(told),
            "the history told {told:?}, and tells {now:?}"
        );
        let stored = (now.len() - told.len()) as u64;
        ensure!(stored <= 1, "{stored} checks are stored of one");
        *told = now;
        let go = heard.iter().any(|line| line.starts_with("GO: "));
        ensure!(!(go && worn), "a worn die is go: {heard:?}");
        ensure!(
            stored == 1 || !check.says("GO: "),
            "a verdict is shown that is not stored: {heard:?}"
        );
        let out = self.folder.join("out");
        let pages = std::fs::read_dir(out.join("reports")).into_iter().flatten();
        for file in std::fs::read_dir(&out)?.chain(pages).flatten() {
            let path = file.path();
            let name = file.file_name().to_string_lossy().into_owned();
            let whole = match path.extension().and_then(|extension| extension.to_str()) {
                Some("json") => serde_json::from_slice::<Value>(&std::fs::read(&path)?).is_ok(),
                Some("html") => std::fs::read_to_string(&path)?
                    .trim_end()
                    .ends_with("</html>"),
                Some("csv") => std::fs::read_to_string(&path)?.ends_with('\n'),
                _ => true,
            };
            ensure!(whole, "{name} is half written");
        }
        Ok(stored)
    }

    /// A check that is not killed is what it was at first, and leaves nothing of all those before it.
    fn last_one(&mut self) -> anyhow::Result<()> {
        for worn in [false, true] {
            let mut check = self.start(worn)?;
            check.hear_out()?;
            let code = check.child.wait()?.code();
            ensure!(code == Some(i32::from(worn)), "{code:?}: {:?}", check.heard);
            ensure!(self.judge(worn, &check)? == 1, "it is stored");
        }
        let mut left = names(&self.runtime.path().join("flankscope"), "flankscope_");
        for folder in [
            ".",
            "out",
            "out/reports",
            "new.db.phasors",
            "worn.db.phasors",
            "state",
        ] {
            left.extend(names(&self.folder.join(folder), ".tmp"));
        }
        ensure!(left.is_empty(), "left behind: {left:?}");
        Ok(())
    }
}

/// Names in a folder that begin with a word.
fn names(folder: &Path, with: &str) -> BTreeSet<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.starts_with(with)).collect()
}
