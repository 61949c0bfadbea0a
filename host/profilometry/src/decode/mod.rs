//! The whole way: from the sums of a view to points in the camera frame.

mod cell;
mod certainty;
mod coded;
mod conditioned;
mod error;
mod estimates;
mod floor;
mod maps;
mod neighbourhood;
mod options;
mod passes;
mod rays;
mod two_projectors;

use std::f64::consts::TAU;
use std::sync::Arc;

use rayon::prelude::*;

use crate::accumulate::agreement::Agreement;
use crate::accumulate::consistency::{self, FrameNoise};
use crate::accumulate::{Accumulator, Band, Layout};
use crate::cells::{CellGrid, CoreGrid, Grid};
use crate::cloud::small_patches;
use crate::frame::FrameKind;
use crate::head::{DepthRange, HeadModel, Pinhole, Sensor};
use crate::pattern::{FringeSet, PatternSet};
use crate::phase::mask;
use crate::phase::smoothing::CellPlane;
use crate::triangulate::Triangulator;
use crate::unwrap;
use flankscope_foundation::order::median;

pub use crate::accumulate::consistency::ConsistencyOptions;
pub use crate::cloud::{
    CellColumn, Cloud, Decoded, LightMedians, PatchOptions, Projectors, Rejected,
};
pub use crate::phase::mask::MaskOptions;
pub use crate::phase::parts::LightParts;
use cell::{CellResult, Fate};
use coded::CodeLadder;
use conditioned::Conditioned;
pub use error::DecodeError;
use estimates::Estimates;
pub use maps::PhaseMaps;
use neighbourhood::{Neighbourhood, Values};
pub use options::{DecodeOptions, GridKind, OrderConsistency};
use rays::{Ray, projector_size_px, rays};

/// Everything about a head and its patterns that does not change from view to view.
#[derive(Clone, Debug)]
pub struct Decoder {
    layout: Arc<Layout>,
    patterns: PatternSet,
    exposures_us: Vec<u32>,
    options: DecodeOptions,
    size_px: [u32; 2],
    sensor: Sensor,
    triangulator: Triangulator,
    camera: Pinhole,
    fringe_contrast: f64,
    projector_width_px: f64,
    volume: Option<DepthRange>,
    rays: Vec<Ray>,
    plane: CellPlane,
    /// Orders of the finest frequency that the set tells apart.
    orders: usize,
    /// Decoded Gray code, if the patterns have one.
    code: Option<CodeLadder>,
    /// Per frequency its phase at which that of the finest is zero, rad.
    origins_rad: Vec<f64>,
    /// Standard deviation of all phases up to which a cell's order is certain without its neighbours, rad.
    enough_rad: f64,
    /// Least amplitude of each frequency, counts per pixel and exposure.
    floors_dn: Vec<f64>,
    /// Largest chi-square by degrees of freedom; empty where it is not tested.
    chi_square_limits: Vec<f32>,
    /// Largest disagreement of exposures by degrees of freedom; empty where they are not compared.
    agreement_limits: Vec<f32>,
    /// Lateral size of a cell per unit of depth.
    cell_by_depth: f64,
    /// The same head by its second projector, if it has one.
    second: Option<Box<Self>>,
    /// Standard uncertainty of the difference between the depths by both projectors, mm.
    allowed_apart_mm: f64,
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
        let all_periods: Vec<f64> = patterns.sets.iter().map(|set| set.periods).collect();
        let orders = unwrap::distinct_orders(&all_periods);
        let projector_width_px = projector_size_px(head, patterns.axis);
        let code = match &patterns.code {
            Some(code) => Some(CodeLadder::new(code, patterns, orders, projector_width_px)?),
            None => None,
        };
        let all_orders = code.as_ref().map_or(orders, |code| code.all_orders);
        let repeated = (100.0 * patterns.finest().periods / all_orders as f64).round() / 100.0;
        if head.volume.is_none() && repeated > 1.0 {
            return Err(DecodeError::NeedsVolume { periods: repeated });
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
        let triangulator = Triangulator::new(head, patterns.axis);
        let rays = rays(head, patterns, all_orders, &grid, &triangulator)?;
        let plane = CellPlane::new(&grid);
        let finest = patterns.finest();
        let origin_rad = |set: &FringeSet| {
            let apart_px = set.phase_origin_px - finest.phase_origin_px;
            TAU * set.periods * apart_px / projector_width_px
        };
        let origins_rad = patterns.sets.iter().map(origin_rad).collect();
        let cell_by_depth = grid.pitch_px() / head.camera.focal_px[0].min(head.camera.focal_px[1]);
        let layout = Layout {
            width,
            height,
            grid,
            pictures: patterns.pictures().collect(),
            steps: patterns.sets.iter().map(|set| set.steps).collect(),
            bits: patterns.code.map_or(0, |code| code.bits as usize),
            exposures: exposures_us.len(),
            dark_frame: options.dark_frame,
            saturation_limit_dn: sensor.saturation_limit_dn(),
            noise: None,
            agreement: None,
        };
        let layout = Layout {
            noise: options
                .consistency
                .map(|gate| frame_noise(&sensor, &layout.grid, gate.response_ratio)),
            agreement: options
                .consistency
                .filter(|gate| gate.least_probability > 0.0)
                .and_then(|_| Agreement::new(exposures_us, &all_periods)),
            ..layout
        };
        let chi_square_limits = options.consistency.map_or(Vec::new(), |gate| {
            let of_set = |set: &FringeSet| set.steps.saturating_sub(3) as usize;
            let most = exposures_us.len() * patterns.sets.iter().map(of_set).sum::<usize>();
            consistency::limits(gate.least_probability, most)
        });
        let compared = options.consistency.zip(layout.agreement.as_ref());
        let agreement_limits = compared.map_or(Vec::new(), |(gate, agreement)| {
            let mut limits = consistency::limits(gate.least_probability, agreement.most_freedom());
            // Where nothing was compared, only impossible saturation was found.
            limits[0] = 0.0;
            limits
        });
        let floors_dn = floor::floors_dn(patterns, &options, &sensor);
        let by_second = head.with_projector(2);
        let second = by_second
            .map(|head| Self::new(&head, patterns, exposures_us, options.clone()))
            .transpose()?
            .map(Box::new);
        let apart = head.calibration.as_ref();
        let apart = apart.and_then(|record| record.second_projector);
        let allowed_apart_mm = apart.map_or(two_projectors::UNCALIBRATED_MM, |apart| {
            1e-3 * apart.allowed_um()
        });
        Ok(Self {
            layout: Arc::new(layout),
            patterns: patterns.clone(),
            exposures_us: exposures_us.to_vec(),
            options,
            size_px: [head.camera.width_px, head.camera.height_px],
            sensor,
            triangulator,
            camera: head.camera.clone(),
            fringe_contrast: head.fringe_contrast.unwrap_or(1.0),
            projector_width_px,
            volume: head.volume,
            rays,
            plane,
            orders,
            code,
            origins_rad,
            enough_rad: unwrap::order_step_rad(&all_periods) / unwrap::MIN_SEPARATION,
            floors_dn,
            chi_square_limits,
            agreement_limits,
            cell_by_depth,
            second,
            allowed_apart_mm,
        })
    }

    /// Empty sums for one view; reuse them with [`Accumulator::reset`].
    pub fn begin(&self) -> Accumulator {
        let mut sums = Accumulator::new(Arc::clone(&self.layout));
        if let Some(second) = &self.second {
            sums.put_second(second.begin());
        }
        sums
    }

    /// Number of projectors of its head; each shows all patterns, one after the other.
    pub fn projectors(&self) -> usize {
        1 + usize::from(self.second.is_some())
    }

    /// The grid of cells.
    pub fn grid(&self) -> &Grid {
        &self.layout.grid
    }

    /// Least amplitude of each frequency, counts per pixel and exposure: see [`DecodeOptions::min_modulation_dn`].
    pub fn floors_dn(&self) -> &[f64] {
        &self.floors_dn
    }

    /// The frames of a view in capture order.
    pub fn capture_order(&self) -> impl Iterator<Item = FrameKind> + '_ {
        (0..self.layout.planned()).filter_map(|index| self.layout.kind(index))
    }

    /// A mean level that a dark frame stays below and a lit frame exceeds: the offset plus 1 % of full scale.
    pub fn dark_limit_dn(&self) -> f64 {
        self.sensor.offset_dn + 0.01 * (2f64.powi(self.sensor.bits as i32) - 1.0)
    }

    /// Lateral size of a cell per unit of depth.
    pub fn cell_by_depth(&self) -> f64 {
        self.cell_by_depth
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
        let Measured {
            mut results,
            fringes_dn,
            frame_noise_ratio,
        } = self.measure(accumulator);
        let second = self.second.as_deref().zip(accumulator.second.as_deref());
        let projectors = second.map(|(second, sums)| {
            let other = second.measure(sums).results;
            two_projectors::join(&mut results, &other, self.allowed_apart_mm)
        });
        if let Some(options) = &self.options.patches {
            for cell in small_patches(&self.layout.grid, &results, self.cell_by_depth, options) {
                results[cell].reject(Fate::Isolated);
            }
        }
        let (mut decoded, ((light, medians), contrast)) = rayon::join(
            || self.collect(&results, fringes_dn.as_deref()),
            || {
                rayon::join(
                    || {
                        let light = self.light(accumulator, second, &results);
                        let medians = LightMedians::from_points(&light);
                        (light, medians)
                    },
                    || self.contrasts(accumulator, &results),
                )
            },
        );
        decoded.cloud.light = light;
        Ok(Decoded {
            frame_noise_ratio,
            contrast,
            light: medians,
            projectors,
            ..decoded
        })
    }

    /// Decodes every cell in the light of one projector.
    fn measure(&self, accumulator: &Accumulator) -> Measured {
        let fringes_dn = self
            .options
            .mask
            .map(|options| mask::fringe_deviations_dn(accumulator, options.smoothing_px));
        let view = self.condition(accumulator);
        let mut results = self.depths(&view);
        let around = Neighbourhood::new(&self.layout.grid, &self.plane, self.smoothing_cells());
        around.judge_exposures(&mut results, &self.disagreements(&view));
        around.judge_orders(&mut results, self.options.order_consistency);
        around.raise_to_frames(&mut results, &self.frame_scatter(&view));
        around.raise_uncertainties(&mut results);
        certainty::keep_certain(&mut results, self.options.max_sigma_z_mm);
        if let (Some(options), Some(fringes_dn)) = (&self.options.mask, &fringes_dn) {
            for (result, &deviation_dn) in results.iter_mut().zip(fringes_dn) {
                if f64::from(deviation_dn) < options.threshold_dn && result.fate == Fate::Point {
                    result.reject(Fate::Masked);
                }
            }
        }
        Measured {
            frame_noise_ratio: view.frame_noise_ratio,
            results,
            fringes_dn,
        }
    }

    /// Scatter of every cell's frames about their fringes, chi-square per degree of freedom, less what the uncertainties have been
    /// raised by already. Nothing where it is not tested, and for the instrument's own frames, which must keep to the prediction.
    fn frame_scatter(&self, view: &Conditioned<'_>) -> Values {
        let measured = self.options.consistency;
        if !measured.is_some_and(|gate| gate.relative_to_view) {
            return Vec::new();
        }
        let scale = view.frame_noise_ratio.max(1.0).powi(2) as f32;
        let bands = view.accumulator.bands.iter();
        let cells =
            bands.flat_map(|band| (0..band.cells).map(|index| self.chi_square(band, index)));
        cells
            .map(|(found, freedom)| (freedom > 0).then(|| found / (scale * freedom as f32)))
            .collect()
    }

    fn depths(&self, view: &Conditioned<'_>) -> Vec<CellResult> {
        let mut results = vec![CellResult::rejected(Fate::LowContrast); self.rays.len()];
        let mut rest = results.as_mut_slice();
        let bands = &view.accumulator.bands;
        let mut parts = Vec::with_capacity(bands.len());
        for band in bands {
            let (part, after) = rest.split_at_mut(band.cells);
            parts.push(part);
            rest = after;
        }
        bands.par_iter().zip(parts).for_each(|(band, part)| {
            let rays = &self.rays[band.first_cell..][..band.cells];
            self.band_depths(view, band, rays, part);
        });
        results
    }

    /// Disagreement of every cell's exposures, chi-square per degree of freedom and at most by the limit for one cell, so that no
    /// single cell speaks for those about it; nothing where they were not compared.
    fn disagreements(&self, view: &Conditioned<'_>) -> Values {
        let scale = view.frame_noise_ratio.max(1.0).powi(2) as f32;
        let of_band = |band: &Band| -> Values {
            let of_cell = |index: usize| {
                let (found, freedom) = self.disagreement(band, index)?;
                let most = self.agreement_limits[freedom];
                (freedom > 0).then(|| (found / scale).min(most) / freedom as f32)
            };
            (0..band.cells).map(of_cell).collect()
        };
        let bands = &view.accumulator.bands;
        let bands: Vec<_> = bands.par_iter().map(of_band).collect();
        bands.concat()
    }

    /// Ratio of the scatter of frames of cells with fringes to the predicted one, median over the view; 1 unless the
    /// options say that cells are laid beside the view.
    fn frame_noise_ratio(&self, accumulator: &Accumulator) -> f64 {
        if !self
            .options
            .consistency
            .is_some_and(|gate| gate.relative_to_view)
        {
            return 1.0;
        }
        let finest = self.layout.steps.len() - 1;
        let of_band = |band: &Band| -> Vec<f64> {
            let light = self.lights(band, finest);
            let cell = |index: usize| {
                let estimate = light(index)?;
                let (chi_square, freedom) = self.chi_square(band, index);
                let lit = estimate.contrast() >= self.options.min_contrast && freedom > 0;
                lit.then(|| f64::from(chi_square) / consistency::median(freedom))
            };
            (0..band.cells).filter_map(cell).collect()
        };
        let ratios: Vec<Vec<f64>> = accumulator.bands.par_iter().map(of_band).collect();
        median(&mut ratios.concat()).map_or(1.0, f64::sqrt)
    }

    /// Direct and global light of every point, by the projector that counts more in it.
    fn light(
        &self,
        accumulator: &Accumulator,
        second: Option<(&Self, &Accumulator)>,
        results: &[CellResult],
    ) -> Vec<LightParts> {
        let finest = self.layout.steps.len() - 1;
        // A point's neighbours may have lent it all its light.
        let dark = LightParts {
            direct_e: 0.0,
            global_e: 0.0,
        };
        let of_band = |(at, band): (usize, &Band)| -> Vec<LightParts> {
            let own = self.lights(band, finest);
            let second = second.map(|(decoder, sums)| {
                let light = decoder.lights(&sums.bands[at], finest);
                (light, decoder.fringe_contrast)
            });
            let parts = |cell: &CellResult, index: usize| {
                let (light, contrast) = match &second {
                    Some((light, contrast)) if cell.by_second => (light(index), *contrast),
                    _ => (own(index), self.fringe_contrast),
                };
                light.map_or(dark, |light| LightParts::from_fringes(&light, contrast))
            };
            let cells = results[band.first_cell..][..band.cells].iter().enumerate();
            let points = cells.filter(|(_, cell)| cell.fate == Fate::Point);
            points.map(|(index, cell)| parts(cell, index)).collect()
        };
        let bands: Vec<_> = accumulator
            .bands
            .par_iter()
            .enumerate()
            .map(of_band)
            .collect();
        bands.concat()
    }

    /// Time of the exposures that count in a cell, of which only the longest saturate.
    fn exposed_us(&self, used: u8) -> f64 {
        let used = &self.exposures_us[..usize::from(used)];
        used.iter().map(|&us| f64::from(us)).sum()
    }

    /// Median contrast of each frequency over the cells with a point that the second projector does not count more in.
    fn contrasts(&self, accumulator: &Accumulator, results: &[CellResult]) -> Vec<f64> {
        let of_set = |set: usize| -> Option<f64> {
            let of_band = |band: &Band| -> Vec<f64> {
                let light = self.lights(band, set);
                let cells = results[band.first_cell..][..band.cells].iter().enumerate();
                let seen = cells.filter(|(_, cell)| cell.fate == Fate::Point && !cell.by_second);
                seen.filter_map(|(index, _)| Some(light(index)?.contrast()))
                    .collect()
            };
            let bands: Vec<Vec<f64>> = accumulator.bands.par_iter().map(of_band).collect();
            median(&mut bands.concat())
        };
        let sets = (0..self.patterns.sets.len()).into_par_iter();
        sets.filter_map(of_set).collect()
    }

    /// Number of orders of the finest fringes between two points of a camera ray, to check whether a point has the expected order. `None`
    /// behind the projector.
    pub fn orders_between(&self, from_mm: [f64; 3], to_mm: [f64; 3]) -> Option<f64> {
        let column = |[x, y, z]: [f64; 3]| self.triangulator.column([x / z, y / z], z);
        let apart_px = column(to_mm)?.0 - column(from_mm)?.0;
        Some(apart_px * self.patterns.finest().periods / self.projector_width_px)
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

    /// Decodes every cell of a complete view, without triangulation: for a calibration, which does not know the
    /// geometry yet. One entry per cell, in the grid's order.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn columns(&self, accumulator: &Accumulator) -> Result<Vec<CellColumn>, DecodeError> {
        self.admit(accumulator)?;
        Ok(self.shown(accumulator, &self.plain(accumulator)))
    }

    /// The same by each of the head's projectors.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn columns_of_each(
        &self,
        accumulator: &Accumulator,
    ) -> Result<Vec<Vec<CellColumn>>, DecodeError> {
        let mut each = vec![self.columns(accumulator)?];
        if let Some((second, sums)) = self.second.as_ref().zip(accumulator.second.as_deref()) {
            each.push(second.columns(sums)?);
        }
        Ok(each)
    }

    /// The same with phasors smoothed as the options say.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn smoothed_columns(
        &self,
        accumulator: &Accumulator,
    ) -> Result<Vec<CellColumn>, DecodeError> {
        self.admit(accumulator)?;
        Ok(self.shown(accumulator, &self.condition(accumulator)))
    }

    fn shown(&self, accumulator: &Accumulator, view: &Conditioned<'_>) -> Vec<CellColumn> {
        let finest = self.layout.steps.len() - 1;
        let of_band = |(band, conditioned): (&Band, &Band)| -> Vec<CellColumn> {
            let light = self.lights(band, finest);
            let mut estimates = Estimates::new(self, conditioned);
            let cell = |index: usize| {
                let ray = &self.rays[band.first_cell + index];
                let (mean_e, contrast) = light(index).map_or((f64::NAN, f64::NAN), |light| {
                    (light.mean_e, light.contrast())
                });
                let column = self.column(view, conditioned, index, &mut estimates, ray);
                let column = column.ok();
                CellColumn {
                    pixel: ray.pixel,
                    mean_e,
                    contrast,
                    column_px: column.map(|column| column.column_px),
                }
            };
            (0..band.cells).map(cell).collect()
        };
        let bands = accumulator.bands.par_iter();
        let bands: Vec<_> = bands.zip(&view.accumulator.bands).map(of_band).collect();
        bands.into_iter().flatten().collect()
    }

    fn admit(&self, accumulator: &Accumulator) -> Result<(), DecodeError> {
        if !Arc::ptr_eq(&accumulator.layout, &self.layout) {
            return Err(DecodeError::ForeignAccumulator);
        }
        match (&self.second, &accumulator.second) {
            (None, None) => {}
            (Some(second), Some(sums)) => second.admit(sums)?,
            _ => return Err(DecodeError::ForeignAccumulator),
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

    /// Viewing direction of a cell in the camera frame: x and y at z = 1. `None` beyond the last cell.
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
        let mut is_dark = Vec::with_capacity(results.len() - points);
        for row in 0..grid.rows() {
            for (cell, (place, _)) in grid.cells(row).zip(grid.places(row)) {
                let result = &results[cell];
                let counter = match result.fate {
                    Fate::Point => {
                        let [x, y] = result.direction;
                        let z = result.depth_mm;
                        cloud.points_mm.push([x * z, y * z, z]);
                        cloud.sigma_z_mm.push(result.sigma_z_mm);
                        cloud.cell.push(place);
                        cloud.fringes_e_per_ms.push(result.fringes_e_per_ms);
                        cloud.fringes_dn.extend(fringes_dn.map(|dn| dn[cell]));
                        continue;
                    }
                    Fate::Saturated => &mut rejected.saturated,
                    Fate::LowContrast => &mut rejected.low_contrast,
                    Fate::LowModulation => &mut rejected.low_modulation,
                    Fate::Disagreeing => &mut rejected.disagreeing,
                    Fate::UncertainOrder => &mut rejected.uncertain_order,
                    Fate::OutsideProjector => &mut rejected.outside_projector,
                    Fate::OutsideVolume => &mut rejected.outside_volume,
                    Fate::UncertainDepth => &mut rejected.uncertain_depth,
                    Fate::Inconsistent => &mut rejected.inconsistent,
                    Fate::ExposuresDisagree => &mut rejected.exposures_disagree,
                    Fate::Masked => &mut rejected.masked,
                    Fate::Isolated => &mut rejected.isolated,
                };
                *counter += 1;
                without_point.push(cell as u32);
                is_dark.push(matches!(
                    result.fate,
                    Fate::LowContrast
                        | Fate::LowModulation
                        | Fate::UncertainOrder
                        | Fate::OutsideVolume
                ));
            }
        }
        Decoded {
            cloud,
            cells: results.len(),
            without_point,
            is_dark,
            rejected,
            frame_noise_ratio: 1.0,
            light: None,
            contrast: Vec::new(),
            projectors: None,
        }
    }
}

/// Decoded frames of one projector, cell by cell.
struct Measured {
    results: Vec<CellResult>,
    /// Modulation that the mask is compared with, if there is a mask.
    fringes_dn: Option<Vec<f32>>,
    frame_noise_ratio: f64,
}

/// Standard deviation of one frame of one cell.
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
