//! True values of judged zones: the exact distance between die and drawing.
//!
//! A zone is sampled on a fine grid. From every sample, the die's surface is searched along the flank's normal; the distance of
//! the point found from the drawing's facets of that flank is the deviation there, positive for proud material. The distance is
//! computed without the instrument's code: another hierarchy (obvhs), and the nearest point of a triangle in closed form.

use std::collections::BTreeMap;

use flankscope_gear_cad::{GearSpec, Mesh};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::world::{FlankId, RayCaster, World, flank_of_facet};

/// Spacing of samples along profile and height, mm, unless there are too many.
const SAMPLE_MM: f64 = 0.02;
/// Largest number of samples of all flanks, which take about a second.
const MAX_SAMPLES: f64 = 1.6e6;
/// Range of the search for the die's surface, mm; at most three tenths of a base pitch, where the neighbouring flank begins.
const REACH_MM: f64 = 1.0;
const REACH_PITCHES: f64 = 0.3;
/// Tolerance for the distance of a flank's facets from its involute, mm: profile corrections are smaller.
const ON_FLANK_MM: f64 = 0.15;
/// Smallest fraction of a disc on which the die's surface must be found.
const LEAST_DISC_SHARE: f64 = 0.5;

/// The judged zone: the same rectangle on some flanks of a drawing.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Facets of the drawing, mm.
    pub cad: Mesh,
    pub gear: GearSpec,
    pub flanks: Vec<FlankId>,
    /// Smallest and largest radius, mm.
    pub radius_mm: [f64; 2],
    /// Smallest and largest height, mm.
    pub height_mm: [f64; 2],
    /// Area of the disc over which the loss is averaged, mm².
    pub disc_area_mm2: f64,
}

/// Deviations of the die from its drawing within one zone; absent if the die's surface was not found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ZoneTruth {
    /// Largest mean loss over any disc of the area that lies in the zone, µm.
    pub max_disc_wear_um: Option<f64>,
    /// Largest mean height of proud material over any such disc, µm.
    pub max_disc_proud_um: Option<f64>,
    /// Mean loss, µm.
    pub zone_mean_wear_um: Option<f64>,
    /// Largest loss of any sample, µm.
    pub zone_max_wear_um: Option<f64>,
    /// Fraction of the zone without a surface near the drawing.
    pub missing_ratio: f64,
}

/// Compares the die in `world` with the drawing, flank by flank.
#[must_use]
pub fn compare(world: &World, judged: &Judged) -> BTreeMap<FlankId, ZoneTruth> {
    let grid = Grid::new(judged);
    let drawn = drawn_flanks(judged);
    let of_flank = |&id: &FlankId| {
        let deviations_mm = match drawn.get(&id) {
            Some(facets) => grid.deviations_mm(world, judged, id, facets),
            None => vec![None; grid.count[0] * grid.count[1]],
        };
        (id, grid.summed_up(&deviations_mm, judged.disc_area_mm2))
    };
    judged.flanks.iter().map(of_flank).collect()
}

/// The drawing's facets of every judged flank.
fn drawn_flanks(judged: &Judged) -> BTreeMap<FlankId, RayCaster> {
    let mut flanks: BTreeMap<FlankId, Mesh> = BTreeMap::new();
    for triangle in &judged.cad.triangles {
        let facet = triangle.map(|v| judged.cad.vertices[v as usize]);
        if let Some(id) = flank_of_facet(&judged.gear, facet, ON_FLANK_MM)
            && judged.flanks.contains(&id)
        {
            let flank = flanks.entry(id).or_default();
            let first = flank.vertices.len() as u32;
            flank.vertices.extend(facet);
            flank.triangles.push([first, first + 1, first + 2]);
        }
    }
    let caster = |(id, flank): (FlankId, Mesh)| (id, RayCaster::new(&flank));
    flanks.into_iter().map(caster).collect()
}

/// Cells of a zone: profile length by height. An involute surface unrolls into its length without stretching.
struct Grid {
    /// Number along the profile and along the height.
    count: [usize; 2],
    step_mm: [f64; 2],
    /// Profile length and height of the corner of the first cell.
    from_mm: [f64; 2],
}

impl Grid {
    fn new(judged: &Judged) -> Self {
        let base = judged.gear.base_radius_mm();
        let profile_mm = judged
            .radius_mm
            .map(|r| (r * r - base * base).max(0.0) / (2.0 * base));
        let size_mm = [
            profile_mm[1] - profile_mm[0],
            judged.height_mm[1] - judged.height_mm[0],
        ];
        let samples = judged.flanks.len() as f64 * size_mm[0] * size_mm[1] / SAMPLE_MM.powi(2);
        let sample_mm = SAMPLE_MM * (samples / MAX_SAMPLES).sqrt().max(1.0);
        let count = size_mm.map(|mm| (mm / sample_mm).ceil().max(1.0) as usize);
        Self {
            count,
            step_mm: [0, 1].map(|k| size_mm[k] / count[k] as f64),
            from_mm: [profile_mm[0], judged.height_mm[0]],
        }
    }

    /// Deviation at the centre of every cell, row by row along the height, mm.
    fn deviations_mm(
        &self,
        world: &World,
        judged: &Judged,
        id: FlankId,
        facets: &RayCaster,
    ) -> Vec<Option<f64>> {
        let gear = &judged.gear;
        let base = gear.base_radius_mm();
        let reach_mm = REACH_MM.min(REACH_PITCHES * base * gear.pitch_angle_rad());
        let deviation = |cell: usize| {
            let at = |k: usize, i: usize| self.from_mm[k] + (i as f64 + 0.5) * self.step_mm[k];
            let (profile, height) = (at(0, cell % self.count[0]), at(1, cell / self.count[0]));
            let radius = (base * base + 2.0 * base * profile).sqrt();
            let (sin, cos) = gear.flank_angle_rad(id.tooth, id.flank, radius).sin_cos();
            let [nx, ny] = gear.flank_normal(id.tooth, id.flank, radius);
            let normal = Vector3::new(nx, ny, 0.0);
            let drawn = Point3::new(radius * cos, radius * sin, height);
            let found = drawn + world.surface_along_mm(drawn, normal, reach_mm)? * normal;
            let off = found - facets.nearest_point(found)?;
            Some(off.norm().copysign(off.dot(&normal)))
        };
        (0..self.count[0] * self.count[1])
            .into_par_iter()
            .with_min_len(256)
            .map(deviation)
            .collect()
    }

    fn summed_up(&self, deviations_mm: &[Option<f64>], disc_area_mm2: f64) -> ZoneTruth {
        let found: Vec<f64> = deviations_mm.iter().flatten().copied().collect();
        // Subtracting from 0.0 avoids minus zero.
        let loss_um = |mm: f64| 0.0 - 1e3 * mm;
        let missing = deviations_mm.len() - found.len();
        let discs = self.disc_means_mm(deviations_mm, disc_area_mm2);
        ZoneTruth {
            max_disc_wear_um: discs.map(|[least, _]| loss_um(least)),
            max_disc_proud_um: discs.map(|[_, most]| 1e3 * most),
            zone_mean_wear_um: (!found.is_empty())
                .then(|| loss_um(found.iter().sum::<f64>() / found.len() as f64)),
            zone_max_wear_um: found.iter().copied().reduce(f64::min).map(loss_um),
            missing_ratio: missing as f64 / deviations_mm.len() as f64,
        }
    }

    /// Smallest and largest mean over all discs around cells that lie completely in the zone, mm; `None` if there is no such
    /// disc, or the surface is missing.
    fn disc_means_mm(&self, deviations_mm: &[Option<f64>], area_mm2: f64) -> Option<[f64; 2]> {
        let radius_mm = (area_mm2 / std::f64::consts::PI).sqrt();
        let [columns, rows] = self.count;
        // Smallest margin between a disc's centre and the zone's rim.
        let margin = self
            .step_mm
            .map(|step| (radius_mm / step - 0.5).ceil().max(0.0) as usize);
        if columns <= 2 * margin[0] || rows <= 2 * margin[1] {
            return None;
        }
        // Half the disc's width in every row, in cells.
        let reach = (radius_mm / self.step_mm[1]).floor() as usize;
        let half_widths: Vec<usize> = (0..=reach)
            .map(|row| {
                let across = radius_mm.powi(2) - (row as f64 * self.step_mm[1]).powi(2);
                (across.max(0.0).sqrt() / self.step_mm[0]).floor() as usize
            })
            .collect();
        let cells: usize = half_widths
            .iter()
            .enumerate()
            .map(|(row, half)| (2 * half + 1) * if row == 0 { 1 } else { 2 })
            .sum();
        // Cumulative sums of every row: the sum between two columns is a difference.
        let mut sums = Vec::with_capacity(rows * (columns + 1));
        for row in deviations_mm.chunks_exact(columns) {
            let mut sum = (0.0, 0usize);
            sums.push(sum);
            for value in row {
                sum = (
                    sum.0 + value.unwrap_or(0.0),
                    sum.1 + usize::from(value.is_some()),
                );
                sums.push(sum);
            }
        }
        let disc = |column: usize, row: usize| {
            let mut total = (0.0, 0usize);
            for y in row - reach.min(row)..=(row + reach).min(rows - 1) {
                let half = half_widths[y.abs_diff(row)];
                let line = y * (columns + 1);
                let (from, to) = (sums[line + column - half], sums[line + column + half + 1]);
                total = (total.0 + to.0 - from.0, total.1 + to.1 - from.1);
            }
            (total.1 as f64 >= LEAST_DISC_SHARE * cells as f64).then(|| total.0 / total.1 as f64)
        };
        (margin[1]..rows - margin[1])
            .into_par_iter()
            .flat_map_iter(|row| {
                (margin[0]..columns - margin[0]).filter_map(move |column| disc(column, row))
            })
            .map(|mean| [mean, mean])
            .reduce_with(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }
}
