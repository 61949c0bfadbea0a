//! The page of a tool's history: wear of each flank against cycles.

use std::fmt::Write as _;

use askama::Template;
use flankscope_foundation::normal::COVERAGE_95;

use super::svg::{open, ticks};
use crate::history::{Acknowledgement, Check, Forecast};

/// Checks that the page lists, the last ones.
const LISTED: usize = 20;

#[derive(Template)]
#[template(path = "history.html")]
struct Page<'a> {
    tool: &'a str,
    checks: usize,
    last: Option<&'a Check>,
    last_number: String,
    simulated: bool,
    unknown: usize,
    flanks: Vec<Flank<'a>>,
    listed: Vec<&'a Check>,
    acknowledgements: &'a [Acknowledgement],
}

struct Flank<'a> {
    forecast: &'a Forecast,
    chart: String,
    rate: String,
    remaining: String,
}

/// Writes the page of a tool's history.
///
/// # Errors
/// The template engine's, which formatting into memory never raises.
pub fn history_html(
    tool: &str,
    checks: &[Check],
    acknowledgements: &[Acknowledgement],
    forecasts: &[Forecast],
) -> Result<String, askama::Error> {
    let flanks = forecasts.iter().map(|forecast| Flank {
        forecast,
        chart: wear(forecast),
        rate: rate(forecast),
        remaining: remaining(forecast),
    });
    let page = Page {
        tool,
        checks: checks.len(),
        last: checks.last(),
        last_number: super::numbered(checks.last().map(|last| last.id)),
        simulated: checks.iter().any(|check| check.origin.is_simulated()),
        unknown: checks
            .iter()
            .filter(|check| check.origin.simulated.is_none())
            .count(),
        flanks: flanks.collect(),
        listed: checks.iter().rev().take(LISTED).collect(),
        acknowledgements,
    };
    page.render()
}

/// Rate of wear with its interval, µm per thousand cycles.
#[must_use]
pub fn rate(forecast: &Forecast) -> String {
    forecast.trend.map_or_else(
        || "–".into(),
        |trend| {
            let [low, high] = trend.rate_um_95;
            format!(
                "{:.1} ({:.1} to {:.1})",
                1e3 * trend.rate_um + 0.0,
                1e3 * low + 0.0,
                1e3 * high + 0.0
            )
        },
    )
}

/// Remaining cycles: those that 95 of 100 such flanks do, and those that half of them do.
#[must_use]
pub fn remaining(forecast: &Forecast) -> String {
    match (forecast.trend, forecast.remaining_cycles.q05) {
        (None, _) => "–".into(),
        (Some(_), None) => "no end in sight".into(),
        (Some(_), Some(q05)) => {
            let q50 = forecast.remaining_cycles.q50;
            format!(
                "{:.0} (half: {})",
                q05.floor(),
                q50.map_or_else(
                    || "not in sight".into(),
                    |q50| format!("{:.0}", q50.floor())
                )
            )
        }
    }
}

/// Wear against cycles: figures with their expanded uncertainty, limits, changes, and the trend.
fn wear(forecast: &Forecast) -> String {
    const WIDTH: f64 = 900.0;
    const HEIGHT: f64 = 260.0;
    let (left, right, top, bottom) = (46.0, WIDTH - 60.0, 14.0, HEIGHT - 36.0);
    let points = &forecast.points;
    let cycles = |f: fn(f64, f64) -> f64, from: f64| points.iter().map(|p| p.cycles).fold(from, f);
    let (first, last) = (
        cycles(f64::min, f64::INFINITY),
        cycles(f64::max, f64::NEG_INFINITY),
    );
    let (first, last) = if first.is_finite() {
        (first, last)
    } else {
        (0.0, 1.0)
    };
    let span = (last - first).max(1.0);
    let wear_um = |f: fn(f64, f64) -> f64, from: f64, side: f64| {
        points
            .iter()
            .map(|p| p.wear_um + side * COVERAGE_95 * p.u_um)
            .fold(from, f)
    };
    let low = wear_um(f64::min, 0.0, -1.0);
    let high = wear_um(f64::max, 1.1 * forecast.limit_um, 1.0);
    let height = (high - low).max(1.0);
    let x = |cycles: f64| left + (cycles - first) / span * (right - left);
    let y = |um: f64| bottom - (um - low) / height * (bottom - top);
    let title = format!(
        "Wear of tooth {} {} against cycles",
        forecast.tooth, forecast.flank
    );
    let mut svg = open(WIDTH, HEIGHT, &title);
    for tick in ticks(low, low + height) {
        let at = y(tick);
        let _ = write!(
            svg,
            r#"<line x1="{left}" y1="{at:.1}" x2="{right}" y2="{at:.1}" class="grid"/><text x="{:.1}" y="{:.1}" text-anchor="end">{tick}</text>"#,
            left - 6.0,
            at + 4.0
        );
    }
    for tick in ticks(first, first + span) {
        let at = x(tick);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{top}" x2="{at:.1}" y2="{bottom}" class="grid"/><text x="{at:.1}" y="{:.1}" text-anchor="middle">{tick}</text>"#,
            bottom + 16.0
        );
    }
    for (um, name) in [(forecast.warn_um, "warn"), (forecast.limit_um, "stop")] {
        let at = y(um);
        let _ = write!(
            svg,
            r#"<line x1="{left}" y1="{at:.1}" x2="{right}" y2="{at:.1}" class="mark {name}"/><text x="{:.1}" y="{:.1}" class="mark {name}">{name}</text>"#,
            right + 6.0,
            at + 4.0
        );
    }
    for point in points
        .iter()
        .filter(|p| forecast.changes.contains(&p.check))
    {
        let at = x(point.cycles);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{top}" x2="{at:.1}" y2="{bottom}" class="change"/><text x="{at:.1}" y="{:.1}" text-anchor="middle" class="change">change</text>"#,
            top - 3.0
        );
    }
    if let Some(trend) = forecast.trend {
        // From the first point of the line to the edge of the picture.
        let begin = points
            .len()
            .checked_sub(trend.points)
            .map_or(first, |at| points[at].cycles);
        let on_line = |cycles: f64| trend.now_um + trend.rate_um * (cycles - trend.now_cycles);
        let _ = write!(
            svg,
            r#"<line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" class="trend"/>"#,
            x(begin),
            y(on_line(begin)),
            x(last),
            y(on_line(last))
        );
    }
    for point in points {
        let at = x(point.cycles);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{:.1}" x2="{at:.1}" y2="{:.1}" class="bar"/><circle cx="{at:.1}" cy="{:.1}" r="2.2" class="figure"/>"#,
            y(point.wear_um - COVERAGE_95 * point.u_um),
            y(point.wear_um + COVERAGE_95 * point.u_um),
            y(point.wear_um)
        );
    }
    let _ = write!(
        svg,
        r#"<text x="{left}" y="{:.1}">wear / µm</text><text x="{right}" y="{:.1}" text-anchor="end">cycles of the tool</text></svg>"#,
        HEIGHT - 2.0,
        HEIGHT - 2.0
    );
    svg
}
