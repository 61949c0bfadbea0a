//! What many captures of one case say together.

use std::collections::BTreeMap;

use flankscope_station::inspection::Feature;
use serde::Serialize;

use super::{Case, Group};
use crate::world::WearKind;

/// One capture's figure.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Sample {
    /// Measured depth (or height of built-up material), µm.
    pub value_um: f64,
    /// Expanded uncertainty, µm.
    pub u95_um: f64,
    /// Least depth that counts as detected, µm.
    pub detection_limit_um: f64,
}

/// All captures of one case.
#[derive(Clone, Debug, Serialize)]
pub struct Cell {
    /// Name of the case.
    pub name: String,
    #[serde(skip)]
    pub(super) group: Group,
    #[serde(skip)]
    pub(super) kind: Option<WearKind>,
    /// True value of what is measured, µm.
    pub truth_um: f64,
    /// Captures.
    pub captures: u32,
    /// Captures judged go, warn, no-go, indeterminate.
    pub verdicts: [u32; 4],
    /// Why captures were indeterminate, and how many.
    pub reasons: BTreeMap<String, u32>,
    /// Captures with a figure.
    pub samples: Vec<Sample>,
    /// Mean budget over them: source and standard uncertainty, µm.
    pub budget_um: Vec<(String, f64)>,
}

impl Cell {
    pub(super) fn new(case: &Case, truth_um: f64) -> Self {
        Self {
            name: case.name.clone(),
            group: case.group,
            kind: case.wear.map(|wear| wear.0),
            truth_um,
            captures: 0,
            verdicts: [0; 4],
            reasons: BTreeMap::new(),
            samples: Vec::new(),
            budget_um: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, feature: &Feature) {
        self.captures += 1;
        let verdict = match feature.verdict.as_str() {
            "go" => 0,
            "warn" => 1,
            "no-go" => 2,
            _ => 3,
        };
        self.verdicts[verdict] += 1;
        if let Some(reason) = feature.code {
            *self.reasons.entry(reason.to_owned()).or_default() += 1;
        }
        let (Some(wear), Some(u95), Some(detail)) =
            (feature.wear_um, feature.u95_um, &feature.detail)
        else {
            return;
        };
        let (value_um, u95_um) = if self.kind == Some(WearKind::Buildup) {
            (detail.proud_um.value, detail.proud_um.u95)
        } else {
            (wear, u95)
        };
        self.samples.push(Sample {
            value_um,
            u95_um,
            detection_limit_um: detail.detection_limit_um,
        });
        let n = self.samples.len() as f64;
        if self.budget_um.is_empty() {
            self.budget_um = detail
                .budget_um
                .keys()
                .map(|name| ((*name).to_owned(), 0.0))
                .collect();
        }
        for ((_, mean), um) in self.budget_um.iter_mut().zip(detail.budget_um.values()) {
            *mean += (um - *mean) / n;
        }
    }

    fn mean(&self, of: impl Fn(&Sample) -> f64) -> f64 {
        self.samples.iter().map(of).sum::<f64>() / self.samples.len() as f64
    }

    fn share(&self, of: impl Fn(&Sample) -> bool) -> f64 {
        self.mean(|sample| f64::from(of(sample)))
    }

    /// Mean error, µm.
    #[must_use]
    pub fn bias_um(&self) -> f64 {
        self.mean(|s| s.value_um) - self.truth_um
    }

    /// Standard deviation over the captures, µm.
    #[must_use]
    pub fn spread_um(&self) -> f64 {
        let mean = self.mean(|s| s.value_um);
        let n = self.samples.len() as f64;
        (self.mean(|s| (s.value_um - mean).powi(2)) * n / (n - 1.0).max(1.0)).sqrt()
    }

    /// Share of captures whose 95 % interval holds the truth.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        self.share(|s| (s.value_um - self.truth_um).abs() <= s.u95_um)
    }

    /// Root mean square error, µm.
    #[must_use]
    pub fn error_um(&self) -> f64 {
        self.mean(|s| (s.value_um - self.truth_um).powi(2)).sqrt()
    }

    /// 95 % interval of the coverage (Wilson 1927). Captures of a block share positions and calibrations: where blocks differ
    /// by more than independent captures would, they count as accordingly fewer.
    #[must_use]
    pub fn coverage_interval(&self) -> [f64; 2] {
        const Z: f64 = 1.96;
        let coverage = self.coverage();
        let holds = |s: &Sample| f64::from((s.value_um - self.truth_um).abs() <= s.u95_um);
        let blocks = self.samples.chunks(super::scene::BLOCK as usize);
        let misses = |block: &[Sample]| block.iter().map(|s| holds(s) - coverage).sum::<f64>();
        let count = blocks.len() as f64;
        let squares: f64 = blocks.map(|block| misses(block).powi(2)).sum();
        let all = self.samples.len() as f64;
        let independent = all * coverage * (1.0 - coverage);
        let shared = squares * count / (count - 1.0).max(1.0) / independent;
        // f64::max passes over the NaN of a coverage of 0 or 1.
        let n = all / shared.max(1.0);
        let middle = coverage + 0.5 * Z * Z / n;
        let half = Z * (coverage * (1.0 - coverage) / n + (0.5 * Z / n).powi(2)).sqrt();
        [middle - half, middle + half].map(|end| end / (1.0 + Z * Z / n))
    }

    /// Share of captures that detect the damage.
    #[must_use]
    pub fn detected(&self) -> f64 {
        self.share(|s| s.value_um >= s.detection_limit_um)
    }

    /// Mean limit of detection that the instrument states, µm.
    #[must_use]
    pub fn detection_limit_um(&self) -> f64 {
        self.mean(|s| s.detection_limit_um)
    }

    /// Mean expanded uncertainty that the instrument states, µm.
    #[must_use]
    pub fn u95_um(&self) -> f64 {
        self.mean(|s| s.u95_um)
    }

    /// Shares of go, warn, no-go, indeterminate.
    #[must_use]
    pub fn shares(&self) -> [f64; 4] {
        self.verdicts
            .map(|n| f64::from(n) / f64::from(self.captures.max(1)))
    }

    pub(super) fn line(&self) -> String {
        let [go, warn, no_go, open] = self.verdicts;
        format!(
            "{:<40} true {:>6.2} bias {:>6.2} sd {:>5.2} U95 {:>5.2} coverage {:>3.0} %  go {go} warn {warn} no-go {no_go} open {open}",
            self.name,
            self.truth_um,
            self.bias_um(),
            self.spread_um(),
            self.u95_um(),
            100.0 * self.coverage(),
        )
    }
}
