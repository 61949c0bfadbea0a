//! Seeded random numbers: one independent stream per purpose, so that adding one never shifts another.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::TAU;

/// What a stream of random numbers is used for.
#[derive(Clone, Copy, Debug)]
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
    Frame(u32),
}

/// The stream of `seed` for `purpose`.
pub(crate) fn stream(seed: u64, purpose: Purpose) -> Pcg64 {
    let label: u64 = match purpose {
        Purpose::CameraBundle => 1,
        Purpose::ProjectorBundle => 2,
        Purpose::PixelResponse => 3,
        Purpose::NoiseTable => 4,
        Purpose::CoreResponse => 5,
        Purpose::Mount => 6,
        Purpose::Target => 7,
        Purpose::Stages => 9,
        Purpose::Vibration => 8,
        Purpose::Unevenness(lens) => 16 + u64::from(lens),
        Purpose::Flanks => 9,
        Purpose::Frame(counter) => (1 << 32) | u64::from(counter),
    };
    let mut bytes = [0u8; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    bytes[16..24].copy_from_slice(&label.to_le_bytes());
    // Streams with neighbouring labels begin alike or are the same: without a state of their own, frames would share noise
    // and the two lenses be one.
    let own = match purpose {
        Purpose::Frame(counter) => Some([i64::from(counter), 0, 0]),
        Purpose::Unevenness(lens) => Some([i64::from(lens), 1, 0]),
        _ => None,
    };
    if let Some(own) = own {
        bytes[8..16].copy_from_slice(&hash(seed, own).to_le_bytes());
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
pub(crate) fn hash(seed: u64, cell: [i64; 3]) -> u64 {
    let mut h = seed;
    for c in cell {
        h = (h ^ c as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
        h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h ^= h >> 31;
    }
    h
}
