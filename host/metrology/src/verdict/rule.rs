//! One figure against its limits.
//!
//! Decision with a guard band (ISO 14253-1, JCGM 106): a limit counts as kept or exceeded only when that holds with 95 %
//! probability.

use flankscope_foundation::normal::guard_factor;

use super::{Reason, Undecided, Verdict};

/// Probability with which a limit must be kept or exceeded, unless the tool file says otherwise.
pub const PROBABILITY: f64 = 0.95;

/// Limits and probability by which one figure is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Warning limit, micrometres.
    pub warn_um: f64,
    /// Stop limit, micrometres.
    pub limit_um: f64,
    /// Probability with which a limit must be kept or exceeded.
    pub probability: f64,
    /// Verdict on a figure whose guard band holds the limit.
    pub undecided: Undecided,
    /// Largest number of measurements until the figure is decided, at least 1: each has its own noise and may err.
    pub looks: u32,
}

impl Rule {
    /// The rule with 95 % probability that leaves undecidable figures open.
    pub fn new(warn_um: f64, limit_um: f64) -> Self {
        Self {
            warn_um,
            limit_um,
            probability: PROBABILITY,
            undecided: Undecided::Indeterminate,
            looks: 1,
        }
    }

    /// Guard band of a figure, µm: `noise_um` is the standard uncertainty that another measurement would draw
    /// anew, `systematic_um` that of all that it would not.
    ///
    /// Measuring again until a figure is decided is optional stopping: over all looks the error stays at what is allowed when
    /// each look's noise gets its share of it (Bonferroni).
    pub fn guard_um(&self, noise_um: f64, systematic_um: f64) -> f64 {
        let share = (1.0 - self.probability) / f64::from(self.looks.max(1));
        (guard_factor(1.0 - share) * noise_um).hypot(guard_factor(self.probability) * systematic_um)
    }
}

/// Decides one figure, `value_um` with standard uncertainty `u_um`, against a warning and a stop limit.
pub fn decide(value_um: f64, u_um: f64, rule: &Rule) -> Verdict {
    decide_parts("wear", value_um, [0.0, u_um], rule)
}

/// Decides the figure `what`, whose standard uncertainty is in two parts: the noise that another look would draw anew, and all
/// that it would not.
pub fn decide_parts(
    what: &'static str,
    value_um: f64,
    [noise_um, systematic_um]: [f64; 2],
    rule: &Rule,
) -> Verdict {
    let Rule {
        warn_um,
        limit_um,
        probability,
        undecided,
        ..
    } = *rule;
    let indeterminate = |reason| Verdict::Indeterminate { reason };
    for (what, value) in [
        (what, value_um),
        ("uncertainty by noise", noise_um),
        ("uncertainty", systematic_um),
        ("warning limit", warn_um),
        ("stop limit", limit_um),
    ] {
        if !value.is_finite() {
            return indeterminate(Reason::NotFinite { what });
        }
    }
    if !(0.0 < warn_um && warn_um <= limit_um) {
        return indeterminate(Reason::Limits { warn_um, limit_um });
    }
    if !(0.5..1.0).contains(&probability) {
        let what = "probability of conformity";
        return indeterminate(Reason::NotFinite { what });
    }
    let guard_um = rule.guard_um(noise_um.abs(), systematic_um.abs());
    if value_um + guard_um <= warn_um {
        Verdict::Go
    } else if value_um + guard_um <= limit_um {
        Verdict::Warn
    } else if value_um - guard_um > limit_um || undecided == Undecided::NoGo {
        Verdict::NoGo
    } else {
        indeterminate(Reason::Undecidable {
            what,
            value_um,
            guard_um,
            limit_um,
        })
    }
}

/// Whether a figure is undecided and another measurement could decide it: with the noise averaged away, some value within two
/// standard deviations of the noise would be decided. `um` is the wear, the standard uncertainty of its noise, and that of
/// everything that repeating does not change.
pub fn repeating_could_decide([wear_um, noise_um, systematic_um]: [f64; 3], rule: &Rule) -> bool {
    let rule = Rule {
        undecided: Undecided::Indeterminate,
        ..*rule
    };
    let undecided = |wear_um, noise_um| {
        matches!(
            decide_parts("wear", wear_um, [noise_um, systematic_um], &rule),
            Verdict::Indeterminate {
                reason: Reason::Undecidable { .. }
            }
        )
    };
    undecided(wear_um, noise_um)
        && [-2.0, -1.0, 0.0, 1.0, 2.0]
            .iter()
            .any(|k| !undecided(wear_um + k * noise_um, 0.0))
}

#[cfg(test)]
mod tests {
    use super::super::Word;
    use super::*;

    #[test]
    fn the_guard_band_decides() {
        // g = 1.645 x 4 = 6.58 um.
        for (wear, expected) in [
            (-5.0, Word::Go),
            (23.4, Word::Go),
            (23.5, Word::Warn),
            (43.4, Word::Warn),
            (43.5, Word::Indeterminate),
            (56.5, Word::Indeterminate),
            (56.6, Word::NoGo),
        ] {
            assert_eq!(
                decide(wear, 4.0, &Rule::new(30.0, 50.0)).word(),
                expected,
                "{wear}"
            );
        }
    }

    #[test]
    fn nothing_that_is_no_number_is_ever_go() {
        let values = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        for bad in values {
            for at in 0..4 {
                let mut x = [0.0, 1.0, 30.0, 50.0];
                x[at] = bad;
                let verdict = decide(x[0], x[1], &Rule::new(x[2], x[3]));
                assert!(
                    matches!(verdict, Verdict::Indeterminate { .. }),
                    "{x:?}: {verdict}"
                );
            }
        }
        assert!(matches!(
            decide(0.0, 1.0, &Rule::new(60.0, 50.0)),
            Verdict::Indeterminate { .. }
        ));
        // A huge uncertainty cannot say go either.
        assert!(matches!(
            decide(0.0, 100.0, &Rule::new(30.0, 50.0)),
            Verdict::Indeterminate { .. }
        ));
    }

    #[test]
    fn the_policy_closes_what_stays_open() {
        let rule = Rule {
            undecided: Undecided::NoGo,
            ..Rule::new(30.0, 50.0)
        };
        assert_eq!(decide(49.0, 4.0, &rule), Verdict::NoGo);
        assert_eq!(decide(10.0, 4.0, &rule), Verdict::Go);
        let strict = Rule {
            probability: 0.999,
            ..rule
        };
        assert_eq!(decide(20.0, 4.0, &strict), Verdict::Warn);
        let absurd = Rule {
            probability: f64::NAN,
            ..rule
        };
        assert!(matches!(
            decide(10.0, 4.0, &absurd),
            Verdict::Indeterminate { .. }
        ));
    }

    #[test]
    fn only_what_noise_leaves_open_is_worth_repeating() {
        let rule = Rule::new(30.0, 50.0);
        for (wear, noise, systematic, expected) in [
            (49.0, 2.0, 0.1, true),  // 1 below, guard 3.3: the noise alone is in the way
            (49.0, 0.1, 2.0, false), // the calibration is in the way, however often it is measured
            (46.0, 2.0, 2.0, true),  // a value of 44 would be decided
            (20.0, 2.0, 0.1, false), // decided already
            (60.0, 2.0, 0.1, false),
            (f64::NAN, 2.0, 0.1, false),
            (49.0, f64::NAN, 0.1, false),
        ] {
            let um = [wear, noise, systematic];
            assert_eq!(repeating_could_decide(um, &rule), expected, "{um:?}");
            let closed = Rule {
                undecided: Undecided::NoGo,
                ..rule
            };
            assert_eq!(repeating_could_decide(um, &closed), expected, "{um:?}");
        }
    }
}
