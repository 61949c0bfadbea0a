//! Assignment of the dots to those of the plate: three large ones mark the middle and the axes, the others follow from neighbour to
//! neighbour.

use std::collections::{HashMap, VecDeque};

use super::CalibrateError;
use flankscope_foundation::order::quantile;

use super::dots::Dot;
use super::target::KEYS;

/// A dot is large if its radius exceeds the median by this; the target's large dots do by a quarter at least.
const LARGE: f64 = 1.15;
/// The next dot lies where the last step says to this part of it.
const STEP_TOLERANCE: f64 = 0.3;
/// The far key stands twice as far from the corner as the near one, seen in perspective.
const KEY_RATIO: f64 = 2.0;
const KEY_TOLERANCE: f64 = 0.35;

/// More large dots than this are no three with something beside them.
const MOST_LARGE: usize = 8;
/// The three large dots can be read in two ways; the right one labels at least this many times the dots of the other.
const CLEARLY: usize = 2;

/// Places of dots: column and row, with the dot's number.
type LabelledDots = Vec<([i32; 2], usize)>;

/// The column and row of every dot that is connected to the middle of the plate over neighbouring dots, with its number in `dots`.
///
/// Where more than three dots are large (dirt, or a plate that leans towards the head), the middle is the triple to which the most dots
/// are connected.
///
/// # Errors
/// The three large dots are not there, or stand otherwise than the target's, or more than one reading is possible.
pub(crate) fn label(dots: &[Dot], view: usize) -> Result<LabelledDots, CalibrateError> {
    let mut radii: Vec<f64> = dots.iter().map(|dot| dot.radius_px).collect();
    let usual = quantile(&mut radii, 0.5).unwrap_or(0.0);
    let large: Vec<usize> = (0..dots.len())
        .filter(|&i| dots[i].radius_px > LARGE * usual)
        .collect();
    let unclear = CalibrateError::Keys {
        view,
        got: large.len(),
    };
    if let &[a, b, c] = large.as_slice() {
        let middle = Middle::new(dots, [a, b, c]);
        return match middle.has_the_shape() {
            true => Ok(spread(dots, &middle)),
            false => Err(CalibrateError::KeyShape {
                view,
                got: middle.ratio,
                expected: KEY_RATIO,
            }),
        };
    }
    if !(3..=MOST_LARGE).contains(&large.len()) {
        return Err(unclear);
    }
    let mut readings: Vec<LabelledDots> = triples(&large)
        .map(|triple| Middle::new(dots, triple))
        .filter(Middle::has_the_shape)
        .map(|middle| (spread(dots, &middle), middle))
        .filter(|(labelled, middle)| middle.is_read_by(labelled))
        .map(|(labelled, _)| labelled)
        .collect();
    readings.sort_by_key(|labelled| std::cmp::Reverse(labelled.len()));
    let second = readings.get(1).map_or(0, Vec::len);
    let best = readings.into_iter().next();
    best.filter(|best| best.len() > CLEARLY * second)
        .ok_or(unclear)
}

/// Every three of them.
fn triples(of: &[usize]) -> impl Iterator<Item = [usize; 3]> + '_ {
    let n = of.len();
    (0..n).flat_map(move |a| {
        (a + 1..n).flat_map(move |b| (b + 1..n).map(move |c| [of[a], of[b], of[c]]))
    })
}

/// Three dots, taken for those of the plate's middle.
struct Middle {
    corner: usize,
    far: usize,
    near: usize,
    /// Distance of the far one from the corner relative to that of the near one.
    ratio: f64,
    /// Steps along columns and rows, pixels.
    axes: [[f64; 2]; 2],
}

impl Middle {
    fn new(dots: &[Dot], [a, b, c]: [usize; 3]) -> Self {
        let way = |from: usize, to: usize| {
            [0, 1].map(|axis| dots[to].centre_px[axis] - dots[from].centre_px[axis])
        };
        let length = |[x, y]: [f64; 2]| x.hypot(y);
        // The corner faces the longest side.
        let sides = [(a, b, c), (b, c, a), (c, a, b)];
        let longest = sides
            .into_iter()
            .max_by(|l, r| length(way(l.1, l.2)).total_cmp(&length(way(r.1, r.2))));
        let (corner, p, q) = longest.unwrap_or((a, b, c));
        let (far, near) = if length(way(corner, p)) > length(way(corner, q)) {
            (p, q)
        } else {
            (q, p)
        };
        Self {
            corner,
            far,
            near,
            ratio: length(way(corner, far)) / length(way(corner, near)),
            axes: [way(corner, far).map(|x| 0.5 * x), way(corner, near)],
        }
    }

    fn has_the_shape(&self) -> bool {
        (self.ratio - KEY_RATIO).abs() < KEY_TOLERANCE * KEY_RATIO
    }

    /// Whether the three large dots lie where the lattice derived from them expects them.
    fn is_read_by(&self, labelled: &LabelledDots) -> bool {
        let mut keys = KEYS.into_iter().zip([self.corner, self.far, self.near]);
        keys.all(|key| labelled.contains(&key))
    }
}

/// From the corner outwards: each dot hands its own steps on to its neighbours.
fn spread(dots: &[Dot], &Middle { corner, axes, .. }: &Middle) -> LabelledDots {
    let mut places: HashMap<[i32; 2], usize> = HashMap::from([([0, 0], corner)]);
    let mut taken = vec![false; dots.len()];
    taken[corner] = true;
    let mut open = VecDeque::from([([0, 0], corner, axes)]);
    while let Some((place, dot, axes)) = open.pop_front() {
        for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
            let mut next = place;
            next[axis] += sign;
            if places.contains_key(&next) {
                continue;
            }
            let step = axes[axis].map(|x| f64::from(sign) * x);
            let from = dots[dot].centre_px;
            let expected = [from[0] + step[0], from[1] + step[1]];
            let off = |i: &usize| {
                let [x, y] = dots[*i].centre_px;
                (x - expected[0]).hypot(y - expected[1])
            };
            let nearest = (0..dots.len())
                .filter(|&i| !taken[i])
                .min_by(|l, r| off(l).total_cmp(&off(r)));
            let Some(found) = nearest.filter(|i| off(i) < STEP_TOLERANCE * step[0].hypot(step[1]))
            else {
                continue;
            };
            let mut own = axes;
            own[axis] = [0, 1].map(|k| f64::from(sign) * (dots[found].centre_px[k] - from[k]));
            taken[found] = true;
            places.insert(next, found);
            open.push_back((next, found, own));
        }
    }
    let mut labelled: Vec<_> = places.into_iter().collect();
    labelled.sort_unstable();
    labelled
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plate in perspective, turned by 100 degrees, with every ninth dot missing.
    #[test]
    fn dots_keep_their_places_in_perspective() {
        let (sin, cos) = 100f64.to_radians().sin_cos();
        let mut dots = Vec::new();
        let mut truth = Vec::new();
        for column in -9..=9_i32 {
            for row in -9..=9_i32 {
                let key = KEYS.contains(&[column, row]);
                if !key && (column + 3 * row).rem_euclid(9) == 4 {
                    continue;
                }
                let (x, y) = (f64::from(column), f64::from(row));
                let depth = 1.0 + 0.006 * x - 0.004 * y;
                let px = [
                    500.0 + 55.0 * (cos * x - sin * y) / depth,
                    400.0 + 55.0 * (sin * x + cos * y) / depth,
                ];
                dots.push(Dot {
                    centre_px: px,
                    radius_px: if key { 20.0 } else { 14.0 } / depth,
                    column_px: 0.0,
                });
                truth.push([column, row]);
            }
        }
        let labelled = label(&dots, 0).unwrap();
        assert_eq!(labelled.len(), dots.len());
        for (place, dot) in labelled {
            assert_eq!(place, truth[dot]);
        }
    }

    /// An even plate with its middle, and whatever else is as large.
    fn plate(also_large: &[[i32; 2]]) -> (Vec<Dot>, Vec<[i32; 2]>) {
        let places = (-9..=9).flat_map(|column| (-9..=9).map(move |row| [column, row]));
        let dot = |&[column, row]: &[i32; 2]| Dot {
            centre_px: [
                500.0 + 55.0 * f64::from(column),
                400.0 - 55.0 * f64::from(row),
            ],
            radius_px: match KEYS.contains(&[column, row]) || also_large.contains(&[column, row]) {
                true => 18.0,
                false => 14.0,
            },
            column_px: 0.0,
        };
        let places: Vec<[i32; 2]> = places.collect();
        (places.iter().map(dot).collect(), places)
    }

    #[test]
    fn dirt_as_large_as_the_middle_does_not_hide_it() {
        for dirt in [
            &[[7, 3]][..],
            &[[1, 1]],
            &[[-1, 0], [3, 0]],
            &[[5, 5], [-6, 2], [8, -8], [0, 5]],
        ] {
            let (dots, places) = plate(dirt);
            let labelled = label(&dots, 0).unwrap();
            assert_eq!(labelled.len(), dots.len(), "{dirt:?}");
            for (place, dot) in labelled {
                assert_eq!(place, places[dot], "{dirt:?}");
            }
        }
    }

    /// Two middles are none: either could be the plate's.
    #[test]
    fn what_can_be_read_twice_is_refused() {
        let second = KEYS.map(|[column, row]| [column - 4, row + 3]);
        let (dots, _) = plate(&second);
        assert_eq!(
            label(&dots, 2),
            Err(CalibrateError::Keys { view: 2, got: 6 })
        );
        // Too many to be three with something beside them.
        let many: Vec<[i32; 2]> = (-9..0).map(|column| [column, -5]).collect();
        let (dots, _) = plate(&many);
        assert_eq!(
            label(&dots, 2),
            Err(CalibrateError::Keys { view: 2, got: 12 })
        );
    }

    #[test]
    fn a_plate_without_its_middle_is_refused() {
        let dot = |x: f64, y: f64, radius_px: f64| Dot {
            centre_px: [x, y],
            radius_px,
            column_px: 0.0,
        };
        let mut dots: Vec<Dot> = (0..49)
            .map(|i| dot(f64::from(i % 7) * 50.0, f64::from(i / 7) * 50.0, 12.0))
            .collect();
        assert_eq!(
            label(&dots, 3),
            Err(CalibrateError::Keys { view: 3, got: 0 })
        );
        // A corner with equal legs belongs to another target.
        for i in [24, 25, 31] {
            dots[i].radius_px = 17.0;
        }
        assert!(matches!(
            label(&dots, 3),
            Err(CalibrateError::KeyShape { view: 3, .. })
        ));
    }
}
