//! Prometheus' text (OpenMetrics): base units, names by that project's conventions.

use std::fmt;
use std::sync::atomic::AtomicU64;

use flankscope_metrology::verdict::Word;
use flankscope_record::document::LiveState;
use jiff::Timestamp;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::standing::{Standing, Worth};

/// Type of the text, for the answer's header.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels = Vec<(&'static str, String)>;
type Counters = Family<Labels, Counter>;
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;

/// The metrics of what stands now, and of the watch, if one runs.
///
/// # Errors
/// None occur when writing to memory.
pub fn text(
    standing: &Standing,
    live: Option<&LiveState>,
    now: Timestamp,
) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("flankscope");
    let mut gauges = |name: &str, help: &str| {
        let family = Gauges::default();
        registry.register(name, help, family.clone());
        family
    };
    let readable = gauges(
        "history_readable",
        "1 if the history can be read and is whole",
    );
    let counts_now = gauges(
        "verdict_counts",
        "1 if the last verdict is neither stale nor of unknown age",
    );
    let verdict = gauges(
        "verdict",
        "1 for the last verdict of a tool, 0 for the others",
    );
    let latched = gauges("no_go_latched", "1 if a no-go is not acknowledged");
    let at = gauges(
        "last_check_timestamp_seconds",
        "When the last check was stored",
    );
    let cycles = gauges(
        "tool_cycles",
        "Press cycles done with the tool at its last check",
    );
    let wear = gauges("flank_wear_meters", "Wear of a flank at the last check");
    let u95 = gauges(
        "flank_wear_u95_meters",
        "Expanded uncertainty (95 %) of that wear",
    );
    let limit = gauges("flank_wear_limit_meters", "Stop limit of the wear");
    let expires = gauges(
        "calibration_expires_timestamp_seconds",
        "Last day on which the calibration of the watch's head judges, its beginning",
    );
    let self_test = gauges(
        "self_test_due_timestamp_seconds",
        "When the self-test of the watch's head is due",
    );
    let mut counters = |name: &str, help: &str| {
        let family = Counters::default();
        registry.register(name, help, family.clone());
        family
    };
    let frames = counters(
        "watch_frames_triggered",
        "Frames triggered since the watch began",
    );
    let lost = counters(
        "watch_frames_lost",
        "Frames triggered since the watch began that never arrived",
    );
    let checks = counters("checks", "Stored checks by verdict");

    let flag = |holds: bool| f64::from(u8::from(holds));
    let set = |family: &Gauges, labels: Labels, value: f64| {
        family.get_or_create(&labels).set(value);
    };
    set(&readable, Vec::new(), flag(standing.fault.is_none()));
    if let Some(live) = live {
        let of = || {
            vec![
                ("tool", live.tool.clone()),
                ("station", live.station.clone()),
            ]
        };
        for (family, day) in [
            (&expires, live.head.calibration_expires),
            (&self_test, live.head.self_test_due),
        ] {
            if let Some(day) = day {
                set(family, of(), day.begins_s() as f64);
            }
        }
        for (family, count) in [
            (&frames, live.made.frames_triggered),
            (&lost, live.made.frames_lost),
        ] {
            family.get_or_create_owned(&of()).inc_by(count);
        }
    }
    for tool in &standing.tools {
        let last = &tool.last;
        let of = || {
            vec![
                ("tool", last.tool.clone()),
                ("station", last.origin.station.clone()),
            ]
        };
        let with =
            |name, value: String| of().into_iter().chain([(name, value)]).collect::<Labels>();
        let counts = standing.worth(tool, now) == Worth::Counts;
        set(&counts_now, of(), flag(counts));
        set(&latched, of(), flag(tool.latched.is_some()));
        set(&cycles, of(), last.tool_cycles as f64);
        if let Ok(stored) = last.at.parse::<Timestamp>() {
            set(&at, of(), stored.as_second() as f64);
        }
        for word in Word::ALL {
            let labels = with("verdict", word.as_str().into());
            set(&verdict, labels.clone(), flag(word == last.verdict));
            let count = tool.counts.iter().find(|(of, _)| *of == word);
            let counter = checks.get_or_create_owned(&labels);
            counter.inc_by(count.map_or(0, |(_, count)| *count));
        }
        for flank in &last.flanks {
            let labels = with("flank", flank.id.to_string());
            for (family, um) in [
                (&wear, flank.wear_um),
                (&u95, flank.u95_um),
                (&limit, Some(flank.limit_um)),
            ] {
                if let Some(um) = um {
                    set(family, labels.clone(), 1e-6 * um);
                }
            }
        }
    }
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}
