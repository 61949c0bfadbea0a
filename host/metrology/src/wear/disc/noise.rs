//! What noise of the cells makes of a largest mean: bias and scatter, from simulated captures.

use std::sync::LazyLock;

use flankscope_foundation::random::normal;
use flankscope_foundation::simd::with_widest;
use rayon::prelude::*;

use super::overlap::Kernel;
use super::{Discs, LANES};
use crate::wear::field::Field;

/// Simulated captures: the scatter of a maximum is then known to 7 %.
pub(super) const DRAWS: usize = 100;

/// Normal deviates, used over and over: the same for every flank, so that the same points give the same bytes.
pub(super) static DEVIATES: LazyLock<Vec<f32>> =
    LazyLock::new(|| (0..1 << 16).map(|i| normal(0x5eed, i) as f32).collect());

/// Draws them in advance, which shortens the first evaluation.
pub(in crate::wear) fn prepare() {
    LazyLock::force(&DEVIATES);
}

impl Discs<'_> {
    /// Bias of the maximum of loss and of proud material by noise, as stated and scaled; and the maximum's scatter by the
    /// scaled noise, mm. Both feel the same draws of noise, whose means over the discs are computed once.
    pub(super) fn of_noise(&self, noise_scale: f64) -> [[f64; 3]; 2] {
        let kernel = self.kernel();
        let padded = Padded::new(self.field, &kernel);
        // Unmeasured cells contribute neither wear nor noise.
        let value = padded.pad(self.field.wear_mm.iter().copied());
        let sigma = padded.pad(self.field.variance_mm2.iter().map(|v| v.sqrt()));
        let places: Vec<usize> = self
            .middles()
            .into_iter()
            .map(|at| padded.index(at))
            .collect();
        let means: Vec<f32> = places.iter().map(|&at| padded.mean(&value, at)).collect();
        let largest = [1.0_f32, -1.0].map(|sign| {
            means
                .iter()
                .map(|mean| sign * mean)
                .fold(f32::NEG_INFINITY, f32::max)
        });
        if !largest.iter().all(|largest| largest.is_finite()) {
            return [[f64::NAN; 3]; 2];
        }
        // A disc so far below the largest that no noise lifts it above takes no part.
        let weights2: f64 = kernel.0.iter().map(|(_, share)| share * share).sum();
        let worst = f64::from(sigma.iter().copied().fold(0.0, f32::max)) * weights2.sqrt();
        let reach = (8.0 * worst * noise_scale) as f32;
        // A disc is no rival on a side where it starts at minus infinity.
        let rivals: Vec<(usize, [f32; 2])> = places
            .into_iter()
            .zip(means)
            .map(|(at, mean)| {
                let of = |k: usize, mean: f32| {
                    if mean >= largest[k] - reach {
                        mean
                    } else {
                        f32::NEG_INFINITY
                    }
                };
                (at, [of(0, mean), of(1, -mean)])
            })
            .filter(|(_, of)| of.iter().any(|mean| mean.is_finite()))
            .collect();
        let groups = (0..DRAWS.div_ceil(LANES)).into_par_iter().map(|group| {
            with_widest(
                #[inline(always)]
                || padded.most_by_noise(&sigma, group * LANES, &rivals, noise_scale as f32),
            )
        });
        let groups: Vec<_> = groups.collect();
        let mut lifts = [[[0.0_f64; 2]; DRAWS]; 2];
        for draw in 0..DRAWS {
            for side in 0..2 {
                let most = groups[draw / LANES][side].map(|lanes| lanes[draw % LANES]);
                lifts[side][draw] = most.map(|most| f64::from(most - largest[side]));
            }
        }
        lifts.map(|lifts| {
            let mean = |k: usize| lifts.iter().map(|l| l[k]).sum::<f64>() / DRAWS as f64;
            let scaled = mean(1);
            let squares: f64 = lifts.iter().map(|l| (l[1] - scaled).powi(2)).sum();
            [
                mean(0).max(0.0),
                scaled.max(0.0),
                (squares / (DRAWS - 1) as f64).sqrt(),
            ]
        })
    }
}

/// Cells with a margin as wide as a disc, so that a mean over a disc needs no check of the zone's border.
pub(super) struct Padded {
    columns: usize,
    rows: usize,
    margin: [usize; 2],
    /// Steps to the cells of a disc, and their shares of it.
    steps: Vec<(isize, f32)>,
}

impl Padded {
    pub(super) fn new(field: &Field, kernel: &Kernel) -> Self {
        let margin = [0, 1].map(|k| {
            let reach = kernel.0.iter().map(|(step, _)| step[k].unsigned_abs());
            reach.max().unwrap_or(0)
        });
        let columns = field.columns + 2 * margin[0];
        let step =
            |&([dx, dy], share): &([isize; 2], f64)| (dy * columns as isize + dx, share as f32);
        Self {
            columns,
            rows: field.rows + 2 * margin[1],
            margin,
            steps: kernel.0.iter().map(step).collect(),
        }
    }

    pub(super) fn index(&self, [column, row]: [usize; 2]) -> usize {
        (row + self.margin[1]) * self.columns + column + self.margin[0]
    }

    /// A field's cells; zero where they are not finite.
    pub(super) fn pad(&self, cells: impl Iterator<Item = f64>) -> Vec<f32> {
        let mut padded = vec![0.0; self.columns * self.rows];
        let inner = self.columns - 2 * self.margin[0];
        for (i, value) in cells.enumerate().filter(|(_, value)| value.is_finite()) {
            padded[self.index([i % inner, i / inner])] = value as f32;
        }
        padded
    }

    /// Mean over the disc on a cell of the zone.
    pub(super) fn mean(&self, cells: &[f32], at: usize) -> f32 {
        let cell = |step: isize| cells[at.wrapping_add_signed(step)];
        self.steps
            .iter()
            .map(|&(step, share)| share * cell(step))
            .sum()
    }

    /// The largest mean of any rival in each of so many draws of noise from `first_draw` on, by side: with the noise as stated, and scaled.
    #[inline(always)]
    fn most_by_noise(
        &self,
        sigma: &[f32],
        first_draw: usize,
        rivals: &[(usize, [f32; 2])],
        noise_scale: f32,
    ) -> [[[f32; LANES]; 2]; 2] {
        let deviates = &*DEVIATES;
        let mut noise = vec![[0.0_f32; LANES]; sigma.len()];
        for lane in 0..LANES {
            let first = (first_draw + lane) * sigma.len();
            for (i, noise) in noise.iter_mut().enumerate() {
                noise[lane] = sigma[i] * deviates[(first + i) % deviates.len()];
            }
        }
        let mut most = [[[f32::NEG_INFINITY; LANES]; 2]; 2];
        for &(at, means) in rivals {
            let mut of_noise = [0.0_f32; LANES];
            for &(step, share) in &self.steps {
                let cell = &noise[at.wrapping_add_signed(step)];
                for lane in 0..LANES {
                    of_noise[lane] += share * cell[lane];
                }
            }
            for side in 0..2 {
                for (k, scale) in [1.0, noise_scale].into_iter().enumerate() {
                    let most = &mut most[side][k];
                    for lane in 0..LANES {
                        let mean = means[side] + scale * of_noise[lane];
                        most[lane] = if mean > most[lane] { mean } else { most[lane] };
                    }
                }
            }
        }
        most
    }
}
