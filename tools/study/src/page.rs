//! The study's results: tables in Markdown, errors as SVG, all samples as JSON.

use std::fmt::Write as _;
use std::path::Path;

use flankscope_bench::config::SurfaceKind;
use flankscope_foundation::files::write_whole;
use serde::Serialize;

use super::calibration::LENS_ERROR_UM;
use super::characteristic;
use super::chart::Frame;
use super::runs::{self, Counts};
use super::setup::{FLANKS_UM, word};
use super::staircase::{self, Profile};
use super::tally::{Share, percent, upper_bound};
use super::{Args, BlockReport, Cell, Group, Outcome, PointSigma, Sample, Subject};

/// Width and height of the plot, and its margins, px.
const SIZE: [f64; 2] = [640.0, 360.0];
const MARGIN: [f64; 2] = [60.0, 44.0];
/// Limits of the demo tool, µm.
const WARN_UM: f64 = 30.0;
const LIMIT_UM: f64 = 50.0;
/// True values from here on count as at the limit, µm: random shapes are scaled to it in floating point.
const AT_LIMIT_UM: f64 = LIMIT_UM - 1e-6;

/// Contents of `study.json`.
#[derive(Serialize)]
struct Document<'a> {
    commit: &'a str,
    command: String,
    seed: u64,
    captures_per_block: u32,
    blocks: &'a [BlockReport],
    rows: &'a [Cell],
}

/// Writes `README.md`, `errors.svg`, `characteristic.svg` if depths were drawn, `staircase.svg` and `study.json`.
pub(super) fn write(
    folder: &Path,
    outcome: &Outcome,
    plane: &[Profile; 2],
    args: &Args,
) -> anyhow::Result<()> {
    let document = Document {
        commit: &args.commit,
        command: command(args),
        seed: args.seed()?,
        captures_per_block: args.captures,
        blocks: &outcome.blocks,
        rows: &outcome.cells,
    };
    let runs = runs::append(args, counts(outcome))?;
    let page = Page {
        outcome,
        plane,
        args,
        runs,
    };
    write_whole(&folder.join("README.md"), page.markdown()?.as_bytes())?;
    write_whole(
        &folder.join("errors.svg"),
        errors(&outcome.cells)?.as_bytes(),
    )?;
    if let Some(picture) = characteristic::draw(&outcome.cells, [WARN_UM, LIMIT_UM])? {
        write_whole(&folder.join("characteristic.svg"), picture.as_bytes())?;
    }
    write_whole(
        &folder.join("staircase.svg"),
        staircase::draw(plane)?.as_bytes(),
    )?;
    write_whole(&folder.join("study.json"), &serde_json::to_vec(&document)?)?;
    Ok(())
}

pub(super) fn command(args: &Args) -> String {
    let Args {
        subject,
        blocks,
        captures,
        seed,
        only,
        surface,
        head,
        ..
    } = args;
    let head = head
        .as_ref()
        .map_or(String::new(), |head| format!(" --head {}", head.given));
    let surface = match surface {
        SurfaceKind::Sprayed => String::new(),
        bare => format!(" --surface {}", word(*bare)),
    };
    let patterns = args.patterns.as_ref();
    let patterns = patterns.map_or(String::new(), |set| format!(" --patterns {set}"));
    let rows = only
        .as_ref()
        .map_or(String::new(), |name| format!(" --only \"{name}\""));
    let size = match subject {
        Subject::Verdicts => format!(" --blocks {blocks} --captures {captures}"),
        Subject::Resolution => " resolution".to_owned(),
        Subject::Families => format!(" families --blocks {blocks} --captures {captures}"),
        Subject::Press => format!(" press --blocks {blocks} --captures {captures}"),
    };
    // Without one, the commit's.
    let seed = seed.map_or(String::new(), |seed| format!(" --seed {seed}"));
    format!("cargo xtask study{size}{seed}{head}{surface}{patterns}{rows}")
}

struct Page<'a> {
    outcome: &'a Outcome,
    plane: &'a [Profile; 2],
    args: &'a Args,
    /// Where the draws come from, and the runs before.
    runs: String,
}

impl Page<'_> {
    fn of(&self, group: Group) -> impl Iterator<Item = &Cell> {
        self.outcome.cells.iter().filter(move |c| c.group == group)
    }

    /// Samples of a damaged or sound flank that should get a verdict, relative to CAD or to a baseline.
    fn judged(&self, since: bool) -> impl Iterator<Item = &Sample> {
        let wanted = move |c: &&Cell| match c.group {
            Group::Drawn | Group::Built | Group::Characteristic => !since,
            Group::Baseline => since,
            Group::Spoiled | Group::Measure => false,
        };
        self.outcome
            .cells
            .iter()
            .filter(wanted)
            .flat_map(|c| &c.samples)
    }

    fn markdown(&self) -> Result<String, std::fmt::Error> {
        let mut text = String::new();
        self.head(&mut text)?;
        self.uncertainty(&mut text)?;
        self.rates(&mut text)?;
        text.push_str(&characteristic::section(
            &self.outcome.cells,
            [WARN_UM, LIMIT_UM],
        )?);
        self.hidden(&mut text)?;
        self.depths(&mut text)?;
        self.rest(&mut text)?;
        Ok(text)
    }

    fn head(&self, text: &mut String) -> std::fmt::Result {
        let blocks = self.outcome.blocks.len();
        let range = |of: fn(&PointSigma) -> f64| {
            let calibrated = |block: &BlockReport| block.calibrated.as_ref().map(of);
            let values = || self.outcome.blocks.iter().filter_map(calibrated);
            let [low, high] = [
                values().fold(f64::INFINITY, f64::min),
                values().fold(f64::NEG_INFINITY, f64::max),
            ];
            format!("{low:.2}–{high:.2}")
        };
        writeln!(
            text,
            "# How often the verdict is right\n\nMade by `{}` at commit `{}`.\n",
            command(self.args),
            self.args.commit
        )?;
        writeln!(
            text,
            "Raw frames are rendered through both fibre bundles with sensor noise, decoded, laid on CAD and judged by the \
             instrument's own code. What errors share is drawn once per *block*, of which there are {blocks}: a head with \
             cores, gains and lenses of its own (light astray by {LENS_ERROR_UM} µm rms as no distortion model does); **its own \
             calibration**, made on the bench from 13 views of the demo target by the code of `flankscope calibrate` (core map, \
             lenses, poses, hand-eye and residual fields; plates that lie as their certificate says, stages that err, noise); a \
             die of its own; one of eight teeth at one of three heights. The instrument takes the calibration's uncertainty from \
             that calibration's own record: {} µm along the view, {} µm across it. Every row is captured {} in every block \
             (captures that deserve no verdict, and single measures, in every fourth), each time approached anew (±15 mdeg, ±5 µm).\n",
            range(|b| b.depth_sigma_um),
            range(|b| b.lateral_sigma_um),
            match self.args.captures {
                1 => "once".to_owned(),
                n => format!("{n} times"),
            }
        )?;
        writeln!(
            text,
            "The head is *{}*. The dies are {}: light touches up to {} place(s) of them on its way. Patterns: `{}`.\n",
            self.outcome.head,
            match self.args.surface {
                SurfaceKind::Sprayed => "sprayed",
                SurfaceKind::Ground => "of bare ground steel (microfacets of roughness 0.3)",
                SurfaceKind::Polished =>
                    "of bare steel polished by use (microfacets of roughness 0.15)",
                SurfaceKind::Oiled => "of ground steel under oil",
            },
            self.args.surface.bounces(),
            self.outcome.patterns
        )?;
        let all = &self.outcome.blocks;
        let refused: Vec<&str> = all.iter().filter_map(|b| b.refused.as_deref()).collect();
        if !refused.is_empty() {
            writeln!(
                text,
                "The calibration of {} of {} heads was refused (\"{}\"): they judge nothing, and no rate below counts them.\n",
                refused.len(),
                all.len(),
                refused.join("\"; \""),
            )?;
        }
        writeln!(
            text,
            "Three dies: *drawn*, as its CAD; *built*, every flank off along the pitch circle by {FLANKS_UM:.2} µm (standard \
             deviation: pitches keep class 7 of ISO 1328-1 with three of them), which the tool states as `as_built_um`, in rows *by its class* as `as_built_class`; *since \
             new*, that die against a baseline of itself when new, by the same head. Slopes and forms of profiles as built, the \
             head's drift since the baseline (which the budget holds with 0.5 µm), and chord errors of the CAD are not \
             simulated; nor is the way between the processes, which changes no value. A rate's interval counts blocks: a block in \
             which it happened once or more is one hit (95 %, one-sided, Clopper and Pearson).\n\n{}",
            self.runs
        )
    }

    fn uncertainty(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "## What U95 is\n\n| judged | U95 / µm | root mean square error / µm | standard uncertainty by source / µm |\n|---|---|---|---|"
        )?;
        for cell in self.outcome.cells.iter().filter(|c| {
            ["undamaged", "uniform 50 µm", "random 50 µm"]
                .iter()
                .any(|what| c.name.ends_with(what))
        }) {
            let budget: Vec<String> = cell
                .budget_um
                .iter()
                .filter(|(_, um)| **um >= 0.005)
                .map(|(name, um)| format!("{name} {um:.2}"))
                .collect();
            writeln!(
                text,
                "| {} | {:.2} | {:.2} | {} |",
                cell.name,
                cell.u95_um(),
                cell.bias_um().hypot(cell.spread_um()),
                budget.join(", ")
            )?;
        }
        let held = |since| {
            let measured = self.judged(since).filter(|s| s.figure.is_some());
            let share = Share::of(measured, |s| !holds(s));
            format!(
                "{} of {} figures ({}; in {} of {} blocks at least one)",
                share.hits,
                share.of,
                percent(share.hits as f64 / share.of as f64),
                share.blocks_hit,
                share.blocks
            )
        };
        writeln!(
            text,
            "\nThe truth lies outside of U95 in {} against CAD, and in {} since a baseline. Nominal are 5 %.\n",
            held(false),
            held(true)
        )?;
        let missed = || {
            let all = self.judged(false).chain(self.judged(true));
            all.filter(|s| s.figure.is_some() && !holds(s))
        };
        let low = missed().filter(|s| s.figure.is_some_and(|f| f.value_um < s.truth_um));
        writeln!(
            text,
            "Of these {} figures {} are too low, and {} carry a go or warn. Two causes: the head looks along a flank, so the walls \
             of a narrow or deep hole hide part of its bottom, and a mean over what is left of the disc is too small by more than \
             U95 says; and of wear that a whole side has in common the pose takes a part (below). Of a damage with steep walls \
             the figure is a lower bound. What was not seen of a flank (holes, shadows, \
             narrow grooves) refuses it where it could hide too much; every pass that was wrong is counted below.\n",
            missed().count(),
            low.count(),
            missed().filter(|s| s.passed()).count()
        )?;
        text.push_str("![errors](errors.svg)\n\n");
        Ok(())
    }

    fn rates(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "## Wrong verdicts\n\nWarn {WARN_UM} µm, stop {LIMIT_UM} µm. Beyond or at the stop limit: all rows with such a \
             truth, the ones exactly at it among them.\n\n| | against CAD | since a baseline |\n|---|---|---|"
        )?;
        type Pick = fn(&Sample) -> bool;
        let rows: [(&str, Pick, Pick); 7] = [
            (
                "go at or beyond the stop limit",
                |s| s.truth_um >= AT_LIMIT_UM,
                |s| s.verdict == "go",
            ),
            (
                "go or warn exactly at the stop limit",
                |s| (s.truth_um - LIMIT_UM).abs() < 1e-6,
                Sample::passed,
            ),
            (
                "go or warn beyond the stop limit by 3 µm or more",
                |s| s.truth_um >= LIMIT_UM + 3.0,
                Sample::passed,
            ),
            (
                "indeterminate at or beyond the stop limit (no pass, but no stop either)",
                |s| s.truth_um >= AT_LIMIT_UM,
                |s| s.verdict == "indeterminate",
            ),
            (
                "go beyond the warning limit",
                |s| s.truth_um > WARN_UM,
                |s| s.verdict == "go",
            ),
            (
                "no-go below the warning limit",
                |s| s.truth_um < WARN_UM,
                |s| s.verdict == "no-go" && by_wear(s),
            ),
            (
                "false alarm: warn or no-go of a flank without damage",
                |s| s.truth_um == 0.0,
                Sample::alarmed,
            ),
        ];
        for (what, among, wrong) in rows {
            let of = |since| {
                let share = Share::of(self.judged(since).filter(|s| among(s)), wrong);
                if share.of == 0 {
                    return "–".to_owned();
                }
                format!(
                    "{} of {} flanks, in {} of {} blocks: at most {}",
                    share.hits,
                    share.of,
                    share.blocks_hit,
                    share.blocks,
                    percent(upper_bound(share.blocks_hit, share.blocks))
                )
            };
            writeln!(text, "| {what} | {} | {} |", of(false), of(true))?;
        }
        text.push('\n');
        Ok(())
    }

    fn hidden(&self, text: &mut String) -> std::fmt::Result {
        let deepest = |since| {
            self.judged(since)
                .filter(|s| s.verdict == "go")
                .map(|s| s.truth_um)
                .fold(0.0, f64::max)
        };
        let limit = |group| {
            let undamaged = self.of(group).find(|c| c.name.ends_with("undamaged"));
            let um = undamaged.map(Cell::detection_limit_um);
            um.map_or("–".to_owned(), |um| format!("{um:.1} µm"))
        };
        writeln!(
            text,
            "## The smallest damage that cannot hide\n\nJudged is the largest mean loss over any disc of 0.25 mm², 0.56 mm \
             across, whatever the damage's shape. Whatever covers such a disc anywhere in the zone is seen from {} on \
             against CAD of a die as built, from {} since a baseline (limit of detection, 5 % errors of both kinds). \
             A smaller spot counts by what is left of its depth over the disc: a tenth of the area must be ten times as deep; \
             single cells of 0.11 mm are judged against twice the limits beside that. The deepest truth that was go here: \
             {:.1} µm against CAD, {:.1} µm since a baseline.\n",
            limit(Group::Built),
            limit(Group::Baseline),
            deepest(false),
            deepest(true),
        )?;
        writeln!(
            text,
            "## What even wear presumes\n\nA view fixes its own pose by the flanks it sees. Wear that only some of them have shows in \
             full. What they all share, the pose takes for its own: of one side of all teeth worn alike the view alone cannot \
             tell a turned die, of a whole ring worn alike not a larger one. There the word of the stages is left, and with it \
             their uncertainty. So an even figure as good as in the table presumes that not all flanks in view are worn alike; \
             where they are, part of the wear is told of the sound side, the figure is low, and U95 grows (rows *one side of all \
             teeth* and *whole ring*): most such verdicts are indeterminate, and what the others are is in the rows.\n"
        )
    }

    fn depths(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "## Depth against truth\n\nThe truth is the figure itself, from the damage's closed form. *Random*: steps, ramps, \
             edges, spalls, bowls, scratches, band-limited fields and sums of them anywhere in the zone, scaled to that truth; \
             *spot*: a round hole anywhere in it. *Held*: figures whose U95 holds the truth.\n\n| damage | true / µm | bias / µm | sd / µm \
             | worst / µm | U95 / µm | held | detection limit / µm | go | warn | no-go | indeterminate |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
        )?;
        for group in [Group::Drawn, Group::Built, Group::Baseline] {
            for cell in self.of(group) {
                let [go, warn, no_go, open] = cell.verdicts();
                let held = cell.held();
                writeln!(
                    text,
                    "| {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {} of {} | {:.1} | {go} | {warn} | {no_go} | {open} |",
                    cell.name,
                    cell.truth_um(),
                    cell.bias_um(),
                    cell.spread_um(),
                    cell.worst_um(),
                    cell.u95_um(),
                    held.hits,
                    held.of,
                    cell.detection_limit_um(),
                )?;
            }
        }
        let mut why: std::collections::BTreeMap<&str, usize> = std::collections::BTreeMap::new();
        for sample in self.judged(false).chain(self.judged(true)) {
            if let Some(code) = &sample.code {
                *why.entry(code).or_default() += 1;
            }
        }
        let why: Vec<String> = why.iter().map(|(code, n)| format!("{code} {n}")).collect();
        writeln!(
            text,
            "\nReasons of the indeterminate ones: {}.\n",
            if why.is_empty() {
                "none".to_owned()
            } else {
                why.join(", ")
            }
        )
    }

    fn rest(&self, text: &mut String) -> std::fmt::Result {
        writeln!(
            text,
            "## Captures that deserve no verdict\n\n| capture | go | warn | no-go | indeterminate |\n|---|---|---|---|---|"
        )?;
        for cell in self.of(Group::Spoiled) {
            let [go, warn, no_go, open] = cell.verdicts();
            writeln!(text, "| {} | {go} | {warn} | {no_go} | {open} |", cell.name)?;
        }
        writeln!(
            text,
            "\n## With and without each measure\n\nOf a drawn die, against CAD.\n\n| capture | bias / µm | sd / µm | U95 / µm | held | standard uncertainty by source / µm |\n|---|---|---|---|---|---|"
        )?;
        let with = self
            .of(Group::Drawn)
            .filter(|c| c.name.ends_with("uniform 20 µm"));
        for cell in with.chain(self.of(Group::Measure)) {
            let budget: Vec<String> = cell
                .budget_um
                .iter()
                .filter(|(_, um)| **um >= 0.005)
                .map(|(name, um)| format!("{name} {um:.2}"))
                .collect();
            let held = cell.held();
            writeln!(
                text,
                "| {} | {:.2} | {:.2} | {:.2} | {} of {} | {} |",
                cell.name,
                cell.bias_um(),
                cell.spread_um(),
                cell.u95_um(),
                held.hits,
                held.of,
                budget.join(", "),
            )?;
        }
        let [pixels, cores] = self.plane;
        writeln!(
            text,
            "\n## A plane, pixel by pixel and core by core\n\nAll pixels of a core show its one phase: points made pixel by pixel \
             make steps of {:.1} µm rms on a plane across the head. From the same frames, a point per core: {:.1} µm rms. The \
             projector is blurred by 0.6 of its own cores' pitch here, so that they leave less than a micrometre.\n\n\
             ![plane](staircase.svg)",
            pixels.rms_um, cores.rms_um
        )
    }
}

/// Of all rows whose flanks should get a verdict.
fn counts(outcome: &Outcome) -> Counts {
    let cells = outcome.cells.iter();
    let judged = cells.filter(|c| !matches!(c.group, Group::Spoiled | Group::Measure));
    let all: Vec<&Sample> = judged.flat_map(|c| &c.samples).collect();
    let count = |among: &dyn Fn(&Sample) -> bool| all.iter().filter(|s| among(s)).count();
    let beyond = |s: &Sample| s.truth_um >= AT_LIMIT_UM;
    let sound = |s: &Sample| s.truth_um < WARN_UM;
    Counts {
        beyond: count(&beyond),
        beyond_go: count(&|s| beyond(s) && s.verdict == "go"),
        beyond_indeterminate: count(&|s| beyond(s) && s.verdict == "indeterminate"),
        sound: count(&sound),
        sound_go: count(&|s| sound(s) && s.verdict == "go"),
        claims: count(&|s| s.figure.is_some()),
        claims_missed: count(&|s| s.figure.is_some() && !holds(s)),
    }
}

fn holds(sample: &Sample) -> bool {
    sample
        .figure
        .is_some_and(|f| (f.value_um - sample.truth_um).abs() <= f.u95_um)
}

fn by_wear(sample: &Sample) -> bool {
    sample
        .reason
        .as_ref()
        .is_some_and(|why| why.starts_with("wear "))
}

/// Measured minus true value against the true value, each with its U95.
fn errors(cells: &[Cell]) -> Result<String, std::fmt::Error> {
    let ([width, height], [left, low]) = (SIZE, MARGIN);
    let groups = [
        (Group::Drawn, "drawn, against CAD", "#c47f00"),
        (Group::Built, "as built, against CAD", "#b2182b"),
        (Group::Baseline, "as built, since new", "#1f6fb2"),
    ];
    let figures = |group: Group| {
        let samples = cells.iter().filter(move |c| c.group == group);
        samples.flat_map(|c| &c.samples).filter_map(|s| {
            let figure = s.figure?;
            Some([s.truth_um, figure.value_um - s.truth_um, figure.u95_um])
        })
    };
    let all = || groups.iter().flat_map(|(group, ..)| figures(*group));
    let deepest = all().map(|p| p[0]).fold(1.0, f64::max);
    let largest = all().map(|p| p[1].abs()).fold(1.0, f64::max);
    let frame = Frame {
        size: SIZE,
        margin: MARGIN,
        reach_um: 5.0 * (largest / 5.0).ceil(),
    };
    let x = |um: f64| left + (width - 2.0 * left) * um / deepest;
    let y = |um: f64| frame.y(um);
    let mut svg = frame.begin(1)?;
    for um in [0.0, 20.0, 35.0, 50.0, 80.0] {
        write!(
            svg,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{um}</text>",
            x(um),
            height - low + 18.0
        )?;
    }
    write!(
        svg,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">true depth / µm; measured minus true, hollow where U95 does not hold it</text>",
        width / 2.0,
        height - 6.0
    )?;
    for (i, (group, name, colour)) in groups.into_iter().enumerate() {
        // Shifted sideways, so that all are visible.
        let aside = 3.0 * (i as f64 - 1.0);
        for [truth, error, u95] in figures(group) {
            let fill = if error.abs() <= u95 { colour } else { "white" };
            write!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2\" fill=\"{fill}\" stroke=\"{colour}\"/>",
                x(truth) + aside,
                y(error)
            )?;
        }
        write!(
            svg,
            "<text x=\"{}\" y=\"{}\" fill=\"{colour}\">{name}</text>",
            left + 4.0,
            14.0 + 14.0 * i as f64
        )?;
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}
