//! The scan from hello to result: captures of as many views as a plan holds, kept one by one, stitched at the end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankscope_metrology::cloud::merge::{MergeError, check_voxel_size};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::{JointError, Stages};
use flankscope_metrology::multiview::cylinder::CylinderMap;
use flankscope_profilometry::date::Date;
use flankscope_protocol::Command;
use tokio::signal::unix::{SignalKind, signal};

use super::comparison::{self, Method};
use super::grid::Grid;
use super::lay::layout;
use super::metrics::{self, MetricsError};
use super::paper::{self, PaperSettings};
use super::reference::{Reference, ReferenceError};
use super::result::Scan;
use super::session::SessionError;
use super::stitch::{Optics, stitch};
use super::stranger::{ambiguous_teeth, stretch_of_views, turned_rad, unlike_teeth};
use super::view::ScannedView;
use super::workshop::{Store, Workshop};
use crate::controller::{Client, ClientSettings};
use crate::inspection::{
    EvaluatorError, FrameCount, Handover, InspectError, Progress as CheckProgress, Run, Station,
    Subject, Timing, hand_eye, peak_memory_mb,
};
use crate::origin::Setting;
use flankscope_frames::{Frame, SharedRoot, monotonic_ns};

/// Why there is no scan.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// The instrument does not work.
    #[error(transparent)]
    Instrument(#[from] InspectError),
    /// The session folder is unusable.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// No common solution.
    #[error(transparent)]
    Joint(#[from] JointError),
    /// Somebody stopped it.
    #[error(
        "interrupted after {done} of {of} views; they are in {folder}: scan into it again to go on"
    )]
    Interrupted {
        /// Views that are kept.
        done: usize,
        /// Of how many.
        of: usize,
        /// Session folder.
        folder: PathBuf,
    },
    /// No merged cloud.
    #[error(transparent)]
    Merge(#[from] MergeError),
}

/// How far a scan is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// Views that are done, of how many, and the time that the others will take at this pace.
    Views {
        /// Done.
        done: usize,
        /// Of how many.
        of: usize,
        /// Remaining.
        remaining: Duration,
    },
    /// A view is captured again.
    Recapture(usize),
    /// All views are laid on the CAD together.
    Stitching,
}

/// The instrument's host side for scans, with its session folder open.
#[derive(Debug)]
pub struct Scanner {
    pub(super) station: Station<ScannedView>,
    pub(super) store: Store,
    pub(super) grid: Grid,
    pub(super) gear: GearData,
    pub(super) nominal: Stages,
    pub(super) resumed: usize,
    method: Method,
    paper: PaperSettings,
    reference: Option<Reference>,
}

impl Scanner {
    /// Opens the session folder, where an earlier part of the same scan may lie, and starts the threads. `of` names what
    /// else must be the same for the scan to go on, beside grid, tool, CAD and head. The result says that it comes from
    /// `setting`.
    ///
    /// # Errors
    /// The subject is unfit, the folder is another scan's or damaged, or shared memory is refused.
    pub fn open(
        subject: Subject,
        setting: Setting,
        grid: Grid,
        folder: &Path,
        of: &BTreeMap<String, String>,
        root: Arc<SharedRoot>,
    ) -> Result<Self, ScanError> {
        let unfit = |error: EvaluatorError| ScanError::from(InspectError::from(error));
        let what = "[gear] in the tool file";
        let gear = subject.tool.gear.clone();
        let gear = gear.ok_or_else(|| unfit(EvaluatorError::Missing { what }))?;
        let nominal = Stages::nominal(*hand_eye(&subject).map_err(unfit)?.isometry());
        let Workshop {
            itinerary,
            decoder,
            mut views,
            store,
        } = Workshop::open(&subject, grid, folder, of)?;
        let resumed = store.known.len();
        let mut station = Station::start(subject, itinerary, decoder, root, move |view, sums| {
            views.scan(view, sums)
        })?;
        station.setting = Some(setting);
        Ok(Self {
            station,
            store,
            grid,
            gear,
            nominal,
            resumed,
            method: Method::default(),
            paper: PaperSettings::default(),
            reference: None,
        })
    }

    /// Compares with an earlier scan of the same die: whether it was put down turned by whole teeth since.
    ///
    /// # Errors
    /// The earlier result cannot be used.
    pub fn against(mut self, earlier: Option<&Path>) -> Result<Self, ReferenceError> {
        let cad = self.station.subject.hashes.get("cad").map(String::as_str);
        let setting = self.station.setting.as_ref();
        let simulated = setting.map(|setting| setting.link.is_simulated());
        let load = |path: &Path| Reference::load(path, cad, simulated);
        self.reference = earlier.map(load).transpose()?;
        Ok(self)
    }

    /// Chooses how the views are stitched; the captured views are the same for every method.
    ///
    /// # Errors
    /// The voxel size is none.
    pub fn by_method(mut self, method: Method, paper: PaperSettings) -> Result<Self, ScanError> {
        check_voxel_size(paper.voxel_mm)?;
        (self.method, self.paper) = (method, paper);
        Ok(self)
    }

    /// Captures what is missing and stitches everything.
    ///
    /// # Errors
    /// The scan could not begin, the session folder cannot be written, or the views have no common solution. Views that
    /// are lost on the way are holes in the map.
    pub fn scan(
        &mut self,
        port: &Path,
        settings: ClientSettings,
        mut watch: impl FnMut(Progress),
    ) -> Result<Scan, ScanError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime = runtime.map_err(|_| InspectError::Thread { thread: "I/O" })?;
        let begun_ns = monotonic_ns();
        // What a head that must not judge would measure is not worth hours.
        let unfit = self.station.subject.head.fit_on(Date::today()).err();
        let (mut run, lost, firmware) = runtime.block_on(async {
            let client = Client::connect(port, settings).await;
            let mut client = client.map_err(InspectError::from)?;
            self.station.make_ready(&mut client, &mut |_| {}).await?;
            let (run, lost) = match &unfit {
                Some(_) => (Run::new(Vec::new(), None), BTreeMap::new()),
                None => self.capture_all(&mut client, &mut watch).await?,
            };
            Ok::<_, ScanError>((run, lost, client.identity().firmware))
        })?;
        let mut scan = match unfit {
            Some(unfit) => self.nothing(unfit.to_string())?,
            None => {
                watch(Progress::Stitching);
                self.stitch_all(&lost)?
            }
        };
        let since = |from: u64| monotonic_ns().saturating_sub(from) as f64 / 1e6;
        scan.timing_ms = Timing {
            total: since(begun_ns),
            positioning: run.timeline.positioning_ms(),
            exposure: run.timeline.exposure_ms(),
            last_exposure_to_verdict: if run.last_exposure_ns > 0 {
                since(run.last_exposure_ns)
            } else {
                0.0
            },
        };
        scan.last_view_to_result_ms = scan.timing_ms.last_exposure_to_verdict;
        scan.frames = FrameCount {
            triggered: run.triggered,
            received: run.received,
            bytes_copied: Frame::bytes_copied(),
            recaptured_views: run.recaptured,
            handover_us: Handover::of(&mut run.handover_ns),
        };
        let [major, minor, patch] = firmware;
        scan.versions
            .insert("firmware", format!("{major}.{minor}.{patch}"));
        scan.peak_memory_mb = peak_memory_mb();
        Ok(scan)
    }

    /// Adds to a finished scan what the article's metrics say of it, and with `raster` its unrolled comparison.
    ///
    /// # Errors
    /// The CAD has no surface where the gear is, or the session folder cannot be read.
    pub fn compare(&self, scan: &mut Scan, raster: bool) -> Result<(), MetricsError> {
        let tool = &self.station.subject.tool;
        scan.metrics = metrics::compare(scan, &self.store.session, tool, &self.gear, raster)?;
        Ok(())
    }

    /// Captures every view that the session does not hold, a lost one once more; returns why views stayed lost.
    async fn capture_all(
        &mut self,
        client: &mut Client,
        watch: &mut impl FnMut(Progress),
    ) -> Result<(Run<ScannedView>, BTreeMap<usize, String>), ScanError> {
        let limits = client.identity().limits;
        let of = self.station.itinerary.views.len();
        let held: Vec<usize> = self.store.session.views().map(|(view, _)| view).collect();
        let wanted: Vec<usize> = (0..of).filter(|view| !held.contains(view)).collect();
        let mut run = Run::new(wanted.clone(), None);
        let mut lost = BTreeMap::new();
        let begun = Instant::now();
        let interrupt = |kind| signal(kind).map_err(|_| InspectError::Thread { thread: "I/O" });
        let mut stop_key = interrupt(SignalKind::interrupt())?;
        let mut stop_order = interrupt(SignalKind::terminate())?;
        for views in wanted.chunks(flankscope_protocol::plan::MAX_VIEWS) {
            let mut open = views.to_vec();
            for attempt in 0..2 {
                if attempt > 0 {
                    open.iter()
                        .for_each(|&view| watch(Progress::Recapture(view)));
                    run.recaptured += open.len() as u32;
                }
                let (mut interrupted, mut nobody) = (false, |_: CheckProgress| {});
                let stopped = tokio::select! {
                    stopped = self.station.capture(
                        client, &mut run, &open, &limits, &mut nobody,
                    ) => stopped?,
                    _ = stop_key.recv() => { interrupted = true; None }
                    _ = stop_order.recv() => { interrupted = true; None }
                };
                for &view in &open {
                    let why = match run.outcomes.remove(&view) {
                        Some(scanned) => match self.store.keep(view, scanned)? {
                            Ok(()) => {
                                lost.remove(&view);
                                continue;
                            }
                            Err(why) => Some(why),
                        },
                        None => run.problems.get(&view).cloned().or_else(|| stopped.clone()),
                    };
                    lost.insert(
                        view,
                        why.unwrap_or_else(|| "the view was not captured".into()),
                    );
                }
                self.store.session.commit()?;
                if interrupted {
                    // The head comes out; a link that is gone has already seen to that.
                    let _ = client.order(&Command::Abort).await;
                    return Err(ScanError::Interrupted {
                        done: self.store.session.views().count(),
                        of,
                        folder: self.store.session.folder().to_path_buf(),
                    });
                }
                open.retain(|view| lost.contains_key(view));
                if open.is_empty() {
                    break;
                }
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
        Ok((run, lost))
    }

    /// A scan without a view, and why.
    fn nothing(&mut self, why: String) -> Result<Scan, ScanError> {
        let Scanner { station, store, .. } = self;
        let tool = &station.subject.tool;
        let optics = Optics::of(&station.subject.head).map_err(InspectError::from)?;
        let none = BTreeMap::new();
        let empty = stitch(
            &store.session,
            &mut store.patches,
            none,
            tool,
            &self.nominal,
            layout(&self.gear),
            optics,
        )?;
        let mut scan = self.describe(empty, &BTreeMap::new())?;
        scan.disown(why);
        Ok(scan)
    }

    /// Stitches by our method, and by the article's if it was asked for.
    fn stitch_all(&mut self, lost: &BTreeMap<usize, String>) -> Result<Scan, ScanError> {
        let first = std::mem::take(&mut self.store.known);
        let subject = &self.station.subject;
        let (tool, itinerary) = (&subject.tool, &self.station.itinerary);
        let (session, nominal, planned) = (&self.store.session, &self.nominal, &itinerary.views);
        let layout = layout(&self.gear);
        let optics = Optics::of(&subject.head).map_err(InspectError::from)?;
        let begun = Instant::now();
        let ours = stitch(
            session,
            &mut self.store.patches,
            first,
            tool,
            nominal,
            layout,
            optics,
        )?;
        let took = begun.elapsed();
        let figures = comparison::of_surface(&ours, session, tool, planned, took)?;
        let shared = ours.joint.stages.clone();
        let stretch = stretch_of_views(&ours, session, tool)?;
        let mut scan = self.describe(ours, lost)?;
        scan.teeth_stretch_ratio = stretch;
        let turned = turned_rad(&shared, nominal, planned);
        scan.teeth_turned_deg = turned.to_degrees();
        let stranger = stretch.and_then(|stretch| unlike_teeth(stretch, &self.gear));
        if let Some(why) = stranger.or_else(|| ambiguous_teeth(turned, &self.gear)) {
            scan.disown(why);
            return Ok(scan);
        }
        if let Some(reference) = &self.reference {
            let placement = reference.compare(&scan.flank_means, self.gear.teeth);
            let objection = placement.objection();
            scan.placement = Some(placement);
            if let Some(why) = objection {
                scan.disown(why);
                return Ok(scan);
            }
        }
        scan.methods.push(figures);
        if self.method == Method::Surface {
            return Ok(scan);
        }
        let begun = Instant::now();
        let map = CylinderMap::new(layout);
        let laid = paper::stitch(session, tool, itinerary, nominal, map, &self.paper)?;
        let took = begun.elapsed();
        let figures = comparison::of_paper(&laid, &shared, &self.paper, planned, took);
        if self.method == Method::Paper {
            scan.show_instead(laid, &figures);
        }
        scan.methods.push(figures);
        Ok(scan)
    }
}
