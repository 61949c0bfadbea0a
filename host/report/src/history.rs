//! The page of a tool's history: wear of each flank against cycles.

use askama::Template;
use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::verdict::Word;

use super::trend_chart::{Checks, Legend, horizon_cycles, one, overlay};
use super::{Fact, Words, facts, figure, numbered};
use flankscope_record::history::{Acknowledgement, Check, Forecast};

/// Number of latest checks that the page lists.
const LISTED: usize = 20;

#[derive(Template)]
#[template(path = "history.html")]
struct Page<'a> {
    tool: &'a str,
    checks: usize,
    last: Option<&'a Check>,
    facts: Vec<Fact>,
    words: &'static Words,
    simulated: bool,
    overlay: String,
    legend: Vec<Legend>,
    flanks: Vec<Flank<'a>>,
    listed: Vec<&'a Check>,
    acknowledgements: &'a [Acknowledgement],
}

struct Flank<'a> {
    forecast: &'a Forecast,
    verdict: Word,
    now: String,
    chart: String,
    rate: String,
    remaining: String,
}

/// Writes the page of a tool's history.
///
/// # Errors
/// Errors of the template engine; none occur when formatting to memory.
pub fn history_html(
    tool: &str,
    checks: &[Check],
    acknowledgements: &[Acknowledgement],
    forecasts: &[Forecast],
) -> Result<String, askama::Error> {
    let known = Checks::of(checks);
    let last = checks.last();
    let flanks = forecasts.iter().map(|forecast| Flank {
        forecast,
        verdict: last.map_or(Word::Indeterminate, |check| on_flank(check, forecast)),
        now: forecast.points.last().map_or_else(
            || "–".into(),
            |p| {
                format!(
                    "{} ± {}",
                    figure(Some(p.wear_um)),
                    figure(Some(COVERAGE_95 * p.u_um))
                )
            },
        ),
        chart: one(forecast, &known),
        rate: rate(forecast),
        remaining: remaining(forecast),
    });
    let (overlay, legend) = overlay(forecasts, &known);
    let page = Page {
        tool,
        checks: checks.len(),
        last,
        facts: last.map_or(Vec::new(), |last| {
            let cycles = Some(last.tool_cycles);
            facts(
                &last.at,
                tool,
                numbered(Some(last.id)),
                cycles,
                &last.origin,
            )
        }),
        words: Words::of(forecasts.iter().map(|of| &of.id)),
        simulated: checks.iter().any(|check| check.origin.simulated),
        overlay,
        legend,
        flanks: flanks.collect(),
        listed: checks.iter().rev().take(LISTED).collect(),
        acknowledgements,
    };
    page.render()
}

/// Verdict of a check on a flank.
fn on_flank(check: &Check, of: &Forecast) -> Word {
    let mut flanks = check.flanks.iter();
    let flank = flanks.find(|f| f.id.is_same(&of.id));
    flank.map_or(Word::Indeterminate, |f| f.verdict)
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

/// Remaining cycles: the number that 95 of 100 such flanks reach, and the median. No trend is extrapolated beyond ten times the
/// cycles of its data.
#[must_use]
pub fn remaining(forecast: &Forecast) -> String {
    let Some(horizon) = horizon_cycles(forecast) else {
        return "–".into();
    };
    let within = |cycles: Option<f64>| cycles.filter(|cycles| *cycles <= horizon);
    let Some(q05) = within(forecast.remaining_cycles.q05) else {
        return format!("> {horizon:.0}, not extrapolated");
    };
    let half = within(forecast.remaining_cycles.q50).map_or_else(
        || format!("> {horizon:.0}"),
        |q50| format!("{:.0}", q50.floor()),
    );
    format!("{:.0} (half: {half})", q05.floor())
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_record::document::FeatureId;
    use flankscope_record::history::{Point, Series};
    use flankscope_record::origin::{HeadId, Origin};

    fn left(tooth: u32) -> FeatureId {
        FeatureId {
            tooth,
            flank: flankscope_metrology::gear::Flank::Left,
            patch: None,
        }
    }

    /// A flank that wears by `rate_um` per cycle, measured every 10 cycles.
    fn flank(tooth: u32, rate_um: f64) -> Forecast {
        let point = |i: i64| Point {
            check: i + 1,
            cycles: 10.0 * i as f64,
            wear_um: rate_um * 10.0 * i as f64 + if i % 2 == 0 { 0.02 } else { -0.02 },
            u_um: 0.5,
        };
        Forecast::of(Series {
            id: left(tooth),
            warn_um: 30.0,
            limit_um: 50.0,
            points: (0..11).map(point).collect(),
        })
    }

    fn check(id: i64, verdict: Word) -> Check {
        let row = |tooth, verdict| flankscope_record::history::FlankRow {
            id: left(tooth),
            wear_um: Some(1.0),
            u95_um: Some(1.0),
            warn_um: 30.0,
            limit_um: 50.0,
            verdict,
            code: None,
        };
        Check {
            id,
            at: format!("2026-02-{id:02}T12:00:00Z"),
            tool: "die <b>".into(),
            tool_cycles: 10 * (id - 1),
            press_cycles: 0,
            baseline: None,
            verdict,
            reason: "because".into(),
            origin: Origin {
                link: "sim".into(),
                simulated: true,
                head: HeadId {
                    name: "head".into(),
                    blake3: String::new(),
                    seal: "unsigned".into(),
                },
                station: "press 7".into(),
                operator: None,
                recording: None,
            },
            serial: None,
            flanks: vec![row(12, verdict), row(40, Word::Go)],
        }
    }

    /// Data over 100 cycles give no forecast for the 2000th cycle; forecasts within the horizon are shown.
    #[test]
    fn no_trend_is_drawn_out_far_beyond_its_figures() {
        assert_eq!(remaining(&flank(12, 0.0)), "> 1000, not extrapolated");
        assert_eq!(remaining(&flank(12, 0.02)), "> 1000, not extrapolated");
        let soon = flank(12, 0.4);
        let words = remaining(&soon);
        let half: f64 = words
            .split("half: ")
            .nth(1)
            .unwrap()
            .trim_end_matches(')')
            .parse()
            .unwrap();
        // 10 µm at 0.4 µm per cycle.
        assert!((20.0..=30.0).contains(&half), "{words}");
        let few = Forecast {
            trend: None,
            ..soon
        };
        assert_eq!(remaining(&few), "–");
    }

    #[test]
    fn the_page_shows_verdicts_dates_and_the_way_to_the_limit() {
        let mut checks: Vec<Check> = (1..=10).map(|id| check(id, Word::Go)).collect();
        checks.push(check(11, Word::Warn));
        let forecasts = [flank(12, 0.4), flank(40, 0.0)];
        let page = history_html("die <b>", &checks, &[], &forecasts).unwrap();
        assert!(!page.contains("die <b>"), "names are escaped");
        // An overlay of both, and one for each.
        assert_eq!(page.matches("<svg").count(), 3);
        assert_eq!(page.matches("class=\"band\"").count(), 2);
        // Ten of eleven values of the first flank are "go", as are all of the second.
        assert_eq!(page.matches("class=\"v-go\"><title>check").count(), 21);
        assert_eq!(
            page.matches("class=\"v-warn\"><title>check 11, 2026-02-11T")
                .count(),
            1
        );
        for shown in ["2026-02-01<", "2026-02-11<", "&#62; 1000, not extrapolated"] {
            assert!(page.contains(shown), "{shown}");
        }
    }
    /// Eight flanks: six lines of their own colour, two in grey; and a patch whose name would be a tag.
    #[test]
    fn the_legend_names_every_line_of_the_overlay() {
        let checks: Vec<Check> = (1..=11).map(|id| check(id, Word::Go)).collect();
        let mut forecasts: Vec<Forecast> = (1..=8)
            .map(|tooth| flank(tooth, 0.05 * f64::from(tooth)))
            .collect();
        forecasts[7].id.patch = Some("<i>shoulder".into());
        let page = history_html("die", &checks, &[], &forecasts).unwrap();
        assert!(!page.contains("<i>shoulder"), "names are escaped");
        let legend = page.split("class=\"legend\"").nth(1).unwrap();
        let legend = legend.split("</p>").next().unwrap();
        assert_eq!(legend.matches("<span").count(), 7);
        // The largest loss first; those in grey share the last sign.
        let mut rest = legend;
        for tooth in ["shoulder".into()]
            .into_iter()
            .chain((1..8).rev().map(|tooth| format!("tooth {tooth} left")))
        {
            let (_, after) = rest
                .split_once(&tooth)
                .unwrap_or_else(|| panic!("{tooth}: {legend}"));
            rest = after;
        }
        // As many lines are drawn as are named, in the legend's colours.
        assert_eq!(page.matches("<polyline").count(), forecasts.len());
        let grey = page.matches("stroke=\"#a8b0b8\"").count();
        assert_eq!((grey, legend.matches("#a8b0b8").count()), (2, 1));
    }

    /// A history of one day says its times; of several days, the days.
    #[test]
    fn an_axis_of_one_day_says_when_it_began_and_ended() {
        let mut checks: Vec<Check> = (1..=11).map(|id| check(id, Word::Go)).collect();
        for (at, check) in checks.iter_mut().enumerate() {
            check.at = format!("2026-02-03T12:{:02}:30Z", 3 * at);
        }
        let page = history_html("die", &checks, &[], &[flank(12, 0.0)]).unwrap();
        for shown in [">2026-02-03 12:00<", ">12:30 UTC<"] {
            // In the overlay and in the flank's own chart.
            assert_eq!(page.matches(shown).count(), 2, "{shown}");
        }
    }
}
