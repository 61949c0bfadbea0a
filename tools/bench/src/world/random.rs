//! Seeded random numbers: one independent stream per purpose, so that adding one never shifts another.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// Purpose of a stream of random numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    CameraBundle,
    ProjectorBundle,
    PixelResponse,
    NoiseTable,
    CoreResponse,
    Mount,
    Target,
    Stages,
    Vibration,
    Unevenness(u8),
    Flanks,
    Film,
    Moved,
    Frame(u32),
    Paths(u32),
}

impl Purpose {
    /// A unique number for every purpose, and an index among several of its kind.
    fn label(self) -> [i64; 2] {
        match self {
            Self::CameraBundle => [1, 0],
            Self::ProjectorBundle => [2, 0],
            Self::PixelResponse => [3, 0],
            Self::NoiseTable => [4, 0],
            Self::CoreResponse => [5, 0],
            Self::Mount => [6, 0],
            Self::Target => [7, 0],
            Self::Vibration => [8, 0],
            Self::Stages => [9, 0],
            Self::Unevenness(lens) => [10, i64::from(lens)],
            Self::Flanks => [11, 0],
            Self::Film => [14, 0],
            Self::Moved => [15, 0],
            Self::Frame(counter) => [12, i64::from(counter)],
            Self::Paths(core) => [13, i64::from(core)],
        }
    }
}

/// The stream of `seed` for `purpose`.
///
/// Seed and label are mixed into all 256 bits of the generator's state and increment. A label in the increment alone would not
/// suffice: the generator makes it odd, so two labels that differ in their last bit would share a stream.
pub(crate) fn stream(seed: u64, purpose: Purpose) -> Pcg64 {
    let [kind, index] = purpose.label();
    let mut bytes = [0u8; 32];
    for (word, eight) in bytes.chunks_exact_mut(8).enumerate() {
        eight.copy_from_slice(&hash(seed, [kind, index, word as i64]).to_le_bytes());
    }
    Pcg64::from_seed(bytes)
}

/// Standard normal deviates by Box and Muller, in pairs.
pub(crate) struct Normals<R> {
    source: R,
    spare: Option<f64>,
}

impl<R: rand::Rng> Normals<R> {
    pub(crate) fn new(source: R) -> Self {
        Self {
            source,
            spare: None,
        }
    }

    pub(crate) fn next(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // 1 - u lies in (0, 1]: its logarithm is finite.
        let radius = (-2.0 * (1.0 - self.source.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (TAU * self.source.random::<f64>()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }

    /// Uniform in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.source.random()
    }
}

/// A well mixed 64-bit hash of a lattice point (finaliser of SplitMix64, Steele et al. 2014).
///
/// The seed is mixed before the first coordinate, so that two seeds that differ in one bit do not give shifted copies of one lattice.
pub(crate) fn hash(seed: u64, cell: [i64; 3]) -> u64 {
    let mut h = mix(seed);
    for c in cell {
        h = mix(h ^ c as u64);
    }
    h
}

fn mix(h: u64) -> u64 {
    let h = h.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^ (h >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// Every purpose, with several indices where it has them.
    fn purposes() -> Vec<Purpose> {
        let mut all = vec![
            Purpose::CameraBundle,
            Purpose::ProjectorBundle,
            Purpose::PixelResponse,
            Purpose::NoiseTable,
            Purpose::CoreResponse,
            Purpose::Mount,
            Purpose::Target,
            Purpose::Stages,
            Purpose::Vibration,
            Purpose::Flanks,
        ];
        all.extend((0..4).map(Purpose::Unevenness));
        all.extend((0..200).map(Purpose::Frame));
        all.extend([u32::MAX - 1, u32::MAX].map(Purpose::Frame));
        all
    }

    #[test]
    fn no_two_purposes_and_no_two_seeds_share_a_value() {
        // 7 seeds x 216 streams x 64 values of 64 bits: a random coincidence occurs once in 4e9 such sets.
        let mut known = HashMap::new();
        for seed in [0, 1, 2, 3, 4, 1 << 40, u64::MAX] {
            for purpose in purposes() {
                let mut random = stream(seed, purpose);
                for place in 0..64 {
                    let value: u64 = random.random();
                    let here = (seed, purpose, place);
                    if let Some(before) = known.insert(value, here) {
                        panic!("{before:?} and {here:?} both give {value:#x}");
                    }
                }
            }
        }
    }

    #[test]
    fn streams_of_neighbouring_labels_are_not_correlated() {
        const COUNT: usize = 4000;
        let draw = |purpose| {
            let mut random = Normals::new(stream(5, purpose));
            (0..COUNT).map(|_| random.next()).collect::<Vec<f64>>()
        };
        let all: Vec<Vec<f64>> = purposes().into_iter().take(20).map(draw).collect();
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let correlation = a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>() / COUNT as f64;
                // Standard deviation 1/sqrt(n) each; five standard deviations for 190 pairs.
                assert!(
                    correlation.abs() < 5.0 / (COUNT as f64).sqrt(),
                    "{correlation}"
                );
            }
        }
    }
}
