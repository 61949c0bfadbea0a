//! Flanks to one verdict. Whatever is missing is indeterminate, never go.

use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::{Inspect, Tool};
use flankscope_metrology::verdict::{Reason, Verdict, combine, decide};
use flankscope_metrology::wear::FlankWear;

use super::result::Feature;

/// One flank with its verdict.
#[derive(Clone, Debug)]
pub struct Judged {
    tooth: u32,
    flank: Flank,
    wear_um: Option<f64>,
    u95_um: Option<f64>,
    mean_um: Option<f64>,
    coverage_ratio: f64,
    warn_um: f64,
    limit_um: f64,
    verdict: Verdict,
    /// Why it was not measured, where the verdict does not say it.
    unmeasured: Option<String>,
}

impl Judged {
    /// Judges a measured flank.
    pub fn of_wear(wear: &FlankWear, inspect: &Inspect) -> Self {
        let finite_um = |mm: f64| mm.is_finite().then_some(mm * 1e3);
        let verdict = if wear.coverage < inspect.least_coverage {
            Verdict::Indeterminate {
                reason: Reason::Coverage {
                    coverage: wear.coverage,
                    least: inspect.least_coverage,
                },
            }
        } else {
            decide(
                wear.wear_mm * 1e3,
                wear.u_mm * 1e3,
                inspect.warn_um,
                inspect.limit_um,
            )
        };
        Self {
            tooth: wear.tooth,
            flank: wear.flank,
            wear_um: finite_um(wear.wear_mm),
            u95_um: finite_um(wear.u95_mm()),
            mean_um: finite_um(wear.mean_mm),
            coverage_ratio: wear.coverage,
            warn_um: inspect.warn_um,
            limit_um: inspect.limit_um,
            verdict,
            unmeasured: None,
        }
    }
}

impl From<Judged> for Feature {
    fn from(judged: Judged) -> Self {
        let reason = match &judged.verdict {
            Verdict::Indeterminate { reason } => {
                Some(judged.unmeasured.unwrap_or_else(|| reason.to_string()))
            }
            _ => None,
        };
        Self {
            tooth: judged.tooth,
            flank: judged.flank.to_string(),
            wear_um: judged.wear_um,
            u95_um: judged.u95_um,
            mean_um: judged.mean_um,
            coverage_ratio: judged.coverage_ratio,
            warn_um: judged.warn_um,
            limit_um: judged.limit_um,
            verdict: judged.verdict.word().into(),
            reason,
        }
    }
}

/// Both flanks of a tooth that could not be measured.
pub fn unmeasured(tooth: u32, tool: &Tool, why: &str) -> Vec<Judged> {
    let (warn_um, limit_um) = tool
        .inspect
        .as_ref()
        .map_or((0.0, 0.0), |inspect| (inspect.warn_um, inspect.limit_um));
    Flank::BOTH
        .iter()
        .map(|&flank| Judged {
            tooth,
            flank,
            wear_um: None,
            u95_um: None,
            mean_um: None,
            coverage_ratio: 0.0,
            warn_um,
            limit_um,
            verdict: Verdict::Indeterminate {
                reason: Reason::Instrument {
                    code: "not_measured",
                },
            },
            unmeasured: Some(why.to_string()),
        })
        .collect()
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
