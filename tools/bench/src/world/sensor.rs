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

/// Half the side of a core's image, in its standard deviations.
const REACH_SIGMA: f64 = 3.5;

/// Where each core's light falls, every pixel's response, and the noise tables.
pub(crate) struct Sensor {
    spec: SensorSpec,
    size_px: [usize; 2],
    spans: Vec<Span>,
    images: CoreImages,
    response: Vec<f32>,
    normals: Vec<f32>,
    dark: Vec<u16>,
    seed: u64,
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
        let spans = spans(spec, size_px, bundle);
        let images = CoreImages::new(spec, &spans, bundle, 0.0);
        let mut random = Normals::new(stream(head_seed, Purpose::PixelResponse));
        let pixels = spans.iter().map(|span| span.columns.len()).sum();
        let response = (0..pixels)
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
            images,
            response,
            normals,
            dark,
            seed: run_seed,
        }
    }

    /// Shifts the cores' image along the rows; every pixel keeps its own response.
    pub(crate) fn shift(&mut self, bundle: &Bundle, shift_px: f64) {
        self.images = CoreImages::new(&self.spec, &self.spans, bundle, shift_px);
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
            .enumerate()
            .with_min_len(8)
            .for_each_init(Vec::new, |pixels, (number, (span, row))| {
                with_widest(
                    #[inline(always)]
                    || self.expose_span(number, span, &blocks, pixels, row),
                );
            });
        Rates { values, patterns }
    }

    /// Light on the pixels of a span, pattern by pattern; `pixels` is room for it.
    #[inline(always)]
    fn expose_span(
        &self,
        number: usize,
        span: &Span,
        blocks: &[Vec<[f32; BLOCK]>],
        pixels: &mut Vec<[f32; BLOCK]>,
        row: &mut [f32],
    ) {
        let length = span.columns.len();
        let width = self.images.width;
        let response = &self.response[span.first..span.first + length];
        for (light, rows) in blocks.iter().zip(row.chunks_mut(BLOCK * length)) {
            pixels.clear();
            pixels.resize(length + 2 * width, [0.0; BLOCK]);
            self.images.add(number, light, pixels);
            for (k, of_pattern) in rows.chunks_exact_mut(length).enumerate() {
                for ((to, sums), response) in
                    of_pattern.iter_mut().zip(&pixels[width..]).zip(response)
                {
                    *to = sums[k] * response;
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

/// The images of all cores on the sensor. A Gaussian is the product of one along the rows and one along the columns, so a core needs
/// as many weights as its image has columns and rows, not as it has pixels.
struct CoreImages {
    /// Columns of a core's image.
    width: usize,
    /// Weights of its columns, core by core.
    along_row: Vec<f32>,
    /// Index of the first entry of each span; the last one is the total.
    starts: Vec<u32>,
    /// Cores that light a span.
    entries: Vec<LitRow>,
}

/// A row of a core's image.
#[derive(Clone, Copy)]
struct LitRow {
    core: u32,
    /// First column of the core's image, counted from `width` columns before the span.
    first: u32,
    weight: f32,
}

impl CoreImages {
    fn new(spec: &SensorSpec, spans: &[Span], bundle: &Bundle, shift_px: f64) -> Self {
        let reach_px = REACH_SIGMA * spec.core_sigma_px;
        let width = (2.0 * reach_px).floor() as usize + 1;
        let pitch = bundle.spec().pitch_px();
        let variance = spec.core_sigma_px * spec.core_sigma_px;
        let gauss = |offset_px: f64| (-0.5 * offset_px * offset_px / variance).exp();
        // A core's light is spread over a cell of the lattice: rates are per mean pixel.
        let peak = 0.5 * 3f64.sqrt() * pitch * pitch / (std::f64::consts::TAU * variance);
        let place = |&[x, y]: &[f64; 2]| [x + shift_px, y];
        let first = |at: f64| (at - reach_px).ceil();
        let along_row = bundle.positions_px().par_iter().flat_map_iter(|at| {
            let [x, _] = place(at);
            (0..width).map(move |column| gauss(first(x) + column as f64 - x) as f32)
        });
        // Spans are rows that follow each other.
        let top = spans.first().map_or(0, |span| span.row);
        let lit = |core: usize| {
            let [x, y] = place(&bundle.positions_px()[core]);
            (0..width).filter_map(move |row| {
                let row = first(y) + row as f64;
                let at = (row >= top as f64).then_some(row as usize - top)?;
                let span = spans.get(at)?;
                let first = first(x) - span.columns.start as f64 + width as f64;
                let inside = first >= 0.0 && first <= (span.columns.len() + width) as f64;
                inside.then(|| {
                    let entry = LitRow {
                        core: core as u32,
                        first: first as u32,
                        weight: (peak * gauss(row - y)) as f32,
                    };
                    (at, entry)
                })
            })
        };
        let cores = 0..bundle.positions_px().len();
        let mut starts = vec![0u32; spans.len() + 1];
        for (at, _) in cores.clone().flat_map(lit) {
            starts[at + 1] += 1;
        }
        for at in 0..spans.len() {
            starts[at + 1] += starts[at];
        }
        let nothing = LitRow {
            core: 0,
            first: 0,
            weight: 0.0,
        };
        let mut entries = vec![nothing; starts[spans.len()] as usize];
        let mut next = starts.clone();
        for (at, entry) in cores.flat_map(lit) {
            entries[next[at] as usize] = entry;
            next[at] += 1;
        }
        Self {
            width,
            along_row: along_row.collect(),
            starts,
            entries,
        }
    }

    /// Adds up the light of a span's pixels, `width` columns before and behind it included.
    #[inline(always)]
    fn add(&self, span: usize, light: &[[f32; BLOCK]], pixels: &mut [[f32; BLOCK]]) {
        let entries = self.starts[span] as usize..self.starts[span + 1] as usize;
        for entry in &self.entries[entries] {
            let core = entry.core as usize;
            let light = light[core].map(|light| light * entry.weight);
            let columns = &self.along_row[core * self.width..][..self.width];
            for (pixel, &column) in pixels[entry.first as usize..].iter_mut().zip(columns) {
                for (sum, light) in pixel.iter_mut().zip(&light) {
                    *sum += column * light;
                }
            }
        }
    }
}

/// The pixels that see the bundle, row by row.
fn spans(spec: &SensorSpec, size_px: [usize; 2], bundle: &Bundle) -> Vec<Span> {
    let [cx, cy] = bundle.spec().centre_px;
    let radius = 0.5 * bundle.spec().diameter_px
        + 2.0 * bundle.spec().pitch_px()
        + REACH_SIGMA * spec.core_sigma_px;
    let mut spans = Vec::new();
    let mut first = 0;
    for row in 0..size_px[1] {
        let half = (radius * radius - (row as f64 - cy).powi(2))
            .max(0.0)
            .sqrt();
        let columns = (cx - half).ceil().max(0.0) as usize
            ..((cx + half).floor() + 1.0).clamp(0.0, size_px[0] as f64) as usize;
        if !columns.is_empty() {
            let length = columns.len();
            spans.push(Span {
                row,
                columns,
                first,
            });
            first += length;
        }
    }
    spans
}

#[cfg(test)]
mod tests {
    use super::super::bundle::BundleSpec;
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

    /// A sensor of 40 x 30 pixels behind a bundle that reaches beyond its right edge, without noise of the pixels.
    fn small() -> (SensorSpec, Bundle) {
        let spec = SensorSpec {
            full_well_e: 32_500.0,
            read_noise_e: 7.0,
            offset_dn: 2.0,
            bits: 12,
            prnu_ratio: 0.0,
            lamp_noise_ratio: 0.0,
            core_sigma_px: 0.9,
            rate_e_per_ms: 300.0,
            core_exponent_spread: 0.0,
        };
        let bundle = BundleSpec {
            cores: 200,
            diameter_px: 27.0,
            centre_px: [29.3, 14.2],
            rotation_rad: 0.1,
            jitter_ratio: 0.1,
            gain_spread_ratio: 0.1,
            dead_ratio: 0.0,
            crosstalk_ratio: 0.0,
        };
        (spec, Bundle::camera(&bundle, 3).expect("a bundle"))
    }

    #[test]
    fn a_core_s_light_is_spread_as_a_gaussian_and_moves_with_the_image() {
        let (spec, bundle) = small();
        let size_px = [40, 30];
        let mut sensor = Sensor::new(&spec, size_px, &bundle, 1, 2);
        // More patterns than are summed at once.
        let patterns = BLOCK + 3;
        let light: Vec<Vec<f32>> = (0..patterns)
            .map(|k| {
                (0..200)
                    .map(|core| ((core * 7 + k * 13) % 50) as f32)
                    .collect()
            })
            .collect();
        for shift_px in [0.0, 1.4] {
            sensor.shift(&bundle, shift_px);
            let rates = sensor.expose(&light);
            let sigma = spec.core_sigma_px;
            let pitch = bundle.spec().pitch_px();
            let scale = 0.5 * 3f64.sqrt() * pitch * pitch / (std::f64::consts::TAU * sigma * sigma);
            let mut compared = 0;
            for span in &sensor.spans {
                let length = span.columns.len();
                for (k, light) in light.iter().enumerate() {
                    for (i, column) in span.columns.clone().enumerate() {
                        let places = bundle.positions_px().iter().zip(light);
                        let [mut within, mut all] = [0.0; 2];
                        for ([x, y], &light) in places {
                            let [dx, dy] = [x + shift_px - column as f64, y - span.row as f64];
                            let weight = (-0.5 * (dx * dx + dy * dy) / (sigma * sigma)).exp();
                            let of_core = scale * weight * f64::from(light);
                            all += of_core;
                            if dx.abs().max(dy.abs()) <= REACH_SIGMA * sigma {
                                within += of_core;
                            }
                        }
                        let got = rates.values[span.first * patterns + k * length + i];
                        let got = f64::from(got);
                        // Some thirty products of single precision.
                        let rounding = 4e-6 * all.max(1.0);
                        assert!(
                            got >= within - rounding && got <= all + rounding,
                            "{got}: {within} to {all}"
                        );
                        compared += usize::from(within > 1.0 && all < 1.01 * within);
                    }
                }
            }
            assert!(compared > 4000, "{compared}");
        }
    }
}
