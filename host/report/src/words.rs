//! What the judged parts of a die are called in tables.

use flankscope_record::document::FeatureId;

/// Heads of columns and nouns.
#[derive(Debug)]
pub struct Words {
    /// Of the number: `tooth`, or `no.` of a patch.
    pub number: &'static str,
    /// Of the side of a tooth, or a patch's name; also one such part.
    pub one: &'static str,
    /// Several of them.
    pub many: &'static str,
    /// Which way a map's rows run.
    pub along: &'static str,
    /// What a map's width is.
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
    /// Those for the parts of one die: it has flanks or patches.
    #[must_use]
    pub fn of<'a>(parts: impl IntoIterator<Item = &'a FeatureId>) -> &'static Self {
        match parts.into_iter().any(|id| id.patch.is_some()) {
            true => &PATCHES,
            false => &FLANKS,
        }
    }
}
