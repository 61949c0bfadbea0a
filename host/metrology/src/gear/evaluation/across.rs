//! Change of deviations across a trace, removed before the trace is evaluated.
//!
//! A helix trace is made of points within a band of radii. Where they lie farther out at one height than at another, the
//! profile's slope would look like a helix deviation (and a profile trace at mid face has the same trouble with the helix).
//! So the deviations in the band are taken as a sum: a part that depends on the place along the trace, as fine as the trace's
//! filter lets through, and a part that depends on the distance across, as fine as the other filter lets through and zero on
//! the trace's line, and a twist. Least squares finds all of them at once. The second part and the twist are then taken away.
//! It is estimated only from points side by side at the same place along the trace. Where those do not
//! tell a twist, as when all lie at one distance, there is taken to be none.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::trace::{Course, TracePoint, TraceProblem};

/// The share of the largest eigenvalue below which rounding decides.
const ROUNDING: f64 = 1e-11;

/// Positions and deviations on the trace's line.
pub(super) fn taken_away(
    samples: &[TracePoint],
    course: &Course,
) -> Result<Vec<(f64, f64)>, TraceProblem> {
    fitted(samples, course, true).or_else(|_| fitted(samples, course, false))
}

fn fitted(
    samples: &[TracePoint],
    course: &Course,
    twist: bool,
) -> Result<Vec<(f64, f64)>, TraceProblem> {
    let [low, high] = course.range;
    let length = high - low;
    let along = Hats::new(course.range, course.cutoff_mm);
    let across = Hats::new([-course.reach_mm, course.reach_mm], course.across_cutoff_mm);
    let on_line = across.values(0.0);
    // The hats sum to one everywhere, so that the first one less its value on the line is redundant.
    let columns = across.count - 1 + usize::from(twist);
    let row = |sample: &TracePoint| {
        let mut row = DVector::zeros(columns);
        for (values, sign) in [(across.values(sample.across), 1.0), (on_line, -1.0)] {
            for (hat, value) in values {
                if hat > 0 {
                    row[hat - 1] += sign * value;
                }
            }
        }
        if twist {
            row[columns - 1] =
                (2.0 * (sample.at - low) / length - 1.0) * sample.across / course.reach_mm;
        }
        row
    };
    let count = samples.len().max(1) as f64;
    let mut a = DMatrix::<f64>::zeros(along.count, along.count);
    let mut b = DMatrix::<f64>::zeros(along.count, columns);
    let mut c = DMatrix::<f64>::zeros(columns, columns);
    let mut right_a = DVector::<f64>::zeros(along.count);
    let mut right_c = DVector::<f64>::zeros(columns);
    let mut sum = DVector::<f64>::zeros(columns);
    for sample in samples {
        let x = row(sample);
        let hats = along.values(sample.at);
        for (i, u) in hats {
            for (k, v) in hats {
                a[(i, k)] += u * v;
            }
            right_a[i] += u * sample.deviation;
            for (column, value) in x.iter().enumerate() {
                b[(i, column)] += u * value;
            }
        }
        c.ger(1.0, &x, &x, 1.0);
        right_c.axpy(sample.deviation, &x, 1.0);
        sum += x;
    }
    // Hats without points: nothing is asked of them, the trace itself names the gap.
    for i in 0..along.count {
        a[(i, i)] += ROUNDING * count;
    }
    let factor = a.cholesky().ok_or(TraceProblem::Entangled)?;
    let within = &c - b.transpose() * factor.solve(&b);
    let right = right_c - b.transpose() * factor.solve(&right_a);
    let eigen = SymmetricEigen::new(within.clone());
    let mut coefficients = DVector::zeros(columns);
    // Variance that the estimate adds to the trace, in units of that of one point.
    let mut added = 0.0;
    for (&seen, direction) in eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
    {
        // Shift of the trace by this part where points lie to one side; a constant is no deviation.
        let moves = (direction.dot(&((&c - &within) * direction))
            - sum.dot(&direction).powi(2) / count)
            .max(0.0);
        if seen > ROUNDING * count {
            coefficients += direction * (direction.dot(&right) / seen);
            added += moves / (count * seen);
        } else if moves > ROUNDING.sqrt() * count {
            return Err(TraceProblem::Entangled);
        }
    }
    // More than one point's own uncertainty, and the trace would be made of what was taken away.
    if added > 1.0 {
        return Err(TraceProblem::Entangled);
    }
    Ok(samples
        .iter()
        .map(|sample| {
            let taken = row(sample).dot(&coefficients);
            (sample.at, sample.deviation - taken)
        })
        .collect())
}

/// Piecewise linear functions that sum to one.
struct Hats {
    from: f64,
    spacing: f64,
    count: usize,
}

impl Hats {
    /// Knots at most `spacing` apart over a range.
    fn new([from, to]: [f64; 2], spacing: f64) -> Self {
        let intervals = ((to - from) / spacing).ceil().max(1.0);
        Self {
            from,
            spacing: (to - from) / intervals,
            count: intervals as usize + 1,
        }
    }

    /// The two hats at a position and their values; beyond the ends the last one holds.
    fn values(&self, at: f64) -> [(usize, f64); 2] {
        let last = (self.count - 1) as f64;
        let place = ((at - self.from) / self.spacing).clamp(0.0, last);
        let below = place.floor().min(last - 1.0);
        let share = place - below;
        [(below as usize, 1.0 - share), (below as usize + 1, share)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COURSE: Course = Course {
        range: [0.0, 30.0],
        stated_mm: 30.0,
        usable_mm: 30.0,
        cutoff_mm: 1.0,
        reach_mm: 0.5,
        across_cutoff_mm: 0.2,
    };

    /// Points that wander from one side of the band to the other, with some spread at each place.
    fn wandering(spread: f64) -> Vec<TracePoint> {
        (0..6000u32)
            .map(|i| {
                let at = 30.0 * f64::from(i) / 6000.0;
                let side = (0.5 - 0.5 * spread) * (at / 4.0).sin();
                let across = side + 0.5 * spread * (f64::from(i % 17) / 8.0 - 1.0);
                // A slope across of 20 um per mm, a crown and a twist.
                let deviation = 0.020 * across - 0.010 * across * across + 1e-4 * at * across;
                TracePoint {
                    at,
                    across,
                    deviation,
                }
            })
            .collect()
    }

    #[test]
    fn a_slope_across_leaves_no_mark_along() {
        let samples = wandering(0.4);
        let raw = samples.iter().map(|s| s.deviation);
        let range = raw.clone().fold(f64::MIN, f64::max) - raw.fold(f64::MAX, f64::min);
        assert!(range > 0.015, "{range}");
        // The crown between knots 0.2 mm apart: 0.010 mm / mm2 x (0.2 mm)2 / 8.
        let between_knots = 0.010 * 0.2 * 0.2 / 8.0;
        for (at, deviation) in taken_away(&samples, &COURSE).unwrap() {
            assert!(deviation.abs() < 3.0 * between_knots, "{at}: {deviation}");
        }
    }

    #[test]
    fn one_radius_at_every_place_is_refused_unless_it_is_always_the_same() {
        assert_eq!(
            taken_away(&wandering(0.0), &COURSE),
            Err(TraceProblem::Entangled)
        );
        let mut straight = wandering(0.0);
        for sample in &mut straight {
            sample.across = 0.1;
            sample.deviation = 0.002;
        }
        assert!(taken_away(&straight, &COURSE).is_ok());
    }
}
