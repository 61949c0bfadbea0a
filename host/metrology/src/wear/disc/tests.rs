use flankscope_foundation::random::{normal, uniform};

use super::noise::{DEVIATES, DRAWS, Padded};
use super::*;

impl Discs<'_> {
    /// One side alone, step by step: what [`Discs::largest`] has to equal. The largest mean loss (`sign` 1) or the largest
    /// mean height of proud material (-1). None when no disc fits.
    ///
    /// `noise_scale` is the ratio of the cells' noise to the stated one.
    fn largest_of(&self, sign: f64, noise_scale: f64) -> Option<Peak> {
        if !self.fits() {
            return None;
        }
        let [columns, rows] = [0, 1].map(|axis| self.lattice(axis, STEPS_PER_CELL));
        let mut tried: Vec<(f64, [f64; 2])> = Vec::with_capacity(columns.len() * rows.len());
        for &y in &rows {
            for &x in &columns {
                tried.push((self.mean_mm([x, y], sign), [x, y]));
            }
        }
        let count = CLIMBS.min(tried.len());
        tried.select_nth_unstable_by(count - 1, |a, b| b.0.total_cmp(&a.0));
        let (raw_mm, at_mm) = tried[..count]
            .iter()
            .map(|&from| self.climb(from, sign))
            .max_by(|a, b| a.0.total_cmp(&b.0))?;
        let [bias_mm, scaled_bias_mm, scatter_mm] = self.of_noise_of(sign, noise_scale);
        Some(Peak {
            raw_mm,
            at_mm,
            bias_mm,
            // Only the bias of the stated noise is subtracted: the excess over it might be wear.
            // Rectangular between the two.
            u_mm: scatter_mm
                .hypot((scaled_bias_mm - bias_mm) / 3f64.sqrt())
                .hypot(self.sampling_mm(at_mm, noise_scale)),
        })
    }

    /// By how much noise lifts the maximum: as stated, scaled; and the maximum's scatter by the scaled noise, mm.
    fn of_noise_of(&self, sign: f64, noise_scale: f64) -> [f64; 3] {
        let kernel = self.kernel();
        let padded = Padded::new(self.field, &kernel);
        // Unmeasured cells contribute neither wear nor noise.
        let value = padded.pad(self.field.wear_mm.iter().map(|&w| sign * w));
        let sigma = padded.pad(self.field.variance_mm2.iter().map(|v| v.sqrt()));
        let places: Vec<usize> = self
            .middles()
            .into_iter()
            .map(|at| padded.index(at))
            .collect();
        let means: Vec<f32> = places.iter().map(|&at| padded.mean(&value, at)).collect();
        let largest = means.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        if !largest.is_finite() {
            return [f64::NAN; 3];
        }
        // A disc so far below the largest that no noise lifts it above takes no part.
        let weights2: f64 = kernel.0.iter().map(|(_, share)| share * share).sum();
        let worst = f64::from(sigma.iter().copied().fold(0.0, f32::max)) * weights2.sqrt();
        let reach = (8.0 * worst * noise_scale) as f32;
        let rivals: Vec<(usize, f32)> = places
            .into_iter()
            .zip(means)
            .filter(|(_, mean)| *mean >= largest - reach)
            .collect();
        let deviates = &*DEVIATES;
        let mut lifts = [[0.0_f64; 2]; DRAWS];
        let mut noise = vec![0.0_f32; sigma.len()];
        for (draw, lift) in lifts.iter_mut().enumerate() {
            for (i, noise) in noise.iter_mut().enumerate() {
                *noise = sigma[i] * deviates[(draw * sigma.len() + i) % deviates.len()];
            }
            let mut most = [f32::NEG_INFINITY; 2];
            for &(at, mean) in &rivals {
                let of_noise = padded.mean(&noise, at);
                most = [
                    most[0].max(mean + of_noise),
                    most[1].max(mean + noise_scale as f32 * of_noise),
                ];
            }
            *lift = most.map(|m| f64::from(m - largest));
        }
        let mean = |k: usize| lifts.iter().map(|l| l[k]).sum::<f64>() / DRAWS as f64;
        let scaled = mean(1);
        let squares: f64 = lifts.iter().map(|l| (l[1] - scaled).powi(2)).sum();
        [
            mean(0).max(0.0),
            scaled.max(0.0),
            (squares / (DRAWS - 1) as f64).sqrt(),
        ]
    }
}

/// Samples over a zone, some seven a cell, in every third seed with a step of 50 µm, in every second with a corner that has
/// none; and the cells' means.
fn drawn(seed: u64) -> (Field, Vec<WearSample>) {
    let mut field = Field::unmeasured([1.7, 6.0], 0.11);
    let samples: Vec<WearSample> = (0..6000)
        .map(|i| {
            let u = |k: u64| uniform(seed, 3 * i + k);
            let at_mm = [1.7 * u(0), 6.0 * u(1)];
            let step = if at_mm[1] > 4.0 && seed.is_multiple_of(3) {
                0.05
            } else {
                0.0
            };
            WearSample::of_point(at_mm, step + 1e-3 * normal(seed + 50, i), 0.25e-6)
        })
        .filter(|s| seed.is_multiple_of(2) || s.at_mm[0] < 1.2 || s.at_mm[1] > 2.0)
        .collect();
    let mut sums = vec![[0.0; 3]; field.wear_mm.len()];
    for s in &samples {
        if let Some(cell) = field.cell_at(s.at_mm) {
            sums[cell][0] += 1.0;
            sums[cell][1] += s.wear_mm;
            sums[cell][2] += s.variance_mm2;
        }
    }
    for (i, [n, wear, variance]) in sums.into_iter().enumerate() {
        field.wear_mm[i] = wear / n;
        field.variance_mm2[i] = variance / (n * n);
    }
    (field, samples)
}

#[test]
fn both_sides_at_once_are_as_each_alone() {
    for seed in 0..12 {
        let (field, samples) = drawn(seed);
        let discs = Discs::new(&field, &samples, 0.25);
        let both = discs.largest(1.7).unwrap();
        let alone = [1.0, -1.0].map(|sign| discs.largest_of(sign, 1.7).unwrap());
        assert_eq!(both, alone, "{seed}");
    }
}

/// Cell by cell and sample by sample, over the whole zone, wherever the disc lies.
#[test]
fn means_over_discs_are_those_of_a_plain_loop() {
    for seed in 0..4 {
        let (field, samples) = drawn(seed);
        let discs = Discs::new(&field, &samples, 0.25);
        let mut cells: Vec<Vec<&WearSample>> = vec![Vec::new(); field.wear_mm.len()];
        for sample in &samples {
            cells[field.cell_at(sample.at_mm).unwrap()].push(sample);
        }
        let radius_mm = (0.25 / std::f64::consts::PI).sqrt();
        for k in 0..50 {
            // Anywhere in the zone of 1.7 by 6 mm.
            let middle = [(1.1, 0), (5.4, 1)]
                .map(|(room, axis)| 0.3 + room * uniform(seed + 100, 2 * k + axis));
            let (mut sum, mut weight) = (0.0, 0.0);
            for cell in &cells {
                for sample in cell {
                    let off_mm = [0, 1].map(|axis| sample.at_mm[axis] - middle[axis]);
                    if off_mm[0].hypot(off_mm[1]) <= radius_mm {
                        sum += sample.wear_mm / cell.len() as f64;
                        weight += 1.0 / cell.len() as f64;
                    }
                }
            }
            let seen = 1.0 - discs.unmeasured_share(middle);
            let expected_mm = if weight > 0.0 {
                sum / weight * seen
            } else {
                0.0
            };
            let got_mm = discs.mean_mm(middle, 1.0);
            let off_mm = (got_mm - expected_mm).abs();
            assert!(off_mm < 1e-12, "{seed} {middle:?}: {got_mm} {expected_mm}");
        }
    }
}
