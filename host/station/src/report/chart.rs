//! Charts as inline SVG: no script, no font file, readable in print.

use std::fmt::Write as _;

use super::svg::{open, ticks};
use crate::acquisition::{Activity, Device};

/// How a device's lane is called and filled.
fn lane(device: Device) -> (&'static str, &'static str) {
    match device {
        Device::Stages => ("stages move", "#7a8794"),
        Device::Settling => ("settle", "#b9c2cb"),
        Device::Led => ("LED", "#2f9e5b"),
        Device::Dmd => ("DMD", "#c77d0a"),
        Device::Camera => ("camera", "#2b6cb0"),
    }
}

/// A lane per device over a common time axis.
#[must_use]
pub fn timeline(activities: &[Activity]) -> String {
    const LEFT: f64 = 90.0;
    const WIDTH: f64 = 900.0;
    const LANE: f64 = 26.0;
    let spans = activities.iter().flat_map(|activity| &activity.spans);
    let end_ms = spans.map(|span| span.end_ms).fold(1.0, f64::max);
    let x = |ms: f64| LEFT + ms / end_ms * (WIDTH - LEFT - 10.0);
    let height = LANE * activities.len() as f64 + 34.0;
    let mut svg = open(WIDTH, height, "Timeline of LED, DMD, camera and stages");
    for tick in ticks(0.0, end_ms) {
        let at = x(tick);
        let bottom = height - 28.0;
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="0" x2="{at:.1}" y2="{bottom}" class="grid"/>"#
        );
        let _ = write!(
            svg,
            r#"<text x="{at:.1}" y="{:.1}" text-anchor="middle">{}</text>"#,
            height - 14.0,
            tick / 1000.0
        );
    }
    let _ = write!(
        svg,
        r#"<text x="{:.1}" y="{height:.1}" text-anchor="end">time / s</text>"#,
        WIDTH - 10.0
    );
    for (i, activity) in activities.iter().enumerate() {
        let (name, colour) = lane(activity.device);
        let top = LANE * i as f64 + 4.0;
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="{:.1}" text-anchor="end">{}</text>"#,
            LEFT - 8.0,
            top + 13.0,
            name
        );
        for span in &activity.spans {
            // A trigger of a millisecond still shows.
            let width = (x(span.end_ms) - x(span.start_ms)).max(0.6);
            let _ = write!(
                svg,
                r#"<rect x="{:.2}" y="{top:.1}" width="{width:.2}" height="{:.1}" fill="{}"/>"#,
                x(span.start_ms),
                LANE - 8.0,
                colour
            );
        }
    }
    svg.push_str("</svg>");
    svg
}

/// A histogram of deviations in µm, with the limits drawn in where they fall into the range.
#[must_use]
pub fn histogram(deviations_um: &[f64], half_range_um: f64, marks_um: &[(f64, &str)]) -> String {
    const BINS: usize = 80;
    const WIDTH: f64 = 900.0;
    const HEIGHT: f64 = 240.0;
    const RIGHT: f64 = 30.0;
    let (left, bottom, top) = (30.0, HEIGHT - 36.0, 16.0);
    let mut counts = [0_usize; BINS];
    let mut outside = 0_usize;
    for &deviation in deviations_um {
        let bin = ((deviation + half_range_um) / (2.0 * half_range_um) * BINS as f64).floor();
        match counts.get_mut(bin as usize) {
            Some(count) if bin >= 0.0 => *count += 1,
            _ => outside += 1,
        }
    }
    let peak = counts.iter().copied().max().unwrap_or(0).max(1) as f64;
    let x = |um: f64| left + (um + half_range_um) / (2.0 * half_range_um) * (WIDTH - left - RIGHT);
    let mut svg = open(WIDTH, HEIGHT, "Histogram of deviations");
    for tick in ticks(-half_range_um, half_range_um) {
        let at = x(tick);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{top}" x2="{at:.1}" y2="{bottom}" class="grid"/>"#
        );
        let _ = write!(
            svg,
            r#"<text x="{at:.1}" y="{:.1}" text-anchor="middle">{tick}</text>"#,
            bottom + 16.0
        );
    }
    let width = (WIDTH - left - RIGHT) / BINS as f64;
    for (bin, &count) in counts.iter().enumerate() {
        let height = count as f64 / peak * (bottom - top);
        let centre_um = (bin as f64 + 0.5) / BINS as f64 * 2.0 * half_range_um - half_range_um;
        let [r, g, b] = super::colour::diverging(centre_um / half_range_um);
        let _ = write!(
            svg,
            r#"<rect x="{:.2}" y="{:.2}" width="{:.2}" height="{height:.2}" fill="rgb({r},{g},{b})" stroke="var(--muted)" stroke-width=".4"/>"#,
            left + bin as f64 * width,
            bottom - height,
            width
        );
    }
    for (um, name) in marks_um.iter().filter(|(um, _)| um.abs() <= half_range_um) {
        let at = x(*um);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{top}" x2="{at:.1}" y2="{bottom}" class="mark"/>"#
        );
        let _ = write!(
            svg,
            r#"<text x="{at:.1}" y="{:.1}" text-anchor="middle" class="mark">{name}</text>"#,
            top - 2.0
        );
    }
    let _ = write!(
        svg,
        r#"<text x="{left:.1}" y="{:.1}">points, most in one bin: {peak}</text><text x="{:.1}" y="{:.1}" text-anchor="end">deviation / µm (minus: material missing) · {outside} points beyond the axis</text></svg>"#,
        HEIGHT - 4.0,
        WIDTH - RIGHT,
        HEIGHT - 4.0
    );
    svg
}

/// A colour bar from `-full_um` to `+full_um`, with the limits drawn in.
#[must_use]
pub fn colour_bar(full_um: f64, marks_um: &[(f64, &str)]) -> String {
    const WIDTH: f64 = 420.0;
    const STEPS: usize = 84;
    let mut svg = open(WIDTH, 58.0, "Colour bar of the deviation maps");
    let step = (WIDTH - 40.0) / STEPS as f64;
    for i in 0..STEPS {
        let [r, g, b] = super::colour::diverging((i as f64 + 0.5) / STEPS as f64 * 2.0 - 1.0);
        let _ = write!(
            svg,
            r#"<rect x="{:.2}" y="16" width="{:.2}" height="16" fill="rgb({r},{g},{b})"/>"#,
            20.0 + i as f64 * step,
            step + 0.3
        );
    }
    for share in [-1.0, -0.5, 0.0, 0.5, 1.0] {
        let at = 20.0 + (share + 1.0) / 2.0 * (WIDTH - 40.0);
        let _ = write!(
            svg,
            r#"<text x="{at:.1}" y="46" text-anchor="middle">{:+.0}</text>"#,
            share * full_um + 0.0
        );
    }
    for (um, name) in marks_um {
        let at = 20.0 + (um / full_um + 1.0) / 2.0 * (WIDTH - 40.0);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="13" x2="{at:.1}" y2="32" class="mark"/><text x="{at:.1}" y="11" text-anchor="middle" class="mark">{name}</text>"#
        );
    }
    let _ = write!(
        svg,
        r#"<text x="{:.1}" y="57" text-anchor="middle">deviation / µm</text></svg>"#,
        WIDTH / 2.0
    );
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_drawn_or_counted_as_beyond_the_axis() {
        let svg = histogram(&[-1000.0, 0.0, 0.0, 5.0, f64::NAN, 99.9, 100.1], 100.0, &[]);
        assert!(
            svg.contains("· 3 points beyond the axis"),
            "two beyond and one without a value: {svg}"
        );
        assert!(svg.contains("most in one bin: 2"));
    }
}
