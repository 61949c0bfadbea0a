//! Every short sequence of events against what may be said: no outlet says good unless a fresh go of this die by this instrument
//! stands and no no-go is open.

use std::time::Duration;

use flankscope_foundation::clock::BootTime;
use flankscope_metrology::verdict::Word;
use flankscope_record::die::DieKey;
use flankscope_record::document::LastExposure;
use flankscope_record::history::{Check, LastChecks};
use flankscope_record::origin::{HeadId, Origin};
use flankscope_record::seal::StandingNoGo;
use jiff::Timestamp;

use crate::statement::{Doubt, Facts, Moment, Standing, StationStatement, Tracker, Worth};

/// Seconds since 1970 at which the wall clock of these tests is 0 s.
const EPOCH_S: i64 = 1_770_000_000;

/// A moment at which both clocks show `s`.
pub fn moment(s: i64) -> Moment {
    moment_of(s, s, 1)
}

/// A moment `true_s` after the first start of the computer, with the wall clock at `wall_s`, in this start of the computer.
pub fn moment_of(true_s: i64, wall_s: i64, boot: u32) -> Moment {
    Moment {
        boot: BootTime {
            boot: format!("start {boot}"),
            since_boot_ms: u64::try_from(1000 * (true_s + 10_000)).unwrap(),
        },
        wall: Timestamp::from_second(EPOCH_S + wall_s).unwrap(),
    }
}

fn key(tool: &str) -> DieKey {
    DieKey {
        tool: tool.into(),
        geometry: format!("geometry of {tool}"),
        serial: None,
    }
}

/// The only check of a tool, with its last exposure at this moment.
pub fn check(id: i64, tool: &str, verdict: Word, exposed: &Moment) -> LastChecks {
    LastChecks {
        die: key(tool),
        check: Some(row(id, tool, verdict, exposed, "/dev/ttyACM0")),
        exposure: Some(LastExposure {
            at: exposed.wall.to_string(),
            boot: exposed.boot.clone(),
        }),
        recording: None,
    }
}

fn row(id: i64, tool: &str, verdict: Word, stored: &Moment, link: &str) -> Check {
    Check {
        id,
        at: stored.wall.to_string(),
        tool: tool.into(),
        tool_cycles: 5,
        press_cycles: 5,
        baseline: None,
        verdict,
        reason: String::new(),
        origin: Origin {
            link: link.into(),
            simulated: false,
            head: HeadId {
                name: "head".into(),
                blake3: String::new(),
                seal: "signed".into(),
            },
            station: "press 7".into(),
            operator: None,
            recording: None,
        },
        serial: None,
        flanks: Vec::new(),
    }
}

pub fn no_go(tool: &str, check: i64) -> StandingNoGo {
    StandingNoGo {
        die: key(tool),
        check,
        at: "2026-01-31T12:00:00Z".into(),
    }
}

/// A history and the process that follows it, without files and clocks.
#[derive(Clone)]
pub struct Scene {
    pub facts: Facts,
    tracker: Tracker,
    standing: Standing,
}

impl Scene {
    pub fn new(stale_after_s: u64) -> Self {
        Self {
            facts: Facts::default(),
            tracker: Tracker::default(),
            standing: Standing::unread(Duration::from_secs(stale_after_s)),
        }
    }

    /// Statement after a look at this moment, as [`crate::follow`] does it.
    pub fn look(&mut self, now: &Moment) -> Standing {
        self.tracker.clock_went_back(now);
        self.standing = self
            .standing
            .with_facts(&self.facts, &mut self.tracker, now);
        self.standing.clone()
    }
}

#[test]
fn a_check_gets_older_by_the_steady_clock_whatever_the_wall_clock_does() {
    let mut scene = Scene::new(60);
    scene.facts.tools = vec![(check(1, "die", Word::Go, &moment(100)), Vec::new())];
    let standing = scene.look(&moment(110));
    let at = |now: &Moment| standing.statement(now).dies[0].clone();
    let die = at(&moment(130));
    assert_eq!(die.age, Some(Duration::from_secs(30)));
    assert_eq!(die.valid_for, Duration::from_secs(30));
    assert_eq!(die.counts_until, Some(moment(160).wall));
    assert_eq!((die.verdict, die.worth), (Some(Word::Go), Worth::Counts));
    // The wall clock may only make it older.
    let die = at(&moment_of(130, 105, 1));
    assert_eq!(die.age, Some(Duration::from_secs(30)));
    let die = at(&moment_of(130, 161, 1));
    assert_eq!((die.verdict, die.worth), (None, Worth::Stale));
    assert_eq!(die.valid_for, Duration::ZERO);
    let die = at(&moment_of(139, 60, 1));
    assert_eq!(die.age, Some(Duration::from_secs(39)));
    // Without a look for long, nothing is known.
    let late = standing.statement(&moment(141));
    assert!(late.fault.is_some() && late.verdict.is_none() && late.dies.is_empty());
}

#[test]
fn a_clock_that_went_back_is_a_doubt_by_name_until_the_next_check() {
    let doubt = |standing: &Standing, now: &Moment| standing.statement(now).dies[0].worth.doubt();
    let mut scene = Scene::new(60);
    scene.facts.tools = vec![(check(1, "die", Word::Go, &moment(100)), Vec::new())];
    let standing = scene.look(&moment(110));
    assert_eq!(doubt(&standing, &moment(110)), None);
    // While this process watches.
    let now = moment_of(111, 50, 1);
    let standing = scene.look(&now);
    assert_eq!(doubt(&standing, &now), Some(Doubt::ClockSetBack));
    assert_eq!(standing.statement(&now).verdict, None);
    let now = moment_of(120, 59, 1);
    scene.facts.tools = vec![(check(2, "die", Word::Go, &now), Vec::new())];
    let standing = scene.look(&now);
    assert_eq!(standing.statement(&now).verdict, Some(Word::Go));
    // Before this process began.
    let mut restarted = Scene::new(60);
    restarted.facts.tools = vec![(check(1, "die", Word::Go, &moment(100)), Vec::new())];
    for (now, expected) in [
        (moment_of(150, 110, 1), Doubt::ClockSetBack),
        (moment_of(110, 90, 1), Doubt::ClockSetBack),
        (moment_of(110, 110, 2), Doubt::BeforeBoot),
    ] {
        let standing = restarted.clone().look(&now);
        assert_eq!(doubt(&standing, &now), Some(expected), "{now:?}");
    }
    // A check of an older program states no steady time: it is not believed while a row of the history is in the future.
    let mut old = check(1, "die", Word::Go, &moment(100));
    old.exposure = None;
    restarted.facts.tools = vec![(old, Vec::new())];
    let now = moment(110);
    let standing = restarted.clone().look(&now);
    assert_eq!(doubt(&standing, &now), None);
    restarted.facts.newest_date = Some(moment(200).wall.to_string());
    let standing = restarted.look(&now);
    assert_eq!(doubt(&standing, &now), Some(Doubt::ClockSetBack));
}

#[test]
fn a_no_go_that_was_known_stays_while_the_history_is_gone() {
    let mut scene = Scene::new(60);
    scene.facts.open_no_gos = vec![no_go("die", 7)];
    let gone = scene
        .look(&moment(100))
        .with_fault("gone", &[no_go("die", 6)]);
    let statement = gone.statement(&moment(500));
    assert_eq!(
        (statement.verdict, statement.open_no_gos[0].check),
        (Some(Word::NoGo), 7)
    );
    // A process that has not read it yet has the station's memory.
    let unread = Standing::unread(Duration::from_secs(60)).with_fault("gone", &[no_go("die", 6)]);
    let statement = unread.statement(&moment(0));
    assert_eq!(
        (statement.verdict, statement.open_no_gos[0].check),
        (Some(Word::NoGo), 6)
    );
}

/// Event between two looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Incident {
    Go,
    NoGo,
    /// A go of another die.
    OtherGo,
    /// Recorded frames are evaluated, with go.
    RecordedGo,
    /// Recorded frames are evaluated, with no-go.
    RecordedNoGo,
    /// A person acknowledges the newest no-go.
    Acknowledge,
    /// The process that follows the history is stopped, and after a long time runs on: no look happens in between.
    FreezeAndThaw,
    /// The process is stopped, and is read by outlets that buffered nothing. It stays stopped until it thaws.
    Wait,
    ClockBack,
    ClockForward,
    /// The process that follows the history starts anew.
    Restart,
    /// The computer starts anew.
    Reboot,
    HistoryGone,
}

const INCIDENTS: [Incident; 13] = [
    Incident::Go,
    Incident::NoGo,
    Incident::OtherGo,
    Incident::RecordedGo,
    Incident::RecordedNoGo,
    Incident::Acknowledge,
    Incident::FreezeAndThaw,
    Incident::Wait,
    Incident::ClockBack,
    Incident::ClockForward,
    Incident::Restart,
    Incident::Reboot,
    Incident::HistoryGone,
];

/// Age from which a verdict is too old, s.
const STALE_S: i64 = 20;

/// The world: what truly happened, and the process that sees it.
#[derive(Clone)]
struct World {
    true_s: i64,
    wall_s: i64,
    boot: u32,
    next_check: i64,
    is_gone: bool,
    scene: Scene,
    /// True time and verdict of the last check of each die, and the number of its open no-go.
    last: [Option<(i64, Word)>; 2],
    open: Option<i64>,
}

const DIES: [&str; 2] = ["die", "other"];

impl World {
    fn new() -> Self {
        Self {
            true_s: 0,
            wall_s: 0,
            boot: 1,
            next_check: 1,
            is_gone: false,
            scene: Scene::new(STALE_S as u64),
            last: [None; 2],
            open: None,
        }
    }

    fn now(&self) -> Moment {
        moment_of(self.true_s, self.wall_s, self.boot)
    }

    fn pass(&mut self, s: i64) {
        self.true_s += s;
        self.wall_s += s;
    }

    fn check(&mut self, die: usize, verdict: Word) {
        let made = check(self.next_check, DIES[die], verdict, &self.now());
        self.last[die] = Some((self.true_s, verdict));
        if verdict == Word::NoGo {
            self.open = Some(self.next_check);
            self.scene.facts.open_no_gos = vec![no_go(DIES[die], self.next_check)];
        }
        self.store(die, made);
    }

    /// Puts the newest checks of a die first, as the history lists them.
    fn store(&mut self, die: usize, checks: LastChecks) {
        let tools = &mut self.scene.facts.tools;
        tools.retain(|(checks, _)| checks.die.tool != DIES[die]);
        tools.insert(0, (checks, Vec::new()));
        self.next_check += 1;
        self.scene.facts.newest_date = Some(self.now().wall.to_string());
    }

    fn take(&mut self, incident: Incident) {
        self.pass(3);
        match incident {
            Incident::Go => self.check(0, Word::Go),
            Incident::NoGo => self.check(0, Word::NoGo),
            Incident::OtherGo => self.check(1, Word::Go),
            Incident::RecordedGo | Incident::RecordedNoGo => {
                let tools = &mut self.scene.facts.tools;
                let mut checks = tools.iter().find(|(checks, _)| checks.die.tool == DIES[0]);
                let mut recorded = checks.take().map_or_else(
                    || LastChecks {
                        die: key(DIES[0]),
                        check: None,
                        exposure: None,
                        recording: None,
                    },
                    |(checks, _)| checks.clone(),
                );
                let (id, now) = (self.next_check, self.now());
                let verdict = match incident {
                    Incident::RecordedNoGo => Word::NoGo,
                    _ => Word::Go,
                };
                recorded.recording = Some(row(id, DIES[0], verdict, &now, "recorded frames"));
                self.store(0, recorded);
                let checked = |(checks, _): &(LastChecks, _)| checks.check.as_ref().map(|c| c.id);
                let tools = &mut self.scene.facts.tools;
                tools.sort_by_key(|tool| std::cmp::Reverse(checked(tool)));
            }
            Incident::Acknowledge => {
                self.open = None;
                self.scene.facts.open_no_gos.clear();
            }
            Incident::FreezeAndThaw | Incident::Wait => self.pass(17),
            Incident::ClockBack => self.wall_s -= 18,
            Incident::ClockForward => self.wall_s += 18,
            Incident::Restart | Incident::Reboot => {
                let facts = self.scene.facts.clone();
                self.scene = Scene::new(STALE_S as u64);
                self.scene.facts = facts;
                if incident == Incident::Reboot {
                    self.pass(5);
                    self.boot += 1;
                }
            }
            Incident::HistoryGone => self.is_gone = !self.is_gone,
        }
        if incident != Incident::Wait {
            self.look();
        }
    }

    fn look(&mut self) {
        if self.is_gone {
            self.scene.standing = self.scene.standing.with_fault("gone", &[]);
        } else {
            self.scene.look(&self.now());
        }
    }

    /// Whether it is true that a fresh go of this die stands and no no-go is open.
    fn is_good(&self, die: usize) -> bool {
        let Some((checked_s, verdict)) = self.last[die] else {
            return false;
        };
        let is_fresh = self.true_s - checked_s <= STALE_S;
        verdict == Word::Go && is_fresh
    }
}

/// Asserts that no outlet says good of what is not.
fn verify(world: &World, path: &[Incident]) -> bool {
    let station = world.scene.standing.statement(&world.now());
    let mut is_good_said = false;
    for die in &station.dies {
        let at = DIES.iter().position(|name| *name == die.last.tool).unwrap();
        let is_open = world.open.is_some() && at == 0;
        let is_good = world.is_good(at) && !is_open;
        let is_said = outlets_say_good(&station, &die.last.tool);
        assert!(is_good || !is_said, "{path:?}: {die:?}");
        is_good_said |= is_said;
        // A no-go comes from the press, never from a recording.
        let is_no_go = is_open || world.last[at].is_some_and(|(_, verdict)| verdict == Word::NoGo);
        assert!(
            is_no_go || die.verdict != Some(Word::NoGo),
            "{path:?}: {die:?}"
        );
    }
    let go = crate::modbus::words(&station, 0);
    let first = station.dies.first();
    let first = first.map(|die| DIES.iter().position(|name| *name == die.last.tool).unwrap());
    let is_good = first.is_some_and(|at| world.is_good(at)) && world.open.is_none();
    assert!(
        is_good || (go[0] & 0b11 == 0 && go[3] != 1 && go[3] != 2),
        "{path:?}: {go:?}"
    );
    // A no-go that is open stays in the registers, whichever die was checked last and whether or not the history can be read.
    assert!(
        world.open.is_none() || !was_read(&station, world) || go[0] & 0b10100 == 0b10100,
        "{path:?}: {go:?}"
    );
    is_good_said
}

/// Whether the open no-go was seen by this process: the station's memory of a history that is gone is not part of this model.
fn was_read(station: &StationStatement, world: &World) -> bool {
    !world.is_gone || !station.open_no_gos.is_empty()
}

/// Whether an outlet says that a die is good.
fn outlets_say_good(station: &StationStatement, tool: &str) -> bool {
    let die = station
        .dies
        .iter()
        .find(|die| die.last.tool == tool)
        .unwrap();
    let is_good = |word: Option<Word>| matches!(word, Some(Word::Go | Word::Warn));
    let page = crate::page::says_good(station, tool);
    #[cfg(feature = "mqtt")]
    assert_eq!(crate::mqtt::says_good(die), page, "{die:?}");
    #[cfg(feature = "opcua")]
    assert_eq!(crate::opcua::says_good(die), page, "{die:?}");
    assert_eq!(is_good(die.verdict), page, "{die:?}");
    page
}

/// Goes on from a world in all ways.
fn explore(world: &World, path: &mut Vec<Incident>, depth: usize, counts: &mut [u64; 2]) {
    if depth == 0 {
        return;
    }
    for incident in INCIDENTS {
        let mut next = world.clone();
        path.push(incident);
        next.take(incident);
        counts[0] += 1;
        counts[1] += u64::from(verify(&next, path));
        explore(&next, path, depth - 1, counts);
        path.pop();
    }
}

/// Longest sequence that is tried.
const DEPTH: usize = 5;

#[test]
fn no_sequence_of_events_makes_an_outlet_say_good_of_what_is_not() {
    let mut counts = [0; 2];
    explore(&World::new(), &mut Vec::new(), DEPTH, &mut counts);
    let [tried, good] = counts;
    assert_eq!(tried, (1..=5).map(|n| 13_u64.pow(n)).sum::<u64>());
    // It is not silent either.
    assert!(good > tried / 20, "{good} of {tried}");
}
