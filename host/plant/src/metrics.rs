//! Prometheus' text (OpenMetrics): base units, names by that project's conventions.

use std::fmt;
use std::sync::atomic::AtomicU64;

use flankscope_metrology::verdict::Word;
use flankscope_record::document::LiveState;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::statement::{StationStatement, Worth};

/// Type of the text, for the answer's header.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels = Vec<(&'static str, String)>;
type Counters = Family<Labels, Counter>;
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;

/// The metrics of what stands now, and of the watch, if one says what it does.
///
/// # Errors
/// None occur when writing to memory.
pub fn text(station: &StationStatement, live: Option<&LiveState>) -> Result<String, fmt::Error> {
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
    let stands = gauges(
        "verdict_stands",
        "1 for the verdict that stands for a tool, 0 for the others; all 0 if none stands",
    );
    let doubtful = gauges(
        "verdict_doubtful",
        "1 if the age of the last check is not proven, for the reason that is named",
    );
    let age = gauges(
        "last_check_age_seconds",
        "Time since the last exposure of the last check",
    );
    let exposed = gauges(
        "last_exposure_timestamp_seconds",
        "When the last exposure of the last check ended",
    );
    let until = gauges(
        "verdict_counts_until_timestamp_seconds",
        "When the last verdict becomes too old",
    );
    let stale_after = gauges(
        "stale_after_seconds",
        "Age from which a verdict no longer counts",
    );
    let open = gauges(
        "no_gos_open",
        "No-gos of all dies of the history that are not acknowledged",
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
    set(&readable, Vec::new(), flag(station.fault.is_none()));
    set(&open, Vec::new(), station.open_no_gos.len() as f64);
    set(&stale_after, Vec::new(), station.stale_after.as_secs_f64());
    if let Some(live) = live {
        let labels_of_watch = || {
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
                set(family, labels_of_watch(), day.begins_s() as f64);
            }
        }
        for (family, count) in [
            (&frames, live.made.frames_triggered),
            (&lost, live.made.frames_lost),
        ] {
            family.get_or_create_owned(&labels_of_watch()).inc_by(count);
        }
    }
    for die in &station.dies {
        let last = &die.last;
        let labels_of_die = || {
            vec![
                ("tool", last.tool.clone()),
                ("station", last.origin.station.clone()),
            ]
        };
        let with = |name, value: String| {
            labels_of_die()
                .into_iter()
                .chain([(name, value)])
                .collect::<Labels>()
        };
        set(
            &counts_now,
            labels_of_die(),
            flag(die.worth == Worth::Counts),
        );
        set(&latched, labels_of_die(), flag(die.latched.is_some()));
        set(&cycles, labels_of_die(), last.tool_cycles as f64);
        if let Ok(stored) = last.at.parse::<jiff::Timestamp>() {
            set(&at, labels_of_die(), stored.as_second() as f64);
        }
        for (family, moment) in [(&exposed, die.exposed_at), (&until, die.counts_until)] {
            if let Some(moment) = moment {
                set(family, labels_of_die(), moment.as_second() as f64);
            }
        }
        if let Some(since) = die.age {
            set(&age, labels_of_die(), since.as_secs_f64());
        }
        if let Some(doubt) = die.worth.doubt() {
            set(&doubtful, with("reason", doubt.word().into()), 1.0);
        }
        for word in Word::ALL {
            let labels = with("verdict", word.as_str().into());
            set(&verdict, labels.clone(), flag(word == last.verdict));
            set(&stands, labels.clone(), flag(die.verdict == Some(word)));
            let count = die.counts.iter().find(|(counted, _)| *counted == word);
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

#[cfg(test)]
mod tests {
    use flankscope_metrology::verdict::Word;

    use crate::freshness_model::{Scene, check, moment, moment_of, no_go};
    use crate::statement::{Moment, Standing};

    #[test]
    fn a_metrics_text_says_what_stands_beside_the_last_check() {
        let mut scene = Scene::new(60);
        scene.facts.tools = vec![(check(1, "die", Word::Go, &moment(100)), Vec::new())];
        let text = |standing: &Standing, now: &Moment| {
            super::text(&standing.statement(now), None).unwrap()
        };
        let line = |name: &str, value: &str| {
            format!("flankscope_{name}{{tool=\"die\",station=\"press 7\",verdict=\"go\"}} {value}")
        };
        let standing = scene.look(&moment(110));
        let fresh = text(&standing, &moment(110));
        assert!(fresh.contains(&line("verdict_stands", "1.0")), "{fresh}");
        assert!(
            fresh.contains(
                "flankscope_last_check_age_seconds{tool=\"die\",station=\"press 7\"} 10.0"
            )
        );
        // Too old.
        scene.look(&moment(160));
        let stale = text(&standing, &moment(161));
        assert!(stale.contains(&line("verdict_stands", "0.0")), "{stale}");
        assert!(stale.contains(&line("verdict", "1.0")));
        // Latched.
        scene.facts.open_no_gos = vec![no_go("die", 1)];
        let latched = text(&scene.look(&moment(110)), &moment(110));
        assert!(
            latched.contains(&line("verdict_stands", "0.0")),
            "{latched}"
        );
        assert!(
            latched
                .contains("verdict_stands{tool=\"die\",station=\"press 7\",verdict=\"no-go\"} 1.0")
        );
        assert!(latched.contains("flankscope_no_gos_open 1.0"));
        // The clock went back.
        let now = moment_of(120, 50, 1);
        let doubtful = text(&scene.look(&now), &now);
        assert!(
            doubtful.contains("reason=\"clock_set_back\"} 1.0"),
            "{doubtful}"
        );
    }
}
