//! What the host tells the camera process before it triggers, and how the camera labels its frames by it.

use flankscope_protocol::{CapturePlan, FrameOrder};
use iceoryx2::prelude::*;

use crate::header::FrameLabel;

/// The order in which the next capture's frames will be exposed, so that the camera process can label them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("flankscope/Arm/1")]
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

impl Arm {
    /// For all views of a plan.
    #[must_use]
    pub fn of(plan: &CapturePlan) -> Self {
        let FrameOrder {
            exposures,
            patterns,
        } = plan.order();
        Self {
            session: plan.session,
            first_view: 0,
            views: plan.views.len() as u16, // a plan holds 16 at most
            exposures,
            patterns,
        }
    }

    /// The order of the frames of a view.
    #[must_use]
    pub fn order(&self) -> FrameOrder {
        FrameOrder {
            exposures: self.exposures,
            patterns: self.patterns,
        }
    }

    /// Frames of all views.
    #[must_use]
    pub fn frames(&self) -> u32 {
        u32::from(self.views) * u32::from(self.order().frames())
    }

    /// The label of the `nth` frame since arming; `None` after the last one.
    #[must_use]
    pub fn label(&self, nth: u32) -> Option<FrameLabel> {
        if nth >= self.frames() {
            return None;
        }
        let per_view = u32::from(self.order().frames());
        let in_view = (nth % per_view) as u16;
        let place = self.order().place(in_view)?;
        Some(FrameLabel {
            view: self.first_view.wrapping_add((nth / per_view) as u16),
            in_view,
            exposure: place.exposure,
            pattern: place.pattern,
        })
    }
}

/// Labels a camera's exposures by counting them since it was armed.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    arm: Arm,
    exposed: u32,
}

impl Labels {
    /// Counts from the start of this capture on.
    pub fn arm(&mut self, arm: Arm) {
        *self = Self { arm, exposed: 0 };
    }

    /// Session and label of the exposure that comes now; [`FrameLabel::BEYOND`] before the first arming and after the
    /// last frame of the plan.
    pub fn take(&mut self) -> (u32, FrameLabel) {
        let label = self.arm.label(self.exposed).unwrap_or(FrameLabel::BEYOND);
        self.exposed = self.exposed.saturating_add(1);
        (self.arm.session, label)
    }

    /// Exposures since arming.
    #[must_use]
    pub fn exposed(&self) -> u32 {
        self.exposed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: Arm = Arm {
        session: 7,
        first_view: 2,
        views: 2,
        exposures: 2,
        patterns: 3,
    };

    #[test]
    fn labels_follow_the_order_of_capture() {
        assert_eq!((ARM.order().frames(), ARM.frames()), (7, 14));
        let of = |nth| {
            ARM.label(nth)
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
    fn a_camera_counts_from_its_arming() {
        let mut labels = Labels::default();
        assert_eq!(labels.take(), (0, FrameLabel::BEYOND), "never armed");
        labels.arm(ARM);
        for nth in 0..14 {
            assert_eq!(labels.take(), (7, ARM.label(nth).unwrap()));
        }
        assert_eq!(labels.take(), (7, FrameLabel::BEYOND));
        labels.arm(Arm { session: 8, ..ARM });
        assert_eq!(labels.take(), (8, ARM.label(0).unwrap()));
    }
}
