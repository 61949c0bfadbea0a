//! A process that stores checks is killed again and again, four hundred times where everything runs, and runs out of disk at every
//! place: no verdict that it gave is lost, none that it could not store was a go.
//!
//! The test starts itself as the process that is killed, so it has no harness. What a power cut loses cannot be tried
//! here: it rests on SQLite's journal and `synchronous = FULL`.

mod inspections;

use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use flankscope_metrology::verdict::Word;
use flankscope_record::history::{History, HistoryWriter, Retention};
use flankscope_record::sink::ResultSink;
use flankscope_test_requisites::everything;
use inspections::inspection;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const KILLS_PER_FILE: usize = 40;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, mode, path, checks] = &arguments[..]
        && mode == "store"
    {
        return store(Path::new(path), checks.parse().unwrap());
    }
    let folder = tempfile::tempdir().unwrap();
    kills_lose_no_verdict(folder.path(), if everything() { 10 } else { 3 });
    a_full_disk_never_gives_go(folder.path());
}

/// Stores checks and says of each, once it counts, its number, verdict and reason.
fn store(path: &Path, checks: u32) {
    let history = match History::open(path, &inspections::seals()) {
        Ok(history) => history,
        Err(error) => return println!("none could-not-run {error}"),
    };
    let mut writer = HistoryWriter::new(
        history,
        None,
        Retention {
            checks: u32::MAX,
            bytes: u64::MAX,
        },
        "tester".into(),
    );
    let process = std::process::id();
    for number in 0..checks {
        let mut check = inspection(number, Word::Go, &format!("{number} of {process}"));
        writer.put(&mut check).unwrap();
        let id = check.id.map_or_else(|| "none".into(), |id| id.to_string());
        println!("{id} {} {}", check.verdict, check.reason);
        std::io::stdout().flush().unwrap();
    }
}

/// What a storing process said; a line that it did not finish was not said.
struct Said {
    id: Option<i64>,
    verdict: Word,
    reason: String,
}

fn said(text: &str) -> Vec<Said> {
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let said = |line: &str| {
        let mut words = line.splitn(3, ' ');
        Said {
            id: words.next().and_then(|id| id.parse().ok()),
            verdict: words.next().unwrap().parse().unwrap_or(Word::Indeterminate),
            reason: words.next().unwrap().into(),
        }
    };
    whole.lines().map(said).collect()
}

/// Every go that was given is in the file, once and whole.
fn assert_kept(path: &Path, given: &[Said]) {
    let connection = rusqlite::Connection::open(path).unwrap();
    let whole: String = connection
        .query_row("PRAGMA integrity_check", [], |row| row.get(0))
        .unwrap();
    assert_eq!(whole, "ok");
    let history = History::read(path, &inspections::seals()).unwrap();
    let checks = history.checks("die").unwrap();
    assert!(
        checks.iter().all(|check| check.flanks.len() == 6),
        "none is stored in part"
    );
    let mut seen = std::collections::BTreeSet::new();
    for said in given {
        let id = said.id.expect("a go that was given has a number");
        assert!(seen.insert(id), "check {id} was given twice");
        let check = checks.iter().find(|check| check.id == id);
        let check = check.unwrap_or_else(|| panic!("check {id} was given and is lost"));
        assert_eq!(
            (&check.verdict, &check.reason),
            (&said.verdict, &said.reason)
        );
        let phasors = &inspection(check.press_cycles as u32, Word::Go, "").phasors[0];
        let found = history
            .phasors(&phasors.blake3, phasors.bytes.len())
            .unwrap();
        assert_eq!(found.bytes, phasors.bytes, "of check {id}");
    }
}

fn kills_lose_no_verdict(folder: &Path, files: usize) {
    let mut random = Pcg64::seed_from_u64(6);
    let program = std::env::current_exe().unwrap();
    let (mut awaited, mut verdicts, mut stored) = (0, 0, 0);
    for file in 0..files {
        let path = folder.join(format!("press-{file}.db"));
        let mut given = Vec::new();
        for _ in 0..KILLS_PER_FILE {
            let mut child: Child = Command::new(&program)
                .arg("store")
                .arg(&path)
                .arg("1000000")
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            // After so many verdicts, and a moment; with none, anywhere while the file is opened.
            let mut output = BufReader::new(child.stdout.take().unwrap());
            let mut text = String::new();
            let first = random.random_range(0..4);
            for _ in 0..first {
                output.read_line(&mut text).unwrap();
            }
            awaited += first;
            std::thread::sleep(Duration::from_micros(random.random_range(0..10_000)));
            child.kill().unwrap();
            child.wait().unwrap();
            output.read_to_string(&mut text).unwrap();
            given.extend(said(&text));
        }
        assert!(given.iter().all(|said| said.verdict == Word::Go));
        if path.exists() {
            // Killed while the file was made, it is empty or not there; it can always be opened.
            drop(History::open(&path, &inspections::seals()).unwrap());
            assert_kept(&path, &given);
            stored += History::read(&path, &inspections::seals())
                .unwrap()
                .checks("die")
                .unwrap()
                .len();
        }
        verdicts += given.len();
    }
    assert!(
        verdicts >= awaited,
        "{verdicts} of {awaited} verdicts were given"
    );
    // Of each kill at most one check is stored that nobody heard of.
    assert!(stored - verdicts <= files * KILLS_PER_FILE);
    println!(
        "{} kills: {verdicts} verdicts given ({awaited} of them waited for), all there",
        files * KILLS_PER_FILE
    );
}

/// No file may grow beyond a limit, from one that does not let the tables be made to one that holds a few dozen checks:
/// writes fail as on a full disk, at every step of storing.
fn a_full_disk_never_gives_go(folder: &Path) {
    let program = std::env::current_exe().unwrap();
    let (mut given, mut refused) = (0, 0);
    for blocks in (0..800).step_by(10) {
        let path = folder.join(format!("full-{blocks}.db"));
        // Without the trap the system would end the process instead of failing the write.
        let output = Command::new("sh")
            .args(["-c", "trap '' XFSZ; ulimit -f $1; shift; exec \"$@\"", "sh"])
            .arg(blocks.to_string())
            .arg(&program)
            .arg("store")
            .arg(&path)
            .arg("60")
            .stderr(Stdio::inherit())
            .output()
            .unwrap();
        assert!(output.status.success());
        let mut lines = Vec::new();
        for line in BufReader::new(&output.stdout[..]).lines() {
            lines.push(line.unwrap() + "\n");
        }
        let (go, other): (Vec<Said>, Vec<Said>) = said(&lines.concat())
            .into_iter()
            .partition(|said| said.verdict == Word::Go);
        assert!(
            other.iter().all(|said| said.id.is_none()),
            "what is stored is not taken back"
        );
        if !go.is_empty() {
            assert_kept(&path, &go);
        }
        given += go.len();
        refused += other.len();
    }
    assert!(
        given > 100 && refused > 100,
        "{given} given, {refused} refused: both must happen"
    );
    println!("disks full at 80 places: {given} verdicts given, all there; {refused} refused");
}
