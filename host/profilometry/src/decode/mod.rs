//! The whole way: from the sums of a view to points in the camera frame.

mod cell;
mod error;
mod options;
mod rays;

use std::sync::Arc;

use rayon::prelude::*;

use crate::accumulate::consistency::{self, FrameNoise};
use crate::accumulate::{Accumulator, Band, Layout};
use crate::cells::{CellGrid, CoreGrid, Grid};
use crate::cloud::small_patches;
use crate::frame::FrameKind;
use crate::head::{DepthRange, HeadModel, Sensor};
use crate::pattern::{FringeSet, PatternSet};
use crate::phase::{mask, smoothing};
use crate::triangulate::Triangulator;

pub use crate::accumulate::consistency::ConsistencyOptions;
pub use crate::cloud::{CellColumn, Cloud, Decoded, PatchOptions, Rejected};
pub use crate::phase::mask::MaskOptions;
use cell::{CellResult, Fate};
pub use error::DecodeError;
pub use options::{DecodeOptions, GridKind};
use rays::{Ray, rays};

/// Everything about a head and its patterns that does not change from view to view.
#[derive(Clone, Debug)]
pub struct Decoder {
    layout: Arc<Layout>,
    patterns: PatternSet,
    options: DecodeOptions,
    size_px: [u32; 2],
    sensor: Sensor,
    triangulator: Triangulator,
    projector_width_px: f64,
    volume: Option<DepthRange>,
    rays: Vec<Ray>,
    /// Largest chi-square by degrees of freedom; empty where it is not tested.
    chi_square_limits: Vec<f32>,
    /// Lateral size of a cell per unit of depth.
    cell_by_depth: f64,
}

impl Decoder {
    /// Checks that head and patterns fit and computes the camera ray of every cell.
    ///
    /// # Errors
    /// [`DecodeError`]: see its variants.
    pub fn new(
        head: &HeadModel,
        patterns: &PatternSet,
        exposures_us: &[u32],
        options: DecodeOptions,
    ) -> Result<Self, DecodeError> {
        head.check().map_err(|bad| DecodeError::Head {
            key: bad.key,
            got: bad.got,
            expected: bad.expected,
        })?;
        options.check()?;
        if !(1..=255).contains(&exposures_us.len()) {
            return Err(DecodeError::ExposureCount {
                got: exposures_us.len(),
            });
        }
        if exposures_us[0] == 0 || exposures_us.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(DecodeError::Exposures {
                got: exposures_us.to_vec(),
            });
        }
        let sensor = head.sensor.ok_or(DecodeError::NoSensor)?;
        let lowest_periods = patterns.sets[0].periods;
        if head.volume.is_none() && lowest_periods > 1.0 {
            return Err(DecodeError::NeedsVolume {
                periods: lowest_periods,
            });
        }
        let (width, height) = (
            head.camera.width_px as usize,
            head.camera.height_px as usize,
        );
        let circle = head.image_circle.as_ref();
        let grid = match options.grid {
            GridKind::Pixel => Grid::Blocks(CellGrid::new(width, height, options.binning, circle)),
            GridKind::Core => {
                let map = head.core_map.as_ref().ok_or(DecodeError::NoCores)?;
                Grid::Cores(CoreGrid::new(map, circle))
            }
        };
        if grid.is_empty() {
            return Err(match options.grid {
                GridKind::Core => DecodeError::NoCores,
                GridKind::Pixel => DecodeError::NoCells {
                    binning: options.binning,
                    width_px: head.camera.width_px,
                    height_px: head.camera.height_px,
                },
            });
        }
        let triangulator = Triangulator::new(head);
        let rays = rays(head, patterns, &grid, &triangulator)?;
        let cell_by_depth = grid.pitch_px() / head.camera.focal_px[0].min(head.camera.focal_px[1]);
        let layout = Layout {
            width,
            height,
            grid,
            steps: patterns.sets.iter().map(|set| set.steps).collect(),
            exposures: exposures_us.len(),
            dark_frame: options.dark_frame,
            saturation_limit_dn: sensor.saturation_limit_dn(),
            noise: None,
        };
        let layout = Layout {
            noise: options
                .consistency
                .map(|gate| frame_noise(&sensor, &layout.grid, gate.response_ratio)),
            ..layout
        };
        let chi_square_limits = options.consistency.map_or(Vec::new(), |gate| {
            let of_set = |set: &FringeSet| set.steps.saturating_sub(3) as usize;
            let most = exposures_us.len() * patterns.sets.iter().map(of_set).sum::<usize>();
            consistency::limits(gate.least_probability, most)
        });
        Ok(Self {
            layout: Arc::new(layout),
            patterns: patterns.clone(),
            options,
            size_px: [head.camera.width_px, head.camera.height_px],
            sensor,
            triangulator,
            projector_width_px: f64::from(head.projector.width_px),
            volume: head.volume,
            rays,
            chi_square_limits,
            cell_by_depth,
        })
    }

    /// Empty sums for one view; reuse them with [`Accumulator::reset`].
    pub fn begin(&self) -> Accumulator {
        Accumulator::new(Arc::clone(&self.layout))
    }

    /// The grid of cells.
    pub fn grid(&self) -> &Grid {
        &self.layout.grid
    }

    /// The frames of a view in capture order.
    pub fn capture_order(&self) -> impl Iterator<Item = FrameKind> + '_ {
        (0..self.layout.planned()).filter_map(|index| self.layout.kind(index))
    }

    /// A mean level that a dark frame stays below and a lit frame exceeds: the offset plus 1 % of full scale.
    pub fn dark_limit_dn(&self) -> f64 {
        self.sensor.offset_dn + 0.01 * (2f64.powi(self.sensor.bits as i32) - 1.0)
    }

    /// Width and height of a frame, px.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// The sensor that frames are of.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// The largest count of the sensor.
    pub fn full_scale_dn(&self) -> u16 {
        self.sensor.full_scale_dn()
    }

    /// Points of a complete view.
    ///
    /// # Errors
    /// [`DecodeError::Incomplete`], [`DecodeError::ForeignAccumulator`]. A view without any point is no error here.
    pub fn finish(&self, accumulator: &Accumulator) -> Result<Decoded, DecodeError> {
        self.admit(accumulator)?;
        let fringes_dn = self
            .options
            .mask
            .map(|options| mask::fringe_deviations_dn(accumulator, options.smoothing_px));
        let (conditioned, variance_ratios) = self.condition(accumulator);
        let mut results = self.depths(
            conditioned.as_ref().unwrap_or(accumulator),
            &variance_ratios,
        );
        if let (Some(options), Some(fringes_dn)) = (&self.options.mask, &fringes_dn) {
            for (result, &deviation_dn) in results.iter_mut().zip(fringes_dn) {
                if f64::from(deviation_dn) < options.threshold_dn && result.fate == Fate::Point {
                    result.reject(Fate::Masked);
                }
            }
        }
        if let Some(options) = &self.options.patches {
            for cell in small_patches(&self.layout.grid, &results, self.cell_by_depth, options) {
                results[cell].reject(Fate::Isolated);
            }
        }
        Ok(self.collect(&results, fringes_dn.as_deref()))
    }

    /// Repaired phasors, if any repair is wanted, and what it did to the variance of each frequency.
    fn condition(&self, accumulator: &Accumulator) -> (Option<Accumulator>, Vec<f64>) {
        let options = &self.options;
        let wanted = options.smoothing_px > 0.0 || options.coarse_smoothing_px > 0.0;
        let Grid::Blocks(grid) = &self.layout.grid else {
            return (None, vec![1.0; self.layout.steps.len()]);
        };
        if !wanted {
            return (None, vec![1.0; self.layout.steps.len()]);
        }
        let mut copy = accumulator.clone();
        let finest = self.layout.steps.len() - 1;
        let binning = grid.binning as f64;
        let sigmas: Vec<f64> = (0..=finest)
            .map(|set| if set == finest { options.smoothing_px } else { options.coarse_smoothing_px } / binning)
            .collect();
        let ratios = smoothing::smooth(&mut copy, grid, &sigmas);
        (Some(copy), ratios)
    }

    fn depths(&self, accumulator: &Accumulator, variance_ratios: &[f64]) -> Vec<CellResult> {
        let mut results = vec![CellResult::rejected(Fate::LowContrast); self.rays.len()];
        let mut rest = results.as_mut_slice();
        let mut parts = Vec::with_capacity(accumulator.bands.len());
        for band in &accumulator.bands {
            let (part, after) = rest.split_at_mut(band.cells);
            parts.push(part);
            rest = after;
        }
        let sigma_ratios: Vec<f64> = variance_ratios.iter().map(|ratio| ratio.sqrt()).collect();
        accumulator
            .bands
            .par_iter()
            .zip(parts)
            .for_each(|(band, part)| {
                let rays = &self.rays[band.first_cell..][..band.cells];
                for (index, (result, ray)) in part.iter_mut().zip(rays).enumerate() {
                    *result = self
                        .cell(band, index, ray, &sigma_ratios)
                        .unwrap_or_else(CellResult::rejected);
                }
            });
        results
    }

    /// Chi-square and degrees of freedom of every cell of a complete view, in the grid's order; zeros where nothing is
    /// tested.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn consistency(&self, accumulator: &Accumulator) -> Result<Vec<(f32, usize)>, DecodeError> {
        self.admit(accumulator)?;
        let bands = accumulator.bands.iter();
        Ok(bands
            .flat_map(|band| (0..band.cells).map(|index| self.chi_square(band, index)))
            .collect())
    }

    /// What every cell of a complete view shows, without triangulation: for a calibration, which does not know the
    /// geometry yet. One entry per cell, in the grid's order.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn columns(&self, accumulator: &Accumulator) -> Result<Vec<CellColumn>, DecodeError> {
        self.admit(accumulator)?;
        let ratios = vec![1.0; self.layout.steps.len()];
        let finest = self.layout.steps.len() - 1;
        let of_band = |band: &Band| -> Vec<CellColumn> {
            let cell = |index: usize| {
                let ray = &self.rays[band.first_cell + index];
                let noise = self.noise(band, index);
                let mean_e = self
                    .estimate(band, index, finest, &noise)
                    .map_or(f64::NAN, |estimate| estimate.mean_e);
                let column = self.column(band, index, ray, &ratios).ok();
                CellColumn {
                    pixel: ray.pixel,
                    mean_e,
                    column_px: column.map(|column| column.column_px),
                }
            };
            (0..band.cells).map(cell).collect()
        };
        let bands: Vec<_> = accumulator.bands.par_iter().map(of_band).collect();
        Ok(bands.into_iter().flatten().collect())
    }

    fn admit(&self, accumulator: &Accumulator) -> Result<(), DecodeError> {
        if !Arc::ptr_eq(&accumulator.layout, &self.layout) {
            return Err(DecodeError::ForeignAccumulator);
        }
        match accumulator.expected() {
            None => Ok(()),
            Some(expected) => Err(DecodeError::Incomplete {
                received: accumulator.received(),
                planned: accumulator.planned(),
                expected,
            }),
        }
    }

    /// Where a cell looks, in the camera frame: x and y at z = 1. None beyond the last cell.
    pub fn direction(&self, cell: u32) -> Option<[f64; 2]> {
        self.rays.get(cell as usize).map(|ray| ray.direction)
    }

    fn collect(&self, results: &[CellResult], fringes_dn: Option<&[f32]>) -> Decoded {
        let grid = &self.layout.grid;
        let mut rejected = Rejected::default();
        let points = results
            .iter()
            .filter(|result| result.fate == Fate::Point)
            .count();
        let mut cloud = Cloud::with_capacity(points);
        let mut without_point = Vec::with_capacity(results.len() - points);
        for row in 0..grid.rows() {
            for (cell, (place, _)) in grid.cells(row).zip(grid.places(row)) {
                let result = &results[cell];
                let counter = match result.fate {
                    Fate::Point => {
                        let [x, y] = self.rays[cell].direction;
                        let z = result.depth_mm;
                        cloud.points_mm.push([x * z, y * z, z]);
                        cloud.sigma_z_mm.push(result.sigma_z_mm);
                        cloud.cell.push(place);
                        cloud.modulation_e.push(result.modulation_e);
                        cloud.fringes_dn.extend(fringes_dn.map(|dn| dn[cell]));
                        continue;
                    }
                    Fate::Saturated => &mut rejected.saturated,
                    Fate::LowContrast => &mut rejected.low_contrast,
                    Fate::UncertainOrder => &mut rejected.uncertain_order,
                    Fate::OutsideProjector => &mut rejected.outside_projector,
                    Fate::OutsideVolume => &mut rejected.outside_volume,
                    Fate::UncertainDepth => &mut rejected.uncertain_depth,
                    Fate::Inconsistent => &mut rejected.inconsistent,
                    Fate::Masked => &mut rejected.masked,
                    Fate::Isolated => &mut rejected.isolated,
                };
                *counter += 1;
                without_point.push(cell as u32);
            }
        }
        Decoded {
            cloud,
            cells: results.len(),
            without_point,
            rejected,
        }
    }
}

/// What a frame of one cell scatters by.
fn frame_noise(sensor: &Sensor, grid: &Grid, response_ratio: f64) -> FrameNoise {
    let pixels = grid.pixels_per_cell() as f64;
    let gain = sensor.gain_e_per_dn;
    FrameNoise {
        offset_dn: (pixels * sensor.offset_dn) as f32,
        dark_variance_dn2: (pixels * sensor.dark_variance_e2() / (gain * gain)) as f32,
        variance_per_dn: (1.0 / gain) as f32,
        response_ratio: response_ratio as f32,
    }
}
