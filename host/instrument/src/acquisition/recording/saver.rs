//! Writes frames from shared memory to files while they are summed, so that a check can be repeated from them later.

use std::io;
use std::path::{Path, PathBuf};

use flankscope_frames::{BorrowedFrame, Frame, FrameHeader};
use flankscope_protocol::Trigger;

use super::index::IndexedView;
use flankscope_foundation::files;

/// Writes frames into a folder: one subfolder for each capture of a view, one binary PGM for each frame.
///
/// A frame takes 10 ms at 1920 x 1200 pixels, most of it for the digest: less than its readout.
#[derive(Debug)]
pub struct Saver {
    folder: PathBuf,
    full_scale_dn: u16,
    captures: usize,
    file: Vec<u8>,
}

/// The files of one capture of a view.
#[derive(Debug)]
pub struct SavedCapture {
    folder: PathBuf,
    name: String,
    session: u32,
    exposed_us: Vec<[u64; 2]>,
    /// Whether the camera measured the exposure times.
    lengths_measured: bool,
    blake3: Vec<String>,
    failed: Option<io::Error>,
}

/// A capture whose frames and triggers pair.
#[derive(Debug)]
pub struct SavedView {
    /// View of the plan.
    pub view: usize,
    /// Session in which it was captured.
    pub session: u32,
    /// Its entry in the index, without the position of the stages.
    pub index: IndexedView,
    /// Why not all of its frames were written, if so.
    pub failed: Option<io::Error>,
}

impl Saver {
    /// Writes into the existing `folder`; counts reach up to `full_scale_dn`.
    pub fn new(folder: &Path, full_scale_dn: u16) -> Self {
        Self {
            folder: folder.to_owned(),
            full_scale_dn,
            captures: 0,
            file: Vec::new(),
        }
    }

    /// Makes a folder for the next capture.
    pub fn begin(&mut self) -> SavedCapture {
        self.captures += 1;
        let name = format!("capture-{:04}", self.captures);
        let folder = self.folder.join(&name);
        let failed = std::fs::create_dir(&folder).err();
        SavedCapture {
            folder,
            name,
            session: 0,
            exposed_us: Vec::new(),
            lengths_measured: true,
            blake3: Vec::new(),
            failed,
        }
    }

    /// Writes the next frame of a capture; does nothing after a failure.
    pub fn add(&mut self, capture: &mut SavedCapture, frame: &impl BorrowedFrame) {
        if capture.failed.is_some() {
            return;
        }
        let header = frame.header();
        let (width, height) = (header.width_px as usize, header.height_px as usize);
        self.file.clear();
        self.file
            .extend(format!("P5\n{width} {height}\n{}\n", self.full_scale_dn).bytes());
        let rows = frame
            .pixels()
            .chunks(header.stride_px as usize)
            .take(height);
        for row in rows {
            let counts = row.get(..width).unwrap_or(row);
            Frame::count_copied(counts);
            self.file
                .extend(counts.iter().flat_map(|dn| dn.to_be_bytes()));
        }
        let path = capture
            .folder
            .join(format!("frame-{:04}.pgm", capture.blake3.len()));
        capture.session = header.session;
        capture.failed = std::fs::write(path, &self.file).err();
        capture.blake3.push(files::hash(&self.file));
        let length = header.measured & FrameHeader::EXPOSURE_MEASURED != 0;
        capture
            .exposed_us
            .push([header.exposure_start_us, header.exposure_end_us]);
        capture.lengths_measured &= length;
    }
}

impl SavedCapture {
    /// Assigns the capture to a view, with the triggers that exposed its frames.
    pub fn of_view(self, view: usize, triggers: &[Trigger]) -> SavedView {
        let triggered = triggers.iter().map(|t| [t.camera_at.0, t.end_at.0]);
        let mut exposed_us = self.exposed_us;
        if !self.lengths_measured {
            // Exposure times that were not measured are set to the commanded ones.
            for (exposed, trigger) in exposed_us.iter_mut().zip(triggers) {
                exposed[0] = exposed[1].saturating_sub(trigger.end_at.0 - trigger.camera_at.0);
            }
        }
        SavedView {
            view,
            session: self.session,
            index: IndexedView {
                folder: self.name.into(),
                triggered_us: triggered.collect(),
                exposed_us,
                blake3: self.blake3,
                ..IndexedView::default()
            },
            failed: self.failed,
        }
    }

    /// Session in which it was captured.
    pub fn session(&self) -> u32 {
        self.session
    }

    /// Removes its files, because its frames cannot be trusted.
    pub fn discard(self) {
        // A file that remains is named in no index.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
