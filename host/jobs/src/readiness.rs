//! Findings of `doctor` on the station's key, tool, head, history and the repeatability of its stages.

use std::path::Path;

use flankscope_foundation::date::Date;
use flankscope_foundation::normal::COVERAGE_95;
use flankscope_metrology::tool::{Tool, ToolError};
use flankscope_metrology::wear::Approaches;
use flankscope_profilometry::HeadModel;
use serde_json::json;

use flankscope_instrument::doctor::Finding;
use flankscope_instrument::settings::Stages;
use flankscope_profilometry::head::HeadDates;
use flankscope_record::baseline::Baseline;
use flankscope_record::history::History;
use flankscope_record::seal::Seals;

/// The station's key, which signs its results.
#[must_use]
pub fn key(seals: &Result<Seals, flankscope_record::seal::SealError>) -> Finding {
    match seals {
        Ok(seals) => {
            let id = seals.station();
            Finding::ok("key", format!("id {id}")).with(json!({ "id": id }))
        }
        Err(error) => Finding::failed(
            "key",
            error.to_string(),
            "give it a private folder by FLANKSCOPE_STATE; what was signed before is believed again by flankscope trust",
        ),
    }
}

/// The tool file.
#[must_use]
pub fn tool(tool: &Result<Tool, ToolError>) -> Finding {
    const CHECK: &str = "tool";
    let tool = match tool {
        Ok(tool) => tool,
        Err(error) => {
            return Finding::failed(
                CHECK,
                error.to_string(),
                "correct its tool.toml (docs/formats/tool.md)",
            );
        }
    };
    let triangles = tool.mesh.triangles.len();
    let figures = json!({ "name": tool.name, "serial": tool.serial, "triangles": triangles });
    let seen = format!(
        "{} ({}), CAD of {triangles} triangles",
        tool.name,
        tool.path.display()
    );
    match &tool.inspect {
        Some(inspect) => {
            let teeth = inspect.teeth.len();
            Finding::ok(CHECK, format!("{seen}, {teeth} teeth to check")).with(figures)
        }
        None => Finding::attention(
            CHECK,
            seen,
            "give it an [inspect] section with limits, or nothing can be judged",
        )
        .with(figures),
    }
}

/// The head file: its signature, and whether it may judge today. `fits` says whether it may be used with the link.
#[must_use]
pub fn head(
    path: &Path,
    head: &HeadModel,
    fits: Result<(), String>,
    seals: Option<&Seals>,
) -> Finding {
    const CHECK: &str = "head";
    const CALIBRATE: &str = "flankscope calibrate -o HEAD.toml";
    let record = head.calibration.as_ref();
    let made = record.map(|made| (made.date, made.expires));
    let dates = HeadDates::of(head);
    let due = dates.self_test_due;
    let figures = json!({
        "name": head.name,
        "file": path,
        "calibrated": made.map(|(date, _)| date),
        "expires": dates.calibration_expires,
        "self_test_due": due,
        "simulated": record.and_then(|made| made.simulated),
    });
    let seen = match made {
        Some((date, expires)) => format!(
            "{} ({}), calibrated {date}, expires {expires}",
            head.name,
            path.display()
        ),
        None => format!("{} ({}), not calibrated", head.name, path.display()),
    };
    let finding = || -> Finding {
        if let Err(why) = fits {
            return Finding::failed(CHECK, why, "calibrate it where it is used");
        }
        let believed = seals.map(|seals| seals.head(path, made.is_some()));
        let standing = match believed {
            Some(Ok(standing)) => standing.words(),
            Some(Err(error)) => {
                let remedy = format!(
                    "if it is right as it is: flankscope trust {} --name WHO",
                    path.display()
                );
                return Finding::failed(CHECK, error.to_string(), remedy);
            }
            None => "whose word it is could not be asked".into(),
        };
        let today = Date::today();
        if let Err(unfit) = head.fit_on(today) {
            return Finding::failed(CHECK, format!("{seen}: {unfit}"), CALIBRATE);
        }
        if made.is_none() {
            let seen = format!("{seen}: a drawing's values, {standing}");
            return Finding::attention(CHECK, seen, CALIBRATE);
        }
        let seen = match due {
            Some(due) => format!("{seen}, self-test due {due}, {standing}"),
            None => format!("{seen}, {standing}"),
        };
        if dates.is_calibration_due(today) {
            Finding::attention(CHECK, seen, CALIBRATE)
        } else if dates.is_self_test_due(today) {
            let remedy = format!("flankscope calibrate --check {}", path.display());
            Finding::attention(CHECK, seen, remedy)
        } else {
            Finding::ok(CHECK, seen)
        }
    };
    finding().with(figures)
}

/// Repeatability of the rotary stage by the approaches of a baseline, beside what the station file states.
#[must_use]
pub fn repeatability(measured: &Approaches, stages: &Stages) -> Finding {
    const CHECK: &str = "repeatability";
    let mdeg = |rad: f64| 1e3 * rad.to_degrees();
    let within_mdeg = mdeg(COVERAGE_95 * measured.rotation_u_rad());
    let found = format!(
        "the rotary stage repeats within {within_mdeg:.2} mdeg (95 %), by {} approaches of each view",
        measured.count
    );
    let finding = match stages.rotation_repeatability_mdeg {
        Some(stated) if measured.exceeds(stages.approach_sigma().0) => Finding::attention(
            CHECK,
            format!(
                "{found}; its station file states {stated} mdeg: it repeats worse than stated, and the measured value counts"
            ),
            "look for play and loose cables, or state the measured value",
        ),
        _ => Finding::ok(CHECK, found),
    };
    finding.with(json!({
        "rotation_sigma_mdeg": mdeg(measured.rotation_sigma_rad),
        "degrees_of_freedom": measured.degrees_of_freedom,
        "stated_mdeg": stages.rotation_repeatability_mdeg,
    }))
}

/// The history, with verification of its chain; and the repeatability by the baseline of its last check.
#[must_use]
pub fn history(path: &Path, seals: &Seals, stages: &Stages) -> (Vec<Finding>, Option<Date>) {
    const CHECK: &str = "history";
    if !path.exists() {
        let seen = format!(
            "{} is not there yet: the first check makes it",
            path.display()
        );
        return (vec![Finding::ok(CHECK, seen)], None);
    }
    let read = History::read(path, seals).and_then(|history| {
        history.verify()?;
        let ids = history.ids()?;
        let last = ids.last().map(|id| history.check(*id)).transpose()?;
        let baseline = last.as_ref().and_then(|last| last.baseline.as_deref());
        let baseline = baseline.map(|hash| history.baseline(hash)).transpose()?;
        Ok((ids.len(), last, baseline.flatten()))
    });
    match read {
        Ok((checks, last, baseline)) => {
            let seen = match &last {
                Some(last) => format!(
                    "{}, {checks} checks, the last of {}",
                    path.display(),
                    last.at
                ),
                None => format!("{}, no check yet", path.display()),
            };
            let date = last.and_then(|last| last.at.get(..10)?.parse().ok());
            let baseline = baseline.and_then(|text| serde_json::from_str::<Baseline>(&text).ok());
            let measured = baseline.and_then(|baseline| baseline.approaches);
            let mut findings = vec![Finding::ok(CHECK, seen).with(json!({ "checks": checks }))];
            findings.extend(measured.map(|measured| repeatability(&measured, stages)));
            (findings, date)
        }
        Err(error) => {
            let remedy = format!(
                "look at it, then flankscope trust {} --name WHO",
                path.display()
            );
            (
                vec![Finding::failed(CHECK, error.to_string(), remedy)],
                None,
            )
        }
    }
}
