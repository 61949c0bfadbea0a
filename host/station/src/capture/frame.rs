//! What travels with a frame, and what the host tells the camera process before it triggers.

use std::sync::atomic::{AtomicU64, Ordering};

use flankscope_profilometry::FrameView;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;

/// The order in which the next capture's frames will be exposed, so that the camera process can label them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
pub struct Arm {
    /// Capture session; every frame of it carries this number.
    pub session: u32,
    /// First view of the session: a view captured again starts at its own number.
    pub first_view: u16,
    /// Views that follow, the first included.
    pub views: u16,
    /// Exposure steps per view (HDR series).
    pub exposures: u16,
    /// Fringe patterns per exposure step; a dark frame precedes each view.
    pub patterns: u16,
}

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

impl Arm {
    /// Frames of one view: the dark frame, then every pattern at every exposure step.
    #[must_use]
    pub fn frames_per_view(&self) -> u32 {
        1 + u32::from(self.exposures) * u32::from(self.patterns)
    }

    /// The label of the `nth` frame since arming; `None` after the last one.
    #[must_use]
    pub fn label(&self, nth: u32) -> Option<FrameLabel> {
        let per_view = self.frames_per_view();
        let view = nth / per_view;
        if view >= u32::from(self.views) {
            return None;
        }
        let in_view = nth % per_view;
        let (exposure, pattern) = match in_view.checked_sub(1) {
            None => (0, 0),
            Some(fringe) => (
                fringe / u32::from(self.patterns),
                1 + fringe % u32::from(self.patterns),
            ),
        };
        Some(FrameLabel {
            view: self.first_view + view as u16,
            in_view: in_view as u16,
            exposure: exposure as u16,
            pattern: pattern as u16,
        })
    }
}

/// Header of one frame, beside its pixels in shared memory.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
pub struct FrameHeader {
    /// Capture session of the last [`Arm`].
    pub session: u32,
    /// Frames exposed since the camera process started; a gap is a lost frame.
    pub counter: u32,
    /// Position in the plan, by counting since the last [`Arm`].
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

/// A frame that still lies in the shared memory; dropping it gives the slot back to the camera process.
#[derive(Debug)]
pub struct Frame {
    pub(super) sample: Sample<ipc::Service, [u16], FrameHeader>,
    /// When the host saw it, monotonic clock, ns.
    pub received_monotonic_ns: u64,
}

/// Bytes of frames that this process copied out of the shared memory; the only way to copy one is [`Frame::copy_pixels`].
static BYTES_COPIED: AtomicU64 = AtomicU64::new(0);

impl Frame {
    /// The header.
    #[must_use]
    pub fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }

    /// The pixels where they are.
    #[must_use]
    pub fn pixels(&self) -> &[u16] {
        self.sample.payload()
    }

    /// The pixels as an image, borrowed.
    #[must_use]
    pub fn view(&self) -> FrameView<'_> {
        let header = self.header();
        FrameView {
            pixels: self.pixels(),
            width: header.width_px as usize,
            height: header.height_px as usize,
            stride: header.stride_px as usize,
        }
    }

    /// The pixels copied out of the shared memory; counted in [`Frame::bytes_copied`].
    #[must_use]
    pub fn copy_pixels(&self) -> Vec<u16> {
        BYTES_COPIED.fetch_add(
            std::mem::size_of_val(self.pixels()) as u64,
            Ordering::Relaxed,
        );
        self.pixels().to_vec()
    }

    /// Bytes of frames copied by this process so far.
    #[must_use]
    pub fn bytes_copied() -> u64 {
        BYTES_COPIED.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_follow_the_order_of_capture() {
        let arm = Arm {
            session: 7,
            first_view: 2,
            views: 2,
            exposures: 2,
            patterns: 3,
        };
        assert_eq!(arm.frames_per_view(), 7);
        let of = |nth| {
            arm.label(nth)
                .map(|l| (l.view, l.in_view, l.exposure, l.pattern))
        };
        assert_eq!(of(0), Some((2, 0, 0, 0)));
        assert_eq!(of(1), Some((2, 1, 0, 1)));
        assert_eq!(of(3), Some((2, 3, 0, 3)));
        assert_eq!(of(4), Some((2, 4, 1, 1)));
        assert_eq!(of(7), Some((3, 0, 0, 0)));
        assert_eq!(of(13), Some((3, 6, 1, 3)));
        assert_eq!(of(14), None, "frames beyond the plan have no label");
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
