//! Combines flanks into one verdict. Missing data give an indeterminate verdict, never "go".

use std::collections::BTreeMap;

use flankscope_foundation::normal::{COVERAGE_95, probability_below};
use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::flank::{Cause, Decision, FlankLimits, judge};
use flankscope_metrology::verdict::{Reason, Verdict, Word, combine};
use flankscope_metrology::wear::{Budget, Figure, FlankWear};

use super::in_view::Finding;
use flankscope_record::document::{Expanded, Feature, FeatureId, FlankDetail};

/// One flank or patch with its verdict.
#[derive(Clone, Debug)]
pub struct Judged {
    id: FeatureId,
    wear_um: Option<f64>,
    u95_um: Option<f64>,
    at_least_um: Option<f64>,
    mean_um: Option<f64>,
    coverage_ratio: f64,
    conformity: Option<f64>,
    detail: Option<FlankDetail>,
    /// The wear by each capture, if it was measured.
    measurements: Vec<Option<Expanded>>,
    warn_um: f64,
    limit_um: f64,
    verdict: Verdict,
    /// The quantity that caused a warning or no-go.
    cause: Option<Cause>,
    /// Whether the flank was measured at all.
    measured: bool,
}

impl Judged {
    /// Judges a measured flank.
    ///
    /// `absolute` is its wear depth relative to CAD, which equals `wear` without a baseline; `None` if no disc could be measured.
    pub fn of_wear(wear: &FlankWear, absolute: Option<Figure>, limits: &FlankLimits) -> Self {
        let finite_um = |mm: f64| mm.is_finite().then_some(mm * 1e3);
        let depth_mm = wear.wear_mm();
        let Decision { verdict, cause } = judge(wear, limits);
        let rule = limits.wear;
        // Loss hidden by walls does not affect a flank that passes; dim light looks like their shadow.
        let at_least_mm = wear.judged.and_then(|of| of.at_least_mm());
        let at_least_mm = at_least_mm.filter(|_| !verdict.word().passes());
        let at_least_um = at_least_mm.and_then(finite_um);
        let conformity = depth_mm.map(|of| probability_below(rule.limit_um * 1e-3, of.value, of.u));
        Self {
            id: FeatureId {
                tooth: wear.tooth,
                flank: wear.flank,
                patch: None,
            },
            wear_um: depth_mm.and_then(|of| finite_um(of.value)),
            // No interval is given with a lower bound.
            u95_um: depth_mm
                .and_then(|of| finite_um(of.u95()))
                .filter(|_| at_least_um.is_none()),
            at_least_um,
            mean_um: wear.judged.and_then(|of| finite_um(of.mean_mm.value)),
            coverage_ratio: wear.coverage,
            conformity: conformity.filter(|of| of.is_finite() && at_least_um.is_none()),
            detail: detail(wear, absolute, limits),
            measurements: Vec::new(),
            warn_um: rule.warn_um,
            limit_um: rule.limit_um,
            verdict,
            cause,
            measured: true,
        }
    }

    pub(crate) fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The wear, µm, if measured.
    pub(crate) fn wear_um(&self) -> Option<f64> {
        self.wear_um
    }

    /// The same, with the name of its patch, if it is one of the tool's patches.
    pub(crate) fn named(mut self, tool: &Tool) -> Self {
        let patch = tool.features().patch(self.id.tooth);
        self.id.patch = patch.map(|patch| patch.name.clone());
        self
    }

    /// The same, with the heights of its zone, mm.
    pub(crate) fn over(mut self, height_mm: [f64; 2]) -> Self {
        if let Some(detail) = &mut self.detail {
            detail.zone_height_mm = Some(height_mm);
        }
        self
    }

    /// Downgrades the verdict for a reason; a no-go stays.
    pub(crate) fn withhold(&mut self, why: &Reason) {
        self.verdict = self.verdict.clone().withheld(why);
    }

    /// The same verdict, with the wear by each of the captures that it is based on.
    pub fn from_captures(self, measurements: Vec<Option<Expanded>>) -> Self {
        Self {
            measurements,
            ..self
        }
    }
}

/// The results besides the judged wear.
fn detail(wear: &FlankWear, absolute: Option<Figure>, limits: &FlankLimits) -> Option<FlankDetail> {
    let (judged, absolute) = wear.judged.zip(absolute)?;
    let figures = judged.read;
    let expanded = |value: f64, u: f64| Expanded {
        value,
        u95: COVERAGE_95 * u,
    };
    let of = |figure: Figure| expanded(figure.value, figure.u);
    let um = |mm: Figure| expanded(1e3 * mm.value, 1e3 * mm.u);
    // Cells are compared as measured, but in the pose of the judged value.
    let moved_mm = judged.mean_mm.value - figures.mean_mm.value;
    let beyond = |um: f64| wear.field.area_beyond_mm2(1e-3 * um - moved_mm);
    let finite = |figure: Expanded| figure.value.is_finite().then_some(figure);
    Some(FlankDetail {
        absolute_um: um(absolute),
        mean_u95_um: 1e3 * COVERAGE_95 * judged.mean_mm.u,
        raw_um: 1e3 * judged.raw_mm,
        deepest_at_mm: figures.at_mm,
        area_mm2: limits.area_mm2,
        zone_height_mm: None,
        proud_um: um(judged.proud_mm),
        proud_limits_um: [limits.proud.warn_um, limits.proud.limit_um],
        cell_um: judged.cell_mm.and_then(|cell| finite(um(cell))),
        cell_limits_um: [limits.cell.warn_um, limits.cell.limit_um],
        area_beyond_warn_mm2: beyond(limits.wear.warn_um),
        area_beyond_limit_mm2: beyond(limits.wear.limit_um),
        worn_area_mm2: of(figures.worn_area_mm2),
        lost_volume_mm3: of(figures.lost_volume_mm3),
        proud_volume_mm3: of(figures.proud_volume_mm3),
        tip_edge_radius_mm: wear.tip.map(|tip| of(tip.radius_mm)),
        tip_limits_mm: limits.tip.map(|tip| tip.radius_mm),
        hidden_um: judged.hidden_mm.map(|mm| 1e3 * mm),
        detection_limit_um: 1e3 * wear.detection_limit_mm(),
        budget_um: budget_um(&wear.budget),
    })
}

fn budget_um(budget: &Budget) -> BTreeMap<&'static str, f64> {
    budget
        .terms()
        .into_iter()
        .map(|(name, mm)| (name, 1e3 * mm))
        .collect()
}

impl From<Judged> for Feature {
    fn from(judged: Judged) -> Self {
        let reason = judged.verdict.reason();
        let code = reason.map(Reason::code);
        let reason = reason.map(Reason::to_string);
        let reason = reason.or_else(|| judged.cause.map(|cause| cause.sentence(&judged.verdict)));
        Self {
            id: judged.id,
            wear_um: judged.wear_um,
            u95_um: judged.u95_um,
            at_least_um: judged.at_least_um,
            mean_um: judged.mean_um,
            coverage_ratio: judged.coverage_ratio,
            conformity: judged.conformity,
            detail: judged.detail,
            measurements: judged.measurements,
            warn_um: judged.warn_um,
            limit_um: judged.limit_um,
            verdict: judged.verdict.word(),
            reason,
            code,
        }
    }
}

/// All sides of a tooth or patch that could not be measured.
pub fn unmeasured(tooth: u32, tool: &Tool, why: &Reason) -> Vec<Judged> {
    let sides = tool.features().sides().iter();
    sides
        .map(|&flank| unmeasured_flank(tooth, flank, tool, why))
        .collect()
}

/// A flank that could not be measured.
pub fn unmeasured_flank(tooth: u32, flank: Flank, tool: &Tool, why: &Reason) -> Judged {
    let (warn_um, limit_um) = tool
        .inspect
        .as_ref()
        .map_or((0.0, 0.0), |inspect| (inspect.warn_um, inspect.limit_um));
    Judged {
        id: FeatureId {
            tooth,
            flank,
            patch: None,
        },
        wear_um: None,
        u95_um: None,
        at_least_um: None,
        mean_um: None,
        coverage_ratio: 0.0,
        conformity: None,
        detail: None,
        measurements: Vec::new(),
        warn_um,
        limit_um,
        verdict: Verdict::Indeterminate {
            reason: why.clone(),
        },
        cause: None,
        measured: false,
    }
    .named(tool)
}

/// Presumptions that the sentence of a "go" states: the CAD where nothing says how the die was built, and a single band of a datum.
pub fn presumptions(tool: &Tool, has_baseline: bool) -> Vec<&'static str> {
    let mut presumed = Vec::new();
    if tool.as_built_um.is_none() && !has_baseline {
        presumed.push("the CAD is taken as true (no as_built_um, no baseline)");
    }
    let inspect = tool.inspect.as_ref();
    if inspect.is_some_and(|inspect| inspect.datum_height_mm.len() == 1) {
        presumed.push("the pose rests on one datum band, of which only the stages would show wear: two are surer");
    }
    presumed
}

/// The tool's verdict and one sentence about it. A check that stopped early is never a "go". A "go" states what is `presumed`.
/// `beside` are findings besides the requested flanks.
pub fn of_tool(
    flanks: &[Judged],
    stopped: Option<&Reason>,
    presumed: &[&str],
    beside: &[Finding],
) -> (Word, String) {
    let of_flanks = flanks.iter().map(|flank| flank.verdict.clone());
    // Without flanks there is no verdict, even if other flanks are in view.
    let counted = if flanks.is_empty() { &[] } else { beside };
    let beside_flanks = counted.iter().map(|of| of.verdict.clone());
    let mut verdict = combine(of_flanks.chain(beside_flanks));
    if let Some(why) = stopped {
        verdict = verdict.withheld(why);
    }
    let named = |word: Word| {
        let names: Vec<String> = flanks
            .iter()
            .filter(|flank| flank.verdict.word() == word)
            .map(|flank| {
                let cause = flank
                    .cause
                    .as_ref()
                    .map(|cause| cause.sentence(&flank.verdict));
                let why = cause.map_or_else(String::new, |why| format!(" ({why})"));
                format!("{}{why}", flank.id)
            })
            .collect();
        names.join(", ")
    };
    let reason = match &verdict {
        Verdict::Go => {
            let presumed: String = presumed.iter().map(|text| format!("; {text}")).collect();
            let what = match flanks.first().is_some_and(|of| of.id.patch.is_some()) {
                true => "patches",
                false => "flanks",
            };
            format!(
                "all {} {what} are within the warning limit{presumed}",
                flanks.len()
            )
        }
        Verdict::Warn | Verdict::NoGo => named(verdict.word()),
        Verdict::Indeterminate { reason } => {
            let unmeasured = flanks.iter().find(|flank| !flank.measured);
            let first = unmeasured.and_then(|flank| flank.verdict.reason());
            stopped.or(first).map_or_else(
                || format!("{reason} ({})", named(Word::Indeterminate)),
                Reason::to_string,
            )
        }
    };
    let sentences = beside.iter().map(|of| of.sentence.clone());
    let told = std::iter::once(reason).filter(|reason| !reason.is_empty());
    let all: Vec<String> = told.chain(sentences).collect();
    (verdict.word(), all.join("; "))
}
