//! What travels with a frame: header, checksum, clock.

use iceoryx2::prelude::*;
use twox_hash::XxHash3_64;

/// Largest difference between a commanded exposure and the one a camera measured, µs: strobe and trigger edges of
/// microseconds, and 100 µs for a timer that was late.
pub const EXPOSURE_TOLERANCE_US: u64 = 100;

/// Which frame of the plan this is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("flankscope/FrameLabel/1")]
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

/// Header of one frame, beside its pixels in shared memory. Its type name is that of its layout, so that a camera in another
/// language can say the same (`docs/camera.md`).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("flankscope/FrameHeader/1")]
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
    /// What of the times below was measured: [`FrameHeader::EXPOSURE_MEASURED`], [`FrameHeader::END_MEASURED`].
    pub measured: u32,
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

impl FrameHeader {
    /// Bit of `measured`: the camera itself measured how long it exposed; otherwise the exposure is what it was told.
    pub const EXPOSURE_MEASURED: u32 = 1;
    /// Bit of `measured`: the camera itself measured when the exposure ended; otherwise it is when the frame came.
    pub const END_MEASURED: u32 = 2;
    /// Both.
    pub const ALL_MEASURED: u32 = Self::EXPOSURE_MEASURED | Self::END_MEASURED;
}

/// The host's monotonic clock, ns: the same in every process of the machine.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// XXH3-64 (seed 0) of the pixels as little-endian bytes: one pass at about memory speed, and there in every language.
#[must_use]
pub fn checksum(pixels: &[u16]) -> u64 {
    const {
        assert!(
            cfg!(target_endian = "little"),
            "pixels lie in shared memory as they are"
        )
    };
    XxHash3_64::oneshot(bytemuck::cast_slice(pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors that the xxHash library's own command and Python's `xxhash` give; `docs/camera.md` has them.
    #[test]
    fn checksum_is_xxh3() {
        assert_eq!(checksum(&[]), 0x2d06_8005_38d3_94c2);
        let ramp: Vec<u16> = (0..1000).collect();
        assert_eq!(checksum(&ramp), 0x57f7_5391_ec06_23aa);
    }

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
