//! A whole camera process: `camera ROOT`, then one exposure per line on standard input, its length in microseconds.
//!
//! A real camera waits for its trigger where this one waits for a line, and reads its sensor out into the slot where this
//! one draws a gradient. The rest is the same.

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

use flankscope_frames::{
    FrameHeader, FrameSender, FrameSink, FrameSlot, Labels, Overflow, SharedRoot, monotonic_ns,
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
    let (switched_on, mut labels) = (Instant::now(), Labels::default());
    for (counter, line) in (0..).zip(std::io::stdin().lines()) {
        let exposure = Duration::from_micros(line?.trim().parse()?);
        let start = switched_on.elapsed();
        std::thread::sleep(exposure);
        let exposure_end_monotonic_ns = monotonic_ns();
        if let Some(arm) = sink.armed() {
            labels.arm(arm);
        }
        let (session, label) = labels.take();
        let header = FrameHeader {
            session,
            counter,
            label,
            width_px: WIDTH_PX,
            height_px: HEIGHT_PX,
            stride_px: WIDTH_PX,
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
    }
    Ok(())
}
