//! Pictures of every pass, and what a view takes with them.

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

/// `adaptive.json`: what was written for a view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Adaptive {
    /// Of this document.
    pub format: String,
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
    #[serde(skip_deserializing)]
    pub loading: Vec<Loading>,
}

/// One pass.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pass {
    /// What it lights; the folder of its pictures and their `patterns.json`.
    pub lights: Region,
    /// Share of the mirrors.
    pub lit_ratio: f64,
    /// How bright they are beside the plain pattern.
    pub brightness_ratio: f64,
}

/// What a view takes from the first frame to the last, in passes and as a plain set, without loading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Its file.
    pub const FILE: &'static str = "adaptive.json";
    /// Its format.
    const FORMAT: &'static str = "flankscope/adaptive/1";

    /// Reads what was written into a folder.
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

    /// What they light in a check of these teeth, or of the tool file's.
    ///
    /// The pictures were made for one view. Those of other teeth are the same to a head if the stages bring each tooth where that
    /// one was: what is cast of the drawing says so.
    ///
    /// # Errors
    /// They are of another set or of other mirrors, or leave dark what a pass of a view should light.
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

/// Why pictures in passes cannot be shown in a check.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AdaptiveError {
    /// No such document.
    #[error("{}: {reason}; `flankscope patterns --adaptive TOOL --tooth N -o DIR` writes it", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why it cannot be used.
        reason: String,
    },
    /// Passes are of one projector.
    #[error(
        "the head has two projectors, which show whole patterns one after the other; passes are for a head with one"
    )]
    TwoProjectors,
    /// Another document.
    #[error("{} has format {got:?}; right would be {:?}", path.display(), Adaptive::FORMAT)]
    Format {
        /// The file.
        path: PathBuf,
        /// What it says.
        got: String,
    },
    /// Other fringes.
    #[error(
        "the pictures show {got}, the head file says pattern_set = {expected:?}; make them anew"
    )]
    Set {
        /// Of the pictures.
        got: String,
        /// Of the head.
        expected: String,
    },
    /// Another DMD.
    #[error("the pictures are of other mirrors than the head file's; make them anew")]
    Mirrors,
    /// Not the known passes.
    #[error("the passes are not left, right and rest, in this order; make the pictures anew")]
    Regions,
    /// A pass of nothing.
    #[error(
        "the pass of {lights} lights no mirror: what it is for does not lie in the view; check without --adaptive"
    )]
    NothingLit {
        /// Which.
        lights: &'static str,
    },
    /// What must be lit is not.
    #[error(
        "tooth {tooth}: {dark} mirrors that light its {lights} stay dark in the pictures, which were made for tooth {made_for} with \
         a margin of {margin_mm} mm; make them for a tooth that looks the same, or with a larger --margin"
    )]
    Dark {
        /// In the middle of the view.
        tooth: u32,
        /// How many mirrors.
        dark: usize,
        /// What they light.
        lights: &'static str,
        /// Tooth of the pictures.
        made_for: u32,
        /// Their margin, mm.
        margin_mm: f64,
    },
    /// No passes by drawing and head.
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
