//! What is said of one flank: depth, mean, area, volumes.
//!
//! A percentile of noisy cells lies above the truth even on a perfect flank. So the cells are first sorted into
//! populations: connected structures (pits, a worn edge, stuck material) and the rest. Within each population the cells are
//! shrunk towards its mean, each by the share that its own noise has in the spread (Morris 1983): an even flank reports
//! its mean, an evenly worn patch the mean of the patch, a pit ten times the noise its own depth to 1 %.

use serde::Serialize;

use super::field::{Field, Noise};

/// A cell counts as worn, and a structure as such, beyond this many standard uncertainties: 5 % errors of both kinds.
pub const DETECTION_FACTOR: f64 = 3.3;
/// Single cells are no structure: one of 200 passes 3.3 standard deviations by chance in every seventh zone.
const LEAST_CLUSTER: usize = 2;

/// A figure with its standard uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figure {
    /// Value.
    pub value: f64,
    /// Standard uncertainty, same unit.
    pub u: f64,
}

impl Figure {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self {
        value: f64::NAN,
        u: f64::NAN,
    };
}

/// Wear figures of one zone.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Figures {
    /// High percentile of the loss, bias-corrected, mm; its `u` from noise alone.
    pub depth_mm: Figure,
    /// Mean loss, mm.
    pub mean_mm: Figure,
    /// Area of connected cells beyond the threshold of detection, mm2.
    pub worn_area_mm2: Figure,
    /// Volume lost there, mm3.
    pub lost_volume_mm3: Figure,
    /// Height of material that stands proud, by the low percentile, mm; 0 when nothing does. Its `u` from noise alone.
    pub buildup_mm: Figure,
    /// Volume of material that stands proud beyond the threshold of detection, mm3.
    pub buildup_volume_mm3: Figure,
    /// Least depth that is told from none with 5 % errors of both kinds, mm.
    pub detection_limit_mm: f64,
}

/// Evaluates a field whose cells share errors of `systematic_mm`.
pub fn evaluate(field: &Field, percent: f64, systematic_mm: f64) -> Option<Figures> {
    let measured: Vec<usize> = field.measured().collect();
    if measured.is_empty() {
        return None;
    }
    let n = measured.len() as f64;
    let cells_noise = field.noise();
    let noise = cells_noise.mean_mm;
    let mean = measured.iter().map(|&i| field.wear_mm[i]).sum::<f64>() / n;

    let (values, sigmas) = shrunken(field, &measured, &cells_noise);
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let at = |percent: f64| {
        let rank = (percent / 100.0).clamp(0.0, 1.0) * (order.len() - 1) as f64;
        let (low, share) = (rank.floor() as usize, rank.fract());
        let (a, b) = (order[low], order[(low + 1).min(order.len() - 1)]);
        // Another capture would have put a neighbour in rank there: the noise of a twentieth of the cells to either side.
        let near = order.len() / 20;
        let around = &order[low.saturating_sub(near)..(low + 2 + near).min(order.len())];
        let variance = around.iter().map(|&i| sigmas[i] * sigmas[i]).sum::<f64>();
        Figure {
            value: values[a] + share * (values[b] - values[a]),
            u: (variance / around.len() as f64).sqrt(),
        }
    };
    let depth_mm = at(percent);
    let lowest = at(100.0 - percent);

    let cell_area = field.cell_area_mm2();
    let threshold = DETECTION_FACTOR * noise.hypot(systematic_mm);
    let beyond = |sign: f64, threshold: f64| {
        field.clusters(|i| sign * field.wear_mm[i] >= threshold, LEAST_CLUSTER)
    };
    let area = |threshold: f64| {
        beyond(1.0, threshold).iter().map(Vec::len).sum::<usize>() as f64 * cell_area
    };
    let volume = |sign: f64| {
        let cells: Vec<usize> = beyond(sign, threshold).concat();
        let count = cells.len() as f64;
        Figure {
            // The rim below the threshold is missing; cells inside count with their sign: rectified noise would add up.
            value: cells
                .iter()
                .fold(0.0, |sum, &i| sum + cell_area * sign * field.wear_mm[i]),
            u: cell_area * (count.sqrt() * noise).hypot(count * systematic_mm),
        }
    };
    let worn = area(threshold);
    let shift = systematic_mm.hypot(noise);
    let by_depth = 0.5 * (area(threshold - shift) - area(threshold + shift)).abs();
    // A rim of cells that are in or out as a whole.
    let by_rim = cell_area * (4.0 * (worn / cell_area).sqrt() / 12.0).sqrt();
    Some(Figures {
        depth_mm,
        mean_mm: Figure {
            value: mean,
            u: noise / n.sqrt(),
        },
        worn_area_mm2: Figure {
            value: worn,
            u: by_depth.hypot(by_rim),
        },
        lost_volume_mm3: volume(1.0),
        buildup_mm: Figure {
            value: (-lowest.value).max(0.0),
            u: lowest.u,
        },
        buildup_volume_mm3: volume(-1.0),
        detection_limit_mm: threshold,
    })
}

/// The measured cells, each shrunk within its population, and the noise of what is left of them.
fn shrunken(field: &Field, measured: &[usize], noise: &Noise) -> (Vec<f64>, Vec<f64>) {
    let mut sorted: Vec<f64> = measured.iter().map(|&i| field.wear_mm[i]).collect();
    let middle = sorted.len() / 2;
    let (_, &mut median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
    let reach = DETECTION_FACTOR * noise.mean_mm;
    let mut populations = field.clusters(|i| field.wear_mm[i] - median > reach, LEAST_CLUSTER);
    populations.extend(field.clusters(|i| median - field.wear_mm[i] > reach, LEAST_CLUSTER));
    let mut in_structure = vec![false; field.wear_mm.len()];
    for &i in populations.iter().flatten() {
        in_structure[i] = true;
    }
    populations.push(
        measured
            .iter()
            .copied()
            .filter(|&i| !in_structure[i])
            .collect(),
    );

    let variances = &noise.variances_mm2;
    let mut values = Vec::with_capacity(measured.len());
    let mut sigmas = Vec::with_capacity(measured.len());
    for cells in populations.iter().filter(|cells| !cells.is_empty()) {
        // What the cells differ by beyond their noise; then each goes to the mean by its own noise's share.
        let n = cells.len() as f64;
        let mean_of = |f: &dyn Fn(usize) -> f64| cells.iter().map(|&i| f(i)).sum::<f64>() / n;
        let mean = mean_of(&|i| field.wear_mm[i]);
        let spread = mean_of(&|i| (field.wear_mm[i] - mean).powi(2)) * n / (n - 1.0).max(1.0);
        let between = (spread - mean_of(&|i| variances[i])).max(0.0);
        let weight = |i: usize| 1.0 / (between + variances[i]);
        let weights: f64 = cells.iter().map(|&i| weight(i)).sum();
        // Noisy cells count less in the mean as well. Cells without any noise and difference are their own mean.
        let mean = if weights.is_finite() {
            cells
                .iter()
                .map(|&i| weight(i) * field.wear_mm[i])
                .sum::<f64>()
                / weights
        } else {
            mean
        };
        for &i in cells {
            let total = between + variances[i];
            let keep = if total > 0.0 { between / total } else { 0.0 };
            values.push(mean + keep * (field.wear_mm[i] - mean));
            // Its own noise as far as it is kept, and what it may differ from the mean by as far as it is not: together
            // `keep` of its variance. Then the mean's own.
            sigmas.push((keep * variances[i] + (1.0 - keep).powi(2) / weights).sqrt());
        }
    }
    (values, sigmas)
}
