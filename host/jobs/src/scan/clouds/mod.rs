//! The scan of recorded clouds: everything after decoding is as in a live scan.
//!
//! Information that clouds lack is never assumed in the die's favour. If no point lies within half a cell of a ray of the head,
//! the ray counts as unmeasured. Without a stated uncertainty nothing is judged. Without frames, their consistency cannot be
//! tested, so no flank is "go": what exceeds a limit is reported, everything else is indeterminate.

mod index;
mod save;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use flankscope_foundation::textfile::TextFileError;
use flankscope_metrology::io::cloud;
use flankscope_metrology::registration::TYPICAL_NOISE_MM;
use flankscope_metrology::verdict::{Code, Reason};
use flankscope_profilometry::Decoder;

pub use index::{CloudIndex, IndexedCloud};
pub use save::SaveCloudsError;

use super::job::{Captured, Progress, ScanError, Scanner};
use super::recorded::{name_of, planned};
use super::view::ViewScanner;
use super::view_pipeline::{Kept, PlannedScan};
use crate::inspection::InspectError;
use crate::plan::ViewPlan;
use crate::subject::Subject;
use flankscope_foundation::files;
use flankscope_frames::monotonic_ns;
use flankscope_instrument::acquisition::RecordedIndex;
use flankscope_record::document::scan::Scan;
use flankscope_record::origin::{RecordingId, Setting};

/// Why recorded clouds cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CloudsError {
    /// The index cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// A cloud is missing.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The cloud.
        path: PathBuf,
        /// Reason.
        source: std::io::Error,
    },
    #[error("{} leads out of {}: clouds lie in the folder of their clouds.toml", path.display(), folder.display())]
    Outside {
        /// The cloud.
        path: PathBuf,
        folder: PathBuf,
    },
    /// A file is not a cloud.
    #[error("cannot use cloud {}: {source}", path.display())]
    Cloud {
        /// The cloud.
        path: PathBuf,
        /// Reason.
        source: Box<cloud::CloudError>,
    },
    #[error("{}: point {point} lies behind the camera (z = {z_mm} mm): a view's cloud is in the camera's frame, z along its view", path.display())]
    Behind {
        /// The cloud.
        path: PathBuf,
        /// Point, from 0.
        point: usize,
        /// Its depth.
        z_mm: f64,
    },
    /// The uncertainty of a point is not plausible.
    #[error("{}: the standard uncertainty of point {point} is {sigma_mm} mm; finite and above 0 would be right", path.display())]
    Sigma {
        /// The cloud.
        path: PathBuf,
        /// Point, from 0.
        point: usize,
        sigma_mm: f32,
    },
    /// A file differs from the recorded one.
    #[error("{} is not what the index says: its BLAKE3 is {got}, not {expected}", path.display())]
    Digest {
        /// The cloud.
        path: PathBuf,
        /// BLAKE3 of the file.
        got: String,
        /// BLAKE3 in the index.
        expected: String,
    },
    /// Two views have the same cloud.
    #[error("{}: view {view} has the very points of view {other}; each view has a cloud of its own", path.display())]
    Twice {
        /// The cloud.
        path: PathBuf,
        /// View, from 1.
        view: usize,
        other: usize,
    },
}

/// A folder of recorded clouds with its index.
#[derive(Clone, Debug)]
pub struct CloudRecording {
    pub index: CloudIndex,
    /// BLAKE3 of the index.
    blake3: String,
    folder: PathBuf,
}

/// The points of a view.
struct ViewCloud {
    points_mm: Vec<[f64; 3]>,
    sigma_mm: Vec<f32>,
    /// Whether cloud or index state the uncertainty of points.
    has_sigma: bool,
    blake3: String,
}

impl CloudRecording {
    /// Reads the index of a folder, and checks that its clouds exist.
    ///
    /// # Errors
    /// File, line and the expected value; or the first missing cloud.
    pub fn open(folder: &Path) -> Result<Self, CloudsError> {
        let (index, text) = CloudIndex::load(folder)?;
        let recording = Self {
            index,
            blake3: files::hash(text.as_bytes()),
            folder: folder.to_owned(),
        };
        let real = |path: &Path| {
            let path = path.to_owned();
            path.canonicalize()
                .map_err(|source| CloudsError::Read { path, source })
        };
        let real_folder = real(folder)?;
        for view in &recording.index.view {
            let path = folder.join(&view.file);
            if !real(&path)?.starts_with(&real_folder) {
                return Err(CloudsError::Outside {
                    path,
                    folder: folder.to_owned(),
                });
            }
        }
        Ok(recording)
    }

    /// The head's file, if the index names one.
    pub fn head(&self) -> Option<PathBuf> {
        let head = self.index.head.as_ref()?;
        Some(self.folder.join(head))
    }

    /// Identity of the recording, as results state it.
    pub fn id(&self) -> RecordingId {
        RecordingId {
            taken: self.index.taken,
            blake3: self.blake3.clone(),
            simulated: self.index.simulated,
        }
    }

    fn load(&self, view: &IndexedCloud) -> Result<ViewCloud, CloudsError> {
        let path = self.folder.join(&view.file);
        let named = || path.clone();
        let bytes = files::read_regular(&path, files::MOST_DATA_BYTES).map_err(|source| {
            CloudsError::Read {
                path: named(),
                source,
            }
        })?;
        let blake3 = files::hash(&bytes);
        if let Some(expected) = view.blake3.as_ref().filter(|said| **said != blake3) {
            return Err(CloudsError::Digest {
                path,
                got: blake3,
                expected: expected.clone(),
            });
        }
        let unit = self.index.unit;
        let read = cloud::parse(&bytes, unit).map_err(|source| CloudsError::Cloud {
            path: named(),
            source: Box::new(source),
        })?;
        if let Some(point) = read.points.iter().position(|p| p[2] <= 0.0) {
            let z_mm = read.points[point][2];
            return Err(CloudsError::Behind { path, point, z_mm });
        }
        let stated = read.sigma_property();
        let stated_mm = self.index.sigma_um.map(|um| 1e-3 * um);
        let sigma_mm: Vec<f32> = match stated {
            Some(extra) => extra.values().map(|mm| mm as f32).collect(),
            None => vec![stated_mm.unwrap_or(TYPICAL_NOISE_MM) as f32; read.points.len()],
        };
        let is_none = |sigma: &f32| !(sigma.is_finite() && *sigma > 0.0);
        if let Some(point) = sigma_mm.iter().position(is_none) {
            return Err(CloudsError::Sigma {
                path,
                point,
                sigma_mm: sigma_mm[point],
            });
        }
        let has_sigma = stated.is_some() || stated_mm.is_some();
        Ok(ViewCloud {
            points_mm: read.points.into_inner(),
            sigma_mm,
            has_sigma,
            blake3,
        })
    }
}

/// A scan of recorded clouds, with its session folder open.
#[derive(Debug)]
pub struct CloudScan {
    /// Stitches and describes the views as in a live scan.
    pub scanner: Scanner,
    clouds: CloudRecording,
    /// For every cloud of the index, its view of the plan.
    of: Vec<usize>,
    decoder: Arc<Decoder>,
}

impl CloudScan {
    /// Prepares a scan of these clouds in `folder`, which may hold an earlier part of it. The result states `setting` as its origin.
    ///
    /// # Errors
    /// Tool or head lack what the job needs, or the folder belongs to another scan.
    pub fn open(
        subject: Subject,
        setting: Setting,
        clouds: CloudRecording,
        folder: &Path,
    ) -> Result<Self, ScanError> {
        let (index, tool) = (&clouds.index, &subject.tool);
        let (views, of) = planned(tool, index.grid.as_deref(), &index.places())?;
        let whole = ViewPlan::new(&subject.tool, &subject.head, Some(&[1]));
        let whole = whole.map_err(InspectError::from)?;
        let planned = PlannedScan {
            name: name_of(index.grid.as_deref(), &views),
            plan: ViewPlan { views, ..whole },
        };
        let decoder = planned.plan.decoder(&subject.head, None);
        let decoder = Arc::new(decoder.map_err(InspectError::from)?);
        let same = BTreeMap::from([("clouds".to_owned(), clouds.blake3.clone())]);
        Ok(Self {
            scanner: Scanner::start(subject, setting, planned, (folder, &same), None)?,
            clouds,
            of,
            decoder,
        })
    }

    /// Registers the clouds to the CAD and stitches them. What remains open without frames is indeterminate.
    ///
    /// # Errors
    /// A cloud is invalid, the session folder cannot be written, or the views have no common solution.
    pub fn scan(&mut self, mut watch: impl FnMut(Progress)) -> Result<Scan, ScanError> {
        let begun_ns = monotonic_ns();
        let unfit = self.scanner.job.unfit_on(self.clouds.index.taken);
        let mut without_sigma = None;
        let is_fit = unfit.is_none();
        let mut captured = Captured::unless(unfit);
        if is_fit {
            without_sigma = self.lay(&mut captured.lost, &mut watch)?;
        }
        let mut scan = self.scanner.conclude(captured, begun_ns, watch)?;
        match without_sigma {
            // If the scan is not of this die, that reason is kept.
            Some(path) if !scan.features.is_empty() => scan.invalidate(&Reason::instrument(
                Code::NoUncertainty,
                format_args!(
                    "{} states no standard uncertainty (property sigma_z or sigma, or sigma_um in clouds.toml), so nothing is judged",
                    path.display()
                ),
            )),
            _ => scan.without_frames(),
        }
        Ok(scan)
    }

    /// Registers every cloud in the order of capture; a further cloud of a view is used if none before it was kept. Returns the
    /// first one without a stated uncertainty.
    fn lay(
        &mut self,
        lost: &mut BTreeMap<usize, Reason>,
        watch: &mut impl FnMut(Progress),
    ) -> Result<Option<PathBuf>, ScanError> {
        let scanner = &mut self.scanner;
        let mut views = ViewScanner::new(
            &scanner.job.subject,
            Arc::clone(&self.decoder),
            Arc::clone(&scanner.job.plan),
            scanner.store.known.clone(),
        )
        .map_err(InspectError::from)?;
        let planned = scanner.job.plan.views.len();
        for view in (0..planned).filter(|&view| scanner.store.session.pose(view).is_none()) {
            let why = format!("there is no cloud of view {}", view + 1);
            lost.insert(view, Reason::instrument(Code::NotCaptured, why));
        }
        let mut without_sigma = None;
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        let begun = Instant::now();
        let all = self.of.len();
        for (at, (&view, said)) in self.of.iter().zip(&self.clouds.index.view).enumerate() {
            let cloud = self.clouds.load(said)?;
            let path = self.clouds.folder.join(&said.file);
            if let Some(other) = seen.insert(cloud.blake3, at) {
                return Err(ScanError::from(CloudsError::Twice {
                    path,
                    view: at + 1,
                    other: other + 1,
                }));
            }
            if !cloud.has_sigma {
                without_sigma.get_or_insert(path);
            }
            if scanner.store.session.pose(view).is_none() {
                let scanned = views.lay_cloud(view, &cloud.points_mm, &cloud.sigma_mm);
                match scanner.store.keep(view, scanned)? {
                    Kept::Kept => drop(lost.remove(&view)),
                    Kept::Refused(why) => drop(lost.insert(view, why)),
                }
                scanner.store.session.commit()?;
            }
            watch(Progress::Views {
                done: at + 1,
                of: all,
                remaining: begun.elapsed() / (at + 1) as u32 * (all - at - 1) as u32,
            });
        }
        Ok(without_sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";

    /// Error message for a folder with this cloud and this index.
    fn load(cloud: &str, more: &str) -> Result<ViewCloud, CloudsError> {
        let folder = tempfile::tempdir().unwrap();
        let index = format!("simulated = true\n{more}[[view]]\nfile = \"a.ply\"\ntooth = 40\n");
        std::fs::write(folder.path().join(CloudIndex::FILE), index).unwrap();
        std::fs::write(folder.path().join("a.ply"), cloud).unwrap();
        let recording = CloudRecording::open(folder.path())?;
        recording.load(&recording.index.view[0])
    }

    #[test]
    fn a_cloud_is_read_with_its_uncertainty_in_its_unit() {
        let bare = format!("{HEADER}end_header\n0 0 20\n1 0 21\n");
        let sure = format!(
            "{HEADER}property float sigma_z\nend_header\n0 0 0.02 4e-6\n0.001 0 0.021 5e-6\n"
        );
        let read = load(&sure, "unit = \"m\"\n").unwrap();
        assert_eq!(read.points_mm[0], [0.0, 0.0, 20.0]);
        assert!((read.sigma_mm[0] - 4e-3).abs() < 1e-8 && read.has_sigma);
        let read = load(&bare, "sigma_um = 5.0\n").unwrap();
        assert!(read.has_sigma && read.sigma_mm == [5e-3, 5e-3]);
        assert!(!load(&bare, "").unwrap().has_sigma);
    }

    #[test]
    fn what_is_no_cloud_of_a_view_is_refused_by_name() {
        let sigma = format!("{HEADER}property float sigma\nend_header\n");
        for (cloud, words) in [
            (format!("{HEADER}end_header\n0 0 20\n0 nan 21\n"), "a.ply"),
            (format!("{HEADER}end_header\n0 0 20\n"), "a.ply"),
            (String::new(), "empty"),
            (
                format!("{HEADER}end_header\n0 0 20\n0 0 -3\n"),
                "point 1 lies behind the camera (z = -3 mm)",
            ),
            (
                format!("{HEADER}end_header\n0 0 0\n0 0 20\n"),
                "point 0 lies behind",
            ),
            (
                format!("{sigma}0 0 20 0.01\n0 0 21 0\n"),
                "uncertainty of point 1 is 0 mm",
            ),
            (
                format!("{sigma}0 0 20 -0.01\n0 0 21 0.01\n"),
                "uncertainty of point 0 is -0.01",
            ),
        ] {
            let said = load(&cloud, "").err().map(|error| error.to_string());
            assert!(
                said.as_ref().is_some_and(|said| said.contains(words)),
                "{cloud}\n{said:?}"
            );
        }
    }

    #[test]
    fn clouds_lie_in_their_folder_and_are_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let (inner, outer) = (folder.path().join("inner"), folder.path().join("a.ply"));
        std::fs::create_dir(&inner).unwrap();
        let digest = "0".repeat(64);
        let index = format!(
            "simulated = true\n[[view]]\nfile = \"a.ply\"\ntooth = 40\nblake3 = \"{digest}\"\n"
        );
        std::fs::write(inner.join(CloudIndex::FILE), index).unwrap();
        let open = || CloudRecording::open(&inner).map_err(|error| error.to_string());
        assert!(open().unwrap_err().contains("a.ply"));
        std::fs::write(&outer, "0 0 20\n").unwrap();
        std::os::unix::fs::symlink(&outer, inner.join("a.ply")).unwrap();
        assert!(open().unwrap_err().contains("leads out of"));
        std::fs::remove_file(inner.join("a.ply")).unwrap();
        std::fs::copy(&outer, inner.join("a.ply")).unwrap();
        let recording = open().unwrap();
        let said = recording.load(&recording.index.view[0]).err().unwrap();
        assert!(
            said.to_string().contains(&format!("not {digest}")),
            "{said}"
        );
    }
}
