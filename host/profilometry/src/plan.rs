//! `PLAN.toml`: the patterns of an external capture and the image of each (see `docs/formats/plan.md`).

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::frame::FrameKind;
use crate::gray::GrayCode;
use crate::head::Sensor;
use crate::io::images::{GreyImage, ImageError, list_images, load_grey};
use crate::pattern::{
    Axis, FringeSet, KNOWN_SETS, OWN_PHASE_ORIGIN_PX, PatternError, PatternSet, Shown, StepSign,
};
use flankscope_foundation::textfile::{self, BadValue, TextFileError};

/// A plan: patterns, exposures and, for every frame, its image.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The patterns, low frequency first.
    pub patterns: PatternSet,
    /// Exposures, ascending; a single one of unknown length counts as 1 us.
    pub exposures_us: Vec<u32>,
    /// Whether a dark frame is taken.
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
    #[serde(default)]
    fringes_along: FringesAlong,
    phase_origin_px: Option<f64>,
    dark: Option<PathBuf>,
    dark_first: Option<bool>,
    sensor: Option<Sensor>,
    #[serde(default)]
    set: Vec<SetFile>,
    gray_code: Option<CodeFile>,
}

/// Direction of the stripes.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FringesAlong {
    /// Stripes follow the projector's columns: their phase counts columns.
    #[default]
    Columns,
    /// Stripes follow the rows: their phase counts rows.
    Rows,
}

impl FringesAlong {
    fn axis(self) -> Axis {
        match self {
            Self::Columns => Axis::Columns,
            Self::Rows => Axis::Rows,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SetFile {
    periods: f64,
    steps: u32,
    /// Before the plan's.
    phase_origin_px: Option<f64>,
    #[serde(default)]
    frames: Vec<PathBuf>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CodeFile {
    bits: u32,
    stripes: f64,
    #[serde(default)]
    complement: bool,
    /// Before the plan's.
    phase_origin_px: Option<f64>,
    #[serde(default)]
    frames: Vec<PathBuf>,
}

/// More frames than any view has: 12 frequencies x 16 steps x 16 exposures, and some.
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
        let exposures_us = exposures_us(&file)?;
        let order = ascending(&file.set);
        let patterns = PatternSet::with_convention(
            name(&file),
            fringe_sets(&file, &order)?,
            step_sign(&file)?,
            file.fringes_along.axis(),
        )
        .and_then(|patterns| patterns.with_code(gray_code(&file)))
        .map_err(|error| bad_pattern(&error, &order))?;
        let total = exposures_us.len() * patterns.frames_per_exposure() + 1;
        if total > MAX_FRAMES {
            return Err(BadValue::new(
                "exposures_us",
                exposures_us.len(),
                "must leave at most 4096 frames in a view",
            ));
        }
        let exposures = exposures_us.len();
        let coded = file.gray_code.as_ref().map(|code| &code.frames);
        let mut listed = file.set.iter().map(|set| &set.frames).chain(coded);
        let images = if listed.all(Vec::is_empty) {
            Images::Sorted(sorted_frames(&file, &order, &patterns, exposures)?)
        } else {
            Images::Named(named_frames(&file, &order, &patterns, exposures)?)
        };
        Ok(Self {
            patterns,
            exposures_us,
            dark_frame: file.dark.is_some() || file.dark_first == Some(true),
            sensor: file.sensor,
            images,
        })
    }

    /// The images of one view, in capture order: all of `size_px` (columns, rows) and of the same bits.
    ///
    /// # Errors
    /// [`ImageError`] with the image that is missing, damaged or different.
    pub fn images(
        &self,
        folder: &Path,
        size_px: [u32; 2],
    ) -> Result<Vec<(FrameKind, GreyImage)>, ImageError> {
        let mut frames: Vec<(FrameKind, GreyImage)> = Vec::new();
        for (kind, path) in self.frames(folder)? {
            let image = load_grey(&path, size_px)?;
            if let Some((_, first)) = frames.first()
                && first.bits != image.bits
            {
                return Err(ImageError::Bits {
                    path,
                    got: image.bits,
                    expected: first.bits,
                });
            }
            frames.push((kind, image));
        }
        Ok(frames)
    }

    /// The image of every frame, in capture order.
    ///
    /// # Errors
    /// [`ImageError::Count`] when the folder's images must be taken by order and their number is not the plan's.
    pub fn frames(&self, folder: &Path) -> Result<Vec<(FrameKind, PathBuf)>, ImageError> {
        self.frames_of_passes(folder, 1)
    }

    /// The image of every frame, in capture order, of patterns that were shown in `passes` one after the other at each exposure;
    /// the dark frame is of all of them.
    ///
    /// # Errors
    /// As [`Self::frames`]; [`ImageError::Passes`] where the plan lists its images, which are those of one pass.
    pub fn frames_of_passes(
        &self,
        folder: &Path,
        passes: usize,
    ) -> Result<Vec<(FrameKind, PathBuf)>, ImageError> {
        let kinds = match &self.images {
            Images::Named(_) if passes != 1 => return Err(ImageError::Passes { passes }),
            Images::Named(frames) => {
                let frames = frames.iter();
                return Ok(frames
                    .map(|(kind, name)| (*kind, folder.join(name)))
                    .collect());
            }
            Images::Sorted(kinds) => kinds,
        };
        let mut shown = Vec::new();
        for of_exposure in kinds.chunk_by(|a, b| a.exposure() == b.exposure()) {
            let is_dark = of_exposure.contains(&FrameKind::Dark);
            for pass in 0..if is_dark { 1 } else { passes } {
                shown.extend(of_exposure.iter().map(|&kind| (pass, kind)));
            }
        }
        let paths = list_images(folder, shown.len())?;
        let mut frames: Vec<_> = shown.into_iter().zip(paths).collect();
        // Stable: what comes after the fringes is in order already.
        frames.sort_by_key(|&((pass, kind), _)| match kind {
            FrameKind::Dark => (0, 0, 0, 0),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => (1 + exposure, pass, set, step),
            FrameKind::Code { exposure, .. } => (1 + exposure, pass, usize::MAX, 0),
        });
        Ok(frames
            .into_iter()
            .map(|((_, kind), path)| (kind, path))
            .collect())
    }
}

/// The exposures, or a single one of unknown length.
fn exposures_us(file: &PlanFile) -> Result<Vec<u32>, BadValue> {
    let exposures_us = match file.exposures_us.as_slice() {
        [] => vec![1],
        given => given.to_vec(),
    };
    if exposures_us[0] == 0 || exposures_us.windows(2).any(|pair| pair[0] >= pair[1]) {
        return Err(BadValue::new(
            "exposures_us",
            exposures_us,
            "must be positive and ascending",
        ));
    }
    Ok(exposures_us)
}

fn step_sign(file: &PlanFile) -> Result<StepSign, BadValue> {
    match file.step_sign.unwrap_or(1) {
        1 => Ok(StepSign::Plus),
        -1 => Ok(StepSign::Minus),
        other => Err(BadValue::new("step_sign", other, "must be 1 or -1")),
    }
}

fn gray_code(file: &PlanFile) -> Option<GrayCode> {
    let common_origin_px = file.phase_origin_px.unwrap_or(OWN_PHASE_ORIGIN_PX);
    file.gray_code.as_ref().map(|code| GrayCode {
        bits: code.bits,
        stripes: code.stripes,
        origin_px: code.phase_origin_px.unwrap_or(common_origin_px),
        complement: code.complement,
    })
}

fn name(file: &PlanFile) -> String {
    let given = file.name.as_ref().or(file.pattern_set.as_ref());
    given.cloned().unwrap_or_else(|| "plan".to_owned())
}

/// The file's tables, lowest frequency first.
fn ascending(sets: &[SetFile]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..sets.len()).collect();
    order.sort_by(|&a, &b| sets[a].periods.total_cmp(&sets[b].periods));
    order
}

/// The frequencies of the tables, or of the built-in set that is named instead, lowest first.
fn fringe_sets(file: &PlanFile, order: &[usize]) -> Result<Vec<FringeSet>, BadValue> {
    let common_origin_px = file.phase_origin_px.unwrap_or(OWN_PHASE_ORIGIN_PX);
    let bad = |value: &str, expected| Err(BadValue::new("pattern_set", value, expected));
    match (&file.pattern_set, order) {
        (Some(name), []) => {
            let Ok(known) = PatternSet::named(name) else {
                return bad(name, KNOWN_SETS);
            };
            let moved = known.sets.into_iter().map(|set| FringeSet {
                phase_origin_px: common_origin_px,
                ..set
            });
            Ok(moved.collect())
        }
        (None, [_, ..]) => {
            let set = |&index: &usize| {
                let set = &file.set[index];
                FringeSet {
                    periods: set.periods,
                    steps: set.steps,
                    phase_origin_px: set.phase_origin_px.unwrap_or(common_origin_px),
                }
            };
            Ok(order.iter().map(set).collect())
        }
        (Some(name), [_, ..]) => bad(name, "must be absent when there are [[set]] tables"),
        (None, []) => bad(
            "nothing",
            "must name a built-in set, or the plan must have [[set]] tables",
        ),
    }
}

/// Content of the folder's images in order of their names: the dark frame, then exposure by exposure the tables as they stand in
/// the file, whatever their frequencies.
fn sorted_frames(
    file: &PlanFile,
    order: &[usize],
    patterns: &PatternSet,
    exposures: usize,
) -> Result<Vec<FrameKind>, BadValue> {
    if let Some(dark) = &file.dark {
        return Err(BadValue::new(
            "dark",
            dark,
            "must be absent (use dark_first = true) when the sets list no frames",
        ));
    }
    // A built-in set has no tables and an order of its own.
    let mut sets: Vec<usize> = (0..patterns.sets.len()).collect();
    sets.sort_by_key(|&set| order.get(set));
    let mut kinds = Vec::new();
    if file.dark_first == Some(true) {
        kinds.push(FrameKind::Dark);
    }
    for exposure in 0..exposures {
        for &set in &sets {
            let steps = 0..patterns.sets[set].steps;
            kinds.extend(steps.map(|step| FrameKind::Fringe {
                exposure,
                set,
                step,
            }));
        }
        kinds.extend(
            code_pictures(patterns).map(|picture| FrameKind::from_picture(picture, exposure)),
        );
    }
    Ok(kinds)
}

fn code_pictures(patterns: &PatternSet) -> impl Iterator<Item = Shown> + '_ {
    let is_code = |picture: &Shown| matches!(picture, Shown::Code { .. });
    patterns.pictures().filter(is_code)
}

/// The images that the tables list, in capture order.
fn named_frames(
    file: &PlanFile,
    order: &[usize],
    patterns: &PatternSet,
    exposures: usize,
) -> Result<Vec<(FrameKind, PathBuf)>, BadValue> {
    if file.dark_first == Some(true) && file.dark.is_none() {
        return Err(BadValue::new(
            "dark_first",
            true,
            "must be absent when the sets list their frames: name the image in dark",
        ));
    }
    let dark = file.dark.clone().map(|dark| (FrameKind::Dark, dark));
    let mut frames: Vec<(FrameKind, PathBuf)> = dark.into_iter().collect();
    for exposure in 0..exposures {
        for (set, &index) in order.iter().enumerate() {
            let listed = &file.set[index];
            let steps = listed.steps as usize;
            if listed.frames.len() != steps * exposures {
                return Err(BadValue::new(
                    format!("set[{index}].frames"),
                    listed.frames.len(),
                    "must list one image per step and exposure (exposure by exposure), in every set or in none",
                ));
            }
            let images = listed.frames[exposure * steps..]
                .iter()
                .zip(0..listed.steps);
            frames.extend(images.map(|(image, step)| {
                let kind = FrameKind::Fringe {
                    exposure,
                    set,
                    step,
                };
                (kind, image.clone())
            }));
        }
        if let (Some(file), Some(code)) = (&file.gray_code, &patterns.code) {
            let pictures = code.frames() as usize;
            if file.frames.len() != pictures * exposures {
                return Err(BadValue::new(
                    "gray_code.frames",
                    file.frames.len(),
                    "must list one image per bit (with complement two) and exposure, exposure by exposure, when the sets list theirs",
                ));
            }
            let images = file.frames[exposure * pictures..].iter();
            let kinds =
                code_pictures(patterns).map(|picture| FrameKind::from_picture(picture, exposure));
            frames.extend(kinds.zip(images.cloned()));
        }
    }
    Ok(frames)
}

/// Error of patterns whose tables stand in this order, lowest frequency first.
fn bad_pattern(error: &PatternError, order: &[usize]) -> BadValue {
    let key = |set: usize, name: &str| match order.get(set) {
        Some(index) => format!("set[{index}].{name}"),
        None => "pattern_set".to_owned(),
    };
    match *error {
        PatternError::Order { set, got, .. } => {
            BadValue::new(key(set, "periods"), got, "must differ from set to set")
        }
        PatternError::FrequencyCount { got } => {
            BadValue::new("set", got, "must be 1 to 12 [[set]] tables")
        }
        ref other => other.bad_value(key),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> Result<Plan, BadValue> {
        Plan::from_file(toml::from_str(text).unwrap())
    }

    fn names(plan: &Plan, folder: &Path) -> Vec<(FrameKind, String)> {
        let name = |path: PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        plan.frames(folder)
            .unwrap()
            .into_iter()
            .map(|(kind, path)| (kind, name(path)))
            .collect()
    }

    /// High frequency first in the file, low first in the capture order; two exposures; a dark frame.
    #[test]
    fn named_and_sorted_images_go_to_the_same_frames() {
        let named = plan(
            "exposures_us = [5, 9]\ndark = '00.png'\n\
             [[set]]\nperiods = 16\nsteps = 3\nframes = ['01.png', '02.png', '03.png', '08.png', '09.png', '10.png']\n\
             [[set]]\nperiods = 1\nsteps = 4\nframes = ['04.png', '05.png', '06.png', '07.png', '11.png', '12.png', '13.png', '14.png']\n",
        )
        .unwrap();
        let sorted = plan(
            "exposures_us = [5, 9]\ndark_first = true\n[[set]]\nperiods = 16\nsteps = 3\n[[set]]\nperiods = 1\nsteps = 4\n",
        )
        .unwrap();
        let folder = std::env::temp_dir().join(format!("flankscope-plan-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        for index in 0..15 {
            std::fs::write(folder.join(format!("{index:02}.png")), []).unwrap();
        }
        let expected: Vec<String> = [0, 4, 5, 6, 7, 1, 2, 3, 11, 12, 13, 14, 8, 9, 10]
            .map(|i| format!("{i:02}.png"))
            .to_vec();
        for plan in [&named, &sorted] {
            let frames = names(plan, &folder);
            assert_eq!(
                frames
                    .iter()
                    .map(|(_, name)| name.clone())
                    .collect::<Vec<_>>(),
                expected
            );
            assert_eq!(frames[0].0, FrameKind::Dark);
            assert_eq!(
                frames[8].0,
                FrameKind::Fringe {
                    exposure: 1,
                    set: 0,
                    step: 0
                }
            );
            assert_eq!(
                frames[14].0,
                FrameKind::Fringe {
                    exposure: 1,
                    set: 1,
                    step: 2
                }
            );
        }
        std::fs::write(folder.join("15.PNG"), []).unwrap();
        assert!(matches!(
            sorted.frames(&folder),
            Err(ImageError::Count {
                got: 16,
                expected: 15,
                ..
            })
        ));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Two passes of a plan that has the high frequency first: names follow the triggers, the dark frame is of both.
    #[test]
    fn passes_follow_each_other_within_an_exposure() {
        let sorted = plan(
            "exposures_us = [5, 9]\ndark_first = true\n[[set]]\nperiods = 16\nsteps = 3\n[[set]]\nperiods = 1\nsteps = 3\n",
        )
        .unwrap();
        let folder = tempfile::tempdir().unwrap();
        for index in 0..25 {
            std::fs::write(folder.path().join(format!("{index:02}.png")), []).unwrap();
        }
        let frames = sorted.frames_of_passes(folder.path(), 2).unwrap();
        assert_eq!(frames[0].0, FrameKind::Dark);
        let names = frames.iter().map(|(_, path)| {
            let name = path.file_stem().unwrap().to_string_lossy();
            name.parse::<usize>().unwrap()
        });
        let swapped = [3, 4, 5, 0, 1, 2];
        let blocks = (0..4).flat_map(|block| swapped.map(|at| 1 + 6 * block + at));
        assert_eq!(
            names.collect::<Vec<_>>(),
            std::iter::once(0).chain(blocks).collect::<Vec<_>>()
        );
        for (at, (kind, _)) in frames.iter().enumerate().skip(1) {
            let expected = FrameKind::Fringe {
                exposure: (at - 1) / 12,
                set: (at - 1) % 6 / 3,
                step: ((at - 1) % 3) as u32,
            };
            assert_eq!(*kind, expected, "frame {at}");
        }
        let listed = plan("[[set]]\nperiods = 1\nsteps = 3\nframes = ['0', '1', '2']\n").unwrap();
        assert!(matches!(
            listed.frames_of_passes(folder.path(), 2),
            Err(ImageError::Passes { passes: 2 })
        ));
    }

    /// A code after the fringes, exposure by exposure, its frames listed and by name.
    #[test]
    fn the_code_comes_after_the_fringes() {
        let text = |frames: [&str; 2]| {
            format!(
                "exposures_us = [5, 9]\n[[set]]\nperiods = 4\nsteps = 3\n{}[gray_code]\nbits = 1\nstripes = 4\ncomplement = true\n{}",
                frames[0], frames[1]
            )
        };
        let named = plan(&text([
            "frames = ['0', '1', '2', '5', '6', '7']\n",
            "frames = ['3', '4', '8', '9']\n",
        ]));
        let named = named.unwrap();
        let frames = names(&named, Path::new(""));
        let order: String = frames.iter().map(|(_, name)| name.as_str()).collect();
        assert_eq!(order, "0123456789");
        let code = |exposure, complement| FrameKind::Code {
            exposure,
            bit: 0,
            complement,
        };
        assert_eq!((frames[3].0, frames[4].0), (code(0, false), code(0, true)));
        assert_eq!((frames[8].0, frames[9].0), (code(1, false), code(1, true)));
        let Images::Sorted(kinds) = plan(&text([""; 2])).unwrap().images else {
            panic!("nothing is listed");
        };
        let listed: Vec<FrameKind> = frames.iter().map(|frame| frame.0).collect();
        assert_eq!(kinds, listed);
        // Their places agree with those that the sums expect.
        let pictures: Vec<Shown> = named.patterns.pictures().collect();
        let expected = (0..2).flat_map(|exposure| {
            let of = |picture: &Shown| FrameKind::from_picture(*picture, exposure);
            pictures.iter().map(of).collect::<Vec<_>>()
        });
        assert_eq!(listed, expected.collect::<Vec<_>>());
    }

    #[test]
    fn contradictions_are_named() {
        let key = |text: &str| plan(text).unwrap_err().key;
        assert_eq!(key(""), "pattern_set");
        assert_eq!(key("pattern_set = 'scan17'"), "pattern_set");
        assert_eq!(
            key("pattern_set = 'scan16'\n[[set]]\nperiods = 1\nsteps = 3"),
            "pattern_set"
        );
        assert_eq!(key("step_sign = 2\npattern_set = 'scan16'"), "step_sign");
        assert_eq!(
            key("exposures_us = [3, 3]\npattern_set = 'scan16'"),
            "exposures_us"
        );
        assert_eq!(key("dark = 'd.png'\npattern_set = 'scan16'"), "dark");
        assert_eq!(
            key("[[set]]\nperiods = 2\nsteps = 3\n[[set]]\nperiods = 2\nsteps = 3"),
            "set[1].periods"
        );
        assert_eq!(
            key("[[set]]\nperiods = 2\nsteps = 3\nframes = ['a.png']"),
            "set[0].frames"
        );
    }
}
