//! The session folder of a scan: one file of points per view and a manifest with their hashes.
//!
//! Files are written atomically, and a view's points before the manifest that lists them: the folder is consistent whenever the
//! scan is interrupted.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use flankscope_foundation::seal::Seal;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::view::KeptView;
use flankscope_article::{ViewPoint, ViewPoints};
use flankscope_foundation::files::{self, hash, write_whole};
use flankscope_record::seal::{Kind, SealError, Seals};

const MANIFEST: &str = "manifest.json";
const FORMAT: u32 = 1;

/// Why a session folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The operating system returned an error.
    #[error("{path}: {error}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Reason.
        error: std::io::Error,
    },
    /// The manifest is invalid.
    #[error("{path} is no scan manifest: {error}; scan into an empty folder")]
    Manifest {
        /// The file.
        path: PathBuf,
        /// Reason.
        error: serde_json::Error,
    },
    #[error(
        "{path} holds another scan: its {what} is {got}, this scan's is {expected}; scan into an empty folder"
    )]
    Other {
        /// The manifest.
        path: PathBuf,
        /// Property that differs.
        what: String,
        /// Value in the manifest.
        got: String,
        /// Value of this scan.
        expected: String,
    },
    /// A file differs from what was written.
    #[error(
        "{path} is damaged: its BLAKE3 is {got}, the manifest says {expected}; remove the file to have the view captured again"
    )]
    Damaged {
        path: PathBuf,
        /// BLAKE3 of the file.
        got: String,
        /// BLAKE3 in the manifest.
        expected: String,
    },
    /// The manifest is neither signed by this station nor trusted.
    #[error(transparent)]
    Seal(#[from] SealError),
    /// A pose is invalid.
    #[error("{path}: the pose of view {view} is no rigid motion")]
    Pose {
        /// The manifest.
        path: PathBuf,
        view: usize,
    },
}

/// A finished view.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Entry {
    /// BLAKE3 of the file of points.
    blake3: String,
    /// Number of points in it, which come before the rays without a point.
    pub points: usize,
    /// First pose, rows of tool frame from camera frame.
    tool_from_camera: [[f64; 4]; 4],
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: u32,
    /// Properties that must be equal for the scan to be continued: grid, tool, CAD, head, and the settings of a simulated bench.
    of: BTreeMap<String, String>,
    views: BTreeMap<usize, Entry>,
}

/// An open session folder.
#[derive(Debug)]
pub(super) struct Session {
    folder: PathBuf,
    manifest: Manifest,
    seals: Seals,
}

impl Session {
    /// Opens a folder, creates it if missing. Every file in the manifest is checked; a view with a missing file is captured again.
    pub fn open(
        folder: &Path,
        of: BTreeMap<String, String>,
        seals: Seals,
    ) -> Result<Self, SessionError> {
        let io = |path: &Path| {
            let path = path.to_path_buf();
            move |error| SessionError::Io { path, error }
        };
        std::fs::create_dir_all(folder).map_err(io(folder))?;
        let path = folder.join(MANIFEST);
        let mut session = Self {
            folder: folder.to_path_buf(),
            manifest: Manifest {
                format: FORMAT,
                of,
                views: BTreeMap::new(),
            },
            seals,
        };
        if !path.exists() {
            return Ok(session);
        }
        let text = files::read_regular(&path, files::MOST_DOCUMENT_BYTES).map_err(io(&path))?;
        let no_manifest = |error| SessionError::Manifest {
            path: path.clone(),
            error,
        };
        let mut document: Value = serde_json::from_slice(&text).map_err(no_manifest)?;
        let sealed = document.clone();
        if let Some(map) = document.as_object_mut() {
            map.remove(Seal::KEY);
        }
        let manifest: Manifest = serde_json::from_value(document).map_err(no_manifest)?;
        let mut expected = session.manifest.of.clone();
        expected.insert("format".into(), FORMAT.to_string());
        let mut got = manifest.of.clone();
        got.insert("format".into(), manifest.format.to_string());
        let mut keys: Vec<&String> = expected.keys().chain(got.keys()).collect();
        keys.sort();
        for what in keys {
            let value = |of: &BTreeMap<String, String>| match of.get(what) {
                Some(value) => value.clone(),
                None => "not named".into(),
            };
            let (got, expected) = (value(&got), value(&expected));
            if got != expected {
                let what = what.clone();
                return Err(SessionError::Other {
                    path,
                    what,
                    got,
                    expected,
                });
            }
        }
        session.seals.believe(Kind::Session, &path, &sealed)?;
        session.manifest = manifest;
        let gone: Vec<usize> = session
            .manifest
            .views
            .keys()
            .copied()
            .filter(|&view| !session.file(view).exists())
            .collect();
        for view in gone {
            session.manifest.views.remove(&view);
        }
        for (&view, entry) in &session.manifest.views {
            if Rigid::<Tool, Camera>::from_rows(&entry.tool_from_camera).is_err() {
                return Err(SessionError::Pose { path, view });
            }
            session.points(view)?;
        }
        Ok(session)
    }

    /// Properties of a folder's scan, read without verification.
    pub fn identity(folder: &Path) -> Result<BTreeMap<String, String>, SessionError> {
        #[derive(Deserialize)]
        struct Named {
            of: BTreeMap<String, String>,
        }
        let path = folder.join(MANIFEST);
        let text = files::read_regular(&path, files::MOST_DOCUMENT_BYTES).map_err(|error| {
            let path = path.clone();
            SessionError::Io { path, error }
        })?;
        let named: Named = serde_json::from_slice(&text)
            .map_err(|error| SessionError::Manifest { path, error })?;
        Ok(named.of)
    }

    fn file(&self, view: usize) -> PathBuf {
        self.folder.join(format!("view-{view:04}.points"))
    }

    /// The finished views.
    pub fn views(&self) -> impl Iterator<Item = (usize, &Entry)> {
        self.manifest
            .views
            .iter()
            .map(|(&view, entry)| (view, entry))
    }

    /// First pose of a finished view.
    pub fn pose(&self, view: usize) -> Option<Rigid<Tool, Camera>> {
        let entry = self.manifest.views.get(&view)?;
        Rigid::from_rows(&entry.tool_from_camera).ok()
    }

    /// Stores a view's points and first pose.
    pub fn keep(
        &mut self,
        view: usize,
        kept: &KeptView,
        tool_from_camera: Rigid<Tool, Camera>,
    ) -> Result<(), SessionError> {
        let points: &[u8] = bytemuck::cast_slice(&kept.points);
        let bytes = [points, bytemuck::cast_slice(&kept.without_point)].concat();
        let path = self.file(view);
        write_whole(&path, &bytes).map_err(|error| SessionError::Io { path, error })?;
        let entry = Entry {
            blake3: hash(&bytes),
            points: kept.points.len(),
            tool_from_camera: tool_from_camera.to_rows(),
        };
        self.manifest.views.insert(view, entry);
        Ok(())
    }

    /// Writes the manifest: views stored before are kept from here on.
    pub fn commit(&self) -> Result<(), SessionError> {
        let path = self.folder.join(MANIFEST);
        let text = || -> serde_json::Result<Result<Vec<u8>, SealError>> {
            let mut document = serde_json::to_value(&self.manifest)?;
            match self.seals.seal(Kind::Session, &document) {
                Ok(seal) => document[Seal::KEY] = serde_json::to_value(seal)?,
                Err(error) => return Ok(Err(error)),
            }
            serde_json::to_vec_pretty(&document).map(Ok)
        };
        let text = text().map_err(|error| {
            let path = path.clone();
            SessionError::Manifest { path, error }
        })??;
        write_whole(&path, &text).map_err(|error| SessionError::Io { path, error })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A random sample of a finished view: its first points. Not checked against the hash again; that was done when the session
    /// was opened or the view was stored.
    pub fn sample(&self, view: usize, most: usize) -> Result<Vec<ViewPoint>, SessionError> {
        let path = self.file(view);
        let points = self
            .manifest
            .views
            .get(&view)
            .map_or(0, |entry| entry.points);
        let most = most.min(points);
        let mut bytes = Vec::with_capacity(most * size_of::<ViewPoint>());
        let read = files::open_regular(&path).and_then(|file| {
            file.take((most * size_of::<ViewPoint>()) as u64)
                .read_to_end(&mut bytes)
        });
        read.map_err(|error| SessionError::Io { path, error })?;
        Ok(read_all(&bytes))
    }

    /// The points of a finished view, checked against their hash.
    pub fn points(&self, view: usize) -> Result<KeptView, SessionError> {
        let path = self.file(view);
        let bytes = files::read_regular(&path, files::MOST_DATA_BYTES).map_err(|error| {
            let path = path.clone();
            SessionError::Io { path, error }
        })?;
        let entry = self.manifest.views.get(&view);
        let expected = entry.map_or("", |entry| entry.blake3.as_str());
        let got = hash(&bytes);
        if got != expected {
            return Err(SessionError::Damaged {
                path,
                got,
                expected: expected.into(),
            });
        }
        let points = entry.map_or(0, |entry| entry.points) * size_of::<ViewPoint>();
        let (points, rays) = bytes.split_at(points.min(bytes.len()));
        Ok(KeptView {
            points: read_all(points),
            without_point: read_all(rays),
        })
    }
}

impl ViewPoints for Session {
    type Error = SessionError;

    fn view_numbers(&self) -> Vec<usize> {
        self.manifest.views.keys().copied().collect()
    }

    fn view_points(&self, view: usize) -> Result<Vec<ViewPoint>, SessionError> {
        Ok(self.points(view)?.points)
    }
}

fn read_all<T: bytemuck::AnyBitPattern>(bytes: &[u8]) -> Vec<T> {
    let each = bytes.chunks_exact(size_of::<T>());
    each.map(bytemuck::pod_read_unaligned).collect()
}
