//! Histograms of pixel levels, exposure by exposure: how bright the frames of a view are and what saturates, for setting up.
//!
//! Counted on the capture thread, from the frame in shared memory, only where a job asks for it ([`super::Acquisition::count_levels`]).

use flankscope_profilometry::head::ImageCircle;
use flankscope_profilometry::{FrameKind, FrameView};

/// Number of pixels at every level, DN.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LevelHistogram {
    /// Pixels by level, from 0 DN.
    counts: Vec<u64>,
}

impl LevelHistogram {
    pub fn add(&mut self, pixels_dn: &[u16]) {
        for level in pixels_dn.iter().map(|&dn| usize::from(dn)) {
            if level >= self.counts.len() {
                self.counts.resize(level + 1, 0);
            }
            self.counts[level] += 1;
        }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The least level that this share of the pixels does not exceed, DN; `None` without pixels.
    #[must_use]
    pub fn quantile_dn(&self, share: f64) -> Option<u16> {
        let wanted = (share.clamp(0.0, 1.0) * self.pixels() as f64)
            .ceil()
            .max(1.0);
        let mut below = 0;
        let found = self.counts.iter().position(|&count| {
            below += count;
            below as f64 >= wanted
        });
        found.and_then(|level| u16::try_from(level).ok())
    }

    /// Share of the pixels above a level; 0 without pixels.
    #[must_use]
    pub fn share_above(&self, limit_dn: u16) -> f64 {
        let above: u64 = self.counts.iter().skip(usize::from(limit_dn) + 1).sum();
        above as f64 / self.pixels().max(1) as f64
    }

    /// Pixels in `bins` equal parts of the levels from 0 to `full_scale_dn`; higher levels count in the last one.
    #[must_use]
    pub fn binned(&self, bins: usize, full_scale_dn: u16) -> Vec<u64> {
        let mut binned = vec![0; bins.max(1)];
        let levels = usize::from(full_scale_dn) + 1;
        for (level, &count) in self.counts.iter().enumerate() {
            let bin = level * binned.len() / levels;
            let last = binned.len() - 1;
            binned[bin.min(last)] += count;
        }
        binned
    }
}

/// Levels of one view's frames.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ViewLevels {
    /// The dark frame.
    pub dark: LevelHistogram,
    /// All patterns at each exposure, shortest first.
    pub exposures: Vec<LevelHistogram>,
}

impl ViewLevels {
    /// Adds the pixels of a frame that lie in the head's image circle, or all of them without one.
    pub(super) fn count(
        &mut self,
        frame: FrameView<'_>,
        kind: FrameKind,
        circle: Option<&ImageCircle>,
    ) {
        let histogram = match kind.exposure() {
            None => &mut self.dark,
            Some(exposure) => {
                if exposure >= self.exposures.len() {
                    self.exposures
                        .resize_with(exposure + 1, LevelHistogram::default);
                }
                &mut self.exposures[exposure]
            }
        };
        for row in 0..frame.height {
            let pixels = frame.pixels.get(row * frame.stride..).unwrap_or_default();
            let pixels = pixels.get(..frame.width).unwrap_or_default();
            let [from, to] = circle.map_or([0, frame.width], |circle| {
                chord_px(circle, row, frame.width)
            });
            histogram.add(pixels.get(from..to).unwrap_or_default());
        }
    }
}

/// First column of a row in the circle, and the one after the last.
fn chord_px(circle: &ImageCircle, row: usize, width: usize) -> [usize; 2] {
    let [x, y] = circle.centre_px;
    let half = (circle.radius_px.powi(2) - (row as f64 - y).powi(2)).max(-1.0);
    if half < 0.0 {
        return [0, 0];
    }
    let half = half.sqrt();
    // Casts of negative numbers give 0.
    let [from, to] = [(x - half).ceil() as usize, (x + half).floor() as usize + 1];
    [from.min(width), to.min(width)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_shares_and_bins_are_those_of_the_pixels() {
        let mut histogram = LevelHistogram::default();
        assert_eq!(histogram.quantile_dn(0.5), None);
        assert_eq!(histogram.share_above(10), 0.0);
        // One pixel at every level from 0 to 4095, and five more at the top.
        let ramp: Vec<u16> = (0..4096).collect();
        histogram.add(&ramp);
        histogram.add(&[4095; 5]);
        assert_eq!(histogram.pixels(), 4101);
        // The smallest level that at least half of 4101 pixels do not exceed: 2051 pixels lie at 0 to 2050.
        assert_eq!(histogram.quantile_dn(0.5), Some(2050));
        assert_eq!(histogram.quantile_dn(0.0), Some(0));
        assert_eq!(histogram.quantile_dn(1.0), Some(4095));
        assert_eq!(histogram.share_above(4094), 6.0 / 4101.0);
        assert_eq!(histogram.share_above(4095), 0.0);
        let binned = histogram.binned(4, 4095);
        assert_eq!(binned, [1024, 1024, 1024, 1029]);
        // A level beyond the scale is not lost.
        histogram.add(&[60_000]);
        assert_eq!(histogram.binned(4, 4095), [1024, 1024, 1024, 1030]);
    }

    #[test]
    fn pixels_outside_the_image_circle_do_not_count() {
        let circle = ImageCircle {
            centre_px: [10.0, 8.0],
            radius_px: 5.0,
        };
        let (width, height) = (24, 20);
        let pixels: Vec<u16> = (0..width * height)
            .map(|place| {
                let at = [(place % width) as f64, (place / width) as f64];
                if circle.contains(at) { 500 } else { 3 }
            })
            .collect();
        let frame = FrameView::packed(&pixels, width, height);
        let inside = pixels.iter().filter(|&&dn| dn == 500).count() as u64;
        let mut levels = ViewLevels::default();
        levels.count(frame, FrameKind::Dark, Some(&circle));
        assert_eq!(levels.dark.pixels(), inside);
        assert_eq!(levels.dark.quantile_dn(0.0), Some(500));
        let fringe = FrameKind::Fringe {
            exposure: 1,
            set: 0,
            step: 0,
        };
        levels.count(frame, fringe, None);
        assert_eq!(levels.exposures[0].pixels(), 0);
        assert_eq!(levels.exposures[1].pixels(), (width * height) as u64);
    }
}
