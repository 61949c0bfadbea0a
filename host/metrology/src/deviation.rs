//! Deviations of a cloud from CAD, and their statistics.

use kiddo::{Chebyshev, ImmutableKdTree, Manhattan, SquaredEuclidean};
use rayon::prelude::*;

use crate::surface::Surface;

/// Points queried at a time: putting scattered points in order costs some 60 bytes a point, which tens of millions of
/// points could not all pay at once.
const BLOCK: usize = 1 << 23;

/// Signed distances of `points` (finite, mm) to the surface, mm, in order: positive where material stands proud.
pub fn deviations(surface: &Surface, points: &[[f64; 3]]) -> Vec<f64> {
    let mut deviations_mm = vec![0.0; points.len()];
    for (points, deviations_mm) in points.chunks(BLOCK).zip(deviations_mm.chunks_mut(BLOCK)) {
        surface.signed_distances(points, deviations_mm);
    }
    deviations_mm
}

/// Order of the Minkowski distance between points: `1` and more, or `inf`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Order {
    /// Sum of the sizes of the coordinate differences.
    One,
    /// Euclidean.
    Two,
    /// Largest coordinate difference.
    Infinity,
    /// Another, above 1: the p-th root of the sum of p-th powers.
    Other(f64),
}

/// No order of a distance.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("{text:?} is no order of a Minkowski distance; right would be a number from 1 on, or inf")]
pub struct OrderError {
    /// What was given.
    pub text: String,
}

impl TryFrom<f64> for Order {
    type Error = OrderError;

    fn try_from(order: f64) -> Result<Self, OrderError> {
        match order {
            1.0 => Ok(Self::One),
            2.0 => Ok(Self::Two),
            f64::INFINITY => Ok(Self::Infinity),
            order if order > 1.0 => Ok(Self::Other(order)),
            order => Err(OrderError {
                text: order.to_string(),
            }),
        }
    }
}

impl std::str::FromStr for Order {
    type Err = OrderError;

    fn from_str(text: &str) -> Result<Self, OrderError> {
        let order: f64 = text.trim().parse().map_err(|_| OrderError {
            text: text.to_owned(),
        })?;
        Self::try_from(order)
    }
}

impl TryFrom<String> for Order {
    type Error = OrderError;

    fn try_from(text: String) -> Result<Self, OrderError> {
        text.parse()
    }
}

impl From<Order> for String {
    fn from(order: Order) -> Self {
        order.to_string()
    }
}

impl std::fmt::Display for Order {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::One => f.write_str("1"),
            Self::Two => f.write_str("2"),
            Self::Infinity => f.write_str("inf"),
            Self::Other(order) => write!(f, "{order}"),
        }
    }
}

/// `(sum |a - b|^p)^(1/p)`, scaled by the largest difference so that no power overflows.
fn minkowski(a: &[f64; 3], b: &[f64; 3], order: f64) -> f64 {
    let off = [0, 1, 2].map(|k| (a[k] - b[k]).abs());
    let largest = off.into_iter().fold(0.0, f64::max);
    if largest == 0.0 {
        return 0.0;
    }
    let sum: f64 = off.iter().map(|d| (d / largest).powf(order)).sum();
    largest * sum.powf(order.recip())
}

/// No tree can be built over the points.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("{points} reference points cannot be searched; right would be {least} to 4294967295")]
pub struct SampleTreeError {
    /// Number of points.
    pub points: usize,
    /// Least number.
    pub least: usize,
}

/// Random surface points as reference, as in the article: the distance to the nearest of them has no sign and, even for a
/// perfect part, a mean of about half their spacing.
pub struct SampleTree {
    tree: ImmutableKdTree<f64, 3>,
    points: Vec<[f64; 3]>,
}

impl SampleTree {
    /// Builds the tree over finite points, mm.
    ///
    /// # Errors
    /// [`SampleTreeError`] for no points or too many.
    pub fn new(points: &[[f64; 3]]) -> Result<Self, SampleTreeError> {
        let error = SampleTreeError {
            points: points.len(),
            least: 1,
        };
        if points.is_empty() {
            return Err(error);
        }
        ImmutableKdTree::new_from_slice(points)
            .map(|tree| Self {
                tree,
                points: points.to_vec(),
            })
            .map_err(|_| error)
    }

    /// Distance of every point (finite, mm) to the nearest reference point, mm, in order.
    pub fn distances(&self, points: &[[f64; 3]], order: Order) -> Vec<f64> {
        let nearest = |point: &[f64; 3]| {
            let query = self.tree.query(point);
            match order {
                Order::One => query.nearest_one::<Manhattan<f64>>().execute().distance,
                Order::Two => query
                    .nearest_one::<SquaredEuclidean<f64>>()
                    .execute()
                    .distance
                    .sqrt(),
                Order::Infinity => query.nearest_one::<Chebyshev<f64>>().execute().distance,
                Order::Other(order) => self.nearest_by(point, order),
            }
        };
        points.par_iter().with_min_len(1024).map(nearest).collect()
    }

    /// Distance of an order between the tree's own. No order's distance is less than the largest difference, and none from 1 on is
    /// more than the sum: the nearest lies within the cube of the Euclidean nearest one's distance.
    fn nearest_by(&self, point: &[f64; 3], order: f64) -> f64 {
        let (first, _) = self.nearest(point);
        let most = minkowski(point, &self.points[first], order);
        // A hair more, for rounding; what lies on the rim is no nearer.
        let within = self
            .tree
            .query(point)
            .within::<Chebyshev<f64>>(most * (1.0 + 1e-12))
            .execute();
        within
            .into_iter()
            .map(|found| minkowski(point, &self.points[found.item as usize], order))
            .fold(most, f64::min)
    }

    /// Number of the nearest reference point (Euclidean) and its squared distance, mm2.
    pub(crate) fn nearest(&self, point: &[f64; 3]) -> (usize, f64) {
        let found = self
            .tree
            .query(point)
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        (found.item as usize, found.distance)
    }
}

/// Summary of a set of deviations, mm.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Statistics {
    /// Number of values.
    pub count: usize,
    /// Arithmetic mean.
    pub mean_mm: f64,
    /// Standard deviation about the mean, divisor n - 1; 0 for a single value.
    pub std_mm: f64,
    /// Root of the mean square.
    pub rms_mm: f64,
    /// 95th percentile of the absolute values (the smallest value that at least 95 % do not exceed).
    pub p95_abs_mm: f64,
    /// Largest absolute value.
    pub max_abs_mm: f64,
}

/// Summarises deviations; none for an empty set.
pub fn statistics(values_mm: &[f64]) -> Option<Statistics> {
    if values_mm.is_empty() {
        return None;
    }
    let n = values_mm.len() as f64;
    // Sums over fixed chunks, added in order: the same bytes on any thread count.
    let sum_of = |f: &(dyn Fn(f64) -> f64 + Sync)| -> f64 {
        let parts: Vec<f64> = values_mm
            .par_chunks(1 << 14)
            .map(|chunk| chunk.iter().map(|&v| f(v)).sum())
            .collect();
        parts.iter().sum()
    };
    let mean_mm = sum_of(&|v| v) / n;
    let rms_mm = (sum_of(&|v| v * v) / n).sqrt();
    let std_mm = if values_mm.len() > 1 {
        (sum_of(&|v| (v - mean_mm).powi(2)) / (n - 1.0)).sqrt()
    } else {
        0.0
    };
    let mut sizes: Vec<f64> = values_mm.iter().map(|v| v.abs()).collect();
    let max_abs_mm = sizes.iter().copied().fold(0.0, f64::max);
    let rank = ((0.95 * n).ceil() as usize).clamp(1, sizes.len()) - 1;
    let (_, p95_abs_mm, _) = sizes.select_nth_unstable_by(rank, f64::total_cmp);
    Some(Statistics {
        count: values_mm.len(),
        mean_mm,
        std_mm,
        rms_mm,
        p95_abs_mm: *p95_abs_mm,
        max_abs_mm,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::uniform;

    #[test]
    fn the_nearest_sample_is_that_of_a_linear_search_in_every_order() {
        let draw = |seed: u64, i: u64| -> [f64; 3] {
            std::array::from_fn(|k| 10.0 * uniform(seed, 3 * i + k as u64))
        };
        let samples: Vec<_> = (0..2000).map(|i| draw(1, i)).collect();
        let points: Vec<_> = (0..500).map(|i| draw(2, i)).collect();
        let tree = SampleTree::new(&samples).unwrap();
        let orders = [Order::Other(1.2), Order::Other(3.0), Order::Other(60.0)];
        for order in [Order::One, Order::Two, Order::Infinity]
            .into_iter()
            .chain(orders)
        {
            let found = tree.distances(&points, order);
            for (p, distance) in points.iter().zip(found) {
                let expected = samples
                    .iter()
                    .map(|s| {
                        let d: [f64; 3] = std::array::from_fn(|k| (s[k] - p[k]).abs());
                        match order {
                            Order::One => d[0] + d[1] + d[2],
                            Order::Two => (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt(),
                            Order::Infinity => d[0].max(d[1]).max(d[2]),
                            Order::Other(p) => {
                                (d[0].powf(p) + d[1].powf(p) + d[2].powf(p)).powf(1.0 / p)
                            }
                        }
                    })
                    .fold(f64::INFINITY, f64::min);
                assert!((distance - expected).abs() < 1e-12, "{order:?}");
            }
        }
        assert!(SampleTree::new(&[]).is_err());
    }

    #[test]
    fn orders_are_numbers_from_one_on() {
        for (text, order) in [
            ("1", Order::One),
            ("2.0", Order::Two),
            ("inf", Order::Infinity),
            ("1.5", Order::Other(1.5)),
        ] {
            assert_eq!(text.parse(), Ok(order));
            assert_eq!(order.to_string().parse(), Ok(order));
        }
        for text in ["0.5", "0", "-1", "nan", "two", "-inf"] {
            assert!(text.parse::<Order>().is_err(), "{text}");
        }
    }

    #[test]
    fn statistics_of_a_small_set_by_hand() {
        let s = statistics(&[1.0, -1.0, 2.0, -4.0]).unwrap();
        assert_eq!(
            (s.count, s.mean_mm, s.max_abs_mm, s.p95_abs_mm),
            (4, -0.5, 4.0, 4.0)
        );
        assert!((s.rms_mm - 5.5f64.sqrt()).abs() < 1e-15);
        assert!((s.std_mm - 7.0f64.sqrt()).abs() < 1e-15);
        assert_eq!(statistics(&[]), None);
    }
}
