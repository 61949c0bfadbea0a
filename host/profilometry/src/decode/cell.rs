//! One cell: from its sums to a depth, or to the first reason why there is none.

use super::Decoder;
use super::rays::Ray;
use crate::accumulate::Band;
use crate::cloud::Depths;
use crate::phase::{self, CellNoise, PhaseEstimate};
use crate::triangulate::depth_sigma_mm;
use crate::unwrap;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    Point,
    Saturated,
    LowContrast,
    UncertainOrder,
    OutsideProjector,
    OutsideVolume,
    UncertainDepth,
    Inconsistent,
    Masked,
    Isolated,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct CellResult {
    pub fate: Fate,
    pub depth_mm: f64,
    pub sigma_z_mm: f32,
    pub modulation_e: f32,
}

/// The projector column of a cell and the uncertainty of its phase.
pub(super) struct Column {
    pub column_px: f64,
    pub sigma_rad: f64,
    pub modulation_e: f64,
}

impl CellResult {
    pub(super) fn rejected(fate: Fate) -> Self {
        Self {
            fate,
            depth_mm: f64::NAN,
            sigma_z_mm: f32::NAN,
            modulation_e: 0.0,
        }
    }

    pub(super) fn reject(&mut self, fate: Fate) {
        *self = Self::rejected(fate);
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

impl Decoder {
    /// The projector column that lights a cell, before any geometry but the fringe order that the volume allows.
    pub(super) fn column(
        &self,
        band: &Band,
        index: usize,
        ray: &Ray,
        sigma_ratios: &[f64],
    ) -> Result<Column, Fate> {
        let noise = self.noise(band, index);
        // Absolute phase of the frequency just done, and its uncertainty; finest last.
        let mut absolute_rad = 0.0;
        let mut sigma_rad = 0.0;
        let mut modulation_e = 0.0;
        for (set, fringes) in self.patterns.sets.iter().enumerate() {
            let estimate = self.estimate(band, index, set, &noise)?;
            // Written so that a NaN fails.
            if !(estimate.contrast() >= self.options.min_contrast) {
                return Err(Fate::LowContrast);
            }
            let wrapped_rad = estimate.phase_rad;
            let own_sigma_rad = estimate.sigma_rad * sigma_ratios[set];
            absolute_rad = if set == 0 {
                unwrap::nearest_turn(wrapped_rad, ray.expected_low_rad)
            } else {
                let ratio = fringes.periods / self.patterns.sets[set - 1].periods;
                unwrap::refine(ratio, absolute_rad, sigma_rad, wrapped_rad, own_sigma_rad)
                    .ok_or(Fate::UncertainOrder)?
            };
            sigma_rad = own_sigma_rad;
            modulation_e = estimate.modulation_e;
        }
        if self.is_inconsistent(band, index) {
            return Err(Fate::Inconsistent);
        }
        let periods = self.patterns.finest().periods;
        let column_px = self
            .patterns
            .column_px(periods, absolute_rad, self.projector_width_px);
        if !(-0.5..=self.projector_width_px - 0.5).contains(&column_px) {
            return Err(Fate::OutsideProjector);
        }
        Ok(Column {
            column_px,
            sigma_rad,
            modulation_e,
        })
    }

    /// Whether noise alone hardly ever leaves so much over of a cell's frames.
    fn is_inconsistent(&self, band: &Band, index: usize) -> bool {
        let (chi_square, freedom) = self.chi_square(band, index);
        self.chi_square_limits
            .get(freedom)
            .is_some_and(|&limit| chi_square > limit)
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

    pub(super) fn noise(&self, band: &Band, index: usize) -> CellNoise {
        let pixels = self.layout.grid.pixels_per_cell() as f64;
        CellNoise {
            gain_e_per_dn: self.sensor.gain_e_per_dn,
            offset_dn: band
                .dark
                .get(index)
                .map_or(self.sensor.offset_dn, |&dark| f64::from(dark) / pixels),
            dark_variance_e2: self.sensor.dark_variance_e2(),
            pixels,
        }
    }

    pub(super) fn estimate(
        &self,
        band: &Band,
        index: usize,
        set: usize,
        noise: &CellNoise,
    ) -> Result<PhaseEstimate, Fate> {
        let phasor = band.phasor(set, index);
        if phasor.exposures == 0 {
            return Err(Fate::Saturated);
        }
        let steps = self.patterns.sets[set].steps;
        let sign = self.patterns.step_sign.factor();
        Ok(phase::estimate(&phasor, steps, sign, noise))
    }

    pub(super) fn cell(
        &self,
        band: &Band,
        index: usize,
        ray: &Ray,
        sigma_ratios: &[f64],
    ) -> Result<CellResult, Fate> {
        let Column {
            column_px,
            sigma_rad,
            modulation_e,
        } = self.column(band, index, ray, sigma_ratios)?;
        let hit = self
            .triangulator
            .intersect(ray.direction, column_px)
            .ok_or(Fate::OutsideVolume)?;
        if self
            .volume
            .is_some_and(|volume| !(volume.near_mm..=volume.far_mm).contains(&hit.depth_mm))
        {
            return Err(Fate::OutsideVolume);
        }
        let periods = self.patterns.finest().periods;
        let sigma_z_mm = depth_sigma_mm(sigma_rad, periods, self.projector_width_px, &hit);
        if self
            .options
            .max_sigma_z_mm
            .is_some_and(|limit| !(sigma_z_mm <= limit))
        {
            return Err(Fate::UncertainDepth);
        }
        Ok(CellResult {
            fate: Fate::Point,
            depth_mm: hit.depth_mm,
            sigma_z_mm: sigma_z_mm as f32,
            modulation_e: modulation_e as f32,
        })
    }
}
