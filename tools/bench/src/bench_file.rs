//! The bench file (`--bench FILE`): all settings of the simulated bench without an option on the command line.
//!
//! One TOML file, described in docs/formats/bench.md; `flankscope bench example` writes one with every key, its unit and
//! its default ([`EXAMPLE`]).

use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize};

use crate::camera::FrameFault;
use crate::demo::OtherDie;
use crate::devices::stage::{AxisModels, NO_MEMORY};
use crate::given::Given;
use crate::link::Trouble;
use crate::world::{MAX_BOUNCES, Saw, SprayEdge};

/// A bench file with every key: those with a default set to it, the others commented out.
pub const EXAMPLE: &str = include_str!("bench_file.toml");

/// Largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Contents of a bench file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BenchFile {
    /// The die and its placement.
    pub die: DieTable,
    /// Its surface, in addition to `--surface`.
    pub surface: SurfaceTable,
    /// Motion between head and die while frames are exposed.
    pub motion: MotionTable,
    /// Rotary and vertical stage.
    pub stages: StagesTable,
    /// Optics of the head.
    pub head: HeadTable,
    pub camera: CameraTable,
    pub press: PressTable,
}

/// Shape of the die and its placement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DieTable {
    /// Largest minus smallest radius of the bore, um.
    #[serde(deserialize_with = "form_um")]
    pub ovality_um: f64,
    /// Growth of the bore's radius from bottom to top, um.
    #[serde(deserialize_with = "form_um")]
    pub taper_um: f64,
    /// Largest minus smallest radius of three lobes around the bore, um.
    #[serde(deserialize_with = "form_um")]
    pub three_lobe_um: f64,
    /// Growth of the bore's radius from its ends to mid-height, um.
    #[serde(deserialize_with = "form_um")]
    pub barrel_um: f64,
    /// Growth of the bore's radius at the upper end, over the last quarter of its height, um.
    #[serde(deserialize_with = "form_um")]
    pub bell_mouth_um: f64,
    /// Standard deviation of the flanks' manufacturing error along the pitch circle, um.
    #[serde(deserialize_with = "spread_um")]
    pub flanks_um: f64,
    /// Seed of that error; each seed is another die.
    pub flanks_seed: u64,
    /// Rotation of the die on the table, degrees.
    #[serde(deserialize_with = "turn_deg")]
    pub turned_deg: f64,
    /// Rotation of the die on the table, in whole teeth.
    pub turned_teeth: i32,
    /// Standard deviation of the die's shift along each axis since it was put down, and of the rim's by a turn about each axis, µm.
    #[serde(deserialize_with = "spread_um")]
    pub moved_um: f64,
    /// Another die instead of the tool file's, `TEETHxMODULE_MM`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub other: Option<Given<OtherDie>>,
}

impl Default for DieTable {
    /// The die as drawn.
    fn default() -> Self {
        Self {
            ovality_um: 0.0,
            taper_um: 0.0,
            three_lobe_um: 0.0,
            barrel_um: 0.0,
            bell_mouth_um: 0.0,
            flanks_um: 0.0,
            flanks_seed: 1,
            turned_deg: 0.0,
            turned_teeth: 0,
            moved_um: 0.0,
            other: None,
        }
    }
}

/// Surface of the die, in addition to `--surface`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceTable {
    /// Height above which the die is sprayed, mm.
    #[serde(
        deserialize_with = "height_mm",
        skip_serializing_if = "Option::is_none"
    )]
    pub sprayed_above_mm: Option<f64>,
    /// Mean thickness of the layer on the die, um.
    #[serde(deserialize_with = "film_um")]
    pub film_um: f64,
    /// Largest number of reflections at the die on the light's way from projector to camera.
    #[serde(deserialize_with = "bounces", skip_serializing_if = "Option::is_none")]
    pub bounces: Option<u32>,
}

impl SurfaceTable {
    /// Edge of the spray, if a height is given.
    pub fn spray_edge(&self) -> Option<SprayEdge> {
        /// Roughness of the edge of sprayed paint, mm.
        const RAGGED_MM: f64 = 0.15;
        self.sprayed_above_mm.map(|above_mm| SprayEdge {
            above_mm,
            ragged_mm: RAGGED_MM,
        })
    }
}

/// Motion between head and die while frames are exposed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionTable {
    /// Standard deviation of the shift from frame to frame, um.
    #[serde(deserialize_with = "spread_um")]
    pub vibration_um: f64,
    /// Standard deviation of the shift within a frame, which blurs the fringes, um.
    #[serde(deserialize_with = "spread_um")]
    pub shiver_um: f64,
}

/// Rotary and vertical stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StagesTable {
    /// Backlash of the rotary stage, mdeg: the table lags by half of it.
    #[serde(deserialize_with = "play")]
    pub backlash_mdeg: f64,
    /// Backlash of the vertical stage, µm.
    #[serde(deserialize_with = "play")]
    pub backlash_um: f64,
    /// Largest change of the rotary stage's error from approach to approach, mdeg; the rest of its error repeats.
    #[serde(deserialize_with = "rotation_repeatability")]
    pub rotation_repeatability_mdeg: f64,
    /// Largest change of the vertical stage's error from approach to approach, µm.
    #[serde(deserialize_with = "vertical_repeatability")]
    pub vertical_repeatability_um: f64,
    /// Saw-tooth error of the rotary encoder, `TEETH:MDEG`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_saw: Option<Given<EncoderSaw>>,
    /// Fault: the stages are not the station's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trouble: Option<StageTrouble>,
    /// File with the camera's true pose if an arm carries the head (`stages.moves = "outside"`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arm: Option<PathBuf>,
}

impl Default for StagesTable {
    /// Without play; the little that a good stage does not repeat.
    fn default() -> Self {
        Self {
            backlash_mdeg: 0.0,
            backlash_um: 0.0,
            rotation_repeatability_mdeg: 2.0,
            vertical_repeatability_um: 1.0,
            encoder_saw: None,
            trouble: None,
            arm: None,
        }
    }
}

/// Optics of the head.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadTable {
    /// Error of the lenses that a distortion model cannot describe: root mean square along each axis, µm.
    #[serde(deserialize_with = "lens_error_um")]
    pub lens_error_um: f64,
    /// Drift of the cores' image along the sensor's rows while the head warms, px.
    #[serde(deserialize_with = "core_shift_px")]
    pub core_drift_px: f64,
    /// Shift of the cores' image along the sensor's rows when the head is turned by a quarter of a turn, px.
    #[serde(deserialize_with = "core_shift_px")]
    pub twist_px: f64,
    /// Share of the light that is lost when the head is turned by half a turn.
    #[serde(deserialize_with = "share")]
    pub twist_loss_ratio: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraTable {
    /// A frame that is lost, repeated or inserted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_fault: Option<Given<FrameFault>>,
    /// Fault of a GigE camera or its link.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gige_trouble: Option<Given<Trouble>>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PressTable {
    #[serde(deserialize_with = "strokes_per_minute")]
    pub strokes_per_minute: f64,
    /// Fraction of a stroke during which the press counts as open.
    #[serde(deserialize_with = "open_share")]
    pub open_share: f64,
}

impl Default for PressTable {
    fn default() -> Self {
        Self {
            strokes_per_minute: 30.0,
            open_share: 0.4,
        }
    }
}

/// Faults of the stages' identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StageTrouble {
    /// The rotary stage is another model.
    OtherModel,
    /// The vertical stage has no memory with its model.
    NoModel,
}

impl StageTrouble {
    /// Applies the fault to the stages of the bench.
    pub fn spoil(self, axes: &mut AxisModels) {
        match self {
            Self::OtherModel => axes.rotation.name = "URS100BPP",
            Self::NoModel => axes.vertical.name = NO_MEMORY,
        }
    }
}

/// A sawtooth error: periods per revolution, and amplitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSaw(pub Saw);

/// The text is not a sawtooth error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{text} is no error of an encoder; 1 to 10000 teeth per turn and 0 to 1000 mdeg are, for example 84:8"
)]
pub struct SawError {
    text: String,
}

impl FromStr for EncoderSaw {
    type Err = SawError;

    fn from_str(text: &str) -> Result<Self, SawError> {
        let saw = text.split_once(':').and_then(|(teeth, mdeg)| {
            let teeth = teeth.parse().ok().filter(|n| (1..=10_000).contains(n))?;
            let mdeg: f64 = mdeg
                .parse()
                .ok()
                .filter(|mdeg| (0.0..=1000.0).contains(mdeg))?;
            Some(Saw {
                teeth,
                height_rad: (1e-3 * mdeg).to_radians(),
            })
        });
        saw.map(Self).ok_or_else(|| SawError { text: text.into() })
    }
}

/// Why a bench file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BenchFileError {
    /// The operating system returned an error, or the file is not text.
    #[error("cannot read the bench file {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The file is too large.
    #[error("the bench file {} has {got_bytes} bytes; at most {max_bytes} are possible", path.display())]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length.
        got_bytes: u64,
        /// Largest.
        max_bytes: u64,
    },
    /// Grammar, an unknown key, or a value out of range.
    #[error(
        "{}:{line}: {message} (flankscope bench example writes a file with every key)", path.display()
    )]
    Content {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Error and expected value.
        message: String,
    },
}

impl BenchFile {
    /// Reads a bench file. Paths in it are relative to its folder.
    ///
    /// # Errors
    /// The file is unreadable, or has an unknown key or a value out of range.
    pub fn load(path: &Path) -> Result<Self, BenchFileError> {
        let read = |source| BenchFileError::Read {
            path: path.to_path_buf(),
            source,
        };
        let got_bytes = crate::files::regular(path)
            .and_then(std::fs::metadata)
            .map_err(read)?
            .len();
        if got_bytes > MAX_FILE_BYTES {
            return Err(BenchFileError::TooLong {
                path: path.to_path_buf(),
                got_bytes,
                max_bytes: MAX_FILE_BYTES,
            });
        }
        let text = std::fs::read_to_string(path).map_err(read)?;
        let mut file: Self = toml::from_str(&text).map_err(|error| {
            let before = error.span().map_or("", |span| &text[..span.start]);
            BenchFileError::Content {
                path: path.to_path_buf(),
                line: 1 + before.matches('\n').count(),
                message: error.message().to_owned(),
            }
        })?;
        if let Some(arm) = &mut file.stages.arm {
            *arm = path.with_file_name("").join(&arm);
        }
        Ok(file)
    }
}

/// A number between `least` and `most`.
fn within<'de, D: Deserializer<'de>>(from: D, least: f64, most: f64) -> Result<f64, D::Error> {
    let number = f64::deserialize(from)?;
    // NaN is out of every range.
    if (least..=most).contains(&number) {
        return Ok(number);
    }
    Err(serde::de::Error::custom(format!(
        "{number} is out of range; a number from {least} to {most} is needed"
    )))
}

fn form_um<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, -1000.0, 1000.0)
}

fn spread_um<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 1000.0)
}

fn play<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 1000.0)
}

fn rotation_repeatability<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 15.0)
}

fn vertical_repeatability<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 5.0)
}

fn turn_deg<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, -360.0, 360.0)
}

fn height_mm<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
    within(from, -1000.0, 1000.0).map(Some)
}

fn lens_error_um<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 10.0)
}

fn film_um<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 200.0)
}

fn share<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 1.0)
}

fn core_shift_px<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, -10.0, 10.0)
}

fn strokes_per_minute<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.0, 300.0)
}

fn open_share<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    within(from, 0.1, 0.9)
}

fn bounces<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u32>, D::Error> {
    let number = u32::deserialize(from)?;
    if (1..=MAX_BOUNCES).contains(&number) {
        return Ok(Some(number));
    }
    Err(serde::de::Error::custom(format!(
        "{number} is out of range; 1 to {MAX_BOUNCES} places are possible"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// `table.key` of every key in a TOML text.
    fn keys(text: &str) -> BTreeSet<String> {
        let tables: toml::Table = toml::from_str(text).unwrap();
        let of_table = |(table, keys): (&String, &toml::Value)| {
            let keys = keys.as_table().unwrap().keys();
            keys.map(|key| format!("{table}.{key}")).collect::<Vec<_>>()
        };
        tables.iter().flat_map(of_table).collect()
    }

    /// The example with its commented-out keys.
    fn with_optional_keys() -> String {
        let uncommented = |line: &str| {
            let key = line.strip_prefix("# ").filter(|rest| rest.contains(" = "));
            format!("{}\n", key.unwrap_or(line))
        };
        EXAMPLE.lines().map(uncommented).collect()
    }

    #[test]
    fn the_example_has_every_key_and_its_default() {
        let example: BenchFile = toml::from_str(EXAMPLE).unwrap();
        assert_eq!(example, BenchFile::default());
        let full: BenchFile = toml::from_str(&with_optional_keys()).unwrap();
        let written = toml::to_string(&full).unwrap();
        assert_eq!(keys(&with_optional_keys()), keys(&written));
        // Keys without a default: a new one does not compile until it is listed here, and the test fails until the example has it.
        let BenchFile {
            die,
            surface:
                SurfaceTable {
                    sprayed_above_mm,
                    film_um: _,
                    bounces,
                },
            stages:
                StagesTable {
                    backlash_mdeg: _,
                    backlash_um: _,
                    rotation_repeatability_mdeg: _,
                    vertical_repeatability_um: _,
                    encoder_saw,
                    trouble,
                    arm,
                },
            camera:
                CameraTable {
                    frame_fault,
                    gige_trouble,
                },
            ..
        } = full;
        assert!(die.other.is_some());
        assert!(sprayed_above_mm.is_some() && bounces.is_some());
        assert!(encoder_saw.is_some() && trouble.is_some() && arm.is_some());
        assert!(frame_fault.is_some() && gige_trouble.is_some());
    }

    #[test]
    fn what_cannot_be_is_refused_with_file_and_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        for (table, wrong, right) in [
            ("head", "lens_error_um = 11", "from 0 to 10"),
            ("head", "core_drift_px = -11", "from -10 to 10"),
            ("head", "twist_loss_ratio = 1.1", "from 0 to 1"),
            ("surface", "film_um = -1", "from 0 to 200"),
            ("surface", "bounces = 0", "1 to 16"),
            ("surface", "sprayed_above_mm = inf", "from -1000 to 1000"),
            ("stages", "encoder_saw = \"0:3\"", "84:8"),
            ("stages", "encoder_saw = \"84\"", "84:8"),
            ("stages", "encoder_saw = \"84:NaN\"", "84:8"),
            ("stages", "trouble = \"lazy\"", "other-model"),
            ("stages", "backlash_um = -1", "from 0 to 1000"),
            ("stages", "rotation_repeatability_mdeg = 16", "from 0 to 15"),
            ("motion", "shiver_um = -1", "from 0 to 1000"),
            ("motion", "vibration_um = nan", "from 0 to 1000"),
            ("press", "open_share = nan", "from 0.1 to 0.9"),
            ("press", "strokes_per_minute = 3000", "from 0 to 300"),
            ("camera", "frame_fault = \"drop:3\"", "lose:12"),
            ("camera", "gige_trouble = \"slow\"", "free-runs"),
            ("die", "other = \"many\"", "83x0.9869"),
            ("die", "ovality_um = \"20\"", "expected f64"),
            ("die", "turned_deg = 361", "from -360 to 360"),
            ("die", "ovalty_um = 20", "ovality_um"),
        ] {
            std::fs::write(&path, format!("# a bench\n[{table}]\n{wrong}\n")).unwrap();
            let said = BenchFile::load(&path).unwrap_err().to_string();
            let place = format!("{}:3: ", path.display());
            assert!(said.starts_with(&place) && said.contains(right), "{said}");
            assert!(said.contains("flankscope bench example"), "{said}");
        }
        std::fs::write(&path, "[dye]\n").unwrap();
        let said = BenchFile::load(&path).unwrap_err().to_string();
        assert!(said.contains("`dye`") && said.contains("`die`"), "{said}");
        let absent = BenchFile::load(&folder.path().join("absent.toml")).unwrap_err();
        assert!(absent.to_string().contains("absent.toml"), "{absent}");
    }

    #[test]
    fn an_arm_s_file_is_beside_the_bench_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        std::fs::write(&path, "[stages]\narm = \"pose.json\"\n").unwrap();
        let arm = BenchFile::load(&path).unwrap().stages.arm;
        assert_eq!(arm, Some(folder.path().join("pose.json")));
    }
}
