//! Axis-aligned boxes.

/// Axis-aligned box in f64, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Smallest coordinates.
    pub low: [f64; 3],
    /// Largest coordinates.
    pub high: [f64; 3],
}

impl Aabb {
    pub(crate) const EMPTY: Self = Self {
        low: [f64::INFINITY; 3],
        high: [f64::NEG_INFINITY; 3],
    };

    /// The smallest box around the points.
    pub fn around(points: &[[f64; 3]]) -> Self {
        let mut all = Self::EMPTY;
        for point in points {
            all.grow(&Self {
                low: *point,
                high: *point,
            });
        }
        all
    }

    /// The box's middle.
    pub fn centre(&self) -> [f64; 3] {
        std::array::from_fn(|k| 0.5 * (self.low[k] + self.high[k]))
    }

    /// The box of one point.
    #[inline(always)]
    pub(crate) fn at(point: [f64; 3]) -> Self {
        Self {
            low: point,
            high: point,
        }
    }

    /// Squared distance between two boxes.
    #[inline(always)]
    pub(crate) fn distance2(&self, other: &Self) -> f64 {
        let mut sum = 0.0;
        for k in 0..3 {
            let gap = (self.low[k] - other.high[k]).max(other.low[k] - self.high[k]);
            let gap = gap.max(0.0);
            sum += gap * gap;
        }
        sum
    }

    /// Squared distance to a point.
    #[inline(always)]
    pub(crate) fn distance2_to(&self, point: &[f64; 3]) -> f64 {
        let mut sum = 0.0;
        for (k, c) in point.iter().enumerate() {
            let (below, above) = (self.low[k] - c, c - self.high[k]);
            let gap = if below > above { below } else { above };
            let gap = if gap > 0.0 { gap } else { 0.0 };
            sum += gap * gap;
        }
        sum
    }

    /// Larger by `margin` on every side.
    pub(crate) fn widened(&self, margin: f64) -> Self {
        Self {
            low: self.low.map(|c| c - margin),
            high: self.high.map(|c| c + margin),
        }
    }

    /// Squared length of the diagonal.
    #[inline(always)]
    pub(crate) fn diagonal2(&self) -> f64 {
        (0..3).map(|k| (self.high[k] - self.low[k]).powi(2)).sum()
    }

    #[inline(always)]
    pub(crate) fn grow(&mut self, other: &Self) {
        for k in 0..3 {
            // Numbers only, so that a comparison does what `min` and `max` need three for.
            let (low, high) = (other.low[k], other.high[k]);
            self.low[k] = if low < self.low[k] { low } else { self.low[k] };
            self.high[k] = if high > self.high[k] {
                high
            } else {
                self.high[k]
            };
        }
    }

    /// Half of the surface area.
    pub(crate) fn half_area(&self) -> f64 {
        let [x, y, z] = std::array::from_fn(|k| (self.high[k] - self.low[k]).max(0.0));
        x * y + y * z + z * x
    }
}
