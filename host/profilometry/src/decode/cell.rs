//! One cell: from its sums to a depth, or to the first reason why there is none.

use std::f64::consts::TAU;

use super::Decoder;
use super::coded::CodedCell;
use super::conditioned::Conditioned;
use super::estimates::Estimates;
use super::rays::Ray;
use crate::accumulate::{Band, Merged};
use crate::cloud::Depths;
use crate::pattern::MAX_FREQUENCIES;
use crate::phase::{self, CellNoise};
use crate::triangulate::{Hit, depth_sigma_mm};
use crate::unwrap::{self, Clue, Ladder, MIN_SEPARATION, nearest_turn};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    Point,
    Saturated,
    LowContrast,
    LowModulation,
    UncertainOrder,
    Disagreeing,
    OutsideProjector,
    OutsideVolume,
    UncertainDepth,
    Inconsistent,
    ExposuresDisagree,
    Masked,
    Isolated,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct CellResult {
    pub fate: Fate,
    /// The second projector counts more in it.
    pub by_second: bool,
    pub depth_mm: f64,
    /// Direction of its light, x and y at z = 1.
    pub direction: [f64; 2],
    pub sigma_z_mm: f32,
    /// Depth over one turn of the finest phase: what a phase that is noise leaves undetermined.
    pub turn_mm: f32,
    /// Amplitude of the finest fringes, electrons per millisecond.
    pub fringes_e_per_ms: f32,
    /// Misfit of the clues to the fringe order: chi-square per degree of freedom. NaN where no order was found.
    pub clue_chi_square: f32,
    /// Distance to the next order, in predicted standard deviations of the clues.
    pub separation: f32,
    /// Disagreement of the frequencies that make up the column: chi-square per degree of freedom. NaN for a single one.
    pub column_chi_square: f32,
}

/// The projector column of a cell and the uncertainty of its phase.
pub(super) struct Column {
    pub column_px: f64,
    /// Standard deviation of the phase of the finest frequency, rad.
    pub sigma_rad: f64,
    /// Amplitude of the finest fringes, electrons per millisecond.
    pub fringes_e_per_ms: f64,
    pub clue_chi_square: f32,
    pub separation: f32,
    pub column_chi_square: f32,
}

/// Why there is no column, and how far the clues missed of what if they were asked.
pub(super) struct Lost {
    pub fate: Fate,
    pub clue_chi_square: f32,
    pub separation: f32,
}

impl From<Fate> for Lost {
    fn from(fate: Fate) -> Self {
        Self {
            fate,
            clue_chi_square: f32::NAN,
            separation: 0.0,
        }
    }
}

impl CellResult {
    pub(super) fn rejected(fate: Fate) -> Self {
        Self {
            fate,
            by_second: false,
            depth_mm: f64::NAN,
            direction: [f64::NAN; 2],
            sigma_z_mm: f32::NAN,
            turn_mm: f32::NAN,
            fringes_e_per_ms: 0.0,
            clue_chi_square: f32::NAN,
            separation: 0.0,
            column_chi_square: f32::NAN,
        }
    }

    pub(super) fn reject(&mut self, fate: Fate) {
        *self = Self::rejected(fate);
    }
}

impl From<Lost> for CellResult {
    fn from(lost: Lost) -> Self {
        Self {
            clue_chi_square: lost.clue_chi_square,
            separation: lost.separation,
            ..Self::rejected(lost.fate)
        }
    }
}

impl Depths for Vec<CellResult> {
    fn depth_mm(&self, cell: usize) -> f64 {
        self[cell].depth_mm
    }

    fn sigma_mm(&self, cell: usize) -> f64 {
        f64::from(self[cell].sigma_z_mm)
    }
}

/// Frequencies of at least this part of the finest one's make up the column with it; lower ones only count its fringes, for
/// what light from elsewhere does to a phase falls with the frequency.
pub(super) const FINE_RATIO: f64 = 0.5;

/// Estimate of one frequency in a cell.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    /// Wrapped, counted from where the finest frequency's phase is zero.
    phase_rad: f64,
    sigma_rad: f64,
}

impl Decoder {
    /// The projector column that lights a cell, before any geometry but the fringe order that the volume allows.
    pub(super) fn column(
        &self,
        view: &Conditioned<'_>,
        band: &Band,
        index: usize,
        estimates: &mut Estimates<'_>,
        ray: &Ray,
    ) -> Result<Column, Lost> {
        let mut seen = [Seen::default(); MAX_FREQUENCIES];
        let mut last = None;
        for (set, seen) in seen.iter_mut().enumerate().take(self.patterns.sets.len()) {
            let estimate = estimates.get(index, set)?;
            // Written so that a NaN fails.
            if !(estimate.light.contrast() >= self.options.min_contrast) {
                return Err(Fate::LowContrast.into());
            }
            if estimate.light.modulation_e < self.floor_e(band, index, set) {
                return Err(Fate::LowModulation.into());
            }
            *seen = Seen {
                phase_rad: estimate.phase_rad + self.origins_rad[set],
                sigma_rad: estimate.sigma_rad * view.sigma_ratios[set],
            };
            last = Some(estimate);
        }
        // Before the orders: those of two scenes in one phasor mean nothing.
        if self.exposures_disagree(band, index, view.frame_noise_ratio) {
            return Err(Fate::ExposuresDisagree.into());
        }
        let estimate = last.ok_or(Fate::UncertainOrder)?;
        let finest = self.patterns.sets.len() - 1;
        let mut clues = [unwrap::NO_CLUE; MAX_FREQUENCIES];
        for (set, clue) in clues.iter_mut().enumerate().take(finest) {
            *clue = self.clue(view, band.first_cell + index, set, &seen);
        }
        let ladder = Ladder {
            middle_rad: ray.middle_rad,
            orders: self.orders,
            expected_rad: ray.expected_rad,
        };
        let wrapped_rad = seen[finest].phase_rad;
        let clues = &clues[..finest];
        let found = match &self.code {
            None => unwrap::decide(clues, wrapped_rad, &ladder),
            Some(code) => {
                let phases_rad = [wrapped_rad, ray.middle_rad];
                {
                    let cell = CodedCell {
                        band,
                        index,
                        finest: &estimate.light,
                        noise: &self.noise_anywhere(),
                    };
                    self.coded_order(code, &cell, clues, phases_rad)?
                }
            }
        };
        if !(found.separation >= MIN_SEPARATION) {
            return Err(Fate::UncertainOrder.into());
        }
        let clue_chi_square = match finest {
            _ if self.code.is_some() => f32::NAN,
            0 => f32::NAN,
            clues => (found.chi_square / clues as f64) as f32,
        };
        if !found.agreed {
            return Err(Lost {
                fate: Fate::Disagreeing,
                clue_chi_square,
                separation: found.separation as f32,
            });
        }
        if self.is_inconsistent(band, index, view.frame_noise_ratio) {
            return Err(Fate::Inconsistent.into());
        }
        let phase = self.fine_phase(&seen[..=finest], found.absolute_rad);
        let fringes = self.patterns.finest();
        let column_px = fringes.column_px(phase.absolute_rad, self.projector_width_px);
        if !(-0.5..=self.projector_width_px - 0.5).contains(&column_px) {
            return Err(Fate::OutsideProjector.into());
        }
        let exposed_ms = 1e-3 * self.exposed_us(band.phasor(finest, index).exposures);
        Ok(Column {
            column_px,
            sigma_rad: phase.sigma_rad * view.frame_noise_ratio.max(1.0),
            fringes_e_per_ms: estimate.light.modulation_e / exposed_ms,
            clue_chi_square,
            separation: found.separation as f32,
            column_chi_square: phase.chi_square,
        })
    }

    /// Clue of a frequency to the fringe order of the finest.
    fn clue(
        &self,
        view: &Conditioned<'_>,
        cell: usize,
        set: usize,
        seen: &[Seen; MAX_FREQUENCIES],
    ) -> Clue {
        let finest = self.patterns.sets.len() - 1;
        let ratio = self.patterns.sets[set].periods / self.patterns.finest().periods;
        let Some(difference) = &view.differences[set] else {
            return Clue {
                ratio,
                phase_rad: seen[set].phase_rad,
                own_variance_rad2: seen[set].sigma_rad.powi(2),
                shared_rad: ratio * seen[finest].sigma_rad,
            };
        };
        let (re, im) = (difference.re[cell], difference.im[cell]);
        let turned_rad =
            self.patterns.step_sign.factor() * phase::atan2(f64::from(im), f64::from(re));
        // Noise of the cell's own phases, smoothed less than the difference was.
        let sigma_rad = |set: usize| {
            let smoothing = difference.variance_ratio.sqrt() / view.sigma_ratios[set];
            seen[set].sigma_rad * smoothing
        };
        let beat = ratio - 1.0;
        Clue {
            ratio: beat,
            phase_rad: turned_rad + self.origins_rad[set],
            own_variance_rad2: sigma_rad(set).powi(2) + (beat * seen[finest].sigma_rad).powi(2),
            shared_rad: sigma_rad(finest),
        }
    }

    /// Absolute phase of the finest frequency from all fine ones, weighted by their variances.
    fn fine_phase(&self, seen: &[Seen], absolute_rad: f64) -> FinePhase {
        let periods = self.patterns.finest().periods;
        // Distances from the finest frequency's own phase, so that it stays as it is when it is alone, and weights.
        let mut parts = [(0.0, 0.0); MAX_FREQUENCIES];
        let (mut count, mut weight) = (0, 0.0);
        for (set, seen) in self.patterns.sets.iter().zip(seen) {
            let ratio = set.periods / periods;
            if ratio > FINE_RATIO {
                let expected_rad = ratio * absolute_rad;
                let off_rad = (nearest_turn(seen.phase_rad, expected_rad) - expected_rad) / ratio;
                parts[count] = (off_rad, (ratio / seen.sigma_rad).powi(2));
                weight += parts[count].1;
                count += 1;
            }
        }
        if count < 2 || !weight.is_finite() {
            return FinePhase {
                absolute_rad,
                sigma_rad: seen[seen.len() - 1].sigma_rad,
                chi_square: f32::NAN,
            };
        }
        let parts = &parts[..count];
        let mean = parts.iter().map(|(off, weight)| off * weight).sum::<f64>() / weight;
        let left = parts
            .iter()
            .map(|(off, weight)| (off - mean).powi(2) * weight);
        FinePhase {
            absolute_rad: absolute_rad + mean,
            sigma_rad: 1.0 / weight.sqrt(),
            chi_square: (left.sum::<f64>() / (count - 1) as f64) as f32,
        }
    }

    /// Least amplitude of a cell in electrons.
    fn floor_e(&self, band: &Band, index: usize, set: usize) -> f64 {
        let exposures = f64::from(band.merged[set].exposures[index]);
        let pixels = self.layout.grid.pixels_per_cell() as f64;
        self.floors_dn[set] * self.sensor.gain_e_per_dn * pixels * exposures
    }

    /// Whether the residuals of a cell's frames exceed what noise alone explains (chi-square test).
    fn is_inconsistent(&self, band: &Band, index: usize, noise_ratio: f64) -> bool {
        let (chi_square, freedom) = self.chi_square(band, index);
        let scale = noise_ratio.max(1.0).powi(2) as f32;
        self.chi_square_limits
            .get(freedom)
            .is_some_and(|&limit| chi_square > limit * scale)
    }

    /// Chi-square of a cell over all frequencies and exposures used, and its degrees of freedom.
    pub(super) fn chi_square(&self, band: &Band, index: usize) -> (f32, usize) {
        let (mut chi_square, mut freedom) = (0.0, 0);
        for (merged, steps) in band.merged.iter().zip(&self.layout.steps) {
            // Three steps follow any fringe.
            if let Some(&own) = merged.chi_square.get(index).filter(|_| *steps > 3) {
                chi_square += own;
                freedom += (steps - 3) as usize * usize::from(merged.exposures[index]);
            }
        }
        (chi_square, freedom)
    }

    /// Whether a cell's exposures differ by more than noise alone explains (chi-square test).
    fn exposures_disagree(&self, band: &Band, index: usize, noise_ratio: f64) -> bool {
        let scale = noise_ratio.max(1.0).powi(2) as f32;
        self.disagreement(band, index)
            .is_some_and(|(found, freedom)| found > self.agreement_limits[freedom] * scale)
    }

    /// Disagreement of a cell's exposures over all frequencies, and its degrees of freedom; none where nothing was compared.
    pub(super) fn disagreement(&self, band: &Band, index: usize) -> Option<(f32, usize)> {
        let &found = band.disagreement.get(index)?;
        let joined = |merged: &Merged| usize::from(merged.exposures[index].saturating_sub(1));
        let freedom = 2 * band.merged.iter().map(joined).sum::<usize>();
        (freedom > 0 || found > 0.0).then_some((found, freedom))
    }

    /// Noise of the cells of a view without dark frame.
    pub(super) fn noise_anywhere(&self) -> CellNoise {
        CellNoise {
            gain_e_per_dn: self.sensor.gain_e_per_dn,
            offset_dn: self.sensor.offset_dn,
            dark_variance_e2: self.sensor.dark_variance_e2(),
            pixels: self.layout.grid.pixels_per_cell() as f64,
        }
    }

    fn noise(&self, band: &Band, index: usize) -> CellNoise {
        let anywhere = self.noise_anywhere();
        let dark = band.dark.get(index);
        CellNoise {
            offset_dn: dark.map_or(anywhere.offset_dn, |&dark| {
                f64::from(dark) / anywhere.pixels
            }),
            ..anywhere
        }
    }

    /// Standard deviation of a cell's phase of one frequency, unsmoothed; `None` where every exposure was saturated.
    pub(super) fn phase_sigma_rad(&self, band: &Band, index: usize, set: usize) -> Option<f64> {
        let phasor = band.phasor(set, index);
        let steps = self.patterns.sets[set].steps;
        let sign = self.patterns.step_sign.factor();
        let estimate = || phase::estimate(&phasor, steps, sign, &self.noise(band, index));
        (phasor.exposures > 0).then(|| estimate().sigma_rad)
    }

    /// The cells of a band: first the column of each, then the depths of all that have one together.
    pub(super) fn band_depths(
        &self,
        view: &Conditioned<'_>,
        band: &Band,
        rays: &[Ray],
        results: &mut [CellResult],
    ) {
        let mut estimates = Estimates::new(self, band);
        let (mut columns, mut sheets) = (Vec::new(), Vec::new());
        for (index, (result, ray)) in results.iter_mut().zip(rays).enumerate() {
            match self.column(view, band, index, &mut estimates, ray) {
                Ok(column) => {
                    let direction = self.lit_direction(view, band.first_cell + index, ray);
                    sheets.push((direction, column.column_px));
                    columns.push((index, column));
                }
                Err(lost) => *result = lost.into(),
            }
        }
        let hits = self.triangulator.intersect_all(&sheets);
        for ((index, column), ((direction, _), hit)) in columns.iter().zip(sheets.iter().zip(hits))
        {
            let point = self.point(column, *direction, hit);
            results[*index] = point.unwrap_or_else(CellResult::rejected);
        }
    }

    /// The point of a cell, if it lies in the volume and in fringes that count.
    fn point(
        &self,
        column: &Column,
        direction: [f64; 2],
        hit: Option<Hit>,
    ) -> Result<CellResult, Fate> {
        let hit = hit.ok_or(Fate::OutsideVolume)?;
        if self
            .volume
            .is_some_and(|volume| !(volume.near_mm..=volume.far_mm).contains(&hit.depth_mm))
        {
            return Err(Fate::OutsideVolume);
        }
        if !self.triangulator.is_lit(&hit) {
            return Err(Fate::OutsideProjector);
        }
        let periods = self.patterns.finest().periods;
        let depth_mm =
            |phase_rad: f64| depth_sigma_mm(phase_rad, periods, self.projector_width_px, &hit);
        Ok(CellResult {
            fate: Fate::Point,
            by_second: false,
            depth_mm: hit.depth_mm,
            direction,
            sigma_z_mm: depth_mm(column.sigma_rad) as f32,
            turn_mm: depth_mm(TAU) as f32,
            fringes_e_per_ms: column.fringes_e_per_ms as f32,
            clue_chi_square: column.clue_chi_square,
            separation: column.separation,
            column_chi_square: column.column_chi_square,
        })
    }
}

impl Decoder {
    /// Direction of the light of a cell's smoothed phasor: its own ray, shifted towards brighter neighbours.
    fn lit_direction(&self, view: &Conditioned<'_>, cell: usize, ray: &Ray) -> [f64; 2] {
        let Some(&centroid) = view.centroids.get(cell) else {
            return ray.direction;
        };
        let pitch_px = self.layout.grid.pitch_px();
        let pixel = [0, 1].map(|axis| ray.pixel[axis] + pitch_px * f64::from(centroid[axis]));
        self.camera.undistort(pixel).unwrap_or(ray.direction)
    }
}

/// Phase of the finest frequency, as all fine ones have it.
struct FinePhase {
    absolute_rad: f64,
    sigma_rad: f64,
    /// Per degree of freedom.
    chi_square: f32,
}
