//! Whether recorded frames show what their plan says, in its order.
//!
//! Frames taken in another order decode to points all the same, in other places. What gives them away: the steps of a set follow one
//! sinusoid in their own order only, a set of more periods has finer fringes in the picture, a dark frame is darker than any fringe,
//! and a Gray code's first bit changes less often across the picture than its last.

use std::f64::consts::TAU;

use crate::frame::{FrameKind, FrameView};
use crate::pattern::PatternSet;

/// What does not fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameOrderError {
    /// The steps of a set are not one sinusoid.
    #[error(
        "the {steps} frames of {periods} periods are not one fringe moved step by step: {percent:.0} % of their change follows it, \
         at least {least_percent:.0} % are needed. Were they taken in another order than the plan's, or of another set?"
    )]
    Steps {
        /// Of the set.
        periods: f64,
        /// Its frames.
        steps: u32,
        /// Share of the squared change between frames.
        percent: f64,
        /// Least share.
        least_percent: f64,
    },
    /// Sets were exchanged, or their frames mixed.
    #[error(
        "the frames of {fine} periods show fringes only {ratio:.1} times as fine as those of {coarse} periods, where {expected:.1} times \
         are expected. Were the sets taken in another order than the plan's?"
    )]
    Sets {
        /// Periods of the finer set.
        fine: f64,
        /// Of the coarser one.
        coarse: f64,
        /// How much finer its fringes are in the picture.
        ratio: f64,
        /// By the plan.
        expected: f64,
    },
    /// The dark frame shows fringes.
    #[error(
        "the dark frame is as bright as the fringes ({dark_dn:.0} counts, their darkest are {darkest_dn:.0}). Was it taken elsewhere in \
         the order, or with the projector on?"
    )]
    Dark {
        /// Its mean where there are fringes.
        dark_dn: f64,
        /// Mean of the fringes' minima.
        darkest_dn: f64,
    },
    /// The code's first bit is its finest.
    #[error(
        "the code's first frame changes {first} times across the picture and its last {last} times: the most significant bit, with the \
         widest stripes, comes first. Were they taken in another order than the plan's?"
    )]
    Code {
        /// Changes of the first bit.
        first: usize,
        /// Changes of the last bit.
        last: usize,
    },
}

/// Least share of the frames' squared change that follows the fringe. Bent responses leave more (a gamma of 2.2: 0.93, black and
/// white stripes in twelve steps: 0.82), twelve steps in the order of unpadded numbers 0.78, two neighbours of four exchanged 0.5.
const LEAST_SHARE: f64 = 0.8;
/// Least standard deviation over the steps for a pixel to be asked, counts of 255.
const LEAST_CHANGE: f64 = 4.0;
/// Fewer pixels than this are too few to say anything.
const LEAST_PIXELS: usize = 200;
/// Every so many pixels in both directions are asked.
const EVERY_PX: usize = 3;
/// Distance over which fringes are compared, px: below half a fringe of any set worth decoding.
const APART_PX: usize = 2;
/// Sets nearer to each other than this are told apart by their orders, not by their width.
const LEAST_RATIO: f64 = 1.5;

/// Sums of a set over its steps, pixel by pixel.
struct Phasors {
    width: usize,
    /// Amplitude as a phasor, counts; none where the frames change too little.
    of_pixel: Vec<Option<[f64; 2]>>,
    /// Mean of the steps.
    mean_dn: Vec<f64>,
    /// Squared change that follows the fringe, and all of it.
    followed: f64,
    all: f64,
}

impl Phasors {
    fn new(frames: &[FrameView<'_>], saturated_dn: u16, least_dn: f64) -> Self {
        let (width, height) = (frames[0].width, frames[0].height);
        let count = frames.len() as f64;
        let turns: Vec<[f64; 2]> = (0..frames.len())
            .map(|step| (TAU * step as f64 / count).sin_cos())
            .map(|(sin, cos)| [cos, -sin])
            .collect();
        let mut sums = Self {
            width,
            of_pixel: vec![None; width * height],
            mean_dn: vec![0.0; width * height],
            followed: 0.0,
            all: 0.0,
        };
        for index in 0..width * height {
            let mut values = frames.iter().map(|frame| frame.pixels[index]);
            if values.clone().any(|value| value >= saturated_dn) {
                continue;
            }
            let mean = values.clone().map(f64::from).sum::<f64>() / count;
            let square = |value: u16| (f64::from(value) - mean).powi(2);
            let change = values.clone().map(square).sum::<f64>();
            sums.mean_dn[index] = mean;
            if change < count * least_dn * least_dn {
                continue;
            }
            let mut part = [0.0; 2];
            for turn in &turns {
                let value = f64::from(values.next().unwrap_or_default());
                part = [part[0] + value * turn[0], part[1] + value * turn[1]];
            }
            let part = part.map(|part| 2.0 * part / count);
            sums.followed += 0.5 * count * (part[0] * part[0] + part[1] * part[1]);
            sums.all += change;
            sums.of_pixel[index] = Some(part);
        }
        sums
    }

    fn pixels(&self) -> usize {
        self.of_pixel.iter().flatten().count()
    }

    /// Phase per pixel across and down the picture, rad, each pair of pixels by its light.
    fn fineness_rad(&self) -> f64 {
        let along = |step: usize, fits: &dyn Fn(usize) -> bool| {
            let (mut re, mut im) = (0.0, 0.0);
            for index in 0..self.of_pixel.len().saturating_sub(step) {
                if let (Some(a), Some(b), true) = (
                    self.of_pixel[index],
                    self.of_pixel[index + step],
                    fits(index),
                ) {
                    re += a[0] * b[0] + a[1] * b[1];
                    im += a[0] * b[1] - a[1] * b[0];
                }
            }
            im.atan2(re)
        };
        let in_row = |index: usize| index % self.width + APART_PX < self.width;
        let across = along(APART_PX, &in_row);
        let down = along(APART_PX * self.width, &|_| true);
        across.hypot(down)
    }
}

/// Checks the frames of a view, in the order of their plan. They are of one size, without padding between rows.
///
/// # Errors
/// [`FrameOrderError`] with what contradicts the plan. Frames without fringes contradict nothing.
pub fn check(
    patterns: &PatternSet,
    frames: &[(FrameKind, FrameView<'_>)],
) -> Result<(), FrameOrderError> {
    let Some((_, first)) = frames.first() else {
        return Ok(());
    };
    // Images of 16 bits may hold fewer: what their brightest pixel needs.
    let brightest = frames.iter().flat_map(|(_, image)| image.pixels).max();
    let bits = 16 - brightest.copied().unwrap_or(0).leading_zeros().min(8);
    let full_scale_dn = f64::from((1u32 << bits) - 1);
    let saturated_dn = (0.95 * full_scale_dn) as u16;
    let least_dn = LEAST_CHANGE * full_scale_dn / 255.0;
    let exposures = frames.iter().filter_map(|(kind, _)| kind.exposure()).max();
    for exposure in 0..=exposures.unwrap_or(0) {
        let of_set = |wanted: usize| -> Vec<FrameView<'_>> {
            let is_of_set = |kind: &FrameKind| matches!(*kind, FrameKind::Fringe { exposure: e, set, .. } if e == exposure && set == wanted);
            let of_set = frames.iter().filter(|(kind, _)| is_of_set(kind));
            of_set.map(|(_, image)| *image).collect()
        };
        let sets = (0..patterns.sets.len()).map(of_set);
        let sets: Vec<Phasors> = sets
            .filter(|images| !images.is_empty())
            .map(|images| Phasors::new(&images, saturated_dn, least_dn))
            .collect();
        let enough = |set: &Phasors| set.pixels() >= LEAST_PIXELS.min(first.pixels.len() / 8);
        if sets.len() != patterns.sets.len() || !sets.iter().all(enough) {
            continue;
        }
        for (set, sums) in patterns.sets.iter().zip(&sets) {
            let share = sums.followed / sums.all;
            if share < LEAST_SHARE {
                return Err(FrameOrderError::Steps {
                    periods: set.periods,
                    steps: set.steps,
                    percent: 100.0 * share,
                    least_percent: 100.0 * LEAST_SHARE,
                });
            }
        }
        widths(patterns, &sets)?;
        let Some(finest) = sets.last() else { continue };
        dark(finest, frames)?;
        code(finest, frames, exposure)?;
    }
    Ok(())
}

/// More periods, finer fringes.
fn widths(patterns: &PatternSet, sets: &[Phasors]) -> Result<(), FrameOrderError> {
    let pairs = patterns.sets.windows(2).zip(sets.windows(2));
    for (periods, sums) in pairs {
        let expected = periods[1].periods / periods[0].periods;
        let ratio = sums[1].fineness_rad() / sums[0].fineness_rad();
        if expected >= LEAST_RATIO && ratio < expected.sqrt() {
            return Err(FrameOrderError::Sets {
                fine: periods[1].periods,
                coarse: periods[0].periods,
                ratio,
                expected,
            });
        }
    }
    Ok(())
}

fn dark(finest: &Phasors, frames: &[(FrameKind, FrameView<'_>)]) -> Result<(), FrameOrderError> {
    let Some((_, dark)) = frames.iter().find(|(kind, _)| *kind == FrameKind::Dark) else {
        return Ok(());
    };
    let (mut dark_dn, mut darkest_dn, mut swing_dn, mut pixels) = (0.0, 0.0, 0.0, 0.0);
    for (index, part) in finest.of_pixel.iter().enumerate() {
        if let Some([re, im]) = part {
            let amplitude_dn = re.hypot(*im);
            dark_dn += f64::from(dark.pixels[index]);
            darkest_dn += finest.mean_dn[index] - amplitude_dn;
            swing_dn += amplitude_dn;
            pixels += 1.0;
        }
    }
    // A fringe's own light averages to its mean, an amplitude above its minimum.
    if dark_dn > darkest_dn + 0.5 * swing_dn {
        return Err(FrameOrderError::Dark {
            dark_dn: dark_dn / pixels,
            darkest_dn: darkest_dn / pixels,
        });
    }
    Ok(())
}

fn code(
    finest: &Phasors,
    frames: &[(FrameKind, FrameView<'_>)],
    exposure: usize,
) -> Result<(), FrameOrderError> {
    let bits: Vec<FrameView<'_>> = frames
        .iter()
        .filter(|(kind, _)| {
            matches!(*kind, FrameKind::Code { exposure: e, complement: false, .. } if e == exposure)
        })
        .map(|(_, image)| *image)
        .collect();
    let changes = |image: FrameView<'_>| {
        let lit = |index: usize| {
            let [re, im] = finest.of_pixel[index]?;
            let off_dn = f64::from(image.pixels[index]) - finest.mean_dn[index];
            // Nearer to the mean lies a blurred edge.
            (off_dn.abs() >= 0.5 * re.hypot(im)).then_some(off_dn > 0.0)
        };
        let changed = |index: usize, step: usize| {
            lit(index)
                .zip(lit(index + step))
                .is_some_and(|(a, b)| a != b)
        };
        let (width, height) = (finest.width, finest.of_pixel.len() / finest.width);
        let apart = 2 * APART_PX;
        let rows = (0..height.saturating_sub(apart)).step_by(EVERY_PX);
        let places = rows.flat_map(|row| {
            let columns = (0..width.saturating_sub(apart)).step_by(EVERY_PX);
            columns.map(move |column| row * width + column)
        });
        places
            .filter(|&at| changed(at, apart) || changed(at, apart * width))
            .count()
    };
    if let [first, .., last] = bits[..] {
        let (first, last) = (changes(first), changes(last));
        if first > last {
            return Err(FrameOrderError::Code { first, last });
        }
    }
    Ok(())
}
