//! Test whether the exposures of a cell show the same scene.
//!
//! Two exposures of one scene have one phase, and amplitudes in the ratio of their times. An exposure that saturates nowhere in
//! the cell is therefore compared with the sum of those before it, frequency by frequency, before it joins them. With `r` the ratio
//! of its time to theirs, the difference of phasors `D = C - r C_before` is noise. Its part across the phasor belongs to the phase,
//! its part along the phasor to the amplitude; each is squared and divided by its predicted variance. Noise alone leaves a
//! chi-square distribution with two degrees of freedom for every frequency and every exposure that joined others, and these are
//! independent of each other, since the variances are in the ratio of the times, too.
//!
//! The means are not compared: offset and ambient light enter them, which one dark frame at one exposure does not determine,
//! and no depth depends on them.

use super::band::Planes;
use super::consistency::{FrameNoise, Sums};

/// Motion of head and press between two exposures, as a standard deviation of the finest frequency's phase: about 1 µm of
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

/// Exposures and patterns for the comparison.
#[derive(Debug)]
pub(crate) struct Agreement {
    /// One entry per exposure after the first.
    joining: Vec<Joining>,
    /// Standard deviation of each frequency's phase by motion, rad.
    motion_rad: Vec<f32>,
}

/// An exposure relative to the sum of those before it.
#[derive(Clone, Copy, Debug)]
struct Joining {
    /// Ratio of its exposure time to the sum of theirs.
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
        merged: MergedExposures<'_>,
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
        let per_frame = 1.0 / count;
        let before = exposure as f32;
        // With three steps shot noise follows the fringe: at most half as much again (see `phase::estimate`).
        let variance_per_frame = 0.5 * count * if steps == 3 { 1.5 } else { 1.0 };
        // Share of one exposure in the sum of all.
        let share = ratio / (1.0 + ratio);
        let frame = |light: f32, frames: f32| {
            let light = light.max(0.0);
            let response = noise.response_ratio * light;
            frames * noise.dark_variance_dn2 + noise.variance_per_dn * light + response * response
        };
        // Slices of one length, and no branch in the loop: the compiler then takes several cells at once.
        let cells = into.len();
        let [re, im, sum] = [sums.re, sums.im, sums.sum].map(|plane| &plane[..cells]);
        let [re_before, im_before, sum_before] =
            [merged.re, merged.im, merged.sum].map(|plane| &plane[..cells]);
        let exposures = &merged.exposures[..cells];
        let joined = exposure as u8;
        for i in 0..cells {
            let light = sum[i] * per_frame - noise.offset_dn;
            let light_before = sum_before[i] * per_frame - before * noise.offset_dn;
            let variance = variance_per_frame
                * (frame(light, 1.0) + ratio * ratio * frame(light_before, before));
            let off_re = re[i] - ratio * re_before[i];
            let off_im = im[i] - ratio * im_before[i];
            // Along the sum of both, which is less noisy than either.
            let (all_re, all_im) = (re[i] + re_before[i], im[i] + im_before[i]);
            let square = (all_re * all_re + all_im * all_im).max(f32::MIN_POSITIVE);
            let across = off_im * all_re - off_re * all_im;
            let along = off_re * all_re + off_im * all_im;
            let own = share * share * square;
            let found = (across * across / (variance + motion * own)
                + along * along / (variance + amplitude * own))
                / square;
            let comparable = exposures[i] == joined;
            let found = if comparable {
                into[i] + found
            } else {
                IMPOSSIBLE
            };
            into[i] = if sum[i].is_finite() { found } else { into[i] };
        }
    }
}

/// The exposures that went in so far, some cells of one frequency.
#[derive(Clone, Copy)]
pub(crate) struct MergedExposures<'a> {
    re: &'a [f32],
    im: &'a [f32],
    sum: &'a [f32],
    exposures: &'a [u8],
}

impl<'a> MergedExposures<'a> {
    pub fn new(planes: &'a Planes, exposures: &'a [u8], cells: std::ops::Range<usize>) -> Self {
        Self {
            re: &planes.re[cells.clone()],
            im: &planes.im[cells.clone()],
            sum: &planes.sum[cells.clone()],
            exposures: &exposures[cells],
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use flankscope_test_requisites::Random;

    use super::*;
    use crate::accumulate::consistency;

    const EXPOSURES_US: [u32; 3] = [4_000, 10_000, 40_000];
    const PERIODS: [f64; 2] = [4.0, 48.0];
    const GAIN_E_PER_DN: f64 = 8.0;
    const OFFSET_DN: f64 = 100.0;
    const DARK_VARIANCE_E2: f64 = 60.0;
    const NOISE: FrameNoise = FrameNoise {
        offset_dn: OFFSET_DN as f32,
        dark_variance_dn2: (DARK_VARIANCE_E2 / (GAIN_E_PER_DN * GAIN_E_PER_DN)) as f32,
        variance_per_dn: (1.0 / GAIN_E_PER_DN) as f32,
        response_ratio: 0.0,
    };

    /// A cell's light: electrons per ms in the mean, contrast, and phase of either frequency.
    #[derive(Clone, Copy)]
    struct CellLight {
        mean_e_per_ms: f64,
        contrast: f64,
        phase_rad: [f64; 2],
    }

    /// Light of the middle exposure of a bright core: 40 000 electrons.
    const BRIGHT: CellLight = CellLight {
        mean_e_per_ms: 4_000.0,
        contrast: 0.5,
        phase_rad: [0.7, -2.1],
    };

    /// Sums of one exposure and frequency: real part, imaginary part, sum.
    fn sums(steps: u32, mut frame_dn: impl FnMut(f64) -> f64) -> [f32; 3] {
        let mut sums = [0.0; 3];
        for n in 0..steps {
            let shift = TAU * f64::from(n) / f64::from(steps);
            let dn = frame_dn(shift);
            sums[0] += dn * shift.cos();
            sums[1] -= dn * shift.sin();
            sums[2] += dn;
        }
        sums.map(|sum| sum as f32)
    }

    /// The statistic of a cell that shows `scenes[e]` at exposure `e`, saturated where there is none.
    fn found(
        agreement: &Agreement,
        steps: [u32; 2],
        scenes: [Option<CellLight>; 3],
        mut noise: impl FnMut() -> f64,
    ) -> f32 {
        let mut into = [7.0];
        let mut merged = [[0.0_f32; 3]; 2];
        let mut joined = [0_u8; 2];
        for (exposure, (scene, time_us)) in scenes.into_iter().zip(EXPOSURES_US).enumerate() {
            for set in 0..2 {
                let frame_dn = |shift: f64| {
                    let Some(scene) = scene else {
                        return f64::INFINITY;
                    };
                    let mean_e = scene.mean_e_per_ms * 1e-3 * f64::from(time_us);
                    let fringe = scene.contrast * (scene.phase_rad[set] + shift).cos();
                    let light_e = mean_e * (1.0 + fringe);
                    let drawn_e = light_e + noise() * (light_e + DARK_VARIANCE_E2).sqrt();
                    OFFSET_DN + drawn_e / GAIN_E_PER_DN
                };
                let [re, im, sum] = sums(steps[set], frame_dn);
                let new = Sums {
                    re: &[re],
                    im: &[im],
                    sum: &[sum],
                    first: &[0.0],
                    squares: &[0.0],
                };
                let [merged_re, merged_im, merged_sum] = merged[set];
                let before = MergedExposures {
                    re: &[merged_re],
                    im: &[merged_im],
                    sum: &[merged_sum],
                    exposures: &[joined[set]],
                };
                agreement.add(new, before, (exposure, set), steps[set], &NOISE, &mut into);
                if sum.is_finite() {
                    for (merged, new) in merged[set].iter_mut().zip([re, im, sum]) {
                        *merged += new;
                    }
                    joined[set] += 1;
                }
            }
        }
        into[0]
    }

    fn agreement() -> Agreement {
        Agreement::new(&EXPOSURES_US, &PERIODS).unwrap()
    }

    /// With nothing beside noise allowed for.
    fn of_noise_alone() -> Agreement {
        let mut agreement = agreement();
        agreement.motion_rad = vec![0.0; 2];
        for joining in &mut agreement.joining {
            joining.amplitude_ratio = 0.0;
        }
        agreement
    }

    /// Standard normal numbers, the same in every run.
    fn normal() -> impl FnMut() -> f64 {
        let mut random = Random(11);
        let mut uniform = move || random.uniform() + 0.5 / (1_u64 << 53) as f64;
        move || (-2.0 * uniform().ln()).sqrt() * (TAU * uniform()).cos()
    }

    #[test]
    fn noise_alone_exceeds_the_limit_as_often_as_asked() {
        let agreement = of_noise_alone();
        assert_eq!(agreement.most_freedom(), 8);
        let dim = CellLight {
            mean_e_per_ms: 80.0,
            ..BRIGHT
        };
        let draws = 40_000;
        for scene in [BRIGHT, dim] {
            let mut noise = normal();
            let drawn: Vec<f32> = (0..draws)
                .map(|_| found(&agreement, [4, 8], [Some(scene); 3], &mut noise))
                .collect();
            for probability in [0.05, 1e-3] {
                let limit = consistency::limits(probability, 8)[8];
                let beyond = drawn.iter().filter(|&&found| found > limit).count() as f64;
                let expected = f64::from(draws) * probability;
                // Four standard deviations of the count, and what the limit is approximate by.
                let allowed = 4.0 * expected.sqrt() + 0.05 * expected;
                assert!(
                    (beyond - expected).abs() < allowed,
                    "{beyond} of {expected}"
                );
            }
            // Three steps: no more often.
            let limit = consistency::limits(0.05, 8)[8];
            let of_three = (0..draws)
                .filter(|_| found(&agreement, [3, 3], [Some(scene); 3], &mut noise) > limit)
                .count();
            assert!(of_three as f64 <= 0.05 * f64::from(draws));
        }
    }

    /// Asserts whether a change of the scene in one of three exposures exceeds the limits.
    #[track_caller]
    fn disagrees(change: impl Fn(&mut CellLight), expected: bool) {
        let mut other = BRIGHT;
        change(&mut other);
        let limit = consistency::limits(1e-3, 8)[8];
        for at in 0..3 {
            let mut scenes = [Some(BRIGHT); 3];
            scenes[at] = Some(other);
            let found = found(&agreement(), [4, 8], scenes, || 0.0);
            assert_eq!(found > limit, expected, "exposure {at}: {found}");
        }
    }

    #[test]
    fn another_scene_in_one_exposure_is_found_at_every_frequency() {
        // Damage 10 um deep: 0.15 rad of fringes of 0.2 mm, a twelfth of that at the coarse frequency.
        disagrees(
            |scene| scene.phase_rad = [scene.phase_rad[0] + 0.0125, scene.phase_rad[1] + 0.15],
            true,
        );
        // A whole fringe of the finest frequency: the coarse one alone shows it.
        disagrees(|scene| scene.phase_rad[0] += TAU / 12.0, true);
        disagrees(|scene| scene.phase_rad[1] += 0.3, true);
        // The same place, but fringes half as strong.
        disagrees(|scene| scene.contrast *= 0.5, true);
        disagrees(|scene| scene.mean_e_per_ms *= 1.3, true);
    }

    #[test]
    fn motion_of_a_micrometre_and_a_drifting_lamp_are_one_scene() {
        disagrees(|_| {}, false);
        disagrees(
            |scene| {
                scene.phase_rad[0] += MOTION_RAD / 12.0;
                scene.phase_rad[1] += MOTION_RAD;
                scene.mean_e_per_ms *= 1.003;
            },
            false,
        );
    }

    #[test]
    fn a_cell_is_compared_where_several_exposures_do_not_saturate() {
        let shown = |scenes| found(&agreement(), [4, 8], scenes, || 0.0);
        let scene = Some(BRIGHT);
        assert!(shown([scene, None, None]).abs() < 1e-3);
        assert!(shown([None; 3]).abs() < 1e-3);
        // Brighter at a shorter exposure than at a longer one.
        assert!(shown([None, scene, scene]) >= IMPOSSIBLE);
        assert!(shown([scene, None, scene]) >= IMPOSSIBLE);
        assert!(shown([None, None, scene]) >= IMPOSSIBLE);
    }

    #[test]
    fn a_single_exposure_is_compared_with_nothing() {
        assert!(Agreement::new(&[10_000], &PERIODS).is_none());
    }
}
