//! The page of a live view for setting up a head. It loads itself again while the view runs; nothing comes from a network.

use std::fmt::Write as _;

use askama::Template;

use super::check::{FRAME_WIDTH, thumbnail};
use super::svg::{about, open};
use super::{Fact, facts};
use flankscope_profilometry::Picture;
use flankscope_record::document::{ExposureLevels, SetupCapture, SetupView};

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 170.0;
const LEFT: f64 = 12.0;
const BOTTOM: f64 = 24.0;
/// Number of newest captures in the table.
const LISTED: usize = 20;

#[derive(Template)]
#[template(path = "setup.html")]
struct Page<'a> {
    view: &'a SetupView,
    simulated: bool,
    refresh_s: Option<u32>,
    facts: Vec<Fact>,
    last: Option<&'a SetupCapture>,
    /// Name, measured value, value of the head file.
    figures: Vec<[String; 3]>,
    /// A row for every exposure.
    exposures: Vec<Vec<String>>,
    /// Exposure in ms, and its histogram.
    histograms: Vec<(String, String)>,
    /// Headers and rows of the newest captures.
    captures: [Vec<Vec<String>>; 2],
    picture: Option<String>,
}

/// Writes the page after a capture, with its picture. A browser loads it again every `refresh_s` seconds, or never.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn setup_html(
    view: &SetupView,
    picture: Option<&Picture>,
    refresh_s: Option<u32>,
) -> Result<String, askama::Error> {
    let last = view.captures.last();
    let page = Page {
        view,
        simulated: view.origin.simulated,
        refresh_s,
        facts: facts(
            last.map_or("", |last| last.date.as_str()),
            &view.tool,
            "live view, nothing is judged".into(),
            None,
            &view.origin,
        ),
        last,
        figures: last.map_or_else(Vec::new, |last| figures(view, last)),
        exposures: last.map_or_else(Vec::new, |last| last.exposures.iter().map(row).collect()),
        histograms: last.map_or_else(Vec::new, |last| {
            let of = |levels: &ExposureLevels| {
                let svg = histogram(levels, view.full_scale_dn, view.saturation_limit_dn);
                (milliseconds(levels.exposure_us), svg)
            };
            last.exposures.iter().map(of).collect()
        }),
        captures: captures(view),
        picture: picture.map(|picture| thumbnail(picture, FRAME_WIDTH)),
    };
    page.render()
}

fn figures(view: &SetupView, last: &SetupCapture) -> Vec<[String; 3]> {
    let expected = &view.expected;
    vec![
        [
            "dark level / DN".into(),
            number(last.dark_dn, 0),
            number(Some(expected.dark_dn), 0),
        ],
        [
            "contrast of the finest fringes".into(),
            number(last.finest_contrast(), 3),
            number(expected.contrast, 3),
        ],
        [
            "focus: their contrast in the middle of the field".into(),
            number(last.focus_contrast, 3),
            number(None, 0),
        ],
        [
            "cells with a usable point".into(),
            percent(last.point_ratio()),
            number(None, 0),
        ],
    ]
}

fn row(of: &ExposureLevels) -> Vec<String> {
    vec![
        milliseconds(of.exposure_us),
        number(Some(of.median_dn), 0),
        number(Some(of.bright_dn), 0),
        number(Some(of.max_dn), 0),
        percent(of.saturated_pixel_ratio),
        percent(of.saturated_cell_ratio),
        number(of.modulation_dn, 0),
        number(of.weak_modulation_dn, 0),
    ]
}

/// Headers of the table of captures, as one row, and its rows, the newest first.
fn captures(view: &SetupView) -> [Vec<Vec<String>>; 2] {
    let exposures = view.captures.last().map_or(&[][..], |last| &last.exposures);
    let bright = exposures
        .iter()
        .map(|of| format!("bright at {} ms / DN", milliseconds(of.exposure_us)));
    let mut headers: Vec<String> = ["capture", "time (UTC)", "dark / DN"]
        .map(Into::into)
        .into();
    headers.extend(bright);
    headers.extend(["contrast", "focus", "points"].map(Into::into));
    let rows = view.captures.iter().rev().take(LISTED).map(|of| {
        let mut row = vec![
            of.number.to_string(),
            of.date.clone(),
            number(of.dark_dn, 0),
        ];
        row.extend(of.exposures.iter().map(|at| number(Some(at.bright_dn), 0)));
        row.extend([
            number(of.finest_contrast(), 3),
            number(of.focus_contrast, 3),
            percent(of.point_ratio()),
        ]);
        row
    });
    [vec![headers], rows.collect()]
}

/// An exposure in ms.
fn milliseconds(exposure_us: u32) -> String {
    (f64::from(exposure_us) / 1000.0).to_string()
}

/// A percentage with one decimal.
fn percent(ratio: f64) -> String {
    format!("{:.1} %", 100.0 * ratio)
}

/// A value with some decimals; a dash if absent.
fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "–".into(), |value| format!("{value:.decimals$}"))
}

/// Pixels by level, on a logarithmic scale so that a few saturated ones are seen.
fn histogram(levels: &ExposureLevels, full_scale_dn: u16, saturation_limit_dn: u16) -> String {
    let title = format!("Pixels by level at {} ms", milliseconds(levels.exposure_us));
    let mut svg = open(WIDTH, HEIGHT, &title);
    let most = levels.histogram.iter().copied().max().unwrap_or(0);
    let scale = |pixels: u64| (pixels as f64).ln_1p() / (most.max(1) as f64).ln_1p();
    let (wide, high) = (WIDTH - 2.0 * LEFT, HEIGHT - BOTTOM - 6.0);
    let zero = HEIGHT - BOTTOM;
    let full = f64::from(full_scale_dn.max(1));
    let x = |dn: f64| LEFT + dn / full * wide;
    let each = wide / levels.histogram.len().max(1) as f64;
    for tick in about(8.0, 0.0, full) {
        let at = x(tick);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="6" x2="{at:.1}" y2="{zero}" class="grid"/><text x="{at:.1}" y="{:.1}" text-anchor="middle">{tick}</text>"#,
            zero + 15.0
        );
    }
    for (bin, &pixels) in levels.histogram.iter().enumerate() {
        let tall = high * scale(pixels);
        let _ = write!(
            svg,
            r#"<rect class="level" x="{:.1}" y="{:.1}" width="{:.1}" height="{tall:.1}"><title>{pixels} pixels</title></rect>"#,
            LEFT + each * bin as f64,
            zero - tall,
            (each - 0.6).max(0.4)
        );
    }
    let limit = x(f64::from(saturation_limit_dn));
    let _ = write!(
        svg,
        r#"<line x1="{limit:.1}" y1="6" x2="{limit:.1}" y2="{zero}" class="mark stop"/>"#
    );
    svg + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_histogram_has_a_bar_for_every_bin_and_a_line_where_saturation_begins() {
        let mut levels = ExposureLevels {
            exposure_us: 10_000,
            median_dn: 100.0,
            bright_dn: 100.0,
            max_dn: 100.0,
            saturated_pixel_ratio: 0.0,
            saturated_cell_ratio: 0.0,
            modulation_dn: None,
            weak_modulation_dn: None,
            histogram: vec![0; ExposureLevels::BINS],
        };
        levels.histogram[1] = 5000;
        let svg = histogram(&levels, 4095, 3890);
        assert_eq!(
            svg.matches(r#"class="level""#).count(),
            ExposureLevels::BINS
        );
        // The tallest bar is as high as the picture, empty ones have no height.
        assert_eq!(svg.matches(r#"height="140.0""#).count(), 1);
        assert_eq!(
            svg.matches(r#"height="0.0""#).count(),
            ExposureLevels::BINS - 1
        );
        // 12 + 3890 / 4095 * 536.
        assert!(svg.contains(r#"<line x1="521.2""#), "{svg}");
    }
}
