//! Pictures of every pass, and what a view takes with them.

use std::path::Path;

use flankscope_profilometry::PatternSet;
use flankscope_profilometry::head::Mirrors;
use serde::Serialize;

use super::loading::{Loading, loading};
use super::passes::{Passes, Region};
use super::{Packing, PatternsError, write_lit};
use crate::files::write_whole;
use crate::inspection::PlannedView;
use crate::settings::Timing;

/// `adaptive.json`: what was written for a view.
#[derive(Clone, Debug, Serialize)]
pub struct Adaptive {
    /// Of this document.
    pub format: &'static str,
    /// Name of the set.
    pub set: String,
    /// The view that the pictures are for, and no other.
    pub view: PlannedView,
    /// How far a pass reaches beyond what it lights, mm.
    pub margin_mm: f64,
    /// How the mirrors lie.
    pub mirrors: Mirrors,
    /// The passes, in the order in which they are shown.
    pub passes: Vec<Pass>,
    /// What a view takes.
    pub time: CaptureTime,
    /// What the controllers need until the pictures of a view are there.
    pub loading: Vec<Loading>,
}

/// One pass.
#[derive(Clone, Debug, Serialize)]
pub struct Pass {
    /// What it lights; the folder of its pictures and their `patterns.json`.
    pub lights: &'static str,
    /// Share of the mirrors.
    pub lit_ratio: f64,
}

/// What a view takes from the first frame to the last, in passes and as a plain set, without loading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CaptureTime {
    /// Frames, a dark one included.
    pub frames: usize,
    /// All exposures, waits for the mirrors and readouts, s.
    pub seconds: f64,
    /// Frames of the plain set.
    pub plain_frames: usize,
    /// And what they take, s.
    pub plain_seconds: f64,
}

impl CaptureTime {
    /// Of a set at some exposures.
    #[must_use]
    pub fn of(set: &PatternSet, exposures_us: &[u32], timing: &Timing) -> Self {
        let wait_us = f64::from(timing.pattern_settle_us) + f64::from(timing.camera_readout_us);
        let dark_us = exposures_us.first().map_or(0.0, |&us| f64::from(us)) + wait_us;
        let patterns = set.frames_per_exposure();
        let per_pattern_us: f64 = exposures_us.iter().map(|&us| f64::from(us) + wait_us).sum();
        let of = |passes: usize| {
            let shown = passes * patterns;
            let seconds = 1e-6 * (dark_us + shown as f64 * per_pattern_us);
            (1 + shown * exposures_us.len(), seconds)
        };
        let (frames, seconds) = of(Region::ALL.len());
        let (plain_frames, plain_seconds) = of(1);
        Self {
            frames,
            seconds,
            plain_frames,
            plain_seconds,
        }
    }
}

/// Writes a folder of pictures for each pass and `adaptive.json`.
///
/// # Errors
/// [`PatternsError`].
pub fn write_adaptive(
    folder: &Path,
    set: &PatternSet,
    passes: &Passes,
    time: CaptureTime,
    packing: Packing,
) -> Result<Adaptive, PatternsError> {
    let mirrors = passes.mirrors();
    let mut written = Vec::new();
    for pass in Region::ALL {
        let light = |shown: &mut [u8]| passes.mask(pass, shown);
        write_lit(&folder.join(pass.name()), set, mirrors, packing, light)?;
        written.push(Pass {
            lights: pass.name(),
            lit_ratio: passes.lit_ratio(pass),
        });
    }
    let patterns = Region::ALL.len() * set.frames_per_exposure();
    let adaptive = Adaptive {
        format: "flankscope/adaptive/1",
        set: set.name.clone(),
        view: passes.view().clone(),
        margin_mm: passes.margin_mm(),
        mirrors,
        passes: written,
        time,
        loading: loading(mirrors, patterns).to_vec(),
    };
    let path = folder.join(Adaptive::FILE);
    let mut text = serde_json::to_vec_pretty(&adaptive).unwrap_or_default();
    text.push(b'\n');
    write_whole(&path, &text).map_err(|source| PatternsError::Write { path, source })?;
    Ok(adaptive)
}

impl Adaptive {
    /// Its file.
    pub const FILE: &'static str = "adaptive.json";
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 12 patterns in three passes at 10 and 40 ms, with 13.2 ms between them, by hand.
    #[test]
    fn three_passes_take_three_times_as_long() {
        let set = PatternSet::named("high12").unwrap();
        let time = CaptureTime::of(&set, &[10_000, 40_000], &Timing::default());
        assert_eq!((time.frames, time.plain_frames), (73, 25));
        assert!((time.seconds - (0.0232 + 36.0 * 0.0764)).abs() < 1e-12);
        assert!((time.plain_seconds - (0.0232 + 12.0 * 0.0764)).abs() < 1e-12);
    }
}
