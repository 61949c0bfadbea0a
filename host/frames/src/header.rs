//! What travels with a frame: header, checksum, clock.

use iceoryx2::prelude::*;

/// Largest difference between a commanded exposure and the one a camera measured, µs: strobe and trigger edges of
/// microseconds, and 100 µs for a timer that was late.
pub const EXPOSURE_TOLERANCE_US: u64 = 100;

/// Which frame of the plan this is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
pub struct FrameLabel {
    /// View number in the session.
    pub view: u16,
    /// Position in the view: 0 is the dark index frame.
    pub in_view: u16,
    /// Exposure step, 0 the shortest.
    pub exposure: u16,
    /// 0 dark, 1.. the fringe patterns in the plan's order.
    pub pattern: u16,
}

impl FrameLabel {
    /// Of an exposure that belongs to no plan.
    pub const BEYOND: Self = Self {
        view: u16::MAX,
        in_view: 0,
        exposure: 0,
        pattern: 0,
    };
}

/// Header of one frame, beside its pixels in shared memory.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
pub struct FrameHeader {
    /// Capture session of the last [`Arm`](crate::Arm).
    pub session: u32,
    /// Frames exposed since the camera process started; a gap is a lost frame.
    pub counter: u32,
    /// Position in the plan, by counting since the last [`Arm`](crate::Arm).
    pub label: FrameLabel,
    /// Image width, px.
    pub width_px: u32,
    /// Image height, px.
    pub height_px: u32,
    /// Row pitch, px.
    pub stride_px: u32,
    /// Reserved, 0.
    pub reserved: u32,
    /// Start of exposure on the camera's clock, µs.
    pub exposure_start_us: u64,
    /// End of exposure on the camera's clock, µs.
    pub exposure_end_us: u64,
    /// End of exposure on the host's monotonic clock, ns, as the camera process knows it.
    pub exposure_end_monotonic_ns: u64,
    /// When the frame was handed over, host's monotonic clock, ns.
    pub published_monotonic_ns: u64,
    /// [`checksum`] of the pixels.
    pub checksum: u64,
}

/// The host's monotonic clock, ns: the same in every process of the machine.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// A checksum of a frame's pixels that costs one pass at about memory speed.
///
/// Every pixel enters by an invertible step, so that any single changed pixel changes the sum.
#[must_use]
pub fn checksum(pixels: &[u16]) -> u64 {
    const ODD: u64 = 0x9E37_79B9_7F4A_7C15; // 2^64 / golden ratio: spreads the low bits of a sample over the word
    let mut lanes = [1_u64, 2, 3, 4];
    let word = |w: &[u16]| {
        u64::from(w[0]) | u64::from(w[1]) << 16 | u64::from(w[2]) << 32 | u64::from(w[3]) << 48
    };
    let mut blocks = pixels.chunks_exact(16);
    for block in &mut blocks {
        for (lane, w) in lanes.iter_mut().zip(block.chunks_exact(4)) {
            *lane = (*lane ^ word(w)).wrapping_mul(ODD);
        }
    }
    for (i, &pixel) in blocks.remainder().iter().enumerate() {
        lanes[i % 4] = (lanes[i % 4] ^ u64::from(pixel)).wrapping_mul(ODD);
    }
    lanes.iter().fold(pixels.len() as u64, |sum, lane| {
        (sum ^ lane).rotate_left(23).wrapping_mul(ODD)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksum_sees_every_pixel_and_every_bit() {
        let mut pixels: Vec<u16> = (0..1003_u32).map(|i| (i * 7919 % 4096) as u16).collect();
        let before = checksum(&pixels);
        for i in 0..pixels.len() {
            for bit in 0..16 {
                pixels[i] ^= 1 << bit;
                assert_ne!(checksum(&pixels), before, "pixel {i} bit {bit}");
                pixels[i] ^= 1 << bit;
            }
        }
        assert_ne!(checksum(&pixels[..1002]), before, "length counts");
    }
}
