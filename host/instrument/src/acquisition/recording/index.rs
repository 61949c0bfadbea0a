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

    fn check(&self) -> Result<(), BadValue> {
        if let Some(degc) = self.tool_temperature_degc
            && !(-273.15..=2000.0).contains(&degc)
        {
            let expected = "must be degrees Celsius";
            return Err(BadValue::new("tool_temperature_degc", degc, expected));
        }
        if self.lit_ratios.len() > MAX_FRINGE_SETS {
            let expected = "must be at most 12 passes";
            return Err(BadValue::new("lit_ratios", self.lit_ratios.len(), expected));
        }
        let is_none = |ratio: &&f64| !(**ratio > 0.0 && **ratio <= 1.0);
        if let Some(ratio) = self.lit_ratios.iter().find(is_none) {
            let expected = "must be shares of all mirrors' light, above 0 and at most 1";
            return Err(BadValue::new("lit_ratios", ratio, expected));
        }
        Ok(())
    }
}

impl IndexedView {
    /// Checks its entries; `at` is its position in the index.
    fn check(&self, at: usize) -> Result<(), BadValue> {
        let bad = |name: &str, got: &dyn std::fmt::Debug, expected| {
            Err(BadValue::new(format!("view[{at}].{name}"), got, expected))
        };
        if self.tooth.is_none() && self.rotation_rad.is_none() {
            let expected = "must name the tooth in the middle, or the angle in rotation_rad";
            return bad("tooth", &"nothing", expected);
        }
        if let Some(angle) = self.rotation_rad
            && !within(angle, FARTHEST_RAD)
        {
            return bad("rotation_rad", &angle, "must be radians");
        }
        if let Some(height) = self.vertical_mm
            && !within(height, LONGEST_MM)
        {
            return bad("vertical_mm", &height, "must be millimetres");
        }
        if !stays_inside(&self.folder) {
            let expected = "must be a folder in that of the images, without ..; name another place by images = \"DIR\"";
            return bad("folder", &self.folder, expected);
        }
        let clocks = [
            ("triggered_us", &self.triggered_us),
            ("exposed_us", &self.exposed_us),
        ];
        for (name, times) in clocks {
            let forward = times.iter().all(|[start, end]| start <= end)
                && times.windows(2).all(|pair| pair[0][1] <= pair[1][0]);
            if !forward {
                let expected = "must be start and end of every frame, each after the one before";
                return bad(name, &"times that go back", expected);
            }
        }
        if self.triggered_us.len() != self.exposed_us.len() {
            let expected = "must have as many entries as triggered_us";
            return bad("exposed_us", &self.exposed_us.len(), expected);
        }
        let is_hash =
            |text: &String| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
        match self.blake3.iter().find(|text| !is_hash(text)) {
            Some(text) => bad("blake3", text, "must be 64 hexadecimal digits"),
            None => Ok(()),
        }
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
