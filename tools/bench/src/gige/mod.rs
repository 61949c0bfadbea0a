//! The bench's camera as a third-party camera: Aravis' fake GigE Vision camera, with pixels of the bench.
//!
//! It is a [`FrameSink`] like the shared memory: a frame that is handed over becomes the fake camera's pattern, a register write
//! triggers it, and it is sent as GigE Vision packets to the application that controls the camera. Aravis does not know how the
//! pixels are made, and the bench does not know the packets.

pub mod network;
mod packing;

use std::ffi::c_void;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::ensure;
use aravis::{FakeCamera, GvFakeCamera, glib::translate::ToGlibPtr};
use flankscope_frames::{Arm, FrameHeader, FrameSink, FrameSlot, Ready, SealedFrame, SendError};
use tempfile::TempDir;

use crate::link::Trouble;
use crate::world::SensorSpec;

/// Address of the camera, on its own loopback interface.
const ADDRESS: &str = "127.0.0.1";
/// Largest packets that the fake camera sends unfragmented.
const PACKET_BYTES: &str = "16000";
/// Speed of its link, bytes per second: gigabit Ethernet. Packets are sent immediately, so frames are spaced accordingly.
const LINK_BYTES_PER_S: f64 = 125e6;
/// Rate at which the fake camera polls its trigger register, 1/s.
const TRIGGER_RATE_HZ: f64 = 1000.0;
/// A trigger that is not obeyed within this time is lost, because the camera is not armed.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time for which an unplugged camera stays disconnected.
const AWAY: Duration = Duration::from_secs(2);
/// Frame period of a camera that runs freely, µs.
const FREE_PERIOD_US: u32 = 20_000;

/// Registers of the fake camera, from its header file.
mod register {
    pub const WIDTH: u32 = 0x100;
    pub const HEIGHT: u32 = 0x104;
    pub const SENSOR_HEIGHT: u32 = 0x118;
    pub const SENSOR_WIDTH: u32 = 0x11c;
    pub const PIXEL_FORMAT: u32 = 0x128;
    pub const FRAME_PERIOD_US: u32 = 0x138;
    pub const TRIGGER_MODE: u32 = 0x300;
    pub const TRIGGER_SOFTWARE: u32 = 0x30c;
    // Unused registers, to which our description assigns a meaning.
    pub const BLACK_LEVEL: u32 = 0x8000;
    pub const GAIN_DB: u32 = 0x8004;
    pub const DEAD: u32 = 0x8010;
}

/// Names and values of pixel formats (EMVA, Pixel Format Values 2.1).
const MONO_12P: (&str, u32) = ("Mono12p", 0x010C_0047);
const MONO_8: (&str, u32) = ("Mono8", 0x0108_0001);
const BAYER_RG_12P: (&str, u32) = ("BayerRG12p", 0x010C_0059);
/// Gain of the fault `Amplified`, dB.
const AMPLIFIED_DB: f32 = 6.0;
/// Size reduction of the fault `Smaller`, px.
const SMALLER_PX: u32 = 64;

/// A frame to be sent by the fake camera.
struct Packed {
    bytes: Vec<u8>,
    exposure_end_us: u64,
}

/// Where the fake camera's thread fetches the frame.
#[derive(Default)]
struct Hand {
    frame: Mutex<Option<Packed>>,
    taken: Condvar,
}

/// The bench's side of the camera.
pub struct GigeCamera {
    // Declared before the data that its thread reads, so it is dropped first.
    fake: Option<GvFakeCamera>,
    hand: Arc<Hand>,
    folder: TempDir,
    size_px: [usize; 2],
    trouble: Option<Trouble>,
    /// Time at which it is plugged in again.
    back: Option<Instant>,
    captures: u32,
    acquiring: bool,
    /// Frames sent since it was armed.
    sent: u32,
    sensor: [f32; 2],
}

/// Memory of one frame.
pub struct Slot {
    pixels: Vec<u16>,
    header: FrameHeader,
}

impl FrameSlot for Slot {
    fn pixels(&mut self) -> &mut [u16] {
        &mut self.pixels
    }

    fn header_mut(&mut self) -> &mut FrameHeader {
        &mut self.header
    }
}

/// Arguments with which a camera process finds this camera.
#[must_use]
pub fn arguments(sensor: &SensorSpec) -> Vec<String> {
    let gain = sensor.gain_e_per_dn().to_string();
    let process = std::process::id().to_string();
    [
        "--network-of",
        &process,
        "--camera",
        ADDRESS,
        "--packet-bytes",
        PACKET_BYTES,
        "--stamp",
        "end",
        "--electrons-per-count",
        &gain,
        "--counts-per-black-level",
        "1",
    ]
    .map(String::from)
    .into()
}

impl GigeCamera {
    /// Switches on a camera of this size.
    ///
    /// # Errors
    /// Another camera uses its port, or its samples do not have twelve bits.
    pub fn open(
        size_px: [usize; 2],
        sensor: &SensorSpec,
        trouble: Option<Trouble>,
    ) -> anyhow::Result<Self> {
        ensure!(
            sensor.bits == 12,
            "samples of {} bits: the GigE camera of the bench has 12",
            sensor.bits
        );
        let mut camera = Self {
            fake: None,
            hand: Arc::default(),
            folder: TempDir::new()?,
            size_px,
            trouble,
            back: None,
            captures: 0,
            acquiring: false,
            sent: 0,
            sensor: [
                sensor.offset_dn as f32,
                match trouble {
                    Some(Trouble::Amplified) => AMPLIFIED_DB,
                    _ => 0.0,
                },
            ],
        };
        camera.plug_in()?;
        Ok(camera)
    }

    fn format(&self) -> (&'static str, u32) {
        match self.trouble {
            Some(Trouble::Colour) => BAYER_RG_12P,
            Some(Trouble::Shallow) => MONO_8,
            _ => MONO_12P,
        }
    }

    /// Writes the camera's description file for Aravis.
    fn description(&self) -> anyhow::Result<PathBuf> {
        let path = self.folder.path().join("camera.xml");
        let (format, value) = self.format();
        let trigger_mode = match self.trouble {
            // Fault: the register accepts the setting without effect.
            Some(Trouble::FreeRuns) => register::DEAD,
            _ => register::TRIGGER_MODE,
        };
        let text = include_str!("camera.xml")
            .replace("{format}", format)
            .replace("{format_value}", &value.to_string())
            .replace("{trigger_mode}", &format!("{trigger_mode:#x}"))
            .replace("{black_level}", &format!("{:#x}", register::BLACK_LEVEL))
            .replace("{gain}", &format!("{:#x}", register::GAIN_DB));
        std::fs::write(&path, text)?;
        Ok(path)
    }

    fn plug_in(&mut self) -> anyhow::Result<()> {
        let description = self.description()?;
        let fake = GvFakeCamera::new_full(Some(ADDRESS), Some("GV-1"), description.to_str());
        ensure!(
            fake.is_running(),
            "the GigE camera of the bench cannot listen on {ADDRESS}, port 3956: another one does, where there are no network \
             namespaces (unshare -rn)"
        );
        if let Some(Trouble::Lost(share)) = self.trouble {
            fake.set_gvsp_lost_ratio(share);
        }
        if let Some(inner) = fake.fake_camera() {
            let less_px = match self.trouble {
                Some(Trouble::Smaller) => SMALLER_PX,
                _ => 0,
            };
            let [width, height] = self.size_px.map(|px| (px as u32).saturating_sub(less_px));
            let [black_level, gain_db] = self.sensor.map(f32::to_bits);
            for (register, value) in [
                (register::SENSOR_WIDTH, width),
                (register::SENSOR_HEIGHT, height),
                (register::WIDTH, width),
                (register::HEIGHT, height),
                (register::PIXEL_FORMAT, self.format().1),
                (register::FRAME_PERIOD_US, FREE_PERIOD_US),
                (register::BLACK_LEVEL, black_level),
                (register::GAIN_DB, gain_db),
            ] {
                inner.write_register(register, value);
            }
            inner.set_trigger_frequency(TRIGGER_RATE_HZ);
            let hand: *const Hand = Arc::as_ptr(&self.hand);
            // SAFETY: the fake calls `show` with this address from its thread, which it ends before it is dropped; `hand` is
            // dropped after it.
            unsafe {
                aravis_sys::arv_fake_camera_set_fill_pattern(
                    inner.to_glib_none().0,
                    Some(show),
                    hand.cast_mut().cast(),
                );
            }
        }
        self.fake = Some(fake);
        Ok(())
    }

    /// The fake camera, while it is plugged in.
    fn inner(&self) -> Option<FakeCamera> {
        self.fake.as_ref()?.fake_camera()
    }

    /// Passes a frame to the fake camera and triggers it; waits until it was taken. An unplugged or unarmed camera takes none.
    fn show(&self, frame: Packed) -> Result<(), &'static str> {
        let armed = |inner: &FakeCamera| inner.acquisition_status() != 0;
        let Some(inner) = self.inner().filter(armed) else {
            return Ok(());
        };
        let length = frame.bytes.len();
        if inner.payload() != length {
            return Err("the camera was set to another size");
        }
        let mut waiting = self
            .hand
            .frame
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        *waiting = Some(frame);
        inner.write_register(register::TRIGGER_SOFTWARE, 1);
        let end = Instant::now() + PATIENCE;
        while waiting.is_some() {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                *waiting = None;
                return Err("the camera does not obey its trigger");
            }
            let woken = self.hand.taken.wait_timeout(waiting, left);
            (waiting, _) = woken.unwrap_or_else(PoisonError::into_inner);
        }
        drop(waiting);
        std::thread::sleep(Duration::from_secs_f64(length as f64 / LINK_BYTES_PER_S));
        Ok(())
    }
}

/// Pattern callback of the fake camera: fills in the waiting frame, or repeats the previous one.
unsafe extern "C" fn show(
    buffer: *mut aravis_sys::ArvBuffer,
    hand: *mut c_void,
    _exposure_us: u32,
    _gain: u32,
    _format: aravis_sys::ArvPixelFormat,
) {
    // SAFETY: `hand` is that of `plug_in`; the buffer is the fake's own, and nobody else writes it now. It holds the payload of the
    // fake's size and format, which cannot be set, and `GigeCamera::show` gives no frame of another one.
    unsafe {
        let hand = &*hand.cast::<Hand>();
        let mut waiting = hand.frame.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(frame) = waiting.take() else { return };
        // The size returned by this call is of received data, which is nothing here.
        let data: *mut u8 = aravis_sys::arv_buffer_get_data(buffer, std::ptr::null_mut()).cast();
        if !data.is_null() {
            data.copy_from_nonoverlapping(frame.bytes.as_ptr(), frame.bytes.len());
        }
        aravis_sys::arv_buffer_set_timestamp(buffer, frame.exposure_end_us * 1000);
        hand.taken.notify_one();
    }
}

impl FrameSink for GigeCamera {
    type Slot = Slot;

    /// Starting the acquisition arms the camera, for an unknown number of frames.
    fn armed(&mut self) -> Option<Arm> {
        if self.back.is_some_and(|back| Instant::now() > back) {
            self.back = None;
            if let Err(error) = self.plug_in() {
                eprintln!("bench: {error}");
            }
        }
        let acquiring = self
            .inner()
            .is_some_and(|inner| inner.acquisition_status() != 0);
        let begins = acquiring && !self.acquiring;
        self.acquiring = acquiring;
        begins.then(|| {
            self.captures += 1;
            self.sent = 0;
            Arm {
                session: self.captures,
                ..Arm::default()
            }
        })
    }

    /// Nothing to do: the camera's properties are in its registers.
    fn ready(&mut self, _: Ready) -> Result<(), SendError> {
        Ok(())
    }

    fn loan(&mut self, pixels: usize, _: u32) -> Result<Slot, SendError> {
        Ok(Slot {
            pixels: vec![0; pixels],
            header: FrameHeader::default(),
        })
    }

    fn send(&mut self, frame: SealedFrame<Slot>) -> Result<(), SendError> {
        let Slot { pixels, header } = frame.into_slot();
        let now = self.sent;
        self.sent += 1;
        if self.trouble == Some(Trouble::Unplugged(now)) {
            self.trouble = None;
            eprintln!("bench: the camera is unplugged");
            self.fake = None;
            self.back = Some(Instant::now() + AWAY);
        }
        let packed = Packed {
            bytes: packing::mono_12p(&pixels),
            exposure_end_us: header.exposure_end_us,
        };
        self.show(packed).map_err(|reason| SendError::Undelivered {
            counter: header.counter,
            reason: reason.into(),
        })
    }
}
