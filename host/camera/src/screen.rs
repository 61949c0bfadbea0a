//! A host that only looks: `--dry-run` shows each frame in the terminal, with what its exposure is to be judged by.

use flankscope_frames::{Arm, FrameHeader, FrameSink, FrameSlot, Ready, SealedFrame, SendError};

/// Characters of the picture, and of the histogram below it.
const COLUMNS: usize = 64;
const ROWS: usize = 20;
const SHADES: &[u8] = b" .:-=+*#%@";
/// Part of full scale from which a pixel counts as saturated, as the decoder has it.
const SATURATED: f64 = 0.95;

/// Prints what comes. It arms the camera once, for as many frames as there are numbers.
pub struct Screen {
    bits: u32,
    armed: bool,
}

/// A frame's memory.
pub struct Page {
    pixels: Vec<u16>,
    header: FrameHeader,
}

impl FrameSlot for Page {
    fn pixels(&mut self) -> &mut [u16] {
        &mut self.pixels
    }

    fn header_mut(&mut self) -> &mut FrameHeader {
        &mut self.header
    }
}

impl Screen {
    /// Nothing shown yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            bits: 16,
            armed: false,
        }
    }
}

impl Default for Screen {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameSink for Screen {
    type Slot = Page;

    fn armed(&mut self) -> Option<Arm> {
        let first = !std::mem::replace(&mut self.armed, true);
        first.then_some(Arm {
            session: 1,
            first_view: 0,
            views: u16::MAX,
            exposures: 1,
            patterns: 0,
        })
    }

    fn ready(&mut self, ready: Ready) -> Result<(), SendError> {
        self.bits = ready.bits;
        if ready.session == 0 {
            // Back after it was gone: to be armed anew.
            self.armed = false;
            let known = |value: f64, unit: &str| match value.is_finite() {
                true => format!("{value} {unit}"),
                false => "unknown".to_owned(),
            };
            println!(
                "{}, {}: {} x {} px, {} bits, gain {}, offset {}",
                ready.model(),
                ready.link(),
                ready.width_px,
                ready.height_px,
                ready.bits,
                known(ready.gain_e_per_dn, "electrons per count"),
                known(ready.offset_dn, "counts"),
            );
        } else {
            println!("armed: waiting for triggers");
        }
        Ok(())
    }

    fn loan(&mut self, pixels: usize, _counter: u32) -> Result<Page, SendError> {
        Ok(Page {
            pixels: vec![0; pixels],
            header: FrameHeader::default(),
        })
    }

    fn send(&mut self, frame: SealedFrame<Page>) -> Result<(), SendError> {
        let Page { pixels, header } = frame.into_slot();
        print!("{}", shown(&pixels, &header, self.bits));
        Ok(())
    }
}

/// A frame in words: its figures, a picture, a histogram.
fn shown(pixels: &[u16], header: &FrameHeader, bits: u32) -> String {
    let full_dn = f64::from((1u32 << bits.clamp(1, 16)) - 1);
    let saturated = pixels
        .iter()
        .filter(|&&dn| f64::from(dn) > SATURATED * full_dn);
    let share = 100.0 * saturated.count() as f64 / pixels.len().max(1) as f64;
    let mean = pixels.iter().map(|&dn| f64::from(dn)).sum::<f64>() / pixels.len().max(1) as f64;
    let [darkest, brightest] =
        [pixels.iter().min(), pixels.iter().max()].map(|dn| dn.copied().unwrap_or_default());
    let mut text = format!(
        "frame {}: {darkest} to {brightest} counts of {full_dn}, mean {mean:.1}, {share:.2} % saturated",
        header.counter
    );
    if header.measured & FrameHeader::EXPOSURE_MEASURED != 0 {
        let exposed_us = header
            .exposure_end_us
            .saturating_sub(header.exposure_start_us);
        text += &format!(", exposed {exposed_us} us");
    }
    text.push('\n');
    let [width, height] = [header.width_px, header.height_px].map(|px| px as usize);
    let shade = |dn: f64| {
        let place = dn / full_dn * (SHADES.len() - 1) as f64;
        char::from(SHADES[(place.round() as usize).min(SHADES.len() - 1)])
    };
    let rows = ROWS.min(height);
    let columns = COLUMNS.min(width);
    for row in 0..rows {
        for column in 0..columns {
            let (at_row, at_column) = (row * height / rows, column * width / columns);
            let here = pixels.get(at_row * width + at_column).copied();
            text.push(shade(f64::from(here.unwrap_or_default())));
        }
        text.push('\n');
    }
    let mut bins = [0usize; COLUMNS];
    for &dn in pixels {
        let bin = (f64::from(dn) / (full_dn + 1.0) * COLUMNS as f64) as usize;
        bins[bin.min(COLUMNS - 1)] += 1;
    }
    // By order of magnitude: a few saturated pixels among a million must show.
    let most = (bins.iter().max().copied().unwrap_or(0).max(1) as f64).ln_1p();
    for bin in bins {
        text.push(shade((bin as f64).ln_1p() / most * full_dn));
    }
    text += "  histogram, logarithmic, dark to full scale\n";
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_told_by_its_counts() {
        let header = FrameHeader {
            counter: 7,
            width_px: 64,
            height_px: 20,
            ..FrameHeader::default()
        };
        // Left half dark, right half full but for one pixel in four.
        let pixel = |k: usize| match (k % 64 < 32, k % 4) {
            (true, _) => 0,
            (false, 0) => 2048,
            (false, _) => 4095,
        };
        let pixels: Vec<u16> = (0..64 * 20).map(pixel).collect();
        let text = shown(&pixels, &header, 12);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines[0],
            "frame 7: 0 to 4095 counts of 4095, mean 1791.6, 37.50 % saturated"
        );
        assert_eq!(lines.len(), 1 + 20 + 1);
        assert!(
            lines[1].starts_with(&" ".repeat(32)) && lines[1].ends_with("+@@@"),
            "{text}"
        );
        let histogram = lines[21].as_bytes();
        assert!(histogram[0] != b' ' && histogram[63] != b' ' && histogram[32] != b' ');
        assert_eq!(histogram[10], b' ');
    }
}
