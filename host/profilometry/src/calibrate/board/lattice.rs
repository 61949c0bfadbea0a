//! Assignment of candidates to points of a board: a square lattice grown from neighbour to neighbour.
//!
//! Nothing presumes that the whole board is seen or how it lies: where the lattice begins is part of a pose, which is unknown anyway.

use std::collections::{HashMap, VecDeque};

use super::closed_form::homography;

/// A place that may be a point of the board.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub at_px: [f64; 2],
    /// Direction of the white squares at a crossing, as cosine and sine of twice the angle; neighbouring crossings have the opposite.
    pub white: Option<[f64; 2]>,
    /// Directions of a crossing's two edges.
    pub edges: Option<[[f64; 2]; 2]>,
}

/// A point with its place in the lattice. Columns and rows turn as those of the image do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LatticePoint {
    pub place: [i32; 2],
    pub at_px: [f64; 2],
}

/// A neighbour lies this near to where the lattice puts it, in distances of neighbours.
const NEAR: f64 = 0.3;
/// A point lies this near to the middle of its neighbours on either side.
const STRAIGHT: f64 = 0.1;
/// Largest angle (its sine) between a crossing's edge and the direction to its neighbour.
const BESIDE_EDGE: f64 = 0.2;
/// Neighbours' white lies across (cosine of twice the angle between them).
pub(super) const ACROSS: f64 = -0.5;
/// Lattices smaller than this are chance.
const LEAST_POINTS: usize = 9;

/// The largest lattice among the candidates; empty if there is none.
pub(super) fn grow(candidates: &[Candidate], width_px: f64) -> Vec<LatticePoint> {
    let places: Vec<[f64; 2]> = candidates.iter().map(|c| c.at_px).collect();
    let search = Search {
        candidates,
        squares: Squares::new(&places, (width_px / 64.0).max(4.0)),
        places: &places,
    };
    let mut taken = vec![false; candidates.len()];
    let mut best: HashMap<[i32; 2], usize> = HashMap::new();
    for seed in 0..candidates.len() {
        if taken[seed] {
            continue;
        }
        for basis in search.bases(seed, width_px) {
            let grown = search.grown_about(seed, basis);
            if grown.len() > best.len() {
                // Its points need not begin another; those of chance lattices may still belong to the board.
                for &member in grown.values().filter(|_| grown.len() >= LEAST_POINTS) {
                    taken[member] = true;
                }
                best = grown;
            }
        }
    }
    search.straight(best)
}

struct Search<'a> {
    candidates: &'a [Candidate],
    places: &'a [[f64; 2]],
    squares: Squares,
}

/// Places sorted into squares, for neighbours within any distance.
struct Squares {
    side: f64,
    members: HashMap<[i64; 2], Vec<usize>>,
}

impl Squares {
    fn new(places: &[[f64; 2]], side: f64) -> Self {
        let mut members: HashMap<[i64; 2], Vec<usize>> = HashMap::new();
        for (index, place) in places.iter().enumerate() {
            let square = place.map(|x| (x / side).floor() as i64);
            members.entry(square).or_default().push(index);
        }
        Self { side, members }
    }

    fn about(&self, at: [f64; 2], reach: f64) -> impl Iterator<Item = usize> + '_ {
        let [columns, rows] = at.map(|x| {
            let square = |x: f64| (x / self.side).floor() as i64;
            square(x - reach)..=square(x + reach)
        });
        rows.flat_map(move |row| columns.clone().map(move |column| [column, row]))
            .filter_map(|square| self.members.get(&square))
            .flatten()
            .copied()
    }
}

type Basis = [[f64; 2]; 2];

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn length([x, y]: [f64; 2]) -> f64 {
    x.hypot(y)
}

impl Search<'_> {
    fn within(&self, at: [f64; 2], reach_px: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.squares.about(at, reach_px).filter_map(move |other| {
            let distance = length(minus(self.places[other], at));
            (distance < reach_px).then_some((other, distance))
        })
    }

    /// Whether two candidates may be neighbours.
    fn alternate(&self, a: usize, b: usize) -> bool {
        match (self.candidates[a].white, self.candidates[b].white) {
            (Some(a), Some(b)) => a[0] * b[0] + a[1] * b[1] < ACROSS,
            _ => true,
        }
    }

    /// Steps to the next points along columns and rows, as far as a candidate's surroundings suggest.
    fn bases(&self, seed: usize, width_px: f64) -> Vec<Basis> {
        let at = self.places[seed];
        let mut around: Vec<(usize, f64)> = Vec::new();
        let mut reach = width_px / 80.0;
        while around.len() < 24 && reach < 0.4 * width_px {
            around = self.within(at, reach).filter(|n| n.0 != seed).collect();
            reach *= 1.6;
        }
        around.sort_by(|a, b| a.1.total_cmp(&b.1));
        let steps: Vec<[f64; 2]> = around
            .iter()
            .filter(|(other, _)| self.alternate(seed, *other))
            .map(|(other, _)| minus(self.places[*other], at))
            .collect();
        let mut bases = Vec::new();
        if let Some(edges) = self.candidates[seed].edges {
            let along = |edge: [f64; 2]| {
                let beside =
                    |step: &&[f64; 2]| cross(edge, **step).abs() < BESIDE_EDGE * length(**step);
                steps.iter().find(beside).copied()
            };
            if let [Some(a), Some(b)] = edges.map(along) {
                bases.push([a, b]);
            }
        } else if let Some(&first) = steps.first() {
            let across = |step: &&[f64; 2]| {
                cross(first, **step).abs() > 0.5 * length(first) * length(**step)
            };
            bases.extend(steps.iter().find(across).map(|&second| [first, second]));
        }
        for basis in &mut bases {
            // The same handedness as an image's columns and rows.
            if cross(basis[0], basis[1]) < 0.0 {
                basis.swap(0, 1);
            }
        }
        bases
    }

    fn grown_about(&self, seed: usize, basis: Basis) -> HashMap<[i32; 2], usize> {
        let mut lattice = HashMap::from([([0, 0], seed)]);
        let mut used = HashMap::from([(seed, [0, 0])]);
        let mut open = VecDeque::from([([0, 0], seed, basis)]);
        while let Some((place, point, basis)) = open.pop_front() {
            let at = self.places[point];
            for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1)] {
                let mut next = place;
                next[axis] += sign;
                if lattice.contains_key(&next) {
                    continue;
                }
                let step = basis[axis].map(|x| f64::from(sign) * x);
                let expected = [at[0] + step[0], at[1] + step[1]];
                // In perspective the shorter side of the lattice limits how far a point may be off.
                let reach = NEAR * length(basis[0]).min(length(basis[1]));
                let free = |(other, _): &(usize, f64)| {
                    !used.contains_key(other) && self.alternate(point, *other)
                };
                let nearest = self
                    .within(expected, reach)
                    .filter(free)
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                let Some((found, _)) = nearest else { continue };
                let mut bent = basis;
                bent[axis] = minus(self.places[found], at).map(|x| f64::from(sign) * x);
                lattice.insert(next, found);
                used.insert(found, next);
                open.push_back((next, found, bent));
            }
        }
        lattice
    }

    /// Without points that do not lie midway between their neighbours, in order of rows and columns, counted from 0.
    fn straight(&self, lattice: HashMap<[i32; 2], usize>) -> Vec<LatticePoint> {
        if lattice.len() < LEAST_POINTS {
            return Vec::new();
        }
        let at = |place: [i32; 2]| lattice.get(&place).map(|&point| self.places[point]);
        let bent = |&place: &[i32; 2]| {
            let own = at(place);
            [[1, 0], [0, 1]].into_iter().any(|[dx, dy]| {
                let sides = [1, -1].map(|s| at([place[0] + s * dx, place[1] + s * dy]));
                let (Some(own), [Some(a), Some(b)]) = (own, sides) else {
                    return false;
                };
                let off = minus(own, [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]);
                length(off) > STRAIGHT * 0.5 * length(minus(a, b))
            })
        };
        let kept = lattice.iter().filter(|(place, _)| !bent(place));
        let labelled = kept.map(|(&place, &point)| LatticePoint {
            place,
            at_px: self.places[point],
        });
        from_zero(labelled.collect())
    }
}

/// Columns and rows that labelled points take up.
pub(super) fn extent(points: &[LatticePoint]) -> [usize; 2] {
    [0, 1].map(|axis| {
        let places = points.iter().map(|point| point.place[axis]);
        let ends = places.clone().min().zip(places.max());
        ends.map_or(0, |(first, last)| (last - first) as usize + 1)
    })
}

/// Median distance of neighbours in the image about each point, px.
pub(super) fn spacings_px(points: &[LatticePoint]) -> Vec<f64> {
    let at: HashMap<[i32; 2], [f64; 2]> = points.iter().map(|p| (p.place, p.at_px)).collect();
    let nearest = |point: &LatticePoint| {
        let [column, row] = point.place;
        let neighbours = [
            [column + 1, row],
            [column - 1, row],
            [column, row + 1],
            [column, row - 1],
        ];
        let distances = neighbours.iter().filter_map(|place| at.get(place));
        let distances = distances.map(|&other| length(minus(other, point.at_px)));
        distances.fold(f64::INFINITY, f64::min)
    };
    points.iter().map(nearest).collect()
}

/// Expected positions of lattice points missing beside present ones, by the homography of the points about them.
pub(super) fn expected_beside(points: &[LatticePoint]) -> Vec<LatticePoint> {
    const ABOUT: i32 = 3;
    let has: HashMap<[i32; 2], [f64; 2]> = points.iter().map(|p| (p.place, p.at_px)).collect();
    let beside = points.iter().flat_map(|point| {
        let [column, row] = point.place;
        [
            [column + 1, row],
            [column - 1, row],
            [column, row + 1],
            [column, row - 1],
        ]
    });
    let mut lacking: Vec<[i32; 2]> = beside.filter(|place| !has.contains_key(place)).collect();
    lacking.sort_by_key(|&[column, row]| (row, column));
    lacking.dedup();
    let expected = lacking.into_iter().filter_map(|place| {
        let near = |other: &&LatticePoint| {
            (0..2).all(|axis| (other.place[axis] - place[axis]).abs() <= ABOUT)
        };
        let pairs: Vec<_> = points
            .iter()
            .filter(near)
            .map(|other| {
                (
                    [0, 1].map(|axis| f64::from(other.place[axis] - place[axis])),
                    other.at_px,
                )
            })
            .collect();
        // Columns and rows of at least two.
        let spread = (0..2).all(|axis| pairs.iter().any(|pair| pair.0[axis] != pairs[0].0[axis]));
        if pairs.len() < 6 || !spread {
            return None;
        }
        let h = homography(&pairs)?;
        let at_px = [h[(0, 2)] / h[(2, 2)], h[(1, 2)] / h[(2, 2)]];
        at_px
            .iter()
            .all(|x| x.is_finite())
            .then_some(LatticePoint { place, at_px })
    });
    expected.collect()
}

/// Counted from 0 again, in order of rows and columns.
pub(super) fn from_zero(mut points: Vec<LatticePoint>) -> Vec<LatticePoint> {
    let first = [0, 1].map(|axis| points.iter().map(|p| p.place[axis]).min().unwrap_or(0));
    for point in &mut points {
        point.place = [0, 1].map(|axis| point.place[axis] - first[axis]);
    }
    points.sort_by_key(|point| (point.place[1], point.place[0]));
    points
}
