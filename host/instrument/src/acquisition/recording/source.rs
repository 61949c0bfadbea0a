//! A folder of images as a source of frames: each image is read, checked and labelled as a camera process would label it.

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;

use flankscope_frames::{
    Arm, BorrowedFrame, FrameHeader, FrameLabel, FrameSource, Ready, ReceiveError, checksum,
    monotonic_ns,
};
use flankscope_profilometry::FrameKind;
use flankscope_profilometry::io::images::{GreyImage, ImageError, read_grey};

use super::RecordedView;
use flankscope_foundation::files;

/// Why a view's images cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ImageProblem {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The image differs from the one that was recorded.
    #[error("{} is not what was recorded: its BLAKE3 is {got}, the index says {expected}", path.display())]
    Changed {
        /// The image.
        path: PathBuf,
        /// BLAKE3 of the file.
        got: String,
        /// BLAKE3 in the index.
        expected: String,
    },
    /// The image repeats an earlier one: two exposures of a real sensor never agree to the last bit.
    #[error("{} is {} again, to the last bit: one of them is missing, or the index names a view twice", path.display(), earlier.display())]
    Again {
        /// The image.
        path: PathBuf,
        /// The earlier image with the same content.
        earlier: PathBuf,
    },
    /// The image has counts above the sensor's full scale.
    #[error(
        "{} has counts of up to {got}, the sensor ends at {full_scale}: counts are not stretched to the bits of the file",
        path.display()
    )]
    BeyondSensor {
        /// The image.
        path: PathBuf,
        /// Largest count.
        got: u16,
        full_scale: u16,
    },
}

/// A frame that was read from a file.
#[derive(Debug)]
pub struct ReadFrame {
    header: FrameHeader,
    pixels: Vec<u16>,
    received_monotonic_ns: u64,
}

impl BorrowedFrame for ReadFrame {
    fn header(&self) -> &FrameHeader {
        &self.header
    }

    fn pixels(&self) -> &[u16] {
        &self.pixels
    }

    fn received_monotonic_ns(&self) -> u64 {
        self.received_monotonic_ns
    }
}

/// Size and depth that images must have.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    pub size_px: [u32; 2],
    pub full_scale: u16,
    pub exposures_us: Vec<u32>,
}

/// How long the source waits for the next session.
const IDLE: Duration = Duration::from_millis(5);

/// Returns the frames of the requested views, in their order.
pub struct FolderSource {
    camera: Camera,
    /// Receives the views of each next session.
    next: Receiver<Vec<RecordedView>>,
    /// Sends the views of the session that cannot be read, and why.
    problems: Sender<(usize, ImageProblem)>,
    session: u32,
    counter: u32,
    views: VecDeque<(usize, RecordedView)>,
    frames: VecDeque<ReadFrame>,
    /// Every fringe image read so far, by a hash of its content.
    seen: HashMap<u64, PathBuf>,
}

impl FolderSource {
    pub(super) fn new(
        camera: Camera,
        next: Receiver<Vec<RecordedView>>,
        problems: Sender<(usize, ImageProblem)>,
    ) -> Self {
        Self {
            camera,
            next,
            problems,
            session: 0,
            counter: 0,
            views: VecDeque::new(),
            frames: VecDeque::new(),
            seen: HashMap::new(),
        }
    }

    /// Reads all frames of a view, or returns why it has none: a view is used only with all its frames.
    fn read(&mut self, view: usize, of: &RecordedView) -> Result<(), ImageProblem> {
        let times = of.times(&of.said.exposed_us, &self.camera.exposures_us);
        let mut frames = VecDeque::with_capacity(of.images.len());
        for (at, ((kind, path), exposed)) in of.images.iter().zip(times).enumerate() {
            let image = self.image(path, of.said.blake3.get(at))?;
            let sum = checksum(&image.pixels);
            // One dark frame may serve several views, and a whole view may lie within one stripe of a code, so only fringes must differ.
            if matches!(kind, FrameKind::Fringe { .. })
                && let Some(earlier) = self.seen.insert(sum, path.clone())
            {
                let path = path.clone();
                return Err(ImageProblem::Again { path, earlier });
            }
            let label = FrameLabel {
                view: view as u16,
                in_view: at as u16,
                exposure: kind.exposure().unwrap_or(0) as u16,
                pattern: pattern(&of.images, at),
            };
            frames.push_back(self.frame(image, label, exposed, sum));
        }
        self.frames = frames;
        Ok(())
    }

    fn image(&self, path: &Path, expected: Option<&String>) -> Result<GreyImage, ImageProblem> {
        let content = files::read_regular(path, files::MOST_DATA_BYTES).map_err(|source| {
            ImageError::Open {
                path: path.to_owned(),
                source,
            }
        })?;
        if let Some(expected) = expected {
            let got = files::hash(&content);
            if !got.eq_ignore_ascii_case(expected) {
                return Err(ImageProblem::Changed {
                    path: path.to_owned(),
                    got,
                    expected: expected.clone(),
                });
            }
        }
        let image = read_grey(path, &content, self.camera.size_px)?;
        let got = image.pixels.iter().copied().max().unwrap_or_default();
        if got > self.camera.full_scale {
            return Err(ImageProblem::BeyondSensor {
                path: path.to_owned(),
                got,
                full_scale: self.camera.full_scale,
            });
        }
        Ok(image)
    }

    fn frame(
        &mut self,
        image: GreyImage,
        label: FrameLabel,
        [start_us, end_us]: [u64; 2],
        checksum: u64,
    ) -> ReadFrame {
        let counter = self.counter;
        self.counter = self.counter.wrapping_add(1);
        let [width_px, height_px] = self.camera.size_px;
        let now = monotonic_ns();
        ReadFrame {
            header: FrameHeader {
                session: self.session,
                counter,
                label,
                width_px,
                height_px,
                stride_px: width_px,
                // Exposure times come from the index, so they count as measured.
                measured: FrameHeader::ALL_MEASURED,
                exposure_start_us: start_us,
                exposure_end_us: end_us,
                exposure_end_monotonic_ns: now,
                published_monotonic_ns: now,
                checksum,
            },
            pixels: image.pixels,
            received_monotonic_ns: now,
        }
    }
}

impl FrameSource for FolderSource {
    type Frame = ReadFrame;

    fn arm(&mut self, arm: Arm) -> Result<(), ReceiveError> {
        self.session = arm.session;
        self.frames.clear();
        // The views were sent before the session is armed.
        self.views = self
            .next
            .try_recv()
            .unwrap_or_default()
            .into_iter()
            .enumerate()
            .collect();
        Ok(())
    }

    /// Recorded frames are always ready.
    fn ready(&mut self) -> Result<Option<Ready>, ReceiveError> {
        let [width_px, height_px] = self.camera.size_px;
        Ok(Some(Ready {
            session: self.session,
            width_px,
            height_px,
            ..Ready::default()
        }))
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<ReadFrame>, ReceiveError> {
        while self.frames.is_empty() {
            let Some((view, of)) = self.views.pop_front() else {
                // No frame is returned before the next session is armed.
                std::thread::sleep(timeout.min(IDLE));
                return Ok(None);
            };
            if let Err(problem) = self.read(view, &of) {
                // If the receiver is gone, nothing waits for the view either.
                let _ = self.problems.send((view, problem));
            }
        }
        Ok(self.frames.pop_front())
    }
}

/// Pattern number within its exposure: 0 for the dark frame, then 1, 2, … in order.
pub(super) fn pattern(images: &[(FrameKind, PathBuf)], at: usize) -> u16 {
    let Some((kind, before)) = images.get(..=at).and_then(<[_]>::split_last) else {
        return 0;
    };
    let Some(exposure) = kind.0.exposure() else {
        return 0;
    };
    let same = before
        .iter()
        .filter(|(kind, _)| kind.exposure() == Some(exposure));
    same.count() as u16 + 1
}
