//! Counter-based random numbers: value number i of a seed is the same whatever thread asks for it.

/// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): value `index` of the stream of `seed`.
#[inline]
fn bits(seed: u64, index: u64) -> u64 {
    let mut z = mix(seed).wrapping_add(index.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    z = mix(z);
    z
}

#[inline]
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Uniform in [0, 1) with 53 random bits.
#[inline]
pub fn uniform(seed: u64, index: u64) -> f64 {
    (bits(seed, index) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Standard normal deviate number `index` of a seed (Box and Muller, Ann. Math. Stat. 29, 610, 1958).
pub fn normal(seed: u64, index: u64) -> f64 {
    // 1 - u lies in (0, 1]: its logarithm is finite.
    let radius = (-2.0 * (1.0 - uniform(seed, 2 * index)).ln()).sqrt();
    radius * (std::f64::consts::TAU * uniform(seed, 2 * index + 1)).cos()
}
