//! A whole camera process: `camera ROOT`, then one exposure per line on standard input, its length in microseconds.
//!
//! A real camera waits for its trigger where this one waits for a line, and reads its sensor out into the slot where this
//! one draws a gradient. The rest is the same.

use std::error::Error;
use std::path::Path;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use flankscope_frames::{
    FrameHeader, FrameSender, FrameSink, FrameSlot, Labels, Overflow, Ready, SharedRoot,
    monotonic_ns,
};

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 400;

fn main() -> Result<(), Box<dyn Error>> {
    let root = std::env::args_os().nth(1).ok_or("usage: camera ROOT")?;
    camera(root.as_ref())
}

/// Sends a frame per line until standard input ends.
pub fn camera(root: &Path) -> Result<(), Box<dyn Error>> {
    let mut sink = FrameSender::open(&SharedRoot::of_owner(root)?, Overflow::Drop)?;
    let (trigger, triggers) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lines().map_while(Result::ok) {
            let _ = trigger.send(line);
        }
    });
    let (switched_on, mut labels, mut counter) = (Instant::now(), Labels::default(), 0);
    let word = Ready {
        width_px: WIDTH_PX,
        height_px: HEIGHT_PX,
        bits: 12,
        model: Ready::text("example"),
        ..Ready::default()
    };
    sink.ready(word)?;
    loop {
        // Between exposures: what was exposed before is handed over, so that the camera is drained.
        if let Some(arm) = sink.armed() {
            labels.arm(arm);
            sink.ready(Ready {
                session: arm.session,
                counter,
                ..word
            })?;
        }
        let line = match triggers.recv_timeout(Duration::from_millis(1)) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        };
        let exposure = Duration::from_micros(line.trim().parse()?);
        let start = switched_on.elapsed();
        std::thread::sleep(exposure);
        let exposure_end_monotonic_ns = monotonic_ns();
        let (session, label) = labels.take();
        let header = FrameHeader {
            session,
            counter,
            label,
            width_px: WIDTH_PX,
            height_px: HEIGHT_PX,
            stride_px: WIDTH_PX,
            measured: FrameHeader::END_MEASURED,
            exposure_start_us: start.as_micros() as u64,
            exposure_end_us: (start + exposure).as_micros() as u64,
            exposure_end_monotonic_ns,
            ..FrameHeader::default()
        };
        let sent = sink.loan((WIDTH_PX * HEIGHT_PX) as usize, counter);
        let sent = sent.and_then(|mut slot| {
            for (i, pixel) in slot.pixels().iter_mut().enumerate() {
                *pixel = (i % 4096) as u16;
            }
            sink.send(slot.seal(header))
        });
        if let Err(lost) = sent {
            eprintln!("camera: {lost}"); // its number is missing: the host sees it
        }
        counter += 1;
    }
}
