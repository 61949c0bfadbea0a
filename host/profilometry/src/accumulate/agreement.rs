//! Whether the exposures of a cell show one scene.
//!
//! Two exposures of one scene have one phase, and amplitudes in the ratio of their times. An exposure that saturates nowhere in
//! the cell is therefore compared with the sum of those before it, frequency by frequency, before it joins them. With `r` the ratio
//! of its time to theirs, the difference of phasors `D = C - r C_before` is noise. Its part across the phasor belongs to the phase,
//! its part along the phasor to the amplitude; each is squared and divided by its predicted variance. Noise alone leaves a
//! chi-square distribution with two degrees of freedom for every frequency and every exposure that joined others, and these are
//! independent of each other, since the variances are in the ratio of the times, too.
//!
//! The means are not compared: offset and ambient light enter them, of which one dark frame at one exposure does not tell enough,
//! and no depth depends on them.

use super::band::Planes;
use super::consistency::{FrameNoise, Sums};

/// What head and press move by between two exposures, as a standard deviation of the finest frequency's phase: about 1 µm of
/// depth for fringes of 0.1 to 0.2 mm at 30 degrees. More than 1 µm from frame to frame is found by [`super::consistency`].
const MOTION_RAD: f64 = 0.02;
/// Standard deviation of the ratio of two amplitudes that camera and lamp leave: a sensor whose counts are linear to 1 % of
/// full scale may have a slope that differs by 2 % between short and long exposures; a lamp drifts by less.
const LINEARITY: f64 = 0.02;
/// A frame is accepted if its exposure time is within this of the commanded one, µs (`EXPOSURE_TOLERANCE_US` of the capture):
/// a uniform distribution of this half width.
const EXPOSURE_TOLERANCE_US: f64 = 100.0;
/// Statistic of a cell that saturates at an exposure and not at a longer one, which no scene does. Finite, as all that is stored.
const IMPOSSIBLE: f32 = 1e30;

/// What the comparison needs of exposures and patterns.
#[derive(Debug)]
pub(crate) struct Agreement {
    /// Of every exposure after the first.
    joining: Vec<Joining>,
    /// Standard deviation of each frequency's phase by motion, rad.
    motion_rad: Vec<f32>,
}

/// An exposure beside the sum of those before it.
#[derive(Clone, Copy, Debug)]
struct Joining {
    /// Its time by theirs.
    ratio: f32,
    /// Standard deviation of its amplitude, relative to it, beside noise.
    amplitude_ratio: f32,
}

impl Agreement {
    /// For ascending exposures and the periods of all frequencies, low to high. None for a single exposure.
    pub fn new(exposures_us: &[u32], periods: &[f64]) -> Option<Self> {
        let finest = periods.last()?;
        let joining: Vec<Joining> = (1..exposures_us.len())
            .map(|at| {
                let time_us = f64::from(exposures_us[at]);
                let before_us: f64 = exposures_us[..at].iter().map(|&us| f64::from(us)).sum();
                let off_us = EXPOSURE_TOLERANCE_US / 3f64.sqrt();
                let before = off_us * (at as f64).sqrt() / before_us;
                let timing = (off_us / time_us).hypot(before);
                Joining {
                    ratio: (time_us / before_us) as f32,
                    amplitude_ratio: LINEARITY.hypot(timing) as f32,
                }
            })
            .collect();
        (!joining.is_empty()).then(|| Self {
            joining,
            motion_rad: periods
                .iter()
                .map(|periods| (MOTION_RAD * periods / finest) as f32)
                .collect(),
        })
    }

    /// Largest number of degrees of freedom of a cell.
    pub fn most_freedom(&self) -> usize {
        2 * self.joining.len() * self.motion_rad.len()
    }

    /// Adds the statistic of one exposure and frequency, cell by cell, before that exposure joins the `merged` ones.
    /// `exposure` counts from 0; the first one starts anew with the first frequency.
    #[inline(always)]
    pub fn add(
        &self,
        sums: Sums<'_>,
        merged: Merged<'_>,
        (exposure, set): (usize, usize),
        steps: u32,
        noise: &FrameNoise,
        into: &mut [f32],
    ) {
        let Some(at) = exposure.checked_sub(1) else {
            if set == 0 {
                into.fill(0.0);
            }
            return;
        };
        let Joining {
            ratio,
            amplitude_ratio,
        } = self.joining[at];
        let motion = self.motion_rad[set] * self.motion_rad[set];
        let amplitude = amplitude_ratio * amplitude_ratio;
        let count = steps as f32;
        let before = exposure as f32;
        // Of three steps, light's own noise follows the fringe: at most half as much again (see `phase::estimate`).
        let variance_per_frame = 0.5 * count * if steps == 3 { 1.5 } else { 1.0 };
        // What an exposure has of the sum of all.
        let share = ratio / (1.0 + ratio);
        let frame = |light: f32, frames: f32| {
            let light = light.max(0.0);
            let response = noise.response_ratio * light;
            frames * noise.dark_variance_dn2 + noise.variance_per_dn * light + response * response
        };
        for (i, into) in into.iter_mut().enumerate() {
            let light = sums.sum[i] / count - noise.offset_dn;
            let light_before = merged.sum[i] / count - before * noise.offset_dn;
            let variance = variance_per_frame
                * (frame(light, 1.0) + ratio * ratio * frame(light_before, before));
            let [re, im] = [
                sums.re[i] - ratio * merged.re[i],
                sums.im[i] - ratio * merged.im[i],
            ];
            // Along the sum of both, which is less noisy than either.
            let [all_re, all_im] = [sums.re[i] + merged.re[i], sums.im[i] + merged.im[i]];
            let square = all_re * all_re + all_im * all_im;
            let length = square.sqrt().max(f32::MIN_POSITIVE);
            let across = (im * all_re - re * all_im) / length;
            let along = (re * all_re + im * all_im) / length;
            let own = share * share * square;
            let found = across * across / (variance + motion * own)
                + along * along / (variance + amplitude * own);
            let good = sums.sum[i].is_finite();
            let comparable = usize::from(merged.exposures[i]) == exposure;
            *into = match (good, comparable) {
                (true, true) => *into + found,
                (true, false) => IMPOSSIBLE,
                (false, _) => *into,
            };
        }
    }
}

/// The exposures that went in so far, some cells of one frequency.
#[derive(Clone, Copy)]
pub(crate) struct Merged<'a> {
    re: &'a [f32],
    im: &'a [f32],
    sum: &'a [f32],
    exposures: &'a [u8],
}

impl<'a> Merged<'a> {
    pub fn new(planes: &'a Planes, exposures: &'a [u8], cells: std::ops::Range<usize>) -> Self {
        Self {
            re: &planes.re[cells.clone()],
            im: &planes.im[cells.clone()],
            sum: &planes.sum[cells.clone()],
            exposures: &exposures[cells],
        }
    }
}
