//! Opens a scan's session folder again without an instrument, for the article's figures.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use flankscope_article::{Article, ArticleError, ArticleSettings, Sections, StitchedScan};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::Stages;

use super::cell_observations::layout;
use super::grid::{Grid, GridError};
use super::job::ScanError;
use super::patches::Patches;
use super::session::{Session, SessionError};
use super::stitch::{Frame, first_information, stitch};
use crate::inspection::{EvaluatorError, InspectError, hand_eye};
use crate::plan::{FieldOfView, ViewPlan};
use crate::subject::Subject;
use flankscope_instrument::acquisition::{Recording, RecordingError};

/// Why a finished scan cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FinishedScanError {
    /// An error that a scan would report too.
    #[error(transparent)]
    Scan(#[from] ScanError),
    #[error("{path}: {error}; the article's figures need views around the die, layer by layer")]
    Grid {
        /// The folder.
        path: String,
        /// Reason.
        error: GridError,
    },
    /// The article's figures cannot be computed.
    #[error(transparent)]
    Article(#[from] ArticleError<SessionError>),
}

impl From<SessionError> for FinishedScanError {
    fn from(error: SessionError) -> Self {
        Self::Scan(error.into())
    }
}

/// Why there are no cross-sections.
#[derive(Debug, thiserror::Error)]
pub enum SectionsError {
    /// The recording cannot be used.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("the recording has no view")]
    NoViews,
    /// The recording belongs to another scan.
    #[error(
        "the recording is of {recorded}, the scan of {scanned}: name the frames that were saved with the scan"
    )]
    OtherScan {
        /// Views of the recording.
        recorded: String,
        /// Views of the scan.
        scanned: String,
    },
}

/// The kept views of a scan, with their plan.
#[derive(Debug)]
pub struct FinishedScan {
    subject: Subject,
    session: Session,
    patches: Patches,
    plan: ViewPlan,
    grid: Grid,
    gear: GearData,
    nominal: Stages,
    field: FieldOfView,
    of: BTreeMap<String, String>,
}

impl FinishedScan {
    /// Opens the folder of a scan of this subject.
    ///
    /// # Errors
    /// It is not such a folder, is damaged, belongs to another tool or head, or its views are not a grid.
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
            field: FieldOfView::of(&subject.head).map_err(|why| unfit(why.into()))?,
            patches: Patches::new(folder)?,
            session,
            subject,
            grid,
            of,
        })
    }
    /// Computes the article's figures with `settings`. These include the fraction of point pairs used when a view is registered
    /// to the one before; its default is nine tenths of the overlap of neighbours. `progress` is told how many views are laid the
    /// article's way, and of how many.
    ///
    /// # Errors
    /// No view is registered to the CAD, the folder cannot be read, or there is no common solution.
    pub fn article(
        &mut self,
        settings: &ArticleSettings,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<Article, FinishedScanError> {
        let mut elapsed_ms = BTreeMap::new();
        let mut clock = Instant::now();
        let mut lap = |what| {
            let took = clock.elapsed();
            elapsed_ms.insert(what, took.as_secs_f64() * 1e3);
            clock = Instant::now();
            took
        };
        let (session, planned) = (&self.session, &self.plan.views);
        let (tool, nominal) = (&self.subject.tool, &self.nominal);
        let first = first_information(session, tool, &self.plan)?;
        let frame = Frame {
            layout: layout(&self.gear),
            field: self.field,
            single: self.subject.station.stages.of_single_view(),
        };
        lap("open");
        let joint = stitch(session, &mut self.patches, first, tool, nominal, &frame)?;
        let took = lap("surface");
        let ours = joint.figures(session, tool, planned, took)?;
        lap("figures of surface");
        let scan = StitchedScan {
            points: session,
            tool,
            planned,
            grid: [self.grid.around, self.grid.layers],
            of: self.of.clone(),
            nominal,
            layout: frame.layout,
            joint: joint.solve(),
            ours,
            elapsed_ms,
        };
        Ok(scan.article(settings, progress)?)
    }

    /// Cross-sections of the fringes in the frames that were saved with this scan.
    ///
    /// # Errors
    /// The frames belong to another scan, or differ from plan and head file.
    pub fn sections(&self, recording: &Recording) -> Result<Sections, SectionsError> {
        let scanned = self.grid.to_string();
        if recording.index.grid.as_ref() != Some(&scanned) {
            let recorded = recording.index.grid.clone();
            return Err(SectionsError::OtherScan {
                recorded: recorded.unwrap_or_else(|| "no grid".into()),
                scanned,
            });
        }
        let head = &self.subject.head;
        let views = recording.views(head)?;
        let first = views.first().ok_or(SectionsError::NoViews)?;
        let size_px = [head.camera.width_px, head.camera.height_px];
        let sections = Sections::of_first_view(first.images(), &recording.plan, size_px);
        Ok(sections.map_err(RecordingError::from)?)
    }
}
