//! Converts light per core to counts per pixel, with the noise of a camera.

use super::WorldError;
use super::bundle::Bundle;
use super::random::{Normals, Purpose, stream};
use flankscope_foundation::simd::with_widest;
use rand::RngExt;
use rayon::prelude::*;
use serde::Deserialize;
use std::ops::Range;

/// The camera behind the bundle (an IMX174-class sensor).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// Full-well charge of a pixel, e⁻.
    pub full_well_e: f64,
    pub read_noise_e: f64,
    /// Counts without light, DN.
    pub offset_dn: f64,
    /// Bits per pixel.
    pub bits: u32,
    /// Fixed relative spread of the pixels' response (PRNU).
    pub prnu_ratio: f64,
    /// Relative spread of the lamp from frame to frame, common to all pixels.
    pub lamp_noise_ratio: f64,
    /// Standard deviation of one core's image, px.
    pub core_sigma_px: f64,
    /// Charge per mean pixel and millisecond in the centre of the field on a plane of reflectance 0.3 that faces the projector,
    /// all mirrors half on, e⁻.
    pub rate_e_per_ms: f64,
    /// Spread of the exponent of the cores' response to light; 0 is a linear bundle.
    pub core_exponent_spread: f64,
}

impl SensorSpec {
    /// Electrons per count: full well divided by the number of codes.
    pub fn gain_e_per_dn(&self) -> f64 {
        self.full_well_e / f64::from(1u32 << self.bits)
    }

    /// Largest count.
    pub fn max_dn(&self) -> u16 {
        ((1u32 << self.bits) - 1) as u16
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("full_well_e", self.full_well_e, 100.0, 1e7)?;
        WorldError::check("read_noise_e", self.read_noise_e, 0.0, 1e4)?;
        WorldError::check("bits", f64::from(self.bits), 8.0, 16.0)?;
        WorldError::check("offset_dn", self.offset_dn, 0.0, f64::from(self.max_dn()))?;
        WorldError::check("prnu_ratio", self.prnu_ratio, 0.0, 0.2)?;
        WorldError::check("lamp_noise_ratio", self.lamp_noise_ratio, 0.0, 0.2)?;
        WorldError::check("core_sigma_px", self.core_sigma_px, 0.3, 5.0)?;
        WorldError::check("rate_e_per_ms", self.rate_e_per_ms, 0.0, 1e6)?;
        WorldError::check("core_exponent_spread", self.core_exponent_spread, 0.0, 0.2)
    }
}

/// The pixels of a row that see the bundle.
#[derive(Clone, Debug)]
struct Span {
    row: usize,
    columns: Range<usize>,
    /// Index of its first pixel in the order of all spans.
    first: usize,
}

/// Patterns summed in one pass, so that their weights are read only once.
const BLOCK: usize = 8;

/// Cores that each pixel sees, its response, and the noise tables.
pub(crate) struct Sensor {
    spec: SensorSpec,
    size_px: [usize; 2],
    spans: Vec<Span>,
    seen: Seen,
    response: Vec<f32>,
    normals: Vec<f32>,
    dark: Vec<u16>,
    seed: u64,
}

/// Cores that the pixels of the spans see.
struct Seen {
    /// Index of the first weight of each pixel; the last entry is the total.
    starts: Vec<u32>,
    cores: Vec<u32>,
    weights: Vec<f32>,
}

/// Light rates of one view on the sensor, e⁻/ms: per span, per pattern, per pixel.
pub(crate) struct Rates {
    values: Vec<f32>,
    patterns: usize,
}

impl Rates {
    /// Frames, black included.
    pub(crate) fn patterns(&self) -> usize {
        self.patterns
    }
}

/// Length of the noise tables; a prime, so that it shares no period with the rows of any image width.
const NOISE_TABLE: usize = 1_048_583;

impl Sensor {
    pub(crate) fn new(
        spec: &SensorSpec,
        size_px: [usize; 2],
        bundle: &Bundle,
        head_seed: u64,
        run_seed: u64,
    ) -> Self {
        let (spans, seen) = seen(spec, size_px, bundle, 0.0);
        let mut random = Normals::new(stream(head_seed, Purpose::PixelResponse));
        let response = (1..seen.starts.len())
            .map(|_| (1.0 + spec.prnu_ratio * random.next()).max(0.0) as f32)
            .collect();
        let mut random = Normals::new(stream(run_seed, Purpose::NoiseTable));
        let normals: Vec<f32> = (0..NOISE_TABLE + size_px[0])
            .map(|_| random.next() as f32)
            .collect();
        let read_dn = spec.read_noise_e / spec.gain_e_per_dn();
        let max = f64::from(spec.max_dn());
        let dark = normals.iter().map(|&g| {
            (spec.offset_dn + read_dn * f64::from(g))
                .round()
                .clamp(0.0, max) as u16
        });
        let dark = dark.collect();
        Self {
            spec: spec.clone(),
            size_px,
            spans,
            seen,
            response,
            normals,
            dark,
            seed: run_seed,
        }
    }

    /// Shifts the cores' image along the rows; every pixel keeps its own response.
    pub(crate) fn shift(&mut self, bundle: &Bundle, shift_px: f64) {
        (_, self.seen) = seen(&self.spec, self.size_px, bundle, shift_px);
    }

    /// Distributes light per core (e⁻/ms per mean pixel, core by core, one entry per pattern) over the pixels.
    pub(crate) fn expose(&self, per_core: &[Vec<f32>]) -> Rates {
        let patterns = per_core.len();
        let cores = per_core.first().map_or(0, Vec::len);
        let blocks: Vec<Vec<[f32; BLOCK]>> = per_core
            .chunks(BLOCK)
            .map(|of_block| {
                let light =
                    |core: usize| std::array::from_fn(|k| of_block.get(k).map_or(0.0, |p| p[core]));
                (0..cores).into_par_iter().map(light).collect()
            })
            .collect();
        let mut values = vec![0f32; self.response.len() * patterns];
        let mut rest = values.as_mut_slice();
        let mut jobs = Vec::with_capacity(self.spans.len());
        for span in &self.spans {
            let (row, tail) = rest.split_at_mut(span.columns.len() * patterns);
            rest = tail;
            jobs.push((span, row));
        }
        jobs.into_par_iter()
            .with_min_len(8)
            .for_each(|(span, row)| {
                with_widest(
                    #[inline(always)]
                    || self.expose_span(span, &blocks, patterns, row),
                );
            });
        Rates { values, patterns }
    }

    /// Light on the pixels of a span, pattern by pattern.
    #[inline(always)]
    fn expose_span(
        &self,
        span: &Span,
        blocks: &[Vec<[f32; BLOCK]>],
        patterns: usize,
        row: &mut [f32],
    ) {
        let length = span.columns.len();
        for i in 0..length {
            let pixel = span.first + i;
            let starts = &self.seen.starts;
            let seen = starts[pixel] as usize..starts[pixel + 1] as usize;
            let response = self.response[pixel];
            for (block, light) in blocks.iter().enumerate() {
                let mut sum = [0f32; BLOCK];
                for (&core, &weight) in self.seen.cores[seen.clone()]
                    .iter()
                    .zip(&self.seen.weights[seen.clone()])
                {
                    for (s, l) in sum.iter_mut().zip(&light[core as usize]) {
                        *s += weight * l;
                    }
                }
                for (k, s) in sum.iter().enumerate().take(patterns - block * BLOCK) {
                    row[(block * BLOCK + k) * length + i] = s * response;
                }
            }
        }
    }

    /// The sum of the light of these patterns, as the only pattern.
    pub(crate) fn together(&self, rates: &Rates, lit: &[usize]) -> Rates {
        let of_span = |span: &Span| {
            let length = span.columns.len();
            let first = span.first * rates.patterns;
            (0..length).map(move |pixel| {
                let at = |pattern: &usize| rates.values[first + pattern * length + pixel];
                lit.iter().map(at).sum()
            })
        };
        Rates {
            values: self.spans.iter().flat_map(of_span).collect(),
            patterns: 1,
        }
    }

    /// One frame. `out` has one count per pixel, row by row.
    pub(crate) fn read_out(
        &self,
        rates: &Rates,
        pattern: usize,
        exposure_ms: f64,
        frame: u32,
        out: &mut [u16],
    ) {
        let mut random = stream(self.seed, Purpose::Frame(frame));
        let lamp = 1.0
            + self.spec.lamp_noise_ratio
                * f64::from(self.normals[random.random_range(0..NOISE_TABLE)]);
        let width = self.size_px[0];
        let counts = Counts {
            time_ms: (exposure_ms * lamp) as f32,
            full_e: self.spec.full_well_e as f32,
            read_e2: (self.spec.read_noise_e * self.spec.read_noise_e) as f32,
            dn_per_e: (1.0 / self.spec.gain_e_per_dn()) as f32,
            offset_dn: self.spec.offset_dn as f32,
            max_dn: f32::from(self.spec.max_dn()),
        };
        let mut spans = self.spans.iter().peekable();
        for (row, pixels) in out.chunks_exact_mut(width).enumerate() {
            let from = random.random_range(0..NOISE_TABLE);
            let Some(span) = spans.next_if(|span| span.row == row) else {
                pixels.copy_from_slice(&self.dark[from..from + width]);
                continue;
            };
            let [left, right] = [span.columns.start, span.columns.end];
            pixels[..left].copy_from_slice(&self.dark[from..from + left]);
            pixels[right..].copy_from_slice(&self.dark[from + right..from + width]);
            let length = right - left;
            let at = span.first * rates.patterns + pattern * length;
            let rates = &rates.values[at..at + length];
            let normals = &self.normals[from + left..from + right];
            let out = &mut pixels[left..right];
            with_widest(
                #[inline(always)]
                || counts.fill(rates, normals, out),
            );
        }
    }
}

const TWO_POW_23: f32 = 8_388_608.0;

/// Constants of one frame.
struct Counts {
    time_ms: f32,
    full_e: f32,
    read_e2: f32,
    dn_per_e: f32,
    offset_dn: f32,
    max_dn: f32,
}

impl Counts {
    /// Shot and read noise are independent: one normal deviate of the summed variance stands for both. A Poisson
    /// distribution below some 50 e⁻ is skewed, but there the read noise of 7 e⁻ hides it.
    #[inline(always)]
    fn fill(&self, rates: &[f32], normals: &[f32], out: &mut [u16]) {
        for ((dn, &rate), &normal) in out.iter_mut().zip(rates).zip(normals) {
            let mean = rate * self.time_ms;
            let charge = (mean + (mean + self.read_e2).sqrt() * normal).min(self.full_e);
            let count = charge * self.dn_per_e + self.offset_dn + 0.5;
            let count = count.max(0.0).min(self.max_dn).floor();
            // The last bits of a number above 2^23 count ones; a conversion that saturates is not made into vector instructions.
            *dn = (count + TWO_POW_23).to_bits() as u16;
        }
    }
}

/// Weights of one row's pixels.
struct RowWeights {
    row: usize,
    columns: Range<usize>,
    /// Index after each pixel's last weight.
    ends: Vec<u32>,
    cores: Vec<u32>,
    weights: Vec<f32>,
}

/// The pixels that see the bundle after its shift, and the cores that they see.
fn seen(
    spec: &SensorSpec,
    size_px: [usize; 2],
    bundle: &Bundle,
    shift_px: f64,
) -> (Vec<Span>, Seen) {
    let rows: Vec<RowWeights> = (0..size_px[1])
        .into_par_iter()
        .filter_map(|row| row_weights(spec, size_px, bundle, row, shift_px))
        .collect();
    let mut spans = Vec::new();
    // 12 million weights: growing the vectors would copy them several times.
    let pixels: usize = rows.iter().map(|row| row.ends.len()).sum();
    let weights: usize = rows.iter().map(|row| row.weights.len()).sum();
    let mut seen = Seen {
        starts: Vec::with_capacity(pixels + 1),
        cores: Vec::with_capacity(weights),
        weights: Vec::with_capacity(weights),
    };
    seen.starts.push(0);
    for row in rows {
        spans.push(Span {
            row: row.row,
            columns: row.columns,
            first: seen.starts.len() - 1,
        });
        let before = seen.cores.len() as u32;
        seen.starts.extend(row.ends.iter().map(|end| before + end));
        seen.cores.extend(row.cores);
        seen.weights.extend(row.weights);
    }
    (spans, seen)
}

fn row_weights(
    spec: &SensorSpec,
    size_px: [usize; 2],
    bundle: &Bundle,
    row: usize,
    shift_px: f64,
) -> Option<RowWeights> {
    let reach_px = 3.5 * spec.core_sigma_px;
    let [cx, cy] = bundle.spec().centre_px;
    let radius = 0.5 * bundle.spec().diameter_px + 2.0 * bundle.spec().pitch_px() + reach_px;
    let half = (radius * radius - (row as f64 - cy).powi(2))
        .max(0.0)
        .sqrt();
    let columns = (cx - half).ceil().max(0.0) as usize
        ..((cx + half).floor() + 1.0).clamp(0.0, size_px[0] as f64) as usize;
    if columns.is_empty() {
        return None;
    }
    // A core's light is spread over a cell of the lattice: rates are per mean pixel.
    let pitch = bundle.spec().pitch_px();
    let variance = spec.core_sigma_px * spec.core_sigma_px;
    let cell_px2 = 0.5 * 3f64.sqrt() * pitch * pitch;
    let peak = cell_px2 / (std::f64::consts::TAU * variance);
    // Cores within reach of a pixel, on a perfect lattice, and some more for its jitter.
    let expected = 1.1 * std::f64::consts::PI * reach_px * reach_px / cell_px2;
    let expected = (expected * columns.len() as f64) as usize;
    let mut found = RowWeights {
        row,
        columns: columns.clone(),
        ends: Vec::with_capacity(columns.len()),
        cores: Vec::with_capacity(expected),
        weights: Vec::with_capacity(expected),
    };
    for column in columns {
        let at = [column as f64 - shift_px, row as f64];
        for core in bundle.near(at, reach_px).flatten() {
            let [x, y] = bundle.positions_px()[core];
            let distance2 = (x - at[0]).powi(2) + (y - at[1]).powi(2);
            if distance2 < reach_px * reach_px {
                found.cores.push(core as u32);
                found
                    .weights
                    .push((peak * (-0.5 * distance2 / variance).exp()) as f32);
            }
        }
        found.ends.push(found.cores.len() as u32);
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_those_of_a_conversion_that_saturates() {
        let counts = Counts {
            time_ms: 1.7,
            full_e: 30_000.0,
            read_e2: 49.0,
            dn_per_e: 4096.0 / 32_500.0,
            offset_dn: 0.2,
            max_dn: 4095.0,
        };
        let mut random = Normals::new(stream(1, Purpose::NoiseTable));
        let normals: Vec<f32> = (0..100_003).map(|_| random.next() as f32).collect();
        let mut rates: Vec<f32> = (0..normals.len())
            .map(|i| 25_000.0 * (i as f32 / normals.len() as f32).powi(3))
            .collect();
        // What no scene gives: no light at all, more than any pixel holds, and no number.
        rates[..4].copy_from_slice(&[0.0, 1e30, f32::INFINITY, f32::NAN]);
        let mut got = vec![0; rates.len()];
        with_widest(
            #[inline(always)]
            || counts.fill(&rates, &normals, &mut got),
        );
        let expected = rates.iter().zip(&normals).map(|(rate, normal)| {
            let mean = rate * counts.time_ms;
            let charge = (mean + (mean + counts.read_e2).sqrt() * normal).min(counts.full_e);
            let count = charge * counts.dn_per_e + counts.offset_dn + 0.5;
            count.clamp(0.0, counts.max_dn) as u16
        });
        assert_eq!(got, expected.collect::<Vec<_>>());
        assert!(got.contains(&0) && got.contains(&3781), "{:?}", &got[..4]);
    }
}
