//! What is to be printed on a target's plates for a head.

use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::{Artwork, Target};

use crate::plan::{FieldOfView, NoVolume};

/// The print of the target's plates, as wide as this head's field needs it.
///
/// # Errors
/// The head file has no measuring volume, so its field is unknown.
pub fn target_artwork(target: &Target, head: &HeadModel) -> Result<Artwork, NoVolume> {
    Ok(target.artwork(FieldOfView::of(head)?.width_mm))
}
