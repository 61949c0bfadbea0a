//! Dark dots on a white plate, as the cells of a view see them: centres to hundredths of a pixel.
//!
//! The cells of a fibre bundle are few and lie irregularly (a dot covers some fifty), so a centre of gravity would carry
//! their pattern. Instead the image of a dot, an ellipse with a soft rim on evenly rising white, is fitted to them.

use flankscope_foundation::order::{SIGMA_PER_MAD, quantile};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};
use rayon::prelude::*;
use std::collections::HashMap;

use super::least_squares::{Normal, Problem, SETTLED, minimise};
use crate::cells::DisjointSets;
use crate::cells::buckets::Buckets;
use crate::cloud::CellColumn;

/// One dot in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Dot {
    /// Centre of its elliptic image: column, row.
    pub centre_px: [f64; 2],
    /// Radius of the circle of the same area.
    pub radius_px: f64,
    /// Projector column that lights the centre.
    pub column_px: f64,
}

/// Approximate size of dots in the image, px.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    /// From dot to dot.
    pub pitch_px: f64,
    /// Radius of an ordinary dot.
    pub radius_px: f64,
}

/// A cell that gets less light from the blank plate than this part of the median sees past the lighted field.
const LEAST_FLAT: f64 = 0.15;
/// Print reflects at most this part of white, or it is none.
const PRINT_RATIO: f64 = 0.75;
/// A dot's image is fitted this far from its centre, in its own radii.
const REACH: f64 = 1.7;
/// Softness of the rim, logistic scale in units of the distance between cells.
const RIM_SOFTNESS: f64 = 0.25;
/// A dot at the edge of the field lacks cells around it.
const LEAST_SURROUNDED: f64 = 0.93;
/// The fringe at a dot's centre is smoothed over this part of the dots' pitch.
const FRINGE_REACH: f64 = 0.7;
/// Part of the cells there that must have a column.
const LEAST_FRINGED: f64 = 0.6;

/// Every complete dot. `flat` is the light that each cell gets from the blank plate.
pub(crate) fn find(cells: &[CellColumn], flat_e: &[f64], scale: Scale) -> Vec<Dot> {
    let Some(image) = Image::new(cells, flat_e, scale) else {
        return Vec::new();
    };
    image
        .blobs(scale)
        .into_par_iter()
        .filter_map(|blob| image.dot(&blob, scale))
        .collect()
}

/// The lit cells: where, how bright relative to the blank plate, and by which column.
struct Image {
    places: Vec<[f64; 2]>,
    ratios: Vec<f64>,
    columns: Vec<Option<f64>>,
    near: Buckets,
    per_px2: f64,
}

/// Dark cells that hang together.
struct Blob {
    centre_px: [f64; 2],
    radius_px: f64,
    white: f64,
    black: f64,
}

impl Image {
    fn new(cells: &[CellColumn], flat_e: &[f64], scale: Scale) -> Option<Self> {
        let mut levels: Vec<f64> = flat_e.iter().copied().filter(|e| e.is_finite()).collect();
        let least_e = LEAST_FLAT * quantile(&mut levels, 0.5)?;
        let (mut places, mut ratios, mut columns) = (Vec::new(), Vec::new(), Vec::new());
        for (cell, &flat) in cells.iter().zip(flat_e) {
            if flat > least_e && cell.mean_e.is_finite() {
                places.push(cell.pixel);
                ratios.push(cell.mean_e / flat);
                columns.push(cell.column_px);
            }
        }
        if places.len() < 100 {
            return None;
        }
        let near = Buckets::new(&places, scale.pitch_px);
        let area_px2 = std::f64::consts::PI * scale.pitch_px * scale.pitch_px;
        // Around cells in the middle, not at the rim: hence not the median.
        let mut counts: Vec<f64> = (0..200)
            .map(|i| places[i * (places.len() - 1) / 199])
            .map(|at| within(&near, &places, at, scale.pitch_px).count() as f64)
            .collect();
        let per_px2 = quantile(&mut counts, 0.8)? / area_px2;
        (per_px2 > 0.0).then_some(Self {
            places,
            ratios,
            columns,
            near,
            per_px2,
        })
    }

    fn cells_within(&self, at: [f64; 2], reach_px: f64) -> impl Iterator<Item = usize> + '_ {
        within(&self.near, &self.places, at, reach_px)
    }

    /// White and black about each square of one and a half pitches.
    fn levels(&self, side_px: f64) -> HashMap<[i64; 2], [f64; 2]> {
        let mut squares: HashMap<[i64; 2], Vec<f64>> = HashMap::new();
        for (place, &ratio) in self.places.iter().zip(&self.ratios) {
            let square = place.map(|x| (x / side_px).floor() as i64);
            for dx in -1..=1 {
                for dy in -1..=1 {
                    let near = [square[0] + dx, square[1] + dy];
                    squares.entry(near).or_default().push(ratio);
                }
            }
        }
        squares
            .into_iter()
            .filter_map(|(square, mut ratios)| {
                let white = quantile(&mut ratios, 0.75)?;
                let black = quantile(&mut ratios, 0.05)?;
                Some((square, [white, black]))
            })
            .collect()
    }

    fn blobs(&self, scale: Scale) -> Vec<Blob> {
        let side_px = 1.5 * scale.pitch_px;
        let levels = self.levels(side_px);
        let level = |place: [f64; 2]| levels.get(&place.map(|x| (x / side_px).floor() as i64));
        let dark: Vec<usize> = (0..self.places.len())
            .filter(|&cell| {
                level(self.places[cell]).is_some_and(|&[white, black]| {
                    black < PRINT_RATIO * white && self.ratios[cell] < 0.5 * (white + black)
                })
            })
            .collect();
        let places: Vec<[f64; 2]> = dark.iter().map(|&cell| self.places[cell]).collect();
        let step_px = 1.5 / self.per_px2.sqrt();
        let near = Buckets::new(&places, step_px);
        let mut patches = DisjointSets::new(places.len());
        for (index, &place) in places.iter().enumerate() {
            let neighbours: Vec<usize> = within(&near, &places, place, step_px)
                .filter(|&other| other < index)
                .collect();
            for other in neighbours {
                patches.join(index, other);
            }
        }
        let mut sums: HashMap<usize, (f64, [f64; 2])> = HashMap::new();
        for (index, place) in places.iter().enumerate() {
            let sum = sums.entry(patches.root(index)).or_default();
            sum.0 += 1.0;
            sum.1 = [sum.1[0] + place[0], sum.1[1] + place[1]];
        }
        let usual = self.per_px2 * std::f64::consts::PI * scale.radius_px * scale.radius_px;
        let mut blobs: Vec<Blob> = sums
            .into_values()
            .filter(|(count, _)| (0.5 * usual..4.0 * usual).contains(count))
            .filter_map(|(count, sum)| {
                let centre_px = sum.map(|s| s / count);
                let &[white, black] = level(centre_px)?;
                Some(Blob {
                    centre_px,
                    radius_px: (count / (self.per_px2 * std::f64::consts::PI)).sqrt(),
                    white,
                    black,
                })
            })
            .collect();
        // Hash maps have no order; results must have one.
        blobs.sort_by(|a, b| {
            let key = |blob: &Blob| (blob.centre_px[1], blob.centre_px[0]);
            let (a, b) = (key(a), key(b));
            a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
        });
        blobs
    }

    fn dot(&self, blob: &Blob, scale: Scale) -> Option<Dot> {
        let reach_px = REACH * blob.radius_px;
        let cells: Vec<usize> = self.cells_within(blob.centre_px, reach_px).collect();
        let whole = self.per_px2 * std::f64::consts::PI * reach_px * reach_px;
        if (cells.len() as f64) < LEAST_SURROUNDED * whole {
            return None;
        }
        let offset = |cell: &usize| {
            let place = self.places[*cell];
            [0, 1].map(|axis| (place[axis] - blob.centre_px[axis]) / blob.radius_px)
        };
        let rim = Rim {
            offsets: cells.iter().map(offset).collect(),
            ratios: cells.iter().map(|&cell| self.ratios[cell]).collect(),
            sharpness: blob.radius_px * self.per_px2.sqrt() / RIM_SOFTNESS,
            shape: [
                0.0,
                0.0,
                1.0,
                0.0,
                1.0,
                blob.white,
                blob.white - blob.black,
                0.0,
                0.0,
            ],
        };
        let [x, y, a, b, c, ..] = minimise(rim, 30, SETTLED).ok()?.state.shape;
        let determinant = a * c - b * b;
        if !(x.hypot(y) < 0.5 && determinant > 0.2 && determinant < 5.0) {
            return None;
        }
        let centre_px = [
            blob.centre_px[0] + blob.radius_px * x,
            blob.centre_px[1] + blob.radius_px * y,
        ];
        Some(Dot {
            centre_px,
            radius_px: blob.radius_px / determinant.powf(0.25),
            column_px: self.column_at(centre_px, FRINGE_REACH * scale.pitch_px)?,
        })
    }

    /// The projector column at a place: a quadratic over the cells around, without those of a wrong fringe.
    fn column_at(&self, at: [f64; 2], reach_px: f64) -> Option<f64> {
        let whole = self.per_px2 * std::f64::consts::PI * reach_px * reach_px;
        let mut kept: Vec<([f64; 2], f64)> = self
            .cells_within(at, reach_px)
            .filter_map(|cell| {
                let place = self.places[cell];
                let offset = [0, 1].map(|axis| (place[axis] - at[axis]) / reach_px);
                Some((offset, self.columns[cell]?))
            })
            .collect();
        for round in 0..3 {
            if (kept.len() as f64) < LEAST_FRINGED * whole {
                return None;
            }
            let (mut matrix, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SVector::zeros());
            for &(offset, column) in &kept {
                matrix += quadratic(offset) * quadratic(offset).transpose();
                right += quadratic(offset) * column;
            }
            let solution = matrix.cholesky()?.solve(&right);
            if round == 2 {
                return Some(solution[0]);
            }
            let off = |&(offset, column): &([f64; 2], f64)| {
                (quadratic(offset).dot(&solution) - column).abs()
            };
            let mut errors: Vec<f64> = kept.iter().map(off).collect();
            // Median absolute deviation to standard deviation, times four.
            let limit = 4.0 * SIGMA_PER_MAD * quantile(&mut errors, 0.5)?;
            kept.retain(|cell| off(cell) <= limit);
        }
        None
    }
}

fn quadratic([x, y]: [f64; 2]) -> SVector<f64, 6> {
    SVector::from([1.0, x, y, x * x, x * y, y * y])
}

fn within<'a>(
    near: &'a Buckets,
    places: &'a [[f64; 2]],
    at: [f64; 2],
    reach_px: f64,
) -> impl Iterator<Item = usize> + 'a {
    near.near(at).filter(move |&index| {
        let [x, y] = places[index];
        (x - at[0]).powi(2) + (y - at[1]).powi(2) <= reach_px * reach_px
    })
}

/// An ellipse with a soft rim on white that rises evenly. Offsets in radii of the blob.
#[derive(Clone)]
struct Rim {
    offsets: Vec<[f64; 2]>,
    ratios: Vec<f64>,
    sharpness: f64,
    /// Centre x, y; quadratic form a, b, c (the rim is where it is 1); white, white minus black, slopes of white.
    shape: [f64; 9],
}

impl Rim {
    /// Residual of a cell and its derivatives by the shape.
    fn residual(&self, cell: usize) -> (f64, [f64; 9]) {
        let [cx, cy, a, b, c, white, depth, gx, gy] = self.shape;
        let [px, py] = self.offsets[cell];
        let (x, y) = (px - cx, py - cy);
        // Far inside or outside the rim nothing changes; the root has no slope at the centre.
        let q = (a * x * x + 2.0 * b * x * y + c * y * y).max(1e-6).sqrt();
        let inside = 1.0 / (1.0 + (-self.sharpness * (1.0 - q)).exp());
        let slope = -self.sharpness * inside * (1.0 - inside);
        let plane = white + gx * px + gy * py;
        let value = plane - depth * inside;
        let by_q = -depth * slope / (2.0 * q);
        (
            value - self.ratios[cell],
            [
                by_q * -2.0 * (a * x + b * y),
                by_q * -2.0 * (b * x + c * y),
                by_q * x * x,
                by_q * 2.0 * x * y,
                by_q * y * y,
                1.0,
                -inside,
                px,
                py,
            ],
        )
    }
}

impl Problem for Rim {
    fn normal(&self) -> Normal {
        let (mut cost, mut hessian, mut gradient) = (
            0.0,
            SMatrix::<f64, 9, 9>::zeros(),
            SVector::<f64, 9>::zeros(),
        );
        for cell in 0..self.ratios.len() {
            let (residual, derivatives) = self.residual(cell);
            let row = SVector::from(derivatives);
            cost += residual * residual;
            gradient += residual * row;
            hessian += row * row.transpose();
        }
        Normal {
            cost,
            hessian: DMatrix::from_column_slice(9, 9, hessian.as_slice()),
            gradient: DVector::from_column_slice(gradient.as_slice()),
        }
    }

    fn stepped(&self, step: &DVector<f64>) -> (Self, f64) {
        let mut next = self.clone();
        for (shape, by) in next.shape.iter_mut().zip(step.iter()) {
            *shape += by;
        }
        let cost = (0..next.ratios.len())
            .map(|cell| next.residual(cell).0.powi(2))
            .sum();
        (next, cost)
    }
}
