//! The scan from hello to result: captures of as many views as a plan holds, kept one by one, stitched at the end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use flankscope_metrology::cylinder::CylinderMap;
use flankscope_metrology::frames::{Camera, Rigid, Tool as ToolFrame};
use flankscope_metrology::gear::{Flank, GearData};
use flankscope_metrology::joint::{JointError, Stages};
use flankscope_metrology::merge::{MergeError, check_voxel_size};
use flankscope_metrology::spacing::opposite;
use flankscope_metrology::verdict::{Rule, Verdict, combine, decide, probability_below};
use flankscope_profilometry::date::Date;
use flankscope_protocol::Command;
use tokio::signal::unix::{SignalKind, signal};

use super::comparison::{self, Method};
use super::coverage::{Coverage, LEAST_COVERAGE};
use super::grid::Grid;
use super::lay::layout;
use super::metrics::{self, MetricsError};
use super::paper::{self, PaperSettings};
use super::result::{Form, Joint, OppositeTeeth, Scan, ScanRegistration, StageErrors, Stitching};
use super::session::SessionError;
use super::stitch::{Stitched, stitch};
use super::stranger::{ambiguous_teeth, stretch_of_views, turned_rad, unlike_teeth};
use super::view::ScannedView;
use super::workshop::{Store, Workshop};
use crate::capture::{Frame, SharedRoot, monotonic_ns};
use crate::controller::{Client, ClientSettings};
use crate::inspection::{
    EvaluatorError, Feature, FrameCount, Handover, InspectError, Progress as CheckProgress, Run,
    Station, Subject, Timing, calibration_um, field_slope, hand_eye, peak_memory_mb,
};

/// Fewer registered views than this share do not describe the die.
const LEAST_REGISTERED: f64 = 0.8;
/// A flank with fewer cells seen is not judged.
const LEAST_CELLS: usize = 20;

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
    station: Station<ScannedView>,
    store: Store,
    grid: Grid,
    gear: GearData,
    nominal: Stages,
    resumed: usize,
    method: Method,
    paper: PaperSettings,
}

impl Scanner {
    /// Opens the session folder, where an earlier part of the same scan may lie, and starts the threads. `of` names what
    /// else must be the same for the scan to go on, beside grid, tool, CAD and head.
    ///
    /// # Errors
    /// The subject is unfit, the folder is another scan's or damaged, or shared memory is refused.
    pub fn open(
        subject: Subject,
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
        let station = Station::start(subject, itinerary, decoder, root, move |view, sums| {
            views.scan(view, sums)
        })?;
        Ok(Self {
            station,
            store,
            grid,
            gear,
            nominal,
            resumed,
            method: Method::default(),
            paper: PaperSettings::default(),
        })
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
        let over = (layout(&self.gear), field_slope(&station.subject.head));
        let none = BTreeMap::new();
        let empty = stitch(
            &store.session,
            &mut store.patches,
            none,
            tool,
            &self.nominal,
            over,
        )?;
        let mut scan = self.describe(empty, &BTreeMap::new());
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
        let over = (layout, field_slope(&subject.head));
        let begun = Instant::now();
        let ours = stitch(session, &mut self.store.patches, first, tool, nominal, over)?;
        let took = begun.elapsed();
        let figures = comparison::of_surface(&ours, session, tool, planned, took)?;
        let shared = ours.joint.stages.clone();
        let stretch = stretch_of_views(&ours, session, tool)?;
        let mut scan = self.describe(ours, lost);
        scan.teeth_stretch_ratio = stretch;
        let turned = turned_rad(&shared, nominal, planned);
        scan.teeth_turned_deg = turned.to_degrees();
        let stranger = stretch.and_then(|stretch| unlike_teeth(stretch, &self.gear));
        if let Some(why) = stranger.or_else(|| ambiguous_teeth(turned, &self.gear)) {
            scan.disown(why);
            return Ok(scan);
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

    fn describe(&self, stitched: Stitched, lost: &BTreeMap<usize, String>) -> Scan {
        let Stitched {
            views,
            refused,
            joint,
            rounds,
            settled,
            steps,
            relaid,
            map,
            quality,
            elapsed_ms,
        } = stitched;
        let mut lost = lost.clone();
        lost.extend(refused);
        let laid: BTreeMap<usize, _> = views
            .iter()
            .zip(joint.strays.iter().zip(&joint.poses))
            .map(|((view, info), (stray, pose))| (*view, (info.rms_mm, stray, pose)))
            .collect();
        let planned = &self.station.itinerary.views;
        let registration = planned.iter().enumerate().map(|(view, at)| {
            let found = laid.get(&view);
            ScanRegistration {
                view,
                rotation_deg: at.rotation_rad.to_degrees(),
                vertical_mm: at.vertical_mm,
                status: if found.is_some() {
                    "registered"
                } else {
                    "lost"
                },
                reason: lost.get(&view).cloned(),
                rms_um: found.map(|(rms_mm, ..)| rms_mm * 1e3),
                stray_um: found.map(|(_, stray, _)| stray.fixed_rows::<3>(3).norm() * 1e3),
                stray_turn_mdeg: found.map(|(_, stray, _)| stray[2].to_degrees() * 1e3),
                tool_from_camera: found
                    .map(|(.., pose)| Rigid::<ToolFrame, Camera>::from_isometry(**pose).to_rows()),
            }
        });
        let registration: Vec<_> = registration.collect();
        let (features, judged) = self.features(&map);
        let spacing = opposite(&self.gear, map.cells());
        let mut verdict = combine(judged).to_string();
        let mut reason = match verdict.as_str() {
            "go" => "every flank that was seen is below the warning limit".to_string(),
            other => {
                let named: Vec<String> = features
                    .iter()
                    .filter(|f| f.verdict == other)
                    .take(5)
                    .map(|f| format!("tooth {} {}", f.tooth, f.flank))
                    .collect();
                format!("{other}: {}", named.join(", "))
            }
        };
        let coverage = Coverage::of(&map, &self.gear, planned, LEAST_COVERAGE);
        if verdict == "go" && !coverage.holes.is_empty() {
            reason += &format!(
                "; {} of {} flank fields were seen to less than {:.0} %",
                coverage.holes.len(),
                coverage.fields,
                100.0 * coverage.least_ratio
            );
        }
        // What is missing takes nothing from a wear that was found.
        if let Some(why) = coverage.objection().filter(|_| verdict != "no-go") {
            (verdict, reason) = ("indeterminate".into(), why);
        }
        let registered = laid.len() as f64 / planned.len() as f64;
        if registered < LEAST_REGISTERED {
            verdict = "indeterminate".into();
            let first = lost.values().next().cloned().unwrap_or_default();
            reason = format!(
                "only {} of {} views could be laid on the CAD, at least {:.0} % are needed: a die with other teeth than the \
                 CAD's, or one put down turned, looks like this; the first lost one: {first}",
                laid.len(),
                planned.len(),
                100.0 * LEAST_REGISTERED
            );
        } else if !settled {
            verdict = "indeterminate".into();
            reason = format!("the views still moved against each other after {rounds} rounds");
        }
        let [low, high] = self.gear.height_mm;
        let form = map
            .form()
            .map(|form| Form::with_sigma(form, joint.form_sigma_mm(high - low)));
        let (turn, shift) = joint.stages.head_error();
        let mut versions = BTreeMap::new();
        versions.insert("host", env!("CARGO_PKG_VERSION").to_string());
        versions.insert(
            "protocol",
            flankscope_protocol::PROTOCOL_VERSION.to_string(),
        );
        Scan {
            verdict,
            reason,
            features,
            form: form.filter(|_| registered >= LEAST_REGISTERED),
            spacing: spacing.into_iter().map(OppositeTeeth::from).collect(),
            timing_ms: Timing::default(),
            last_view_to_result_ms: 0.0,
            frames: FrameCount::default(),
            peak_memory_mb: None,
            views: self.grid.to_string(),
            resumed_views: self.resumed,
            coverage_ratio: map.coverage(),
            coverage,
            inconsistent_ratio: map.inconsistent(),
            registration,
            stitching: Stitching {
                relaid_views: relaid,
                elapsed_ms,
            },
            joint: Joint {
                rounds,
                settled,
                condition: joint.condition,
                weak: joint.weak.iter().map(|w| (w.name, w.prior_share)).collect(),
                steps,
                found: StageErrors {
                    eccentricity_mm: joint.stages.eccentricity_mm(),
                    axis_mm: self.gear.height_mm.map(|z| joint.stages.axis_at_mm(z)),
                    tilt_deg: joint.stages.tilt_rad().to_degrees(),
                    head_turn_deg: turn.map(f64::to_degrees),
                    head_shift_mm: shift,
                    vertical_lean_mrad: joint.stages.vertical_lean_rad().map(|rad| rad * 1e3),
                    harmonics_mdeg: joint
                        .stages
                        .harmonics_rad()
                        .map(|pair| pair.map(|rad| rad.to_degrees() * 1e3)),
                },
            },
            methods: Vec::new(),
            teeth_stretch_ratio: None,
            teeth_turned_deg: 0.0,
            metrics: None,
            tool: self.station.subject.tool.name.clone(),
            versions,
            hashes: self.station.subject.hashes.clone(),
            map,
            quality,
        }
    }

    /// Mean loss of every flank that was seen. The cells of a flank share what is wrong with the poses, so their
    /// uncertainties do not average out.
    fn features(
        &self,
        map: &flankscope_metrology::cylinder::CylinderMap,
    ) -> (Vec<Feature>, Vec<Verdict>) {
        let mut flanks: BTreeMap<(u32, bool), (usize, f64, f64)> = BTreeMap::new();
        for cell in map.cells() {
            if let Some(at) = self.gear.place(cell.point, cell.normal) {
                let sums = flanks
                    .entry((at.tooth, at.flank == Flank::Right))
                    .or_default();
                sums.0 += 1;
                sums.1 -= cell.deviation_mm * 1e3;
                sums.2 += (cell.sigma_mm * 1e3).powi(2);
            }
        }
        let most = flanks.values().map(|sums| sums.0).max().unwrap_or(1) as f64;
        let Subject { tool, head, .. } = &self.station.subject;
        let rule = tool
            .inspect
            .as_ref()
            .map_or(Rule::new(f64::NAN, f64::NAN), |i| i.rule());
        let calibration_um = calibration_um(tool, head);
        flanks
            .into_iter()
            .filter(|(_, (cells, ..))| *cells >= LEAST_CELLS)
            .map(|((tooth, right), (cells, loss, variance))| {
                let mean_um = loss / cells as f64;
                let u_um = (variance / cells as f64 + calibration_um * calibration_um).sqrt();
                let verdict = decide(mean_um, u_um, &rule);
                let (reason, code) = match &verdict {
                    Verdict::Indeterminate { reason } => {
                        (Some(reason.to_string()), Some(reason.code()))
                    }
                    _ => (None, None),
                };
                let flank = if right { Flank::Right } else { Flank::Left };
                let feature = Feature {
                    tooth,
                    flank: flank.to_string(),
                    wear_um: Some(mean_um),
                    u95_um: Some(1.96 * u_um),
                    mean_um: Some(mean_um),
                    coverage_ratio: cells as f64 / most,
                    warn_um: rule.warn_um,
                    limit_um: rule.limit_um,
                    conformity: Some(probability_below(rule.limit_um, mean_um, u_um)),
                    detail: None,
                    measurements: Vec::new(),
                    verdict: verdict.to_string(),
                    reason,
                    code,
                };
                (feature, verdict)
            })
            .unzip()
    }
}
