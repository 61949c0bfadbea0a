//! The operating characteristic: shares of the four verdicts over the true depth, of flanks whose depth was drawn.

use std::fmt::{Error, Write as _};

use super::cases::DEEPEST_UM;
use super::chart::sheet;
use super::tally::{Share, percent, upper_bound};
use super::{Cell, Group, Sample};

/// Width of a bin of true depths, µm.
const BIN_UM: f64 = 10.0;
/// Verdicts from below to above, and their colours.
const VERDICTS: [(&str, &str); 4] = [
    ("go", "#3a9a4e"),
    ("warn", "#e3b505"),
    ("no-go", "#b2182b"),
    ("indeterminate", "#c9cdd2"),
];
/// Width and height of the drawing and margins, px.
const SIZE: [f64; 2] = [640.0, 320.0];
const LEFT: f64 = 60.0;
const TOP: f64 = 42.0;
const BOTTOM: f64 = 50.0;

/// Flanks of one bin of true depths.
struct Bin<'a> {
    from_um: f64,
    samples: Vec<&'a Sample>,
}

impl Bin<'_> {
    fn share(&self, verdict: &str) -> Share {
        Share::of(self.samples.iter().copied(), |s| s.verdict == verdict)
    }
}

fn bins<'a>(cells: impl Iterator<Item = &'a Cell>) -> Vec<Bin<'a>> {
    let mut bins: Vec<Bin<'a>> = (0..(DEEPEST_UM / BIN_UM).ceil() as usize)
        .map(|at| Bin {
            from_um: BIN_UM * at as f64,
            samples: Vec::new(),
        })
        .collect();
    for sample in cells.flat_map(|cell| &cell.samples) {
        let at = (sample.truth_um / BIN_UM) as usize;
        if let Some(bin) = bins.get_mut(at) {
            bin.samples.push(sample);
        }
    }
    bins
}

/// All rows whose depth was drawn.
fn drawn(cells: &[Cell]) -> impl Iterator<Item = &Cell> {
    cells
        .iter()
        .filter(|cell| cell.group == Group::Characteristic)
}

/// The section of the page; empty where no depth was drawn.
pub(super) fn section(cells: &[Cell], limits_um: [f64; 2]) -> Result<String, Error> {
    let mut text = String::new();
    if none_drawn(cells) {
        return Ok(text);
    }
    let [warn_um, limit_um] = limits_um;
    writeln!(
        text,
        "## What a flank gets, by its true depth\n\nDepths drawn uniformly from 0 to {DEEPEST_UM} µm for every capture, of dies as built, \
         against CAD. Warn {warn_um} µm, stop {limit_um} µm. The black line is the upper bound of the rate of go (one-sided 95 %, Clopper \
         and Pearson, of blocks).\n\n![operating characteristic](characteristic.svg)\n"
    )?;
    for cell in drawn(cells) {
        writeln!(
            text,
            "*{}*\n\n| true depth / µm | flanks | blocks | go | warn | no-go | indeterminate | P(go) at most |\n|---|---|---|---|---|---|---|---|",
            cell.name
        )?;
        for bin in bins([cell].into_iter()) {
            let [go, warn, no_go, open] = VERDICTS.map(|(verdict, _)| bin.share(verdict));
            let bound = match go.blocks {
                0 => "–".to_owned(),
                _ => percent(upper_bound(go.blocks_hit, go.blocks)),
            };
            writeln!(
                text,
                "| {} to {} | {} | {} | {} | {} | {} | {} | {bound} |",
                bin.from_um,
                bin.from_um + BIN_UM,
                go.of,
                go.blocks,
                go.hits,
                warn.hits,
                no_go.hits,
                open.hits
            )?;
        }
        text.push('\n');
    }
    Ok(text)
}

fn none_drawn(cells: &[Cell]) -> bool {
    drawn(cells).all(|cell| cell.samples.is_empty())
}

/// The picture of all rows whose depth was drawn; `None` without any.
pub(super) fn draw(cells: &[Cell], limits_um: [f64; 2]) -> Result<Option<String>, Error> {
    if none_drawn(cells) {
        return Ok(None);
    }
    let [width, height] = SIZE;
    let x = |um: f64| LEFT + (width - 2.0 * LEFT) * um / DEEPEST_UM;
    let y = |share: f64| height - BOTTOM - (height - BOTTOM - TOP) * share;
    let mut svg = sheet(SIZE);
    for percent in [0, 25, 50, 75, 100] {
        write!(
            svg,
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{percent} %</text>",
            LEFT - 6.0,
            y(f64::from(percent) / 100.0) + 4.0
        )?;
    }
    for bin in bins(drawn(cells)) {
        let [left, right] = [bin.from_um, bin.from_um + BIN_UM].map(x);
        let mut below = 0.0;
        for (verdict, colour) in VERDICTS {
            let share = bin.share(verdict);
            if share.hits == 0 {
                continue;
            }
            let above = below + share.hits as f64 / share.of as f64;
            write!(
                svg,
                "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{colour}\"/>",
                left + 1.0,
                y(above),
                right - left - 2.0,
                y(below) - y(above)
            )?;
            below = above;
        }
        let go = bin.share("go");
        if go.blocks > 0 {
            let at = y(upper_bound(go.blocks_hit, go.blocks));
            write!(
                svg,
                "<line x1=\"{left:.1}\" x2=\"{right:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"black\" stroke-width=\"2\"/>"
            )?;
        }
        write!(
            svg,
            "<text x=\"{right:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            y(0.0) + 16.0,
            bin.from_um + BIN_UM
        )?;
    }
    for (um, word) in limits_um.into_iter().zip(["warn", "stop"]) {
        write!(
            svg,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{:.1}\" y2=\"{:.1}\" stroke=\"black\" stroke-dasharray=\"4 3\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{word}</text>",
            y(1.0),
            y(0.0),
            y(1.0) - 4.0,
            at = x(um),
        )?;
    }
    let mut at = LEFT;
    for (verdict, colour) in VERDICTS {
        write!(
            svg,
            "<rect x=\"{at}\" y=\"6\" width=\"10\" height=\"10\" fill=\"{colour}\"/><text x=\"{}\" y=\"15\">{verdict}</text>",
            at + 14.0
        )?;
        at += 34.0 + 7.0 * verdict.len() as f64;
    }
    writeln!(
        svg,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">true depth / µm; share of the verdicts, and the upper bound of go</text></svg>",
        width / 2.0,
        height - 10.0
    )?;
    Ok(Some(svg))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flanks_are_counted_where_their_truth_lies_and_bounds_count_blocks() {
        let mut cell = Cell::new("uniform, depth drawn".into(), Group::Characteristic);
        for (block, truth_um, verdict) in [
            (0, 0.0, "go"),
            (1, 9.99, "go"),
            (1, 10.0, "warn"),
            (2, 119.9, "no-go"),
            (3, 119.0, "go"),
            (3, 118.0, "go"),
        ] {
            cell.samples.push(Sample {
                block,
                truth_um,
                figure: None,
                verdict: verdict.into(),
                reason: None,
                code: None,
            });
        }
        let cells = [cell];
        let text = section(&cells, [30.0, 50.0]).expect("text");
        // One block of two: 1 - sqrt(0.05).
        assert!(
            text.contains("| 110 to 120 | 3 | 2 | 2 | 0 | 1 | 0 | 97.5 % |"),
            "{text}"
        );
        assert!(
            text.contains("| 0 to 10 | 2 | 2 | 2 | 0 | 0 | 0 | 100.0 % |"),
            "{text}"
        );
        assert!(
            text.contains("| 10 to 20 | 1 | 1 | 0 | 1 | 0 | 0 | 95.0 % |"),
            "{text}"
        );
        let svg = draw(&cells, [30.0, 50.0]).expect("drawn");
        let svg = svg.expect("a picture");
        let document = roxmltree::Document::parse(&svg).expect("XML");
        let of = |colour: &str| {
            let all = document.descendants();
            let bars = all.filter(|node| node.attribute("fill") == Some(colour));
            bars.filter_map(|node| node.attribute("height")?.parse::<f64>().ok())
                .collect::<Vec<_>>()
        };
        let full = SIZE[1] - BOTTOM - TOP;
        // The last one is the legend's.
        let [first, last, _] = of(VERDICTS[0].1)[..] else {
            panic!("two bars")
        };
        assert!(
            (first - full).abs() < 0.1 && (last - 2.0 / 3.0 * full).abs() < 0.1,
            "{first} {last}"
        );
        assert!(section(&[], [30.0, 50.0]).expect("text").is_empty());
        assert!(draw(&[], [30.0, 50.0]).expect("nothing").is_none());
    }
}
