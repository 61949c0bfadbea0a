//! Decides a flank from all of its measurements, one or several, by limits and baseline.

use std::collections::BTreeSet;
use std::sync::Arc;

use flankscope_metrology::gear::Flank;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::flank::{FlankLimits, judge};
use flankscope_metrology::verdict::{Code, Reason, Verdict, repeating_could_decide};
use flankscope_metrology::wear::{FlankWear, WearSettings};

use super::outcome::FurtherCapture;
use super::verdict::{Judged, unmeasured_flank};
use flankscope_record::baseline::Baseline;
use flankscope_record::document::Expanded;

/// Limits and baseline that flanks are judged by.
#[derive(Debug)]
pub(crate) struct FlankCriteria {
    pub tool: Arc<Tool>,
    pub limits: FlankLimits,
    pub settings: WearSettings,
    pub baseline: Option<Arc<Baseline>>,
}

impl FlankCriteria {
    /// The judged wear of a flank: its loss since the baseline if there is one, else its deviation from CAD.
    ///
    /// # Errors
    /// The baseline cannot be used for the flank.
    fn judged_wear(&self, wear: &FlankWear) -> Result<FlankWear, Reason> {
        let Some(baseline) = &self.baseline else {
            return Ok(wear.clone());
        };
        let lacks = || {
            let sentence = "the baseline lacks this flank; record it again with this tooth";
            Reason::instrument(Code::BaselineLacks, sentence)
        };
        let reference = baseline.field(wear.tooth, wear.flank).ok_or_else(lacks)?;
        let before = baseline.pose(wear.tooth);
        let since = wear.clone().since(reference, before, &self.settings);
        since.map_err(|mismatch| Reason::instrument(Code::BaselineMismatch, mismatch))
    }

    /// Judges a flank by all of its measurements, those of further views included.
    pub fn flank(
        &self,
        tooth: u32,
        flank: Flank,
        captures: &[Vec<FlankWear>],
        further: &[FurtherCapture],
    ) -> Option<Judged> {
        let is_it = |wear: &&FlankWear| (wear.tooth, wear.flank) == (tooth, flank);
        let measured: Vec<&FlankWear> = captures.iter().flatten().filter(is_it).collect();
        let mut together = FlankWear::together(&measured, &self.settings)?;
        let views: BTreeSet<usize> = further.iter().map(|of| of.view).collect();
        for view in views {
            let of_view = further.iter().filter(|of| of.view == view);
            let of_view = of_view.flat_map(|of| &of.wears);
            let of_view: Vec<&FlankWear> = of_view.filter(is_it).collect();
            if let Some(of_view) = FlankWear::together(&of_view, &self.settings) {
                together = together.with_further(&of_view, &self.settings);
            }
        }
        let absolute = together.wear_mm();
        Some(match self.judged_wear(&together) {
            Ok(wear) => {
                let judged = Judged::of_wear(&wear, absolute, &self.limits).named(&self.tool);
                if measured.len() > 1 {
                    judged.from_captures(measured.iter().map(|wear| self.figure(wear)).collect())
                } else {
                    judged
                }
            }
            Err(why) => unmeasured_flank(tooth, flank, &self.tool, &why),
        })
    }

    /// Wear by a single measurement, µm.
    fn figure(&self, wear: &FlankWear) -> Option<Expanded> {
        let depth_mm = self.judged_wear(wear).ok()?.wear_mm()?;
        let (value, u95) = (1e3 * depth_mm.value, 1e3 * depth_mm.u95());
        (value.is_finite() && u95.is_finite()).then_some(Expanded { value, u95 })
    }

    /// Whether a flank is too near to a limit to be decided, and repeating the measurement could change that.
    pub fn is_open(&self, wear: &FlankWear) -> bool {
        self.judged_wear(wear).is_ok_and(|wear| {
            let Some(depth_mm) = wear.wear_mm() else {
                return false;
            };
            let um = [
                depth_mm.value,
                wear.budget.noise_mm,
                wear.budget.systematic_mm(),
            ];
            matches!(
                judge(&wear, &self.limits).verdict,
                Verdict::NoGo
                    | Verdict::Indeterminate {
                        reason: Reason::Undecidable { .. }
                    }
            ) && repeating_could_decide(um.map(|mm| 1e3 * mm), &self.limits.wear)
        })
    }
}
