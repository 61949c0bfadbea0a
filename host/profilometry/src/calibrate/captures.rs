//! Captures of a target made elsewhere: which folder of images shows what (`captures.toml`).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize};

use super::adjust::LEAST_VIEWS;
use super::target::Target;
use flankscope_foundation::textfile::{self, BadValue, TextFileError};

/// The manifest of a folder of captures. All folders named are relative to it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Captures {
    /// Patterns and exposures of every view, as `decode` takes them.
    #[serde(default = "default_plan")]
    pub plan: PathBuf,
    /// Images of the blank plate, facing the head.
    pub blank: PathBuf,
    /// Images of the spheres for a self-test, a folder for each of the target's places; without such, facing the head.
    #[serde(
        default,
        skip_serializing_if = "Vec::is_empty",
        deserialize_with = "one_or_more"
    )]
    pub sphere: Vec<PathBuf>,
    /// Views of printed plates.
    #[serde(default)]
    pub view: Vec<CapturedView>,
}

/// A view of a printed plate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CapturedView {
    /// Its images.
    pub folder: PathBuf,
    /// Plate of the target; the first is 1.
    pub plate: usize,
    /// Commanded angle of the rotary stage.
    pub rotation_rad: f64,
    /// Commanded height of the vertical stage.
    pub vertical_mm: f64,
    /// Takes no part in the adjustment and is measured with its result.
    #[serde(default)]
    pub kept_aside: bool,
}

/// A folder, or a list of them.
fn one_or_more<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<PathBuf>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "a folder, or a list of folders")]
    enum Folders {
        One(PathBuf),
        More(Vec<PathBuf>),
    }
    Ok(match Folders::deserialize(from)? {
        Folders::One(folder) => vec![folder],
        Folders::More(folders) => folders,
    })
}

fn default_plan() -> PathBuf {
    "PLAN.toml".into()
}

impl Captures {
    /// The manifest's name in its folder.
    pub const FILE: &str = "captures.toml";

    /// Reads a folder's manifest.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and what would be right: too few views, a plate that `target` does not have.
    pub fn load(folder: &Path, target: &Target) -> Result<Self, TextFileError> {
        let path = folder.join(Self::FILE);
        let check = |captures: &Self| captures.check(target);
        let (captures, _) = textfile::load_toml(&path, textfile::MAX_BYTES, check)?;
        Ok(captures)
    }

    #[rustfmt::skip]
    fn check(&self, target: &Target) -> Result<(), BadValue> {
        let adjusting = self.view.iter().filter(|view| !view.kept_aside).count();
        let (spheres, places) = (self.sphere.len(), target.spheres().len().max(1));
        textfile::require(&[
            (adjusting >= LEAST_VIEWS, "view", &adjusting, "must be at least 6 tables [[view]] without kept_aside"),
            ([0, places].contains(&spheres), "sphere", &spheres, "must be a folder for each [[test_place]] of the target"),
        ])?;
        for (index, CapturedView { plate, rotation_rad, vertical_mm, .. }) in self.view.iter().enumerate() {
            let key = |name: &str| format!("view[{index}].{name}");
            textfile::require(&[
                ((1..=target.plate.len()).contains(plate), &key("plate"), plate, "must be a plate of the target; the first is 1"),
                (rotation_rad.abs() < 1e3, &key("rotation_rad"), rotation_rad, "must be radians"),
                (vertical_mm.abs() < 1e4, &key("vertical_mm"), vertical_mm, "must be millimetres"),
            ])?;
        }
        Ok(())
    }

    /// The manifest's content.
    ///
    /// # Errors
    /// The writer's.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}
