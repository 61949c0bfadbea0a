//! Compares two stored checks of one die: the later one is computed again with the earlier one as its baseline.

use std::sync::Arc;

use flankscope_record::baseline::Baseline;
use flankscope_record::document::{ComparedCheck, ComparedFlank, Comparison, Expanded, Feature};
use flankscope_record::history::History;

use super::{ReplayError, Stored, compute};
use crate::inspection::Findings;
use crate::subject::Subject;

/// Files that both checks must have in common: otherwise calibration and CAD do not cancel in the difference.
const SAME_FILES: [&str; 3] = ["tool", "cad", "head"];

/// What changed from check `before` to check `after` of a history, for the tool and head of `subject`.
///
/// # Errors
/// Data of a check are missing or damaged, or the two were made with other files than each other's or `subject`'s.
pub fn compare_checks(
    history: &History,
    [before, after]: [i64; 2],
    subject: &Subject,
) -> Result<Comparison, ReplayError> {
    let (first, _) = Stored::read(history, before)?;
    let (second, _) = Stored::read(history, after)?;
    for what in SAME_FILES {
        let hash = |hash: Option<&String>| hash.map_or_else(|| "none".into(), String::clone);
        let [then, now] = [&first, &second].map(|stored| hash(stored.hashes.get(what)));
        if then != now {
            return Err(ReplayError::OtherFiles {
                checks: [before, after],
                what,
                hashes: [then, now],
            });
        }
        let given = hash(subject.hashes.get(what));
        if then != given {
            return Err(ReplayError::NotItsFile {
                id: before,
                what,
                stored: then,
                given,
            });
        }
    }
    let earlier = compute(history, &first, &first.subject(subject))?.found;
    let baseline = Baseline {
        tool: subject.tool.name.clone(),
        hashes: first.hashes.clone(),
        simulated: first.simulated,
        flanks: earlier.fields.clone(),
        poses: earlier.poses.clone(),
        in_view: earlier.neighbours.clone(),
        approaches: None,
    };
    let mut with_baseline = second.subject(subject);
    with_baseline.baseline = Some(Arc::new(baseline));
    let later = compute(history, &second, &with_baseline)?.found;
    let compared = |id, stored: &Stored, of: &Findings| ComparedCheck {
        id,
        date: stored.date.clone(),
        cycles: stored.press_cycles,
        maps: of.maps.clone(),
    };
    let absolute = |of: &Feature| of.detail.as_ref().map(|detail| detail.absolute_um);
    let flank = |since: &Feature| {
        let then = earlier.features.iter().find(|of| of.id.is_same(&since.id));
        ComparedFlank {
            id: since.id.clone(),
            before_um: then.and_then(|then| finite(absolute(then)?)),
            after_um: absolute(since).and_then(finite),
            since: since.clone(),
        }
    };
    Ok(Comparison {
        before: compared(before, &first, &earlier),
        after: compared(after, &second, &later),
        tool: subject.tool.name.clone(),
        flanks: later.features.iter().map(flank).collect(),
        simulated: first.simulated || second.simulated,
        link: second.link,
        station: second.station,
    })
}

fn finite(figure: Expanded) -> Option<Expanded> {
    (figure.value.is_finite() && figure.u95.is_finite()).then_some(figure)
}
