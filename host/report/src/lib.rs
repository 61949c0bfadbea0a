//! Reports of checks, scans, histories and the article's figures: each is one self-contained HTML file for screen, e-mail and print.

mod article;
mod artwork;
mod bars;
mod chart;
mod check;
mod colour;
mod comparison;
mod folder;
mod history;
mod map3d;
mod map3d_source;
mod pick;
mod plot;
mod ring;
mod scan;
mod scan_files;
mod scenes;
mod setup;
mod space;
mod svg;
mod tables;
mod trend_chart;
mod words;

pub use artwork::artwork_svg;
pub use check::{html, live_pictures};
pub use comparison::comparison_html;
pub use folder::{Pages, ReportFolder};
pub use history::{history_html, rate, remaining};
pub use pick::{MOST_PICK_POINTS, PickSides, pick_html};
pub use ring::numbered_ring;
pub use scan::scan_html;
pub use scan_files::{scan_mesh, scan_ply};
pub use setup::setup_html;
pub use words::Words;

use flankscope_record::document::{Expanded, Feature, FlankDetail};
use flankscope_record::origin::Origin;

/// Definitions of a check's results: the same text in reports, help texts and documentation.
pub const DEFINITIONS: &str = "Wear of a flank is the largest mean loss over any disc of 0.25 mm² (inspect.wear_area_mm2) in \
its zone; no shape of the damage is assumed. U95 is its expanded uncertainty (95 %, coverage factor 1.96). The zone is \
the judged part of a flank: zone_radius_mm by zone_height_mm in tool.toml. Proud is the largest mean height of material over \
such a disc, cell the loss of the single cell that lost most (a cell is a fifth of the disc's diameter wide), tip the radius of \
the tip edge's rounding. Detects is the detection limit: the least wear that is distinguished from none with an error probability \
of 5 % either way; damage with a smaller mean loss over every disc may not be noticed.";

/// An entry on the origin of a result: its name and value.
type Fact = (&'static str, String);

/// Name of the date among the facts; the page adds the local time.
const DATE: &str = "date (UTC)";

/// Entries below every title.
fn facts(date: &str, tool: &str, check: String, cycles: Option<i64>, origin: &Origin) -> Vec<Fact> {
    let mut facts = vec![
        (DATE, date.to_owned()),
        ("tool", tool.to_owned()),
        ("check", check),
    ];
    facts.extend(cycles.map(|cycles| ("cycles", cycles.to_string())));
    facts.extend(origin.particulars());
    facts
}

/// Warn and stop limit of the loss, µm; those of the first flank stand for all.
fn limits_um(features: &[Feature]) -> Option<[f64; 2]> {
    features.first().map(|of| [of.warn_um, of.limit_um])
}

/// A check, with its number in the history.
fn numbered(id: Option<i64>) -> String {
    id.map_or_else(
        || "in no history".into(),
        |id| format!("number {id} of its history"),
    )
}

/// A value in µm for a table: one decimal, no negative zero, a dash if absent.
#[must_use]
pub fn figure(value: Option<f64>) -> String {
    // Adding zero turns −0 into 0.
    value.filter(|um| um.is_finite()).map_or_else(
        || "–".into(),
        |um| format!("{:.1}", (um * 10.0).round() / 10.0 + 0.0),
    )
}

/// Wear of a flank in µm as an interval or a lower bound.
#[must_use]
pub fn wear_in_words(of: &Feature) -> String {
    match of.at_least_um {
        Some(um) => format!("≥ {}", figure(Some(um))),
        None => format!("{} ± {}", figure(of.wear_um), figure(of.u95_um)),
    }
}

/// The flank or patch with the most wear, and that wear; a dash if none was measured.
#[must_use]
pub fn most_wear(features: &[Feature]) -> String {
    ring::deepest(features).map_or_else(
        || "–".into(),
        |of| format!("{}: {} µm", of.id, wear_in_words(of)),
    )
}

/// A value in µm with its expanded uncertainty; a dash if absent.
#[must_use]
pub fn expanded_in_words(of: Option<Expanded>) -> String {
    let interval = |of: Expanded| format!("{} ± {}", figure(Some(of.value)), figure(Some(of.u95)));
    of.map_or_else(|| "–".into(), interval)
}

/// A contribution to a flank's uncertainty for a table; a dash if absent.
fn part(detail: &FlankDetail, source: &str) -> String {
    let shown = detail.shown_budget().into_iter();
    let um = shown
        .filter(|(name, _)| *name == source)
        .map(|(_, um)| um)
        .next();
    um.map_or_else(|| "–".into(), |um| format!("{um:.2}"))
}

/// Sentences are plain ASCII. Where µ can be shown, "um" becomes "µm" if it is a separate word, unlike in `10um.ply`.
#[must_use]
pub fn with_micro(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("um") {
        let (before, from) = rest.split_at(at);
        let after = &from[2..];
        let begins = before
            .chars()
            .last()
            .is_none_or(|c| !c.is_alphanumeric() && !['_', '-', '"'].contains(&c))
            // The value of an option is shown as it is typed.
            && !before.split(' ').rev().nth(1).is_some_and(|word| word.starts_with("--"));
        let ends = after
            .chars()
            .next()
            .is_none_or(|c| !c.is_alphanumeric() && c != '_');
        shown += before;
        shown += if begins && ends { "µm" } else { "um" };
        rest = after;
    }
    shown + rest
}

#[cfg(test)]
mod tests {
    use flankscope_metrology::verdict::Code;

    use super::*;

    #[test]
    fn documentation_and_report_define_the_figures_in_the_same_words() {
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        let method = words(include_str!("../../../docs/method.md"));
        assert!(method.contains(&words(DEFINITIONS)));
    }

    #[test]
    fn documentation_lists_every_reason_with_its_remedy() {
        let reasons = include_str!("../../../docs/formats/reasons.md");
        for code in Code::ALL {
            let (begins, ends) = (format!("| `{code}` | "), format!(" | {} |", code.remedy()));
            let of_code = |row: &str| row.starts_with(&begins) && row.ends_with(&ends);
            assert!(reasons.lines().any(of_code), "{code}");
        }
    }

    #[test]
    fn figures_have_one_decimal_and_no_negative_zero() {
        let of = |um| figure(Some(um));
        assert_eq!(
            [of(-0.04), of(0.04), of(-0.06), of(79.96)],
            ["0.0", "0.0", "-0.1", "80.0"]
        );
        assert_eq!(figure(None), "–");
    }
}
