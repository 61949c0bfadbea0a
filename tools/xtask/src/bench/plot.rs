//! Cost against size as an SVG, both axes logarithmic: a straight line of slope one is proportional growth.

use std::fmt::Write;
use std::path::Path;

/// One curve: its name, and (size, milliseconds) by rising size.
pub struct Curve {
    pub name: &'static str,
    pub points: Vec<(f64, f64)>,
}

const LEFT: f64 = 70.0;
const RIGHT: f64 = 620.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 330.0;
const COLOURS: [&str; 4] = ["#0b5394", "#b45f06", "#38761d", "#741b47"];

/// A picture of the curves; none without points.
pub fn svg(title: &str, size: &str, curves: &[Curve]) -> Option<String> {
    let all = || curves.iter().flat_map(|curve| curve.points.iter());
    let decades = |of: &dyn Fn(&(f64, f64)) -> f64| {
        let exponents: Vec<f64> = all().map(|point| of(point).log10()).collect();
        let low = exponents.iter().copied().reduce(f64::min)?.floor();
        let high = exponents.iter().copied().reduce(f64::max)?.ceil();
        Some((low, high.max(low + 1.0)))
    };
    let (x_low, x_high) = decades(&|point| point.0)?;
    let (y_low, y_high) = decades(&|point| point.1)?;
    let x = |value: f64| LEFT + (RIGHT - LEFT) * (value.log10() - x_low) / (x_high - x_low);
    let y = |value: f64| BOTTOM - (BOTTOM - TOP) * (value.log10() - y_low) / (y_high - y_low);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 820 380\" width=\"820\" height=\"380\">\n\
         <style>text{{font:12px sans-serif;fill:#222}}.t{{font-weight:bold}}.g{{stroke:#ddd}}.c{{fill:none;stroke-width:2}}\
         </style>\n<rect width=\"820\" height=\"380\" fill=\"#fff\"/>\n\
         <text class=\"t\" x=\"{LEFT}\" y=\"22\">{title}</text>\n\
         <text x=\"{RIGHT}\" y=\"368\" text-anchor=\"end\">{size}</text>\n\
         <text x=\"10\" y=\"{TOP}\">ms</text>\n"
    );
    let lines = |low: f64, high: f64| (low as i32..=high as i32).map(|e| 10f64.powi(e));
    for value in lines(x_low, x_high) {
        let at = x(value);
        let _ = writeln!(
            text,
            "<line class=\"g\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{BOTTOM}\"/>\
             <text x=\"{at:.1}\" y=\"348\" text-anchor=\"middle\">{value}</text>"
        );
    }
    for value in lines(y_low, y_high) {
        let at = y(value);
        let _ = writeln!(
            text,
            "<line class=\"g\" x1=\"{LEFT}\" x2=\"{RIGHT}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{value}</text>",
            LEFT - 6.0,
            at + 4.0
        );
    }
    for (number, curve) in curves.iter().enumerate() {
        let colour = COLOURS[number % COLOURS.len()];
        let path: Vec<String> = curve
            .points
            .iter()
            .map(|&(size, ms)| format!("{:.1},{:.1}", x(size), y(ms)))
            .collect();
        let _ = writeln!(
            text,
            "<polyline class=\"c\" stroke=\"{colour}\" points=\"{}\"/>",
            path.join(" ")
        );
        for &(size, ms) in &curve.points {
            let _ = writeln!(
                text,
                "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\" fill=\"{colour}\"/>",
                x(size),
                y(ms)
            );
        }
        let _ = writeln!(
            text,
            "<text x=\"{:.1}\" y=\"{:.1}\" style=\"fill:{colour}\">{}</text>",
            RIGHT + 12.0,
            TOP + 14.0 + 18.0 * number as f64,
            curve.name
        );
    }
    Some(text + "</svg>\n")
}

/// Writes a picture into the folder, which is made.
pub fn save(folder: &Path, name: &str, svg: &str) -> Result<(), String> {
    let path = folder.join(format!("{name}.svg"));
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, svg))
        .map_err(|error| format!("{}: {error}", path.display()))
}
