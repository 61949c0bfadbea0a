//! What the templates show.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use askama::Template;
use flankscope_foundation::clock::BootTime;
use flankscope_foundation::date::Date;
use flankscope_foundation::files::read_text;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::{LivePicture, LiveState};
use flankscope_record::history::{Check, FlankRow};
use flankscope_record::origin::OriginKind;
use flankscope_report::figure;

use super::language::Language;
use crate::access::{Role, User};
use crate::live::Live;
use crate::percent;
use crate::statement::{DieStatement, Doubt, StationStatement, Worth, most_worn};

/// Name of the newest check's maps in space.
const MAP3D: &str = "map3d.html";
/// Free space of the history's disk below which it is an alarm, bytes.
const LOW_DISK_BYTES: u64 = 1 << 30;
/// Time for which a tile is believed without a new answer of the server: three times the interval at which the page asks.
const BOARD_LIFE: Duration = Duration::from_secs(15);
/// Largest page of a report, bytes.
const MOST_REPORT: u64 = 4 << 20;

#[derive(Template)]
#[template(path = "login.html")]
pub struct Login<'a> {
    pub lang: Language,
    /// Where to go then.
    pub to: &'a str,
    /// Whether a token was just refused.
    pub refused: bool,
}

#[derive(Template)]
#[template(path = "home.html")]
pub struct Home {
    pub lang: Language,
    pub board: String,
    pub now: String,
    pub pictures: String,
    /// Whether there are maps in space.
    pub has_map3d: bool,
    /// Whether its reader acknowledges and starts checks.
    pub acknowledges: bool,
    /// Whether its reader gives and revokes tokens.
    pub is_admin: bool,
}

/// Who has a token.
#[derive(Template)]
#[template(path = "users.html")]
pub struct UsersPage<'a> {
    pub lang: Language,
    pub users: &'a [User],
    /// The reader's own name.
    pub own: &'a str,
    /// Name and token of somebody who was just given one: shown this once.
    pub given: Option<(&'a str, &'a str)>,
}

impl UsersPage<'_> {
    fn roles(&self) -> [Role; 3] {
        [Role::View, Role::Acknowledge, Role::Admin]
    }
}

/// What a watch does now.
#[derive(Template)]
#[template(path = "now.html")]
pub struct Now<'a> {
    lang: Language,
    today: Date,
    state: Option<&'a LiveState>,
    /// Seconds since the last statement of a watch that is connected and whose statement holds no longer.
    silent_s: Option<u64>,
    /// Time for which the statement holds, ms.
    valid_ms: u128,
    /// What the history's disk has free, if it says.
    free_bytes: Option<u64>,
    /// Steps of the check, with their seconds and their lengths as shares of the whole, percent.
    steps: Vec<Step<'a>>,
}

/// Maps and camera frames of the last check.
#[derive(Template)]
#[template(path = "pictures.html")]
pub struct LastPictures {
    pub lang: Language,
    pub pictures: Arc<[LivePicture]>,
}

struct Step<'a> {
    at_s: f64,
    share: f64,
    what: &'a str,
}

impl<'a> Now<'a> {
    pub fn new(live: &'a Live, now: &BootTime, free_bytes: Option<u64>, lang: Language) -> Self {
        let state = live.current(now);
        let silent = live.state.as_ref().filter(|_| state.is_none());
        let silent_s = silent.map(|state| {
            let said_at = state.said_at.as_ref();
            let since = said_at.and_then(|said_at| now.since(said_at));
            since.map_or(0, |since| since.as_secs())
        });
        let steps = state.map_or(&[][..], |state| &state.steps);
        let whole_ms = steps.last().map_or(1, |last| last.at_ms.max(1));
        let ends_ms = steps.iter().skip(1).map(|next| next.at_ms);
        let steps = steps.iter().zip(ends_ms.chain([whole_ms]));
        let steps = steps.map(|(step, end_ms)| Step {
            at_s: step.at_ms as f64 / 1000.0,
            share: 100.0 * end_ms.saturating_sub(step.at_ms) as f64 / whole_ms as f64,
            what: &step.what,
        });
        Self {
            lang,
            today: Date::today(),
            state,
            silent_s,
            valid_ms: live.valid_for(now).as_millis(),
            free_bytes,
            steps: steps.collect(),
        }
    }
}

/// What stands for every tool.
#[derive(Template)]
#[template(path = "board.html")]
pub struct Board {
    lang: Language,
    fault: Option<String>,
    /// Check and die of the no-gos that are open while the history cannot be read.
    open_no_gos: Vec<String>,
    tools: Vec<Tile>,
    /// Whether its reader may acknowledge.
    acknowledges: bool,
}

struct Tile {
    tool: String,
    query: String,
    /// Class and word of the badge.
    badge: &'static str,
    word: &'static str,
    /// Time for which the tile may be believed without a new one, ms.
    valid_ms: u128,
    /// Why the verdict does not count, if it does not.
    not_counting: Option<String>,
    /// The check whose no-go is not acknowledged.
    latched: Option<i64>,
    simulated: bool,
    /// The check shown is a recording: of this day, if that is known.
    is_recording: bool,
    /// A newer recording: its number and what it says.
    recording: Option<(i64, String)>,
    age: String,
    id: i64,
    reason: String,
    worst: Option<String>,
    particulars: String,
    counts: String,
}

impl Board {
    pub fn new(station: &StationStatement, acknowledges: bool, lang: Language) -> Self {
        let open_no_gos = match station.fault {
            Some(_) => station
                .open_no_gos
                .iter()
                .map(ToString::to_string)
                .collect(),
            // Each tile shows its own.
            None => Vec::new(),
        };
        Self {
            lang,
            fault: station.fault.as_deref().map(str::to_owned),
            open_no_gos,
            tools: station.dies.iter().map(|die| tile(die, lang)).collect(),
            acknowledges,
        }
    }
}

#[cfg(test)]
impl Board {
    pub fn says_good(&self, tool: &str) -> bool {
        let mut tiles = self.tools.iter();
        tiles.any(|tile| tile.tool == tool && matches!(tile.badge, "go" | "warn"))
    }
}

fn tile(die: &DieStatement, lang: Language) -> Tile {
    let last = &die.last;
    let is_recording = die.origin == OriginKind::Recording;
    let age = match die.age {
        Some(age) => ago(age.as_secs(), lang),
        None => lang
            .choose("at an unknown time", "zu unbekannter Zeit")
            .into(),
    };
    let (badge, word) = match (die.verdict, die.worth) {
        (Some(word), _) => (word.as_str(), shown(word, lang)),
        (None, Worth::Stale) => ("old", lang.choose("TOO OLD", "ZU ALT")),
        (None, _) if is_recording => ("old", lang.choose("RECORDING", "AUFNAHME")),
        (None, _) => ("old", lang.choose("UNKNOWN", "UNBEKANNT")),
    };
    let not_counting = die.verdict.is_none().then(|| {
        let before = lang.choose("last", "zuletzt");
        let why = die.worth.doubt().map_or("", |doubt| doubted(doubt, lang));
        format!("{before} {}, {age}{why}", shown(last.verdict, lang))
    });
    // A verdict that stands because it is young is believed until it is too old, everything else for as long as the board.
    let valid = match die.verdict {
        Some(word) if word != Word::NoGo => BOARD_LIFE.min(die.valid_for),
        _ => BOARD_LIFE,
    };
    let recording = die.recording.as_ref();
    Tile {
        tool: last.tool.clone(),
        query: percent::encoded(&last.tool),
        badge,
        word,
        valid_ms: valid.as_millis(),
        not_counting,
        latched: die.latched.as_ref().map(|no_go| no_go.check),
        simulated: last.origin.simulated,
        is_recording,
        recording: recording.map(|check| (check.id, shown(check.verdict, lang).to_owned())),
        age,
        id: last.id,
        reason: last.reason.clone(),
        worst: most_worn(last).map(|flank| worn(flank, lang)),
        particulars: format!(
            "{} {} · {} {} · {} {}",
            lang.choose("station", "Station"),
            last.origin.station,
            lang.choose("head", "Messkopf"),
            last.origin.head.name,
            lang.choose("press cycles", "Pressenhübe"),
            last.tool_cycles,
        ),
        counts: die
            .counts
            .iter()
            .map(|(word, count)| format!("{count} {}", word.as_str()))
            .collect::<Vec<_>>()
            .join(" · "),
    }
}

/// Why the age of a check is not believed, after a comma.
fn doubted(doubt: Doubt, lang: Language) -> &'static str {
    match doubt {
        Doubt::Recording => lang.choose(
            ", from recorded frames, not from the press",
            ", aus aufgezeichneten Bildern, nicht von der Presse",
        ),
        Doubt::ClockAhead => lang.choose(
            ", with a date in the future: set the clock right",
            ", mit einem Datum in der Zukunft: Uhr richtig stellen",
        ),
        Doubt::ClockSetBack => lang.choose(
            ", and the clock was set back since then: the next check counts again",
            ", und die Uhr wurde seitdem zurückgestellt: Die nächste Prüfung gilt wieder",
        ),
        Doubt::BeforeBoot => lang.choose(
            ", before this computer was started: the next check counts again",
            ", vor dem Start dieses Rechners: Die nächste Prüfung gilt wieder",
        ),
    }
}

fn shown(word: Word, lang: Language) -> &'static str {
    match word {
        Word::Go => "GO",
        Word::Warn => lang.choose("WARN", "WARNUNG"),
        Word::NoGo => "NO-GO",
        Word::Indeterminate => lang.choose("INDETERMINATE", "UNENTSCHIEDEN"),
    }
}

/// Time since then, to two figures.
fn ago(age_s: u64, lang: Language) -> String {
    let (number, unit) = match age_s {
        0..120 => (age_s, "s"),
        120..7200 => (age_s / 60, "min"),
        7200..172_800 => (age_s / 3600, "h"),
        _ => (age_s / 86_400, lang.choose("days", "Tagen")),
    };
    match lang {
        Language::English => format!("{number} {unit} ago"),
        Language::German => format!("vor {number} {unit}"),
    }
}

fn worn(flank: &FlankRow, lang: Language) -> String {
    format!(
        "{}: {} µm, {} {:.0} µm",
        flank.id,
        wear(flank),
        lang.choose("stop at", "Stopp bei"),
        flank.limit_um
    )
}

fn wear(flank: &FlankRow) -> String {
    match flank.wear_um {
        Some(_) => format!("{} ± {}", figure(flank.wear_um), figure(flank.u95_um)),
        None => figure(None),
    }
}

/// The list of checks.
#[derive(Template)]
#[template(path = "checks.html")]
pub struct List {
    pub lang: Language,
    pub tools: Vec<String>,
    /// Filters; an empty name means all tools.
    pub tool: String,
    pub verdict: Option<Word>,
    /// Newest first.
    pub checks: Vec<Check>,
    /// Older ones follow before this one.
    pub more: Option<i64>,
}

impl List {
    fn words(&self) -> [Word; 4] {
        Word::ALL
    }

    fn most_worn(&self, check: &Check) -> String {
        most_worn(check).map_or_else(
            || "–".into(),
            |flank| format!("{} {}", flank.id, wear(flank)),
        )
    }

    fn older(&self, before: &i64) -> String {
        let verdict = self
            .verdict
            .map_or_else(String::new, |word| format!("&verdict={word}"));
        format!(
            "checks?tool={}{verdict}&before={before}",
            percent::encoded(&self.tool)
        )
    }
}

/// One check.
#[derive(Template)]
#[template(path = "check.html")]
pub struct CheckPage {
    pub lang: Language,
    pub check: Check,
    /// Name of the instrument's page of it.
    pub report: Option<String>,
}

impl CheckPage {
    fn wear(&self, flank: &FlankRow) -> String {
        wear(flank)
    }
}

/// Name of the report of a check in a folder of reports, if there is one.
pub async fn report_of(folder: PathBuf, id: i64) -> Option<String> {
    let part = format!("-check-{id}-");
    let find = move || {
        let files = std::fs::read_dir(folder.join("reports")).ok()?;
        let names = files.filter_map(|file| file.ok()?.file_name().into_string().ok());
        names
            .filter(|name| is_page(name) && name.contains(&part))
            .max()
    };
    tokio::task::spawn_blocking(find).await.ok()?
}

/// The newest check's maps in space, in a folder of reports.
pub fn map3d(folder: &Path) -> PathBuf {
    folder.join(MAP3D)
}

/// A page in a folder of reports.
pub async fn report_page(folder: PathBuf, name: String) -> Option<String> {
    if !is_page(&name) {
        return None;
    }
    let read = move || {
        let path = match name.as_str() {
            MAP3D => map3d(&folder),
            _ => folder.join("reports").join(name),
        };
        (std::fs::metadata(&path).ok()?.len() <= MOST_REPORT).then(|| read_text(&path).ok())?
    };
    tokio::task::spawn_blocking(read).await.ok()?
}

/// Whether it is a name that the instrument gives a page: letters, digits and hyphens, so that no path leads out of the folder.
fn is_page(name: &str) -> bool {
    name.strip_suffix(".html").is_some_and(|stem| {
        !stem.is_empty() && stem.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-')
    })
}

#[cfg(test)]
mod tests {
    use flankscope_record::document::{HeadDates, LiveCounts};

    use super::*;

    const GIB: u64 = 1 << 30;

    fn alarms(days: [u32; 2], made: LiveCounts, free_bytes: u64) -> Vec<String> {
        let today = Date::today();
        let head = HeadDates {
            calibration_expires: Some(today.plus_days(days[0])),
            self_test_due: Some(today.plus_days(days[1])),
        };
        let mut state = LiveState::new("press 7".into(), "die".into(), false, head);
        state.made = made;
        let now = BootTime::now();
        (state.said_at, state.holds_ms) = (Some(now.clone()), 1000);
        let live = Live {
            state: Some(Arc::new(state)),
            ..Live::default()
        };
        let now = Now::new(&live, &now, Some(free_bytes), Language::English);
        let page = now.render().unwrap();
        let alarms = page.split("<li class=\"alarm\">").skip(1);
        alarms
            .map(|alarm| alarm.split('<').next().unwrap().to_owned())
            .collect()
    }

    #[test]
    fn health_that_needs_somebody_is_an_alarm() {
        let fit = LiveCounts {
            checks: 3,
            frames_triggered: 225,
            ..LiveCounts::default()
        };
        assert_eq!(alarms([60, 5], fit, 20 * GIB), [""; 0]);
        let begins = |alarms: Vec<String>, wanted: &str| {
            assert!(
                alarms.len() == 1 && alarms[0].starts_with(wanted),
                "{alarms:?}"
            );
        };
        begins(alarms([13, 5], fit, 20 * GIB), "Calibration expires");
        begins(alarms([60, 1], fit, 20 * GIB), "Self-test due");
        begins(
            alarms([60, 5], fit, GIB - 1),
            "Free for the history: 1.1 GB",
        );
        let lossy = LiveCounts {
            frames_lost: 2,
            ..fit
        };
        begins(
            alarms([60, 5], lossy, 20 * GIB),
            "Camera: lost 2 of 225 frames; views captured again: 0; checks of this watch: 3",
        );
        let shut_out = LiveCounts {
            missed_checks: 1,
            ..fit
        };
        begins(
            alarms([60, 5], shut_out, 20 * GIB),
            "Checks not made because the press did not admit the head: 1",
        );
    }
}
