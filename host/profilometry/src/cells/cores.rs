//! One cell per core of a fibre bundle: a box of 3 x 3 pixels about its centre.
//!
//! A pixel inside a core sees that core's one phase, wherever in the core it lies: triangulated along the pixel's own
//! ray it makes a staircase. So a flat-field capture is searched for the cores ([`crate::calibrate::cores::find`]), the
//! result is kept beside the head's file ([`CoreMap`]), and views are summed core by core and triangulated along the
//! cores' rays.

use rayon::prelude::*;

use super::buckets::Buckets;
use crate::head::{CoreMap, ImageCircle};

/// Pixels along the side of a core's box: most of its own light, little of its neighbours'.
pub const BOX_PX: usize = 3;

/// Cores as cells, sorted by the first row and column of their boxes.
#[derive(Clone, Debug)]
pub struct CoreGrid {
    /// First pixel column of each box.
    pub(crate) left_px: Vec<u16>,
    /// First cell of each image row, by the first row of the boxes, and the number of cells as a last entry.
    starts: Vec<u32>,
    /// Mean position of a box's light: column, row of the camera.
    seen_px: Vec<[f64; 2]>,
    /// Cells of neighbouring cores with smaller numbers.
    earlier_neighbours: Vec<[u32; 6]>,
    pitch_px: f64,
}

/// No neighbour.
const NONE: u32 = u32::MAX;
/// The ring of six lies within this many pitches, the next one beyond.
const RING_PITCH: f64 = 1.45;

impl CoreGrid {
    /// Cores whose boxes lie on the sensor and whose centres lie in the circle.
    ///
    /// A box also catches its neighbours' light. For fringes that are nearly straight from core to core the sum has the
    /// phase at the brightness-weighted mean position, so that position, from the map, is taken as the box's.
    pub fn new(map: &CoreMap, circle: Option<&ImageCircle>) -> Self {
        let pitch_px = map.pitch_px().unwrap_or(BOX_PX as f64);
        let ring_px = RING_PITCH * pitch_px;
        let caught = Caught::new(map.core_sigma_px);
        let buckets = Buckets::new(&map.positions_px, (caught.reach_px + 0.5).max(ring_px));
        let (width, height) = (map.width_px as usize, map.height_px as usize);
        let corner = |at: f64, size: usize| {
            let first = at.round() - (BOX_PX / 2) as f64;
            (first >= 0.0 && first as usize + BOX_PX <= size).then_some(first as usize)
        };
        let mut boxes: Vec<(usize, usize, usize)> = map
            .positions_px
            .iter()
            .enumerate()
            .filter(|(_, at)| {
                circle.is_none_or(|circle| {
                    let [x, y] = circle.centre_px;
                    (at[0] - x).hypot(at[1] - y) <= circle.radius_px
                })
            })
            .filter_map(|(core, at)| Some((corner(at[1], height)?, corner(at[0], width)?, core)))
            .collect();
        boxes.sort_unstable();
        let mut starts = vec![0u32; height + 1];
        let mut cell_of = vec![NONE; map.positions_px.len()];
        for (cell, &(top, _, core)) in boxes.iter().enumerate() {
            starts[top + 1] += 1;
            cell_of[core] = cell as u32;
        }
        for row in 0..height {
            starts[row + 1] += starts[row];
        }
        let seen = |&(top, left, core): &(usize, usize, usize)| {
            let (mut sum, mut weight) = ([0.0; 2], 0.0);
            let middle = [left, top].map(|first| (first + BOX_PX / 2) as f64);
            for other in buckets.near(map.positions_px[core]) {
                let at = map.positions_px[other];
                let [x, y] = [at[0] - middle[0], at[1] - middle[1]];
                if x.abs().max(y.abs()) > caught.reach_px {
                    continue;
                }
                let light = f64::from(map.gains[other]) * caught.of(x) * caught.of(y);
                weight += light;
                sum = [sum[0] + light * at[0], sum[1] + light * at[1]];
            }
            sum.map(|sum| sum / weight)
        };
        let neighbours = |(cell, &(_, _, core)): (usize, &(usize, usize, usize))| {
            let at = map.positions_px[core];
            let mut ring = [NONE; 6];
            let mut found = 0;
            for other in buckets.near(at) {
                let place = map.positions_px[other];
                let squared = (place[0] - at[0]).powi(2) + (place[1] - at[1]).powi(2);
                let near = squared < ring_px * ring_px;
                // NONE is larger than any cell.
                if near && (cell_of[other] as usize) < cell && found < ring.len() {
                    ring[found] = cell_of[other];
                    found += 1;
                }
            }
            ring
        };
        Self {
            left_px: boxes.iter().map(|&(_, left, _)| left as u16).collect(),
            starts,
            seen_px: boxes.par_iter().map(seen).collect(),
            earlier_neighbours: boxes.par_iter().enumerate().map(neighbours).collect(),
            pitch_px,
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.left_px.len()
    }

    /// Whether the map has no cores.
    pub fn is_empty(&self) -> bool {
        self.left_px.is_empty()
    }

    /// Image rows in which boxes may begin.
    pub(crate) fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// The cells whose boxes begin in an image row.
    pub(crate) fn cells(&self, row: usize) -> std::ops::Range<usize> {
        self.starts[row] as usize..self.starts[row + 1] as usize
    }

    /// Position of a box's light: column, row of the camera.
    pub fn seen_px(&self) -> &[[f64; 2]] {
        &self.seen_px
    }

    /// Distance between neighbouring cores.
    pub fn pitch_px(&self) -> f64 {
        self.pitch_px
    }

    /// Neighbouring cores with smaller numbers.
    pub(crate) fn earlier_neighbours(&self, cell: usize) -> [Option<usize>; 6] {
        self.earlier_neighbours[cell].map(|other| (other != NONE).then_some(other as usize))
    }
}

/// The part of a core's image that falls on the pixels of a box along one axis, but for a constant.
struct Caught {
    per_px2: f64,
    /// Of a pixel beside the middle one, of a core at the middle.
    beside: f64,
    /// From a box's middle to cores whose light it catches: a pixel and 3.5 standard deviations.
    reach_px: f64,
}

impl Caught {
    fn new(sigma_px: f64) -> Self {
        let per_px2 = 0.5 / (sigma_px * sigma_px);
        Self {
            per_px2,
            beside: (-per_px2).exp(),
            reach_px: (BOX_PX / 2) as f64 + 3.5 * sigma_px,
        }
    }

    /// Of a core so far from the middle pixel of three: `exp(-(d ± 1)²) = exp(-d²) exp(-1) exp(∓2d)`.
    fn of(&self, from_middle_px: f64) -> f64 {
        const { assert!(BOX_PX == 3, "a pixel on either side") };
        let middle = (-self.per_px2 * from_middle_px * from_middle_px).exp();
        let tilt = (2.0 * self.per_px2 * from_middle_px).exp();
        middle * (1.0 + self.beside * (tilt + tilt.recip()))
    }
}
