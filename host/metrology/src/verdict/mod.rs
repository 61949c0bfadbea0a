//! From figures with uncertainty to a verdict.
//!
//! Decision with a guard band (ISO 14253-1, JCGM 106): a limit counts as kept or exceeded only when that holds with 95 %
//! probability. Whatever is missing, late, partial, unsure or not finite is *indeterminate*, never *go*.

pub mod flank;

/// Probability with which a limit must be kept or exceeded, unless the tool file says otherwise.
pub const PROBABILITY: f64 = 0.95;

/// What an undecidable figure ends in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Undecided {
    /// Nothing is said.
    #[default]
    Indeterminate,
    /// What cannot be shown to be good counts as bad.
    NoGo,
}

/// How one figure is judged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Warning limit, micrometres.
    pub warn_um: f64,
    /// Stop limit, micrometres.
    pub limit_um: f64,
    /// Probability with which a limit must be kept or exceeded.
    pub probability: f64,
    /// What an undecidable figure ends in.
    pub undecided: Undecided,
    /// How often the figure may be measured until it is decided, at least once: every look has its own noise, and may err.
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

    /// How far a figure must keep from a limit, µm: `noise_um` is the standard uncertainty that another look would draw
    /// anew, `systematic_um` that of all that it would not.
    ///
    /// Measuring again until a figure is decided is optional stopping: over all looks the error stays at what is allowed when
    /// each look's noise gets its share of it (Bonferroni).
    pub fn guard_um(&self, noise_um: f64, systematic_um: f64) -> f64 {
        let share = (1.0 - self.probability) / f64::from(self.looks.max(1));
        (guard_factor(1.0 - share) * noise_um).hypot(guard_factor(self.probability) * systematic_um)
    }
}

/// Probability that a normal figure lies at or below a limit: of conformity when the limit is an upper one.
pub fn probability_below(limit: f64, value: f64, u: f64) -> f64 {
    0.5 * libm::erfc((value - limit) / (u * std::f64::consts::SQRT_2))
}

/// How many standard uncertainties a figure must keep from a limit, so that the limit is kept or exceeded with this
/// probability: the quantile of the normal distribution, for probabilities from one half up to (not including) one. The one
/// source of every coverage and guard factor: 1.645 for a one-sided 95 %, `guard_factor(0.975)` = 1.960 for U95.
pub fn guard_factor(probability: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    // 50 halvings of 10 end below 1e-14.
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if probability_below(middle, 0.0, 1.0) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// What the instrument says.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(tag = "verdict", rename_all = "lowercase")]
pub enum Verdict {
    /// Wear is below the warning limit.
    Go,
    /// Wear is below the stop limit, but not below the warning limit.
    Warn,
    /// Wear exceeds the stop limit.
    NoGo,
    /// Nothing can be said.
    Indeterminate {
        /// Why.
        reason: Reason,
    },
}

/// Why nothing can be said.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Reason {
    /// No feature was evaluated.
    #[error("no feature was evaluated")]
    NoFeatures,
    /// A figure that is no number.
    #[error("the {what} is {value}, not a finite number")]
    NotFinite {
        /// Which figure.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Limits that contradict each other.
    #[error(
        "the limits are out of order: warn {warn_um} um, stop {limit_um} um; right would be 0 < warn <= stop"
    )]
    Limits {
        /// Warning limit.
        warn_um: f64,
        /// Stop limit.
        limit_um: f64,
    },
    /// The figure is too near to the limit for its uncertainty.
    #[error(
        "{what} {value_um:.1} um is too near to the stop limit of {limit_um} um to decide: the guard band is {guard_um:.1} um to either side"
    )]
    Undecidable {
        /// Which figure.
        what: &'static str,
        /// Its value.
        value_um: f64,
        /// How far it must keep from a limit.
        guard_um: f64,
        /// Stop limit.
        limit_um: f64,
    },
    /// Too little of the zone was measured.
    #[error("only {:.0} % of the zone was measured, at least {:.0} % are needed", 100.0 * coverage, 100.0 * least)]
    Coverage {
        /// Measured share of the zone.
        coverage: f64,
        /// Least share.
        least: f64,
    },
    /// Nothing fits the zone over which the largest mean loss could be sought, or nothing was measured.
    #[error(
        "no disc of {area_mm2} mm2 could be measured in the zone; a larger zone or a smaller inspect.wear_area_mm2 is needed"
    )]
    NoDisc {
        /// Area of the disc.
        area_mm2: f64,
    },
    /// What was not seen may hide more than the limit: unmeasured patches, floors behind steep walls, grooves too narrow to
    /// look into.
    #[error(
        "what was not seen of the flank (holes, shadows of steep walls, narrow grooves) may hide up to {hidden_um:.1} um of mean loss if {supposed_um:.0} um are lost there, {limit_um} um are the limit; clean the flank, look from another height, or look at it by eye"
    )]
    Hidden {
        /// The largest mean loss that a disc may have.
        hidden_um: f64,
        /// What is supposed to be lost wherever nothing was measured.
        supposed_um: f64,
        /// The limit that it may exceed.
        limit_um: f64,
    },
    /// Damage at the warning limit would not be seen.
    #[error(
        "the least wear that can be told from none is {detects_um:.1} um, not below the warning limit of {warn_um} um; largest part of the uncertainty: {largest}"
    )]
    Detection {
        /// Least wear that is told from none.
        detects_um: f64,
        /// Warning limit.
        warn_um: f64,
        /// Where most of the uncertainty comes from.
        largest: &'static str,
    },
    /// The estimate is not what was read.
    #[error(
        "the estimate of {wear_um:.1} um differs from the largest mean loss as read, {raw_um:.1} um, by more than its uncertainty allows ({guard_um:.1} um)"
    )]
    Disagreement {
        /// Estimate.
        wear_um: f64,
        /// As read.
        raw_um: f64,
        /// Allowed difference.
        guard_um: f64,
    },
    /// The tip edge was not seen.
    #[error("the tip edge was not seen whole, so that its rounding cannot be told")]
    TipUnseen,
    /// The pose hides too much of the wear.
    #[error(
        "the pose hides {:.0} % of the flank's wear, at most {:.0} % may be; fit to other surfaces (inspect.datum) or bring in a better stage",
        100.0 * leakage, 100.0 * limit
    )]
    Leakage {
        /// Worst leakage of the flank.
        leakage: f64,
        /// Largest that leaves enough to see.
        limit: f64,
    },
    /// The tool's temperature is needed and not known.
    #[error(
        "the tool's temperature is not known, but its file asks for it; give --tool-temperature"
    )]
    TemperatureMissing,
    /// The tool's temperature is outside its range.
    #[error("the tool has {degc} degrees C, outside its range of {low} to {high}")]
    TemperatureRange {
        /// Temperature.
        degc: f64,
        /// Lowest.
        low: f64,
        /// Highest.
        high: f64,
    },
    /// The cloud could not be laid on CAD.
    #[error("registration: {0}")]
    Registration(crate::registration::Reason),
    /// The instrument itself failed; the code names how.
    #[error("{code}")]
    Instrument {
        /// Stable name of the failure.
        code: &'static str,
    },
}

impl Reason {
    /// A short stable name for files and reports.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NoFeatures => "no_features",
            Self::NotFinite { .. } => "not_finite",
            Self::Limits { .. } => "limits",
            Self::Undecidable { .. } => "undecidable",
            Self::Coverage { .. } => "coverage",
            Self::NoDisc { .. } => "no_disc",
            Self::Hidden { .. } => "hidden",
            Self::Detection { .. } => "detection_limit",
            Self::Disagreement { .. } => "disagreement",
            Self::TipUnseen => "tip_unseen",
            Self::Leakage { .. } => "leakage",
            Self::TemperatureMissing => "temperature_missing",
            Self::TemperatureRange { .. } => "temperature_range",
            Self::Registration(reason) => reason.code(),
            Self::Instrument { code } => code,
        }
    }
}

impl serde::Serialize for Reason {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl Verdict {
    /// The word for tables and files.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Go => "go",
            Self::Warn => "warn",
            Self::NoGo => "no-go",
            Self::Indeterminate { .. } => "indeterminate",
        }
    }

    /// The process exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Go => 0,
            Self::NoGo => 1,
            Self::Indeterminate { .. } => 2,
            Self::Warn => 4,
        }
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
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
            return indeterminate(Reason::NotFinite { what, value });
        }
    }
    if !(0.0 < warn_um && warn_um <= limit_um) {
        return indeterminate(Reason::Limits { warn_um, limit_um });
    }
    if !(0.5..1.0).contains(&probability) {
        let what = "probability of conformity";
        return indeterminate(Reason::NotFinite {
            what,
            value: probability,
        });
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

/// Whether a figure is undecided and measuring it again could decide it: with the noise averaged away, some value within two
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

/// The tool's verdict from its features': one no-go is enough; then one indeterminate; then one warning. Without features
/// there is nothing to say.
pub fn combine(features: impl IntoIterator<Item = Verdict>) -> Verdict {
    let severity = |verdict: &Verdict| match verdict {
        Verdict::Go => 0,
        Verdict::Warn => 1,
        Verdict::Indeterminate { .. } => 2,
        Verdict::NoGo => 3,
    };
    let mut worst: Option<Verdict> = None;
    for verdict in features {
        if worst
            .as_ref()
            .is_none_or(|w| severity(&verdict) > severity(w))
        {
            worst = Some(verdict);
        }
    }
    worst.unwrap_or(Verdict::Indeterminate {
        reason: Reason::NoFeatures,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_guard_band_decides() {
        // g = 1.645 x 4 = 6.58 um.
        for (wear, expected) in [
            (-5.0, "go"),
            (23.4, "go"),
            (23.5, "warn"),
            (43.4, "warn"),
            (43.5, "indeterminate"),
            (56.5, "indeterminate"),
            (56.6, "no-go"),
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
    fn the_guard_is_the_normal_quantile_and_the_policy_closes_what_stays_open() {
        // Quantiles of the standard normal distribution, from tables.
        for (probability, quantile) in [
            (0.5, 0.0),
            (0.95, 1.644_854),
            (0.975, 1.959_964),
            (0.999, 3.090_232),
        ] {
            assert!((guard_factor(probability) - quantile).abs() < 1e-6);
        }
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

    #[test]
    fn the_worst_feature_decides() {
        let unsure = || Verdict::Indeterminate {
            reason: Reason::NoFeatures,
        };
        assert_eq!(combine([]), unsure());
        assert_eq!(combine([Verdict::Go, Verdict::Warn]), Verdict::Warn);
        assert_eq!(combine([Verdict::Warn, unsure(), Verdict::Go]), unsure());
        assert_eq!(
            combine([unsure(), Verdict::NoGo, Verdict::Go]),
            Verdict::NoGo
        );
    }
}
