//! What is said of one flank: depth, mean, area, volumes.
//!
//! A percentile of noisy cells lies above the truth even on a perfect flank, so it is taken of the cells as they most likely
//! are ([`super::likely`]).

use serde::Serialize;

use super::field::Field;
use super::likely::likely;

/// A cell counts as worn, and a structure as such, beyond this many standard uncertainties: 5 % errors of both kinds.
pub const DETECTION_FACTOR: f64 = 3.3;
/// Single cells are no structure: one of 200 passes 3.3 standard deviations by chance in every seventh zone.
pub(super) const LEAST_CLUSTER: usize = 2;

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

    let likely = likely(field, &cells_noise);
    let value = |i: usize| likely[i].value;
    let mut order = measured.clone();
    order.sort_by(|&a, &b| value(a).total_cmp(&value(b)));
    let at = |percent: f64| {
        let rank = (percent / 100.0).clamp(0.0, 1.0) * (order.len() - 1) as f64;
        let (low, share) = (rank.floor() as usize, rank.fract());
        let (a, b) = (order[low], order[(low + 1).min(order.len() - 1)]);
        let value = likely[a].value + share * (likely[b].value - likely[a].value);
        // Another capture might have put any cell in this rank that lies within two of its standard uncertainties.
        let near = order.iter().map(|&i| likely[i]);
        let near = near.filter(|cell| (cell.value - value).abs() <= 2.0 * cell.u);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, n), cell| {
            (sum + cell.u * cell.u, n + 1.0)
        });
        let variance = if count > 0.0 {
            sum / count
        } else {
            likely[a].u.max(likely[b].u).powi(2)
        };
        Figure {
            value,
            u: variance.sqrt(),
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
