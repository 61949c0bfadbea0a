//! The report: one HTML file that needs nothing else, for the screen, the mail and the printer.

mod chart;
mod colour;
mod folder;
mod history;
mod plot;
mod scan;
mod scan_files;
mod svg;

use std::collections::BTreeSet;

use askama::Template;
use flankscope_metrology::verdict::{Code, Word};

pub use folder::{LatestPage, ReportFolder};
pub use history::{history_html, rate, remaining};
pub use scan::scan_html;
pub use scan_files::{scan_mesh, scan_ply};

use crate::inspection::{FlankDetail, FlankMap, Inspection};
use crate::origin::Origin;

/// What the figures of a check are: the same words in reports, help texts and documentation.
pub const DEFINITIONS: &str = "Wear of a flank is the largest mean loss over any disc of 0.25 mm² (inspect.wear_area_mm2) in \
its zone; nothing is presumed of the damage's shape. U95 is its expanded uncertainty (95 %, coverage factor 1.96). The zone is \
the judged part of a flank: zone_radius_mm by zone_height_mm in tool.toml. Proud is the largest mean height of material over \
such a disc, cell the loss of the single cell that lost most (a cell is a fifth of the disc's diameter wide), tip the radius of \
the tip edge's rounding. Detects is the least wear that is told from none with 5 % errors of both kinds: damage that takes less \
than that off every disc of the stated area can hide.";

/// The report's page.
#[derive(Template)]
#[template(path = "report.html")]
struct Page<'a> {
    inspection: &'a Inspection,
    origin: &'a Origin,
    date: &'a str,
    check: String,
    /// What to do about what could not be decided.
    remedies: BTreeSet<Code>,
    /// Parts of the uncertainty that some flank has.
    sources: BTreeSet<&'static str>,
    maps: Vec<Map<'a>>,
    colour_bar: String,
    histogram: String,
    timeline: String,
    frame: Option<String>,
    max_abs_um: f64,
}

/// A deviation map as a picture.
struct Map<'a> {
    map: &'a FlankMap,
    verdict: Word,
    picture: String,
    width_px: f64,
    height_px: f64,
    /// Where most is lost: left and top of the disc, and its diameter, px.
    disc_px: Option<[f64; 3]>,
}

/// Writes the page of an inspection.
///
/// # Errors
/// The template engine's, which formatting into memory never raises.
pub fn html(inspection: &Inspection) -> Result<String, askama::Error> {
    let limit_um = inspection
        .features
        .iter()
        .map(|f| f.limit_um)
        .fold(0.0, f64::max);
    // Full scale: twice the stop limit, so that a limit violation is dark but not the end of the scale.
    let full_um = if limit_um > 0.0 {
        2.0 * limit_um
    } else {
        100.0
    };
    let pictures = &inspection.pictures;
    let maps = pictures
        .maps
        .iter()
        .map(|map| draw(map, inspection, full_um))
        .collect();
    let marks = inspection
        .features
        .first()
        .map(|f| [(-f.warn_um, "warn"), (-f.limit_um, "stop")]);
    let details = inspection.features.iter().filter_map(|f| f.detail.as_ref());
    let page = Page {
        inspection,
        origin: &inspection.origin,
        date: &inspection.date,
        check: numbered(inspection.id),
        remedies: inspection.features.iter().filter_map(|f| f.code).collect(),
        sources: details
            .flat_map(|detail| detail.shown_budget())
            .map(|(source, _)| source)
            .collect(),
        maps,
        colour_bar: chart::colour_bar(full_um, marks.as_ref().map_or(&[], |m| m)),
        histogram: chart::histogram(
            &pictures.deviations_um,
            full_um,
            marks.as_ref().map_or(&[], |m| m),
        ),
        timeline: chart::timeline(&pictures.activities),
        frame: pictures
            .frame
            .as_ref()
            .map(|frame| colour::grey_data_uri(frame.width, frame.height, &frame.grey)),
        max_abs_um: full_um,
    };
    page.render()
}

/// A check by its number in the history.
fn numbered(id: Option<i64>) -> String {
    id.map_or_else(
        || "in no history".into(),
        |id| format!("check {id} of its history"),
    )
}

fn draw<'a>(map: &'a FlankMap, inspection: &'a Inspection, full_um: f64) -> Map<'a> {
    let pixels: Vec<[u8; 3]> = map
        .deviation_um
        .iter()
        .enumerate()
        .map(|(place, &um)| {
            if um.is_finite() {
                colour::diverging(um / full_um)
            } else {
                colour::unmeasured(place % map.columns, place / map.columns)
            }
        })
        .collect();
    let flank = inspection
        .features
        .iter()
        .find(|f| f.tooth == map.tooth && f.flank == map.flank);
    let disc_px = flank.and_then(|f| f.detail.as_ref()).map(|detail| {
        let [along, up] = detail.deepest_at_mm;
        let radius_mm = (detail.area_mm2 / std::f64::consts::PI).sqrt();
        let top_mm = map.size_mm[1] - up - radius_mm;
        [along - radius_mm, top_mm, 2.0 * radius_mm].map(|mm| mm * PX_PER_MM)
    });
    const PX_PER_MM: f64 = 48.0;
    Map {
        map,
        verdict: flank.map_or(Word::Indeterminate, |f| f.verdict),
        disc_px,
        picture: colour::rgb_data_uri(map.columns, map.rows, &pixels),
        width_px: map.size_mm[0] * PX_PER_MM,
        height_px: map.size_mm[1] * PX_PER_MM,
    }
}

/// A figure in µm for a table: one decimal, no minus before zero, a dash where there is none.
#[must_use]
pub fn figure(value: Option<f64>) -> String {
    // Adding zero turns the −0 that rounding may leave into 0.
    value.filter(|um| um.is_finite()).map_or_else(
        || "–".into(),
        |um| format!("{:.1}", (um * 10.0).round() / 10.0 + 0.0),
    )
}

/// A part of a flank's uncertainty for a table, a dash where it has none.
fn part(detail: &FlankDetail, source: &str) -> String {
    let shown = detail.shown_budget().into_iter();
    let um = shown
        .filter(|(name, _)| *name == source)
        .map(|(_, um)| um)
        .next();
    um.map_or_else(|| "–".into(), |um| format!("{um:.2}"))
}

/// Sentences are plain ASCII; where µ can be shown, "um" becomes "µm" wherever it is a word of its own.
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
            .is_none_or(|c| !c.is_alphabetic() && c != '_' && c != '-');
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
    use super::*;

    #[test]
    fn documentation_and_report_define_the_figures_in_the_same_words() {
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        let formats = words(include_str!("../../../../docs/formats.md"));
        assert!(formats.contains(&words(DEFINITIONS)));
    }

    #[test]
    fn documentation_lists_every_reason_with_its_remedy() {
        let formats = include_str!("../../../../docs/formats.md");
        for code in Code::ALL {
            let (begins, ends) = (format!("| `{code}` | "), format!(" | {} |", code.remedy()));
            let of_code = |row: &str| row.starts_with(&begins) && row.ends_with(&ends);
            assert!(formats.lines().any(of_code), "{code}");
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
