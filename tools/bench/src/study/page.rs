//! The study as a page: tables in Markdown, the detection curve as SVG, all samples as JSON.

use std::fmt::Write as _;
use std::path::Path;

use flankscope_station::files::write_whole;

use super::staircase::{self, Profile};
use super::{Args, Cell, Group, Outcome};
use crate::world::WearKind;

/// Width and height of the plot, and its margins, px.
const SIZE: [f64; 2] = [640.0, 320.0];
const MARGIN: [f64; 2] = [56.0, 40.0];

/// Coverage that is aimed at.
const AIM: [f64; 2] = [0.93, 0.97];

/// Writes `README.md`, `detection.svg`, `staircase.svg` and `study.json`.
pub(super) fn write(
    folder: &Path,
    outcome: &Outcome,
    plane: &[Profile; 2],
    args: &Args,
) -> anyhow::Result<()> {
    let cells = &outcome.cells[..];
    write_whole(
        &folder.join("README.md"),
        markdown(outcome, plane, args)?.as_bytes(),
    )?;
    write_whole(&folder.join("detection.svg"), detection(cells)?.as_bytes())?;
    write_whole(
        &folder.join("staircase.svg"),
        staircase::draw(plane)?.as_bytes(),
    )?;
    write_whole(&folder.join("study.json"), &serde_json::to_vec(cells)?)?;
    Ok(())
}

fn markdown(
    outcome: &Outcome,
    [pixels, cores]: &[Profile; 2],
    args: &Args,
) -> Result<String, std::fmt::Error> {
    let Outcome {
        stated_um: [calibration_um, drift_um],
        cells,
    } = outcome;
    let mut text = String::new();
    let Args {
        captures,
        seed,
        only,
        ..
    } = args;
    writeln!(text, "# How often the verdict is right\n")?;
    let rows = only
        .as_ref()
        .map_or(String::new(), |name| format!(" --only \"{name}\""));
    writeln!(
        text,
        "Made by `cargo xtask study --captures {captures} --seed {seed}{rows}`.\n"
    )?;
    writeln!(
        text,
        "A row is {captures} captures of tooth 40 of the demo die (of the rows about single measures a fifth, of those since a \
         baseline half): raw frames rendered through both fibre bundles with sensor noise, decoded, laid on CAD and judged by the \
         instrument's own code. Captures come in blocks of eight: two stage positions, drawn from ±15 mdeg and ±5 µm, each seen \
         by four calibrations, drawn with errors of 0.03 px in principal points, focal lengths and distortion of both lenses; \
         noise is drawn for each. Uniform wear and tip rounding, pit and built-up material of the same size are on the two \
         flanks of one tooth and share captures. Left out: the way between the processes, which changes no value, and the other \
         teeth. Chord errors of the CAD do not act here and are not in the budget: the die is made of its very facets.\n"
    )?;
    writeln!(
        text,
        "What those calibrations leave of a depth was evaluated first, on undamaged flanks, by 40 draws of its own: \
         {calibration_um:.2} µm, and {drift_um:.2} µm for the drift of 0.01 px between a baseline and a later check (root mean \
         square). These the instrument was told; all other parts of its budget it finds itself.\n\n## Depth against \
         truth\n\nThe truth is that of the figure itself: the 99.5 % percentile over the zone's cells of 0.25 mm, from the \
         damage's closed form. U95 is what the instrument states, coverage how often its interval holds the truth, with \
         what these captures can tell of that (95 %, Wilson, with blocks that differ counted as fewer captures). Detected: at or beyond the stated detection \
         limit. Warn 30 µm, stop 50 µm.\n"
    )?;
    writeln!(
        text,
        "| damage | true / µm | bias / µm | sd / µm | U95 / µm | coverage | detection limit / µm | detected | go | warn | no-go | indeterminate |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    )?;
    for cell in cells.iter().filter(|c| c.group == Group::Wear) {
        let [go, warn, no_go, open] = cell.shares().map(percent);
        writeln!(
            text,
            "| {} | {:.2} | {:.2} | {:.2} | {:.2} | {} | {:.1} | {} | {go} | {warn} | {no_go} | {open} |",
            cell.name,
            cell.truth_um,
            cell.bias_um(),
            cell.spread_um(),
            cell.u95_um(),
            coverage(cell),
            cell.detection_limit_um(),
            percent(cell.detected()),
        )?;
    }
    text.push_str(&rates(cells)?);
    writeln!(
        text,
        "\n![detection curve](detection.svg)\n\n## Captures that deserve no verdict\n\n| capture | go | warn | no-go | indeterminate |\n|---|---|---|---|---|"
    )?;
    for cell in cells.iter().filter(|c| c.group == Group::Spoiled) {
        let [go, warn, no_go, open] = cell.shares().map(percent);
        writeln!(text, "| {} | {go} | {warn} | {no_go} | {open} |", cell.name)?;
    }
    writeln!(
        text,
        "\n## With and without each measure\n\n| capture | bias / µm | sd / µm | U95 / µm | coverage | detection limit / µm | standard uncertainty by source / µm |\n|---|---|---|---|---|---|---|"
    )?;
    for cell in cells.iter().filter(|c| c.group == Group::Measure) {
        let budget: Vec<String> = cell
            .budget_um
            .iter()
            .map(|(name, um)| format!("{name} {um:.2}"))
            .collect();
        writeln!(
            text,
            "| {} | {:.2} | {:.2} | {:.2} | {} | {:.1} | {} |",
            cell.name,
            cell.bias_um(),
            cell.spread_um(),
            cell.u95_um(),
            coverage(cell),
            cell.detection_limit_um(),
            budget.join(", "),
        )?;
    }
    writeln!(
        text,
        "\n## A plane, pixel by pixel and core by core\n\nAll pixels of a core show its one phase: points made pixel by pixel \
         make steps of {:.1} µm rms on a plane across the head. From the same frames, a point per core: {:.1} µm rms. The \
         projector is blurred by 0.6 of its own cores' pitch here, so that they leave less than a micrometre.\n\n\
         ![plane](staircase.svg)",
        pixels.rms_um, cores.rms_um
    )?;
    Ok(text)
}

fn coverage(cell: &Cell) -> String {
    let [low, high] = cell.coverage_interval().map(|end| 100.0 * end);
    format!("{} ({low:.1}–{high:.1})", percent(cell.coverage()))
}

/// What the rows say of wrong verdicts, and of coverage as a whole.
fn rates(cells: &[Cell]) -> Result<String, std::fmt::Error> {
    let mut text = String::from("\n");
    let mut rate = |what: &str, name: &str, wrong: fn(&Cell) -> u32| {
        let of = cells.iter().filter(|cell| cell.name.starts_with(name));
        let (wrong, captures) = of.fold((0, 0), |(w, n), c| (w + wrong(c), n + c.captures));
        if captures == 0 {
            return Ok(());
        }
        writeln!(
            text,
            "{what}: {wrong} of {captures}, a rate of at most {} (95 %, exact binomial).\n",
            percent(upper_bound(wrong, captures))
        )
    };
    let passed = |cell: &Cell| cell.verdicts[0] + cell.verdicts[1];
    rate("False go or warn at 50 µm exactly", "uniform 50 µm", passed)?;
    rate(
        "False go or warn just beyond, at 50.2 µm",
        "uniform 50.2 µm",
        passed,
    )?;
    rate(
        "False alarm (warn or no-go) of undamaged flanks",
        "undamaged",
        |cell| cell.verdicts[1] + cell.verdicts[2],
    )?;
    let worn = || cells.iter().filter(|c| c.group == Group::Wear);
    let named = |beyond: fn([f64; 2]) -> bool| {
        let rows = worn().filter(|cell| beyond(cell.coverage_interval()));
        let rows: Vec<String> = rows
            .map(|cell| {
                let [u95, error] = [cell.u95_um(), 1.96 * cell.error_um()];
                format!("{} ({u95:.2}; {error:.2})", cell.name)
            })
            .collect();
        rows
    };
    let careful = named(|[low, _]| low > AIM[1]);
    let sure = named(|[_, high]| high < AIM[0]);
    let all = worn().count();
    writeln!(
        text,
        "Of {all} rows, {} agree with a coverage of 93–97 %, as far as their captures can tell.",
        all - careful.len() - sure.len()
    )?;
    if !careful.is_empty() {
        writeln!(
            text,
            "\nCovered more often (in brackets U95 and what the errors call for, 1.96 times their root mean square, µm): {}. One \
             row in twenty does so by chance; in the others wear has a slope. Within a cell its shape adds to the scatter that noise is told from, and what \
             neighbouring cores may pass on to it is counted by its possible amount; where that shows as a bias that is the \
             same in every capture and smaller than U95, the interval always holds.",
            careful.join(", ")
        )?;
    }
    if !sure.is_empty() {
        writeln!(
            text,
            "\nCovered less often (likewise): {}.",
            sure.join(", ")
        )?;
    }
    Ok(text)
}

/// Upper end of the one-sided 95 % interval for a rate of which `hits` of `all` were seen (Clopper and Pearson 1934).
fn upper_bound(hits: u32, all: u32) -> f64 {
    // Probability of at most that many, summed from the likeliest way down to none by ratios of neighbours.
    let at_most = |rate: f64| {
        let mut term = f64::from(all) * (1.0 - rate).ln();
        let mut sum = term.exp();
        for k in 0..hits {
            term += (f64::from(all - k) / f64::from(k + 1)).ln() + (rate / (1.0 - rate)).ln();
            sum += term.exp();
        }
        sum
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if at_most(middle) > 0.05 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

fn percent(share: f64) -> String {
    if share.is_finite() {
        format!("{:.1} %", 100.0 * share)
    } else {
        "–".into()
    }
}

/// Share detected over true depth, per kind of damage, depth on a root scale.
fn detection(cells: &[Cell]) -> Result<String, std::fmt::Error> {
    let ([width, height], [left, low]) = (SIZE, MARGIN);
    let deepest = cells.iter().map(|c| c.truth_um).fold(1.0, f64::max);
    let x = |um: f64| left + (width - 2.0 * left) * (um.max(0.0) / deepest).sqrt();
    let y = |share: f64| height - low - (height - 2.0 * low) * share;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"system-ui, sans-serif\" font-size=\"12\">\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>"
    );
    for share in [0.0, 0.5, 1.0] {
        let at = y(share);
        write!(
            svg,
            "<line x1=\"{left}\" x2=\"{}\" y1=\"{at}\" y2=\"{at}\" stroke=\"#d8dde2\"/><text x=\"8\" y=\"{}\">{:.0} %</text>",
            width - left,
            at + 4.0,
            100.0 * share
        )?;
    }
    for um in [0.0, 3.0, 5.0, 10.0, 20.0, 50.0, 80.0] {
        write!(
            svg,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{um}</text>",
            x(um),
            height - low + 18.0
        )?;
    }
    write!(
        svg,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">true depth / µm</text>",
        width / 2.0,
        height - 6.0
    )?;
    for (i, (kind, name, colour)) in [
        (WearKind::Uniform, "uniform", "#1f6fb2"),
        (WearKind::Tip, "tip edge", "#c47f00"),
        (WearKind::Pit, "pit of 1 mm²", "#b2182b"),
        (WearKind::Buildup, "built-up", "#1f7a3d"),
    ]
    .into_iter()
    .enumerate()
    {
        let of_kind = |c: &&Cell| c.group == Group::Wear && c.kind.is_none_or(|k| k == kind);
        let mut points: Vec<(f64, f64)> = cells
            .iter()
            .filter(of_kind)
            .map(|c| (c.truth_um, c.detected()))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let line: Vec<String> = points
            .iter()
            .map(|&(um, share)| format!("{:.1},{:.1}", x(um), y(share)))
            .collect();
        write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            line.join(" ")
        )?;
        write!(
            svg,
            "<text x=\"{}\" y=\"{}\" fill=\"{colour}\">{name}</text>",
            width - left - 90.0,
            height - low - 60.0 + 18.0 * i as f64
        )?;
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::upper_bound;

    #[test]
    fn bounds_of_rates_are_those_of_the_tables() {
        // None of n: 1 - 0.05^(1/n). Five of 100: 10.225 % (Clopper and Pearson's tables).
        assert!((upper_bound(0, 200) - (1.0 - 0.05_f64.powf(1.0 / 200.0))).abs() < 1e-9);
        assert!((upper_bound(5, 100) - 0.10225).abs() < 1e-4);
        assert!((upper_bound(3, 3) - 1.0).abs() < 1e-9);
    }
}
