//! Charts of wear against cycles: an overlay of all flanks of a tool, and one per flank with the extrapolation to the stop limit.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::verdict::Word;

use super::figure;
use super::svg::{about, escaped, open, sign};
use flankscope_record::history::{Check, Forecast, Point};

/// A trend is extrapolated up to this many times the range of its data.
const AHEAD: f64 = 10.0;
/// Number of steps of the uncertainty band.
const STEPS: u32 = 12;
/// Colours of the flanks with the largest loss in the overlay; the others share one grey.
const COLOURS: [&str; 6] = [
    "#b2182b", "#2b6cb0", "#1b7f5c", "#8a4fb0", "#b7791f", "#4a5568",
];
const GREY: &str = "#a8b0b8";
/// Dashes of a line, and the same as a border of its sign in the legend. Neighbours differ in them, for who does not tell colours.
const DASHES: [(&str, &str); 3] = [("none", "solid"), ("7 3", "dashed"), ("2 2", "dotted")];

/// Largest extrapolation of a trend, cycles from its last value; `None` without a trend.
pub(super) fn horizon_cycles(forecast: &Forecast) -> Option<f64> {
    let trend = forecast.trend?;
    let since = forecast.points.len().checked_sub(trend.points)?;
    let (first, last) = (forecast.points.get(since)?, forecast.points.last()?);
    Some(AHEAD * (last.cycles - first.cycles))
}

/// The checks that the values come from, by number.
pub(super) struct Checks<'a>(BTreeMap<i64, &'a Check>);

impl<'a> Checks<'a> {
    pub(super) fn of(checks: &'a [Check]) -> Self {
        Self(checks.iter().map(|check| (check.id, check)).collect())
    }

    /// Verdict on the flank and date of a value, if known.
    fn of_figure(&self, of: &Forecast, point: &Point) -> (Word, &'a str) {
        let Some(check) = self.0.get(&point.check) else {
            return (Word::Indeterminate, "–");
        };
        let mut flanks = check.flanks.iter();
        let flank = flanks.find(|f| f.id.is_same(&of.id));
        (flank.map_or(Word::Indeterminate, |f| f.verdict), &check.at)
    }
}

/// Scales of cycles and wear in a picture.
struct Frame {
    width: f64,
    height: f64,
    cycles: [f64; 2],
    wear_um: [f64; 2],
}

const LEFT: f64 = 44.0;
const RIGHT: f64 = 40.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 50.0;

impl Frame {
    fn right(&self) -> f64 {
        self.width - RIGHT
    }

    fn bottom(&self) -> f64 {
        self.height - BOTTOM
    }

    fn x(&self, cycles: f64) -> f64 {
        let [from, to] = self.cycles;
        LEFT + (cycles - from) / (to - from).max(1.0) * (self.right() - LEFT)
    }

    fn y(&self, um: f64) -> f64 {
        let [low, high] = self.wear_um;
        self.bottom() - (um.clamp(low, high) - low) / (high - low).max(1.0) * (self.bottom() - TOP)
    }

    /// Axes and limits, with the dates of the first and the last value below.
    fn begin(&self, title: &str, limits_um: [f64; 2], dates: [(f64, &str); 2]) -> String {
        let mut svg = open(self.width, self.height, title);
        let (right, bottom) = (self.right(), self.bottom());
        for tick in about(5.0, self.wear_um[0], self.wear_um[1]) {
            let at = self.y(tick);
            let _ = write!(
                svg,
                r#"<line x1="{LEFT}" y1="{at:.1}" x2="{right}" y2="{at:.1}" class="grid"/><text x="{:.1}" y="{:.1}" text-anchor="end">{tick}</text>"#,
                LEFT - 6.0,
                at + 4.0
            );
        }
        for tick in about(self.width / 90.0, self.cycles[0], self.cycles[1]) {
            let at = self.x(tick);
            let _ = write!(
                svg,
                r#"<line x1="{at:.1}" y1="{TOP}" x2="{at:.1}" y2="{bottom}" class="grid"/><text x="{at:.1}" y="{:.1}" text-anchor="middle">{tick}</text>"#,
                bottom + 15.0
            );
        }
        for (um, name) in limits_um.into_iter().zip(["warn", "stop"]) {
            let at = self.y(um);
            let _ = write!(
                svg,
                r#"<line x1="{LEFT}" y1="{at:.1}" x2="{right}" y2="{at:.1}" class="mark {name}"/><text x="{:.1}" y="{:.1}" class="mark {name}">{name}</text>"#,
                right + 4.0,
                at + 4.0
            );
        }
        let [first, last] = dates.map(|(cycles, _)| self.x(cycles));
        let [begun, ended] = days_or_times(dates.map(|(_, at)| at));
        let _ = write!(
            svg,
            r#"<text x="{LEFT}" y="{:.1}">wear / µm</text><text x="{first:.1}" y="{y:.1}" text-anchor="start" class="date">{begun}</text>"#,
            TOP - 3.0,
            y = bottom + 29.0
        );
        // Only if both fit below their values.
        if last - first > 150.0 {
            let _ = write!(
                svg,
                r#"<text x="{last:.1}" y="{:.1}" text-anchor="end" class="date">{ended}</text>"#,
                bottom + 29.0
            );
        }
        let _ = write!(
            svg,
            r#"<text x="{right}" y="{:.1}" text-anchor="end">cycles of the tool</text>"#,
            self.height - 4.0
        );
        svg
    }
}

/// First and last date as days; within one day with the time, because two equal days would not say how long it took.
fn days_or_times(dates: [&str; 2]) -> [String; 2] {
    let split = dates.map(|at| at.split_once('T').unwrap_or((at, "")));
    let [(first, begun), (last, ended)] = split;
    let minute = |time: &str| time.get(..5).unwrap_or(time).to_owned();
    if first == last && !begun.is_empty() {
        [
            format!("{first} {}", minute(begun)),
            format!("{} UTC", minute(ended)),
        ]
    } else {
        [first.to_owned(), last.to_owned()]
    }
}

fn range(points: &[Point]) -> [f64; 2] {
    match (points.first(), points.last()) {
        (Some(first), Some(last)) => [first.cycles, last.cycles.max(first.cycles + 1.0)],
        _ => [0.0, 1.0],
    }
}

/// Range of the values with their uncertainties and of the stop limit.
fn heights<'a>(points: impl Iterator<Item = &'a Point>, limit_um: f64) -> [f64; 2] {
    points.fold([0.0, 1.15 * limit_um], |[low, high], p| {
        let half = COVERAGE_95 * p.u_um;
        [low.min(p.wear_um - half), high.max(p.wear_um + half)]
    })
}

/// A line of the overlay in its legend: the sign's colour and border, and the flanks that it stands for.
pub(super) struct Legend {
    pub(super) colour: &'static str,
    pub(super) border: &'static str,
    pub(super) names: Vec<String>,
}

/// All flanks in one chart, and its legend: those with the largest loss each in its colour, the others in grey.
pub(super) fn overlay(forecasts: &[Forecast], checks: &Checks<'_>) -> (String, Vec<Legend>) {
    let all = || forecasts.iter().flat_map(|f| &f.points);
    let first = all().map(|p| p.cycles).fold(f64::INFINITY, f64::min);
    let last = all().map(|p| p.cycles).fold(f64::NEG_INFINITY, f64::max);
    let limit = |of: fn(&Forecast) -> f64| forecasts.iter().map(of).fold(0.0, f64::max);
    let limits_um = [limit(|f| f.warn_um), limit(|f| f.limit_um)];
    let frame = Frame {
        width: 900.0,
        height: 270.0,
        cycles: if first.is_finite() {
            [first, last.max(first + 1.0)]
        } else {
            [0.0, 1.0]
        },
        wear_um: heights(all(), limits_um[1]),
    };
    let mut dated = forecasts
        .iter()
        .flat_map(|f| f.points.iter().map(move |p| (f, p)));
    let begun = dated
        .clone()
        .min_by(|a, b| a.1.cycles.total_cmp(&b.1.cycles));
    let ended = dated
        .by_ref()
        .max_by(|a, b| a.1.cycles.total_cmp(&b.1.cycles));
    let dates = [begun, ended]
        .map(|of| of.map_or((0.0, "–"), |(f, p)| (p.cycles, checks.of_figure(f, p).1)));
    let mut svg = frame.begin("Wear against cycles, all in one", limits_um, dates);
    let mut order: Vec<&Forecast> = forecasts.iter().filter(|f| !f.points.is_empty()).collect();
    let now = |f: &Forecast| f.points.last().map_or(0.0, |p| p.wear_um);
    order.sort_by(|a, b| now(b).total_cmp(&now(a)));
    // Those with a colour are drawn last, in front of the others.
    for (place, of) in order.iter().enumerate().rev() {
        let line: Vec<String> = of
            .points
            .iter()
            .map(|p| format!("{:.1},{:.1}", frame.x(p.cycles), frame.y(p.wear_um)))
            .collect();
        let (colour, (dash, _), wide) = match COLOURS.get(place) {
            Some(colour) => (*colour, DASHES[place % DASHES.len()], 2.0),
            None => (GREY, DASHES[0], 1.0),
        };
        let _ = write!(
            svg,
            r#"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="{wide}" stroke-dasharray="{dash}"><title>{}: {} µm now</title></polyline>"#,
            line.join(" "),
            escaped(&of.id.to_string()),
            figure(Some(now(of)))
        );
    }
    let named = COLOURS.iter().zip(DASHES.iter().cycle()).zip(&order);
    let mut legend: Vec<Legend> = named
        .map(|((colour, (_, border)), of)| Legend {
            colour,
            border,
            names: vec![of.id.to_string()],
        })
        .collect();
    if let Some(others @ [_, ..]) = order.get(COLOURS.len()..) {
        legend.push(Legend {
            colour: GREY,
            border: "solid",
            names: others.iter().map(|of| of.id.to_string()).collect(),
        });
    }
    (svg + "</svg>", legend)
}

/// One flank: values with U95 and the symbol of their verdict, changes, and the line with its band up to the limit.
pub(super) fn one(of: &Forecast, checks: &Checks<'_>) -> String {
    let [first, last] = range(&of.points);
    let ahead = drawn_ahead(of);
    let frame = Frame {
        width: 440.0,
        height: 240.0,
        cycles: [first, last + ahead.unwrap_or(0.0)],
        wear_um: heights(of.points.iter(), of.limit_um),
    };
    let title = format!("Wear of {} against cycles", of.id);
    let date = |point: Option<&Point>| {
        point.map_or((0.0, "–"), |p| (p.cycles, checks.of_figure(of, p).1))
    };
    let dates = [date(of.points.first()), date(of.points.last())];
    let mut svg = frame.begin(&title, [of.warn_um, of.limit_um], dates);
    for point in of.points.iter().filter(|p| of.changes.contains(&p.check)) {
        let at = frame.x(point.cycles);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="{TOP}" x2="{at:.1}" y2="{:.1}" class="change"/><text x="{at:.1}" y="{:.1}" text-anchor="middle" class="change">change</text>"#,
            frame.bottom(),
            TOP + 8.0
        );
    }
    draw_trend(&mut svg, of, &frame, ahead);
    // Smaller symbols for many values.
    let radius = if of.points.len() > 60 { 2.2 } else { 3.6 };
    for point in &of.points {
        let half = COVERAGE_95 * point.u_um;
        let (verdict, at) = checks.of_figure(of, point);
        let (x, y) = (frame.x(point.cycles), frame.y(point.wear_um));
        let _ = write!(
            svg,
            r#"<path d="M{x:.1} {:.1}V{:.1}" class="whisker"/>"#,
            frame.y(point.wear_um - half),
            frame.y(point.wear_um + half)
        );
        let said = format!(
            "check {}, {at}, cycle {}: {} ± {} µm, {verdict}",
            point.check,
            point.cycles,
            figure(Some(point.wear_um)),
            figure(Some(half))
        );
        sign(&mut svg, verdict, [x, y], radius, &said);
    }
    svg + "</svg>"
}

/// Extrapolation of a line beyond the last value: to its intersection with the limit, at most up to the horizon.
fn drawn_ahead(of: &Forecast) -> Option<f64> {
    let trend = of.trend?;
    let horizon = horizon_cycles(of)?;
    let to_limit = (of.limit_um - trend.now_um) / trend.rate_um;
    let wanted = if to_limit > 0.0 { 1.1 * to_limit } else { 0.0 };
    // A line that ends far away is drawn a short way only, because otherwise the values would shrink to a dot.
    let shown = if wanted > horizon {
        0.1 * horizon
    } else {
        wanted
    };
    (shown > 0.0).then_some(shown)
}

fn draw_trend(svg: &mut String, of: &Forecast, frame: &Frame, ahead: Option<f64>) {
    let Some(trend) = of.trend else {
        return;
    };
    let on_line = |cycles: f64| trend.now_um + trend.rate_um * (cycles - trend.now_cycles);
    let begin = of
        .points
        .len()
        .checked_sub(trend.points)
        .and_then(|at| of.points.get(at))
        .map_or(trend.now_cycles, |p| p.cycles);
    let end = trend.now_cycles + ahead.unwrap_or(0.0);
    if let (Some(ahead), Some(last)) = (ahead, of.points.last()) {
        let half = |cycles: f64| {
            COVERAGE_95
                * last
                    .u_um
                    .hypot(trend.u_rate_um() * (cycles - trend.now_cycles))
        };
        let places: Vec<f64> = (0..=STEPS)
            .map(|i| trend.now_cycles + ahead * f64::from(i) / f64::from(STEPS))
            .collect();
        let place = |cycles: f64, side: f64| {
            let um = on_line(cycles) + side * half(cycles);
            format!("{:.1},{:.1}", frame.x(cycles), frame.y(um))
        };
        let upper = places.iter().map(|&cycles| place(cycles, 1.0));
        let lower = places.iter().rev().map(|&cycles| place(cycles, -1.0));
        let edge: Vec<String> = upper.chain(lower).collect();
        let _ = write!(
            svg,
            r#"<polygon points="{}" class="band"><title>where the wear will be, 95 %</title></polygon>"#,
            edge.join(" ")
        );
    }
    let _ = write!(
        svg,
        r#"<line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" class="trend"/>"#,
        frame.x(begin),
        frame.y(on_line(begin)),
        frame.x(end),
        frame.y(on_line(end))
    );
}
