//! Random schedules of stopped and killed processes, acknowledgements and stepped clocks: no outlet says go of what is stale,
//! superseded or latched, and no acknowledgement clears a no-go that was not seen.
//!
//! The test starts itself as a press that exposes, evaluates for a while, and stores. Eight schedules, four at a time, or as many as the
//! argument says, 32 at a time: `cargo test -p flankscope-plant --test freezes -- 1000`.

#[allow(dead_code)]
mod press;
#[allow(dead_code)]
mod station;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use flankscope_foundation::clock::BootTime;
use flankscope_foundation::date;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::LastExposure;
use flankscope_test_requisites::{Random, in_lanes};
use flankscope_tests::Killed;
use press::{Press, inspection};
use rustix::process::{Pid, Signal, kill_process, set_parent_process_death_signal};
use station::{Plant, Station};

const STALE_AFTER_MS: u64 = 3_000;
/// Length of a schedule.
const SCHEDULE_MS: u64 = 20_000;
/// Interval between two rounds of questions to all outlets.
const TICK: Duration = Duration::from_millis(200);
/// Time within which a running process has seen what was stored: it looks every second, beside other work.
const SEEN_WITHIN_MS: u64 = 3_000;
/// Resolution of an age in seconds, and the way of an answer.
const ANSWER_MS: u64 = 1_000;
const GO: u16 = 1;
const LATCHED: u16 = 1 << 4;
const TOOLS: [&str; 2] = ["die", "other die"];

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[1..] {
        ["press", folder, state, seed] => {
            check_for_ever(Path::new(folder), Path::new(state), seed.parse().unwrap());
        }
        [count] if count.parse::<usize>().is_ok() => campaign(count.parse().unwrap(), 32),
        _ => campaign(8, 4),
    }
}

fn now_ms() -> u64 {
    BootTime::now().since_boot_ms
}

/// The press: one line of the ledger before a check is stored, one afterwards.
fn check_for_ever(folder: &Path, state: &Path, seed: u64) {
    set_parent_process_death_signal(Some(Signal::KILL)).unwrap();
    let mut random = Random(seed);
    let mut press = Press::of_station(&folder.join("press.db"), state);
    let ledger = folder.join("ledger");
    let note = |line: String| {
        let file = std::fs::File::options()
            .append(true)
            .create(true)
            .open(&ledger);
        file.unwrap().write_all(line.as_bytes()).unwrap();
    };
    loop {
        let mut pause = |most_ms: f64| {
            std::thread::sleep(Duration::from_millis((most_ms * random.uniform()) as u64));
        };
        pause(900.0);
        let mut exposure = LastExposure::before_now(Duration::ZERO);
        let exposed_ms = exposure.boot.since_boot_ms;
        pause(400.0);
        let tool = usize::from(random.uniform() < 0.2);
        let verdict = match random.uniform() {
            u if u < 0.78 => Word::Go,
            u if u < 0.9 => Word::NoGo,
            u if u < 0.95 => Word::Warn,
            _ => Word::Indeterminate,
        };
        let mut check = inspection(TOOLS[tool], 40, verdict, 1);
        // A wall clock that was an hour late at the exposure, or a folder of frames: never a fresh go. The frames latch nothing either.
        let mut counts = 1;
        match random.uniform() {
            u if u < 0.05 => {
                exposure.at = date::before_now(Duration::from_secs(3600));
                counts = 0;
            }
            u if u < 0.1 => {
                check.origin.link = "recorded frames".into();
                counts = 0;
            }
            _ => {}
        }
        let is_recording = u8::from(check.origin.link != "sim");
        check.last_exposure = Some(exposure);
        note(format!(
            "begin {tool} {verdict} {exposed_ms} {counts} {is_recording}\n"
        ));
        let id = press.put(check);
        note(format!("stored {id} {}\n", now_ms()));
    }
}

/// A check as the ledger has it.
#[derive(Debug, Clone)]
struct Noted {
    tool: usize,
    verdict: String,
    exposed_ms: u64,
    /// Whether it may stand at all.
    counts: bool,
    /// Number and time, once it is stored.
    stored: Option<(i64, u64)>,
    is_recording: bool,
}

impl Noted {
    /// Whether it is a no-go that stands until it is acknowledged.
    fn is_press_no_go(&self) -> bool {
        self.verdict == "no-go" && !self.is_recording
    }
}

fn ledger(folder: &Path) -> Vec<Noted> {
    let text = std::fs::read_to_string(folder.join("ledger")).unwrap_or_default();
    let mut checks: Vec<Noted> = Vec::new();
    // A line that is being written has no end yet.
    let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    for line in whole.lines() {
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["begin", tool, verdict, exposed_ms, counts, is_recording] => checks.push(Noted {
                tool: tool.parse().unwrap(),
                verdict: verdict.into(),
                exposed_ms: exposed_ms.parse().unwrap(),
                counts: counts == "1",
                stored: None,
                is_recording: is_recording == "1",
            }),
            ["stored", id, at_ms] => {
                let check = checks.last_mut().unwrap();
                check.stored = Some((id.parse().unwrap(), at_ms.parse().unwrap()));
            }
            _ => panic!("{line}"),
        }
    }
    checks
}

/// An acknowledgement that was sent: of this no-go, when, and whether it was accepted.
#[derive(Debug)]
struct Acknowledged {
    tool: usize,
    check: i64,
    at_ms: u64,
    is_accepted: bool,
}

/// Why an outlet must not say go of a tool between two moments, when the plant's process has run since a third one; none if it may.
fn objection(
    checks: &[Noted],
    acknowledged: &[Acknowledged],
    tool: Option<usize>,
    [asked_ms, answered_ms, plant_runs_since_ms]: [u64; 3],
) -> Option<String> {
    let seen_by_ms = asked_ms.saturating_sub(SEEN_WITHIN_MS);
    let is_known = |check: &Noted| {
        let is_old = |(_, at_ms)| at_ms < seen_by_ms;
        plant_runs_since_ms < seen_by_ms && check.stored.is_some_and(is_old)
    };
    let open = checks
        .iter()
        .filter(|check| check.is_press_no_go() && is_known(check));
    let open = open.filter(|check| tool.is_none_or(|tool| check.tool == tool));
    for check in open {
        let (id, _) = check.stored?;
        let covers = |done: &&Acknowledged| {
            done.tool == check.tool && done.check >= id && done.at_ms < answered_ms
        };
        if acknowledged.iter().find(covers).is_none() {
            return Some(format!("no-go {id} is not acknowledged"));
        }
    }
    let of_tool = |tool: usize| {
        let checks: Vec<&Noted> = checks.iter().filter(|check| check.tool == tool).collect();
        (0..checks.len()).rev().any(|n| {
            let is_fresh = answered_ms <= checks[n].exposed_ms + STALE_AFTER_MS + ANSWER_MS;
            let later = checks[n + 1..].iter();
            let is_superseded = later
                .filter(|check| !check.is_recording)
                .any(|check| is_known(check));
            checks[n].verdict == "go" && checks[n].counts && is_fresh && !is_superseded
        })
    };
    let stands = match tool {
        Some(tool) => of_tool(tool),
        None => (0..TOOLS.len()).any(of_tool),
    };
    (!stands).then(|| "no fresh go stands".into())
}

/// Outlets that say go now, each with the tool that it says it of.
fn goes(plant: &Plant) -> Vec<(&'static str, Option<usize>)> {
    let mut outlets = Vec::new();
    if plant.registers()[0] & GO != 0 {
        outlets.push(("Modbus", None));
    }
    let metrics = plant.with_token("/metrics").text;
    for (tool, name) in TOOLS.iter().enumerate() {
        let line = format!(
            "flankscope_verdict_stands{{tool=\"{name}\",station=\"press 7\",verdict=\"go\"}} 1.0"
        );
        if metrics.contains(&line) {
            outlets.push(("metrics", Some(tool)));
        }
    }
    let board = plant.with_token("/board").text;
    for tile in board.split("<span class=\"verdict ").skip(1) {
        if tile.starts_with("go\"") {
            outlets.push(("page", None));
        }
    }
    outlets
}

fn signal(child: &Child, signal: Signal) {
    kill_process(Pid::from_child(child), signal).unwrap();
}

fn start_press(folder: &Path, seed: u64) -> Killed {
    let child = Command::new(std::env::current_exe().unwrap())
        .arg("press")
        .arg(folder)
        .arg(flankscope_tests::state())
        .arg(seed.to_string())
        .stdin(Stdio::null())
        .spawn();
    Killed(child.unwrap())
}

/// Counts of a schedule, and the goes that were wrong.
#[derive(Debug, Default)]
struct Seen {
    rounds: usize,
    goes: usize,
    stops: usize,
    kills: usize,
    accepted: usize,
    refused: usize,
    wrong: Vec<String>,
}

/// A schedule while it runs.
struct Schedule {
    folder: PathBuf,
    plant: Plant,
    /// Since when the plant's process has run without a stop.
    plant_runs_since_ms: u64,
    acknowledged: Vec<Acknowledged>,
    seen: Seen,
}

impl Schedule {
    /// Asks every outlet, and notes each go that must not be said.
    fn ask(&mut self) {
        let asked_ms = now_ms();
        let outlets = goes(&self.plant);
        let answered_ms = now_ms();
        let checks = ledger(&self.folder);
        let objection = |tool| {
            let moments = [asked_ms, answered_ms, self.plant_runs_since_ms];
            objection(&checks, &self.acknowledged, tool, moments)
        };
        self.seen.rounds += 1;
        for (outlet, tool) in outlets {
            self.seen.goes += 1;
            // The page has a tile of each die, whatever another die's no-go is.
            let tools = match outlet {
                "page" => vec![Some(0), Some(1)],
                _ => vec![tool],
            };
            let objections: Vec<String> =
                tools.iter().filter_map(|&tool| objection(tool)).collect();
            if objections.len() == tools.len() {
                let last = &checks[checks.len().saturating_sub(4)..];
                self.seen.wrong.push(format!(
                    "{outlet} {tool:?} asked {asked_ms} answered {answered_ms}, runs since {}: {objections:?}\n{last:#?}\n{:?}",
                    self.plant_runs_since_ms, self.acknowledged
                ));
            }
        }
    }

    /// Acknowledges the newest no-go that is known to be stored, unless that was done.
    fn acknowledge(&mut self) {
        let checks = ledger(&self.folder);
        let no_go = checks.iter().rev().find(|check| check.is_press_no_go());
        let Some((tool, check)) = no_go.and_then(|check| Some((check.tool, check.stored?.0)))
        else {
            return;
        };
        let is_done = |done: &Acknowledged| done.check == check && done.is_accepted;
        if self.acknowledged.iter().any(is_done) {
            return;
        }
        let bearer = format!("Authorization: Bearer {}\r\n", self.plant.token);
        let form = format!("check={check}&reason=insert+changed");
        let at_ms = now_ms();
        let answer = self.plant.post("/acknowledge", &bearer, &form);
        let is_accepted = answer.status == 303;
        assert!(is_accepted || answer.status == 409, "{}", answer.text);
        self.seen.accepted += usize::from(is_accepted);
        self.seen.refused += usize::from(!is_accepted);
        self.acknowledged.push(Acknowledged {
            tool,
            check,
            at_ms,
            is_accepted,
        });
    }

    /// Notes it if a no-go that no accepted acknowledgement named is not latched any more.
    fn look_at_the_end(&mut self) {
        let accepted = |check: &Noted, id: i64| {
            let mut done = self.acknowledged.iter();
            done.any(|done| done.is_accepted && done.tool == check.tool && done.check >= id)
        };
        let checks = ledger(&self.folder);
        let is_open = |check: &&Noted| {
            let id = check.stored.map_or(0, |(id, _)| id);
            check.is_press_no_go() && id > 0 && !accepted(check, id)
        };
        let open: Vec<&Noted> = checks.iter().filter(is_open).collect();
        // A press that was killed may have stored a no-go without noting it.
        let is_noted = |check: &Noted| !check.is_press_no_go() || check.stored.is_some();
        let is_latched = self.plant.registers()[0] & LATCHED != 0;
        if !open.is_empty() && !is_latched {
            let wrong = format!("cleared unseen: {open:?} {:?}", self.acknowledged);
            self.seen.wrong.push(wrong);
        }
        if open.is_empty() && is_latched && checks.iter().all(is_noted) {
            let wrong = format!("latched without a no-go of the press: {checks:?}");
            self.seen.wrong.push(wrong);
        }
    }
}

fn schedule(seed: u64) -> Seen {
    let mut random = Random(seed);
    let station = Station::new((STALE_AFTER_MS / 1000) as u32);
    let folder: PathBuf = station.folder.path().into();
    let mut press = start_press(&folder, seed);
    let mut schedule = Schedule {
        plant: station.serve(),
        plant_runs_since_ms: now_ms(),
        folder: folder.clone(),
        acknowledged: Vec::new(),
        seen: Seen::default(),
    };
    let end_ms = now_ms() + SCHEDULE_MS;
    let mut next_event_ms = now_ms() + 1_000;
    while now_ms() < end_ms {
        std::thread::sleep(TICK);
        if now_ms() >= next_event_ms {
            next_event_ms = now_ms() + 500 + (4_000.0 * random.uniform()) as u64;
            let long = Duration::from_millis(200 + (4_800.0 * random.uniform().powi(2)) as u64);
            let event = random.uniform();
            if event < 0.3 {
                signal(&press.0, Signal::STOP);
                schedule.ask();
                std::thread::sleep(long);
                schedule.ask();
                signal(&press.0, Signal::CONT);
                schedule.seen.stops += 1;
            } else if event < 0.7 {
                let stops_press = event < 0.45;
                if stops_press {
                    signal(&press.0, Signal::STOP);
                }
                signal(&schedule.plant.process.0, Signal::STOP);
                std::thread::sleep(long);
                if stops_press {
                    signal(&press.0, Signal::CONT);
                }
                schedule.plant_runs_since_ms = now_ms() + 30;
                let stopped = Pid::from_child(&schedule.plant.process.0);
                std::thread::scope(|scope| {
                    scope.spawn(|| {
                        std::thread::sleep(Duration::from_millis(30));
                        kill_process(stopped, Signal::CONT).unwrap();
                    });
                    // Asked while it is stopped, answered when it goes on.
                    schedule.ask();
                });
                schedule.seen.stops += 1;
            } else if event < 0.85 {
                schedule.plant = station.serve();
                schedule.plant_runs_since_ms = now_ms();
                schedule.seen.kills += 1;
            } else {
                drop(press);
                press = start_press(&folder, seed ^ now_ms());
                schedule.seen.kills += 1;
            }
        }
        // Seldom enough for most no-gos to stay open for longer than the process needs to see them.
        if random.uniform() < 0.05 {
            schedule.acknowledge();
        }
        schedule.ask();
    }
    drop(press);
    std::thread::sleep(Duration::from_millis(SEEN_WITHIN_MS));
    schedule.look_at_the_end();
    schedule.seen
}

fn campaign(count: usize, lanes: usize) {
    let first = u64::from(std::process::id()) << 20;
    let all = in_lanes(count, lanes, |number| schedule(first + number as u64));
    let sum = |figure: fn(&Seen) -> usize| all.iter().map(figure).sum::<usize>();
    println!(
        "{count} schedules, {} rounds of questions, {} goes, {} stops, {} kills, {} acknowledgements accepted and {} refused",
        sum(|seen| seen.rounds),
        sum(|seen| seen.goes),
        sum(|seen| seen.stops),
        sum(|seen| seen.kills),
        sum(|seen| seen.accepted),
        sum(|seen| seen.refused)
    );
    let wrong: Vec<&String> = all.iter().flat_map(|seen| &seen.wrong).collect();
    assert!(
        wrong.is_empty(),
        "{} wrong goes, the first: {}",
        wrong.len(),
        wrong[0]
    );
    // A plant that never says go would pass: most schedules have some.
    assert!(
        sum(|seen| usize::from(seen.goes > 0)) * 2 > count,
        "hardly any go was said"
    );
}
