//! One camera frame, borrowed where it lies.

use crate::pattern::Shown;

/// A borrowed frame (a shared memory slice, a decoded image). Never copied.
#[derive(Clone, Copy, Debug)]
pub struct FrameView<'a> {
    /// Row after row, `stride` apart; the last row may end after `width`.
    pub pixels: &'a [u16],
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Distance from row to row in pixels, at least `width`.
    pub stride: usize,
}

impl<'a> FrameView<'a> {
    /// A frame without padding between rows.
    pub fn packed(pixels: &'a [u16], width: usize, height: usize) -> Self {
        Self {
            pixels,
            width,
            height,
            stride: width,
        }
    }

    /// One row's pixels. `check` has made sure that it exists.
    pub(crate) fn row(&self, row: usize) -> &'a [u16] {
        &self.pixels[row * self.stride..][..self.width]
    }

    /// Checks the size against what is expected and the slice against the size.
    pub(crate) fn check(&self, width: usize, height: usize) -> Result<(), FrameError> {
        if (self.width, self.height) != (width, height) {
            return Err(FrameError::Size {
                got_width: self.width,
                got_height: self.height,
                width,
                height,
            });
        }
        if self.stride < self.width {
            return Err(FrameError::Stride {
                got: self.stride,
                width,
            });
        }
        let needed = match self.height {
            0 => Some(0),
            rows => self
                .stride
                .checked_mul(rows - 1)
                .and_then(|start| start.checked_add(self.width)),
        };
        match needed {
            Some(needed) if self.pixels.len() >= needed => Ok(()),
            _ => Err(FrameError::Short {
                got: self.pixels.len(),
                width,
                height,
                stride: self.stride,
            }),
        }
    }
}

/// Content of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameKind {
    /// Projector black, shortest exposure: the index frame of a view.
    Dark,
    /// One phase step.
    Fringe {
        /// Index of the exposure, ascending in time.
        exposure: usize,
        /// Index of the frequency, low to high.
        set: usize,
        /// Index of the phase step.
        step: u32,
    },
    /// One bit of a Gray code.
    Code {
        /// Index of the exposure, ascending in time.
        exposure: usize,
        /// Index of the bit, 0 the most significant.
        bit: u32,
        /// Whether dark and bright are exchanged.
        complement: bool,
    },
}

impl FrameKind {
    /// A picture at one exposure.
    pub fn from_picture(picture: Shown, exposure: usize) -> Self {
        match picture {
            Shown::Fringe { set, step } => Self::Fringe {
                exposure,
                set,
                step,
            },
            Shown::Code { bit, complement } => Self::Code {
                exposure,
                bit,
                complement,
            },
        }
    }

    /// Index of the exposure; `None` of the dark frame, which is exposed as the shortest.
    pub fn exposure(self) -> Option<usize> {
        match self {
            Self::Dark => None,
            Self::Fringe { exposure, .. } | Self::Code { exposure, .. } => Some(exposure),
        }
    }
}

impl std::fmt::Display for FrameKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Dark => write!(f, "the dark frame"),
            Self::Fringe {
                exposure,
                set,
                step,
            } => {
                write!(f, "exposure {exposure}, frequency {set}, step {step}")
            }
            Self::Code {
                exposure,
                bit,
                complement,
            } => {
                let of = if *complement { "complement of " } else { "" };
                write!(f, "exposure {exposure}, {of}code bit {bit}")
            }
        }
    }
}

/// Mean level of a frame, computed while it was accumulated (no second read).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameLevel {
    /// Mean over the pixels inside the image circle, in raw counts (offset included).
    pub mean_dn: f64,
    /// Number of these pixels.
    pub pixels: u64,
}

impl FrameLevel {
    /// Whether the mean level fits the content: the dark frame at most `dark_limit_dn`, a fringe frame above it. Code frames may be
    /// either, since a view may lie in a single stripe.
    ///
    /// A dark frame between the fringes, or light in the dark frame, means that triggers and frames lost step.
    ///
    /// # Errors
    /// [`FrameError::DarkFrameLit`], [`FrameError::FringeFrameDark`].
    pub fn check_content(&self, kind: FrameKind, dark_limit_dn: f64) -> Result<(), FrameError> {
        let lit = self.mean_dn > dark_limit_dn;
        match kind {
            FrameKind::Dark if lit => Err(FrameError::DarkFrameLit {
                mean_dn: self.mean_dn,
                limit_dn: dark_limit_dn,
            }),
            FrameKind::Fringe { .. } if !lit => Err(FrameError::FringeFrameDark {
                kind,
                mean_dn: self.mean_dn,
                limit_dn: dark_limit_dn,
            }),
            _ => Ok(()),
        }
    }
}

/// Why a frame was refused. The accumulator is unchanged then.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Another camera, or another binning in the camera.
    #[error("frame of {got_width} x {got_height} pixels, expected {width} x {height}")]
    Size {
        /// Width found.
        got_width: usize,
        /// Height found.
        got_height: usize,
        /// Width the head's camera has.
        width: usize,
        /// Height the head's camera has.
        height: usize,
    },
    /// Rows would overlap.
    #[error("stride of {got} pixels is less than the width of {width}")]
    Stride {
        /// Stride found.
        got: usize,
        /// Width.
        width: usize,
    },
    /// The slice ends before the frame does.
    #[error("{got} pixels in memory are too few for {width} x {height} with stride {stride}")]
    Short {
        /// Pixels in the slice.
        got: usize,
        /// Width.
        width: usize,
        /// Height.
        height: usize,
        /// Stride.
        stride: usize,
    },
    /// This frame was added before.
    #[error("{got} came twice; next should be {expected}")]
    Repeated {
        /// Received.
        got: FrameKind,
        /// Expected.
        expected: FrameKind,
    },
    /// A later frame came first: one or more are missing.
    #[error("{got} came, but {missing} frame(s) before it are missing, first {expected}")]
    Missing {
        /// Received.
        got: FrameKind,
        /// Expected.
        expected: FrameKind,
        /// Number of frames skipped.
        missing: usize,
    },
    /// No such frame in the plan.
    #[error(
        "{got} is not in the plan of {exposures} exposure(s) and {sets} frequencies; next should be {expected}"
    )]
    NotPlanned {
        /// Received.
        got: FrameKind,
        /// Expected.
        expected: FrameKind,
        /// Exposures in the plan.
        exposures: usize,
        /// Frequencies in the plan.
        sets: usize,
    },
    /// All frames were there already.
    #[error("{got} came after all {planned} frames of the view")]
    Extra {
        /// Received.
        got: FrameKind,
        /// Frames in the plan.
        planned: usize,
    },
    /// Light where none should be.
    #[error(
        "the dark frame has a mean of {mean_dn:.1} DN, limit {limit_dn:.1}: projector or lamp was on, or frames lost step"
    )]
    DarkFrameLit {
        /// Mean level.
        mean_dn: f64,
        /// Limit.
        limit_dn: f64,
    },
    /// No light where some should be.
    #[error(
        "{kind} has a mean of {mean_dn:.1} DN, must exceed {limit_dn:.1}: no light, or frames lost step"
    )]
    FringeFrameDark {
        /// The frame.
        kind: FrameKind,
        /// Mean level.
        mean_dn: f64,
        /// Limit.
        limit_dn: f64,
    },
}

/// The lit part of a frame as a grey picture.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub grey: Vec<u8>,
}
