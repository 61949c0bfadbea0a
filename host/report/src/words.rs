//! Names of the judged parts of a die in tables.

use flankscope_record::document::FeatureId;

/// Column headers and nouns.
#[derive(Debug)]
pub struct Words {
    /// For the number: `tooth`, or `no.` of a patch.
    pub number: &'static str,
    /// For the side of a tooth, or a patch's name; also for one such part.
    pub one: &'static str,
    /// For several parts.
    pub many: &'static str,
    /// Direction of a map's rows.
    pub along: &'static str,
    /// Quantity that a map's width shows.
    pub width: &'static str,
}

const FLANKS: Words = Words {
    number: "tooth",
    one: "flank",
    many: "flanks",
    along: "tip → root",
    width: "profile",
};
const PATCHES: Words = Words {
    number: "no.",
    one: "patch",
    many: "patches",
    along: "along →",
    width: "length",
};

impl Words {
    /// The names for the parts of one die, which are either flanks or patches.
    #[must_use]
    pub fn of<'a>(parts: impl IntoIterator<Item = &'a FeatureId>) -> &'static Self {
        match parts.into_iter().any(|id| id.patch.is_some()) {
            true => &PATCHES,
            false => &FLANKS,
        }
    }
}
