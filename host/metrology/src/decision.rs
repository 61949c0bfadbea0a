//! One flank to its verdict: every figure against its limits, and what forbids a verdict.
//!
//! A loss that is shown to exceed the stop limit is a no-go whatever else could not be seen. Everything short of that needs
//! more: that no unmeasured patch, no blunt instrument and no pose may hide what would change the word.

use crate::leakage::RECOVERABLE;
use crate::verdict::{Reason, Rule, Verdict, combine, decide_parts};
use crate::wear::FlankWear;

/// Limits of one flank.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
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

/// What decided a verdict that is not go and not indeterminate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cause {
    /// Which figure.
    pub figure: &'static str,
    /// Its value, in the limits' unit.
    pub value: f64,
    /// How far it must keep from a limit.
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
        if value > limit {
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

/// A flank's verdict, and what decided it where it is warn or no-go.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// The verdict.
    pub verdict: Verdict,
    /// The figure behind it.
    pub cause: Option<Cause>,
}

/// Which of the refusals are in force: all of them, but in the tests that show what each is for.
#[derive(Debug, Clone, Copy)]
struct Refusals {
    coverage: bool,
    hidden: bool,
    detection: bool,
    disagreement: bool,
    pose: bool,
    tip: bool,
}

impl Refusals {
    const ALL: Self = Self {
        coverage: true,
        hidden: true,
        detection: true,
        disagreement: true,
        pose: true,
        tip: true,
    };
}

/// Judges one flank.
pub fn judge(wear: &FlankWear, limits: &Limits) -> Decision {
    judge_with(wear, limits, Refusals::ALL)
}

fn judge_with(wear: &FlankWear, limits: &Limits, refusals: Refusals) -> Decision {
    let none = |reason| Decision {
        verdict: Verdict::Indeterminate { reason },
        cause: None,
    };
    // A pose that may hide or feign anything proves nothing either way.
    if let Some(reason) = pose(wear).filter(|_| refusals.pose) {
        return none(reason);
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

/// Every figure's own verdict.
fn figures(wear: &FlankWear, limits: &Limits) -> Vec<(Verdict, Cause)> {
    let systematic = 1e3 * wear.budget.systematic_mm();
    let noise = |mm: Option<f64>| 1e3 * mm.unwrap_or(f64::NAN);
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
    let mut judged = vec![
        of(
            "wear",
            1e3 * wear.wear_mm,
            [1e3 * wear.budget.noise_mm, systematic],
            limits.wear,
        ),
        of(
            "proud material",
            1e3 * wear.proud_mm,
            [noise(wear.figures.map(|f| f.proud_mm.u)), systematic],
            limits.proud,
        ),
        of(
            "loss of a single cell",
            1e3 * wear.cell_mm.value,
            [noise(wear.figures.map(|f| f.cell_mm.u)), systematic],
            limits.cell,
        ),
    ];
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

/// Why the pose forbids any verdict.
fn pose(wear: &FlankWear) -> Option<Reason> {
    let leakage = wear.influence.as_ref()?.leakage.worst();
    (leakage.is_nan() || leakage > RECOVERABLE).then_some(Reason::Leakage {
        leakage,
        limit: RECOVERABLE,
    })
}

/// Why `verdict`, which is no no-go, cannot be given.
fn blind(wear: &FlankWear, limits: &Limits, verdict: &Verdict, on: Refusals) -> Option<Reason> {
    if wear.coverage < limits.least_coverage && on.coverage {
        return Some(Reason::Coverage {
            coverage: wear.coverage,
            least: limits.least_coverage,
        });
    }
    let Some(figures) = wear.figures else {
        return Some(Reason::NoDisc {
            area_mm2: limits.area_mm2,
        });
    };
    let (noise_um, systematic_um) = (
        1e3 * wear.budget.noise_mm,
        1e3 * wear.budget.systematic_mm(),
    );
    let guard_um = limits.wear.guard_um(noise_um, systematic_um);
    let allowed_um = if *verdict == Verdict::Go {
        limits.wear.warn_um
    } else {
        limits.wear.limit_um
    };
    if let Some(hidden_mm) = wear.hidden_mm
        && 1e3 * hidden_mm + guard_um > allowed_um
        && on.hidden
    {
        return Some(Reason::Hidden {
            hidden_um: 1e3 * hidden_mm + guard_um,
            supposed_um: limits.hidden_depth_um,
            limit_um: allowed_um,
        });
    }
    let detects_um = 1e3 * wear.detection_limit_mm();
    if !(detects_um < limits.wear.warn_um) && on.detection {
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
    let apart_um = 1e3 * (figures.raw_mm - figures.depth_mm.value).abs();
    if apart_um > guard_um && on.disagreement {
        return Some(Reason::Disagreement {
            wear_um: 1e3 * wear.wear_mm,
            raw_um: 1e3 * wear.raw_mm,
            guard_um,
        });
    }
    // What is worn away at the very edge is not there to be seen: at least as much is lost as was told.
    let tip_seen = limits.tip.is_none() || wear.tip.is_some_and(|tip| tip.whole);
    if !tip_seen && on.tip {
        return Some(Reason::TipUnseen);
    }
    None
}
