//! Layout of an accumulator: grid, frames in capture order, limits.

use super::agreement::Agreement;
use super::consistency::FrameNoise;
use crate::cells::Grid;
use crate::frame::FrameKind;
use crate::pattern::Shown;

/// Layout of an accumulator.
#[derive(Debug)]
pub(crate) struct Layout {
    pub width: usize,
    pub height: usize,
    pub grid: Grid,
    /// Pictures of one exposure, in their order.
    pub pictures: Vec<Shown>,
    /// Phase steps of each frequency.
    pub steps: Vec<u32>,
    /// Bits of the code; 0 without one.
    pub bits: usize,
    pub exposures: usize,
    pub dark_frame: bool,
    /// Counts above this are saturated.
    pub saturation_limit_dn: u16,
    /// Predicted noise of frames, if their consistency is tested.
    pub noise: Option<FrameNoise>,
    /// Comparison of its exposures, where there are several and `noise` is known.
    pub agreement: Option<Agreement>,
}

impl Layout {
    /// Frames of a view.
    pub fn planned(&self) -> usize {
        usize::from(self.dark_frame) + self.exposures * self.pictures.len()
    }

    /// The place of a frame in the capture order.
    pub fn index(&self, kind: FrameKind) -> Option<usize> {
        let Some(exposure) = kind.exposure() else {
            return self.dark_frame.then_some(0);
        };
        let is_this = |&picture: &Shown| FrameKind::from_picture(picture, exposure) == kind;
        let in_exposure = self.pictures.iter().position(is_this)?;
        let before = usize::from(self.dark_frame) + exposure * self.pictures.len();
        (exposure < self.exposures).then_some(before + in_exposure)
    }

    /// The frame at a place in the capture order.
    pub fn kind(&self, index: usize) -> Option<FrameKind> {
        if index >= self.planned() {
            return None;
        }
        let Some(index) = index.checked_sub(usize::from(self.dark_frame)) else {
            return Some(FrameKind::Dark);
        };
        let exposure = index / self.pictures.len();
        let picture = self.pictures.get(index % self.pictures.len())?;
        Some(FrameKind::from_picture(*picture, exposure))
    }

    /// Whether every bit is followed by its complement.
    pub fn has_complements(&self) -> bool {
        let is_complement = |picture: &Shown| {
            matches!(
                picture,
                Shown::Code {
                    complement: true,
                    ..
                }
            )
        };
        self.pictures.last().is_some_and(is_complement)
    }
}
