//! Estimates of consecutive cells, found together: arithmetic that the compiler takes for several cells at once.

use std::ops::Range;

use flankscope_foundation::simd::with_widest;

use super::Decoder;
use super::cell::Fate;
use crate::accumulate::{Band, Phasor};
use crate::phase::{self, CellNoise, LightEstimate, PhaseEstimate};

/// Cells that are estimated together.
const BLOCK: usize = 64;

/// Estimates of a band's cells by every frequency, some cells ahead of the one that is asked for.
pub(super) struct Estimates<'a> {
    decoder: &'a Decoder,
    band: &'a Band,
    /// The cells that are known.
    known: Range<usize>,
    of_sets: Vec<Block>,
}

/// Those of one frequency.
#[derive(Clone)]
struct Block {
    phase_rad: [f64; BLOCK],
    modulation_e: [f64; BLOCK],
    mean_e: [f64; BLOCK],
    sigma_rad: [f64; BLOCK],
}

impl<'a> Estimates<'a> {
    pub fn new(decoder: &'a Decoder, band: &'a Band) -> Self {
        let none = Block {
            phase_rad: [0.0; BLOCK],
            modulation_e: [0.0; BLOCK],
            mean_e: [0.0; BLOCK],
            sigma_rad: [0.0; BLOCK],
        };
        Self {
            decoder,
            band,
            known: 0..0,
            of_sets: vec![none; band.merged.len()],
        }
    }

    /// The estimate of the band's `index`-th cell.
    pub fn get(&mut self, index: usize, set: usize) -> Result<PhaseEstimate, Fate> {
        if self.band.merged[set].exposures[index] == 0 {
            return Err(Fate::Saturated);
        }
        if !self.known.contains(&index) {
            self.known = index..(index + BLOCK).min(self.band.cells);
            with_widest(
                #[inline(always)]
                || self.find(),
            );
        }
        let (block, at) = (&self.of_sets[set], index - self.known.start);
        Ok(PhaseEstimate {
            phase_rad: block.phase_rad[at],
            light: LightEstimate {
                modulation_e: block.modulation_e[at],
                mean_e: block.mean_e[at],
            },
            sigma_rad: block.sigma_rad[at],
        })
    }

    #[inline(always)]
    fn find(&mut self) {
        let Self { decoder, band, .. } = *self;
        let cells = self.known.clone();
        let count = cells.len();
        let sign = decoder.patterns.step_sign.factor();
        let anywhere = decoder.noise_anywhere();
        let mut offset_dn = [0.0; BLOCK];
        decoder.offsets_dn(band, cells.clone(), &mut offset_dn);
        let sets = decoder.patterns.sets.iter().zip(&band.merged);
        for ((set, merged), block) in sets.zip(&mut self.of_sets) {
            let planes = &merged.planes;
            let [re, im, sum] =
                [&planes.re, &planes.im, &planes.sum].map(|plane| &plane[cells.clone()][..count]);
            let exposures = &merged.exposures[cells.clone()][..count];
            // As many whole vectors as there are; a branch that is the same for all cells is none in the loop.
            for at in 0..count.min(BLOCK) {
                let phasor = Phasor {
                    re: re[at],
                    im: im[at],
                    sum: sum[at],
                    exposures: exposures[at],
                };
                let noise = CellNoise {
                    offset_dn: offset_dn[at],
                    ..anywhere
                };
                let found = phase::estimate(&phasor, set.steps, sign, &noise);
                block.phase_rad[at] = found.phase_rad;
                block.modulation_e[at] = found.light.modulation_e;
                block.mean_e[at] = found.light.mean_e;
                block.sigma_rad[at] = found.sigma_rad;
            }
        }
    }
}

impl Decoder {
    /// Counts per pixel without light of some cells of a band.
    #[inline(always)]
    fn offsets_dn(&self, band: &Band, cells: Range<usize>, into: &mut [f64]) {
        let anywhere = self.noise_anywhere();
        match band.dark.get(cells) {
            None => into.fill(anywhere.offset_dn),
            Some(dark) => {
                for (into, &dark) in into.iter_mut().zip(dark) {
                    *into = f64::from(dark) / anywhere.pixels;
                }
            }
        }
    }

    /// Light of all cells of a band by one frequency; `None` where every exposure was saturated.
    pub(super) fn lights<'a>(
        &self,
        band: &'a Band,
        set: usize,
    ) -> impl Fn(usize) -> Option<LightEstimate> + use<'a> {
        let exposures = &band.merged[set].exposures;
        let lights = with_widest(
            #[inline(always)]
            || self.find_lights(band, set),
        );
        move |index| (exposures[index] > 0).then(|| lights[index])
    }

    #[inline(always)]
    fn find_lights(&self, band: &Band, set: usize) -> Vec<LightEstimate> {
        let steps = self.patterns.sets[set].steps;
        let anywhere = self.noise_anywhere();
        let mut offset_dn = vec![0.0; band.cells];
        self.offsets_dn(band, 0..band.cells, &mut offset_dn);
        let planes = &band.merged[set].planes;
        let phasors = planes.re.iter().zip(&planes.im).zip(&planes.sum);
        let cells = phasors.zip(&band.merged[set].exposures).zip(&offset_dn);
        cells
            .map(|((((&re, &im), &sum), &exposures), &offset_dn)| {
                let phasor = Phasor {
                    re,
                    im,
                    sum,
                    exposures,
                };
                let noise = CellNoise {
                    offset_dn,
                    ..anywhere
                };
                LightEstimate::new(&phasor, steps, &noise)
            })
            .collect()
    }
}
