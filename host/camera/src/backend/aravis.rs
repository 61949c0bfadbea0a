//! Cameras of the GenICam world, GigE Vision and USB3 Vision, through Aravis.
//!
//! Features have the names of the GenICam Standard Features Naming Convention. The camera exposes as long as its trigger line is
//! high (`ExposureMode` `TriggerWidth`); nothing that would change its counts by itself is left on. Whatever it does not take is an
//! error, because an instrument that believes in settings that the camera does not have measures something else.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use aravis::glib::object::{Cast, ObjectExt};
use aravis::prelude::*;
use aravis::{Buffer, BufferStatus, Camera, GvStream, Stream};
use flankscope_frames::{FrameHeader, monotonic_ns};

use super::{Backend, CameraError, Description, Next, Status, Taken};
use crate::frame_id::Counting;
use crate::unpack::PixelFormat;

/// Frames that may wait while one is late: one with missing packets is given up after [`PACKET_PATIENCE`] times a few.
const BUFFERS: usize = 16;
/// How long Aravis waits for the packets of a frame before it asks again, and before it gives the frame up.
const PACKET_PATIENCE: Duration = Duration::from_millis(20);
const FRAME_PATIENCE: Duration = Duration::from_millis(100);
/// A camera that exposes though nothing triggers it shows that within this, once it is found: a second is too long to wait for
/// each view, and cameras take a while until their first frame.
const QUIET_AT_FIRST: Duration = Duration::from_secs(1);
/// And before each view: two frames of 20 a second.
const QUIET: Duration = Duration::from_millis(100);
/// No frame has it.
const NO_ID: u64 = u64::MAX;
/// In the order in which they are asked for: most bits, then fewest bytes.
const FORMATS: [PixelFormat; 8] = [
    PixelFormat::Mono12p,
    PixelFormat::Mono12Packed,
    PixelFormat::Mono12,
    PixelFormat::Mono16,
    PixelFormat::Mono10p,
    PixelFormat::Mono10Packed,
    PixelFormat::Mono10,
    PixelFormat::Mono8,
];

/// What a camera's time stamp is of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Stamp {
    /// The start of the exposure, as the naming convention has it.
    #[default]
    Start,
    /// Its end.
    End,
}

/// Which camera, and what it cannot say of itself.
#[derive(clap::Args, Clone, Debug)]
pub struct Settings {
    /// Address, serial number or name of the camera [default: the first one found]
    #[arg(long, value_name = "NAME|ADDRESS")]
    pub camera: Option<String>,
    /// The input that the trigger is wired to
    #[arg(long, value_name = "LINE", default_value = "Line0")]
    pub trigger_line: String,
    /// How the camera packs its samples [default: most bits in fewest bytes that it offers, Mono12p first]
    #[arg(long, value_name = "FORMAT")]
    pub format: Option<PixelFormat>,
    /// What its time stamps are of; its manual says so
    #[arg(long, value_enum, default_value_t)]
    pub stamp: Stamp,
    /// Bytes of a packet on a network [default: the largest that come through]
    #[arg(long, value_name = "BYTES", value_parser = clap::value_parser!(i32).range(576..=16_000))]
    pub packet_bytes: Option<i32>,
    /// Gain in dB to set [default: left as it is]
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    pub gain_db: Option<f64>,
    /// Electrons per count at a gain of 0 dB, by its data sheet (EMVA 1288): then the gain is compared with the head's
    #[arg(long, value_name = "E")]
    pub electrons_per_count: Option<f64>,
    /// Counts per unit of its BlackLevel: then the offset is compared with the head's
    #[arg(long, value_name = "DN")]
    pub counts_per_black_level: Option<f64>,
}

/// A camera behind Aravis.
pub struct Aravis {
    settings: Settings,
    open: Option<Open>,
    status: Status,
    /// It was found before, and did not run freely.
    known: bool,
}

/// What is open of it.
struct Open {
    camera: Camera,
    stream: Stream,
    lost: Arc<AtomicBool>,
    format: PixelFormat,
    size_px: [i32; 2],
    counting: Counting,
    /// Packets that were missing when it was armed last.
    packets_before: u64,
}

impl Drop for Open {
    fn drop(&mut self) {
        // Of one that is gone nothing can be asked any more.
        let _ = self.camera.stop_acquisition();
    }
}

impl Aravis {
    /// Not yet looked for.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            open: None,
            status: Status::default(),
            known: false,
        }
    }

    fn open(&mut self) -> Result<&mut Open, CameraError> {
        self.open.as_mut().ok_or_else(|| CameraError::Gone {
            reason: "it was never found".into(),
        })
    }
}

/// Aravis' own words of why something does not work with a camera that may have gone.
fn gone(error: aravis::glib::Error) -> CameraError {
    CameraError::Gone {
        reason: error.message().into(),
    }
}

/// A feature that the camera has to have in just this way.
fn demand(camera: &Camera, feature: &str, value: &str, why: &str) -> Result<(), CameraError> {
    let wrong = |reason: String| CameraError::Setting {
        setting: feature.into(),
        reason: format!("{reason}; it must be {value}: {why}"),
    };
    camera
        .set_string(feature, value)
        .map_err(|error| wrong(error.message().into()))?;
    match camera.string(feature) {
        Ok(got) if got == value => Ok(()),
        Ok(got) => Err(wrong(format!("it is {got} after it was set"))),
        Err(error) => Err(wrong(error.message().into())),
    }
}

/// The same of one that not every camera has.
fn demand_if_there(
    camera: &Camera,
    feature: &str,
    value: &str,
    why: &str,
) -> Result<(), CameraError> {
    match camera.is_feature_available(feature) {
        Ok(true) => demand(camera, feature, value, why),
        Ok(false) => Ok(()),
        Err(error) => Err(gone(error)),
    }
}

/// A number, where the camera has such a feature.
fn number(camera: &Camera, feature: &str) -> Result<Option<f64>, CameraError> {
    if !camera.is_feature_available(feature).map_err(gone)? {
        return Ok(None);
    }
    let read = camera
        .float(feature)
        .map_err(|error| CameraError::Setting {
            setting: feature.into(),
            reason: error.message().into(),
        })?;
    match read.is_finite() {
        true => Ok(Some(read)),
        false => Err(CameraError::Setting {
            setting: feature.into(),
            reason: format!("{read} is no number"),
        }),
    }
}

impl Settings {
    /// Has the camera triggered by its line, and switches off whatever changes counts by itself.
    fn impose(&self, camera: &Camera) -> Result<(), CameraError> {
        const BY_ITSELF: &str = "nothing may change its counts by itself";
        const TRIGGERED: &str = "it exposes when and as long as its trigger line says so";
        for feature in ["ExposureAuto", "GainAuto", "BlackLevelAuto"] {
            demand_if_there(camera, feature, "Off", BY_ITSELF)?;
        }
        demand_if_there(
            camera,
            "AcquisitionMode",
            "Continuous",
            "frames follow the triggers",
        )?;
        demand_if_there(camera, "TriggerSelector", "FrameStart", TRIGGERED)?;
        demand(camera, "TriggerMode", "On", TRIGGERED)?;
        demand(camera, "TriggerSource", &self.trigger_line, TRIGGERED)?;
        demand_if_there(camera, "TriggerActivation", "RisingEdge", TRIGGERED)?;
        demand(camera, "ExposureMode", "TriggerWidth", TRIGGERED)?;
        if let Some(gain_db) = self.gain_db {
            camera
                .set_float("Gain", gain_db)
                .map_err(|error| CameraError::Setting {
                    setting: "Gain".into(),
                    reason: error.message().into(),
                })?;
        }
        Ok(())
    }

    /// Sets the way in which samples are packed.
    fn pack(&self, camera: &Camera) -> Result<PixelFormat, CameraError> {
        let offered = camera
            .dup_available_pixel_formats_as_strings()
            .map_err(gone)?;
        let offers = |format: &PixelFormat| offered.iter().any(|name| name == format.name());
        let wanted = self.format.as_slice();
        let wanted = if wanted.is_empty() { &FORMATS } else { wanted };
        let Some(format) = wanted.iter().copied().find(offers) else {
            let names = |all: &[&str]| all.join(", ");
            let offered: Vec<&str> = offered.iter().map(|name| name.as_str()).collect();
            let wanted: Vec<&str> = wanted.iter().map(|format| format.name()).collect();
            return Err(CameraError::Setting {
                setting: "PixelFormat".into(),
                reason: format!(
                    "the camera offers {}; {} would be right",
                    names(&offered),
                    names(&wanted)
                ),
            });
        };
        let why = "its samples are unpacked so";
        demand(camera, "PixelFormat", format.name(), why)?;
        Ok(format)
    }
}

impl Backend for Aravis {
    fn configure(&mut self) -> Result<Description, CameraError> {
        // A camera has one master: what is left of an earlier connection goes first.
        self.open = None;
        let settings = &self.settings;
        let camera = Camera::new(settings.camera.as_deref()).map_err(|error| {
            let named = settings.camera.as_deref().unwrap_or("any camera");
            CameraError::Gone {
                reason: format!("{named}: {}", error.message()),
            }
        })?;
        camera.stop_acquisition().map_err(gone)?;
        settings.impose(&camera)?;
        let format = settings.pack(&camera)?;
        let (_, _, width, height) = camera.region().map_err(gone)?;
        let largest = flankscope_frames::MAX_FRAME_PIXELS as i64;
        let pixels = i64::from(width) * i64::from(height);
        if width < 1 || height < 1 || pixels > largest {
            return Err(CameraError::Setting {
                setting: "Width, Height".into(),
                reason: format!("{width} x {height} px: 1 to {largest} pixels are possible"),
            });
        }
        let network = camera.is_gv_device();
        if network {
            match settings.packet_bytes {
                Some(bytes) => camera.gv_set_packet_size(bytes).map_err(gone)?,
                None => camera.gv_auto_packet_size().map_err(gone)?,
            }
        }
        let gain_db = number(&camera, "Gain")?;
        let black_level = number(&camera, "BlackLevel")?;
        let said = |text: Result<aravis::glib::GString, aravis::glib::Error>| {
            text.map_or_else(|_| String::new(), |text| text.trim().to_owned())
        };
        let model = format!(
            "{} {}",
            said(camera.vendor_name()),
            said(camera.model_name())
        );
        let kind = if network {
            "GigE Vision"
        } else {
            "USB3 Vision"
        };
        let link = format!("{kind}, serial {}", said(camera.device_serial_number()));
        let counting = match (network, camera.string("GevGVSPExtendedIDMode")) {
            (true, Ok(mode)) if mode == "On" => Counting::SixtyFour,
            (true, _) => Counting::Sixteen,
            (false, _) => Counting::SixtyFour,
        };
        let stream = camera.create_stream().map_err(gone)?;
        if let Some(stream) = stream.downcast_ref::<GvStream>() {
            stream.set_socket_buffer(aravis::GvStreamSocketBuffer::Auto);
            stream.set_packet_timeout(PACKET_PATIENCE.as_micros() as u32);
            stream.set_frame_retention(FRAME_PATIENCE.as_micros() as u32);
        }
        let payload = camera.payload().map_err(gone)? as usize;
        if payload < format.bytes(pixels as usize) {
            return Err(CameraError::Setting {
                setting: "PayloadSize".into(),
                reason: format!(
                    "{payload} bytes; {width} x {height} px of {} take {}",
                    format.name(),
                    format.bytes(pixels as usize)
                ),
            });
        }
        for _ in 0..BUFFERS {
            let buffer = Buffer::new_allocate(payload);
            buffer.set_frame_id(NO_ID);
            stream.push_buffer(buffer);
        }
        let lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = camera.device() {
            let lost = Arc::clone(&lost);
            device.connect_control_lost(move |_| lost.store(true, Ordering::Release));
        }
        self.status = Status {
            packets_lost: network.then_some(0),
            frame_bytes: payload as u64,
            network,
            ..Status::default()
        };
        let description = Description {
            model,
            link,
            width_px: width as u32,
            height_px: height as u32,
            bits: format.bits(),
            offset_dn: black_level
                .zip(settings.counts_per_black_level)
                .map(|(level, counts)| level * counts),
            gain_e_per_dn: gain_db
                .zip(settings.electrons_per_count)
                .map(|(gain_db, electrons)| electrons / 10_f64.powf(gain_db / 20.0)),
            counting,
        };
        let mut open = Open {
            camera,
            stream,
            lost,
            format,
            size_px: [width, height],
            counting,
            packets_before: 0,
        };
        // One that comes back in the middle of a check is triggered still: frames say nothing of it then. The arming asks again.
        if !self.known {
            open.start(QUIET_AT_FIRST)?;
            open.camera.stop_acquisition().map_err(gone)?;
        }
        self.known = true;
        self.open = Some(open);
        Ok(description)
    }

    fn arm(&mut self, _frames: u32) -> Result<(), CameraError> {
        let open = self.open()?;
        open.start(QUIET)?;
        self.status = Status {
            packets_lost: self.status.packets_lost.map(|_| 0),
            frame_bytes: self.status.frame_bytes,
            network: self.status.network,
            ..Status::default()
        };
        Ok(())
    }

    fn next(&mut self, slot: &mut [u16], patience: Duration) -> Result<Next, CameraError> {
        let stamp = self.settings.stamp;
        let Some(open) = &mut self.open else {
            return Err(CameraError::Gone {
                reason: "it was never found".into(),
            });
        };
        let buffer = open.stream.timeout_pop_buffer(patience.as_micros() as u64);
        let Some(buffer) = buffer else {
            if open.lost.load(Ordering::Acquire) {
                self.open = None;
                return Err(CameraError::Gone {
                    reason: "it does not answer any more: unplugged, switched off, or another program has it".into(),
                });
            }
            return Ok(Next::Nothing);
        };
        let next = match buffer.status() {
            BufferStatus::Success => open.take(&buffer, stamp, slot).map(Next::Whole),
            _ => Ok(Next::Incomplete {
                id: Some(open.id(&buffer)).filter(|&id| id != NO_ID),
            }),
        };
        open.give_back(buffer);
        match &next {
            Ok(Next::Whole(_)) => self.status.whole += 1,
            _ => self.status.incomplete += 1,
        }
        if let Some(packets) = &mut self.status.packets_lost {
            *packets = open.packets_missing().saturating_sub(open.packets_before);
        }
        next
    }

    fn status(&self) -> Status {
        self.status
    }
}

impl Open {
    /// Has it expose whenever its line says so. Changed settings, and frames that were begun, make a camera's numbers jump: it
    /// begins anew, with nothing on its way, and nothing may come within `quiet` by itself.
    fn start(&mut self, quiet: Duration) -> Result<(), CameraError> {
        self.camera.stop_acquisition().map_err(gone)?;
        self.discard(QUIET);
        self.packets_before = self.packets_missing();
        let heard_before = self.heard();
        self.camera.start_acquisition().map_err(gone)?;
        // A frame that has only begun to come is one, too.
        if self.dropped_one(quiet) || self.heard() > heard_before {
            let _ = self.camera.stop_acquisition();
            return Err(CameraError::Setting {
                setting: "TriggerMode".into(),
                reason: "frames come though nothing triggers the camera: it runs freely, or its trigger line is open; \
                         see how the line is wired, and that no other program sets the camera"
                    .into(),
            });
        }
        Ok(())
    }

    /// Takes frames out of the stream until none has come for `quiet`, at most ten times as long.
    fn discard(&self, quiet: Duration) {
        let end = Instant::now() + 10 * quiet;
        while Instant::now() < end && self.dropped_one(quiet) {}
    }

    /// Whether a frame came within `patience`; it goes nowhere.
    fn dropped_one(&self, patience: Duration) -> bool {
        let frame = self.stream.timeout_pop_buffer(patience.as_micros() as u64);
        frame.map(|buffer| self.give_back(buffer)).is_some()
    }

    /// For the next frame. One whose first packet is lost would carry the number that its buffer had before.
    fn give_back(&self, buffer: Buffer) {
        buffer.set_frame_id(NO_ID);
        self.stream.push_buffer(buffer);
    }

    /// Packets or bytes of frames so far, whole or not.
    fn heard(&self) -> u64 {
        self.stream
            .info_uint64_by_name(match self.counting_packets() {
                true => "n_received_packets",
                false => "n_transferred_bytes",
            })
    }

    fn counting_packets(&self) -> bool {
        self.stream.is::<GvStream>()
    }

    fn packets_missing(&self) -> u64 {
        match self.counting_packets() {
            true => self.stream.info_uint64_by_name("n_missing_packets"),
            false => 0,
        }
    }

    fn id(&self, buffer: &Buffer) -> u64 {
        match (self.counting, buffer.frame_id()) {
            (_, NO_ID) => NO_ID,
            (Counting::Sixteen, id) => id & 0xFFFF,
            (Counting::SixtyFour, id) => id,
        }
    }

    /// Unpacks a whole frame straight into the slot.
    fn take(&self, buffer: &Buffer, stamp: Stamp, slot: &mut [u16]) -> Result<Taken, CameraError> {
        let (_, _, width, height) = buffer.image_region();
        let packed = buffer.image_pixel_format().raw();
        if [width, height] != self.size_px || packed != self.format.pfnc() {
            let [right_width, right_height] = self.size_px;
            return Err(CameraError::Setting {
                setting: "a frame came with other settings than the camera was given".into(),
                reason: format!(
                    "{width} x {height} px of pixel format {packed:#010x}; {right_width} x {right_height} px of {} ({:#010x}) \
                     would be right: see that no other program sets the camera",
                    self.format.name(),
                    self.format.pfnc()
                ),
            });
        }
        let (data, length) = buffer.data();
        let need = self.format.bytes(slot.len());
        let bytes = match data.is_null() {
            true => &[][..],
            // SAFETY: Aravis gives the address and length of the buffer's own memory, which nobody writes while the buffer is
            // out of the stream; `buffer` lives longer than the slice. What follows the image is its padding and chunks.
            false => unsafe { std::slice::from_raw_parts(data.cast_const(), length.min(need)) },
        };
        self.format.unpack(bytes, slot)?;
        let stamp_us = buffer.timestamp() / 1000;
        Ok(Taken {
            id: self.id(buffer),
            // How long it was is not told: the trigger line was high for so long.
            exposure_start_us: stamp_us,
            exposure_end_us: stamp_us,
            exposure_end_monotonic_ns: monotonic_of(buffer.system_timestamp()),
            measured: match stamp {
                Stamp::End => FrameHeader::END_MEASURED,
                Stamp::Start => 0,
            },
        })
    }
}

/// A time of the wall clock in the recent past on the monotonic clock, ns; now, where nobody kept it.
fn monotonic_of(wall_ns: u64) -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let now_ns = since.map_or(0, |since| since.as_nanos() as u64);
    let ago_ns = match wall_ns {
        0 => 0,
        kept_ns => now_ns.saturating_sub(kept_ns),
    };
    monotonic_ns().saturating_sub(ago_ns)
}
