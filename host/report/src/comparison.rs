//! The page that compares two checks: the flanks' wear in either, and their maps side by side.

use askama::Template;
use flankscope_record::document::{ComparedFlank, Comparison, FeatureId, FlankMap};

use super::check::{PX_PER_MM, cells_as_picture};
use super::{Words, chart, expanded_in_words, wear_in_words};

#[derive(Template)]
#[template(path = "comparison.html")]
struct Page<'a> {
    comparison: &'a Comparison,
    simulated: bool,
    words: &'static Words,
    rows: Vec<[String; 7]>,
    flanks: Vec<Maps<'a>>,
    colour_bar: String,
    max_abs_um: f64,
}

/// The maps of one flank: name and picture of each.
struct Maps<'a> {
    id: &'a FeatureId,
    size_mm: [f64; 2],
    size_px: [f64; 2],
    pictures: Vec<(&'static str, String)>,
}

/// Writes the page of a comparison.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn comparison_html(comparison: &Comparison) -> Result<String, askama::Error> {
    let limits = comparison.flanks.iter().map(|flank| &flank.since);
    let limits_um = limits.clone().next().map(|of| [of.warn_um, of.limit_um]);
    let full_um = 2.0 * limits_um.map_or(50.0, |[_, limit_um]| limit_um);
    let page = Page {
        simulated: comparison.simulated,
        words: Words::of(comparison.flanks.iter().map(|flank| &flank.id)),
        rows: comparison.flanks.iter().map(row).collect(),
        flanks: comparison
            .flanks
            .iter()
            .filter_map(|flank| maps(comparison, &flank.id, full_um))
            .collect(),
        colour_bar: chart::colour_bar(full_um, limits_um),
        max_abs_um: full_um,
        comparison,
    };
    page.render()
}

/// Tooth, side, wear before, wear after, loss since, proud since, verdict on the loss.
fn row(flank: &ComparedFlank) -> [String; 7] {
    let since = &flank.since;
    let proud = since.detail.as_ref().map(|detail| detail.proud_um);
    [
        flank.id.tooth.to_string(),
        flank.id.side().to_owned(),
        expanded_in_words(flank.before_um),
        expanded_in_words(flank.after_um),
        wear_in_words(since),
        expanded_in_words(proud),
        since.verdict.to_string(),
    ]
}

fn maps<'a>(comparison: &'a Comparison, id: &'a FeatureId, full_um: f64) -> Option<Maps<'a>> {
    let of = |maps: &'a [FlankMap]| maps.iter().find(|map| map.id.is_same(id));
    let [before, after] = [&comparison.before, &comparison.after].map(|check| of(&check.maps));
    let (before, after) = before.zip(after)?;
    let cells = before.deviation_um.iter().zip(&after.deviation_um);
    let change: Vec<f64> = cells.map(|(then, now)| now - then).collect();
    let picture = |um: &[f64]| cells_as_picture(after.columns, um, full_um);
    Some(Maps {
        id,
        size_mm: after.size_mm,
        size_px: after.size_mm.map(|mm| mm * PX_PER_MM),
        pictures: vec![
            ("before", picture(&before.deviation_um)),
            ("after", picture(&after.deviation_um)),
            ("change", picture(&change)),
        ],
    })
}
