//! The scan from connecting to its result: captures with as many views as a plan holds, views kept one by one and stitched at the end.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankscope_metrology::cloud::merge::{MergeError, check_voxel_size};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::io::points::Format;
use flankscope_metrology::multiview::adjustment::{AdjustmentError, Stages};
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::Accumulator;

use super::bore_size::size_sigma_mm;
use super::cell_observations::layout;
use super::clouds::CloudsError;
use super::die_identity::{ambiguous_teeth, stretch_of_views, turned_rad, unlike_teeth};
use super::fine_map::{self, FineMapError};
use super::full_cloud::{self, CloudError};
use super::gear::{self, ScanGearError};
use super::grid::{Grid, GridError};
use super::metrics::{self, MetricsError};
use super::reference::{Reference, ReferenceError};
use super::session::SessionError;
use super::stitch::{Frame, stitch};
use super::view::ScannedView;
use super::view_pipeline::{Kept, PlannedScan, Store, ViewPipeline};
use crate::bookkeeping::{frame_count, peak_memory_mb, timing};
use crate::inspection::{EvaluatorError, InspectError, calibration_um, hand_eye};
use crate::job::{self, Job, RecordError, RecordedFrames, Source, connect, runtime};
use crate::plan::FieldOfView;
use crate::subject::Subject;
use flankscope_article::{ArticleError, ArticleSettings, MethodResult};
use flankscope_frames::{SharedRoot, monotonic_ns};
use flankscope_instrument::acquisition::{
    AcquisitionError, AfterStop, FrameIndex, Progress as CheckProgress, Run, Stop,
};
use flankscope_instrument::controller::{Client, ClientSettings};
use flankscope_record::document::scan::Scan;
use flankscope_record::origin::Setting;

/// Why a scan failed.
#[derive(Debug, thiserror::Error)]
pub enum ScanError {
    /// The instrument failed.
    #[error(transparent)]
    Instrument(#[from] InspectError),
    /// Controller or camera cannot be used.
    #[error(transparent)]
    Acquisition(#[from] AcquisitionError),
    /// The session folder cannot be used.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Recorded clouds cannot be used.
    #[error(transparent)]
    Clouds(#[from] CloudsError),
    /// The recording's grid is invalid.
    #[error("grid of the recording: {0}")]
    Grid(#[from] GridError),
    /// The tool file names datum bands, which determine the pose of a single view only.
    #[error(
        "inspect.datum_height_mm of the tool file names {bands} bands that the pose of a check rests on; a scan lays all its views \
         on the whole die and cannot use them: scan with a tool file that leaves the key out"
    )]
    DatumBands {
        /// Number of bands.
        bands: usize,
    },
    #[error(
        "view {view} of the recording was not taken from a place of its grid {grid}; leave grid out for views of any place"
    )]
    OffGrid {
        /// View, from 1.
        view: usize,
        grid: String,
    },
    /// The poses of a recording come from a table instead of the stages.
    #[error(
        "poses = {:?} in frames.toml: a scan lays its views together by the errors of two stages, not by a table of poses; leave it out \
         where stages moved, or use inspect --frames",
        poses.display()
    )]
    PosesFromTable {
        /// The table.
        poses: PathBuf,
    },
    /// The views have no common solution.
    #[error(transparent)]
    Adjustment(#[from] AdjustmentError),
    /// The operator interrupted it.
    #[error(
        "interrupted after {done} of {of} views; they are in {folder}: scan into it again to go on"
    )]
    Interrupted {
        /// Number of kept views.
        done: usize,
        /// Number of views.
        of: usize,
        /// Session folder.
        folder: PathBuf,
    },
    /// The voxel size is invalid.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// The article's method cannot stitch the views.
    #[error(transparent)]
    Article(#[from] ArticleError<SessionError>),
}

/// Stitching method of the result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// All views on the CAD surface, in one adjustment.
    #[default]
    Surface,
    /// The article's method; ours for comparison.
    Article,
    /// Our method; the article's for comparison.
    Both,
}

/// Progress of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Views that are done, with the remaining time at the present pace.
    Views {
        /// Number of views done.
        done: usize,
        /// Number of views.
        of: usize,
        /// Remaining time.
        remaining: Duration,
    },
    /// A view is captured again.
    Recapture(usize),
    /// The adjustment of all views has begun.
    Stitching,
}

/// Host side of the instrument for scans, with an open session folder.
#[derive(Debug)]
pub struct Scanner {
    pub(super) job: Job<ScannedView>,
    pub(super) store: Store,
    /// Name of the set of views.
    pub(super) views: String,
    pub(super) gear: GearData,
    pub(super) nominal: Stages,
    pub(super) field: FieldOfView,
    pub(super) resumed: usize,
    method: Method,
    article: ArticleSettings,
    reference: Option<Reference>,
}

impl Scanner {
    /// Opens the session folder, which may hold an earlier part of the same scan, and starts the threads. `of` lists further
    /// properties besides grid, tool, CAD and head that must be equal for the scan to be continued. The result states `setting`
    /// as its origin.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, the folder belongs to another scan or is damaged, or shared memory cannot be created.
    pub fn open(
        subject: Subject,
        setting: Setting,
        grid: Grid,
        folder: &Path,
        of: &BTreeMap<String, String>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, ScanError> {
        let planned = PlannedScan::of(grid, &subject)?;
        Self::start(subject, setting, planned, (folder, of), Some(root))
    }

    /// Like [`Self::open`] for any planned views; frames come from the camera process below `camera`, or from a recording if this
    /// is `None`.
    pub(super) fn start(
        subject: Subject,
        setting: Setting,
        planned: PlannedScan,
        (folder, of): (&Path, &BTreeMap<String, String>),
        camera: Option<Arc<SharedRoot>>,
    ) -> Result<Self, ScanError> {
        let unfit = |error: EvaluatorError| ScanError::from(InspectError::from(error));
        let what = "[gear] in the tool file";
        let gear = subject.tool.gear.clone();
        let gear = gear.ok_or_else(|| unfit(EvaluatorError::Missing { what }))?;
        let nominal = Stages::nominal(hand_eye(&subject).map_err(unfit)?);
        let field = FieldOfView::of(&subject.head).map_err(|why| unfit(why.into()))?;
        let name = planned.name.clone();
        let ViewPipeline {
            plan,
            decoder,
            mut views,
            store,
        } = ViewPipeline::open(&subject, planned, folder, of)?;
        let resumed = store.known.len();
        let scan = move |view, sums: &Accumulator| views.scan(view, sums);
        Ok(Self {
            job: Job::start(subject, setting, plan, &decoder, camera, scan)?,
            store,
            views: name,
            gear,
            nominal,
            field,
            resumed,
            method: Method::default(),
            article: ArticleSettings::default(),
            reference: None,
        })
    }

    /// Compares with an earlier scan of the same die, to detect whether it was rotated by whole teeth since.
    ///
    /// # Errors
    /// The earlier result cannot be used.
    pub fn against(&mut self, earlier: Option<&Path>) -> Result<(), ReferenceError> {
        let cad = self.job.subject.hashes.get("cad").map(String::as_str);
        let simulated = self.job.setting.link.is_simulated();
        let load = |path: &Path| Reference::load(path, cad, simulated, &self.job.subject.seals);
        self.reference = earlier.map(load).transpose()?;
        Ok(())
    }

    /// Chooses the stitching method; the captured views are the same for every method.
    ///
    /// # Errors
    /// The voxel size is invalid.
    pub fn by_method(&mut self, method: Method, article: ArticleSettings) -> Result<(), ScanError> {
        check_voxel_size(article.voxel_mm)?;
        let article = article.for_toothing(self.gear.radial_threshold_mm);
        (self.method, self.article) = (method, article);
        Ok(())
    }

    /// Captures the missing views and stitches all.
    ///
    /// # Errors
    /// The scan could not begin, the session folder cannot be written, or the views have no common solution. Lost views are holes
    /// in the map.
    pub fn scan(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        mut watch: impl FnMut(Progress),
    ) -> Result<Scan, ScanError> {
        let begun_ns = monotonic_ns();
        let (captured, [major, minor, patch]) = runtime()?.block_on(async {
            let acquisition = &self.job.acquisition;
            let mut client = connect(acquisition, port, settings, &mut |_| {}).await?;
            let source = Source::Live(&mut client);
            let captured = self.capture(source, &mut watch).await?;
            Ok::<_, ScanError>((captured, client.identity().firmware))
        })?;
        let mut scan = self.conclude(captured, begun_ns, watch)?;
        scan.versions
            .insert("firmware", format!("{major}.{minor}.{patch}"));
        Ok(scan)
    }

    /// Sums recorded frames of the views that the session folder lacks, and stitches all.
    ///
    /// # Errors
    /// The session folder cannot be written, or the views have no common solution. Views without frames are holes in the map.
    pub fn scan_recorded(
        &mut self,
        frames: &mut RecordedFrames,
        mut watch: impl FnMut(Progress),
    ) -> Result<Scan, ScanError> {
        let begun_ns = monotonic_ns();
        let captured = runtime()?.block_on(self.capture(Source::Recorded(frames), &mut watch))?;
        self.conclude(captured, begun_ns, watch)
    }

    /// Captures every view that the session folder lacks, if the head may judge.
    async fn capture(
        &mut self,
        source: Source<'_>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Captured, ScanError> {
        let mut captured = Captured::unless(self.job.unfit(&source));
        if captured.unfit.is_none() {
            match source {
                Source::Live(client) => self.capture_all(client, &mut captured, watch).await?,
                Source::Recorded(frames) => self.play_scan(frames, &mut captured, watch).await?,
            }
        }
        Ok(captured)
    }

    /// The result of the captured views, including those already in the session folder.
    pub(super) fn conclude(
        &mut self,
        Captured { unfit, run, lost }: Captured,
        begun_ns: u64,
        mut watch: impl FnMut(Progress),
    ) -> Result<Scan, ScanError> {
        let mut scan = match unfit {
            Some(why) => self.nothing(&why)?,
            None => {
                watch(Progress::Stitching);
                self.stitch_all(&lost)?
            }
        };
        let verdict_ns = match run.counts.last_exposure_ns {
            0 => 0, // nothing was exposed
            _ => monotonic_ns(),
        };
        scan.timing_ms = timing(&run, begun_ns, verdict_ns);
        scan.last_view_to_result_ms = scan.timing_ms.last_exposure_to_verdict;
        scan.frames = frame_count(run.counts);
        scan.peak_memory_mb = peak_memory_mb();
        Ok(scan)
    }

    /// Adds the article's metrics to a finished scan.
    ///
    /// # Errors
    /// The CAD has no surface where the gear is, or the session folder cannot be read.
    pub fn compare(&self, scan: &mut Scan) -> Result<(), MetricsError> {
        let tool = &self.job.subject.tool;
        scan.metrics = metrics::compare(scan, &self.store.session, tool, &self.gear)?;
        Ok(())
    }

    /// Adds profile, helix and pitch of every tooth to a finished scan, from every point of every registered view.
    ///
    /// # Errors
    /// The views are not registered reliably, their uncertainty is not known, or the session folder cannot be read.
    pub fn evaluate_gear(&self, scan: &mut Scan) -> Result<(), ScanGearError> {
        scan.gear = Some(gear::evaluate(scan, &self.store.session, &self.gear)?);
        Ok(())
    }

    /// Checks whether a mesh of this gear can have this spacing.
    ///
    /// # Errors
    /// The spacing is out of range.
    pub fn check_spacing(&self, spacing_mm: f64) -> Result<(), FineMapError> {
        fine_map::layout(&self.gear, spacing_mm).map(drop)
    }

    /// The map of a finished scan in cells of `spacing_mm` along the toothing's profile and its axis.
    ///
    /// # Errors
    /// The spacing is out of range, or the session folder cannot be read.
    pub fn fine_map(&self, scan: &Scan, spacing_mm: f64) -> Result<CylinderMap, FineMapError> {
        let layout = fine_map::layout(&self.gear, spacing_mm)?;
        let tool = &self.job.subject.tool;
        Ok(fine_map::merged(scan, &self.store.session, tool, layout)?)
    }

    /// Writes every point of every registered view of a finished scan, in its final pose; returns their number.
    ///
    /// # Errors
    /// The session folder cannot be read, or `out` not be written.
    pub fn write_cloud(
        &self,
        scan: &Scan,
        format: Format,
        out: &mut dyn Write,
    ) -> Result<u64, CloudError> {
        full_cloud::write(scan, &self.store.session, format, out)
    }

    /// Captures every view that the session folder lacks, in groups.
    async fn capture_all(
        &mut self,
        client: &mut Client,
        captured: &mut Captured,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(), ScanError> {
        let of = self.job.plan.views.len();
        let held: Vec<usize> = self.store.session.views().map(|(view, _)| view).collect();
        let wanted: Vec<usize> = (0..of).filter(|view| !held.contains(view)).collect();
        let Captured { run, lost, .. } = captured;
        run.wanted.clone_from(&wanted);
        let begun = Instant::now();
        for views in wanted.chunks(flankscope_protocol::plan::MAX_VIEWS) {
            let store = &mut self.store;
            let keep = |run: &mut Run<ScannedView>, views: &[usize], stopped: Option<&Stop>| {
                keep(store, lost, run, views, stopped)
            };
            let mut again = |progress: CheckProgress| {
                if let CheckProgress::Recapture(view) = progress {
                    watch(Progress::Recapture(view));
                }
            };
            let captured = self.job.acquisition.capture_settled(
                client,
                run,
                views,
                AfterStop::GoOn,
                keep,
                &mut again,
            );
            if let Some(Stop::Interrupted) = captured.await? {
                return Err(ScanError::Interrupted {
                    done: self.store.session.views().count(),
                    of,
                    folder: self.store.session.folder().to_path_buf(),
                });
            }
            let done = self.store.session.views().count() + lost.len();
            let new = done.saturating_sub(self.resumed).max(1);
            let pace = begun.elapsed() / new as u32;
            watch(Progress::Views {
                done,
                of,
                remaining: pace * (of - done) as u32,
            });
        }
        Ok(())
    }

    /// Cell layout and tolerances for the adjustment.
    fn frame(&self) -> Frame {
        Frame {
            layout: layout(&self.gear),
            field: self.field,
            single: self.job.subject.station.stages.of_single_view(),
        }
    }

    /// A scan without views, with the reason.
    fn nothing(&mut self, why: &Reason) -> Result<Scan, ScanError> {
        let frame = self.frame();
        let none = BTreeMap::new();
        let empty = stitch(
            &self.store.session,
            &mut self.store.patches,
            none,
            &self.job.subject.tool,
            &self.nominal,
            &frame,
        )?;
        let mut scan = self.describe(empty, &BTreeMap::new())?;
        scan.invalidate(why);
        Ok(scan)
    }

    /// Stitches by our method, and by the article's if it was asked for.
    fn stitch_all(&mut self, lost: &BTreeMap<usize, Reason>) -> Result<Scan, ScanError> {
        let first = std::mem::take(&mut self.store.known);
        let (tool, plan) = (&self.job.subject.tool, &self.job.plan);
        let (session, nominal, planned) = (&self.store.session, &self.nominal, &plan.views);
        let frame = self.frame();
        let begun = Instant::now();
        let ours = stitch(
            session,
            &mut self.store.patches,
            first,
            tool,
            nominal,
            &frame,
        )?;
        let took = begun.elapsed();
        let figures = ours.figures(session, tool, planned, took)?;
        let shared = ours.adjustment.stages.clone();
        let stretch = stretch_of_views(&ours, session, tool)?;
        let mut scan = self.describe(ours, lost)?;
        scan.teeth_stretch_ratio = stretch;
        let lateral_mm = 1e-3 * calibration_um(tool, &self.job.subject.head);
        let half_field_mm = 0.5 * self.field.width_mm;
        scan.take_size_sigma(size_sigma_mm(
            &self.gear,
            stretch,
            lateral_mm,
            half_field_mm,
        ));
        let turned = turned_rad(&shared, nominal, planned, self.field.reach_mm);
        scan.teeth_turned_deg = turned.to_degrees();
        let other_die = stretch.and_then(|stretch| unlike_teeth(stretch, &self.gear));
        if let Some(why) = other_die.or_else(|| ambiguous_teeth(turned, &self.gear)) {
            scan.invalidate(&why);
            return Ok(scan);
        }
        if let Some(reference) = &self.reference {
            let placement = reference.compare(&scan.flank_means, self.gear.teeth);
            let objection = placement.objection();
            scan.placement = Some(placement);
            if let Some(why) = objection {
                scan.invalidate(&why);
                return Ok(scan);
            }
        }
        scan.methods.push(figures);
        if self.method == Method::Surface {
            return Ok(scan);
        }
        let begun = Instant::now();
        let map = CylinderMap::new(frame.layout);
        let settings = &self.article;
        let laid = flankscope_article::stitch(
            session,
            tool,
            planned,
            nominal,
            map,
            settings,
            &mut |_, _| {},
        )?;
        let took = begun.elapsed();
        let figures = MethodResult::of_article(&laid, &shared, &self.article, planned, took);
        if self.method == Method::Article {
            scan.show_instead(laid, &figures);
        }
        scan.methods.push(figures);
        Ok(scan)
    }
}

impl Scanner {
    /// Also writes the frames of all following captures into `folder`, which must exist.
    ///
    /// # Errors
    /// A thread ended early.
    pub fn save_frames(&mut self, folder: &Path) -> Result<(), AcquisitionError> {
        self.job.save_frames(folder)
    }

    /// Writes the index of the frames that were saved for a scan. `head` is the head file in the same folder.
    ///
    /// # Errors
    /// A file was not written.
    pub fn record(&mut self, folder: &Path, head: &Path) -> Result<(), RecordError> {
        let note = FrameIndex {
            grid: Some(self.views.clone()),
            ..FrameIndex::default()
        };
        self.job.write_recording(folder, head, note)
    }
}

/// Result of the capture of a scan's views; the views themselves are in the session folder.
pub(super) struct Captured {
    /// Why the head must not judge, if so; nothing was captured then.
    unfit: Option<Reason>,
    pub run: Run<ScannedView>,
    /// Reasons of views that are missing in the session folder.
    pub lost: BTreeMap<usize, Reason>,
}

impl Captured {
    /// Without captured views yet.
    pub fn unless(unfit: Option<Reason>) -> Self {
        Self {
            unfit,
            run: Run::new(Vec::new(), None),
            lost: BTreeMap::new(),
        }
    }
}

/// Stores the outcomes of these views; returns those that are lost so far, with reasons.
pub(super) fn keep(
    store: &mut Store,
    lost: &mut BTreeMap<usize, Reason>,
    run: &mut Run<ScannedView>,
    views: &[usize],
    stopped: Option<&Stop>,
) -> Result<Vec<usize>, ScanError> {
    let mut open = Vec::new();
    for &view in views {
        let why = match run.outcomes.remove(&view) {
            Some(scanned) => match store.keep(view, scanned)? {
                Kept::Kept => {
                    lost.remove(&view);
                    continue;
                }
                Kept::Refused(why) => why,
            },
            None => match (run.problems.get(&view), stopped) {
                (Some(problem), _) => job::view_lost(problem),
                (None, Some(stopped)) => job::stopped(stopped),
                (None, None) => Reason::instrument(Code::NotCaptured, "the view was not captured"),
            },
        };
        lost.insert(view, why);
        open.push(view);
    }
    store.session.commit()?;
    Ok(open)
}
