//! Scatter of points that straight, narrow scratches do not explain.
//!
//! Over the width of a disc a scratch is straight, and its depth depends on the distance from its middle alone. Pits, and grooves side by
//! side, scatter otherwise. Up to three strips in different directions are found one after the other, each the one that explains most of
//! what is left (matching pursuit: Mallat and Zhang, IEEE Transactions on Signal Processing 41, 1993), all of them fitted together with a
//! surface of second order.

use nalgebra::{SMatrix, SVector};

use super::field::WearSample;

/// Distance of a strip's knots, mm: about that of neighbouring points. Between knots its depth is linear.
const KNOT_MM: f64 = 0.05;
/// Knots of a strip, beyond which its depth is nought: 0.35 mm in all. Scratches of a die in use are narrower.
const KNOTS: usize = 6;
/// More scratches than that within a disc's width are no single ones.
const STRIPS: usize = 3;
/// Directions that are tried, evenly over half a turn: at the end of a disc the nearest one is 0.02 mm beside the scratch.
const DIRECTIONS: usize = 24;
/// Strips differ by at least so many directions: parallel ones are a texture.
const LEAST_APART: usize = 2;
/// Terms of the surface of second order.
const SURFACE: usize = 6;
const TERMS: usize = SURFACE + STRIPS * KNOTS;
/// Points for each term, so that a fit leaves something to be judged.
const POINTS_PER_TERM: usize = 3;
/// Weight of a knot's being nought, in points: keeps knots without points there.
const RIDGE: f64 = 1e-3;

type Row = SVector<f64, TERMS>;

/// A straight strip: its direction, and the first of its knots across.
#[derive(Clone, Copy, Debug)]
struct Strip {
    direction: usize,
    first_knot: usize,
}

/// Places across strips of one direction, in distances of knots from the outermost one that a point can matter to.
struct Across {
    knots: usize,
    places: Vec<f64>,
}

impl Across {
    fn new(at_mm: &[[f64; 2]], direction: usize) -> Self {
        let angle = std::f64::consts::PI * direction as f64 / DIRECTIONS as f64;
        let [cos, sin] = [angle.cos(), angle.sin()];
        let across = at_mm.iter().map(|[x, y]| (x * cos + y * sin) / KNOT_MM);
        let mut places: Vec<f64> = across.collect();
        let least = places.iter().copied().fold(f64::INFINITY, f64::min);
        // Strips may begin before the first point.
        let lead = (KNOTS - 1) as f64;
        for place in &mut places {
            *place += lead - least;
        }
        let most = places.iter().copied().fold(0.0, f64::max);
        Self {
            knots: most as usize + KNOTS,
            places,
        }
    }

    /// The knot before a point, and how far behind it the point lies.
    fn before(&self, point: usize) -> (usize, f64) {
        let place = self.places[point];
        (place as usize, place.fract())
    }
}

/// Variance of points about the surface and the scratches that fit them best, mm2; none where there are too few for one scratch. Each
/// counts as often as points were merged into it.
pub(super) fn scatter_beside_mm2(points: &[&WearSample]) -> Option<f64> {
    let Fit { left, terms } = fit(points)?;
    let merged: f64 = points.iter().map(|p| p.merged).sum();
    let freedom = merged - terms as f64;
    let squares = |(point, off): (&&WearSample, &f64)| point.merged * off * off + point.within_mm2;
    let squares: f64 = points.iter().zip(&left).map(squares).sum();
    Some(squares / freedom)
}

/// Residuals of points about the surface and the scratches that fit them best, mm; none where there are too few for one scratch.
pub(super) fn residuals_beside_mm(points: &[&WearSample]) -> Option<Vec<f64>> {
    fit(points).map(|fit| fit.left)
}

/// Surface of second order with scratches.
struct Fit {
    /// Residual of each point's wear, mm.
    left: Vec<f64>,
    /// Number of its terms.
    terms: usize,
}

/// The best fit; none where there are too few points for one scratch.
fn fit(points: &[&WearSample]) -> Option<Fit> {
    let strips = (points.len() / POINTS_PER_TERM).saturating_sub(SURFACE) / KNOTS;
    if strips == 0 {
        return None;
    }
    let count = points.len() as f64;
    let middle = [0, 1].map(|k| points.iter().map(|p| p.at_mm[k]).sum::<f64>() / count);
    let at_mm: Vec<[f64; 2]> = points
        .iter()
        .map(|p| [0, 1].map(|k| p.at_mm[k] - middle[k]))
        .collect();
    let directions: Vec<Across> = (0..DIRECTIONS)
        .map(|direction| Across::new(&at_mm, direction))
        .collect();
    let mut rows: Vec<Row> = at_mm.iter().map(|at| surface(*at)).collect();
    let mut left = residuals(&rows, points)?;
    let mut found: Vec<Strip> = Vec::new();
    for number in 0..strips.min(STRIPS) {
        let strip = best_strip(&directions, points, &left, &found)?;
        let across = &directions[strip.direction];
        for (point, row) in rows.iter_mut().enumerate() {
            let (knot, share) = across.before(point);
            for (at, weight) in [(knot, 1.0 - share), (knot + 1, share)] {
                if (strip.first_knot..strip.first_knot + KNOTS).contains(&at) {
                    row[SURFACE + number * KNOTS + at - strip.first_knot] = weight;
                }
            }
        }
        left = residuals(&rows, points)?;
        found.push(strip);
    }
    Some(Fit {
        left,
        terms: SURFACE + found.len() * KNOTS,
    })
}

/// The terms of the surface; those of strips are nought.
fn surface([x, y]: [f64; 2]) -> Row {
    let mut row = Row::zeros();
    for (term, value) in row.iter_mut().zip([1.0, x, y, x * x, x * y, y * y]) {
        *term = value;
    }
    row
}

/// What the best fit of these rows leaves of each point's wear, mm.
fn residuals(rows: &[Row], points: &[&WearSample]) -> Option<Vec<f64>> {
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = Row::zeros();
    for (row, point) in rows.iter().zip(points) {
        let weighted = point.merged * row;
        normal.ger(1.0, &weighted, row, 1.0);
        right += point.wear_mm * weighted;
    }
    // Of a surface too little to move it.
    for term in 0..TERMS {
        normal[(term, term)] += if term < SURFACE { 1e-9 } else { RIDGE };
    }
    let fit = normal.cholesky()?.solve(&right);
    let left = |(row, point): (&Row, &&WearSample)| point.wear_mm - row.dot(&fit);
    Some(rows.iter().zip(points).map(left).collect())
}

/// The strip whose depths explain most of what is left, in a direction of its own.
fn best_strip(
    directions: &[Across],
    points: &[&WearSample],
    left: &[f64],
    found: &[Strip],
) -> Option<Strip> {
    let mut best: Option<(f64, Strip)> = None;
    for (direction, across) in directions.iter().enumerate() {
        let near = |strip: &Strip| {
            let apart = strip.direction.abs_diff(direction);
            apart.min(DIRECTIONS - apart) < LEAST_APART
        };
        if found.iter().any(near) {
            continue;
        }
        // Normal equations of all knots: hats overlap with their neighbours only.
        let mut diagonal = vec![RIDGE; across.knots];
        let (mut beside, mut right) = (vec![0.0; across.knots], vec![0.0; across.knots]);
        for (at, (point, off)) in points.iter().zip(left).enumerate() {
            let (knot, share) = across.before(at);
            let [near, far] = [1.0 - share, share].map(|weight| point.merged * weight);
            diagonal[knot] += near * (1.0 - share);
            diagonal[knot + 1] += far * share;
            beside[knot] += near * share;
            right[knot] += near * off;
            right[knot + 1] += far * off;
        }
        for first_knot in 0..=across.knots - KNOTS {
            let of = first_knot..first_knot + KNOTS;
            let gain = explained(&diagonal[of.clone()], &beside[of.clone()], &right[of]);
            if best.as_ref().is_none_or(|(most, _)| gain > *most) {
                let strip = Strip {
                    direction,
                    first_knot,
                };
                best = Some((gain, strip));
            }
        }
    }
    best.map(|(_, strip)| strip)
}

/// Sum of squares that some knots explain: of `A x = b` with a tridiagonal, positive `A` the product `b x`, by elimination.
fn explained(diagonal: &[f64], beside: &[f64], right: &[f64]) -> f64 {
    let (mut gain, mut pivot, mut value) = (0.0, 0.0, 0.0);
    for knot in 0..diagonal.len() {
        let (above, below) = match knot {
            0 => (0.0, 0.0),
            _ => (beside[knot - 1] / pivot, beside[knot - 1]),
        };
        (pivot, value) = (diagonal[knot] - above * below, right[knot] - above * value);
        gain += value * value / pivot;
    }
    gain
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::random::{normal, uniform};

    const NOISE_MM: f64 = 1e-3;

    /// Points all over a window of 0.57 mm.
    fn points(depth_mm: impl Fn(f64, f64) -> f64, seed: u64) -> Vec<WearSample> {
        (0..140)
            .map(|i| {
                let [x, y] = [0, 1].map(|k| 0.57 * uniform(seed, 2 * i + k));
                let wear_mm = depth_mm(x, y) + NOISE_MM * normal(seed + 1, i);
                WearSample::of_point([x, y], wear_mm, NOISE_MM * NOISE_MM)
            })
            .collect()
    }

    fn scatter_um(depth_mm: impl Fn(f64, f64) -> f64, seed: u64) -> f64 {
        let points = points(depth_mm, seed);
        let of: Vec<&WearSample> = points.iter().collect();
        1e3 * scatter_beside_mm2(&of).expect("enough points").sqrt()
    }

    /// Half a period of a cosine across a line.
    fn scratch(angle: f64, at: f64, width: f64, depth: f64) -> impl Fn(f64, f64) -> f64 {
        move |x, y| {
            let off = (x * angle.cos() + y * angle.sin() - at) / (0.5 * width);
            match off.abs() < 1.0 {
                true => 0.5 * depth * (1.0 + (std::f64::consts::PI * off).cos()),
                false => 0.0,
            }
        }
    }

    #[test]
    fn scratches_that_cross_are_explained_and_pits_are_not() {
        for seed in 0..20 {
            let u = |k: u64, low: f64, high: f64| low + (high - low) * uniform(900 + seed, k);
            let angle = u(0, 0.0, 3.0);
            let of = |k: u64, turn: f64| {
                scratch(
                    angle + turn,
                    u(k, 0.1, 0.4),
                    u(k + 1, 0.15, 0.3),
                    u(k + 2, 5e-3, 20e-3),
                )
            };
            let (one, two) = (of(1, 0.0), of(4, u(7, 0.5, 2.5)));
            let both = scatter_um(|x, y| one(x, y).max(two(x, y)), seed);
            // Where they cross the deeper one counts, which no sum shows.
            assert!(both < 2.5, "{seed}: {both} of 1 um");
            let plain = scatter_um(|x, y| 0.02 * x + 0.1 * y * y, seed);
            assert!(plain < 1.3, "{seed}: {plain} of 1 um");
            // Dimples of a fifth of the area, as deep as such a scratch.
            let pitch = u(8, 0.12, 0.2);
            let away = |v: f64| v.rem_euclid(pitch) - 0.5 * pitch;
            let pits = scatter_um(
                |x, y| {
                    if away(x).hypot(away(y)) < 0.25 * pitch {
                        15e-3
                    } else {
                        0.0
                    }
                },
                seed,
            );
            assert!(pits > 3.5, "{seed}: {pits} of some 6 um");
        }
    }

    #[test]
    fn what_knots_explain_is_what_the_full_equations_say() {
        for seed in 0..50 {
            let u = |k: u64| uniform(seed, k);
            let diagonal: Vec<f64> = (0..5).map(|k| 2.5 + u(k)).collect();
            let beside: Vec<f64> = (5..10).map(u).collect();
            let right: Vec<f64> = (10..15).map(|k| u(k) - 0.5).collect();
            let full = SMatrix::<f64, 5, 5>::from_fn(|i, k| match i.abs_diff(k) {
                0 => diagonal[i],
                1 => beside[i.min(k)],
                _ => 0.0,
            });
            let right_of = SVector::<f64, 5>::from_row_slice(&right);
            let solved = full.lu().solve(&right_of).expect("positive");
            let found = explained(&diagonal, &beside, &right);
            assert!((found - right_of.dot(&solved)).abs() < 1e-12, "{seed}");
        }
    }

    #[test]
    fn few_points_say_nothing_and_merged_ones_count_as_many() {
        let all = points(|_, _| 0.0, 3);
        let few: Vec<&WearSample> = all.iter().take(32).collect();
        assert_eq!(scatter_beside_mm2(&few), None);
        // A point that stands for four with their scatter, and the four themselves, in the same place.
        let merged: Vec<WearSample> = all
            .iter()
            .map(|p| WearSample {
                merged: 4.0,
                within_mm2: 4.0 * 1e-6,
                ..*p
            })
            .collect();
        let apart: Vec<WearSample> = all
            .iter()
            .flat_map(|p| {
                [-1e-3, -1e-3, 1e-3, 1e-3].map(|off| WearSample {
                    wear_mm: p.wear_mm + off,
                    ..*p
                })
            })
            .collect();
        let of = |points: &[WearSample]| {
            let points: Vec<&WearSample> = points.iter().collect();
            scatter_beside_mm2(&points).expect("enough points")
        };
        let (one, four) = (of(&merged), of(&apart));
        assert!((one / four - 1.0).abs() < 1e-9, "{one} {four}");
    }
}
