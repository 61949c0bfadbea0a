//! Writes the pictures of every pass, and computes the capture time of a view with them.

use std::path::{Path, PathBuf};

use flankscope_metrology::tool::Tool;
use flankscope_profilometry::PatternSet;
use flankscope_profilometry::head::{HeadModel, Mirrors};
use serde::{Deserialize, Serialize};

use super::light::PatternLight;
use super::loading::{Loading, loading};
use super::passes::{Passes, PassesError, Region};
use super::{Packing, PatternsError, write_lit};
use crate::settings::Timing;
use flankscope_foundation::files::write_whole;
use flankscope_metrology::view::PlannedView;

/// `adaptive.json`: the pictures that were written for a view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Adaptive {
    /// Format of this document.
    pub format: String,
    /// Name of the set.
    pub set: String,
    /// The view that the pictures were made for.
    pub view: PlannedView,
    /// Distance by which a pass reaches beyond its own flanks, mm.
    pub margin_mm: f64,
    /// Layout of the mirrors.
    pub mirrors: Mirrors,
    /// The passes, in the order in which they are shown.
    pub passes: Vec<Pass>,
    /// Capture time of a view.
    pub time: CaptureTime,
    /// Time that each DMD controller needs to load the pictures of a view.
    #[serde(skip_deserializing)]
    pub loading: Vec<Loading>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pass {
    /// Surfaces that it lights; also names the folder of its pictures and their `patterns.json`.
    pub lights: Region,
    /// Fraction of the mirrors that are lit.
    pub lit_ratio: f64,
    /// Brightness of its mirrors relative to the plain pattern.
    pub brightness_ratio: f64,
}

/// Time of a view from the first frame to the last, in passes and as a plain set, without loading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CaptureTime {
    /// Frames, including the dark one.
    pub frames: usize,
    /// All exposures, settling times of the mirrors and readouts, s.
    pub seconds: f64,
    /// Frames of the plain set.
    pub plain_frames: usize,
    /// Time of the plain set, s.
    pub plain_seconds: f64,
}

impl CaptureTime {
    /// Time of a set at some exposures.
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
            lights: pass,
            lit_ratio: passes.lit_ratio(pass),
            brightness_ratio: passes.brightness_ratio(pass),
        });
    }
    let patterns = Region::ALL.len() * set.frames_per_exposure();
    let adaptive = Adaptive {
        format: Adaptive::FORMAT.into(),
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
    /// File name.
    pub const FILE: &'static str = "adaptive.json";
    /// Format identifier.
    const FORMAT: &'static str = "flankscope/adaptive/1";

    /// Reads the `adaptive.json` of a folder.
    ///
    /// # Errors
    /// [`AdaptiveError::Read`], [`AdaptiveError::Format`].
    pub fn open(folder: &Path) -> Result<Self, AdaptiveError> {
        let path = folder.join(Self::FILE);
        let failed = |reason: String| {
            let path = path.clone();
            AdaptiveError::Read { path, reason }
        };
        let text = flankscope_foundation::files::read_regular(
            &path,
            flankscope_foundation::files::MOST_DOCUMENT_BYTES,
        )
        .map_err(|error| failed(error.to_string()))?;
        let read: Self =
            serde_json::from_slice(&text).map_err(|error| failed(error.to_string()))?;
        if read.format != Self::FORMAT {
            let got = read.format;
            return Err(AdaptiveError::Format { path, got });
        }
        Ok(read)
    }

    /// Light of the pictures in a check of these views.
    ///
    /// The pictures were made for one view. They fit other teeth too if the stages bring each tooth to the same place relative to
    /// the head; casting rays on the drawing checks that.
    ///
    /// # Errors
    /// The pictures are for another set or another DMD, or leave mirrors dark that a pass should light.
    pub fn light(
        &self,
        tool: &Tool,
        head: &HeadModel,
        views: &[PlannedView],
    ) -> Result<PatternLight, AdaptiveError> {
        let set = head.pattern_set.as_deref().unwrap_or_default();
        if self.set != set {
            return Err(AdaptiveError::Set {
                got: self.set.clone(),
                expected: set.into(),
            });
        }
        if head.projectors() > 1 {
            return Err(AdaptiveError::TwoProjectors);
        }
        if self.mirrors != head.mirrors() {
            return Err(AdaptiveError::Mirrors);
        }
        let lights: Vec<Region> = self.passes.iter().map(|pass| pass.lights).collect();
        if lights != Region::ALL {
            return Err(AdaptiveError::Regions);
        }
        let loaded = Passes::new(tool, head, &self.view, self.margin_mm)?;
        for view in views {
            let needed = Passes::new(tool, head, view, 0.0)?;
            for region in Region::ALL {
                let dark = needed.beyond(&loaded, region);
                if dark > 0 {
                    return Err(AdaptiveError::Dark {
                        tooth: view.tooth,
                        dark,
                        lights: region.name(),
                        made_for: self.view.tooth,
                        margin_mm: self.margin_mm,
                    });
                }
            }
        }
        let lit_ratio = |region| match loaded.lit_ratio(region) {
            lit if lit > 0.0 => Ok(lit * loaded.brightness_ratio(region)),
            _ => Err(AdaptiveError::NothingLit {
                lights: region.name(),
            }),
        };
        Ok(PatternLight {
            lit_ratios: Region::ALL
                .into_iter()
                .map(lit_ratio)
                .collect::<Result<_, _>>()?,
        })
    }
}

/// Why pictures in passes cannot be used in a check.
#[derive(Debug, thiserror::Error)]
pub enum AdaptiveError {
    /// `adaptive.json` cannot be read.
    #[error("{}: {reason}; `flankscope patterns --adaptive TOOL --tooth N -o DIR` writes it", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why it cannot be used.
        reason: String,
    },
    #[error(
        "the head has two projectors, which show whole patterns one after the other; passes are for a head with one"
    )]
    TwoProjectors,
    /// Another document, or another version of it.
    #[error("{} has format {got:?}; right would be {:?}", path.display(), Adaptive::FORMAT)]
    Format {
        /// The file.
        path: PathBuf,
        /// Format that it states.
        got: String,
    },
    /// Another pattern set than the head's.
    #[error(
        "the pictures show {got}, the head file says pattern_set = {expected:?}; make them anew"
    )]
    Set { got: String, expected: String },
    /// The pictures are for another DMD.
    #[error("the pictures are of other mirrors than the head file's; make them anew")]
    Mirrors,
    /// The passes are not the known ones.
    #[error("the passes are not left, right and rest, in this order; make the pictures anew")]
    Regions,
    #[error(
        "the pass of {lights} lights no mirror: what it is for does not lie in the view; check without --adaptive"
    )]
    NothingLit {
        /// Name of the pass.
        lights: &'static str,
    },
    /// Mirrors that must be lit are dark.
    #[error(
        "tooth {tooth}: {dark} mirrors that light its {lights} stay dark in the pictures, which were made for tooth {made_for} with \
         a margin of {margin_mm} mm; make them for a tooth that looks the same, or with a larger --margin"
    )]
    Dark {
        /// Tooth in the middle of the view.
        tooth: u32,
        /// Number of dark mirrors.
        dark: usize,
        /// Surfaces that they light.
        lights: &'static str,
        made_for: u32,
        margin_mm: f64,
    },
    /// The passes cannot be computed from drawing and head.
    #[error(transparent)]
    Passes(#[from] PassesError),
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
