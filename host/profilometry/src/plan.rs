//! `PLAN.toml`: the patterns of somebody's capture and which image shows which (see `docs/formats.md`).

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::calibration::Sensor;
use crate::frame::FrameKind;
use crate::images::{ImageError, list_pngs};
use crate::pattern::{FringeSet, OWN_PHASE_ORIGIN_PX, PatternError, PatternSet, StepSign};
use crate::textfile::{self, BadValue, TextFileError};

/// A plan: patterns, exposures and, for every frame, its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The patterns, low frequency first.
    pub patterns: PatternSet,
    /// Exposures, ascending; a single one of unknown length counts as 1 us.
    pub exposures_us: Vec<u32>,
    /// Whether there is a dark frame.
    pub dark_frame: bool,
    /// The measured sensor, if the plan has one.
    pub sensor: Option<Sensor>,
    /// Image file names.
    images: Images,
}

#[derive(Clone, Debug, PartialEq)]
enum Images {
    /// In capture order.
    Named(Vec<(FrameKind, PathBuf)>),
    /// The kinds in the order of the plan file; names come from the folder.
    Sorted(Vec<FrameKind>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PlanFile {
    name: Option<String>,
    pattern_set: Option<String>,
    #[serde(default)]
    exposures_us: Vec<u32>,
    #[serde(default)]
    step_sign: Option<i32>,
    phase_origin_px: Option<f64>,
    dark: Option<PathBuf>,
    dark_first: Option<bool>,
    sensor: Option<Sensor>,
    #[serde(default)]
    set: Vec<SetFile>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SetFile {
    periods: f64,
    steps: u32,
    #[serde(default)]
    frames: Vec<PathBuf>,
}

/// More frames than any view has: 4 frequencies x 64 steps x 16 exposures.
const MAX_FRAMES: usize = 4096;

impl Plan {
    /// Reads a plan file.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and what would be right.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let text = textfile::read(path)?;
        let file: PlanFile = textfile::parse_toml(path, &text)?;
        Self::from_file(file).map_err(|bad| bad.in_file(path, &text))
    }

    fn from_file(file: PlanFile) -> Result<Self, BadValue> {
        let exposures_us = if file.exposures_us.is_empty() {
            vec![1]
        } else {
            file.exposures_us
        };
        if exposures_us[0] == 0 || exposures_us.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(BadValue::new(
                "exposures_us",
                exposures_us,
                "must be positive and ascending",
            ));
        }
        let step_sign = match file.step_sign.unwrap_or(1) {
            1 => StepSign::Plus,
            -1 => StepSign::Minus,
            other => return Err(BadValue::new("step_sign", other, "must be 1 or -1")),
        };
        // Where each [[set]] of the file goes when frequencies ascend.
        let mut order: Vec<usize> = (0..file.set.len()).collect();
        order.sort_by(|&a, &b| file.set[a].periods.total_cmp(&file.set[b].periods));
        let sets =
            match (&file.pattern_set, file.set.is_empty()) {
                (Some(name), true) => PatternSet::named(name)
                    .map_err(|_| {
                        BadValue::new(
                            "pattern_set",
                            name,
                            "must be article8, insitu12 or scan16, or absent with [[set]] tables",
                        )
                    })?
                    .sets,
                (None, false) => order
                    .iter()
                    .map(|&index| FringeSet {
                        periods: file.set[index].periods,
                        steps: file.set[index].steps,
                    })
                    .collect(),
                (Some(name), false) => {
                    return Err(BadValue::new(
                        "pattern_set",
                        name,
                        "must be absent when there are [[set]] tables",
                    ));
                }
                (None, true) => {
                    return Err(BadValue::new(
                        "pattern_set",
                        "nothing",
                        "must name a built-in set, or the plan must have [[set]] tables",
                    ));
                }
            };
        let name = file
            .name
            .or(file.pattern_set)
            .unwrap_or_else(|| "plan".to_owned());
        let patterns = PatternSet::with_convention(
            name,
            sets,
            step_sign,
            file.phase_origin_px.unwrap_or(OWN_PHASE_ORIGIN_PX),
        )
        .map_err(|error| bad_pattern(&error, &order))?;
        if order.is_empty() {
            order = (0..patterns.sets.len()).collect();
        }
        let total = exposures_us.len() * patterns.frames_per_exposure() + 1;
        if total > MAX_FRAMES {
            return Err(BadValue::new(
                "exposures_us",
                exposures_us.len(),
                "must leave at most 4096 frames in a view",
            ));
        }
        let named = file.set.iter().filter(|set| !set.frames.is_empty()).count();
        let dark_frame = file.dark.is_some() || file.dark_first == Some(true);
        let images = if named == 0 {
            if let Some(dark) = &file.dark {
                return Err(BadValue::new(
                    "dark",
                    dark,
                    "must be absent (use dark_first = true) when the sets list no frames",
                ));
            }
            let fringes = (0..exposures_us.len()).flat_map(|exposure| {
                let kinds = order.iter().flat_map(move |&set| [(exposure, set)]);
                kinds.collect::<Vec<_>>()
            });
            let mut kinds = if dark_frame {
                vec![FrameKind::Dark]
            } else {
                Vec::new()
            };
            for (exposure, file_index) in fringes {
                let set = order
                    .iter()
                    .position(|&index| index == file_index)
                    .unwrap_or(file_index);
                kinds.extend((0..patterns.sets[set].steps).map(|step| FrameKind::Fringe {
                    exposure,
                    set,
                    step,
                }));
            }
            Images::Sorted(kinds)
        } else {
            if file.dark_first == Some(true) && file.dark.is_none() {
                return Err(BadValue::new(
                    "dark_first",
                    true,
                    "must be absent when the sets list their frames: name the image in dark",
                ));
            }
            let mut frames: Vec<(FrameKind, PathBuf)> = file
                .dark
                .map(|dark| (FrameKind::Dark, dark))
                .into_iter()
                .collect();
            for exposure in 0..exposures_us.len() {
                for (set, &index) in order.iter().enumerate() {
                    let listed = &file.set[index];
                    if listed.frames.len() != listed.steps as usize * exposures_us.len() {
                        return Err(BadValue::new(
                            format!("set[{index}].frames"),
                            listed.frames.len(),
                            "must list one image per step and exposure (exposure by exposure), in every set or in none",
                        ));
                    }
                    for step in 0..listed.steps {
                        let at = exposure * listed.steps as usize + step as usize;
                        frames.push((
                            FrameKind::Fringe {
                                exposure,
                                set,
                                step,
                            },
                            listed.frames[at].clone(),
                        ));
                    }
                }
            }
            Images::Named(frames)
        };
        Ok(Self {
            patterns,
            exposures_us,
            dark_frame,
            sensor: file.sensor,
            images,
        })
    }

    /// The image of every frame, in capture order.
    ///
    /// # Errors
    /// [`ImageError::Count`] when the folder's images must be taken by order and their number is not the plan's.
    pub fn frames(&self, folder: &Path) -> Result<Vec<(FrameKind, PathBuf)>, ImageError> {
        match &self.images {
            Images::Named(frames) => Ok(frames
                .iter()
                .map(|(kind, name)| (*kind, folder.join(name)))
                .collect()),
            Images::Sorted(kinds) => {
                let paths = list_pngs(folder, kinds.len())?;
                let mut frames: Vec<_> = kinds.iter().copied().zip(paths).collect();
                frames.sort_by_key(|(kind, _)| match *kind {
                    FrameKind::Dark => (0, 0, 0),
                    FrameKind::Fringe {
                        exposure,
                        set,
                        step,
                    } => (1 + exposure, set, step),
                });
                Ok(frames)
            }
        }
    }
}

fn bad_pattern(error: &PatternError, order: &[usize]) -> BadValue {
    let key = |set: usize, name: &str| match order.get(set) {
        Some(index) => format!("set[{index}].{name}"),
        None => "pattern_set".to_owned(),
    };
    match *error {
        PatternError::Steps { set, got } => BadValue::new(
            key(set, "steps"),
            got,
            "must be 3 to 64 (offset, amplitude and phase are three unknowns)",
        ),
        PatternError::Periods { set, got } => {
            BadValue::new(key(set, "periods"), got, "must be above 0 and at most 4096")
        }
        PatternError::Order { set, got, .. } => {
            BadValue::new(key(set, "periods"), got, "must differ from set to set")
        }
        PatternError::FrequencyCount { got } => {
            BadValue::new("set", got, "must be 1 to 4 [[set]] tables")
        }
        PatternError::Origin { got } => BadValue::new(
            "phase_origin_px",
            got,
            "must be within a projector's width of column 0",
        ),
        PatternError::UnknownName { ref name } => {
            BadValue::new("pattern_set", name, "must be article8, insitu12 or scan16")
        }
    }
}
