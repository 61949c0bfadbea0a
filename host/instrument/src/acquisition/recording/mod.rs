//! Frames that were recorded before, in the place of a camera: a folder with an index (`frames.toml`), a plan, a head and
//! images, read into the same sums as frames that come now. Nothing moves, and no other process runs.
//!
//! | file | holds |
//! |---|---|
//! | `index` | `frames.toml` |
//! | `source` | a folder as a source of frames |
//! | `playback` | an acquisition that is fed from it |
//! | `saver` | frames written into such a folder while they come |

mod index;
mod playback;
mod saver;
mod source;

use std::path::{Path, PathBuf};

use flankscope_foundation::textfile::TextFileError;
use flankscope_profilometry::head::Sensor;
use flankscope_profilometry::io::images::{ImageError, ImageHeader};
use flankscope_profilometry::plan::Plan;
use flankscope_profilometry::{FrameKind, HeadModel};
use flankscope_protocol::{Microseconds, Timestamp, Trigger};

pub use index::stays_inside;
pub use index::{FrameIndex, IndexedView, RecordedIndex};
pub use playback::Playback;
pub use saver::{SavedCapture, SavedView, Saver};
pub use source::ImageProblem;

use flankscope_foundation::files;

/// A folder of recorded frames, its index and plan read.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The index.
    pub index: FrameIndex,
    /// Patterns, exposures and names of the images.
    pub plan: Plan,
    /// BLAKE3 of the index.
    pub blake3: String,
    folder: PathBuf,
}

/// Why a folder of frames cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// Index or plan.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// An image that is not there, or not what plan and head say.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The index says something of more or fewer frames than the plan has.
    #[error("{}: {key} of view {view} has {got} entries, the plan {planned} frames in a view", path.display())]
    Count {
        /// The index.
        path: PathBuf,
        /// Which list.
        key: &'static str,
        /// View, from 1.
        view: usize,
        /// Its entries.
        got: usize,
        /// Frames of a view.
        planned: usize,
    },
    /// An image elsewhere than in the images' folder.
    #[error(
        "{} lies outside {}: the images of a recording are in one folder, which images = \"DIR\" in frames.toml names",
        path.display(),
        root.display()
    )]
    Outside {
        /// The image.
        path: PathBuf,
        /// The images' folder.
        root: PathBuf,
    },
    /// Fewer bits than the sensor has, or more than the container.
    #[error("{} has {got} bits, the sensor {bits}: its counts are not the sensor's (counts are not stretched; see [sensor])", path.display())]
    Depth {
        /// The image.
        path: PathBuf,
        /// Bits of the image.
        got: u32,
        /// Bits of the sensor.
        bits: u32,
    },
    /// Nothing known of the counts.
    #[error(
        "neither plan nor head says anything of the sensor: give [sensor] in one of them, a verdict needs its noise"
    )]
    NoSensor,
}

/// The frames of one view.
#[derive(Clone, Debug)]
pub struct RecordedView {
    /// Its place in the index: the order in which views were taken.
    pub number: usize,
    images: Vec<(FrameKind, PathBuf)>,
    /// What the index says beside.
    said: IndexedView,
}

impl Recording {
    /// Reads index and plan of a folder.
    ///
    /// # Errors
    /// File, line and what would be right.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let (index, text) = FrameIndex::load(folder)?;
        let plan = Plan::load(&folder.join(&index.plan))?;
        Ok(Self {
            index,
            plan,
            blake3: files::hash(text.as_bytes()),
            folder: folder.to_owned(),
        })
    }

    /// BLAKE3 of the index, as hexadecimal text.
    #[must_use]
    pub fn blake3(&self) -> &str {
        &self.blake3
    }

    /// The head's file, if the index names one.
    #[must_use]
    pub fn head(&self) -> Option<PathBuf> {
        let head = self.index.head.as_ref()?;
        Some(self.folder.join(head))
    }

    /// The table that says where the camera stood, if there is one.
    #[must_use]
    pub fn poses(&self) -> Option<PathBuf> {
        let poses = self.index.poses.as_ref()?;
        Some(self.folder.join(poses))
    }

    /// The sensor that counted, as plan or else head say.
    ///
    /// # Errors
    /// [`RecordingError::NoSensor`].
    pub fn sensor(&self, head: &HeadModel) -> Result<Sensor, RecordingError> {
        self.plan
            .sensor
            .or(head.sensor)
            .ok_or(RecordingError::NoSensor)
    }

    /// The images of every view, each of them there, where it may be, and as large and deep as the camera's frames.
    ///
    /// # Errors
    /// The first that is not.
    pub fn views(&self, head: &HeadModel) -> Result<Vec<RecordedView>, RecordingError> {
        let sensor = self.sensor(head)?;
        let size_px = [head.camera.width_px, head.camera.height_px];
        let root = match &self.index.images {
            Some(images) => self.folder.join(images),
            None => self.folder.clone(),
        };
        let views = self.index.view.iter().enumerate();
        views
            .map(|(at, said)| {
                // Without a "." in the middle of every path that is named.
                let folder: PathBuf = root.join(&said.folder).components().collect();
                let passes = self.index.lit_ratios.len().max(1);
                let images = self.plan.frames_of_passes(&folder, passes)?;
                self.check_counts(at, said, images.len())?;
                for (_, image) in &images {
                    inside(image, &root)?;
                    let header = ImageHeader::read(image)?;
                    header.check(image, size_px)?;
                    // 12 bits lie in 16 as they are; in 8 they have lost some.
                    if header.bits < sensor.bits {
                        return Err(RecordingError::Depth {
                            path: image.clone(),
                            got: header.bits,
                            bits: sensor.bits,
                        });
                    }
                }
                Ok(RecordedView {
                    number: at,
                    images,
                    said: said.clone(),
                })
            })
            .collect()
    }

    fn check_counts(
        &self,
        at: usize,
        said: &IndexedView,
        planned: usize,
    ) -> Result<(), RecordingError> {
        let lists = [
            ("blake3", said.blake3.len()),
            ("triggered_us", said.triggered_us.len()),
            ("exposed_us", said.exposed_us.len()),
        ];
        for (key, got) in lists {
            if got != 0 && got != planned {
                return Err(RecordingError::Count {
                    path: self.folder.join(FrameIndex::FILE),
                    key,
                    view: at + 1,
                    got,
                    planned,
                });
            }
        }
        Ok(())
    }
}

/// Whether an image lies below the images' folder, by its name and by where links lead.
fn inside(image: &Path, root: &Path) -> Result<(), RecordingError> {
    let outside = || RecordingError::Outside {
        path: image.to_owned(),
        root: root.to_owned(),
    };
    if !image.strip_prefix(root).is_ok_and(stays_inside) {
        return Err(outside());
    }
    let opened = |path: &Path| {
        let path = path.to_owned();
        move |source| ImageError::Open { path, source }
    };
    let real_image = image.canonicalize().map_err(opened(image))?;
    let real_root = root.canonicalize().map_err(opened(root))?;
    if real_image.starts_with(real_root) {
        Ok(())
    } else {
        Err(outside())
    }
}

impl RecordedView {
    /// Its images, in the order in which they were taken.
    pub fn images(&self) -> &[(FrameKind, PathBuf)] {
        &self.images
    }

    /// Frames of the view.
    pub fn frames(&self) -> usize {
        self.images.len()
    }

    /// What the controller said when it was recorded; of a recording that does not say, what it must have said.
    fn triggers(&self, session: u32, view: u8, exposures_us: &[u32]) -> Vec<Trigger> {
        let times = self.times(&self.said.triggered_us, exposures_us);
        let frames = self.images.iter().zip(times).enumerate();
        frames
            .map(|(at, ((kind, _), [start, end]))| Trigger {
                session,
                view,
                frame: at as u16,
                pattern: source::pattern(&self.images, at),
                exposure: Microseconds(exposure_us(*kind, exposures_us)),
                dmd_at: Timestamp(start),
                camera_at: Timestamp(start),
                end_at: Timestamp(end),
            })
            .collect()
    }

    /// Start and end of every frame, as recorded, or else one right after the other.
    fn times(&self, recorded: &[[u64; 2]], exposures_us: &[u32]) -> Vec<[u64; 2]> {
        if !recorded.is_empty() {
            return recorded.to_vec();
        }
        let mut now = 0;
        let frames = self.images.iter();
        frames
            .map(|(kind, _)| {
                let start = now;
                now += u64::from(exposure_us(*kind, exposures_us));
                [start, now]
            })
            .collect()
    }
}

/// How long a frame of a plan is exposed: the dark one as the shortest.
fn exposure_us(kind: FrameKind, exposures_us: &[u32]) -> u32 {
    let step = kind.exposure().unwrap_or(0);
    exposures_us.get(step).copied().unwrap_or_default()
}
