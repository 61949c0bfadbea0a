//! Number of cycles until a flank's wear exceeds a limit.
//!
//! Wear is modelled as a line with a random walk about it: rate μ, and standard deviation σ√n after n cycles. The first passage
//! of a distance d then has the inverse Gaussian distribution (Schrödinger 1915; Folks and Chhikara, J. R. Stat. Soc. B 40,
//! 1978). Distance and rate are uncertain themselves, so the distribution is averaged over both.

use super::series::Point;
use super::trend::Trend;

/// Horizon, cycles: 60 years at 30 strokes a minute. Beyond it no forecast is given.
const MOST_CYCLES: f64 = 1e9;
/// Nodes of the average over a normal variable, and how many standard deviations they span on each side.
const NODES: usize = 61;
const SPAN: f64 = 5.0;

/// Distance, rate and random walk of the wear up to a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// Remaining distance, µm, and its standard uncertainty.
    pub distance_um: [f64; 2],
    /// Wear per cycle, µm, and its standard uncertainty.
    pub rate_um: [f64; 2],
    /// Random walk of the wear about its line, µm per square root of a cycle.
    pub wander_um: f64,
}

impl Passage {
    /// The passage of a flank with this trend to a limit. `points` are those of the trend; `u_um` is the standard uncertainty of
    /// the wear, including contributions common to all values.
    #[must_use]
    pub fn new(trend: &Trend, points: &[Point], u_um: f64, limit_um: f64) -> Self {
        Self {
            distance_um: [limit_um - trend.now_um, u_um],
            rate_um: [trend.rate_um, trend.u_rate_um()],
            wander_um: wander_um(points, trend.rate_um),
        }
    }

    /// Cycles after which the limit is exceeded with `probability`; `None` beyond the horizon.
    #[must_use]
    pub fn quantile(&self, probability: f64) -> Option<f64> {
        let at_most = |cycles: f64| self.probability(cycles) <= probability;
        if at_most(MOST_CYCLES) {
            return None;
        }
        let (mut low, mut high) = (0.0, MOST_CYCLES);
        // To 1e-6 relative, or a hundredth of a cycle.
        while high - low > (1e-6 * high).max(1e-2) {
            // Bisects on a logarithmic scale first, then linearly.
            let middle = if low > 1.0 && high > 4.0 * low {
                (low * high).sqrt()
            } else {
                0.5 * (low + high)
            };
            if at_most(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        Some(low)
    }

    /// Probability that the limit is passed within `cycles`.
    #[must_use]
    pub fn probability(&self, cycles: f64) -> f64 {
        let [distance_um, u_distance_um] = self.distance_um;
        let [rate_um, u_rate_um] = self.rate_um;
        let spread = u_distance_um
            .hypot(u_rate_um * cycles)
            .hypot(self.wander_um * cycles.sqrt());
        // Beyond the limit at the end, in closed form; plus beyond it in between but back again, averaged numerically.
        let mut sum = beyond(rate_um * cycles - distance_um, spread);
        for (distance_um, weight) in nodes(self.distance_um) {
            for (rate_um, of_rate) in nodes(self.rate_um) {
                sum += weight * of_rate * back_again(distance_um, rate_um, self.wander_um, cycles);
            }
        }
        sum.min(1.0)
    }
}

/// Nodes of a normal variable with weights that sum to one.
fn nodes([value, u]: [f64; 2]) -> impl Iterator<Item = (f64, f64)> {
    let at = |i: usize| SPAN * (2.0 * i as f64 / (NODES - 1) as f64 - 1.0);
    let density = move |i: usize| (-0.5 * at(i) * at(i)).exp();
    let total: f64 = (0..NODES).map(density).sum();
    (0..NODES).map(move |i| (value + at(i) * u, density(i) / total))
}

/// Probability that a normal variable is positive.
fn beyond(value: f64, u: f64) -> f64 {
    if u > 0.0 {
        normal(value / u)
    } else {
        f64::from(u8::from(value >= 0.0))
    }
}

/// Probability that the limit was exceeded and the wear is below it again: the first-passage distribution without the part that
/// [`beyond`] counts.
fn back_again(distance_um: f64, rate_um: f64, wander_um: f64, cycles: f64) -> f64 {
    let wandered = wander_um * cycles.sqrt();
    if distance_um <= 0.0 {
        return 1.0 - beyond(rate_um * cycles - distance_um, wandered);
    }
    if wandered <= 0.0 {
        return 0.0;
    }
    let reflected = 2.0 * rate_um * distance_um / (wander_um * wander_um)
        + ln_normal(-(rate_um * cycles + distance_um) / wandered);
    reflected.exp()
}

fn normal(z: f64) -> f64 {
    flankscope_foundation::normal::probability_below(z, 0.0, 1.0)
}

/// Logarithm of the normal distribution function, also where the function underflows.
fn ln_normal(z: f64) -> f64 {
    if z > -30.0 {
        return normal(z).ln();
    }
    // First terms of Mills' ratio: relative error below 3/z⁴ = 4e-6 here, less beyond.
    -0.5 * z * z - (-z * std::f64::consts::TAU.sqrt()).ln() + (-1.0 / (z * z)).ln_1p()
}

/// Random walk of the wear about its line beyond the scatter of single values: growth of the squared difference of two values per
/// cycle between them.
fn wander_um(points: &[Point], rate_um: f64) -> f64 {
    let off = |p: &Point| p.wear_um - rate_um * p.cycles;
    let at_lag = |lag: usize| {
        let pairs = points.len().saturating_sub(lag).max(1) as f64;
        let pairs_of = || points.iter().zip(points.iter().skip(lag));
        let cycles: f64 = pairs_of().map(|(a, b)| b.cycles - a.cycles).sum();
        let square: f64 = pairs_of().map(|(a, b)| (off(b) - off(a)).powi(2)).sum();
        (cycles / pairs, square / pairs)
    };
    let (near, far) = (at_lag(1), at_lag((points.len() / 4).max(2)));
    let growth = (far.1 - near.1) / (far.0 - near.0);
    if growth.is_finite() {
        growth.max(0.0).sqrt()
    } else {
        0.0
    }
}
