//! Prometheus' text (OpenMetrics): base units, names by that project's conventions.

use std::fmt;
use std::sync::atomic::AtomicU64;

use flankscope_metrology::verdict::Word;
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
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;

/// The metrics of what stands now.
///
/// # Errors
/// None occur when writing to memory.
pub fn text(standing: &Standing, now: Timestamp) -> Result<String, fmt::Error> {
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
    let checks: Family<Labels, Counter> = Family::default();
    registry.register("checks", "Stored checks by verdict", checks.clone());

    let flag = |holds: bool| f64::from(u8::from(holds));
    let set = |family: &Gauges, labels: Labels, value: f64| {
        family.get_or_create(&labels).set(value);
    };
    set(&readable, Vec::new(), flag(standing.fault.is_none()));
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
