//! `clouds.toml`: position of the stages for each view of a folder of recorded clouds.

use std::path::PathBuf;

use flankscope_foundation::date::Date;
use flankscope_foundation::textfile::{self, BadValue};
use flankscope_metrology::io::Unit;
use serde::{Deserialize, Serialize};

use flankscope_instrument::acquisition::{IndexedView, RecordedIndex, stays_inside};

/// The index of a folder of clouds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloudIndex {
    /// Whether the clouds show no real die.
    pub simulated: bool,
    /// Day of capture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taken: Option<Date>,
    /// Head file of the head that captured the clouds, relative to the index.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub head: Option<PathBuf>,
    /// Unit of the clouds; cloud formats do not state it.
    #[serde(default)]
    pub unit: Unit,
    /// Standard uncertainty of a point along its ray, µm, for clouds that do not state it point by point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_um: Option<f64>,
    /// Grid of the scan that the views belong to, as `scan --views` takes it; by default the scan consists of these views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub grid: Option<String>,
    /// The views, in the order of capture.
    #[serde(default)]
    pub view: Vec<IndexedCloud>,
}

/// One view: position of the stages, and its cloud.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IndexedCloud {
    /// Its cloud in the camera's frame, in the index's folder.
    pub file: PathBuf,
    /// Tooth in its middle. Without `rotation_rad`, the angle follows from the drawing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tooth: Option<u32>,
    /// Commanded angle of the rotary stage, rad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_rad: Option<f64>,
    /// Commanded height of the vertical stage, mm; by default the viewing height in the tool file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertical_mm: Option<f64>,
    /// BLAKE3 of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blake3: Option<String>,
}

/// Range of plausible standard uncertainties of a point, µm.
const SIGMA_UM: [f64; 2] = [1e-3, 1e3];

impl RecordedIndex for CloudIndex {
    const FILE: &'static str = "clouds.toml";

    fn places(&self) -> Vec<IndexedView> {
        let place = |of: &IndexedCloud| IndexedView {
            tooth: of.tooth,
            rotation_rad: of.rotation_rad,
            vertical_mm: of.vertical_mm,
            blake3: of.blake3.iter().cloned().collect(),
            ..IndexedView::default()
        };
        self.view.iter().map(place).collect()
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let sigma_um = self.sigma_um.unwrap_or(1.0);
        let in_range = (SIGMA_UM[0]..=SIGMA_UM[1]).contains(&sigma_um);
        textfile::require(&[(in_range, "sigma_um", &sigma_um, "must be micrometres, 0.001 to 1000")])?;
        for (at, IndexedCloud { file, .. }) in self.view.iter().enumerate() {
            let key = format!("view[{at}].file");
            textfile::require(&[(stays_inside(file), &key, file, "must be a file in the folder of clouds.toml, without ..")])?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mistake_is_named_with_its_line_and_what_would_be_right() {
        let view = "simulated = true\n[[view]]\nfile = \"a.ply\"\ntooth = 40\n";
        for (text, line, word) in [
            ("simulated = true\n".to_owned(), 1, "[[view]]"),
            (
                "simulated = true\n[[view]]\ntooth = 40\n".to_owned(),
                2,
                "file",
            ),
            (
                "simulated = true\n[[view]]\nfile = \"a.ply\"\n".to_owned(),
                2,
                "rotation_rad",
            ),
            (view.replace("a.ply", "../a.ply"), 3, "without .."),
            (view.replace("a.ply", "/a.ply"), 3, "without .."),
            (format!("{view}vertical_mm = nan\n"), 5, "millimetres"),
            (format!("{view}blake3 = \"12\"\n"), 5, "64 hexadecimal"),
            (format!("{view}folder = \"a\"\n"), 5, "vertical_mm"),
            (format!("sigma_um = 0.0\n{view}"), 1, "micrometres"),
            (format!("sigma_um = nan\n{view}"), 1, "micrometres"),
            (format!("unit = \"furlong\"\n{view}"), 1, "inch"),
        ] {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join(CloudIndex::FILE), &text).unwrap();
            let said = CloudIndex::load(folder.path()).unwrap_err().to_string();
            assert!(
                said.contains(&format!("clouds.toml:{line}: ")) && said.contains(word),
                "{text}\n{said}"
            );
        }
    }
}
