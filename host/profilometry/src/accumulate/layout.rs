//! What an accumulator is laid out for: grid, frames in capture order, limits.

use super::consistency::FrameNoise;
use crate::cells::Grid;
use crate::frame::FrameKind;

/// What an accumulator is laid out for.
#[derive(Debug)]
pub(crate) struct Layout {
    pub width: usize,
    pub height: usize,
    pub grid: Grid,
    /// Phase steps of each frequency.
    pub steps: Vec<u32>,
    pub exposures: usize,
    pub dark_frame: bool,
    /// Counts above this are saturated.
    pub saturation_limit_dn: u16,
    /// What frames scatter by, where that is to be tested.
    pub noise: Option<FrameNoise>,
}

impl Layout {
    /// Frames of a view.
    pub fn planned(&self) -> usize {
        usize::from(self.dark_frame) + self.exposures * self.steps_per_exposure()
    }

    fn steps_per_exposure(&self) -> usize {
        self.steps.iter().map(|&steps| steps as usize).sum()
    }

    /// The place of a frame in the capture order.
    pub fn index(&self, kind: FrameKind) -> Option<usize> {
        match kind {
            FrameKind::Dark => self.dark_frame.then_some(0),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => {
                if exposure >= self.exposures || step >= *self.steps.get(set)? {
                    return None;
                }
                let before: usize = self.steps[..set].iter().map(|&steps| steps as usize).sum();
                Some(
                    usize::from(self.dark_frame)
                        + exposure * self.steps_per_exposure()
                        + before
                        + step as usize,
                )
            }
        }
    }

    /// The frame at a place in the capture order.
    pub fn kind(&self, index: usize) -> Option<FrameKind> {
        if index >= self.planned() {
            return None;
        }
        if self.dark_frame && index == 0 {
            return Some(FrameKind::Dark);
        }
        let index = index - usize::from(self.dark_frame);
        let exposure = index / self.steps_per_exposure();
        let mut step = (index % self.steps_per_exposure()) as u32;
        for (set, &steps) in self.steps.iter().enumerate() {
            if step < steps {
                return Some(FrameKind::Fringe {
                    exposure,
                    set,
                    step,
                });
            }
            step -= steps;
        }
        None
    }
}
