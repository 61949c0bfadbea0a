//! Flanks to one verdict. Whatever is missing is indeterminate, never go.

use std::collections::BTreeMap;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::leakage::{RECOVERABLE, Recovery};
use flankscope_metrology::tool::{Inspect, Tool};
use flankscope_metrology::verdict::{Reason, Verdict, combine, decide, probability_below};
use flankscope_metrology::wear::{Budget, Figure, FlankWear};

use super::result::{Expanded, Feature, FlankDetail};

/// One flank with its verdict.
#[derive(Clone, Debug)]
pub struct Judged {
    tooth: u32,
    flank: Flank,
    wear_um: Option<f64>,
    u95_um: Option<f64>,
    mean_um: Option<f64>,
    coverage_ratio: f64,
    conformity: Option<f64>,
    detail: Option<FlankDetail>,
    /// The figure of each capture, where it has one.
    measurements: Vec<Option<Expanded>>,
    warn_um: f64,
    limit_um: f64,
    verdict: Verdict,
    /// Why it was not measured, where the verdict does not say it.
    unmeasured: Option<String>,
}

impl Judged {
    /// Judges a measured flank.
    ///
    /// `absolute` is its figure against CAD, which `wear` itself is without a baseline.
    pub fn of_wear(wear: &FlankWear, absolute: Figure, inspect: &Inspect) -> Self {
        let finite_um = |mm: f64| mm.is_finite().then_some(mm * 1e3);
        let verdict = if wear.coverage < inspect.least_coverage {
            Verdict::Indeterminate {
                reason: Reason::Coverage {
                    coverage: wear.coverage,
                    least: inspect.least_coverage,
                },
            }
        } else if let Some(leakage) = wear.leakage.filter(|l| l.recovery() == Recovery::Refused) {
            Verdict::Indeterminate {
                reason: Reason::Leakage {
                    leakage: leakage.worst(),
                    limit: RECOVERABLE,
                },
            }
        } else {
            decide(wear.wear_mm * 1e3, wear.u_mm * 1e3, &inspect.rule())
        };
        let conformity = probability_below(inspect.limit_um * 1e-3, wear.wear_mm, wear.u_mm);
        Self {
            tooth: wear.tooth,
            flank: wear.flank,
            wear_um: finite_um(wear.wear_mm),
            u95_um: finite_um(wear.u95_mm()),
            mean_um: finite_um(wear.mean_mm),
            coverage_ratio: wear.coverage,
            conformity: conformity.is_finite().then_some(conformity),
            detail: detail(wear, absolute),
            measurements: Vec::new(),
            warn_um: inspect.warn_um,
            limit_um: inspect.limit_um,
            verdict,
            unmeasured: None,
        }
    }

    /// The same verdict with the figures of the captures that it rests on, where there are several.
    pub fn from_captures(self, measurements: Vec<Option<Expanded>>) -> Self {
        Self {
            measurements: if measurements.len() > 1 {
                measurements
            } else {
                Vec::new()
            },
            ..self
        }
    }
}

/// The figures beside the judged one.
fn detail(wear: &FlankWear, absolute: Figure) -> Option<FlankDetail> {
    let figures = wear.figures?;
    let expanded = |figure: Figure, scale: f64| Expanded {
        value: figure.value * scale,
        u95: 1.96 * figure.u * scale,
    };
    let proud = Figure {
        u: figures.buildup_mm.u.hypot(wear.budget.systematic_mm()),
        ..figures.buildup_mm
    };
    Some(FlankDetail {
        absolute_um: expanded(absolute, 1e3),
        mean_u95_um: 1.96e3 * wear.u_mean_mm(),
        worn_area_mm2: expanded(figures.worn_area_mm2, 1.0),
        lost_volume_mm3: expanded(figures.lost_volume_mm3, 1.0),
        buildup_um: expanded(proud, 1e3),
        buildup_volume_mm3: expanded(figures.buildup_volume_mm3, 1.0),
        tip_edge_radius_mm: wear.tip_radius_mm.map(|radius| expanded(radius, 1.0)),
        detection_limit_um: 1e3 * figures.detection_limit_mm,
        budget_um: budget_um(&wear.budget),
    })
}

fn budget_um(budget: &Budget) -> BTreeMap<&'static str, f64> {
    [
        ("noise", budget.noise_mm),
        ("registration", budget.registration_mm),
        ("leakage", budget.leakage_mm),
        ("calibration", budget.calibration_mm),
        ("temperature", budget.temperature_mm),
        ("cad", budget.cad_mm),
        ("reference", budget.reference_mm),
    ]
    .map(|(name, mm)| (name, 1e3 * mm))
    .into()
}

impl From<Judged> for Feature {
    fn from(judged: Judged) -> Self {
        let (reason, code) = match &judged.verdict {
            Verdict::Indeterminate { reason } => (
                Some(judged.unmeasured.unwrap_or_else(|| reason.to_string())),
                Some(reason.code()),
            ),
            _ => (None, None),
        };
        Self {
            tooth: judged.tooth,
            flank: judged.flank.to_string(),
            wear_um: judged.wear_um,
            u95_um: judged.u95_um,
            mean_um: judged.mean_um,
            coverage_ratio: judged.coverage_ratio,
            conformity: judged.conformity,
            detail: judged.detail,
            measurements: judged.measurements,
            warn_um: judged.warn_um,
            limit_um: judged.limit_um,
            verdict: judged.verdict.word().into(),
            reason,
            code,
        }
    }
}

/// Both flanks of a tooth that could not be measured.
pub fn unmeasured(tooth: u32, tool: &Tool, why: &str) -> Vec<Judged> {
    Flank::BOTH
        .map(|flank| unmeasured_flank(tooth, flank, tool, why))
        .into()
}

/// A flank that could not be measured.
pub fn unmeasured_flank(tooth: u32, flank: Flank, tool: &Tool, why: &str) -> Judged {
    let (warn_um, limit_um) = tool
        .inspect
        .as_ref()
        .map_or((0.0, 0.0), |inspect| (inspect.warn_um, inspect.limit_um));
    Judged {
        tooth,
        flank,
        wear_um: None,
        u95_um: None,
        mean_um: None,
        coverage_ratio: 0.0,
        conformity: None,
        detail: None,
        measurements: Vec::new(),
        warn_um,
        limit_um,
        verdict: Verdict::Indeterminate {
            reason: Reason::Instrument {
                code: "not_measured",
            },
        },
        unmeasured: Some(why.to_string()),
    }
}

/// The tool's verdict and one sentence about it. A check that stopped early is never a go.
pub fn of_tool(flanks: &[Judged], stopped: Option<&str>) -> (&'static str, String) {
    let mut verdict = combine(flanks.iter().map(|flank| flank.verdict.clone()));
    if stopped.is_some() && matches!(verdict, Verdict::Go | Verdict::Warn) {
        verdict = Verdict::Indeterminate {
            reason: Reason::Instrument { code: "stopped" },
        };
    }
    let named = |word: &str| {
        let names: Vec<String> = flanks
            .iter()
            .filter(|flank| flank.verdict.word() == word)
            .map(|flank| format!("tooth {} {}", flank.tooth, flank.flank))
            .collect();
        names.join(", ")
    };
    let reason = match &verdict {
        Verdict::Go => format!("all {} flanks are within the warning limit", flanks.len()),
        Verdict::Warn => format!("beyond the warning limit: {}", named("warn")),
        Verdict::NoGo => format!("beyond the stop limit: {}", named("no-go")),
        Verdict::Indeterminate { reason } => {
            let first = flanks.iter().find_map(|flank| flank.unmeasured.as_deref());
            stopped.or(first).map_or_else(
                || format!("{reason} ({})", named("indeterminate")),
                str::to_string,
            )
        }
    };
    (verdict.word(), reason)
}
