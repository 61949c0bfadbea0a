//! Why nothing can be decoded.

use crate::frame::FrameKind;

/// Why a head, a pattern set and exposures do not make a decoder, or a view no cloud.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// No exposure, or more than a byte can count.
    #[error("{got} exposures: 1 to 255 are possible")]
    ExposureCount {
        /// Number given.
        got: usize,
    },
    /// Not ascending, or zero.
    #[error("exposures {got:?} us: must be positive and ascending")]
    Exposures {
        /// Which.
        got: Vec<u32>,
    },
    /// Nothing known about the camera's counts.
    #[error("the head says nothing about its sensor: give [sensor] in head.toml")]
    NoSensor,
    /// A head value beyond its limits.
    #[error("{key} = {got}: {expected}")]
    Head {
        /// Which.
        key: String,
        /// Its value.
        got: String,
        /// Allowed values.
        expected: std::borrow::Cow<'static, str>,
    },
    /// An option beyond its limits.
    #[error("option {option} = {got}: {expected}")]
    Option {
        /// Which.
        option: &'static str,
        /// Its value.
        got: f64,
        /// Allowed values.
        expected: &'static str,
    },
    /// Binning or image circle leave nothing.
    #[error(
        "no cell lies inside the image circle (binning {binning}, camera {width_px} x {height_px}): check image_circle"
    )]
    NoCells {
        /// Binning.
        binning: usize,
        /// Camera columns.
        width_px: u32,
        /// Camera rows.
        height_px: u32,
    },
    /// No core map, or one that leaves nothing.
    #[error(
        "no core of the head's map lies in the image circle: check [cores] and image_circle, or use the pixel grid"
    )]
    NoCores,
    /// All frequencies together repeat and nothing says which repetition.
    #[error(
        "the lowest frequency has {periods} periods (of high ones: their beat) and the head no [volume]: give the volume's depth range, or a frequency with a single period"
    )]
    NeedsVolume {
        /// Periods of the lowest frequency, or of the beat of high ones: repetitions over the projector.
        periods: f64,
    },
    /// All frequencies together repeat within the volume.
    #[error(
        "within the measuring volume the lowest frequency ({periods} periods; of high ones their beat) passes {spanned:.2} periods, at most {limit} are unambiguous: use at most {usable:.1} periods, or a shallower volume"
    )]
    VolumeTooDeep {
        /// Periods of the lowest frequency, or of the beat of high ones: repetitions over the projector.
        periods: f64,
        /// Periods passed along the worst ray.
        spanned: f64,
        /// The limit.
        limit: f64,
        /// Periods that would do.
        usable: f64,
    },
    /// The volume reaches behind the projector.
    #[error(
        "the measuring volume ({near_mm} to {far_mm} mm) reaches behind the projector: check projector_from_camera and volume"
    )]
    VolumeBehindProjector {
        /// Near end.
        near_mm: f64,
        /// Far end.
        far_mm: f64,
    },
    /// A stripe of the code holds more fringes than the frequencies tell apart.
    #[error(
        "a stripe of the Gray code holds {fringes:.2} fringes of the finest frequency, of which the frequencies tell {limit} apart: use at least {} times as many stripes, or a lower frequency beside", fringes / *limit as f64
    )]
    WideStripes {
        /// Fringes in a stripe.
        fringes: f64,
        /// Number of orders that can be distinguished.
        limit: usize,
    },
    /// The accumulator belongs to another decoder.
    #[error("the accumulator was begun by another decoder")]
    ForeignAccumulator,
    /// Frames are missing.
    #[error("{received} of {planned} frames are there; next should be {expected}")]
    Incomplete {
        /// Frames added.
        received: usize,
        /// Frames of a view.
        planned: usize,
        /// First missing.
        expected: FrameKind,
    },
}
