//! From the summed frames of a view to points, pose and cells in the session folder.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use flankscope_metrology::multiview::adjustment::ViewInformation;
use flankscope_metrology::verdict::Reason;
use flankscope_profilometry::Decoder;
use flankscope_profilometry::decode::MaskOptions;

use super::grid::Grid;
use super::job::ScanError;
use super::patches::Patches;
use super::session::Session;
use super::stitch::first_information;
use super::view::{ScannedView, ViewScanner};
use crate::inspection::InspectError;
use crate::plan::ViewPlan;
use crate::subject::Subject;

/// Masks nothing, but gives every point the fringe modulation around it (smoothed over two fibre cores).
const FRINGES_ONLY: MaskOptions = MaskOptions {
    threshold_dn: 0.0,
    smoothing_px: 7.0,
};

/// Stored data of finished views.
#[derive(Debug)]
pub(super) struct Store {
    pub session: Session,
    pub patches: Patches,
    /// Each view's information on its pose, at its first pose.
    pub known: BTreeMap<usize, ViewInformation>,
}

impl Store {
    /// Stores a view that is registered to the CAD.
    pub fn keep(&mut self, view: usize, scanned: ScannedView) -> Result<Kept, ScanError> {
        let laid = match scanned.laid {
            Ok(laid) => laid,
            Err(why) => return Ok(Kept::Refused(why)),
        };
        self.session
            .keep(view, &scanned.kept, scanned.tool_from_camera)?;
        let pose = laid.information.tool_from_camera;
        self.patches
            .keep(view, pose, &laid.cell_observations, &laid.flanks)?;
        self.known.insert(view, laid.information);
        Ok(Kept::Kept)
    }
}

/// Whether a view was kept.
#[derive(Clone, Debug, PartialEq)]
pub enum Kept {
    /// It is registered to the CAD and stored in the session folder.
    Kept,
    /// It cannot be used, for this reason.
    Refused(Reason),
}

/// Views of a scan.
#[derive(Clone, Debug)]
pub(super) struct PlannedScan {
    pub plan: ViewPlan,
    /// Name of the set of views.
    pub name: String,
}

impl PlannedScan {
    /// The views of a grid, for tool and head of a subject.
    pub fn of(grid: Grid, subject: &Subject) -> Result<Self, ScanError> {
        let plan = grid.plan(&subject.tool, &subject.head);
        Ok(Self {
            plan: plan.map_err(InspectError::from)?,
            name: grid.to_string(),
        })
    }
}

/// Converts frames to stored views.
pub(super) struct ViewPipeline {
    pub plan: Arc<ViewPlan>,
    pub decoder: Arc<Decoder>,
    pub views: ViewScanner,
    pub store: Store,
}

impl ViewPipeline {
    /// Opens the session folder, which may hold an earlier part of the same scan; `further` properties must then be equal.
    pub fn open(
        subject: &Subject,
        PlannedScan { plan, name }: PlannedScan,
        folder: &Path,
        further: &BTreeMap<String, String>,
    ) -> Result<Self, ScanError> {
        let inspect = subject.tool.inspect.as_ref();
        let bands = inspect.map_or(0, |inspect| inspect.datum_height_mm.len());
        if bands > 0 {
            return Err(ScanError::DatumBands { bands });
        }
        let plan = Arc::new(plan);
        let mut of: BTreeMap<String, String> = subject
            .hashes
            .iter()
            .map(|(&name, hash)| (name.to_string(), hash.clone()))
            .collect();
        of.insert("views".into(), name);
        let points = match subject.head.core_map {
            Some(_) => "cores",
            None => "pixels",
        };
        of.insert("points".into(), points.into());
        of.extend(further.clone());
        let session = Session::open(folder, of, subject.seals.clone())?;
        let patches = Patches::new(session.folder())?;
        let known = first_information(&session, &subject.tool, &plan)?;
        let decoder = plan.decoder(&subject.head, Some(FRINGES_ONLY));
        let decoder = Arc::new(decoder.map_err(InspectError::from)?);
        let (to_decode, planned) = (Arc::clone(&decoder), Arc::clone(&plan));
        let views = ViewScanner::new(subject, to_decode, planned, known.clone());
        Ok(Self {
            plan,
            decoder,
            views: views.map_err(InspectError::from)?,
            store: Store {
                session,
                patches,
                known,
            },
        })
    }
}
