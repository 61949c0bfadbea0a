//! The cells of a field as they most likely are.
//!
//! Cells are sorted into structures (pits, chips, stuck material: connected cells that stand out of their columns) and the
//! rest, which wears evenly along the height. Of the rest each column counts as one value, the columns shrunk towards their
//! common mean; within each structure the cells are shrunk towards its mean. What is shrunk goes to the mean by the share
//! that its own noise has in the spread (Morris 1983): an even flank is its mean, a worn tip the mean of its column, a pit
//! ten times the noise its own depth to 1 %.

use super::field::{Field, Noise};
use super::figures::{DETECTION_FACTOR, Figure, LEAST_CLUSTER};

/// Rows that may share an error: what cores and fringes beat by stays the same over about a millimetre.
const SHARED_ROWS: usize = 4;
/// Fewer independent stretches of a column tell nothing about its scatter.
const LEAST_STRETCHES: usize = 4;
/// Few stretches may agree by chance: a column is no surer than this share of the columns' mean variance.
const LEAST_SHARE: f64 = 0.25;

/// Standard uncertainty of a cell per step to its steepest neighbour: a core passes some percent of its light to each of the
/// cores around it, so that on a slope, where one side is brighter than the other, a cell reads a little of that side.
const BLEED: f64 = 0.015;

/// Every cell's likely value with its standard uncertainty, mm; unknown where nothing was measured.
pub(super) fn likely(field: &Field, noise: &Noise) -> Vec<Figure> {
    let above = |i: usize| field.wear_mm[i] - noise.even_mm[i];
    let reach = |i: usize| DETECTION_FACTOR * noise.variances_mm2[i].sqrt();
    let mut structures = field.clusters(|i| above(i) > reach(i), LEAST_CLUSTER);
    structures.extend(field.clusters(|i| -above(i) > reach(i), LEAST_CLUSTER));
    let mut is_rest: Vec<bool> = field.wear_mm.iter().map(|w| w.is_finite()).collect();
    for &i in structures.iter().flatten() {
        is_rest[i] = false;
    }

    let mut cells = vec![Figure::UNKNOWN; field.wear_mm.len()];
    let columns: Vec<Vec<usize>> = (0..field.columns)
        .map(|column| (column..cells.len()).step_by(field.columns))
        .map(|column| column.filter(|&i| is_rest[i]).collect())
        .filter(|column: &Vec<usize>| !column.is_empty())
        .collect();
    let mut means: Vec<Figure> = columns
        .iter()
        .map(|column| mean_of_column(field, noise, column))
        .collect();
    let least = LEAST_SHARE * mean(means.iter().map(|m| m.u * m.u));
    for figure in &mut means {
        figure.u = figure.u.max(least.sqrt());
    }
    shrink(&mut means);
    for (column, mean) in columns.iter().zip(means) {
        for &i in column {
            cells[i] = mean;
        }
    }
    for structure in structures {
        let mut own: Vec<Figure> = structure
            .iter()
            .map(|&i| Figure {
                value: field.wear_mm[i],
                u: noise.variances_mm2[i].sqrt(),
            })
            .collect();
        shrink(&mut own);
        for (i, figure) in structure.into_iter().zip(own) {
            cells[i] = figure;
        }
    }
    let steepest: Vec<f64> = (0..cells.len())
        .map(|i| {
            let step = |other: usize| (cells[other].value - cells[i].value).abs();
            // f64::max passes over neighbours that were not measured.
            field.neighbours(i).map(step).fold(0.0, f64::max)
        })
        .collect();
    for (cell, step) in cells.iter_mut().zip(steepest) {
        cell.u = cell.u.hypot(BLEED * step);
    }
    cells
}

/// Mean of a column's cells, weighted by their noise; its uncertainty from how much its stretches differ.
fn mean_of_column(field: &Field, noise: &Noise, column: &[usize]) -> Figure {
    let weight = |i: usize| 1.0 / noise.variances_mm2[i];
    let weights: f64 = column.iter().map(|&i| weight(i)).sum();
    if !weights.is_finite() {
        // Cells without any noise.
        let value = mean(column.iter().map(|&i| field.wear_mm[i]));
        return Figure { value, u: 0.0 };
    }
    let value = column
        .iter()
        .map(|&i| weight(i) * field.wear_mm[i])
        .sum::<f64>()
        / weights;
    let stretch = |i: usize| i / field.columns / SHARED_ROWS;
    let stretches: Vec<f64> = column
        .chunk_by(|&a, &b| stretch(a) == stretch(b))
        .map(|cells| {
            cells
                .iter()
                .map(|&i| weight(i) * (field.wear_mm[i] - value))
                .sum()
        })
        .collect();
    let n = stretches.len() as f64;
    let variance = if stretches.len() < LEAST_STRETCHES {
        1.0 / weights
    } else {
        stretches.iter().map(|sum| sum * sum).sum::<f64>() / (weights * weights) * n / (n - 1.0)
    };
    Figure {
        value,
        u: variance.sqrt(),
    }
}

/// Moves each figure to their common mean by the share that its own variance has in what they differ by.
fn shrink(figures: &mut [Figure]) {
    let n = figures.len() as f64;
    let plain = mean(figures.iter().map(|f| f.value));
    let squares = figures.iter().map(|f| (f.value - plain).powi(2));
    let spread = squares.sum::<f64>() / (n - 1.0).max(1.0);
    let between = (spread - mean(figures.iter().map(|f| f.u * f.u))).max(0.0);
    let weight = |f: &Figure| 1.0 / (between + f.u * f.u);
    let weights: f64 = figures.iter().map(weight).sum();
    // Without any noise and difference they are their own mean.
    let common = if weights.is_finite() {
        figures.iter().map(|f| weight(f) * f.value).sum::<f64>() / weights
    } else {
        plain
    };
    for figure in figures {
        let total = between + figure.u * figure.u;
        let keep = if total > 0.0 { between / total } else { 0.0 };
        figure.value = common + keep * (figure.value - common);
        // Its own noise as far as it is kept, and what it may differ from the mean by as far as it is not: together `keep`
        // of its variance. Then the mean's own.
        figure.u = (keep * figure.u * figure.u + (1.0 - keep).powi(2) / weights).sqrt();
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}
