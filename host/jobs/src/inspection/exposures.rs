//! Tests whether the exposures of a view show the same scene: the response of check and scan to the decoder's finding.

use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::Decoded;

/// Largest fraction of the cells with fringes whose exposures may disagree. Noise alone gives one in a thousand; for the ten
/// thousand cells of a small field, three in a thousand are six standard deviations more. Below the limit the disagreeing cells
/// are lost, which coverage and hidden depth account for.
const MOST_DISAGREEING: f64 = 3e-3;

/// Why a view whose exposures do not show the same scene is not used: it must be captured again.
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
