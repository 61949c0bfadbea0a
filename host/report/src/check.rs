//! The page of an in-situ check.

use std::collections::BTreeSet;

use askama::Template;
use flankscope_metrology::verdict::{Code, Word};

use super::{Fact, Words, chart, colour, facts, limits_um, numbered, ring};
use flankscope_profilometry::Picture;
use flankscope_record::document::{FlankInView, FlankMap, Inspection, LivePicture};

/// Pixels per millimetre of a map on the page.
pub(super) const PX_PER_MM: f64 = 30.0;
/// Largest width of the raw frame on the page, px: it is for viewing, not for measurement.
pub(super) const FRAME_WIDTH: usize = 480;
/// Width of a frame on a live display, pixels of the screen.
const LIVE_FRAME_WIDTH: f64 = 240.0;

#[derive(Template)]
#[template(path = "report.html")]
struct Page<'a> {
    inspection: &'a Inspection,
    simulated: bool,
    facts: Vec<Fact>,
    words: &'static Words,
    /// Remedies for indeterminate results.
    remedies: BTreeSet<Code>,
    /// Sources of uncertainty that occur in some flank's budget.
    sources: BTreeSet<&'static str>,
    ring: Option<String>,
    maps: Vec<Map<'a>>,
    colour_bar: String,
    histogram: String,
    timeline: String,
    /// Name of each view and its frame.
    frames: Vec<(&'a str, String)>,
    max_abs_um: f64,
}

/// A deviation map as a picture.
struct Map<'a> {
    map: &'a FlankMap,
    verdict: Word,
    picture: String,
    width_px: f64,
    height_px: f64,
    /// The disc with the largest loss: left, top, width and height, as percentages of the map's size.
    disc: Option<[f64; 4]>,
}

/// Writes the page of an inspection.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn html(inspection: &Inspection) -> Result<String, askama::Error> {
    let full_um = full_scale_um(inspection);
    let pictures = &inspection.pictures;
    let maps = pictures.maps.iter();
    let limits_um = limits_um(&inspection.features);
    let details = inspection.features.iter().filter_map(|f| f.detail.as_ref());
    let page = Page {
        inspection,
        simulated: inspection.origin.simulated,
        facts: facts_of(inspection),
        words: Words::of(inspection.features.iter().map(|f| &f.id)),
        remedies: inspection.features.iter().filter_map(|f| f.code).collect(),
        sources: details
            .flat_map(|detail| detail.shown_budget())
            .map(|(source, _)| source)
            .collect(),
        ring: pictures
            .toothing
            .as_ref()
            .map(|toothing| ring::ring(toothing, &inspection.features)),
        maps: maps.map(|map| draw(map, inspection, full_um)).collect(),
        colour_bar: chart::colour_bar(full_um, limits_um),
        histogram: chart::histogram(&pictures.deviations_um, full_um, limits_um),
        timeline: chart::timeline(
            &pictures.activities,
            pictures.moves,
            inspection.verdict,
            inspection.timing_ms.last_exposure_to_verdict,
        ),
        frames: thumbnails(&pictures.frames),
        max_abs_um: full_um,
    };
    page.render()
}

/// The maps and frames of a check as a live display shows them.
#[must_use]
pub fn live_pictures(inspection: &Inspection) -> Vec<LivePicture> {
    let full_um = full_scale_um(inspection);
    let maps = inspection.pictures.maps.iter().map(|map| LivePicture {
        caption: format!("{} \u{b1}{full_um:.0} \u{b5}m", map.id),
        image: cells_as_picture(map.columns, &map.deviation_um, full_um),
        size_px: map.size_mm.map(|mm| mm * PX_PER_MM),
    });
    let frames = thumbnails(&inspection.pictures.frames).into_iter();
    let frames = frames.zip(&inspection.pictures.frames);
    let frames = frames.map(|((name, image), (_, frame))| {
        let width = LIVE_FRAME_WIDTH;
        LivePicture {
            caption: format!("{name}: camera frame"),
            image,
            size_px: [width, width * frame.height as f64 / frame.width as f64],
        }
    });
    maps.chain(frames).collect()
}

/// Entries below the title of a check.
pub(super) fn facts_of(inspection: &Inspection) -> Vec<Fact> {
    facts(
        &inspection.date,
        &inspection.tool,
        numbered(inspection.id),
        Some(inspection.press_cycles.into()),
        &inspection.origin,
    )
}

/// Half of the colour scale's range: twice the stop limit, so that a violated limit is dark but not at the end of the scale.
pub(super) fn full_scale_um(inspection: &Inspection) -> f64 {
    let limits = inspection.features.iter().map(|f| f.limit_um);
    match limits.fold(0.0, f64::max) {
        limit_um if limit_um > 0.0 => 2.0 * limit_um,
        _ => 100.0,
    }
}

/// The cells of a map, row by row, as a picture; cells that were not measured are hatched.
pub(super) fn cells_as_picture(columns: usize, deviation_um: &[f64], full_um: f64) -> String {
    let pixel = |(place, &um): (usize, &f64)| match um.is_finite() {
        true => colour::diverging(um / full_um),
        false => colour::unmeasured(place % columns, place / columns),
    };
    let pixels: Vec<[u8; 3]> = deviation_um.iter().enumerate().map(pixel).collect();
    colour::rgb_data_uri(columns, pixels.len() / columns.max(1), &pixels)
}

fn draw<'a>(map: &'a FlankMap, inspection: &'a Inspection, full_um: f64) -> Map<'a> {
    let flank = inspection.features.iter().find(|f| f.id.is_same(&map.id));
    let [wide_mm, high_mm] = map.size_mm;
    let disc = flank.and_then(|f| f.detail.as_ref()).map(|detail| {
        let [along, up] = detail.deepest_at_mm;
        let radius_mm = (detail.area_mm2 / std::f64::consts::PI).sqrt();
        let top_mm = high_mm - up - radius_mm;
        let (across, left) = (2.0 * radius_mm, along - radius_mm);
        [
            left / wide_mm,
            top_mm / high_mm,
            across / wide_mm,
            across / high_mm,
        ]
        .map(|share| 100.0 * share)
    });
    Map {
        map,
        verdict: flank.map_or(Word::Indeterminate, |f| f.verdict),
        disc,
        picture: cells_as_picture(map.columns, &map.deviation_um, full_um),
        width_px: wide_mm * PX_PER_MM,
        height_px: high_mm * PX_PER_MM,
    }
}

/// Whether a flank that was not requested affects the verdict of the check; only these are printed on paper.
fn counts(flank: &FlankInView) -> bool {
    matches!(flank.verdict, Word::NoGo | Word::Warn)
}

/// The frames of all views, the smaller the more there are, so that together they take the room of one.
fn thumbnails(frames: &[(String, Picture)]) -> Vec<(&str, String)> {
    let columns = (FRAME_WIDTH as f64 / (frames.len() as f64).sqrt()) as usize;
    frames
        .iter()
        .map(|(name, frame)| (name.as_str(), thumbnail(frame, columns)))
        .collect()
}

/// A frame as a small picture of at most this many columns: means of blocks of pixels, in 32 shades, so that noise compresses well.
pub(super) fn thumbnail(frame: &Picture, most_columns: usize) -> String {
    let block = frame.width.div_ceil(most_columns.max(1)).max(1);
    let (width, height) = (frame.width / block, frame.height / block);
    let grey: Vec<u8> = (0..width * height)
        .map(|place| {
            let (column, row) = (block * (place % width), block * (place / width));
            let of_row = |row: usize| &frame.grey[row * frame.width + column..][..block];
            let sum: u32 = (row..row + block)
                .flat_map(|row| of_row(row).iter().map(|&grey| u32::from(grey)))
                .sum();
            // Below 256, because every pixel is.
            (sum / (block * block) as u32) as u8 & 0xf8
        })
        .collect();
    colour::grey_data_uri(width, height, &grey)
}
