//! A folder of images as a camera, with a trigger or a rate.
//!
//! `camera.toml` in the folder says what the images are; they are shown in the order of their names, and again from the first
//! one. A `.png` holds grey samples of 8 or 16 bits, any other file the bytes as a camera packs them.

use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use flankscope_foundation::files::{MOST_DATA_BYTES, read_regular, read_text};
use flankscope_frames::{FrameHeader, monotonic_ns};
use serde::Deserialize;

use super::{Backend, CameraError, Description, Next, Status, Taken};
use crate::frame_id::Counting;
use crate::unpack::PixelFormat;

/// `camera.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// Maker and model.
    #[serde(default)]
    model: Option<String>,
    /// Columns.
    width_px: u32,
    /// Rows.
    height_px: u32,
    /// Samples of files that are no PNG; their bits also count for a PNG of 16 bits.
    format: String,
    /// Frames per second after arming; absent: a line on standard input fires one, its exposure in µs.
    #[serde(default)]
    rate_hz: Option<f64>,
    /// Exposure of every frame at a rate, µs.
    #[serde(default)]
    exposure_us: Option<u64>,
    /// Number of the first frame.
    #[serde(default)]
    first_id: Option<u64>,
}

/// The camera.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    images: Vec<PathBuf>,
    file: Option<File>,
    format: PixelFormat,
    triggers: Option<Receiver<u64>>,
    /// Since when, and how many frames are still to come at the rate.
    running: Option<(Instant, u32)>,
    switched_on: Instant,
    shown: usize,
    id: u64,
    status: Status,
}

/// What a GigE Vision camera counts to.
const LAST_ID: u64 = 65_535;

impl Folder {
    /// A camera that shows the images of a folder; nothing is read before it is configured.
    #[must_use]
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            images: Vec::new(),
            file: None,
            format: PixelFormat::Mono16,
            triggers: None,
            running: None,
            switched_on: Instant::now(),
            shown: 0,
            id: 0,
            status: Status::default(),
        }
    }

    fn read(&self) -> Result<(File, PixelFormat), CameraError> {
        let path = self.path.join("camera.toml");
        let wrong = |reason: String| CameraError::Setting {
            setting: path.display().to_string(),
            reason,
        };
        let text = read_text(&path).map_err(|error| wrong(error.to_string()))?;
        let file: File = toml::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        let format: PixelFormat = file.format.parse()?;
        let largest = flankscope_frames::MAX_FRAME_PIXELS as u64;
        let pixels = u64::from(file.width_px) * u64::from(file.height_px);
        if pixels == 0 || pixels > largest {
            return Err(wrong(format!(
                "{} x {} px: 1 to {largest} pixels are possible",
                file.width_px, file.height_px
            )));
        }
        if file
            .rate_hz
            .is_some_and(|rate| !(rate > 0.0 && rate <= 1e3))
        {
            return Err(wrong("rate_hz must be more than 0 and at most 1000".into()));
        }
        if file.first_id.is_some_and(|id| !(1..=LAST_ID).contains(&id)) {
            return Err(wrong("first_id must be 1 to 65535".into()));
        }
        Ok((file, format))
    }

    /// Waits for a trigger: the exposure in µs, or nothing in time, or that none will come.
    fn trigger(&mut self, patience: Duration) -> Option<Option<u64>> {
        if let Some(triggers) = &self.triggers {
            return match triggers.recv_timeout(patience) {
                Ok(exposure_us) => Some(Some(exposure_us)),
                Err(RecvTimeoutError::Timeout) => Some(None),
                Err(RecvTimeoutError::Disconnected) => None,
            };
        }
        let file = self.file.as_ref()?;
        let exposure_us = file.exposure_us.unwrap_or(1_000);
        let (due, left) = self.running?;
        if left == 0 {
            std::thread::sleep(patience);
            return Some(None);
        }
        let wait = due.saturating_duration_since(Instant::now());
        if wait > patience {
            std::thread::sleep(patience);
            return Some(None);
        }
        std::thread::sleep(wait);
        let period = Duration::from_secs_f64(1.0 / file.rate_hz.unwrap_or(1.0));
        self.running = Some((due + period, left - 1));
        Some(Some(exposure_us))
    }

    /// Reads an image into the slot; false if its file does not hold a whole one.
    fn show(&self, image: &Path, slot: &mut [u16]) -> Result<bool, CameraError> {
        let gone = |error: &dyn std::fmt::Display| CameraError::Gone {
            reason: format!("{}: {error}", image.display()),
        };
        let bytes = read_regular(image, MOST_DATA_BYTES).map_err(|error| gone(&error))?;
        if image.extension().is_none_or(|is| is != "png") {
            // As a transfer that broke off.
            if bytes.len() < self.format.bytes(slot.len()) {
                return Ok(false);
            }
            self.format.unpack(&bytes, slot)?;
            return Ok(true);
        }
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes))
            .read_info()
            .map_err(|error| gone(&error))?;
        let info = reader.info();
        let (size, color, depth) = ((info.width, info.height), info.color_type, info.bit_depth);
        let file = self.file.as_ref();
        let right = file.map(|file| (file.width_px, file.height_px));
        if Some(size) != right || color != png::ColorType::Grayscale {
            return Err(gone(&format!(
                "{} x {} px, {color:?}; camera.toml says {right:?}, grey",
                size.0, size.1
            )));
        }
        let mut samples = vec![0; reader.output_buffer_size().unwrap_or_default()];
        reader
            .next_frame(&mut samples)
            .map_err(|error| gone(&error))?;
        match depth {
            png::BitDepth::Eight => PixelFormat::Mono8.unpack(&samples, slot)?,
            png::BitDepth::Sixteen => {
                for (pixel, pair) in slot.iter_mut().zip(samples.chunks_exact(2)) {
                    *pixel = u16::from_be_bytes([pair[0], pair[1]]);
                }
            }
            other => return Err(gone(&format!("{other:?} bits; 8 or 16 can be read"))),
        }
        Ok(true)
    }
}

impl Backend for Folder {
    fn configure(&mut self) -> Result<Description, CameraError> {
        let (file, format) = self.read()?;
        let entries = std::fs::read_dir(&self.path).map_err(|error| CameraError::Gone {
            reason: format!("{}: {error}", self.path.display()),
        })?;
        self.images = entries
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| {
                path.is_file() && path.file_name().is_some_and(|name| name != "camera.toml")
            })
            .collect();
        self.images.sort();
        if self.images.is_empty() {
            return Err(CameraError::Setting {
                setting: self.path.display().to_string(),
                reason: "there is no image: .png, or files as the camera packs them".into(),
            });
        }
        if file.rate_hz.is_none() && self.triggers.is_none() {
            let (sender, triggers) = mpsc::channel();
            std::thread::spawn(move || {
                for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                    let Ok(exposure_us) = line.trim().parse() else {
                        continue;
                    };
                    if sender.send(exposure_us).is_err() {
                        return;
                    }
                }
            });
            self.triggers = Some(triggers);
        }
        self.format = format;
        self.id = file.first_id.unwrap_or(1) - 1;
        self.status.frame_bytes =
            format.bytes(file.width_px as usize * file.height_px as usize) as u64;
        let description = Description {
            model: file.model.clone().unwrap_or_else(|| "folder".into()),
            link: self.path.display().to_string(),
            width_px: file.width_px,
            height_px: file.height_px,
            bits: format.bits(),
            offset_dn: None,
            gain_e_per_dn: None,
            counting: Counting::Sixteen,
        };
        self.file = Some(file);
        Ok(description)
    }

    fn arm(&mut self, frames: u32) -> Result<(), CameraError> {
        self.running = Some((Instant::now(), frames));
        self.shown = 0;
        self.status = Status {
            frame_bytes: self.status.frame_bytes,
            ..Status::default()
        };
        Ok(())
    }

    fn next(&mut self, slot: &mut [u16], patience: Duration) -> Result<Next, CameraError> {
        let exposure_us = match self.trigger(patience) {
            Some(Some(exposure_us)) => exposure_us,
            Some(None) => return Ok(Next::Nothing),
            None if self.triggers.is_none() => {
                // Never armed yet.
                std::thread::sleep(patience);
                return Ok(Next::Nothing);
            }
            None => return Ok(Next::End),
        };
        let start_us = self.switched_on.elapsed().as_micros() as u64;
        std::thread::sleep(Duration::from_micros(exposure_us));
        let ended_ns = monotonic_ns();
        self.id = self.id % LAST_ID + 1;
        let image = self.images[self.shown % self.images.len()].clone();
        self.shown += 1;
        if !self.show(&image, slot)? {
            self.status.incomplete += 1;
            return Ok(Next::Incomplete { id: Some(self.id) });
        }
        self.status.whole += 1;
        Ok(Next::Whole(Taken {
            id: self.id,
            exposure_start_us: start_us,
            exposure_end_us: start_us + exposure_us,
            exposure_end_monotonic_ns: ended_ns,
            measured: FrameHeader::END_MEASURED,
        }))
    }

    fn status(&self) -> Status {
        self.status
    }
}
