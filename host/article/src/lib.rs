//! The article's method (Hinz, Kästner and Reithmeier 2019), its figures and its tables, ours beside them.
//!
//! It works on the points of views, the CAD and the poses that the joint solve found; it knows neither instrument nor session
//! folder ([`ViewPoints`] reads the points). The registration of a single view is in `flankscope_metrology::registration`.
//!
//! ```text
//!  points of the views ──► joint solve (the caller's) ──► poses ─┐
//!        │                                                       ├─► alignments, threshold curves, merging, overlays ──► Article
//!        └──► mask ─► denoise ─► 10 % ─► the article's poses ────┘
//! ```
//!
//! | file | holds |
//! |---|---|
//! | `method` | settings of the method, and all views to one map by it |
//! | `comparison` | both methods in the same figures |
//! | `drawn` | the drawn points of a view |
//! | `figures` | the document: all figures and tables of one scan |
//! | `alignment` | the views by positions alone, one on the other, the article's way, ours: distances, maps (figures 4, 19, 20, 21) |
//! | `serial` | one view on the one before, without CAD (figure 4b) |
//! | `threshold` | the mask and its threshold (figure 14) |
//! | `sections` | counts across the fringes, from recorded frames (figures 11 to 13) |
//! | `overlay` | measured points on the article's reference points (figures 16, 17) |
//! | `space` | toothing, cameras, the initial transformation, the final cloud (figures 5, 10, 15, 18) |
//! | `merging` | one point per voxel, chosen in several ways (figure 9, section 10) |

mod alignment;
mod comparison;
mod drawn;
mod figures;
mod merging;
mod method;
mod overlay;
mod sections;
mod serial;
mod space;
mod threshold;

use flankscope_metrology::cloud::merge::MergeError;
use flankscope_metrology::deviation::SampleTreeError;

pub use alignment::Alignment;
pub use comparison::{Creep, JointSolve, LayerDrift, MethodResult, ScanDrift, Spread, Trend};
pub use figures::{Article, DrawingSteps, FirstView, StitchedScan};
pub use merging::Merging;
pub use method::{ArticleSettings, ArticleStitched, ArticleView, Denoise, MERGED_PER_MM2, stitch};
pub use overlay::Overlay;
pub use sections::Sections;
pub use serial::SerialLayer;
pub use space::{InSpace, InitialTransformation};
pub use threshold::{Left, MaskPicture};

/// A point of a view: x, y, z in the camera's frame and the standard uncertainty of z, mm; then how much the fringes oscillate
/// around it, counts.
pub type ViewPoint = [f32; 5];

/// Reads the points of the views of a scan.
pub trait ViewPoints {
    /// Why points cannot be read.
    type Error: std::error::Error;

    /// Numbers of the views that have points, ascending.
    fn view_numbers(&self) -> Vec<usize>;

    /// Points of one of these views.
    ///
    /// # Errors
    /// They cannot be read.
    fn view_points(&self, view: usize) -> Result<Vec<ViewPoint>, Self::Error>;
}

/// Why there are no figures. `P` is why points cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ArticleError<P: std::error::Error> {
    /// Points of a view.
    #[error("{0}")]
    Points(P),
    /// No merged cloud.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Nothing to compare with.
    #[error(transparent)]
    Reference(#[from] SampleTreeError),
    #[error(
        "none of {views} views settled on the CAD by the article's method; start it from picked pairs, or mask less"
    )]
    NothingLaid {
        /// Views that the joint solve laid.
        views: usize,
    },
}
