//! The `[[patch]]` tables of a tool file.

use std::path::Path;

use super::{Inspect, ToolError};
use crate::patch::{PatchSpec, Pick, SEED_ANGLE_DEG};

/// Facets that lean farther from a seed lean too far from the patch's normal, too.
const MOST_SEED_ANGLE_DEG: f64 = 45.0;

/// One `[[patch]]` table.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PatchFile {
    #[serde(deserialize_with = "flankscope_foundation::display::name")]
    name: String,
    seed_mm: Option<[f64; 3]>,
    angle_deg: Option<f64>,
    facets: Option<Vec<u32>>,
    box_mm: Option<[[f64; 3]; 2]>,
    origin_mm: Option<[f64; 3]>,
    up: Option<[f64; 3]>,
    zone_mm: Option<[[f64; 2]; 2]>,
    #[serde(default)]
    datum: Vec<String>,
}

impl PatchFile {
    /// The patch that the table describes.
    ///
    /// # Errors
    /// More or less than one way to name facets.
    pub fn spec(self, tool: &Path) -> Result<PatchSpec, ToolError> {
        let wrong = |what: String| ToolError::PatchFacets {
            path: tool.to_owned(),
            name: self.name.clone(),
            what,
        };
        if self.angle_deg.is_some() && self.seed_mm.is_none() {
            return Err(wrong(
                "angle_deg is that of seed_mm, which is missing".into(),
            ));
        }
        let angle_deg = self.angle_deg.unwrap_or(SEED_ANGLE_DEG);
        if !(0.0..=MOST_SEED_ANGLE_DEG).contains(&angle_deg) {
            return Err(wrong(format!(
                "angle_deg = {angle_deg} is out of range; right would be 0 to {MOST_SEED_ANGLE_DEG}"
            )));
        }
        let pick = match (self.seed_mm, self.facets) {
            (Some(_), Some(_)) => return Err(wrong("seed_mm and facets: one of them".into())),
            (Some(at), None) => Pick::Seed(at, angle_deg.to_radians()),
            (None, Some(facets)) => Pick::Facets(facets),
            (None, None) if self.box_mm.is_some() => Pick::All,
            (None, None) => {
                return Err(wrong("one of seed_mm, facets and box_mm is needed".into()));
            }
        };
        Ok(PatchSpec {
            name: self.name,
            pick,
            box_mm: self.box_mm,
            origin_mm: self.origin_mm,
            up: self.up,
            zone_mm: self.zone_mm,
            datum: self.datum,
        })
    }
}

/// Keys that a file with patches must not have: they describe teeth.
///
/// # Errors
/// The first such key.
pub(super) fn without_teeth(path: &Path, inspect: &Inspect) -> Result<(), ToolError> {
    let said = [
        ("teeth", !inspect.teeth.is_empty()),
        ("height_mm", !inspect.height_mm.is_nan()),
        ("zone_radius_mm", inspect.zone_radius_mm.is_some()),
        (
            "zone_height_mm",
            inspect.zone_height_mm != super::default_zone_height(),
        ),
        ("tip_warn_mm", inspect.tip_warn_mm.is_some()),
        ("tip_limit_mm", inspect.tip_limit_mm.is_some()),
        ("datum", inspect.datum != super::Datum::default()),
        ("datum_height_mm", !inspect.datum_height_mm.is_empty()),
        ("as_built_class", inspect.as_built_class.is_some()),
        ("as_built_scan", inspect.as_built_scan.is_some()),
    ];
    match said.into_iter().find(|(_, said)| *said) {
        None => Ok(()),
        Some((key, _)) => Err(ToolError::OfTeeth {
            path: path.to_owned(),
            key,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(table: &str) -> Result<PatchSpec, String> {
        let file: PatchFile = toml::from_str(&format!("name = \"face\"\n{table}")).unwrap();
        file.spec(Path::new("tool.toml"))
            .map_err(|error| error.to_string())
    }

    #[test]
    fn facets_are_named_in_one_way() {
        let seed = spec("seed_mm = [1.0, 2.0, 3.0]\ndatum = [\"rim\"]").unwrap();
        let usual = SEED_ANGLE_DEG.to_radians();
        assert_eq!(seed.pick, Pick::Seed([1.0, 2.0, 3.0], usual));
        assert_eq!(seed.datum, ["rim"]);
        let facets = spec("facets = [4, 7]\nbox_mm = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]").unwrap();
        assert_eq!(facets.pick, Pick::Facets(vec![4, 7]));
        let boxed = spec("box_mm = [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]").unwrap();
        assert_eq!(boxed.pick, Pick::All);
        for (table, hint) in [
            ("", "one of seed_mm, facets and box_mm is needed"),
            (
                "seed_mm = [1.0, 2.0, 3.0]\nfacets = [4]",
                "seed_mm and facets",
            ),
            ("facets = [4]\nangle_deg = 5.0", "seed_mm, which is missing"),
            (
                "seed_mm = [1.0, 2.0, 3.0]\nangle_deg = nan",
                "right would be 0 to 45",
            ),
            (
                "seed_mm = [1.0, 2.0, 3.0]\nangle_deg = 46.0",
                "right would be 0 to 45",
            ),
        ] {
            let said = spec(table).unwrap_err();
            assert!(said.contains(hint) && said.contains("\"face\""), "{said}");
        }
    }

    #[test]
    fn what_is_said_of_teeth_is_refused_beside_patches() {
        let beside = |line: &str| {
            let table = format!("warn_um = 30.0\nlimit_um = 50.0\n{line}");
            let inspect: Inspect = toml::from_str(&table).unwrap();
            without_teeth(Path::new("tool.toml"), &inspect)
        };
        assert!(beside("wear_area_mm2 = 0.3").is_ok());
        for line in [
            "teeth = [1]",
            "height_mm = 33.0",
            "zone_radius_mm = [40.0, 41.0]",
            "zone_height_mm = [-3.0, 3.0]",
            "tip_warn_mm = 0.2",
            "tip_limit_mm = 0.2",
            "datum = \"lands\"",
            "as_built_class = 7",
            "as_built_scan = \"new.json\"",
        ] {
            let said = beside(line).unwrap_err().to_string();
            let key = line.split(' ').next().unwrap_or_default();
            assert!(
                said.contains(&format!("inspect.{key} is said of")),
                "{said}"
            );
        }
    }
}
