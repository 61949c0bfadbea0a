//! All views of a scan laid on the CAD together.
//!
//! Each view, laid on the surface, is compressed to its 6x6 information ([`ViewInformation`]), and each pair of views that
//! saw the same cells to a 12x12 one ([`Overlap`]). One solve then finds what all views share (die on its table, hand-eye,
//! directions of the vertical axis, encoder harmonics: [`Stages`]) and how far each view lies from it (pose residual) within what
//! its stages can be off. A view may not bend to the form of the piece where it looks: ovality and taper of the whole and a form
//! of its own under every view are eliminated, which keeps them in the deviations. Overlaps know nothing of the CAD: in the
//! difference of two views the form cancels.
//!
//! | file | holds |
//! |---|---|
//! | `model` | camera poses from the commanded stage positions |
//! | `view` | one view against the CAD |
//! | `overlap` | one view against another |
//! | `form` | ovality and taper of the piece |
//! | `local` | deviation of a single view from the shared model |
//! | `solve` | least squares over all views |
//! | `blocks` | the sparse factor behind it |

mod blocks;
mod form;
mod local;
mod model;
mod overlap;
mod solve;
mod view;

use flankscope_foundation::rigid::{Camera, Rigid, Tool};

pub use local::Local;
pub use model::{HEAD_SIGMA_MM, PARAMETERS, Pose, Stages};
pub use overlap::{Overlap, take_off_common};
pub use solve::{AdjustmentError, Solution, StageSigma, Weak, solve};
pub use view::{ViewInformation, compress, compress_laid};

/// Pose of a view: tool frame from camera frame.
pub type CameraPose = Rigid<Tool, Camera>;
