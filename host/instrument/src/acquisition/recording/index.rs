//! The index of a recorded folder of frames or clouds, and `frames.toml`: the stage position of each view of a folder of recorded
//! frames, and its images.

use std::path::{Component, Path, PathBuf};

use flankscope_foundation::date::Date;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};
use flankscope_protocol::plan::MAX_FRINGE_SETS;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// An index in TOML, with a table `[[view]]` for each view.
pub trait RecordedIndex: DeserializeOwned {
    /// File name in the folder.
    const FILE: &'static str;

    /// Stage position and further checked entries of each view, in the order in which they were captured.
    fn places(&self) -> Vec<IndexedView>;

    /// Checks the entries that only this kind of index has.
    ///
    /// # Errors
    /// The first value out of range.
    fn check(&self) -> Result<(), BadValue>;

    /// Reads a folder's index. Also returns its text, whose digest identifies the recording.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and the expected value.
    fn load(folder: &Path) -> Result<(Self, String), TextFileError> {
        let check = |index: &Self| {
            let places = index.places();
            if places.is_empty() {
                let expected = "must be one table [[view]] for each view";
                return Err(BadValue::new("view", 0, expected));
            }
            index.check()?;
            let mut places = places.iter().enumerate();
            places.try_for_each(|(at, place)| place.check(at))
        };
        let path = folder.join(Self::FILE);
        textfile::load_toml(&path, textfile::MAX_BYTES * 16, check)
    }
}

/// The index of a folder of frames. Paths are absolute or relative to the index.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameIndex {
    /// Whether the frames show no real die: they were rendered, or come from the simulated bench.
    pub simulated: bool,
    /// Day on which the frames were taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taken: Option<Date>,
    /// Plan file with the patterns and exposures of every view, as `decode` takes it.
    #[serde(default = "default_plan")]
    pub plan: PathBuf,
    /// Head file of the head that captured the frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub head: Option<PathBuf>,
    /// Table of camera poses, if these do not follow from the stages.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub poses: Option<PathBuf>,
    /// Folder that holds the folders of the views; by default the index's own folder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<PathBuf>,
    /// Teeth that the check had to measure; by default those of the views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teeth: Option<Vec<u32>>,
    /// Grid of the scan that the views belong to, as `scan --views` takes it; by default the scan consists of these views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<String>,
    /// Press cycles by the controller's counter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub press_cycles: Option<u32>,
    /// Temperature of the tool, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool_temperature_degc: Option<f64>,
    /// Fraction of the light of all mirrors that each pass gave, if the patterns were shown in passes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lit_ratios: Vec<f64>,
    /// The views, in the order in which they were captured.
    #[serde(default)]
    pub view: Vec<IndexedView>,
}

/// One view: position of the stages, and its images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IndexedView {
    /// Folder of its images; by default the images' folder itself.
    #[serde(default = "here")]
    pub folder: PathBuf,
    /// Tooth in the middle of the view, or number of the patch. Without `rotation_rad`, the angle follows from the drawing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tooth: Option<u32>,
    /// Commanded angle of the rotary stage, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_rad: Option<f64>,
    /// Commanded height of the vertical stage, mm; by default the viewing height in the tool file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertical_mm: Option<f64>,
    /// Start and end of each frame's trigger by the controller's clock, in order of capture, µs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub triggered_us: Vec<[u64; 2]>,
    /// Start and end of each frame's exposure by the camera's clock, in order of capture, µs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub exposed_us: Vec<[u64; 2]>,
    /// BLAKE3 of each image file, in order of capture.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub blake3: Vec<String>,
}

fn default_plan() -> PathBuf {
    "PLAN.toml".into()
}

fn here() -> PathBuf {
    ".".into()
}

/// Largest angle of a rotary stage that is accepted, rad.
const FARTHEST_RAD: f64 = 1e3;
/// Largest position of a vertical stage that is accepted, mm.
const LONGEST_MM: f64 = 1e4;

impl RecordedIndex for FrameIndex {
    const FILE: &'static str = "frames.toml";

    fn places(&self) -> Vec<IndexedView> {
        self.view.clone()
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let degc = self.tool_temperature_degc.unwrap_or(0.0);
        let passes = self.lit_ratios.len();
        let no_share = self.lit_ratios.iter().find(|ratio| !(**ratio > 0.0 && **ratio <= 1.0));
        textfile::require(&[
            ((-273.15..=2000.0).contains(&degc), "tool_temperature_degc", &degc, "must be degrees Celsius"),
            (passes <= MAX_FRINGE_SETS, "lit_ratios", &passes, "must be at most 12 passes"),
            (no_share.is_none(), "lit_ratios", &no_share.unwrap_or(&1.0), "must be shares of all mirrors' light, above 0 and at most 1"),
        ])
    }
}

impl IndexedView {
    /// Checks its entries; `at` is its position in the index.
    #[rustfmt::skip]
    fn check(&self, at: usize) -> Result<(), BadValue> {
        let key = |name: &str| format!("view[{at}].{name}");
        let (angle_rad, height_mm) = (self.rotation_rad.unwrap_or(0.0), self.vertical_mm.unwrap_or(0.0));
        let is_placed = self.tooth.is_some() || self.rotation_rad.is_some();
        let forward = |times: &[[u64; 2]]| times.as_flattened().is_sorted();
        let (in_order, back) = ("must be start and end of every frame, each after the one before", &"times that go back");
        let exposed = self.exposed_us.len();
        let is_hash = |text: &&String| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
        let no_hash = self.blake3.iter().find(|text| !is_hash(text));
        textfile::require(&[
            (is_placed, &key("tooth"), &"nothing", "must name the tooth in the middle, or the angle in rotation_rad"),
            (within(angle_rad, FARTHEST_RAD), &key("rotation_rad"), &angle_rad, "must be radians"),
            (within(height_mm, LONGEST_MM), &key("vertical_mm"), &height_mm, "must be millimetres"),
            (stays_inside(&self.folder), &key("folder"), &self.folder, "must be a folder in that of the images, without ..; name another place by images = \"DIR\""),
            (forward(&self.triggered_us), &key("triggered_us"), back, in_order),
            (forward(&self.exposed_us), &key("exposed_us"), back, in_order),
            (self.triggered_us.len() == exposed, &key("exposed_us"), &exposed, "must have as many entries as triggered_us"),
            (no_hash.is_none(), &key("blake3"), &no_hash.map_or("", String::as_str), "must be 64 hexadecimal digits"),
        ])
    }
}

/// Whether a value is finite and its magnitude at most `most`.
fn within(value: f64, most: f64) -> bool {
    (-most..=most).contains(&value)
}

/// Whether a path stays in the folder that it is relative to.
pub fn stays_inside(path: &Path) -> bool {
    path.components()
        .all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn complaint(text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(FrameIndex::FILE), text).unwrap();
        FrameIndex::load(folder.path()).unwrap_err().to_string()
    }

    #[test]
    fn a_mistake_is_named_with_its_line_and_what_would_be_right() {
        let view = "simulated = true\n[[view]]\ntooth = 40\n";
        for (text, line, word) in [
            ("[[view]]\ntooth = 40\n".to_owned(), 1, "simulated"),
            ("simulated = true\n".to_owned(), 1, "[[view]]"),
            (
                "simulated = true\n[[view]]\nvertical_mm = 33\n".to_owned(),
                2,
                "rotation_rad",
            ),
            (format!("{view}rotation_rad = nan\n"), 4, "radians"),
            (format!("{view}vertical_mm = inf\n"), 4, "millimetres"),
            (format!("tool_temperature_degc = nan\n{view}"), 1, "Celsius"),
            (format!("{view}folder = \"../elsewhere\"\n"), 4, "images ="),
            (format!("{view}folder = \"/elsewhere\"\n"), 4, "images ="),
            (format!("{view}angle = 3\n"), 4, "rotation_rad"),
            (format!("lit_ratios = [0.5, nan]\n{view}"), 1, "at most 1"),
            (format!("lit_ratios = [0.5, 0.0]\n{view}"), 1, "above 0"),
            (
                format!("lit_ratios = {:?}\n{view}", [0.5; 13]),
                1,
                "at most 12 passes",
            ),
            (format!("{view}blake3 = [\"12\"]\n"), 4, "64 hexadecimal"),
            (format!("{view}exposed_us = [[5, 4]]\n"), 4, "go back"),
            (
                format!("{view}exposed_us = [[1, 4], [3, 5]]\n"),
                4,
                "go back",
            ),
            (format!("{view}exposed_us = [[1, 4]]\n"), 4, "as many"),
            (format!("taken = \"yesterday\"\n{view}"), 1, "2026-01-31"),
        ] {
            let said = complaint(&text);
            assert!(
                said.contains(&format!("frames.toml:{line}: ")) && said.contains(word),
                "{text}\n{said}"
            );
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let index = FrameIndex {
            poses: None,
            simulated: true,
            taken: Some("2026-01-31".parse().unwrap()),
            plan: "PLAN.toml".into(),
            head: Some("head.toml".into()),
            images: None,
            teeth: Some(vec![40]),
            grid: Some("84x7".into()),
            press_cycles: Some(7),
            tool_temperature_degc: Some(21.5),
            lit_ratios: vec![0.5, 0.25],
            view: vec![IndexedView {
                folder: "view-0001".into(),
                tooth: Some(40),
                rotation_rad: Some(-2.954_592_863_472_399),
                vertical_mm: Some(33.0),
                triggered_us: vec![[1, 2], [3, 4]],
                exposed_us: vec![[11, 12], [13, 14]],
                blake3: vec!["0".repeat(64), "f".repeat(64)],
            }],
        };
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(
            folder.path().join(FrameIndex::FILE),
            toml::to_string(&index).unwrap(),
        )
        .unwrap();
        assert_eq!(FrameIndex::load(folder.path()).unwrap().0, index);
    }
}
