//! The artefact: plates with printed dots where the die sits (`target.toml`, see `docs/formats/target.md`).

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::sighting::StagePose;
use crate::head::{Limits, RigidTransform};
use flankscope_foundation::textfile::{self, BadValue, TextFileError};

/// Plates and a sphere on a carrier that sits where the die does. Millimetres, radians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Free text.
    pub name: String,
    /// Exposure at which the white of the plates comes near saturation but does not reach it.
    pub exposure_us: u32,
    /// Height of the vertical stage at which the head is out of the target.
    pub retract_mm: f64,
    /// Standard uncertainty of each plate's place, from its certificate.
    pub pose_sigma_mm: f64,
    /// Standard uncertainty of each plate's orientation.
    pub pose_sigma_rad: f64,
    /// Places of plane and spheres in a self-test, one after the other; empty: `blank` and `sphere` in the middle.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub test_place: Vec<TestPlace>,
    /// Dots printed on the plates.
    pub dots: Dots,
    /// A white plate without print: shows the cores, and how evenly the head lights.
    pub blank: Plate,
    /// The printed plates.
    pub plate: Vec<Plate>,
    /// Further plates without print, for the self-test.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub test_blank: Vec<Plate>,
    /// A matt sphere for the self-test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// Further ones, with a partner or without.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub test_sphere: Vec<Sphere>,
    /// Limits of the self-test.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limits: Option<Limits>,
    /// Stage offsets from the position facing a printed plate, one view each; the last view is kept aside.
    #[serde(default = "beside_of_10_mm")]
    pub beside: Vec<StageOffset>,
}

/// For a field of 10 mm, 41.5 mm from the axis.
fn beside_of_10_mm() -> Vec<StageOffset> {
    [(0.05, 0.8), (-0.05, -0.8), (0.02, -0.4)]
        .map(|(turned_rad, raised_mm)| StageOffset {
            turned_rad,
            raised_mm,
        })
        .to_vec()
}

/// A square grid of dark dots, centred on the plate; three of them are larger and mark the middle: those at column and row
/// (0, 0), (2, 0) and (0, 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dots {
    /// From dot to dot.
    pub pitch_mm: f64,
    /// Diameter of a dot.
    pub diameter_mm: f64,
    /// Diameter of the three larger ones.
    pub key_diameter_mm: f64,
}

/// Places of the three larger dots, in pitches.
pub const KEYS: [[i32; 2]; 3] = [[0, 0], [2, 0], [0, 1]];

/// Allowed number of views of a plate: at least one for the adjustment and one kept aside.
const BESIDE: std::ops::RangeInclusive<usize> = 2..=16;

impl Dots {
    /// Radius of the dot at a column and row.
    pub fn radius_mm(&self, place: [i32; 2]) -> f64 {
        let key = KEYS.contains(&place);
        0.5 * if key {
            self.key_diameter_mm
        } else {
            self.diameter_mm
        }
    }
}

/// One plate. Its frame lies in its surface with z out of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plate {
    /// Its pose in the tool frame.
    pub tool_from_plate: RigidTransform,
}

/// Offset of the stages from another position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageOffset {
    /// Rotation.
    pub turned_rad: f64,
    /// Height.
    pub raised_mm: f64,
}

/// A place of a self-test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TestPlace {
    /// Rotation of the stages from the position facing plane or spheres.
    pub turned_rad: f64,
    /// Their height from there.
    pub raised_mm: f64,
    /// Plate without print: 1 is `blank`, 2 the first `test_blank`.
    #[serde(default = "first", skip_serializing_if = "is_first")]
    pub blank: usize,
    /// Sphere or pair of spheres: 1 is `sphere`, 2 the first `test_sphere`.
    #[serde(default = "first", skip_serializing_if = "is_first")]
    pub sphere: usize,
}

fn first() -> usize {
    1
}

fn is_first(number: &usize) -> bool {
    *number == 1
}

impl TestPlace {
    /// Facing `blank` and `sphere`.
    pub const MIDDLE: Self = Self {
        turned_rad: 0.0,
        raised_mm: 0.0,
        blank: 1,
        sphere: 1,
    };

    fn offset(&self) -> StageOffset {
        StageOffset {
            turned_rad: self.turned_rad,
            raised_mm: self.raised_mm,
        }
    }
}

/// A sphere or a pair, and how it is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereAt {
    /// The sphere or pair.
    pub sphere: Sphere,
    /// Positions of the stages.
    pub stood: StagePose,
}

/// A sphere.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    /// Certified diameter.
    pub diameter_mm: f64,
    /// Another one in the same field, at a certified distance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub partner: Option<Partner>,
}

/// The other sphere of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Partner {
    /// Its centre in the tool frame.
    pub centre_mm: [f64; 3],
    /// Certified diameter.
    pub diameter_mm: f64,
    /// Certified distance of the two centres.
    pub spacing_mm: f64,
}

impl Sphere {
    /// Point to be placed in the middle of the field: the centre of the sphere, or the midpoint of the pair.
    #[must_use]
    pub fn middle_mm(&self) -> [f64; 3] {
        let other = self.partner.map_or(self.centre_mm, |of| of.centre_mm);
        [0, 1, 2].map(|k| 0.5 * (self.centre_mm[k] + other[k]))
    }

    /// Centre and certified diameter of each.
    pub(crate) fn each(&self) -> impl Iterator<Item = ([f64; 3], f64)> {
        let partner = self.partner.map(|of| (of.centre_mm, of.diameter_mm));
        std::iter::once((self.centre_mm, self.diameter_mm)).chain(partner)
    }

    /// Checks the values of what the file calls `name`.
    #[rustfmt::skip]
    fn check(&self, name: &str) -> Result<(), BadValue> {
        let keys = [name.to_owned(), format!("{name}.partner")];
        for (key, (centre_mm, diameter_mm)) in keys.iter().zip(self.each()) {
            let is_near = centre_mm.iter().all(|x| x.abs() < 1e4);
            textfile::require(&[
                (diameter_mm > 0.0 && diameter_mm < 1e3, &format!("{key}.diameter_mm"), &diameter_mm, "must be positive millimetres"),
                (is_near, &format!("{key}.centre_mm"), &centre_mm, "must be finite millimetres"),
            ])?;
        }
        let Some(partner) = self.partner else {
            return Ok(());
        };
        let apart = |k: usize| partner.centre_mm[k] - self.centre_mm[k];
        let drawn_mm = (0..3).map(|k| apart(k).powi(2)).sum::<f64>().sqrt();
        let touching_mm = 0.5 * (self.diameter_mm + partner.diameter_mm);
        let (key, spacing_mm) = (format!("{name}.partner.spacing_mm"), partner.spacing_mm);
        textfile::require(&[
            (spacing_mm > touching_mm, &key, &spacing_mm, "must be the distance of the centres of two spheres that do not touch"),
            ((spacing_mm - drawn_mm).abs() <= PARTNER_OFF_MM, &key, &spacing_mm, "must agree with the two centres to 0.1 mm"),
        ])
    }
}

/// A bar's drawing agrees with its certificate so well.
const PARTNER_OFF_MM: f64 = 0.1;
/// A self-test takes minutes, not a shift.
const MOST_TEST_PLACES: usize = 32;

impl Target {
    /// Reads `target.toml`.
    ///
    /// # Errors
    /// [`TextFileError`] with file, line and what would be right.
    pub fn load(path: &Path) -> Result<Self, TextFileError> {
        let (target, _) = textfile::load_toml(path, textfile::MAX_BYTES, Self::check)?;
        Ok(target)
    }

    /// The content of a `target.toml`.
    ///
    /// # Errors
    /// The writer's.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }

    fn test_places(&self) -> Vec<TestPlace> {
        match &self.test_place[..] {
            [] => vec![TestPlace::MIDDLE],
            places => places.to_vec(),
        }
    }

    /// Stage positions in front of plates without print in a self-test, one after the other.
    #[must_use]
    pub fn planes(&self) -> Vec<StagePose> {
        let plates = [&[self.blank][..], &self.test_blank].concat();
        let stood = |place: TestPlace| {
            let plate = plates.get(place.blank.checked_sub(1)?)?;
            let facing = StagePose::before(plate.tool_from_plate.translation_mm);
            Some(facing.beside(place.offset()))
        };
        self.test_places().into_iter().filter_map(stood).collect()
    }

    /// The same before spheres; none without `sphere`.
    #[must_use]
    pub fn spheres(&self) -> Vec<SphereAt> {
        let Some(first) = self.sphere else {
            return Vec::new();
        };
        let spheres = [&[first][..], &self.test_sphere].concat();
        let seen = |place: TestPlace| {
            let sphere = *spheres.get(place.sphere.checked_sub(1)?)?;
            let facing = StagePose::before(sphere.middle_mm());
            let stood = facing.beside(place.offset());
            Some(SphereAt { sphere, stood })
        };
        self.test_places().into_iter().filter_map(seen).collect()
    }

    #[rustfmt::skip]
    fn check(&self) -> Result<(), BadValue> {
        let Dots { pitch_mm, diameter_mm, key_diameter_mm } = self.dots;
        // False for a NaN.
        let within = |got: f64, low: f64, high: f64| got > low && got < high;
        let small = "must be positive and small: the plate's certificate says how well it is known";
        textfile::require(&[
            (within(pitch_mm, 0.0, 1e3), "dots.pitch_mm", &pitch_mm, "must be positive millimetres"),
            (within(diameter_mm, 0.0, 0.7 * pitch_mm), "dots.diameter_mm", &diameter_mm, "must be positive and at most 0.7 of the pitch"),
            (within(key_diameter_mm, 1.25 * diameter_mm, 0.85 * pitch_mm), "dots.key_diameter_mm", &key_diameter_mm, "must exceed the other dots by a quarter, and be at most 0.85 of the pitch"),
            (within(self.pose_sigma_mm, 0.0, 1.0), "pose_sigma_mm", &self.pose_sigma_mm, small),
            (within(self.pose_sigma_rad, 0.0, 0.1), "pose_sigma_rad", &self.pose_sigma_rad, small),
            (within(self.retract_mm, -1e4, 1e4), "retract_mm", &self.retract_mm, "must be millimetres"),
            (self.exposure_us > 0, "exposure_us", &self.exposure_us, "must be positive microseconds"),
        ])?;
        self.blank.tool_from_plate.check("blank.tool_from_plate")?;
        for (index, plate) in self.plate.iter().enumerate() {
            plate.tool_from_plate.check(&format!("plate[{index}].tool_from_plate"))?;
        }
        let places = self.test_place.len();
        textfile::require(&[(places <= MOST_TEST_PLACES, "test_place", &places, "must be at most 32 tables [[test_place]]")])?;
        for (index, plate) in self.test_blank.iter().enumerate() {
            plate.tool_from_plate.check(&format!("test_blank[{index}].tool_from_plate"))?;
        }
        if let Some(sphere) = &self.sphere {
            sphere.check("sphere")?;
        }
        for (index, sphere) in self.test_sphere.iter().enumerate() {
            sphere.check(&format!("test_sphere[{index}]"))?;
        }
        let blanks = 1 + self.test_blank.len();
        let spheres = usize::from(self.sphere.is_some()) + self.test_sphere.len();
        for (index, TestPlace { blank, sphere, .. }) in self.test_place.iter().enumerate() {
            let key = |of: &str| format!("test_place[{index}].{of}");
            textfile::require(&[
                ((1..=blanks).contains(blank), &key("blank"), blank, "must be 1 for [blank], 2 for the first [[test_blank]] and so on"),
                ((1..=spheres.max(1)).contains(sphere), &key("sphere"), sphere, "must be 1 for [sphere], 2 for the first [[test_sphere]] and so on"),
            ])?;
        }
        let (more, beside) = (self.test_sphere.len(), self.beside.len());
        textfile::require(&[
            (self.sphere.is_some() || more == 0, "test_sphere", &more, "must be 0 without a [sphere], which is the first"),
            (BESIDE.contains(&beside), "beside", &beside, "must be 2 to 16 places, the last for the view that is kept aside"),
        ])?;
        let small = ["must be radians, less than 0.5 to either side", "must be millimetres, less than 50 up or down"];
        let any = ["must be -1 to 1 rad", "must be millimetres"];
        let test_places: Vec<_> = self.test_place.iter().map(TestPlace::offset).collect();
        for (name, places, [most_rad, most_mm], [turned, raised]) in [
            ("test_place", &test_places, [0.5, 50.0], small),
            ("beside", &self.beside, [1.0, 1e3], any),
        ] {
            for (index, StageOffset { turned_rad, raised_mm }) in places.iter().enumerate() {
                let key = |of: &str| format!("{name}[{index}].{of}");
                textfile::require(&[
                    (within(*turned_rad, -most_rad, most_rad), &key("turned_rad"), turned_rad, turned),
                    (within(*raised_mm, -most_mm, most_mm), &key("raised_mm"), raised_mm, raised),
                ])?;
            }
        }
        self.limits.as_ref().map_or(Ok(()), Limits::check)
    }
}
