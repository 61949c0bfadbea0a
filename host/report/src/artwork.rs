//! A drawing at scale of what is printed for a calibration: SVG in millimetres, with dimensions and a ruler to check the printer by.

use std::fmt::Write as _;

use flankscope_profilometry::calibrate::{Artwork, PrintedMark};

use super::svg::escaped;

/// Ruler's length.
const RULER_MM: f64 = 100.0;
/// White around everything.
const MARGIN_MM: f64 = 12.0;
/// Place for a dimension's words on either side of the plate.
const BESIDE_MM: f64 = 42.0;
/// Height of letters, and from line to line.
const LETTER_MM: f64 = 2.5;
const LINE_MM: f64 = 4.0;

/// The drawing as a file. One unit of its coordinates is 1 mm, without any transformation.
#[must_use]
pub fn artwork_svg(artwork: &Artwork) -> String {
    let [across, up] = artwork.size_mm;
    let longest = artwork.notes.iter().map(|note| note.chars().count()).max();
    // A sans-serif letter is about half as wide as it is high.
    let words_mm = 0.55 * LETTER_MM * longest.unwrap_or(0) as f64;
    let width = (across + 2.0 * BESIDE_MM).max(RULER_MM.max(words_mm) + 2.0 * MARGIN_MM);
    let ruler_y = 2.0 * MARGIN_MM + up + 2.0 * LINE_MM;
    let words_y = ruler_y + 3.0 * LINE_MM;
    let height = words_y + LINE_MM * artwork.notes.len() as f64 + MARGIN_MM;
    let [left, top] = [0.5 * (width - across), MARGIN_MM];
    let middle = [left + 0.5 * across, top + 0.5 * up];
    let title = escaped(&artwork.title);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"{LETTER_MM}\">\n<title>{title}</title>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n<text x=\"{MARGIN_MM}\" y=\"{}\">{title}</text>\n",
        0.5 * MARGIN_MM
    );
    let ground = if artwork.dark_ground { "black" } else { "none" };
    let ink = if artwork.dark_ground {
        "white"
    } else {
        "black"
    };
    let _ = writeln!(
        svg,
        "<rect id=\"outline\" x=\"{left}\" y=\"{top}\" width=\"{across}\" height=\"{up}\" fill=\"{ground}\" stroke=\"grey\" \
         stroke-width=\"0.05\"/>\n<g id=\"marks\" fill=\"{ink}\">"
    );
    for mark in &artwork.marks {
        let _ = match *mark {
            PrintedMark::Circle {
                centre_mm: [x, y],
                radius_mm,
            } => writeln!(
                svg,
                "<circle cx=\"{}\" cy=\"{}\" r=\"{radius_mm}\"/>",
                middle[0] + x,
                middle[1] - y
            ),
            PrintedMark::Square {
                centre_mm: [x, y],
                side_mm,
            } => writeln!(
                svg,
                "<rect x=\"{}\" y=\"{}\" width=\"{side_mm}\" height=\"{side_mm}\"/>",
                middle[0] + x - 0.5 * side_mm,
                middle[1] - y - 0.5 * side_mm
            ),
        };
    }
    svg += "</g>\n<g id=\"dimensions\" fill=\"black\" stroke-width=\"0.1\">\n";
    let tolerance = match artwork.tolerance_mm {
        Some(tolerance_mm) => format!(" ±{tolerance_mm}"),
        None => String::new(),
    };
    for (axis, &steps) in artwork.steps.iter().enumerate() {
        let length_mm = steps as f64 * artwork.pitch_mm;
        let said = format!("{steps} × {} = {length_mm:.3}{tolerance}", artwork.pitch_mm);
        let [from, to] = [-0.5, 0.5].map(|end| middle[axis] + end * length_mm);
        let beyond = 0.4 * MARGIN_MM;
        let _ = if axis == 0 {
            let y = top + up + beyond;
            writeln!(
                svg,
                "<path d=\"M{from} {}V{}M{from} {y}H{to}M{to} {}V{}\" fill=\"none\" stroke=\"black\"/>\n\
                 <text x=\"{}\" y=\"{}\">{said}</text>",
                y - 1.0,
                y + 1.0,
                y - 1.0,
                y + 1.0,
                to + 2.0,
                y + 0.4 * LETTER_MM
            )
        } else {
            let x = left - beyond;
            writeln!(
                svg,
                "<path d=\"M{} {from}H{}M{x} {from}V{to}M{} {to}H{}\" fill=\"none\" stroke=\"black\"/>\n\
                 <text x=\"{}\" y=\"{}\" text-anchor=\"end\">{said}</text>",
                x - 1.0,
                x + 1.0,
                x - 1.0,
                x + 1.0,
                x - 2.0,
                middle[1] + 0.4 * LETTER_MM
            )
        };
    }
    let from = 0.5 * (width - RULER_MM);
    let _ = write!(
        svg,
        "</g>\n<g id=\"ruler\">\n<path stroke=\"black\" stroke-width=\"0.1\" fill=\"none\" d=\"M{from} {ruler_y}H{}",
        from + RULER_MM
    );
    for step in 0..=RULER_MM as usize {
        let long = if step % 10 == 0 { 3.0 } else { 1.5 };
        let _ = write!(svg, "M{} {ruler_y}v{long}", from + step as f64);
    }
    let _ = writeln!(
        svg,
        "\"/>\n<text x=\"{from}\" y=\"{}\">{RULER_MM} mm: measure it on the print</text>\n</g>\n<g id=\"notes\">",
        ruler_y + 3.0 + LETTER_MM
    );
    for (line, note) in artwork.notes.iter().enumerate() {
        let y = words_y + LINE_MM * line as f64;
        let note = escaped(note);
        let _ = writeln!(svg, "<text x=\"{MARGIN_MM}\" y=\"{y}\">{note}</text>");
    }
    svg + "</g>\n</svg>\n"
}
