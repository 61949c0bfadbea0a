//! Charts of a check: activity of the devices over time, histogram of deviations, colour scale.

use std::fmt::Write as _;

use flankscope_metrology::verdict::Word;

use super::plot::{Axes, Series, binned};
use super::svg::{open, sign, ticks};
use flankscope_foundation::activity::{Activity, Device, Span};
use flankscope_metrology::kinematics::Moves;

/// Name and fill of a device's lane.
fn lane(device: Device, moves: Moves) -> (&'static str, &'static str) {
    match device {
        Device::Stages if moves != Moves::Die => ("head moves", "#7a8794"),
        Device::Stages => ("stages move", "#7a8794"),
        Device::Settling => ("settle", "#b9c2cb"),
        Device::Led => ("LED on", "#e0a100"),
        Device::Dmd => ("DMD switches", "#8c6bb1"),
        Device::Camera => ("camera exposes", "#2b6cb0"),
        Device::Held => ("press held", "#b2182b"),
    }
}

/// Position and size of the lanes, px.
const LEFT: f64 = 118.0;
const WIDTH: f64 = 900.0;
const LANE: f64 = 24.0;

/// One lane per device over a common time axis, then markers of the press: held, head clear (the controller is ready again), and
/// the verdict `to_verdict_ms` after the last exposure, or once the head is out.
#[must_use]
pub fn timeline(
    activities: &[Activity],
    moves: Moves,
    verdict: Word,
    to_verdict_ms: f64,
) -> String {
    let spans = |of: &dyn Fn(Device) -> bool| -> Vec<Span> {
        let asked = activities.iter().filter(|activity| of(activity.device));
        asked.flat_map(|activity| activity.spans.clone()).collect()
    };
    let last = |spans: &[Span]| spans.iter().map(|span| span.end_ms).fold(0.0, f64::max);
    let held = spans(&|device| device == Device::Held);
    let evaluated_ms = last(&spans(&|device| device == Device::Camera)) + to_verdict_ms;
    let verdict_ms = evaluated_ms.max(last(&held));
    let end_ms = 1.03 * verdict_ms.max(last(&spans(&|_| true))).max(1.0);
    let clear = between(&held, end_ms);
    let x = |ms: f64| LEFT + ms / end_ms * (WIDTH - LEFT - 10.0);
    let lanes = activities.len() + 2;
    let height = LANE * lanes as f64 + 40.0;
    let bottom = height - 36.0;
    let mut svg = open(
        WIDTH,
        height,
        "Timeline from the start order to the verdict",
    );
    for tick in ticks(0.0, end_ms) {
        let at = x(tick);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="0" x2="{at:.1}" y2="{bottom}" class="grid"/><text x="{at:.1}" y="{:.1}" text-anchor="middle">{} s</text>"#,
            bottom + 16.0,
            tick / 1000.0
        );
    }
    let mut draw = |number: usize, name: &str, colour: &str, spans: &[Span]| {
        let top = LANE * number as f64 + 4.0;
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="{:.1}" text-anchor="end">{name}</text>"#,
            LEFT - 8.0,
            top + 12.0
        );
        // One element per span would need as much space as a file; a single path still shows every pause.
        let mut shape = String::new();
        for span in spans {
            // Wide enough to show a trigger of a millisecond.
            let width = (x(span.end_ms) - x(span.start_ms)).max(0.6);
            let _ = write!(
                shape,
                "M{:.1} {top:.0}h{width:.1}v{h:.0}h-{width:.1}z",
                x(span.start_ms),
                h = LANE - 8.0
            );
        }
        let busy_s = spans.iter().map(|s| s.end_ms - s.start_ms).sum::<f64>() / 1e3;
        let _ = write!(
            svg,
            r#"<path d="{shape}" fill="{colour}"><title>{name}: {busy_s:.2} s in all</title></path>"#
        );
    };
    for (number, activity) in activities.iter().enumerate() {
        let (name, colour) = lane(activity.device, moves);
        draw(number, name, colour, &activity.spans);
    }
    draw(lanes - 2, "head clear, ready", "#1b7f5c", &clear);
    draw(lanes - 1, "verdict", "none", &[]);
    let at = x(verdict_ms);
    let top = LANE * (lanes - 1) as f64;
    let _ = write!(
        svg,
        r#"<line x1="{at:.1}" y1="0" x2="{at:.1}" y2="{bottom}" class="mark"/><text x="{:.1}" y="{:.1}" text-anchor="end" font-weight="700">{verdict} at {:.2} s</text>"#,
        at - 12.0,
        top + 16.0,
        verdict_ms / 1e3
    );
    let said = format!(
        "{verdict}: flanks evaluated {:.2} s after the start order",
        evaluated_ms / 1e3
    );
    sign(&mut svg, verdict, [at, top + 12.0], 6.0, &said);
    svg.push_str("</svg>");
    svg
}

/// Gaps between spans, from 0 to `end_ms`.
fn between(spans: &[Span], end_ms: f64) -> Vec<Span> {
    let mut since = 0.0;
    let mut found = Vec::new();
    for span in spans {
        found.push(Span {
            start_ms: since,
            end_ms: span.start_ms,
        });
        since = span.end_ms;
    }
    found.push(Span {
        start_ms: since,
        end_ms,
    });
    found.retain(|span| span.end_ms > span.start_ms);
    found
}

/// A histogram of deviations in µm, with the limits that lie within the range.
#[must_use]
pub fn histogram(deviations_um: &[f64], half_range_um: f64, limits_um: Option<[f64; 2]>) -> String {
    const BINS: usize = 80;
    let range = [-half_range_um, half_range_um];
    let (counts, beyond) = binned(deviations_um, range, BINS);
    let total = deviations_um.len().max(1) as f64;
    let width = 2.0 * half_range_um / BINS as f64;
    let bars: Vec<(f64, String)> = counts
        .iter()
        .enumerate()
        .map(|(bin, count)| {
            let centre = (bin as f64 + 0.5) * width - half_range_um;
            let [r, g, b] = super::colour::diverging(centre / half_range_um);
            (100.0 * count / total, format!("rgb({r},{g},{b})"))
        })
        .collect();
    let most = bars.iter().map(|(share, _)| *share).fold(0.1, f64::max);
    let mut series = vec![Series::Bars(&bars)];
    if let Some([warn, stop]) = limits_um {
        series.extend([Series::Mark(-warn, "warn"), Series::Mark(-stop, "stop")]);
    }
    let label = format!(
        "deviation / µm (minus: material missing) · {} points, {beyond} beyond the axis",
        deviations_um.len()
    );
    Axes {
        title: "Histogram of deviations",
        size: [900.0, 210.0],
        x: (range, &label),
        y: ([0.0, 1.05 * most], "points / %"),
    }
    .draw(&series)
}

/// A colour bar from `-full_um` to `+full_um`, with markers of warning and stop limit.
#[must_use]
pub fn colour_bar(full_um: f64, limits_um: Option<[f64; 2]>) -> String {
    const STEPS: usize = 84;
    let colours: Vec<[u8; 3]> = (0..STEPS)
        .map(|i| super::colour::diverging((i as f64 + 0.5) / STEPS as f64 * 2.0 - 1.0))
        .collect();
    let label = "deviation / µm (minus: material missing)";
    bar(&colours, [-full_um, full_um], label, limits_um)
}

/// A colour bar of the sequential scale from 0 to `full`.
#[must_use]
pub fn amount_bar(full: f64, label: &str) -> String {
    const STEPS: usize = 42;
    let colours: Vec<[u8; 3]> = (0..STEPS)
        .map(|i| super::colour::sequential((i as f64 + 0.5) / STEPS as f64))
        .collect();
    bar(&colours, [0.0, full], label, None)
}

fn bar(
    colours: &[[u8; 3]],
    [from, to]: [f64; 2],
    label: &str,
    limits_um: Option<[f64; 2]>,
) -> String {
    const WIDTH: f64 = 420.0;
    let mut svg = open(WIDTH, 62.0, &format!("Colours: {label}"));
    let step = (WIDTH - 40.0) / colours.len() as f64;
    for (i, [r, g, b]) in colours.iter().enumerate() {
        let _ = write!(
            svg,
            r#"<rect x="{:.1}" y="16" width="{:.1}" height="16" fill="rgb({r},{g},{b})"/>"#,
            20.0 + i as f64 * step,
            step + 0.3
        );
    }
    let x = |value: f64| 20.0 + (value - from) / (to - from) * (WIDTH - 40.0);
    for tick in super::svg::about(5.0, from, to) {
        let _ = write!(
            svg,
            r#"<text x="{:.1}" y="46" text-anchor="middle">{tick}</text>"#,
            x(tick)
        );
    }
    let limits = limits_um.map_or(Vec::new(), |[warn, stop]| {
        vec![(-warn, "warn"), (-stop, "stop")]
    });
    for (um, name) in limits.into_iter().filter(|(um, _)| *um >= from) {
        let at = x(um);
        let _ = write!(
            svg,
            r#"<line x1="{at:.1}" y1="13" x2="{at:.1}" y2="34" class="mark {name}"/><text x="{at:.1}" y="11" text-anchor="middle" class="mark {name}">{name}</text>"#
        );
    }
    let _ = write!(
        svg,
        r#"<text x="{:.1}" y="60" text-anchor="middle">{label}</text></svg>"#,
        WIDTH / 2.0
    );
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_drawn_or_counted_as_beyond_the_axis() {
        let svg = histogram(
            &[-1000.0, 0.0, 0.0, 5.0, f64::NAN, 99.9, 100.1],
            100.0,
            Some([30.0, 50.0]),
        );
        assert!(
            svg.contains("7 points, 3 beyond the axis"),
            "two beyond and one without a value: {svg}"
        );
        assert!(svg.contains("mark warn") && svg.contains("mark stop"));
    }

    /// The head is clear when the press is not held; the verdict comes when flanks are evaluated and the head is out.
    #[test]
    fn the_timeline_ends_with_the_verdict() {
        let span = |start_ms, end_ms| Span { start_ms, end_ms };
        let of = |device, spans: &[Span]| Activity {
            device,
            spans: spans.to_vec(),
        };
        let activities = [
            of(Device::Camera, &[span(1000.0, 2000.0)]),
            of(Device::Held, &[span(100.0, 3000.0)]),
        ];
        assert!(timeline(&activities, Moves::Die, Word::Go, 500.0).contains("go at 3.00 s"));
        let late = timeline(&activities, Moves::Head, Word::NoGo, 1750.0);
        assert!(late.contains("no-go at 3.75 s") && late.contains("press held: 2.90 s in all"));
        let clear = between(&[span(100.0, 3000.0)], 4000.0);
        assert_eq!(clear, [span(0.0, 100.0), span(3000.0, 4000.0)]);
        assert_eq!(between(&[], 5.0), [span(0.0, 5.0)]);
    }
}
