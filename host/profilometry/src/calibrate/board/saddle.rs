//! Crossings of a checkerboard: saddle points of brightness.
//!
//! Between four squares the determinant of the brightness' second derivatives is negative. On a circle about such a place brightness has
//! two periods (Bennett and Lasenby 2014, ChESS), whose phase says where white lies: neighbouring crossings differ by half a period.
//! To fractions of a pixel the crossing is where all gradients about it point past it (Förstner and Gülch 1987).

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

use super::image::Grey;
use super::lattice::{ACROSS, Candidate};

/// Least difference of white and black, as part of the mean there, and in counts.
const LEAST_CONTRAST: f64 = 0.15;
const LEAST_COUNTS: f64 = 2.0;
/// Circle about a candidate, in sigmas of the blur, and samples of it.
const CIRCLE: f64 = 2.5;
const SAMPLES: usize = 32;
/// The two periods on the circle exceed one and three by this.
const LEAST_TWOFOLD: f64 = 1.5;
/// Radius of the window of gradients, in distances of crossings: neighbouring edges stay outside.
const REACH: f64 = 0.3;
const REACH_LIMITS_PX: [f64; 2] = [3.0, 30.0];
const GRADIENT_SIGMA_PX: f64 = 1.0;
const ROUNDS: usize = 20;
const SETTLED_PX: f64 = 1e-3;

/// Places that may be crossings, after a blur of `sigma_px`.
pub(super) fn candidates(image: &Grey, sigma_px: f64) -> Vec<Candidate> {
    let smooth = image.blurred(sigma_px);
    let level = image.blurred(4.0 * sigma_px);
    let margin = (CIRCLE * sigma_px).ceil() as usize + 2;
    let (columns, rows) = (image.columns, image.rows);
    if columns <= 2 * margin || rows <= 2 * margin {
        return Vec::new();
    }
    let second = |column: usize, row: usize| {
        let at = |dx: usize, dy: usize| smooth.at(column + dx - 1, row + dy - 1);
        let middle = at(1, 1);
        let xx = at(0, 1) - 2.0 * middle + at(2, 1);
        let yy = at(1, 0) - 2.0 * middle + at(1, 2);
        let xy = 0.25 * (at(0, 0) + at(2, 2) - at(0, 2) - at(2, 0));
        [xx, xy, yy]
    };
    let mut strength = vec![0f32; columns * rows];
    strength
        .par_chunks_mut(columns)
        .enumerate()
        .skip(1)
        .take(rows - 2)
        .for_each(|(row, line)| {
            for (column, value) in line.iter_mut().enumerate().take(columns - 1).skip(1) {
                let [xx, xy, yy] = second(column, row);
                *value = (xy * xy - xx * yy).max(0.0) as f32;
            }
        });
    let reach = (sigma_px.ceil() as usize + 1).max(2);
    let strongest = |column: usize, row: usize| {
        let own = strength[row * columns + column];
        let near = (row - reach..=row + reach)
            .flat_map(|y| (column - reach..=column + reach).map(move |x| (x, y)));
        near.filter(|&place| place != (column, row)).all(|(x, y)| {
            let other = strength[y * columns + x];
            // Of equal neighbours the first in reading order is the peak.
            other < own || other == own && (y, x) > (row, column)
        })
    };
    let margin = margin.max(reach);
    let of_row = |row: usize| {
        let found = (margin..columns - margin).filter_map(|column| {
            // Between ideal squares that differ by c, blurred by s, the determinant is -(c / (pi s^2))^2.
            let own = f64::from(strength[row * columns + column]).sqrt();
            let contrast = own * PI * sigma_px * sigma_px;
            let least = (LEAST_CONTRAST * level.at(column, row)).max(LEAST_COUNTS);
            let worth = contrast >= least && strongest(column, row);
            worth.then(|| candidate(&smooth, [column, row], sigma_px, second(column, row)))?
        });
        found.collect::<Vec<_>>()
    };
    let found: Vec<Vec<Candidate>> = (margin..rows - margin)
        .into_par_iter()
        .map(of_row)
        .collect();
    found.into_iter().flatten().collect()
}

/// The candidate at a pixel, if brightness has two periods about it.
fn candidate(
    smooth: &Grey,
    [column, row]: [usize; 2],
    sigma_px: f64,
    [xx, xy, yy]: [f64; 3],
) -> Option<Candidate> {
    let at_px = [column as f64, row as f64];
    let white = white(smooth, at_px, CIRCLE * sigma_px)?;
    // Along the edges the second derivative vanishes: xx c^2 + 2 xy c s + yy s^2 = 0.
    let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let swing = half.hypot(xy);
    let (middle, off) = (xy.atan2(half), (-mean / swing).acos());
    let edges = [middle + off, middle - off].map(|double| {
        let (sin, cos) = (0.5 * double).sin_cos();
        [cos, sin]
    });
    Some(Candidate {
        at_px,
        white: Some(white),
        edges: edges
            .iter()
            .flatten()
            .all(|x| x.is_finite())
            .then_some(edges),
    })
}

/// Direction of the white squares (cosine and sine of twice the angle), if brightness has two periods on a circle of `reach` pixels.
fn white(smooth: &Grey, at_px: [f64; 2], reach: f64) -> Option<[f64; 2]> {
    let mut waves = [[0.0; 2]; 5];
    for sample in 0..SAMPLES {
        let angle = TAU * sample as f64 / SAMPLES as f64;
        let (sin, cos) = angle.sin_cos();
        let value = smooth.between([at_px[0] + reach * cos, at_px[1] + reach * sin])?;
        for (order, wave) in waves.iter_mut().enumerate() {
            let (sin, cos) = (order as f64 * angle).sin_cos();
            wave[0] += value * cos;
            wave[1] += value * sin;
        }
    }
    let [mean, one, two, three, four] = waves.map(|[re, im]| f64::hypot(re, im));
    // Between ideal squares that differ by c the wave has the amplitude 2 c / pi, half of which each sample adds.
    let least = (LEAST_CONTRAST * mean).max(LEAST_COUNTS * SAMPLES as f64) / PI;
    let twofold = two >= LEAST_TWOFOLD * one.max(three) && two >= four && two >= 0.5 * least;
    twofold.then(|| waves[2].map(|part| part / two))
}

/// Slopes of a slightly smoothed image, in which crossings are found to fractions of a pixel.
pub(super) struct Slopes(Grey);

impl Slopes {
    pub fn new(image: &Grey) -> Self {
        Self(image.blurred(GRADIENT_SIGMA_PX))
    }

    /// Whether a crossing lies at `at_px` whose white squares are turned by 90° against those of its neighbour, as on a checkerboard.
    pub fn is_crossing(&self, at_px: [f64; 2], spacing_px: f64, neighbour_px: [f64; 2]) -> bool {
        let white = |at| white(&self.0, at, REACH * spacing_px);
        match (white(at_px), white(neighbour_px)) {
            (Some(own), Some(other)) => own[0] * other[0] + own[1] * other[1] < ACROSS,
            _ => false,
        }
    }

    /// The crossing near a place, with neighbours `spacing_px` away; `None` if it runs away.
    pub fn crossing(&self, near_px: [f64; 2], spacing_px: f64) -> Option<[f64; 2]> {
        let [least, most] = REACH_LIMITS_PX;
        let reach = (REACH * spacing_px).clamp(least, most);
        let image = &self.0;
        let mut at = Vector2::from(near_px);
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
            for [column, row] in image.about(at.into(), reach, 1) {
                let slope = Vector2::new(
                    image.at(column + 1, row) - image.at(column - 1, row),
                    image.at(column, row + 1) - image.at(column, row - 1),
                );
                let away = Vector2::new(column as f64, row as f64) - at;
                let weight = (-2.0 * away.norm_squared() / (reach * reach)).exp();
                let part = weight * slope * slope.transpose();
                normal += part;
                right += part * away;
            }
            let step = normal.try_inverse()? * right;
            at += step;
            let wandered = (at - Vector2::from(near_px)).norm();
            // Written so that a NaN ends it.
            if !(wandered <= 0.5 * reach) {
                return None;
            }
            if step.norm() < SETTLED_PX {
                return Some(at.into());
            }
        }
        None
    }
}
