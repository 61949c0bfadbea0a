//! Resolution chart: openings of several widths and depths on the flanks of a die, and the instrument's verdict on each.

use std::fmt::Write as _;

use flankscope_bench::damage::Rectangle;
use flankscope_foundation::files::write_whole;
use flankscope_metrology::verdict::Word;
use flankscope_record::document::Feature;

use super::Args;
use super::capture::judged;
use super::families::{LIMIT_UM, WARN_UM};
use super::page::command;
use super::runs::{self, Counts};
use super::setup::{Setup, flank, on_all_cores, word as surface_word};
use super::stand::Stand;
use super::structure::{Plan, Section, Structure, cut};

const WIDTHS_MM: [f64; 5] = [0.02, 0.04, 0.08, 0.16, 0.32];
const DEPTHS_UM: [f64; 6] = [320.0, 160.0, 80.0, 40.0, 20.0, 10.0];
/// Ratio of the distance between neighbours to the width.
const GROOVE_PITCH: f64 = 1.75;
const PIT_PITCH: f64 = 1.25;
/// Number of identical heads that work in parallel.
const WORKERS: usize = 2;
/// Height of the area covered by adjacent openings, mm: three discs.
const COVERED_MM: f64 = 1.7;

/// One row of charts: a single opening, or several side by side.
struct Series {
    name: &'static str,
    plan: Plan,
    pitch_ratio: Option<f64>,
    /// It ends at the rim of the judged zone: at the end of the profile away from the base circle, or at the upper end of the height.
    is_at_rim: bool,
}

const SERIES: [Series; 7] = [
    Series {
        name: "one groove along the height",
        plan: Plan::Line(0.0),
        pitch_ratio: None,
        is_at_rim: false,
    },
    Series {
        name: "one scratch along the profile",
        plan: Plan::Line(std::f64::consts::FRAC_PI_2),
        pitch_ratio: None,
        is_at_rim: false,
    },
    Series {
        name: "one round pit",
        plan: Plan::Pit,
        pitch_ratio: None,
        is_at_rim: false,
    },
    Series {
        name: "grooves along the height, 1.75 widths apart",
        plan: Plan::Line(0.0),
        pitch_ratio: Some(GROOVE_PITCH),
        is_at_rim: false,
    },
    Series {
        name: "pits, 1.25 widths apart",
        plan: Plan::Pit,
        pitch_ratio: Some(PIT_PITCH),
        is_at_rim: false,
    },
    Series {
        name: "one groove along the height, at the zone's rim",
        plan: Plan::Line(0.0),
        pitch_ratio: None,
        is_at_rim: true,
    },
    Series {
        name: "one scratch along the profile, at the zone's rim",
        plan: Plan::Line(std::f64::consts::FRAC_PI_2),
        pitch_ratio: None,
        is_at_rim: true,
    },
];

/// Verdict on an opening, compared with the true value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    /// "Go" or "warn" although the true mean loss exceeds the stop limit.
    Passed,
    /// "Go" between the limits, where "warn" would be right.
    Late,
    /// "Warn" or "no-go".
    Seen,
    /// Indeterminate.
    Refused,
    /// "Go" below the warning limit.
    Go,
}

impl Outcome {
    const ALL: [Self; 5] = [
        Self::Passed,
        Self::Late,
        Self::Seen,
        Self::Refused,
        Self::Go,
    ];

    fn of(word: Word, truth_um: f64) -> Self {
        match word {
            Word::Go | Word::Warn if truth_um > LIMIT_UM => Self::Passed,
            Word::Go if truth_um > WARN_UM => Self::Late,
            Word::Go => Self::Go,
            Word::Warn | Word::NoGo => Self::Seen,
            Word::Indeterminate => Self::Refused,
        }
    }

    fn colour(self) -> &'static str {
        match self {
            Self::Passed => "#d7191c",
            Self::Late => "#f7a8b8",
            Self::Seen => "#f0b43c",
            Self::Refused => "#b8c4d0",
            Self::Go => "#9ed48a",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Passed => "go or warn beyond the stop limit",
            Self::Late => "go between the limits",
            Self::Seen => "warn or no-go",
            Self::Refused => "indeterminate",
            Self::Go => "go below the warning limit",
        }
    }
}

/// One field of the chart.
struct Field {
    series: usize,
    width: usize,
    depth: usize,
    truth_um: f64,
    found: Feature,
}

impl Field {
    fn outcome(&self) -> Outcome {
        Outcome::of(self.found.verdict, self.truth_um)
    }

    /// Whether the stated interval or lower bound contains the true value; true if nothing is stated.
    fn holds(&self) -> bool {
        let um = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let bound = self.found.at_least_um.is_none_or(|um| um <= self.truth_um);
        let off_um = (um(self.found.wear_um) - self.truth_um).abs();
        let interval = self.found.u95_um.is_none_or(|u95| off_um <= u95);
        bound && (interval || self.found.verdict == Word::Indeterminate)
    }
}

/// Captures all fields of the chart, two openings at a time.
fn measure(args: &Args) -> anyhow::Result<Vec<Field>> {
    let setup =
        Setup::load(args.head.as_ref())?.with_surface(args.surface, args.patterns.as_deref());
    let wanted = |series: &usize| {
        let only = args.only.as_ref();
        only.is_none_or(|text| SERIES[*series].name.contains(text))
    };
    let fields: Vec<[usize; 3]> = (0..SERIES.len())
        .filter(wanted)
        .flat_map(|series| {
            let depths = move |width| (0..DEPTHS_UM.len()).map(move |depth| [series, width, depth]);
            (0..WIDTHS_MM.len()).flat_map(depths)
        })
        .collect();
    let part = fields.len().div_ceil(2 * WORKERS) * 2;
    let parts: Vec<&[[usize; 3]]> = fields.chunks(part).collect();
    let found = on_all_cores(parts.len() as u32, |number| {
        // The same head is used for all openings.
        let mut stand = Stand::new(&setup, 0, args.seed()?, false)?;
        let mut found = Vec::new();
        for (pair, number) in parts[number as usize].chunks(2).zip((number << 12)..) {
            let flanks = stand.flanks();
            let cuts: Vec<_> = flanks
                .into_iter()
                .zip(pair)
                .map(|(id, at)| (id, structure(stand.judged, *at)))
                .collect();
            let outcome = stand.look(cut(stand.gear(), &cuts), number)?;
            for ((id, opening), &[series, width, depth]) in cuts.iter().zip(pair) {
                found.push(Field {
                    series,
                    width,
                    depth,
                    truth_um: opening.largest_mean_um(stand.judged, stand.disc_area_mm2),
                    found: judged(&outcome, flank(id.flank))?,
                });
                if let Some(field) = found.last() {
                    eprintln!(
                        "{}, {} mm wide, {} µm deep: true {:.1} µm, found {:?} ± {:?} (at least {:?}): {}{}",
                        SERIES[series].name,
                        WIDTHS_MM[width],
                        DEPTHS_UM[depth],
                        field.truth_um,
                        field.found.wear_um,
                        field.found.u95_um,
                        field.found.at_least_um,
                        field.found.verdict,
                        if field.holds() { "" } else { ", DOES NOT HOLD" },
                    );
                }
            }
        }
        Ok(found)
    })?;
    Ok(found.into_iter().flatten().collect())
}

fn structure(judged: Rectangle, [series, width, depth]: [usize; 3]) -> Structure {
    let (series, width_mm) = (&SERIES[series], WIDTHS_MM[width]);
    let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
    let mut at_mm = [middle(judged.profile_mm), middle(judged.height_mm)];
    match series.plan {
        Plan::Line(0.0) if series.is_at_rim => at_mm[0] = judged.profile_mm[1] - 0.5 * width_mm,
        _ if series.is_at_rim => at_mm[1] = judged.height_mm[1] - 0.5 * width_mm,
        _ => {}
    }
    let height_mm = match (series.plan, series.pitch_ratio) {
        // Along the whole height.
        (Plan::Line(0.0), None) => judged.height_mm,
        (_, None) => [
            at_mm[1] - width_mm,
            (at_mm[1] + width_mm).min(judged.height_mm[1]),
        ],
        (_, Some(_)) => [at_mm[1] - 0.5 * COVERED_MM, at_mm[1] + 0.5 * COVERED_MM],
    };
    Structure {
        plan: series.plan,
        section: Section::Flat,
        width_mm,
        pitch_mm: series.pitch_ratio.map(|ratio| ratio * width_mm),
        depth_mm: 1e-3 * DEPTHS_UM[depth],
        at_mm,
        within: Rectangle {
            height_mm,
            ..judged
        },
    }
}

/// Of all fields.
fn counts(fields: &[&Field]) -> Counts {
    let count = |among: &dyn Fn(&Field) -> bool| fields.iter().filter(|f| among(f)).count();
    let beyond = |f: &Field| f.truth_um > LIMIT_UM;
    let is = |f: &Field, word| f.found.verdict == word;
    let claims = |f: &Field| f.found.at_least_um.is_some() || f.found.u95_um.is_some();
    Counts {
        beyond: count(&beyond),
        beyond_go: count(&|f| beyond(f) && is(f, Word::Go)),
        beyond_indeterminate: count(&|f| beyond(f) && is(f, Word::Indeterminate)),
        sound: count(&|f| f.truth_um < WARN_UM),
        sound_go: count(&|f| f.truth_um < WARN_UM && is(f, Word::Go)),
        claims: count(&claims),
        claims_missed: count(&|f| !f.holds()),
    }
}

/// Captures the chart; writes `resolution.md` and `resolution.svg`.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let charts = [(surface_word(args.surface), measure(args)?)];
    write_whole(&args.out.join("resolution.svg"), draw(&charts)?.as_bytes())?;
    let fields: Vec<&Field> = charts.iter().flat_map(|(_, fields)| fields).collect();
    let page = page(&charts, args)? + "\n" + &runs::append(args, counts(&fields))?;
    write_whole(&args.out.join("resolution.md"), page.as_bytes())?;
    Ok(())
}

/// Side of a field, margins, px.
const FIELD: [f64; 2] = [46.0, 24.0];
const LEFT: f64 = 64.0;
const TOP: f64 = 56.0;
const BETWEEN: [f64; 2] = [84.0, 62.0];

fn draw(charts: &[(&str, Vec<Field>)]) -> Result<String, std::fmt::Error> {
    let size = [
        FIELD[0] * WIDTHS_MM.len() as f64,
        FIELD[1] * DEPTHS_UM.len() as f64,
    ];
    let (width, height) = (
        LEFT + charts.len() as f64 * (size[0] + BETWEEN[0]),
        TOP + SERIES.len() as f64 * (size[1] + BETWEEN[1]) + 30.0,
    );
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\" font-size=\"11\">\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>"
    );
    for (i, outcome) in Outcome::ALL.into_iter().enumerate() {
        let x = 12.0 + 152.0 * i as f64;
        write!(
            svg,
            "<rect x=\"{x}\" y=\"10\" width=\"12\" height=\"12\" fill=\"{}\"/><text x=\"{}\" y=\"20\" font-size=\"10\">{}</text>",
            outcome.colour(),
            x + 16.0,
            outcome.name()
        )?;
    }
    for (column, (surface, fields)) in charts.iter().enumerate() {
        let left = LEFT + column as f64 * (size[0] + BETWEEN[0]);
        for (row, series) in SERIES.iter().enumerate() {
            let top = TOP + row as f64 * (size[1] + BETWEEN[1]);
            write!(
                svg,
                "<text x=\"{left}\" y=\"{}\" font-weight=\"bold\">{surface}: {}</text>",
                top - 6.0,
                series.name
            )?;
            for (i, um) in DEPTHS_UM.iter().enumerate() {
                write!(
                    svg,
                    "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{um} µm</text>",
                    left - 5.0,
                    top + FIELD[1] * (i as f64 + 0.66)
                )?;
            }
            for (i, mm) in WIDTHS_MM.iter().enumerate() {
                write!(
                    svg,
                    "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{mm}</text>",
                    left + FIELD[0] * (i as f64 + 0.5),
                    top + size[1] + 14.0
                )?;
            }
            write!(
                svg,
                "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\" font-size=\"10\">width / mm; up: depth; in the fields: true mean loss / µm</text>",
                left + 0.5 * size[0],
                top + size[1] + 28.0
            )?;
            for field in fields.iter().filter(|f| f.series == row) {
                let [x, y] = [
                    left + FIELD[0] * field.width as f64,
                    top + FIELD[1] * field.depth as f64,
                ];
                write!(
                    svg,
                    "<rect x=\"{x}\" y=\"{y}\" width=\"{}\" height=\"{}\" fill=\"{}\" stroke=\"white\"/>\
                     <text x=\"{}\" y=\"{}\" text-anchor=\"middle\" font-size=\"10\">{:.1}</text>",
                    FIELD[0],
                    FIELD[1],
                    field.outcome().colour(),
                    x + 0.5 * FIELD[0],
                    y + 0.66 * FIELD[1],
                    field.truth_um
                )?;
            }
        }
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// Limits of what the chart shows.
const NO_EVIDENCE: &str = "## What no evidence shows\n\n\
    * Openings narrower than some 0.03 mm: no point comes from their floors, and the rays that end on their walls scatter no more \
    than a rough surface does. Side by side only the light tells them: walls that face the lamp come back brighter. Where that is \
    not so (a red field), the limits of wear must leave room for such texture, or it must be looked for by eye.\n\
    * Single openings read as nearly nothing where they are narrower than two of the camera's cores see; as long as their true mean \
    over the disc is below the limits, go is right, but the figure is then too low by more than U95.\n\
    * The bench gives a core one line of sight. A real core sees some 0.03 mm across, so that finer texture is averaged before \
    anything scatters, and its light with it: the fields at 0.02 mm hold for the bench alone.\n\
    * One head, one place (tooth 40, the middle of the die), steep walls and flat floors, one capture a field: round and V-shaped \
    ones at any angle are in [families](families.md).\n";

fn page(charts: &[(&str, Vec<Field>)], args: &Args) -> Result<String, std::fmt::Error> {
    let mut text = format!(
        "# What the instrument resolves\n\nMade by `{}` at commit `{}`.\n\n\
         Openings with steep walls and a flat floor are cut into the flanks of a die, as a mesh; raw frames are rendered through both \
         fibre bundles, decoded, laid on CAD and judged by the instrument's own code, with the head calibrated on the bench. The \
         demo tool judges the largest mean loss over any disc of 0.25 mm² (0.56 mm across): warn {WARN_UM} µm, stop {LIMIT_UM} µm. The \
         number in each field is the *true* value of that, so a narrow opening may be deep and still rightly go.\n\n\
         ![resolution](resolution.svg)\n\n\
         | surface | opening | {} |\n|---|---|{}\n",
        command(args),
        args.commit,
        Outcome::ALL.map(Outcome::name).join(" | "),
        "---|".repeat(Outcome::ALL.len()),
    );
    for (surface, fields) in charts {
        for (row, series) in SERIES.iter().enumerate() {
            let count = |outcome| {
                let of = fields.iter().filter(|f| f.series == row);
                of.filter(|f| f.outcome() == outcome).count().to_string()
            };
            let counts = Outcome::ALL.map(count).join(" | ");
            writeln!(text, "| {surface} | {} | {counts} |", series.name)?;
        }
    }
    text.push_str("\n## The smallest that is not passed unseen\n\n");
    text.push_str(
        "By width, the least depth from which on, at this width, every field is warn, no-go or indeterminate (a dash: none of these \
         depths), and the deepest that is go:\n\n",
    );
    let head: Vec<String> = WIDTHS_MM.iter().map(|mm| format!("{mm} mm")).collect();
    writeln!(
        text,
        "| surface | opening | {} |\n|---|---|{}",
        head.join(" | "),
        "---|".repeat(WIDTHS_MM.len())
    )?;
    for (surface, fields) in charts {
        for (row, series) in SERIES.iter().enumerate() {
            let by_width = |width: usize| {
                let of: Vec<&Field> = fields
                    .iter()
                    .filter(|f| f.series == row && f.width == width)
                    .collect();
                let stopped = of
                    .iter()
                    .take_while(|f| f.found.verdict != Word::Go)
                    .last()
                    .map(|f| format!("{} µm", DEPTHS_UM[f.depth]));
                let gone = of
                    .iter()
                    .find(|f| f.found.verdict == Word::Go)
                    .map(|f| format!("{} µm", DEPTHS_UM[f.depth]));
                let word = |um: Option<String>| um.unwrap_or_else(|| "–".into());
                format!("from {}; go {}", word(stopped), word(gone))
            };
            let all: Vec<String> = (0..WIDTHS_MM.len()).map(by_width).collect();
            writeln!(
                text,
                "| {surface} | {} | {} |",
                series.name,
                all.join(" | ")
            )?;
        }
    }
    let all = || charts.iter().flat_map(|(_, fields)| fields);
    let broken = all().filter(|f| !f.holds()).count();
    let codes = all().filter_map(|f| f.found.code);
    let mut why: std::collections::BTreeMap<&str, usize> = std::collections::BTreeMap::new();
    for code in codes {
        *why.entry(code.word()).or_default() += 1;
    }
    let why: Vec<String> = why.iter().map(|(code, n)| format!("{code} {n}")).collect();
    writeln!(
        text,
        "\nOf {} fields the claim (U95 of a judged flank, or `at_least_um`) does not hold in {broken}. Reasons of the indeterminate \
         ones: {}.\n",
        all().count(),
        why.join(", ")
    )?;
    text.push_str(NO_EVIDENCE);
    Ok(text)
}
