//! Detects changes in a flank's wear over cycles: a chip, a new tool, another rate.
//!
//! Each value is predicted by the straight line through all earlier ones since the last change. Divided by their standard
//! deviation, these prediction errors are independent and normal as long as the line holds (recursive residuals: Brown, Durbin
//! and Evans, J. R. Stat. Soc. B 37, 1975), as a cumulative sum requires (Page, Biometrika 41, 1954).

use super::series::Point;

/// Allowance subtracted from each error, in standard deviations: tuned to shifts of one.
const SLACK: f64 = 0.5;
/// A sum above this many standard deviations is a change. While the line holds, the two sums together give one false alarm in 465
/// checks on average (Montgomery, Introduction to Statistical Quality Control).
const ALARM: f64 = 5.0;
/// Smallest relevant shift, as a fraction of the warning limit: a smaller one changes no decision.
const LEAST_SHARE_OF_WARN: f64 = 0.05;
/// Smallest scatter, µm: below it is the resolution of the stored values, not of the instrument.
const LEAST_SCATTER_UM: f64 = 1e-3;
/// Median of the absolute value of a normal variable, in standard deviations.
const MEDIAN_ABSOLUTE: f64 = 0.674_489_75;
/// What a median of absolute values tells of a scatter, relative to the mean of squares of as many values (Hampel 1974).
const MEDIAN_EFFICIENCY: f64 = 0.37;
/// A shift counts beyond so many of its own standard deviations.
const COVERAGE: f64 = 2.0;
/// 95 % quantile of the normal distribution.
const NORMAL_95: f64 = 1.644_854;

/// The cumulative sums of positive and of negative errors.
#[derive(Clone, Debug, Default)]
struct Sums {
    up: f64,
    down: f64,
    errors: Vec<f64>,
}

impl Sums {
    /// Adds a standardised error; returns how many values ago a change began, if one is detected.
    fn add(&mut self, error: f64) -> Option<usize> {
        self.errors.push(error);
        self.up = (self.up + error - SLACK).max(0.0);
        self.down = (self.down - error - SLACK).max(0.0);
        (self.up.max(self.down) > ALARM).then(|| self.began())
    }

    /// Most likely beginning of a shift of unknown size, as a number of values back.
    fn began(&self) -> usize {
        let (mut sum, mut best) = (0.0_f64, (0.0, 1));
        for (back, error) in (1..).zip(self.errors.iter().rev()) {
            sum += error;
            let evidence = sum * sum / back as f64;
            if evidence > best.0 {
                best = (evidence, back);
            }
        }
        best.1
    }
}

/// A least-squares line, updated point by point.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    count: f64,
    mean_cycles: f64,
    mean_um: f64,
    spread: f64,
    product: f64,
}

impl Line {
    fn add(&mut self, point: &Point) {
        self.count += 1.0;
        let cycles = point.cycles - self.mean_cycles;
        self.mean_cycles += cycles / self.count;
        let wear_um = point.wear_um - self.mean_um;
        self.mean_um += wear_um / self.count;
        self.spread += cycles * (point.cycles - self.mean_cycles);
        self.product += cycles * (point.wear_um - self.mean_um);
    }

    /// Wear on the line at a point's cycles, µm.
    fn at(&self, point: &Point) -> f64 {
        let slope = if self.spread > 0.0 {
            self.product / self.spread
        } else {
            0.0
        };
        self.mean_um + slope * (point.cycles - self.mean_cycles)
    }

    /// Prediction error of a point, in units of the values' scatter; `None` while the line is undetermined there.
    fn error(&self, point: &Point) -> Option<f64> {
        // Checks at the same cycle determine a mean only, and only there.
        let is_mean = self.count > 0.0 && point.cycles == self.mean_cycles;
        let inflation = 1.0 + self.variance(point.cycles);
        (self.spread > 0.0 || is_mean).then(|| (point.wear_um - self.at(point)) / inflation.sqrt())
    }

    /// Variance of the line at these cycles, in units of the values' scatter; of their mean if they determine no slope.
    fn variance(&self, cycles: f64) -> f64 {
        let away = cycles - self.mean_cycles;
        let of_slope = if self.spread > 0.0 {
            away * away / self.spread
        } else {
            0.0
        };
        1.0 / self.count.max(1.0) + of_slope
    }
}

/// Indices of the points at which the wear left its line permanently by at least a twentieth of the warning limit, ascending.
///
/// The scatter by which a shift is detected is that of the points themselves. Few of them know it badly, so a shift must be large
/// even if the scatter is as large as they allow: the first checks of a die raise no alarm by chance.
#[must_use]
pub fn changes(points: &[Point], warn_um: f64) -> Vec<usize> {
    let Some(scatter_um) = scatter_um(points) else {
        return Vec::new();
    };
    let least_um = LEAST_SHARE_OF_WARN * warn_um;
    let largest_scatter_um = scatter_um * largest_scatter_ratio(points.len());
    let mut changes = Vec::new();
    let mut line = Line::default();
    let mut sums = Sums::default();
    let mut next = 0;
    while let Some(point) = points.get(next) {
        let alarm = line
            .error(point)
            .and_then(|error| sums.add(error / scatter_um));
        if let Some(since) = alarm {
            let from = next + 1 - since;
            let begun = changes.last().copied().unwrap_or(0);
            let (shift_um, sigmas) = shift(&points[begun..from], &points[from..=next]);
            if shift_um >= least_um && shift_um >= COVERAGE * sigmas * largest_scatter_um {
                // The next line begins where the shift did.
                changes.push(from);
                line = Line::default();
                for point in &points[from..next] {
                    line.add(point);
                }
            }
            sums = Sums::default();
        }
        line.add(point);
        next += 1;
    }
    changes
}

/// Mean distance of later points from the line through earlier ones, µm (from their mean if they determine no slope), and its standard
/// deviation in units of the points' scatter.
fn shift(earlier: &[Point], later: &[Point]) -> (f64, f64) {
    let mut line = Line::default();
    for point in earlier {
        line.add(point);
    }
    let count = later.len().max(1) as f64;
    let off = later.iter().map(|point| point.wear_um - line.at(point));
    let middle = later.iter().map(|point| point.cycles).sum::<f64>() / count;
    let variance = 1.0 / count + line.variance(middle);
    ((off.sum::<f64>() / count).abs(), variance.sqrt())
}

/// Upper bound (95 %) of the scatter of so many points, relative to that which [`scatter_um`] finds: by the chi-squared distribution
/// (Wilson and Hilferty, PNAS 17, 1931).
fn largest_scatter_ratio(points: usize) -> f64 {
    let freedom = MEDIAN_EFFICIENCY * points.saturating_sub(2) as f64;
    let variance = 2.0 / (9.0 * freedom);
    let root = 1.0 - variance - NORMAL_95 * variance.sqrt();
    if root > 0.0 {
        root.powf(-1.5)
    } else {
        f64::INFINITY
    }
}

/// Standard deviation of a value about the line through its neighbours; the median is insensitive to the few places where the
/// wear jumps. `None` for fewer than five points.
pub fn scatter_um(points: &[Point]) -> Option<f64> {
    if points.len() < 5 {
        return None;
    }
    let mut off: Vec<f64> = points
        .windows(3)
        .map(|three| {
            let span = three[2].cycles - three[0].cycles;
            let share = if span > 0.0 {
                (three[1].cycles - three[0].cycles) / span
            } else {
                0.5
            };
            let between = (1.0 - share) * three[0].wear_um + share * three[2].wear_um;
            let variance = 1.0 + share * share + (1.0 - share) * (1.0 - share);
            ((three[1].wear_um - between) / variance.sqrt()).abs()
        })
        .collect();
    off.sort_unstable_by(f64::total_cmp);
    Some((off[off.len() / 2] / MEDIAN_ABSOLUTE).max(LEAST_SCATTER_UM))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(wear_um: &[f64]) -> Vec<Point> {
        let each = (1..).zip(wear_um);
        let point = |(check, &wear_um): (i64, &f64)| Point {
            check,
            cycles: 100.0 * check as f64,
            wear_um,
            u_um: 2.0,
        };
        each.map(point).collect()
    }

    #[test]
    fn a_shift_counts_from_a_twentieth_of_the_warning_limit_on() {
        let shifted = |um: f64| -> Vec<f64> {
            let scattered =
                |i: u32| 5.0 * f64::from(i) + if i.is_multiple_of(2) { 0.05 } else { -0.05 };
            let shifted = |i| scattered(i) + if i < 12 { 0.0 } else { um };
            (0..20).map(shifted).collect()
        };
        assert_eq!(changes(&points(&shifted(1.0)), 10.0), [12]);
        assert!(changes(&points(&shifted(1.0)), 30.0).is_empty());
        assert_eq!(changes(&points(&shifted(2.0)), 30.0), [12]);
        let chipped = points(&[5.0, 10.0, 15.0, 20.0, 25.0, 32.0, 37.0, 42.0]);
        assert_eq!(changes(&chipped, 30.0), [5]);
    }

    #[test]
    fn the_scatter_of_five_checks_is_hardly_known() {
        // Their scatter looks like 0.09 µm; the first value alone is off by more.
        let chance = points(&[4.65, 10.43, 15.48, 20.51, 25.39]);
        assert!(changes(&chance, 0.0).is_empty());
        // The 5 % quantile of chi-squared with 10 degrees of freedom is 3.940.
        let points_of_ten = 2 + (10.0 / MEDIAN_EFFICIENCY).round() as usize;
        let freedom = MEDIAN_EFFICIENCY * (points_of_ten - 2) as f64;
        let expected = (10.0_f64 / 3.940).sqrt();
        assert!((freedom - 10.0).abs() < 0.1);
        assert!((largest_scatter_ratio(points_of_ten) - expected).abs() < 0.01 * expected);
        assert_eq!(largest_scatter_ratio(2), f64::INFINITY);
    }
}
