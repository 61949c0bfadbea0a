//! The light of a pattern set as shown: in passes, or once by all mirrors.

use flankscope_profilometry::HeadModel;

/// Light of the patterns, as a check needs it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatternLight {
    /// Fraction of the light of all mirrors that each pass gives; empty: the patterns are shown once, by all mirrors.
    pub lit_ratios: Vec<f64>,
}

impl PatternLight {
    /// All mirrors of every projector, one projector after the other.
    #[must_use]
    pub fn of(head: &HeadModel) -> Self {
        let lit_ratios = match head.projectors() {
            1 => Vec::new(),
            several => vec![1.0; several],
        };
        Self { lit_ratios }
    }
}
