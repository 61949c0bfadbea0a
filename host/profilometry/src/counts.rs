//! Range of the camera's counts in the images of a view.
//!
//! A camera of 12 bits writes files of 16. Its saturated pixels stand at 4095 or, with counts shifted to the upper bits, at 65 520.
//! The files state the range (largest value of a PGM, `sBIT` of a PNG), or the counts show it: left-aligned counts leave gaps, and
//! an over-exposed view has many pixels at its largest count.

use rayon::prelude::*;
use serde::Serialize;

use crate::frame::FrameKind;
use crate::io::images::GreyImage;

/// Evidence for the end of the counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CountSource {
    /// The files state it.
    File,
    /// All bits of the files are used, or the caller states their number, as `[sensor]` does.
    Bits,
    /// Counts are left-aligned: their lower bits are zero, or repeat the upper ones.
    Gaps,
    /// Many pixels stand at one largest count.
    Clipping,
    /// Number of bits, of 8, 10, 12, 14 and 16, that the largest count needs.
    LargestCount,
}

/// Range of the counts, after left-aligned ones were shifted down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct CountRange {
    /// Count at which the camera ends.
    pub full_scale_dn: u16,
    /// Bits by which the counts of the files were shifted down.
    pub shift_bits: u32,
    /// Evidence for the end of the counts.
    pub source: CountSource,
    /// Largest count of the view.
    pub largest_dn: u16,
    /// Pixels of all fringe frames at the largest count, if they are so many that the counts are clipped there; 0 otherwise.
    pub clipped_pixels: u64,
}

/// Least pixels of all fringe frames at a count at which they are clipped.
const LEAST_CLIPPED: u64 = 100;
/// Least ratio of pixels at a count at which they are clipped to those at any count just below. At the crest of a sinusoid without
/// noise the ratio is 1.4, with few levels up to 4.
const LEAST_RATIO: u64 = 8;
/// Share of the largest count over which counts are just below it.
const BELOW_SHARE: f64 = 1.0 / 64.0;
/// Least number of counts just below. Half as many must occur.
const LEAST_BELOW: usize = 16;
/// Least different counts by which left-aligned ones are told.
const LEAST_COUNTS: usize = 32;
/// Sizes of cameras' counts, bits.
const USUAL_BITS: [u32; 5] = [8, 10, 12, 14, 16];
/// Share of the end of the counts above which a pixel counts as saturated.
const SATURATED_SHARE: f64 = 0.95;

impl CountRange {
    /// Range of counts of so many bits, 1 to 16, which fill it.
    #[must_use]
    pub fn from_bits(bits: u32) -> Self {
        Self {
            full_scale_dn: largest_of_bits(bits.clamp(1, 16)),
            shift_bits: 0,
            source: CountSource::Bits,
            largest_dn: 0,
            clipped_pixels: 0,
        }
    }

    /// Finds the range of the counts of a view, and shifts left-aligned ones down. `sensor_bits` are those of a described sensor, which
    /// come before everything else; counts that fit them are not shifted.
    pub fn take(frames: &mut [(FrameKind, GreyImage)], sensor_bits: Option<u32>) -> Self {
        let bits = frames.first().map_or(8, |(_, image)| image.bits);
        let is_fringe = |kind: FrameKind| matches!(kind, FrameKind::Fringe { .. });
        let all = histogram(frames, |_| true);
        let stated = frames
            .iter()
            .filter_map(|(_, image)| image.stated_largest_dn);
        let stated = stated.max();
        let shift_bits = match stated {
            _ if bits != 16
                || sensor_bits.is_some_and(|bits| largest_of_bits(bits) >= largest(&all)) =>
            {
                0
            }
            // Significant bits of a PNG are the upper ones, if counts need more.
            Some(stated) if largest(&all) > stated => stated.leading_zeros(),
            Some(_) => 0,
            None => left_shift(&all),
        };
        if shift_bits > 0 {
            for (_, image) in frames.iter_mut() {
                image
                    .pixels
                    .par_iter_mut()
                    .for_each(|count| *count >>= shift_bits);
            }
        }
        let fringes = histogram(frames, is_fringe);
        let largest_dn = largest(&all) >> shift_bits;
        let clipped_pixels = clipped(&fringes);
        let (full_scale_dn, source) = match (sensor_bits, stated) {
            (Some(bits), _) => (largest_of_bits(bits), CountSource::Bits),
            (None, Some(stated)) => (stated, CountSource::File),
            _ if bits != 16 => (largest_of_bits(bits), CountSource::Bits),
            _ if shift_bits > 0 => (u16::MAX >> shift_bits, CountSource::Gaps),
            _ => {
                let needed = |bits: &&u32| largest_of_bits(**bits) >= largest_dn;
                let bits = USUAL_BITS.iter().find(needed).unwrap_or(&16);
                (largest_of_bits(*bits), CountSource::LargestCount)
            }
        };
        let ends_below = f64::from(largest(&fringes)) < SATURATED_SHARE * f64::from(full_scale_dn);
        let is_open = source == CountSource::LargestCount;
        let (full_scale_dn, source) = match clipped_pixels > 0 && (ends_below || is_open) {
            true => (largest(&fringes), CountSource::Clipping),
            false => (full_scale_dn, source),
        };
        Self {
            full_scale_dn,
            shift_bits,
            source,
            largest_dn,
            clipped_pixels,
        }
    }
}

impl std::fmt::Display for CountRange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            full_scale_dn,
            shift_bits,
            largest_dn,
            clipped_pixels,
            ..
        } = self;
        if *shift_bits > 0 {
            write!(
                f,
                "counts are left-aligned and were shifted by {shift_bits} bits; "
            )?;
        }
        write!(f, "counts end at {full_scale_dn}")?;
        match self.source {
            CountSource::File => write!(f, ", as the images state"),
            CountSource::Bits | CountSource::Gaps => Ok(()),
            CountSource::Clipping => write!(
                f,
                ": {clipped_pixels} pixels of the fringe frames stand at that, their largest count"
            ),
            CountSource::LargestCount => write!(f, ": the largest is {largest_dn}"),
        }
    }
}

fn largest_of_bits(bits: u32) -> u16 {
    ((1u32 << bits) - 1) as u16
}

/// Pixels at every count, of the frames of some kinds.
fn histogram(
    frames: &[(FrameKind, GreyImage)],
    is_counted: impl Fn(FrameKind) -> bool,
) -> Vec<u64> {
    let mut pixels = vec![0_u64; 1 << 16];
    for (_, image) in frames.iter().filter(|(kind, _)| is_counted(*kind)) {
        for &count in &image.pixels {
            pixels[usize::from(count)] += 1;
        }
    }
    pixels
}

fn largest(pixels: &[u64]) -> u16 {
    pixels.iter().rposition(|&n| n > 0).unwrap_or(0) as u16
}

/// Bits by which counts are shifted to the upper end of 16; 0 if they are not. The lower bits are zero or repeat the upper ones.
fn left_shift(pixels: &[u64]) -> u32 {
    let counts = || (0..=u16::MAX).filter(|&count| pixels[usize::from(count)] > 0);
    if counts().count() < LEAST_COUNTS {
        return 0;
    }
    let is_shifted = |bits: u32| {
        let lower = u16::MAX >> bits;
        let has_zeros = |count: u16| count & lower == 0;
        // One repetition of 8 bits and more fills 16.
        let repeats = |count: u16| count & lower == (count >> (16 - bits)) >> (2 * bits - 16);
        counts().all(has_zeros) || counts().all(repeats)
    };
    (8..16)
        .find(|&bits| is_shifted(bits))
        .map_or(0, |bits| 16 - bits)
}

/// Pixels at the largest count, if counts are clipped there; 0 otherwise.
fn clipped(pixels: &[u64]) -> u64 {
    let top = usize::from(largest(pixels));
    let width = LEAST_BELOW.max((BELOW_SHARE * top as f64) as usize);
    let below = &pixels[top.saturating_sub(width)..top];
    let occurring = below.iter().filter(|&&n| n > 0).count();
    let most_below = below.iter().copied().max().unwrap_or(0);
    // Counts of a rendering with few levels tell nothing.
    let is_dense = 2 * occurring >= LEAST_BELOW;
    let is_clipped = is_dense && pixels[top] >= LEAST_CLIPPED.max(LEAST_RATIO * most_below);
    if is_clipped { pixels[top] } else { 0 }
}

#[cfg(test)]
mod tests {
    use flankscope_test_requisites::Random;

    use super::*;

    const SIZE: [usize; 2] = [200, 150];

    /// Eight steps of fringes on grey tiles, a fifth of the picture lit up to `peak_dn`, the rest below a third of that. Counts end at
    /// `end_dn`; without noise where `noise_dn` is 0.
    fn frames(peak_dn: f64, end_dn: f64, noise_dn: f64) -> Vec<(FrameKind, GreyImage)> {
        let mut random = Random(11);
        let frame = |step: u32| {
            let pixels = (0..SIZE[0] * SIZE[1]).map(|index| {
                let (x, y) = ((index % SIZE[0]) as f64, (index / SIZE[0]) as f64);
                let phase = 0.13 * x + 0.011 * y + std::f64::consts::TAU * f64::from(step) / 8.0;
                let albedo = match x < 40.0 {
                    true => 1.0,
                    false => 0.25 + 0.05 * (y / 40.0).floor() / 3.0,
                };
                let light = peak_dn * albedo * (0.52 + 0.48 * phase.cos());
                (light + noise_dn * random.normal())
                    .round()
                    .clamp(0.0, end_dn) as u16
            });
            let image = GreyImage {
                pixels: pixels.collect(),
                width: SIZE[0],
                height: SIZE[1],
                bits: 16,
                stated_largest_dn: None,
            };
            (
                FrameKind::Fringe {
                    exposure: 0,
                    set: 0,
                    step,
                },
                image,
            )
        };
        let mut frame = frame;
        (0..8).map(&mut frame).collect()
    }

    fn found(frames: &[(FrameKind, GreyImage)]) -> CountRange {
        CountRange::take(&mut frames.to_vec(), None)
    }

    fn mapped(
        frames: &[(FrameKind, GreyImage)],
        map: impl Fn(u16) -> u16,
    ) -> Vec<(FrameKind, GreyImage)> {
        let mut frames = frames.to_vec();
        for (_, image) in &mut frames {
            image
                .pixels
                .iter_mut()
                .for_each(|count| *count = map(*count));
        }
        frames
    }

    #[test]
    fn clipped_counts_end_where_they_are_clipped() {
        for end_dn in [255.0, 1023.0, 4095.0, 3700.0, 16_383.0, 65_535.0] {
            let range = found(&frames(1.5 * end_dn, end_dn, 0.005 * end_dn));
            assert_eq!(
                (range.full_scale_dn, range.source, range.shift_bits),
                (end_dn as u16, CountSource::Clipping, 0)
            );
            assert!(range.clipped_pixels > 1000, "{range:?}");
        }
        // In files of 8 bits, too.
        let mut eight = frames(350.0, 231.0, 1.2);
        eight.iter_mut().for_each(|(_, image)| image.bits = 8);
        let range = found(&eight);
        assert_eq!(
            (range.full_scale_dn, range.source),
            (231, CountSource::Clipping)
        );
    }

    #[test]
    fn counts_that_are_not_clipped_end_with_the_bits_that_they_need() {
        for (peak_dn, bits) in [
            (200.0, 8),
            (900.0, 10),
            (3900.0, 12),
            (15_000.0, 14),
            (60_000.0, 16),
        ] {
            for noise_dn in [0.0, 0.003 * peak_dn] {
                let range = found(&frames(peak_dn, 65_535.0, noise_dn));
                assert_eq!(range.clipped_pixels, 0, "{range:?}");
                assert_eq!(
                    (range.full_scale_dn, range.source),
                    (largest_of_bits(bits), CountSource::LargestCount)
                );
            }
        }
        let mut eight = frames(120.0, 255.0, 1.0);
        eight.iter_mut().for_each(|(_, image)| image.bits = 8);
        assert_eq!(
            found(&eight),
            CountRange {
                largest_dn: found(&eight).largest_dn,
                ..CountRange::from_bits(8)
            }
        );
    }

    #[test]
    fn left_aligned_counts_are_shifted_down() {
        for bits in [8, 10, 12, 14] {
            let end_dn = f64::from(largest_of_bits(bits));
            for peak_dn in [0.4 * end_dn, 1.4 * end_dn] {
                let plain = frames(peak_dn, end_dn, 0.004 * end_dn);
                let shift = 16 - bits;
                for repeated in [false, true] {
                    let mut frames = mapped(&plain, |count| {
                        let lower = if repeated {
                            count >> (2 * bits - 16)
                        } else {
                            0
                        };
                        count << shift | lower
                    });
                    let range = CountRange::take(&mut frames, None);
                    assert_eq!(
                        (range.full_scale_dn, range.shift_bits, range.source),
                        (end_dn as u16, shift, CountSource::Gaps)
                    );
                    assert_eq!(range.clipped_pixels > 0, peak_dn > end_dn);
                    assert_eq!(frames, plain);
                }
            }
        }
    }

    #[test]
    fn a_described_sensor_comes_before_the_counts() {
        let plain = frames(3000.0, 4095.0, 10.0);
        let aligned = mapped(&plain, |count| count << 4);
        let take = |frames: &[(FrameKind, GreyImage)], bits| {
            let mut frames = frames.to_vec();
            let range = CountRange::take(&mut frames, Some(bits));
            (range.full_scale_dn, range.shift_bits, frames == plain)
        };
        assert_eq!(take(&plain, 14), (16_383, 0, true));
        assert_eq!(take(&aligned, 12), (4095, 4, true));
        // Gain and offset are those of the counts in the files.
        assert_eq!(take(&aligned, 16), (65_535, 0, false));
    }

    #[test]
    fn what_the_files_state_comes_first() {
        let state = |mut frames: Vec<(FrameKind, GreyImage)>| {
            for (_, image) in &mut frames {
                image.stated_largest_dn = Some(4095);
            }
            frames
        };
        let dim = frames(900.0, 4095.0, 3.0);
        let expected = (4095, 0, CountSource::File);
        let summary = |range: CountRange| (range.full_scale_dn, range.shift_bits, range.source);
        assert_eq!(summary(found(&state(dim.clone()))), expected);
        let shifted = mapped(&dim, |count| count << 4);
        assert_eq!(
            summary(found(&state(shifted))),
            (4095, 4, CountSource::File)
        );
        // A camera that is clipped below.
        let clipped = frames(6000.0, 3000.0, 10.0);
        assert_eq!(
            summary(found(&state(clipped))),
            (3000, 0, CountSource::Clipping)
        );
    }
}
