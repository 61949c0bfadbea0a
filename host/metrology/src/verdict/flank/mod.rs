//! One flank to its verdict: every figure against its limits, and what forbids a verdict.
//!
//! A loss that is shown to exceed the stop limit is a no-go whatever else could not be seen. Everything short of that needs
//! more: that no unmeasured patch, no blunt instrument and no pose may hide what would change the word.

mod in_view;

pub use in_view::judge_in_view;

use flankscope_foundation::display::Number;

use crate::verdict::{Reason, Rule, Verdict, combine, decide_parts};
use crate::wear::leakage::RECOVERABLE;
use crate::wear::{FlankWear, OppositeChange};

/// A flank of which less was seen is not judged, whatever a tool file says.
pub const LEAST_COVERAGE: f64 = 0.5;

/// Limits of one flank.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlankLimits {
    /// Of the wear depth.
    pub wear: Rule,
    /// Of the height of proud material.
    pub proud: Rule,
    /// Of the loss of a single cell.
    pub cell: Rule,
    /// Of the rounding of the tip edge; none: it is not judged.
    pub tip: Option<TipLimits>,
    /// Least measured share of the zone.
    pub least_coverage: f64,
    /// Area of the disc over which the largest mean loss is sought, mm2.
    pub area_mm2: f64,
    /// Loss that is supposed wherever nothing was measured, µm.
    pub hidden_depth_um: f64,
}

/// Limits of the tip edge's rounding, warning first. Judged is the cross-section that is lost: noise acts on it evenly, on the
/// radius it does not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TipLimits {
    /// As radius of a tangent rounding, mm.
    pub radius_mm: [f64; 2],
    /// Cross-section that such roundings take away under the flank, mm2.
    pub area_mm2: [f64; 2],
}

/// Figure that decided a verdict warn or no-go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cause {
    /// Name of the figure.
    pub figure: &'static str,
    /// Its value, in the limits' unit.
    pub value: f64,
    /// Guard band: least distance of the figure from a limit, same unit.
    pub guard: f64,
    /// Its warning and its stop limit.
    pub limits: [f64; 2],
    /// Their unit.
    pub unit: &'static str,
}

impl Cause {
    /// In one sentence, why the verdict is that.
    pub fn sentence(&self, verdict: &Verdict) -> String {
        let Self {
            figure,
            value,
            guard,
            limits: [warn, stop],
            unit,
        } = self;
        let (limit, name) = match verdict {
            Verdict::NoGo => (stop, "stop limit"),
            _ => (warn, "warning limit"),
        };
        // Rounding of tenths of a millimetre would hide what is compared.
        let digits = if *unit == "mm" { 3 } else { 1 };
        let beyond = value > limit;
        let [value, guard, limit] = [*value, *guard, *limit].map(Number);
        if beyond {
            format!(
                "{figure} {value:.digits$} {unit} is beyond the {name} of {limit:.digits$} {unit}"
            )
        } else {
            format!(
                "{figure} {value:.digits$} {unit} is within the guard band (±{guard:.digits$} {unit}) of the {name} of {limit:.digits$} {unit}"
            )
        }
    }
}

/// A flank's verdict, with the figure that decided it where it is warn or no-go.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// The verdict.
    pub verdict: Verdict,
    /// The figure behind it.
    pub cause: Option<Cause>,
}

/// Refusals in force: all of them, except in tests that switch single ones off.
#[derive(Debug, Clone, Copy)]
struct Refusals {
    coverage: bool,
    hidden: bool,
    detection: bool,
    disagreement: bool,
    opposite: bool,
    pose: bool,
    tip: bool,
}

impl Refusals {
    const ALL: Self = Self {
        coverage: true,
        hidden: true,
        detection: true,
        disagreement: true,
        opposite: true,
        pose: true,
        tip: true,
    };
}

/// Judges one flank.
pub fn judge(wear: &FlankWear, limits: &FlankLimits) -> Decision {
    judge_with(wear, limits, Refusals::ALL)
}

fn judge_with(wear: &FlankWear, limits: &FlankLimits, refusals: Refusals) -> Decision {
    let none = |reason| Decision {
        verdict: Verdict::Indeterminate { reason },
        cause: None,
    };
    // A pose that may hide or feign anything proves nothing either way.
    if let Some(reason) = pose(wear).filter(|_| refusals.pose) {
        // Where too little was seen, nothing tells what the pose hides.
        return none(uncovered(wear, limits).unwrap_or(reason));
    }
    let judged = figures(wear, limits);
    let verdict = combine(judged.iter().map(|(verdict, _)| verdict.clone()));
    if verdict != Verdict::NoGo
        && let Some(reason) = blind(wear, limits, &verdict, refusals)
    {
        return none(reason);
    }
    let cause = judged
        .into_iter()
        .find(|(of, _)| *of == verdict)
        .map(|(_, cause)| cause)
        .filter(|_| matches!(verdict, Verdict::Warn | Verdict::NoGo));
    Decision { verdict, cause }
}

/// The verdict of each figure by itself; of a zone without figures, that of the tip edge alone.
fn figures(wear: &FlankWear, limits: &FlankLimits) -> Vec<(Verdict, Cause)> {
    let systematic = 1e3 * wear.budget.systematic_mm();
    let of = |figure: &'static str, value: f64, u: [f64; 2], rule: Rule| {
        let cause = Cause {
            figure,
            value,
            guard: rule.guard_um(u[0], u[1]),
            limits: [rule.warn_um, rule.limit_um],
            unit: "um",
        };
        (decide_parts(figure, value, u, &rule), cause)
    };
    let mut judged = Vec::new();
    if let Some(figures) = &wear.judged {
        let of_zone = |figure, value_mm: f64, noise_mm: f64, rule| {
            of(figure, 1e3 * value_mm, [1e3 * noise_mm, systematic], rule)
        };
        // A figure that is not there is not finite, which is no go.
        let cell_mm = figures.cell_mm.map_or(f64::NAN, |cell| cell.value);
        let cell_noise_mm = figures.read.cell_mm.map_or(f64::NAN, |cell| cell.u);
        judged.extend([
            of_zone(
                "wear",
                figures.wear_mm.value,
                wear.budget.noise_mm,
                limits.wear,
            ),
            of_zone(
                "proud material",
                figures.proud_mm.value,
                figures.read.proud_mm.u,
                limits.proud,
            ),
            of_zone("loss of a single cell", cell_mm, cell_noise_mm, limits.cell),
        ]);
    }
    if let (Some(tip), Some(loss)) = (limits.tip, wear.tip) {
        let rule = Rule {
            warn_um: 1e3 * tip.area_mm2[0],
            limit_um: 1e3 * tip.area_mm2[1],
            ..limits.wear
        };
        let area = [loss.area_mm2.value, loss.area_mm2.u].map(|mm2| 1e3 * mm2);
        let (verdict, cause) = of("rounding of the tip edge", area[0], [0.0, area[1]], rule);
        let cause = Cause {
            value: loss.radius_mm.value,
            guard: rule.guard_um(0.0, loss.radius_mm.u),
            limits: tip.radius_mm,
            unit: "mm",
            ..cause
        };
        judged.push((verdict, cause));
    }
    judged
}

/// Reason for which the pose forbids any verdict: it may hide more than half of the wear.
fn pose(wear: &FlankWear) -> Option<Reason> {
    let leakage = wear.sensitivity.as_ref()?.leakage.worst();
    (leakage.is_nan() || leakage > RECOVERABLE).then_some(Reason::Leakage {
        leakage,
        limit: RECOVERABLE,
    })
}

/// Reason for which too little of the zone was measured. Comparisons with NaN are false: a coverage that is not a number is refused.
fn uncovered(wear: &FlankWear, limits: &FlankLimits) -> Option<Reason> {
    let least = limits.least_coverage.max(LEAST_COVERAGE);
    let enough = wear.coverage >= least && limits.least_coverage.is_finite();
    (!enough).then_some(Reason::Coverage {
        coverage: wear.coverage,
        least,
    })
}

/// Reason for which `verdict`, which is not no-go, cannot be given.
fn blind(
    wear: &FlankWear,
    limits: &FlankLimits,
    verdict: &Verdict,
    on: Refusals,
) -> Option<Reason> {
    if let Some(reason) = uncovered(wear, limits).filter(|_| on.coverage) {
        return Some(reason);
    }
    let Some(figures) = &wear.judged else {
        return Some(Reason::NoDisc {
            area_mm2: limits.area_mm2,
        });
    };
    let (noise_um, systematic_um) = (
        1e3 * wear.budget.noise_mm,
        1e3 * wear.budget.systematic_mm(),
    );
    let guard_um = limits.wear.guard_um(noise_um, systematic_um);
    // Of a flank that is too near to a limit nothing could be passed that a hole may hide: it may be measured again first.
    let allowed_um = match verdict {
        Verdict::Go => limits.wear.warn_um,
        Verdict::Indeterminate {
            reason: Reason::Undecidable { .. },
        } => f64::INFINITY,
        _ => limits.wear.limit_um,
    };
    let allowed = |hidden_mm: f64| 1e3 * hidden_mm + guard_um <= allowed_um;
    if let Some(hidden_mm) = figures.hidden_mm
        && !allowed(hidden_mm)
        && on.hidden
    {
        return Some(Reason::Hidden {
            hidden_um: 1e3 * hidden_mm + guard_um,
            supposed_um: limits.hidden_depth_um,
            limit_um: allowed_um,
        });
    }
    // Of a warning only what the stages contradict: that both sides are as the flanks show them is presumed otherwise.
    let is_asked = |change: &OppositeChange| match verdict {
        Verdict::Go => true,
        Verdict::Warn => change.is_seen,
        _ => false,
    };
    if let Some(change) = figures.with_opposite.filter(is_asked)
        && on.opposite
    {
        let together_um = 1e3 * change.together_mm + guard_um;
        let limit_um = limits.wear.limit_um;
        let is_below = together_um <= limit_um;
        if !is_below {
            return Some(Reason::Opposite {
                together_um,
                limit_um,
            });
        }
    }
    let detects_um = 1e3 * wear.detection_limit_mm();
    let detects = detects_um < limits.wear.warn_um;
    if !detects && on.detection {
        let largest = wear
            .budget
            .terms()
            .into_iter()
            .filter(|(name, _)| *name != "leakage")
            .max_by(|a, b| a.1.total_cmp(&b.1));
        return Some(Reason::Detection {
            detects_um,
            warn_um: limits.wear.warn_um,
            largest: largest.map_or("", |(name, _)| name),
        });
    }
    let apart_um = 1e3 * (figures.read.raw_mm - figures.read.depth_mm.value).abs();
    if apart_um > guard_um && on.disagreement {
        return Some(Reason::Disagreement {
            wear_um: 1e3 * figures.wear_mm.value,
            raw_um: 1e3 * figures.raw_mm,
            guard_um,
        });
    }
    // A tip edge that is worn away leaves no points: the loss stated is only its lower bound.
    let tip_seen = limits.tip.is_none() || wear.tip.is_some_and(|tip| tip.whole);
    if !tip_seen && on.tip {
        return Some(Reason::TipUnseen);
    }
    None
}

#[cfg(test)]
mod campaign;
#[cfg(test)]
mod fine_structure;

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::gear::Flank;
    use crate::verdict::Rule;
    use crate::wear::leakage::Leakage;
    use crate::wear::{Figure, JudgedFigures, PoseEvidence, PoseSensitivity, WearSettings};

    /// Changes a flank.
    type Spoil = fn(&mut FlankWear);

    /// The figures of a flank that has some.
    fn judged_of(wear: &mut FlankWear) -> &mut JudgedFigures {
        wear.judged.as_mut().unwrap()
    }

    fn limits() -> FlankLimits {
        FlankLimits {
            wear: Rule::new(30.0, 50.0),
            proud: Rule::new(30.0, 50.0),
            cell: Rule::new(60.0, 100.0),
            tip: Some(TipLimits {
                radius_mm: [0.25, 0.38],
                area_mm2: [4e-3, 9e-3],
            }),
            least_coverage: 0.8,
            area_mm2: 0.25,
            hidden_depth_um: 300.0,
        }
    }

    /// A sound flank, seen whole.
    fn sound() -> FlankWear {
        let settings = WearSettings::default();
        let points: Vec<([f64; 2], f64, f64)> = (0..1600)
            .map(|i| {
                let at = [f64::from(i % 40), f64::from(i / 40)].map(|x| (x + 0.5) * 0.05);
                (at, 1e-3 * ((i % 7) as f64 - 3.0) / 3.0, 0.5e-3)
            })
            .collect();
        let mut wear = FlankWear::of_points((40, Flank::Left), [2.0, 2.0], &points, &settings);
        wear.tip = Some(tip(0.0));
        wear
    }

    fn tip(area_mm2: f64) -> crate::wear::TipLoss {
        let known = |value| Figure { value, u: 1e-4 };
        crate::wear::TipLoss {
            area_mm2: known(area_mm2),
            radius_mm: known((area_mm2 / 0.0627).sqrt()),
            whole: true,
        }
    }

    fn leaking(uniform: f64) -> Option<PoseSensitivity> {
        Some(PoseSensitivity {
            leakage: Leakage {
                uniform,
                slope: 0.0,
                pit: 0.0,
                side: 0.0,
                flanks: 0.0,
                ring: 0.0,
            },
            evidence: Some(Arc::new(PoseEvidence {
                tooth: Some(40),
                flanks: Vec::new(),
                stages_mm: 0.0,
                approach_sigma_mm: 0.0,
                mount_sigma_mm: 0.0,
                stages_both_mm: 0.0,
                both_sigma_mm: 0.0,
                mount: None,
                same_mount: None,
            })),
            datum_hides_mm: 0.0,
            form_scatter_mm: 0.0,
            others_form: 0.0,
            temperature_mm: 0.0,
        })
    }

    /// Each refusal is the only thing between a go and what it forbids: without it, the same flank passes.
    #[test]
    fn switching_a_refusal_off_lets_something_pass() {
        assert_eq!(judge(&sound(), &limits()).verdict, Verdict::Go);
        let all = Refusals::ALL;
        let cases: [(&str, Refusals, Spoil); 7] = [
            (
                "coverage",
                Refusals {
                    coverage: false,
                    ..all
                },
                |w| w.coverage = 0.7,
            ),
            (
                "hidden",
                Refusals {
                    hidden: false,
                    ..all
                },
                |w| judged_of(w).hidden_mm = Some(0.031),
            ),
            (
                "detection_limit",
                Refusals {
                    detection: false,
                    ..all
                },
                |w| {
                    w.budget.calibration_mm = 10e-3;
                },
            ),
            (
                "disagreement",
                Refusals {
                    disagreement: false,
                    ..all
                },
                |w| {
                    let read = &mut judged_of(w).read;
                    read.raw_mm = read.depth_mm.value + 0.06;
                },
            ),
            ("leakage", Refusals { pose: false, ..all }, |w| {
                w.sensitivity = leaking(0.6)
            }),
            (
                "leakage",
                Refusals {
                    opposite: false,
                    ..all
                },
                |w| {
                    judged_of(w).with_opposite = Some(OppositeChange {
                        together_mm: 0.051,
                        is_seen: false,
                    });
                },
            ),
            ("tip_unseen", Refusals { tip: false, ..all }, |w| {
                w.tip = None
            }),
        ];
        for (code, off, spoil) in cases {
            let mut wear = sound();
            spoil(&mut wear);
            let Verdict::Indeterminate { reason } = judge(&wear, &limits()).verdict else {
                panic!("{code} is not refused");
            };
            assert_eq!(reason.code().word(), code);
            assert_eq!(
                judge_with(&wear, &limits(), off).verdict,
                Verdict::Go,
                "{code}"
            );
        }
    }

    /// A figure proven to be beyond the stop limit is no-go, whatever else was not measured.
    #[test]
    fn every_figure_has_its_own_limits_and_a_proven_excess_needs_no_more() {
        let cases: [(&str, Spoil); 4] = [
            ("wear", |w| judged_of(w).wear_mm.value = 0.08),
            ("proud material", |w| judged_of(w).proud_mm.value = 0.08),
            ("loss of a single cell", |w| {
                judged_of(w).cell_mm.as_mut().unwrap().value = 0.15
            }),
            ("rounding of the tip edge", |w| w.tip = Some(tip(0.02))),
        ];
        for (figure, spoil) in cases {
            for blind in [false, true] {
                let mut wear = sound();
                spoil(&mut wear);
                if blind {
                    wear.coverage = 0.5;
                    judged_of(&mut wear).hidden_mm = Some(0.2);
                }
                let decision = judge(&wear, &limits());
                assert_eq!(decision.verdict, Verdict::NoGo, "{figure}");
                let sentence = decision.cause.unwrap().sentence(&Verdict::NoGo);
                assert!(
                    sentence.starts_with(figure) && sentence.contains("beyond the stop limit"),
                    "{sentence}"
                );
            }
        }
    }

    #[test]
    fn of_a_flank_that_was_hardly_seen_the_coverage_is_the_reason() {
        let mut wear = sound();
        wear.sensitivity = leaking(f64::NAN);
        for (coverage, code) in [(0.0, "coverage"), (0.3, "coverage"), (1.0, "leakage")] {
            wear.coverage = coverage;
            let Verdict::Indeterminate { reason } = judge(&wear, &limits()).verdict else {
                panic!("{coverage} is not refused");
            };
            assert_eq!(reason.code().word(), code);
        }
    }

    #[test]
    fn the_reason_says_beyond_only_where_it_is() {
        let mut wear = sound();
        judged_of(&mut wear).wear_mm.value = 28.8e-3;
        let decision = judge(&wear, &limits());
        assert_eq!(decision.verdict, Verdict::Warn);
        let sentence = decision.cause.unwrap().sentence(&decision.verdict);
        assert!(sentence.contains("within the guard band"), "{sentence}");
        judged_of(&mut wear).wear_mm.value = 31.0e-3;
        let decision = judge(&wear, &limits());
        let sentence = decision.cause.unwrap().sentence(&decision.verdict);
        assert!(sentence.contains("beyond the warning limit"), "{sentence}");
    }

    #[test]
    fn nothing_that_is_no_number_is_ever_go() {
        let cases: [Spoil; 9] = [
            |w| w.judged = None,
            |w| judged_of(w).cell_mm = None,
            |w| judged_of(w).wear_mm.value = f64::NAN,
            |w| judged_of(w).proud_mm.value = f64::NAN,
            |w| judged_of(w).cell_mm.as_mut().unwrap().value = f64::NAN,
            |w| judged_of(w).hidden_mm = Some(f64::NAN),
            |w| w.budget.registration_mm = f64::NAN,
            |w| w.coverage = f64::NAN,
            |w| w.sensitivity = leaking(f64::NAN),
        ];
        for (i, spoil) in cases.into_iter().enumerate() {
            let mut wear = sound();
            spoil(&mut wear);
            let verdict = judge(&wear, &limits()).verdict;
            assert!(
                matches!(verdict, Verdict::Indeterminate { .. }),
                "{i}: {verdict}"
            );
        }
    }
}
