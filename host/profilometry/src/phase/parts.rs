//! Direct and global light (Nayar, Krishnan, Grossberg and Raskar, Fast separation of direct and global components of a scene
//! using high frequency illumination, SIGGRAPH 2006).
//!
//! With every mirror on, a place would send D straight back and G over other surfaces, from within the material, or from a lamp. A
//! fringe lights half of the scene: whatever reaches the place over many fringes is G / 2 in every step, and D goes with the
//! fringe, as far as the optics show it. So the mean over the steps is `A = (D + G) / 2` and the amplitude `B = c D / 2`, where c is
//! the contrast that the optics leave a matt, convex surface in focus (`fringe_contrast` of the head):
//!
//! `D = 2 B / c`, `G = 2 A - D`.
//!
//! Assumed: global light is uniform over a fringe; the part of it that still has fringes counts as direct. Without a stated c it is
//! taken as 1, which makes D a lower and G an upper bound.

use super::LightEstimate;

/// Electrons with every mirror on, summed over a cell's pixels and the exposures used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightParts {
    /// Straight from the projector.
    pub direct_e: f64,
    /// By any other path, electrons.
    pub global_e: f64,
}

impl LightParts {
    /// Separates direct from global light by the finest fringes, which global light follows least.
    pub fn from_fringes(finest: &LightEstimate, fringe_contrast: f64) -> Self {
        let direct_e = 2.0 * finest.modulation_e / fringe_contrast;
        // Noise can leave less than nothing.
        let global_e = (2.0 * finest.mean_e - direct_e).max(0.0);
        Self { direct_e, global_e }
    }

    /// Share of the global part; NaN without light.
    pub fn global_ratio(self) -> f64 {
        self.global_e / (self.direct_e + self.global_e)
    }
}
