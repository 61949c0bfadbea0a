//! A chart with two axes as inline SVG: bars, lines and dots; axes have round numbers.

use std::fmt::Write as _;

use super::svg::{about, open};

const LEFT: f64 = 58.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 40.0;

/// Elements of a chart.
pub enum Series<'a> {
    /// A bar from zero over each of equally wide bins, with its own colour.
    Bars(&'a [(f64, String)]),
    /// A line through the points in order; it breaks where a value is missing.
    Line(&'a [(f64, Option<f64>)], String),
    /// A dot at each point.
    Dots(&'a [(f64, f64)], String),
    /// A coloured dot at each point, with its tooltip.
    Named(&'a [(f64, f64, String, String)]),
    /// A limit on the horizontal axis: its value, its name, and its CSS class.
    Mark(f64, &'a str),
    /// A picture (`data:` address) over the whole area between the axes, and its colour scale for the tooltip.
    Picture(String, Scale),
    /// Rectangles of equal size, row by row from the top; the number in a row, and of each its colour and tooltip.
    Cells(usize, &'a [([u8; 3], String)]),
}

/// Colour scale of a picture.
#[derive(Clone, Copy)]
pub enum Scale {
    /// [`super::colour::diverging`], full scale in µm.
    Deviation(f64),
    /// [`super::colour::sequential`], full scale.
    Amount(f64),
}

/// The axes of a chart.
pub struct Axes<'a> {
    /// Description for screen readers.
    pub title: &'a str,
    /// Width and height, px.
    pub size: [f64; 2],
    /// Range and label along the bottom.
    pub x: ([f64; 2], &'a str),
    /// Range and label along the side.
    pub y: ([f64; 2], &'a str),
}

impl Axes<'_> {
    /// Draws the axes and the elements.
    #[must_use]
    pub fn draw(&self, series: &[Series<'_>]) -> String {
        let [width, height] = self.size;
        let ([x_from, x_to], x_label) = self.x;
        let ([y_from, y_to], y_label) = self.y;
        let (right, bottom) = (width - RIGHT, height - BOTTOM);
        let x = |value: f64| LEFT + (value - x_from) / (x_to - x_from) * (right - LEFT);
        let y = |value: f64| bottom - (value - y_from) / (y_to - y_from) * (bottom - TOP);
        let mut svg = open(width, height, self.title);
        for tick in about(((right - LEFT) / 45.0).min(8.0), x_from, x_to) {
            let _ = write!(
                svg,
                r#"<line x1="{0:.1}" y1="{TOP}" x2="{0:.1}" y2="{bottom}" class="grid"/><text x="{0:.1}" y="{1:.1}" text-anchor="middle">{tick}</text>"#,
                x(tick),
                bottom + 15.0
            );
        }
        for tick in about(((bottom - TOP) / 20.0).clamp(2.0, 8.0), y_from, y_to) {
            let _ = write!(
                svg,
                r#"<line x1="{LEFT}" y1="{0:.1}" x2="{right}" y2="{0:.1}" class="grid"/><text x="{1:.1}" y="{2:.1}" text-anchor="end">{tick}</text>"#,
                y(tick),
                LEFT - 6.0,
                y(tick) + 4.0
            );
        }
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="{:.1}" text-anchor="middle">{x_label}</text><text transform="translate(13 {:.1}) rotate(-90)" text-anchor="middle">{y_label}</text>"#,
            0.5 * (LEFT + right),
            height - 8.0,
            0.5 * (TOP + bottom)
        );
        for series in series {
            match series {
                Series::Bars(bars) => {
                    let each = (right - LEFT) / bars.len().max(1) as f64;
                    for (bin, (value, colour)) in bars.iter().enumerate() {
                        let top = y(value.clamp(y_from, y_to));
                        let _ = write!(
                            svg,
                            r#"<rect x="{:.2}" y="{top:.2}" width="{each:.2}" height="{:.2}" fill="{colour}" stroke="var(--muted)" stroke-width=".3"/>"#,
                            LEFT + bin as f64 * each,
                            bottom - top
                        );
                    }
                }
                Series::Line(points, colour) => {
                    for piece in points.split(|(_, value)| value.is_none()) {
                        let path: Vec<String> = piece
                            .iter()
                            .filter_map(|&(at, value)| {
                                Some(format!("{:.1},{:.1}", x(at), y(value?.clamp(y_from, y_to))))
                            })
                            .collect();
                        let _ = write!(
                            svg,
                            r#"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="1.6"/>"#,
                            path.join(" ")
                        );
                    }
                }
                Series::Named(points) => {
                    for (at, value, colour, said) in *points {
                        let _ = write!(
                            svg,
                            r#"<circle cx="{:.1}" cy="{:.1}" r="2.2" fill="{colour}"><title>{said}</title></circle>"#,
                            x(*at),
                            y(value.clamp(y_from, y_to))
                        );
                    }
                }
                Series::Mark(value, name) if (x_from..=x_to).contains(value) => {
                    let at = x(*value);
                    let _ = write!(
                        svg,
                        r#"<line x1="{at:.1}" y1="{TOP}" x2="{at:.1}" y2="{bottom}" class="mark {name}"/><text x="{at:.1}" y="{:.1}" text-anchor="middle" class="mark {name}">{name}</text>"#,
                        TOP - 3.0
                    );
                }
                Series::Mark(..) => {}
                Series::Cells(columns, cells) => {
                    let columns = (*columns).max(1);
                    let rows = cells.len().div_ceil(columns).max(1);
                    let (wide, high) = (
                        (right - LEFT) / columns as f64,
                        (bottom - TOP) / rows as f64,
                    );
                    for (place, ([r, g, b], said)) in cells.iter().enumerate() {
                        let _ = write!(
                            svg,
                            r#"<rect x="{:.1}" y="{:.1}" width="{wide:.1}" height="{high:.1}" fill="rgb({r},{g},{b})"><title>{said}</title></rect>"#,
                            LEFT + (place % columns) as f64 * wide,
                            TOP + (place / columns) as f64 * high
                        );
                    }
                }
                Series::Picture(address, scale) => {
                    let (scale, full) = match scale {
                        Scale::Deviation(full) => ("deviation", full),
                        Scale::Amount(full) => ("amount", full),
                    };
                    let _ = write!(
                        svg,
                        r#"<image href="{address}" x="{LEFT}" y="{TOP}" width="{:.1}" height="{:.1}" preserveAspectRatio="none" style="image-rendering:pixelated" data-scale="{scale}" data-full="{full}" data-x="{x_from} {x_to} {x_label}" data-y="{y_to} {y_from} {y_label}"/>"#,
                        right - LEFT,
                        bottom - TOP
                    );
                }
                Series::Dots(points, colour) => {
                    for &(at, value) in *points {
                        let _ = write!(
                            svg,
                            r#"<circle cx="{:.1}" cy="{:.1}" r="1.8" fill="{colour}"/>"#,
                            x(at),
                            y(value.clamp(y_from, y_to))
                        );
                    }
                }
            }
        }
        svg.push_str("</svg>");
        svg
    }
}

/// Counts per bin, and the number of values beyond the range.
pub fn binned(values: &[f64], [from, to]: [f64; 2], bins: usize) -> (Vec<f64>, usize) {
    let mut counts = vec![0.0; bins];
    let mut beyond = 0;
    for &value in values {
        let bin = ((value - from) / (to - from) * bins as f64).floor();
        match counts.get_mut(bin as usize) {
            Some(count) if bin >= 0.0 => *count += 1.0,
            _ => beyond += 1,
        }
    }
    (counts, beyond)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_binned_or_beyond() {
        let (counts, beyond) = binned(&[0.0, 0.5, 9.99, 10.0, -0.1, f64::NAN], [0.0, 10.0], 10);
        assert_eq!((counts[0], counts[9], beyond), (2.0, 1.0, 3));
        assert_eq!(counts.iter().sum::<f64>(), 3.0);
    }

    #[test]
    fn a_line_breaks_where_nothing_was_seen_and_stays_inside() {
        let points = [
            (0.0, Some(1.0)),
            (1.0, Some(99.0)),
            (2.0, None),
            (3.0, Some(2.0)),
            (4.0, Some(3.0)),
        ];
        let axes = Axes {
            title: "test",
            size: [400.0, 200.0],
            x: ([0.0, 4.0], "x"),
            y: ([0.0, 10.0], "y"),
        };
        let svg = axes.draw(&[Series::Line(&points, "red".into())]);
        assert_eq!(svg.matches("<polyline").count(), 2);
        // 99 is drawn at the upper edge.
        assert!(svg.contains(",16.0\""), "{svg}");
    }
}
