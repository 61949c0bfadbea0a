//! Whether the exposures of a view show one scene: what a check and a scan make of what the decoder found.

use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::Decoded;

/// Largest share of the cells with fringes whose exposures may disagree. Noise alone leaves one in a thousand: of the ten thousand
/// cells of a small field, three in a thousand are six standard deviations more. What lies below has lost its cells, and coverage
/// and hidden depth speak for it.
const MOST_DISAGREEING: f64 = 3e-3;

/// Why nothing is made of a view whose exposures do not show one scene: it is to be taken again.
pub(crate) fn exposures_disagree(decoded: &Decoded) -> Option<Reason> {
    let rejected = &decoded.rejected;
    let without_fringes = rejected.saturated + rejected.low_contrast + rejected.low_modulation;
    let with_fringes = decoded.cells.saturating_sub(without_fringes).max(1);
    let ratio = rejected.exposures_disagree as f64 / with_fringes as f64;
    let why = format_args!(
        "the exposures of {:.1} % of the points do not show one scene, at most {:.1} % may: something moved between them, or \
         the frames are not of one capture",
        100.0 * ratio,
        100.0 * MOST_DISAGREEING
    );
    (ratio > MOST_DISAGREEING).then(|| Reason::instrument(Code::ExposuresDisagree, why))
}
