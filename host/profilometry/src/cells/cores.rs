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
        let reach = (0.5 * BOX_PX as f64 * std::f64::consts::SQRT_2 + 3.5 * map.core_sigma_px)
            .max(RING_PITCH * pitch_px);
        let buckets = Buckets::new(&map.positions_px, reach);
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
            for other in buckets.near(map.positions_px[core]) {
                let at = map.positions_px[other];
                let light = f64::from(map.gains[other])
                    * caught(left, at[0], map.core_sigma_px)
                    * caught(top, at[1], map.core_sigma_px);
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
                let near = (place[0] - at[0]).hypot(place[1] - at[1]) < RING_PITCH * pitch_px;
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

/// The part of a Gaussian image about `centre` that falls on the box's pixels along one axis, but for a constant.
fn caught(first: usize, centre: f64, sigma: f64) -> f64 {
    (first..first + BOX_PX)
        .map(|pixel| (-0.5 * ((pixel as f64 - centre) / sigma).powi(2)).exp())
        .sum()
}
