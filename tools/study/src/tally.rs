//! Statistics of many captures of one row.

use std::collections::{BTreeMap, BTreeSet};

use flankscope_record::document::Feature;
use serde::{Deserialize, Serialize};

use super::Group;

/// One flank in one capture.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Sample {
    /// The block: its head, calibration, die and place.
    pub block: u32,
    /// True value of the measurand, µm.
    pub truth_um: f64,
    /// Measured value, if there is one.
    #[serde(flatten)]
    pub figure: Option<Figure>,
    /// `go`, `warn`, `no-go` or `indeterminate`.
    pub verdict: String,
    /// Why it is not go.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Short name of that reason, if it is indeterminate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub code: Option<String>,
}

/// One flank in one capture, as a block keeps it.
#[derive(Serialize, Deserialize)]
pub(super) struct Found {
    /// Index of its case among the chosen ones.
    pub case: usize,
    pub is_right: bool,
    pub sample: Sample,
    /// Sources and standard uncertainties, µm.
    pub budget_um: BTreeMap<String, f64>,
}

/// A measured depth.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Figure {
    /// Wear, µm.
    pub value_um: f64,
    /// Expanded uncertainty, µm.
    pub u95_um: f64,
    /// Smallest depth that counts as detected, µm.
    pub detection_limit_um: f64,
}

impl Sample {
    /// A flank's result beside its truth.
    pub(super) fn new(block: u32, truth_um: f64, feature: &Feature) -> Self {
        let figure = || {
            Some(Figure {
                value_um: feature.wear_um?,
                u95_um: feature.u95_um?,
                detection_limit_um: feature.detail.as_ref()?.detection_limit_um,
            })
        };
        Self {
            block,
            truth_um,
            figure: figure(),
            verdict: feature.verdict.to_string(),
            reason: feature.reason.clone(),
            code: feature.code.map(|code| code.word().into()),
        }
    }

    /// Measured minus true, µm, with its expanded uncertainty.
    fn error_um(&self) -> Option<[f64; 2]> {
        let figure = self.figure?;
        Some([figure.value_um - self.truth_um, figure.u95_um])
    }

    fn is(&self, verdicts: &[&str]) -> bool {
        verdicts.contains(&self.verdict.as_str())
    }

    /// Whether the flank got "go" or "warn".
    pub fn passed(&self) -> bool {
        self.is(&["go", "warn"])
    }

    /// Whether the flank got "warn" or "no-go".
    pub fn alarmed(&self) -> bool {
        self.is(&["warn", "no-go"])
    }
}

/// Sources of a flank's uncertainty, standard uncertainties in µm; empty without a figure.
pub(super) fn budget_um(feature: &Feature) -> BTreeMap<String, f64> {
    let detail = feature.detail.as_ref();
    let of = |(name, um): (&&'static str, &f64)| ((*name).to_owned(), *um);
    detail.map_or_else(BTreeMap::new, |detail| {
        detail.budget_um.iter().map(of).collect()
    })
}

/// All samples of one row.
#[derive(Clone, Debug, Serialize)]
pub struct Cell {
    /// Name of the row.
    pub name: String,
    /// Topic of the row.
    pub group: Group,
    /// Flanks in captures.
    pub samples: Vec<Sample>,
    /// Mean budget: source and standard uncertainty, µm.
    pub budget_um: BTreeMap<String, f64>,
}

/// Number of hits among samples, and number of blocks with at least one hit among all blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Share {
    pub hits: usize,
    pub of: usize,
    pub blocks_hit: usize,
    pub blocks: usize,
}

impl Share {
    /// Counts the samples for which `hit` holds.
    pub fn of<'a>(
        samples: impl Iterator<Item = &'a Sample>,
        hit: impl Fn(&Sample) -> bool,
    ) -> Self {
        let (mut all, mut hits) = (BTreeSet::new(), BTreeSet::new());
        let mut share = Self::default();
        for sample in samples {
            share.of += 1;
            all.insert(sample.block);
            if hit(sample) {
                share.hits += 1;
                hits.insert(sample.block);
            }
        }
        Self {
            blocks_hit: hits.len(),
            blocks: all.len(),
            ..share
        }
    }
}

impl Cell {
    pub(super) fn new(name: String, group: Group) -> Self {
        Self {
            name,
            group,
            samples: Vec::new(),
            budget_um: BTreeMap::new(),
        }
    }

    pub(super) fn add(&mut self, found: Found) {
        if found.sample.figure.is_some() {
            let n = (self.figures().count() + 1) as f64;
            for (name, um) in found.budget_um {
                let mean = self.budget_um.entry(name).or_default();
                *mean += (um - *mean) / n;
            }
        }
        self.samples.push(found.sample);
    }

    fn figures(&self) -> impl Iterator<Item = &Figure> {
        self.samples.iter().filter_map(|s| s.figure.as_ref())
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = values.fold((0.0, 0.0), |(sum, n), x| (sum + x, n + 1.0));
        sum / count
    }

    fn errors_um(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.samples.iter().filter_map(Sample::error_um)
    }

    /// Mean of the truth, µm.
    pub fn truth_um(&self) -> f64 {
        Self::mean(self.samples.iter().map(|s| s.truth_um))
    }

    /// Mean error, µm.
    pub fn bias_um(&self) -> f64 {
        Self::mean(self.errors_um().map(|e| e[0]))
    }

    /// Standard deviation of the error, µm.
    pub fn spread_um(&self) -> f64 {
        let mean = self.bias_um();
        let n = self.errors_um().count() as f64;
        let squares: f64 = self.errors_um().map(|e| (e[0] - mean).powi(2)).sum();
        (squares / (n - 1.0).max(1.0)).sqrt()
    }

    /// Largest absolute error, µm.
    pub fn worst_um(&self) -> f64 {
        self.errors_um().map(|e| e[0].abs()).fold(0.0, f64::max)
    }

    /// Number of values whose 95 % interval contains the true value.
    pub(super) fn held(&self) -> Share {
        let measured = self.samples.iter().filter(|s| s.figure.is_some());
        Share::of(measured, |s| {
            s.error_um().is_some_and(|[error, u95]| error.abs() <= u95)
        })
    }

    /// Fraction of values whose 95 % interval contains the true value.
    pub fn coverage(&self) -> f64 {
        let held = self.held();
        held.hits as f64 / held.of as f64
    }

    /// Mean detection limit stated by the instrument, µm.
    pub fn detection_limit_um(&self) -> f64 {
        Self::mean(self.figures().map(|f| f.detection_limit_um))
    }

    /// Mean expanded uncertainty stated by the instrument, µm.
    pub fn u95_um(&self) -> f64 {
        Self::mean(self.figures().map(|f| f.u95_um))
    }

    /// Numbers of go, warn, no-go, indeterminate.
    pub fn verdicts(&self) -> [usize; 4] {
        ["go", "warn", "no-go", "indeterminate"]
            .map(|word| self.samples.iter().filter(|s| s.is(&[word])).count())
    }

    pub(super) fn line(&self) -> String {
        let [go, warn, no_go, open] = self.verdicts();
        format!(
            "{:<60} true {:>6.2} bias {:>6.2} sd {:>5.2} U95 {:>5.2} coverage {:>3.0} %  go {go} warn {warn} no-go {no_go} open {open}",
            self.name,
            self.truth_um(),
            self.bias_um(),
            self.spread_um(),
            self.u95_um(),
            100.0 * self.coverage(),
        )
    }
}

/// Upper end of the one-sided 95 % interval for a rate with `hits` of `all` (Clopper and Pearson 1934).
pub(super) fn upper_bound(hits: usize, all: usize) -> f64 {
    // Cumulative binomial probability, summed downwards from the most likely term by ratios of neighbours.
    let at_most = |rate: f64| {
        let mut term = (all as f64) * (1.0 - rate).ln();
        let mut sum = term.exp();
        for k in 0..hits {
            term += ((all - k) as f64 / (k + 1) as f64).ln() + (rate / (1.0 - rate)).ln();
            sum += term.exp();
        }
        sum
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if at_most(middle) > 0.05 {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

pub(super) fn percent(share: f64) -> String {
    if share.is_finite() {
        format!("{:.1} %", 100.0 * share)
    } else {
        "–".into()
    }
}

#[cfg(test)]
mod tests {
    use super::upper_bound;

    #[test]
    fn bounds_of_rates_are_those_of_the_tables() {
        // 0 of n: 1 - 0.05^(1/n). 5 of 100: 10.225 % (Clopper and Pearson's tables).
        assert!((upper_bound(0, 200) - (1.0 - 0.05_f64.powf(1.0 / 200.0))).abs() < 1e-9);
        assert!((upper_bound(5, 100) - 0.10225).abs() < 1e-4);
        assert!((upper_bound(3, 3) - 1.0).abs() < 1e-9);
    }
}
