//! A flank that is in view of another tooth's capture and was not asked for.
//!
//! Its measured part counts, its unmeasured part does not: the flank is at the rim of the field, seen in part, and no verdict
//! on it was requested. A figure shown to be beyond the stop limit, guard band included, is a no-go as on any flank. One whose
//! estimate is beyond the warning limit warns: nearer to a limit than that, an asked flank is measured again or refused, and of
//! this one neither is wanted. Means over a disc decide, either way; a single cell of a few grazing points at the rim does not,
//! nor does a tip edge that is seen in part.

use super::{Decision, FlankLimits, figures, judge};
use crate::verdict::{Code, Reason, Verdict};
use crate::wear::FlankWear;

/// The figures that count.
const COUNTED: [&str; 2] = ["wear", "proud material"];

/// Judges a flank that was not asked for.
pub fn judge_in_view(wear: &FlankWear, limits: &FlankLimits) -> Decision {
    let figures = figures(wear, limits);
    let counted = || {
        let of = figures.iter().map(|(_, cause)| cause);
        of.filter(|cause| COUNTED.contains(&cause.figure) && cause.guard.is_finite())
    };
    let stops = counted().find(|cause| cause.value - cause.guard > cause.limits[1]);
    let warns = counted().find(|cause| cause.value > cause.limits[0]);
    for (cause, verdict) in [(stops, Verdict::NoGo), (warns, Verdict::Warn)] {
        if let Some(cause) = cause {
            return Decision {
                verdict,
                cause: Some(*cause),
            };
        }
    }
    let Decision { verdict, cause } = judge(wear, limits);
    let verdict = match verdict {
        Verdict::Go | Verdict::Indeterminate { .. } => verdict,
        Verdict::Warn | Verdict::NoGo => {
            let sentence = cause.map_or_else(String::new, |cause| cause.sentence(&verdict));
            Verdict::Indeterminate {
                reason: Reason::instrument(Code::Undecidable, sentence),
            }
        }
    };
    Decision {
        verdict,
        cause: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::Flank;
    use crate::verdict::{Rule, Word};
    use crate::wear::WearSettings;

    fn limits() -> FlankLimits {
        FlankLimits {
            wear: Rule::new(30.0, 50.0),
            proud: Rule::new(30.0, 50.0),
            cell: Rule::new(60.0, 100.0),
            tip: None,
            least_coverage: 0.8,
            area_mm2: 0.25,
            hidden_depth_um: 300.0,
        }
    }

    /// A flank of 4 mm² of which the lower part was seen.
    fn seen(part: f64, lost_mm: f64) -> FlankWear {
        let points: Vec<([f64; 2], f64, f64)> = (0..1600)
            .map(|i| [f64::from(i % 40), f64::from(i / 40)].map(|x| (x + 0.5) * 0.05))
            .filter(|at| at[1] < 2.0 * part)
            .map(|at| (at, lost_mm, 0.5e-3))
            .collect();
        let settings = WearSettings::default();
        FlankWear::of_points((41, Flank::Left), [2.0, 2.0], &points, &settings)
    }

    #[test]
    fn what_is_seen_counts_and_what_is_not_seen_does_not() {
        for (part, lost_mm, expected) in [
            (1.0, 0.0, Word::Go),
            (0.5, 0.0, Word::Indeterminate),
            (0.0, 0.0, Word::Indeterminate),
            (0.5, 0.15, Word::NoGo),
            (1.0, 0.15, Word::NoGo),
            (0.5, 0.04, Word::Warn),
            // Within the guard band of the stop limit.
            (0.5, 0.051, Word::Warn),
            // Within that of the warning limit: an asked flank would be warned of.
            (1.0, 0.029, Word::Indeterminate),
            (0.5, -0.04, Word::Warn),
        ] {
            let decision = judge_in_view(&seen(part, lost_mm), &limits());
            assert_eq!(decision.verdict.word(), expected, "{part} {lost_mm}");
        }
    }

    #[test]
    fn what_is_no_number_shows_nothing() {
        for spoil in [
            |w: &mut FlankWear| w.judged = None,
            |w: &mut FlankWear| w.judged.as_mut().unwrap().wear_mm.value = f64::NAN,
            |w: &mut FlankWear| w.budget.registration_mm = f64::NAN,
        ] {
            let mut wear = seen(1.0, 0.15);
            spoil(&mut wear);
            let word = judge_in_view(&wear, &limits()).verdict.word();
            assert_eq!(word, Word::Indeterminate);
        }
    }
}
