//! Light reflected by other parts of the die, at every core of a view.
//!
//! On a smooth face this light changes slowly, the more slowly the farther its source faces are. So many paths are followed from
//! a few places, which are denser where other faces are close, and the cores between take their mean (irradiance caching: Ward,
//! Rubinstein and Clear 1988). A few paths from every core would have to be averaged over neighbours to be useful, and the
//! fringes of single paths would remain as patches although in reality they wash out.

use super::lamp::Lamp;
use super::microfacet;
use super::random::{Purpose, stream};
use super::scene::{LANES, Lanes};
use super::transport::{START_MM, Spot, Transport, spread};
use rayon::prelude::*;
use std::collections::HashMap;

/// Number of light paths from each place.
const WAYS: u32 = 256;
/// Number of paths that estimate the distance of other faces.
const FEELERS: usize = 16;
/// Spacing of places: square of the (harmonic mean) distance to the visible parts of the die, divided by this, mm. Not
/// proportional to the distance, because fringes of a close face are still fringes on this one, and wash out with distance ...
const OPEN_MM: f64 = 20.0;
/// ... within these limits, mm. A core covers 0.03 mm.
const SPACING_MM: [f64; 2] = [0.03, 0.2];
/// A core uses places up to this many spacings away.
const REACH_SPACINGS: f64 = 2.0;
/// Smallest cosine between the normals of two points of the same face.
const SAME_FACE_COS: f64 = 0.99;

/// Light reflected at least once more on its way to each spot's eye; `None` without a spot.
pub(crate) fn light(
    transport: &Transport<'_>,
    lamp: &impl Lamp,
    spots: &[Option<Spot>],
    seed: u64,
) -> Vec<Lanes> {
    let spacings_mm: Vec<f64> = spots
        .par_iter()
        .with_min_len(512)
        .map(|spot| spot.map_or(0.0, |spot| spacing_mm(transport, &spot)))
        .collect();
    let places = Places::chosen(spots, spacings_mm);
    let fans: Vec<Lanes> = places
        .chosen
        .par_iter()
        .with_min_len(16)
        .map(|place| {
            let mut random = stream(seed, Purpose::Paths(place.core));
            transport.indirect(lamp, &place.spot, WAYS, &mut random)
        })
        .collect();
    (0..spots.len())
        .into_par_iter()
        .with_min_len(512)
        .map(|core| spots[core].map_or([0.0; LANES], |spot| places.mean(core, &spot, &fans)))
        .collect()
}

/// Distance from a spot within which the reflected light is nearly constant, mm.
fn spacing_mm(transport: &Transport<'_>, spot: &Spot) -> f64 {
    let nearness = |way| {
        let towards = microfacet::by_cosine(&spot.normal, way);
        let start = spot.point + START_MM * spot.normal;
        let hit = transport.rays.nearest(start, towards);
        hit.map_or(0.0, |hit| 1.0 / hit.distance)
    };
    let ways = spread([0.5; 2]).take(FEELERS);
    let mean = ways.map(nearness).sum::<f64>() / FEELERS as f64;
    let [least, most] = SPACING_MM;
    ((1.0 / mean).powi(2) / OPEN_MM).clamp(least, most)
}

/// Spots that many light paths are followed from.
struct Places {
    chosen: Vec<Place>,
    /// Spacing about every spot, mm.
    spacings_mm: Vec<f64>,
    /// Indices into `chosen` by cell of space.
    boxes: HashMap<[i32; 3], Vec<u32>>,
}

struct Place {
    spot: Spot,
    core: u32,
    spacing_mm: f64,
}

impl Places {
    /// Chooses spots such that every other one has a place on its own face within its spacing and that of the place.
    fn chosen(spots: &[Option<Spot>], spacings_mm: Vec<f64>) -> Self {
        let mut places = Self {
            chosen: Vec::new(),
            spacings_mm,
            boxes: HashMap::new(),
        };
        for (core, spot) in spots.iter().enumerate() {
            let Some(spot) = *spot else { continue };
            let mut near = places.near(core, &spot);
            if near.any(|(_, ratio)| ratio < 1.0) {
                continue;
            }
            drop(near);
            let number = places.chosen.len() as u32;
            places.boxes.entry(box_of(&spot)).or_default().push(number);
            places.chosen.push(Place {
                spot,
                core: core as u32,
                spacing_mm: places.spacings_mm[core],
            });
        }
        places
    }

    /// Places within reach of a spot, and their distances in spacings.
    fn near(&self, core: usize, spot: &Spot) -> impl Iterator<Item = (usize, f64)> {
        let [x, y, z] = box_of(spot);
        let boxes = (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        let own_mm = self.spacings_mm[core];
        let (point, normal) = (spot.point, spot.normal);
        boxes
            .filter_map(|key| self.boxes.get(&key))
            .flatten()
            .filter_map(move |&number| {
                let place = &self.chosen[number as usize];
                let away_mm = (place.spot.point - point).norm();
                let spacings = away_mm / own_mm.min(place.spacing_mm);
                let same = place.spot.normal.dot(&normal) > SAME_FACE_COS;
                (same && spacings < REACH_SPACINGS).then_some((number as usize, spacings))
            })
    }

    /// Mean of the light of the places within reach, with larger weights for nearer ones.
    fn mean(&self, core: usize, spot: &Spot, fans: &[Lanes]) -> Lanes {
        let mut sum = [0f32; LANES];
        let mut weights = 0f32;
        for (number, spacings) in self.near(core, spot) {
            let weight = (1.0 - spacings / REACH_SPACINGS).powi(2) as f32;
            weights += weight;
            for (all, lane) in sum.iter_mut().zip(fans[number]) {
                *all += weight * lane;
            }
        }
        sum.map(|lane| lane / weights)
    }
}

/// The cell of a spot; everything within reach lies in this cell or its neighbours.
fn box_of(spot: &Spot) -> [i32; 3] {
    let width_mm = REACH_SPACINGS * SPACING_MM[1];
    [0, 1, 2].map(|axis| (spot.point[axis] / width_mm).floor() as i32)
}
