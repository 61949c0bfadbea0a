//! What `flankscope init` writes of a tool that is no gear: faces of its CAD, each named by a point on it.

use std::fmt::Write as _;
use std::str::FromStr;

use anyhow::{Context, bail, ensure};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::patch::{
    Patch, PatchError, PatchSpec, Patches, Pick, RIM_MM, SEED_ANGLE_DEG,
};
use flankscope_metrology::surface::Surface;
use flankscope_metrology::wear::AREA_MM2;
use serde::Serialize;

/// Half the side of a judged square about its point, mm, the first that fits: what one view of a 10 mm field surely shows, down to what
/// holds the disc of the measurand.
const HALF_SIDES_MM: [f64; 4] = [2.0, 1.5, 1.0, 0.5];

/// A face by a point on it: `X,Y,Z` in mm, or `NAME=X,Y,Z`.
#[derive(Clone, Debug, PartialEq)]
pub struct FacePoint {
    name: Option<String>,
    at_mm: [f64; 3],
}

impl FromStr for FacePoint {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let (name, at) = match text.rsplit_once('=') {
            Some((name, at)) => (Some(name.trim().to_owned()), at),
            None => (None, text),
        };
        let numbers: Result<Vec<f64>, _> = at.split(',').map(|part| part.trim().parse()).collect();
        let numbers = numbers.ok().and_then(|numbers| numbers.try_into().ok());
        let at_mm: [f64; 3] =
            numbers.with_context(|| format!("{at:?} is no point; right would be X,Y,Z in mm"))?;
        ensure!(
            at_mm.iter().all(|mm| mm.is_finite()),
            "{at:?}: coordinates are finite numbers, in mm"
        );
        Ok(Self { name, at_mm })
    }
}

/// A face as the report of the command has it.
#[derive(Serialize)]
pub struct FaceReport<'a> {
    name: &'a str,
    judged: bool,
    origin_mm: [f64; 3],
    normal: [f64; 3],
    zone_mm: [[f64; 2]; 2],
    area_mm2: f64,
}

/// The faces of a tool, laid out on its CAD.
pub struct Faces {
    specs: Vec<PatchSpec>,
    patches: Patches,
    /// Largest distance of the judged facets from the surface that they stand for.
    pub chord_error_mm: f64,
}

impl Faces {
    /// Lays them out, each judged one with the largest square about its point that lies on it, on all the datums.
    ///
    /// # Errors
    /// A point off the CAD, a face that is no patch or too small, two points on one face.
    pub fn new(judged: &[FacePoint], datums: &[FacePoint], mesh: &TriMesh) -> anyhow::Result<Self> {
        let surface = Surface::new(mesh)?;
        let named = |points: &[FacePoint], what: &str| -> Vec<(String, [f64; 3])> {
            let numbered = (1..).zip(points);
            let name = |(number, point): (usize, &FacePoint)| {
                let name = point.name.clone();
                (
                    name.unwrap_or_else(|| format!("{what} {number}")),
                    point.at_mm,
                )
            };
            numbered.map(name).collect()
        };
        let (judged, datums) = (named(judged, "patch"), named(datums, "datum"));
        let pick = |at_mm: [f64; 3]| Pick::Seed(at_mm, SEED_ANGLE_DEG.to_radians());
        let spec = |name: &str, at_mm| PatchSpec {
            name: name.to_owned(),
            pick: pick(at_mm),
            box_mm: None,
            origin_mm: None,
            up: None,
            zone_mm: None,
            datum: Vec::new(),
        };
        let square = |half_mm: f64| Some([[-half_mm, half_mm]; 2]);
        let mut sizes = vec![0; judged.len()];
        loop {
            let specs = |rim_mm: f64| -> Vec<PatchSpec> {
                let of_judged = judged
                    .iter()
                    .zip(&sizes)
                    .map(|((name, at_mm), size)| PatchSpec {
                        origin_mm: Some(*at_mm),
                        zone_mm: square(HALF_SIDES_MM[*size] + rim_mm),
                        datum: datums.iter().map(|(name, _)| name.clone()).collect(),
                        ..spec(name, *at_mm)
                    });
                let of_datums = datums.iter().map(|(name, at_mm)| spec(name, *at_mm));
                of_judged.chain(of_datums).collect()
            };
            // A rim stays free, as stages place no view better.
            match Patches::new(&specs(RIM_MM), mesh, &surface, AREA_MM2) {
                Ok(_) => {}
                Err(PatchError::ZoneOffPatch { name, .. }) => {
                    let at = judged.iter().position(|(other, _)| *other == name);
                    let size = at.and_then(|at| sizes.get_mut(at));
                    let smaller = size.filter(|size| **size + 1 < HALF_SIDES_MM.len());
                    let Some(smaller) = smaller else {
                        bail!(
                            "patch {name:?}: no square of {} mm about its point lies on the face, with {RIM_MM} mm to its rim; take a point \
                             farther inside, or a larger face",
                            2.0 * HALF_SIDES_MM[HALF_SIDES_MM.len() - 1]
                        );
                    };
                    *smaller += 1;
                    continue;
                }
                Err(error) => return Err(error.into()),
            }
            let specs = specs(0.0);
            let patches = Patches::new(&specs, mesh, &surface, AREA_MM2)?;
            let of_judged = patches
                .judged()
                .into_iter()
                .filter_map(|number| patches.get(number));
            let chord_error_mm = of_judged
                .map(|patch| patch.chord_error_mm(mesh))
                .fold(0.0, f64::max);
            return Ok(Self {
                specs,
                patches,
                chord_error_mm,
            });
        }
    }

    fn laid_out(&self) -> impl Iterator<Item = &Patch> {
        (1..).map_while(|number| self.patches.get(number))
    }

    /// The `[[patch]]` tables.
    pub fn toml(&self) -> String {
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let mut toml = String::new();
        for spec in &self.specs {
            let Pick::Seed(at_mm, _) = &spec.pick else {
                continue;
            };
            let _ = write!(
                toml,
                "[[patch]]\nname = {}\nseed_mm = {at_mm:?}\n",
                quoted(&spec.name)
            );
            if let (Some(origin_mm), Some(zone_mm)) = (spec.origin_mm, spec.zone_mm) {
                let datum: Vec<String> = spec.datum.iter().map(|name| quoted(name)).collect();
                let _ = write!(
                    toml,
                    "origin_mm = {origin_mm:?}\nzone_mm = {zone_mm:?}   # judged rectangle, along and up from the origin\ndatum = [{}]   # \
                     the press does not touch these\n",
                    datum.join(", ")
                );
            }
            toml += "\n";
        }
        toml
    }

    /// For the report as JSON.
    pub fn report(&self) -> Vec<FaceReport<'_>> {
        let report = |patch| {
            let Patch {
                name,
                origin_mm,
                axes,
                zone_mm,
                area_mm2,
                ..
            }: &Patch = patch;
            FaceReport {
                name,
                judged: patch.is_judged(),
                origin_mm: *origin_mm,
                normal: axes[2],
                zone_mm: *zone_mm,
                area_mm2: *area_mm2,
            }
        };
        self.laid_out().map(report).collect()
    }

    /// A line of each for the terminal.
    pub fn told(&self) -> String {
        let line = |patch: &Patch| {
            let [x, y, z] = patch.axes[2];
            let part = if patch.is_judged() {
                let [[left, right], [low, high]] = patch.zone_mm;
                format!(
                    "judged on {:.1} x {:.1} mm about its point",
                    right - left,
                    high - low
                )
            } else {
                "datum".to_owned()
            };
            format!(
                "{}: {part}, face of {:.1} mm2 towards ({x:.2}, {y:.2}, {z:.2})\n",
                patch.name, patch.area_mm2
            )
        };
        self.laid_out().map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_is_named_by_a_point_with_or_without_a_name() {
        let face = |text: &str| text.parse::<FacePoint>().map_err(|error| error.to_string());
        let at_mm = [-1.0, 2.5, 3e1];
        let name = Some("a=b".to_owned());
        assert_eq!(face("-1,2.5,3e1"), Ok(FacePoint { name: None, at_mm }));
        assert_eq!(face("a=b = -1, 2.5, 30"), Ok(FacePoint { name, at_mm }));
        for wrong in ["", "1,2", "1,2,3,4", "boss", "boss=", "1;2;3"] {
            assert!(face(wrong).unwrap_err().contains("X,Y,Z in mm"), "{wrong}");
        }
        assert!(face("1,nan,3").unwrap_err().contains("finite"));
    }
}
