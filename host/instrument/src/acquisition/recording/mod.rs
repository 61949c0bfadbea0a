//! Recorded frames in place of a camera: a folder with an index (`frames.toml`), a plan, a head file and images, read into the
//! same sums as live frames. Nothing moves, and no other process runs.
//!
//! | file | holds |
//! |---|---|
//! | `index` | `frames.toml` |
//! | `source` | a folder as a source of frames |
//! | `playback` | an acquisition whose frames come from such a source |
//! | `saver` | writes such a folder during a capture |

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
    pub index: FrameIndex,
    /// Patterns, exposures and names of the images.
    pub plan: Plan,
    /// BLAKE3 of the index.
    pub blake3: String,
    folder: PathBuf,
}

/// Why a folder of frames cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Index or plan cannot be read.
    #[error(transparent)]
    File(#[from] TextFileError),
    /// An image is missing, or differs from plan or head file.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A list in the index has more or fewer entries than the plan has frames.
    #[error("{}: {key} of view {view} has {got} entries, the plan {planned} frames in a view", path.display())]
    Count {
        /// Path of the index.
        path: PathBuf,
        /// Key of the list.
        key: &'static str,
        /// View, from 1.
        view: usize,
        /// Number of entries.
        got: usize,
        /// Number of frames of a view.
        planned: usize,
    },
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
    /// An image has fewer bits than the sensor, or more than its container.
    #[error("{} has {got} bits, the sensor {bits}: its counts are not the sensor's (counts are not stretched; see [sensor])", path.display())]
    Depth {
        /// The image.
        path: PathBuf,
        /// Bits of the image.
        got: u32,
        bits: u32,
    },
    /// Neither plan nor head file describes the sensor.
    #[error(
        "neither plan nor head says anything of the sensor: give [sensor] in one of them, a verdict needs its noise"
    )]
    NoSensor,
}

/// The frames of one view.
#[derive(Clone, Debug)]
pub struct RecordedView {
    images: Vec<(FrameKind, PathBuf)>,
    /// Its other entries in the index.
    said: IndexedView,
}

impl Recording {
    /// Reads index and plan of a folder.
    ///
    /// # Errors
    /// File, line and the expected value.
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
    pub fn blake3(&self) -> &str {
        &self.blake3
    }

    /// The head's file, if the index names one.
    pub fn head(&self) -> Option<PathBuf> {
        let head = self.index.head.as_ref()?;
        Some(self.folder.join(head))
    }

    /// The table of camera poses, if the index names one.
    pub fn poses(&self) -> Option<PathBuf> {
        let poses = self.index.poses.as_ref()?;
        Some(self.folder.join(poses))
    }

    /// The sensor that took the frames, from the plan or else from the head file.
    ///
    /// # Errors
    /// [`RecordingError::NoSensor`].
    pub fn sensor(&self, head: &HeadModel) -> Result<Sensor, RecordingError> {
        self.plan
            .sensor
            .or(head.sensor)
            .ok_or(RecordingError::NoSensor)
    }

    /// The images of every view; checks that each exists, lies in the images' folder, and has the camera's size and bit depth.
    ///
    /// # Errors
    /// The first image that fails a check.
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
                // Removes "." components from the middle of the path.
                let folder: PathBuf = root.join(&said.folder).components().collect();
                let passes = self.index.lit_ratios.len().max(1);
                let images = self.plan.frames_of_passes(&folder, passes)?;
                self.check_counts(at, said, images.len())?;
                for (_, image) in &images {
                    inside(image, &root)?;
                    let header = ImageHeader::read(image)?;
                    header.check(image, size_px)?;
                    // 12 bits lie unchanged in 16; in 8 bits some are lost.
                    if header.bits < sensor.bits {
                        return Err(RecordingError::Depth {
                            path: image.clone(),
                            got: header.bits,
                            bits: sensor.bits,
                        });
                    }
                }
                Ok(RecordedView {
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

/// Whether an image lies below the images' folder, both by its name and after links are resolved.
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
    /// Its images, in the order in which they were captured.
    pub fn images(&self) -> &[(FrameKind, PathBuf)] {
        &self.images
    }

    /// Frames of the view.
    pub fn frames(&self) -> usize {
        self.images.len()
    }

    /// The controller's triggers as recorded; if the recording has none, as they follow from the plan.
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

    /// Start and end of every frame, as recorded, or else one right after the other, µs.
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

/// Exposure time of a frame of a plan, µs; the dark frame has the shortest.
fn exposure_us(kind: FrameKind, exposures_us: &[u32]) -> u32 {
    let step = kind.exposure().unwrap_or(0);
    exposures_us.get(step).copied().unwrap_or_default()
}
