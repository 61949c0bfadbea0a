//! What the templates show. A verdict is shown as standing on the board alone, and only while it is fresh.

use std::collections::BTreeSet;

use askama::Template;
use flankscope_record::origin::RECORDED_LINKS;
use jiff::{SignedDuration, Timestamp};

use super::answers::{CheckRow, Die, FlankRow, LastCheck, Unlike};
use super::hall::Place;
use super::standing::{Lines, Standing};
use super::{Site, Times};
use crate::name::encoded;
use crate::query::questions;

/// Class of what does not stand.
const OLD: &str = "old";
/// Verdicts as checks spell them, the worst first; what nobody knows stands before what is well. Nothing else has a colour.
const CLASSES: [&str; 5] = ["no-go", "indeterminate", "warn", OLD, "go"];
/// End of the bands' scale, in the shortest life that is left.
const SCALE_RATIO: f64 = 10.0;

/// One decimal, as limits are written.
fn one_decimal(figure: Option<f64>) -> String {
    match figure {
        Some(figure) if figure.is_finite() => format!("{figure:.1}"),
        _ => "—".into(),
    }
}

fn whole(figure: Option<f64>) -> String {
    match figure {
        Some(figure) if figure.is_finite() => format!("{figure:.0}"),
        _ => "—".into(),
    }
}

fn measured(wear_um: Option<f64>, u95_um: Option<f64>) -> String {
    match (wear_um, u95_um) {
        (Some(_), Some(_)) => format!("{} ± {} µm", one_decimal(wear_um), one_decimal(u95_um)),
        _ => "no figure".into(),
    }
}

fn at(time: Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%M:%S").to_string()
}

fn ago(age: SignedDuration) -> String {
    match age.as_secs() {
        seconds @ ..120 => format!("{} s ago", seconds.max(0)),
        seconds @ ..7200 => format!("{} min ago", seconds / 60),
        seconds @ ..172_800 => format!("{} h ago", seconds / 3600),
        seconds => format!("{} d ago", seconds / 86_400),
    }
}

/// The tool, with the serial number of the die.
fn die(check: &CheckRow) -> String {
    match &check.serial {
        Some(serial) => format!("{}, {serial}", check.tool),
        None => check.tool.clone(),
    }
}

fn press_link(station: &str) -> String {
    format!("/press?station={}", encoded(station))
}

fn check_link(station: &str, check: &CheckRow) -> String {
    format!(
        "/check?station={}&date={}&history={}&epoch={}&number={}",
        encoded(station),
        encoded(&check.date),
        encoded(&check.history),
        encoded(&check.epoch),
        check.check_number
    )
}

/// How a press is shown: its last verdict, or why that does not stand.
#[derive(Debug, PartialEq, Eq)]
pub enum Shown {
    Standing(&'static str),
    Old(String),
}

impl Shown {
    /// A verdict stands if the lake answers and has it, and the check is neither a recording nor older than its time nor ahead of the
    /// clock.
    pub fn of(
        LastCheck {
            check,
            is_gone,
            link,
            ..
        }: &LastCheck,
        lake_answers: bool,
        times: &Times,
    ) -> Self {
        let mut words = CLASSES.into_iter().filter(|class| *class != OLD);
        let word = words.find(|word| *word == check.check_verdict);
        let was = || format!("was {}", check.check_verdict);
        match word {
            _ if !lake_answers => Self::Old(was()),
            _ if RECORDED_LINKS.contains(&link.as_str()) => {
                Self::Old(format!("{}; a recording, not the press", was()))
            }
            _ if *is_gone => Self::Old(format!("{}; the lake has nothing of it any more", was())),
            _ if times.is_ahead(check.stored_at) => {
                Self::Old(format!("{}; its clock is ahead", was()))
            }
            _ if times.is_stale(check.stored_at) => Self::Old(was()),
            Some(word) => Self::Standing(word),
            None => Self::Old(was()),
        }
    }

    fn class(&self) -> &'static str {
        match self {
            Self::Standing(word) => word,
            Self::Old(_) => OLD,
        }
    }

    fn word(&self) -> &str {
        match self {
            Self::Standing(word) => word,
            Self::Old(why) => why,
        }
    }
}

#[derive(Template)]
#[template(path = "tile.html")]
struct Tile<'a> {
    class: &'a str,
    link: String,
    /// Style of its place.
    place: Option<String>,
    station: &'a str,
    word: &'a str,
    simulated: bool,
    age: String,
    lines: Vec<String>,
}

#[derive(Template)]
#[template(path = "board_of_hall.html")]
struct Board {
    fault: Option<String>,
    presses: usize,
    now: String,
    counts: Vec<(&'static str, usize)>,
    hall: Vec<String>,
    others: Vec<String>,
}

/// The board: tiles on the map, then the others, the worst first.
pub fn board(site: &Site, standing: &Standing) -> askama::Result<String> {
    let times = site.times();
    let fault = match (&standing.fault, standing.answered_at) {
        (Some(fault), _) => Some(format!("The lake cannot be asked: {fault}")),
        (None, None) => Some("The lake was not read yet.".into()),
        (None, Some(last)) if times.is_ahead(last) || times.age(last) > Site::SILENT => {
            Some(format!("No answer of the lake since {} UTC.", at(last)))
        }
        _ => None,
    };
    let mut shown: Vec<(Shown, &LastCheck)> = standing
        .presses
        .iter()
        .map(|press| (Shown::of(press, fault.is_none(), &times), press))
        .collect();
    let count = |class: &'static str| {
        let of = shown.iter().filter(|(shown, _)| shown.class() == class);
        (class, of.count())
    };
    let counts = CLASSES.into_iter().map(count).filter(|(_, n)| *n > 0);
    let counts = counts.collect();
    let rank = |shown: &Shown| CLASSES.iter().position(|class| *class == shown.class());
    shown.sort_by(|(a, first), (b, second)| {
        (rank(a), &first.station).cmp(&(rank(b), &second.station))
    });
    let (mut hall, mut others) = (Vec::new(), Vec::new());
    for (shown, press) in &shown {
        let place = site
            .hall
            .as_ref()
            .and_then(|hall| hall.0.get(&press.station));
        let tile = tile(shown, press, place.copied(), &times).render()?;
        match place {
            Some(_) => hall.push(tile),
            None => others.push(tile),
        }
    }
    // A place whose press never said a word is no gap in the hall.
    let known: BTreeSet<&String> = shown.iter().map(|(_, press)| &press.station).collect();
    for (station, place) in site.hall.iter().flat_map(|hall| &hall.0) {
        if !known.contains(station) {
            let tile = Tile {
                class: OLD,
                link: press_link(station),
                place: Some(style(*place)),
                station,
                word: match standing.snapshot {
                    Some(_) => "no check yet",
                    None => "not known yet",
                },
                simulated: false,
                age: String::new(),
                lines: Vec::new(),
            };
            hall.push(tile.render()?);
        }
    }
    let board = Board {
        fault,
        presses: shown.len(),
        now: at(times.now),
        counts,
        hall,
        others,
    };
    board.render()
}

fn style(Place { row, column }: Place) -> String {
    format!("grid-row:{row};grid-column:{column}")
}

fn tile<'a>(
    shown: &'a Shown,
    press: &'a LastCheck,
    place: Option<Place>,
    times: &Times,
) -> Tile<'a> {
    let check = &press.check;
    let wear = measured(check.wear_um, check.u95_um);
    Tile {
        class: shown.class(),
        link: press_link(&press.station),
        place: place.map(style),
        station: &press.station,
        word: shown.word(),
        simulated: check.simulated,
        age: ago(times.age(check.stored_at)),
        lines: vec![
            die(check),
            format!(
                "{}: {wear} of {}",
                check.nearest,
                one_decimal(check.limit_um)
            ),
        ],
    }
}

#[derive(Template)]
#[template(path = "presses.html")]
pub struct Presses {
    pub board: String,
}

/// What a page says of when it asked; the same for a page that has not yet.
fn when(lines: Option<&Lines>, standing: &Standing) -> String {
    match (lines, &standing.fault) {
        (_, Some(fault)) => format!("The lake cannot be asked: {fault}"),
        (Some(lines), None) => format!("Asked at {} UTC.", at(lines.asked_at)),
        (None, None) => "Not asked yet.".into(),
    }
}

fn sentence_or_fault<T>(
    answer: Option<&Result<Vec<T>, String>>,
    asked: String,
    name: &str,
) -> String {
    let mut named = questions().filter(|question| question.name == name);
    match answer {
        Some(Err(fault)) => format!("{asked} There is no answer: {fault}"),
        _ => format!(
            "{} {asked}",
            named.next().map_or("", |question| question.sentence)
        ),
    }
}

struct DieRow {
    link: String,
    station: String,
    simulated: bool,
    tool: String,
    serial: String,
    flank: String,
    now_um: String,
    limit_um: String,
    at_least: String,
    strokes_left: String,
    /// Begin and width, per cent.
    band: Option<[f64; 2]>,
    why_not: String,
    last_check: String,
    stale: bool,
}

#[derive(Template)]
#[template(path = "dies.html")]
pub struct Dies {
    asked: String,
    dies: Vec<DieRow>,
}

impl Dies {
    pub fn of(site: &Site, standing: &Standing, lines: Option<&Lines>) -> Self {
        let times = site.times();
        let answer = lines.map(|lines| &lines.dies);
        let dies = answer
            .and_then(|dies| dies.as_deref().ok())
            .unwrap_or_default();
        // All bands share one scale, so that the dies to be changed next can be told apart.
        let left = dies.iter().filter_map(|die| die.strokes_left);
        let shortest = left.filter(|strokes| *strokes > 0.0).reduce(f64::min);
        let scale = SCALE_RATIO * shortest.unwrap_or(1.0);
        let row = |die: &Die| {
            let ends = die.at_least.zip(die.strokes_left);
            let band = ends.filter(|(from, _)| *from < scale).map(|(from, to)| {
                let [from, to] =
                    [from, to].map(|strokes| (100.0 * strokes / scale).clamp(0.0, 100.0));
                [from, (to - from).max(0.0)]
            });
            let beyond = || match ends {
                Some(_) => format!("more than {scale:.0}"),
                None => "—".into(),
            };
            DieRow {
                link: press_link(&die.station),
                station: die.station.clone(),
                simulated: die.simulated,
                tool: die.tool.clone(),
                serial: die.serial.clone().unwrap_or_else(|| "—".into()),
                flank: die.flank.to_string(),
                now_um: one_decimal(die.now_um),
                limit_um: one_decimal(die.limit_um),
                at_least: whole(die.at_least),
                strokes_left: whole(die.strokes_left),
                band,
                why_not: die.why_not.clone().unwrap_or_else(beyond),
                last_check: at(die.last_check),
                stale: times.is_stale(die.last_check) || times.is_ahead(die.last_check),
            }
        };
        let asked = sentence_or_fault(answer, when(lines, standing), "dies-by-strokes-left");
        Self {
            asked,
            dies: dies.iter().map(row).collect(),
        }
    }
}

struct StationRow {
    link: String,
    station: String,
    simulated: bool,
    dies: i64,
    flanks: i64,
    difference_um: String,
    expanded_um: String,
    u95_um: String,
    finding: &'static str,
}

#[derive(Template)]
#[template(path = "stations.html")]
pub struct Stations {
    asked: String,
    stations: Vec<StationRow>,
}

impl Stations {
    pub fn of(standing: &Standing, lines: Option<&Lines>) -> Self {
        let answer = lines.map(|lines| &lines.unlike);
        let unlike = answer
            .and_then(|unlike| unlike.as_deref().ok())
            .unwrap_or_default();
        let row = |of: &Unlike| StationRow {
            link: press_link(&of.station),
            station: of.station.clone(),
            simulated: of.simulated,
            dies: of.dies,
            flanks: of.flanks,
            difference_um: one_decimal(of.difference_um),
            expanded_um: one_decimal(of.expanded_um),
            u95_um: one_decimal(of.u95_um),
            finding: match (of.beyond_u95, of.beyond_expanded) {
                (Some(true), _) => "beyond what its values claim",
                (_, Some(true)) => "unlike the others, within its values' U95",
                (Some(false), Some(false)) => "like the others",
                _ => "—",
            },
        };
        let asked = sentence_or_fault(answer, when(lines, standing), "stations-unlike-the-others");
        Self {
            asked,
            stations: unlike.iter().map(row).collect(),
        }
    }
}

struct CheckLine {
    link: String,
    check_number: i64,
    at: String,
    tool: String,
    simulated: bool,
    tool_cycles: i64,
    verdict: String,
    nearest: String,
    reason: String,
}

#[derive(Template)]
#[template(path = "press.html")]
pub struct Press {
    station: String,
    checks: Vec<CheckLine>,
    days: i64,
    older: String,
}

impl Press {
    /// `before_ms`: where the next page ends.
    pub fn of(station: &str, checks: &[CheckRow], days: i64, before_ms: i64) -> Self {
        let line = |check: &CheckRow| CheckLine {
            link: check_link(station, check),
            check_number: check.check_number,
            at: at(check.stored_at),
            tool: die(check),
            simulated: check.simulated,
            tool_cycles: check.tool_cycles,
            verdict: check.check_verdict.clone(),
            nearest: format!(
                "{}: {}",
                check.nearest,
                measured(check.wear_um, check.u95_um)
            ),
            reason: check.reason.clone(),
        };
        Self {
            station: station.to_owned(),
            checks: checks.iter().map(line).collect(),
            days,
            older: format!("{}&before={before_ms}", press_link(station)),
        }
    }
}

struct FlankLine {
    flank: String,
    wear: String,
    warn_um: String,
    limit_um: String,
    verdict: String,
    code: String,
}

#[derive(Template)]
#[template(path = "check_of_hall.html")]
pub struct CheckPage {
    station: String,
    link: String,
    check_number: i64,
    at: String,
    tool: String,
    tool_cycles: i64,
    verdict: String,
    reason: String,
    simulated: bool,
    flanks: Vec<FlankLine>,
}

impl CheckPage {
    /// `None` without rows.
    pub fn of(station: &str, rows: &[FlankRow]) -> Option<Self> {
        let check = &rows.first()?.check;
        let of_flank = |row: &FlankRow| FlankLine {
            flank: row.check.nearest.to_string(),
            wear: measured(row.check.wear_um, row.check.u95_um),
            warn_um: one_decimal(row.warn_um),
            limit_um: one_decimal(row.check.limit_um),
            verdict: row.verdict.clone().unwrap_or_else(|| "—".into()),
            code: row.code.clone().unwrap_or_default(),
        };
        Some(Self {
            station: station.to_owned(),
            link: press_link(station),
            check_number: check.check_number,
            at: at(check.stored_at),
            tool: die(check),
            tool_cycles: check.tool_cycles,
            verdict: check.check_verdict.clone(),
            reason: check.reason.clone(),
            simulated: check.simulated,
            flanks: rows.iter().map(of_flank).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(verdict: &str, stored_at: Timestamp) -> LastCheck {
        serde_json::from_value(serde_json::json!({
            "station": "press 7", "link": "/dev/ttyACM0", "simulated": false, "history": "h", "epoch": "e", "check_number": 1, "date": "2026-01-31", "stored_at": stored_at.to_string(),
            "tool": "die", "serial": null, "tool_cycles": 1, "check_verdict": verdict, "reason": "", "tooth": 40, "flank": "left",
            "patch": null, "wear_um": 1.0, "u95_um": 4.0, "limit_um": 50.0
        }))
        .unwrap()
    }

    #[test]
    fn a_verdict_stands_only_while_it_is_fresh_known_and_the_lake_answers() {
        let now: Timestamp = "2026-01-31T12:00:00Z".parse().unwrap();
        let times = Times {
            now,
            stale_after: SignedDuration::from_mins(60),
        };
        let minutes = |minutes| now - SignedDuration::from_mins(minutes);
        for (verdict, minutes_ago, answers, standing) in [
            ("go", 0, true, true),
            ("go", 60, true, true),
            ("go", 61, true, false),
            ("no-go", 61, true, false),
            ("go", -2, true, true),
            ("go", -3, true, false),
            ("go", 0, false, false),
            ("warn", 5, true, true),
            // Of a release that is not known yet.
            ("good", 5, true, false),
        ] {
            let shown = Shown::of(&press(verdict, minutes(minutes_ago)), answers, &times);
            assert_eq!(
                shown.class() == verdict,
                standing,
                "{verdict} {minutes_ago}"
            );
            assert_eq!(shown.class() == OLD, !standing, "{verdict} {minutes_ago}");
            assert!(shown.word().contains(verdict), "{verdict}");
        }
        let gone = LastCheck {
            is_gone: true,
            ..press("go", now)
        };
        assert_eq!(Shown::of(&gone, true, &times).class(), OLD);
        for (link, class) in [
            ("/dev/ttyACM0", "go"),
            ("sim", "go"),
            ("recorded frames", OLD),
            ("recorded clouds", OLD),
        ] {
            let checked = LastCheck {
                link: link.into(),
                ..press("go", now)
            };
            assert_eq!(Shown::of(&checked, true, &times).class(), class, "{link}");
        }
    }
}
