//! All views of a scan laid on the CAD together.
//!
//! Each view, laid on the surface, is compressed to its 6x6 information ([`ViewInformation`]). One solve then finds what
//! all views share (die on its table, hand-eye, direction of the vertical axis, encoder harmonics: [`Stages`]) and how far
//! each view strays from it within what its stages can be off. A view may not bend to the form of the piece where it
//! looks: that is what keeps ovality and taper in the deviations.

mod model;
mod solve;
mod view;

pub use model::{PARAMETERS, Pose, Stages};
pub use solve::{JointError, Local, Solution, Weak, solve};
pub use view::{ViewInformation, compress, compress_laid};
