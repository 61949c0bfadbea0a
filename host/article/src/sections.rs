//! Counts across the fringes (figures 11 to 13): every step of the finest frequency, and how much they spread.

use std::path::PathBuf;

use flankscope_profilometry::FrameKind;
use flankscope_profilometry::io::images::{GreyImage, ImageError, load_grey};
use flankscope_profilometry::pattern::Axis;
use flankscope_profilometry::plan::Plan;
use serde::Serialize;

/// Smoothing of the spread, pixels: that of the mask, two fibre cores.
const SMOOTHING_PX: f64 = 7.0;
/// The Gaussian ends here.
const REACH_PX: usize = 21;
/// Side of the part of the image that is shown, pixels.
const CROP_PX: usize = 240;

/// Cross-sections of a view's finest fringes through the middle of the image, perpendicular to them.
#[derive(Clone, Debug, Serialize)]
pub struct Sections {
    /// View of the recording, from 1.
    pub view: usize,
    /// The exposure that is shown: the middle one, µs.
    pub exposure_us: u32,
    /// Row of the cut; column where fringes run along rows.
    pub cut_px: usize,
    /// Counts along the cut, of every step.
    pub counts: Vec<Vec<u16>>,
    /// Standard deviation over the steps along the cut, about their mean (divisor n), counts.
    pub std_dn: Vec<f64>,
    /// The same, smoothed in both directions.
    pub smoothed_dn: Vec<f64>,
    /// Middle of the image of every step: grey values, row by row.
    #[serde(skip)]
    pub crops: Vec<Vec<u8>>,
}

impl Sections {
    /// Side of a crop, pixels.
    pub const CROP_PX: usize = CROP_PX;

    /// Of the images of a recording's first view, in their order of capture.
    ///
    /// # Errors
    /// An image is not there, or not of this size.
    pub fn of_first_view(
        images: &[(FrameKind, PathBuf)],
        plan: &Plan,
        size_px: [u32; 2],
    ) -> Result<Self, ImageError> {
        let finest = plan.patterns.sets.len() - 1;
        let middle = plan.exposures_us.len() / 2;
        let of_cut = |kind: &FrameKind| matches!(kind, FrameKind::Fringe { exposure, set, .. } if (*exposure, *set) == (middle, finest));
        let steps = plan.patterns.sets[finest].steps as usize;
        // Of a recording in passes, the first.
        let images = images.iter().filter(|(kind, _)| of_cut(kind)).take(steps);
        let images: Vec<GreyImage> = images
            .map(|(_, path)| load_grey(path, size_px))
            .collect::<Result<_, _>>()?;
        let along_rows = plan.patterns.axis == Axis::Rows;
        Ok(Self {
            view: 1,
            exposure_us: plan.exposures_us.get(middle).copied().unwrap_or_default(),
            ..cut(&images, along_rows)
        })
    }
}

/// The cut through the middle of images of all steps.
fn cut(images: &[GreyImage], along_rows: bool) -> Sections {
    let Some(first) = images.first() else {
        return Sections::from_counts(0, Vec::new(), Vec::new(), Vec::new(), Vec::new());
    };
    let (length, across) = match along_rows {
        false => (first.width, first.height),
        true => (first.height, first.width),
    };
    let cut_px = across / 2;
    let at = |image: &GreyImage, i: usize, j: usize| match along_rows {
        false => image.pixels[j * image.width + i],
        true => image.pixels[i * image.width + j],
    };
    let counts = |image: &GreyImage| (0..length).map(|i| at(image, i, cut_px)).collect();
    let std = |i: usize, j: usize| spread(images.iter().map(|image| f64::from(at(image, i, j))));
    let band = cut_px.saturating_sub(REACH_PX)..(cut_px + REACH_PX + 1).min(across);
    let across_smoothed: Vec<f64> = (0..length)
        .map(|i| weighted(band.clone().map(|j| (j.abs_diff(cut_px), std(i, j)))))
        .collect();
    let smoothed = |i: usize| {
        let near = i.saturating_sub(REACH_PX)..(i + REACH_PX + 1).min(length);
        weighted(near.map(|k| (k.abs_diff(i), across_smoothed[k])))
    };
    Sections::from_counts(
        cut_px,
        images.iter().map(counts).collect(),
        (0..length).map(|i| std(i, cut_px)).collect(),
        (0..length).map(smoothed).collect(),
        crops(images),
    )
}

impl Sections {
    fn from_counts(
        cut_px: usize,
        counts: Vec<Vec<u16>>,
        std_dn: Vec<f64>,
        smoothed_dn: Vec<f64>,
        crops: Vec<Vec<u8>>,
    ) -> Self {
        Self {
            view: 0,
            exposure_us: 0,
            cut_px,
            counts,
            std_dn,
            smoothed_dn,
            crops,
        }
    }
}

/// Standard deviation about the mean, divisor n.
fn spread(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Mean of values by a Gaussian of their distances.
fn weighted(values: impl Iterator<Item = (usize, f64)>) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for (off_px, value) in values {
        let weight = (-0.5 * (off_px as f64 / SMOOTHING_PX).powi(2)).exp();
        sum += weight * value;
        total += weight;
    }
    sum / total
}

/// The middle of every image, all on one scale of grey.
fn crops(images: &[GreyImage]) -> Vec<Vec<u8>> {
    let middle = |image: &GreyImage| -> Vec<u16> {
        let [left, top] = [image.width, image.height].map(|n| n.saturating_sub(CROP_PX) / 2);
        let row = |y: usize| {
            (0..CROP_PX).map(move |x| {
                let inside = left + x < image.width && top + y < image.height;
                let at = (top + y) * image.width + left + x;
                if inside { image.pixels[at] } else { 0 }
            })
        };
        (0..CROP_PX).flat_map(row).collect()
    };
    let all: Vec<Vec<u16>> = images.iter().map(middle).collect();
    let most = all.iter().flatten().copied().max().unwrap_or(1).max(1);
    let grey = |counts: &u16| (f64::from(*counts) / f64::from(most) * 255.0).round() as u8;
    all.iter()
        .map(|crop| crop.iter().map(grey).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of fringes of one amplitude in one half of the image, and none in the other.
    fn steps() -> Vec<GreyImage> {
        let (width, height) = (300, 120);
        (0..4)
            .map(|step| {
                let pixels = (0..width * height).map(|at| {
                    let x = at % width;
                    let amplitude = if x < width / 2 { 400.0 } else { 0.0 };
                    let phase = 0.4 * x as f64 + std::f64::consts::FRAC_PI_2 * f64::from(step);
                    (1000.0 + amplitude * phase.cos()).round() as u16
                });
                GreyImage {
                    pixels: pixels.collect(),
                    width,
                    height,
                    bits: 16,
                    stated_largest_dn: None,
                }
            })
            .collect()
    }

    #[test]
    fn a_sinusoid_spreads_by_its_amplitude_over_root_two() {
        let images = steps();
        let found = cut(&images, false);
        assert_eq!(
            (found.cut_px, found.counts.len(), found.std_dn.len()),
            (60, 4, 300)
        );
        let expected = 400.0 / 2f64.sqrt();
        for x in 0..300 {
            let std = if x < 150 { expected } else { 0.0 };
            // Counts are whole numbers.
            assert!(
                (found.std_dn[x] - std).abs() < 0.8,
                "{x}: {}",
                found.std_dn[x]
            );
            assert_eq!(found.counts[2][x], images[2].pixels[60 * 300 + x]);
        }
        // Far from the edge smoothing changes nothing; at the edge half is left.
        assert!((found.smoothed_dn[70] - expected).abs() < 0.8);
        assert!(found.smoothed_dn[230] < 1e-9);
        let half = 0.5 * (found.smoothed_dn[149] + found.smoothed_dn[150]);
        assert!((half - 0.5 * expected).abs() < 0.5, "{half}");
        // Fringes along rows: the same image turned.
        let turned: Vec<GreyImage> = images
            .iter()
            .map(|image| GreyImage {
                pixels: (0..300 * 120)
                    .map(|at| image.pixels[(at % 120) * 300 + at / 120])
                    .collect(),
                width: 120,
                height: 300,
                bits: 16,
                stated_largest_dn: None,
            })
            .collect();
        let other = cut(&turned, true);
        assert_eq!(
            (other.std_dn, other.smoothed_dn),
            (found.std_dn, found.smoothed_dn)
        );
    }
}
