//! A scan's session folder, opened again without an instrument.

use std::collections::BTreeMap;
use std::path::Path;

use flankscope_metrology::cloud::merge::MergeError;
use flankscope_metrology::deviation::SampleTreeError;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::Stages;

use crate::inspection::{EvaluatorError, FieldOfView, InspectError, ViewPlan, hand_eye};
use crate::scan::grid::{Grid, GridError};
use crate::scan::job::ScanError;
use crate::scan::patches::Patches;
use crate::scan::session::{Session, SessionError};
use crate::subject::Subject;

/// Why a finished scan cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FinishedScanError {
    /// What a scan could not have used either.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// Its views are no grid.
    #[error("{path}: {error}; the article's figures need views around the die, layer by layer")]
    Grid {
        /// The folder.
        path: String,
        /// Why.
        error: GridError,
    },
    /// Nothing to compare with.
    #[error(transparent)]
    Reference(#[from] SampleTreeError),
    /// The article's method laid no view.
    #[error(
        "none of {views} views settled on the CAD by the article's method; start it from picked pairs, or mask less"
    )]
    NothingLaid {
        /// Views that the joint solve laid.
        views: usize,
    },
}

impl From<SessionError> for FinishedScanError {
    fn from(error: SessionError) -> Self {
        Self::Scan(error.into())
    }
}

impl From<MergeError> for FinishedScanError {
    fn from(error: MergeError) -> Self {
        Self::Scan(error.into())
    }
}

/// The kept views of a scan, and what they are of.
#[derive(Debug)]
pub struct FinishedScan {
    pub(super) subject: Subject,
    pub(super) session: Session,
    pub(super) patches: Patches,
    pub(super) plan: ViewPlan,
    pub(super) grid: Grid,
    pub(super) gear: GearData,
    pub(super) nominal: Stages,
    pub(super) field: FieldOfView,
    pub(super) of: BTreeMap<String, String>,
}

impl FinishedScan {
    /// What a session's folder calls that which stood on the simulated bench.
    pub const BENCH: &'static str = "bench";

    /// Opens the folder of a scan of this subject.
    ///
    /// # Errors
    /// It is no such folder, damaged, of another tool or head, or its views are no grid.
    pub fn open(subject: Subject, folder: &Path) -> Result<Self, FinishedScanError> {
        let unfit = |error: EvaluatorError| ScanError::from(InspectError::from(error));
        let mut of = Session::identity(folder)?;
        for (name, hash) in &subject.hashes {
            of.insert((*name).into(), hash.clone());
        }
        let session = Session::open(folder, of.clone(), subject.seals.clone())?;
        let views = of.get("views").map_or("", String::as_str);
        let grid: Grid = views.parse().map_err(|error| FinishedScanError::Grid {
            path: folder.display().to_string(),
            error,
        })?;
        let plan = grid.plan(&subject.tool, &subject.head);
        let what = "[gear] in the tool file";
        let gear = subject.tool.gear.clone();
        Ok(Self {
            plan: plan.map_err(|error| ScanError::from(InspectError::from(error)))?,
            gear: gear.ok_or_else(|| unfit(EvaluatorError::Missing { what }))?,
            nominal: Stages::nominal(hand_eye(&subject).map_err(unfit)?),
            field: FieldOfView::of(&subject.head).map_err(unfit)?,
            patches: Patches::new(folder)?,
            session,
            subject,
            grid,
            of,
        })
    }
}
