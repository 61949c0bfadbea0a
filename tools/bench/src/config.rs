//! All that a run of the bench can be told: options of whoever starts it, and one document that hands them over.
//!
//! The same structs are options of the command line (by `clap`) and parts of [`BenchConfig`], which the bench's process
//! reads as one line of JSON.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::camera::FrameFault;
use crate::demo::OtherDie;
use crate::devices::stage::{AxisModels, NO_MEMORY};
use crate::link::{CameraLink, Trouble};
use crate::world::{Carries, MAX_BOUNCES, Saw, SprayEdge, Surface, Wear};

/// Virtual seconds per real second at `--speed max`; rendering holds the clock, so this is reached only between frames.
const MAX_SPEED: f64 = 50.0;

/// What stands on the bench, who drives it, and where its frames go.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchConfig {
    /// The host's shared-memory root.
    pub root: PathBuf,
    /// What stands there.
    pub stands: Stands,
    /// Teeth that are judged, for the truth, instead of the tool file's.
    pub teeth: Option<Vec<u32>>,
    /// Who drives the pins.
    pub controller: ControllerKind,
    /// Damage, speed, seed.
    pub bench: BenchArgs,
    /// A press; without one it stands open.
    pub press: Option<PressArgs>,
    /// A die put down by hand; without this the drawing's own, exactly in place.
    pub die: Option<DieArgs>,
    /// What the rotary stage carries.
    pub rotary_carries: Carries,
    /// Folder of pictures that the DMD is loaded with, as `flankscope patterns --adaptive` writes it; without one, what the head
    /// file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pictures: Option<PathBuf>,
}

/// What stands before the head.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stands {
    /// The die of a tool file or its folder; its head.toml, else the demo head.
    Tool(PathBuf),
    /// The calibration target of a folder; before the demo head, whatever the folder says of one.
    Target(PathBuf),
}

/// Who drives the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControllerKind {
    /// The controller crate in the bench's own process.
    Sim,
    /// Its image in QEMU.
    Qemu,
}

/// What only the simulated bench knows.
#[derive(clap::Args, Clone, Debug, Serialize, Deserialize)]
#[command(next_help_heading = "Simulated bench")]
pub struct BenchArgs {
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Wear of a flank, up to 300 um: TOOTH:left|right:DEPTH_UM, and :KIND may follow: uniform, tip, pit, buildup, half (above
    /// half height), ramp, edge, spall, scratch-along, scratch-across, crater, crack, side (this flank of every tooth) or
    /// ring (the whole toothing)
    #[arg(long, value_name = "TOOTH:FLANK:DEPTH_UM")]
    pub wear: Vec<Given<Wear>>,
    /// This mesh stands there instead of the CAD: PLY or STL, in mm and in the frame of the CAD, open or closed, up to five
    /// million triangles; it is the die as it is, so no wear can be added
    #[arg(long, value_name = "FILE", conflicts_with = "wear")]
    pub die_mesh: Option<PathBuf>,
    /// What the die's surface is: matt spray, ground steel, steel polished by use, or ground steel under oil
    #[arg(long, value_name = "KIND", value_enum, default_value_t)]
    pub surface: SurfaceKind,
    /// The die is sprayed above this height in mm, whatever its surface is below
    #[arg(long, value_name = "MM", value_parser = height_mm, allow_negative_numbers = true)]
    pub sprayed_above_mm: Option<f64>,
    /// Places of the die that light touches at most on its way from projector to camera; 1 is direct light alone [default: 1
    /// on a sprayed die, else 5]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_BOUNCES)))]
    pub bounces: Option<u32>,
    /// How many times faster than real time the bench runs, or max
    #[arg(long, value_name = "1|K|max", default_value = "1")]
    pub speed: Given<Speed>,
    /// Head and die shift against each other from frame to frame: standard deviation in um
    #[arg(long, value_name = "UM", default_value_t = 0.0)]
    pub vibration_um: f64,
    /// They shiver within a frame, faster than it is exposed, and the fringes blur: standard deviation in um
    #[arg(long, value_name = "UM", default_value_t = 0.0, value_parser = shiver_um)]
    pub shiver_um: f64,
    /// Play of the stages: the table stays behind by half of it, whichever way it came; of the rotation in mdeg
    #[arg(long, value_name = "MDEG", default_value_t = 0.0, value_parser = play)]
    pub backlash_mdeg: f64,
    /// The same of the vertical stage, in um
    #[arg(long, value_name = "UM", default_value_t = 0.0, value_parser = play)]
    pub backlash_um: f64,
    /// Error of the rotary encoder that no harmonic of low order follows: it grows evenly and falls back at once, so many times per
    /// turn, by so much
    #[arg(long, value_name = "TEETH:MDEG")]
    pub encoder_saw: Option<Given<EncoderSaw>>,
    /// The head comes cold into a warm die: from view to view the cores' image creeps along the sensor's rows, in the end by so
    /// many px
    #[arg(long, value_name = "PX", default_value_t = 0.0, value_parser = core_drift_px, allow_negative_numbers = true)]
    pub core_drift_px: f64,
    /// The head's lenses lead light astray by this where no distortion model follows, smoothly over the field: root mean
    /// square along each axis in um
    #[arg(long, value_name = "UM", default_value_t = 0.0, value_parser = lens_error_um)]
    pub lens_error_um: f64,
    /// A camera that misbehaves, to see what the instrument makes of it: lose|repeat|extra:FRAME, `:once` may follow
    #[arg(long, value_name = "KIND:FRAME")]
    pub frame_fault: Option<Given<FrameFault>>,
    /// How frames come: written into shared memory, or as packets of a GigE Vision camera, by Aravis, on a network of their own
    /// (in a build with the feature aravis)
    #[arg(long, value_name = "LINK", value_enum, default_value_t)]
    pub camera: CameraLink,
    /// A GigE camera that misbehaves: free-runs, colour, smaller, shallow (8 bits), amplified (6 dB), unplugged:FRAME, or lost:SHARE of its packets
    #[arg(long, value_name = "KIND")]
    pub gige_trouble: Option<Given<Trouble>>,
    /// Stages that are not the station's: other-model (the rotary one), no-model (the vertical one cannot say what it is)
    #[arg(long, value_name = "KIND", value_enum)]
    pub stage_trouble: Option<StageTrouble>,
    /// An arm carries the head (stages.moves = "outside"): FILE has the camera's true pose in the die's frame, rows of a 4x4 matrix as
    /// JSON, and whoever plays the arm replaces it
    #[arg(long, value_name = "FILE")]
    pub arm: Option<PathBuf>,
}

/// What is wrong with the stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum StageTrouble {
    /// The rotary stage is another model.
    OtherModel,
    /// The vertical stage has no memory that would say what it is.
    NoModel,
}

impl StageTrouble {
    /// Spoils the stages that stand on the bench.
    pub fn spoil(self, axes: &mut AxisModels) {
        match self {
            Self::OtherModel => axes.rotation.name = "URS100BPP",
            Self::NoModel => axes.vertical.name = NO_MEMORY,
        }
    }
}

/// What a die's surface is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum SurfaceKind {
    /// Matt spray.
    #[default]
    Sprayed,
    /// Ground steel.
    Ground,
    /// Smoother steel.
    Polished,
    /// Ground steel under a film of oil.
    Oiled,
}

impl SurfaceKind {
    /// Places that light touches at most, unless said otherwise: under spray what a second flank adds is left out.
    #[must_use]
    pub fn bounces(self) -> u32 {
        match self {
            Self::Sprayed => 1,
            Self::Ground | Self::Polished | Self::Oiled => 5,
        }
    }

    /// How it reflects.
    #[must_use]
    pub fn surface(self) -> Surface {
        match self {
            Self::Sprayed => Surface::sprayed(),
            Self::Ground => Surface::ground(),
            Self::Polished => Surface::polished(),
            Self::Oiled => Surface::oiled(),
        }
    }
}

impl BenchArgs {
    /// Places that light touches at most.
    #[must_use]
    pub fn bounces(&self) -> u32 {
        self.bounces.unwrap_or_else(|| self.surface.bounces())
    }

    /// Edge of the spray, if there is one.
    #[must_use]
    pub fn spray_edge(&self) -> Option<SprayEdge> {
        /// How a spray gun's edge runs, mm.
        const RAGGED_MM: f64 = 0.15;
        self.sprayed_above_mm.map(|above_mm| SprayEdge {
            above_mm,
            ragged_mm: RAGGED_MM,
        })
    }
}

/// The simulated press.
#[derive(clap::Args, Clone, Debug, Serialize, Deserialize)]
#[command(next_help_heading = "Simulated press")]
pub struct PressArgs {
    /// Strokes per minute
    #[arg(long, default_value_t = 30.0, value_parser = strokes_per_minute)]
    pub strokes_per_minute: f64,
    /// Share of a stroke during which the press counts as open
    #[arg(long, default_value_t = 0.4, value_parser = open_share)]
    pub open_share: f64,
    /// Wear that each cycle adds: TOOTH:FLANK:DEPTH_UM
    #[arg(long, value_name = "TOOTH:FLANK:DEPTH_UM", conflicts_with = "die_mesh")]
    pub wear_rate: Vec<Given<Wear>>,
}

/// The die on the simulated bench: eccentric and tilted, drawn from the seed, with the form that is stated here.
#[derive(clap::Args, Clone, Debug, Serialize, Deserialize)]
#[command(next_help_heading = "Simulated bench")]
pub struct DieArgs {
    /// Largest minus smallest radius of the bore, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub ovality_um: f64,
    /// Growth of the bore's radius from bottom to top, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub taper_um: f64,
    /// Largest minus smallest radius of three lobes around the bore, um: what a chuck with three jaws leaves
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub three_lobe_um: f64,
    /// Growth of the bore's radius from its ends to mid-height, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub barrel_um: f64,
    /// Growth of the bore's radius at the upper end, over the last quarter of its height, um
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub bell_mouth_um: f64,
    /// Another die than the tool file's on the bench: so many teeth of such a module
    #[arg(long, value_name = "TEETHxMODULE_MM", conflicts_with = "die_mesh")]
    pub die: Option<Given<OtherDie>>,
    /// The die is put down turned by this angle
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub turned_deg: f64,
    /// The die is put down turned by so many whole teeth
    #[arg(
        long,
        value_name = "N",
        default_value_t = 0,
        allow_negative_numbers = true
    )]
    pub turned_teeth: i32,
    /// What every flank stands off by since it was made: standard deviation along the pitch circle, um
    #[arg(long, value_name = "UM", default_value_t = 0.0)]
    pub flanks_um: f64,
    /// Which die: draws what its flanks stand off by
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub die_seed: u64,
}

impl Default for DieArgs {
    /// As drawn.
    fn default() -> Self {
        Self {
            ovality_um: 0.0,
            taper_um: 0.0,
            three_lobe_um: 0.0,
            barrel_um: 0.0,
            bell_mouth_um: 0.0,
            die: None,
            turned_deg: 0.0,
            turned_teeth: 0,
            flanks_um: 0.0,
            die_seed: 1,
        }
    }
}

/// A value with the text that somebody gave it as, by which it is handed on and named.
#[derive(Clone, Debug, PartialEq)]
pub struct Given<T> {
    text: String,
    /// What the text means.
    pub value: T,
}

impl<T: FromStr> FromStr for Given<T> {
    type Err = T::Err;

    fn from_str(text: &str) -> Result<Self, T::Err> {
        Ok(Self {
            text: text.to_owned(),
            value: text.parse()?,
        })
    }
}

impl<T> fmt::Display for Given<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl<T> Serialize for Given<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

impl<'de, T: FromStr<Err: fmt::Display>> Deserialize<'de> for Given<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

/// An encoder's saw: teeth per turn, and height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSaw(pub Saw);

/// Why a text is no saw.
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
            let mdeg = within(mdeg, 0.0, 1000.0).ok()?;
            Some(Saw {
                teeth,
                height_rad: (1e-3 * mdeg).to_radians(),
            })
        });
        saw.map(Self).ok_or_else(|| SawError { text: text.into() })
    }
}

/// How many virtual seconds pass per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed(pub f64);

/// Why a text is no speed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{text} is no speed; 0.1 to {MAX_SPEED} or max is")]
pub struct SpeedError {
    text: String,
}

impl FromStr for Speed {
    type Err = SpeedError;

    fn from_str(text: &str) -> Result<Self, SpeedError> {
        if text == "max" {
            return Ok(Self(MAX_SPEED));
        }
        match text.parse::<f64>() {
            Ok(speed) if (0.1..=MAX_SPEED).contains(&speed) => Ok(Self(speed)),
            _ => Err(SpeedError { text: text.into() }),
        }
    }
}

fn strokes_per_minute(text: &str) -> Result<f64, OutOfRange> {
    within(text, 0.0, 300.0)
}

fn open_share(text: &str) -> Result<f64, OutOfRange> {
    within(text, 0.1, 0.9)
}

fn height_mm(text: &str) -> Result<f64, OutOfRange> {
    within(text, -1000.0, 1000.0)
}

fn shiver_um(text: &str) -> Result<f64, OutOfRange> {
    within(text, 0.0, 1000.0)
}

fn play(text: &str) -> Result<f64, OutOfRange> {
    within(text, 0.0, 1000.0)
}

fn core_drift_px(text: &str) -> Result<f64, OutOfRange> {
    within(text, -10.0, 10.0)
}

fn lens_error_um(text: &str) -> Result<f64, OutOfRange> {
    within(text, 0.0, 10.0)
}

/// A number that is none, or too small or large.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{text} is out of range; a number from {least} to {most} is needed")]
struct OutOfRange {
    text: String,
    least: f64,
    most: f64,
}

fn within(text: &str, least: f64, most: f64) -> Result<f64, OutOfRange> {
    match text.parse() {
        Ok(number) if (least..=most).contains(&number) => Ok(number),
        _ => Err(OutOfRange {
            text: text.into(),
            least,
            most,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        bench: BenchArgs,
        #[command(flatten)]
        press: PressArgs,
        #[command(flatten)]
        die: DieArgs,
    }

    #[test]
    fn what_was_given_arrives() {
        let given = [
            "x",
            "--seed",
            "7",
            "--wear",
            "12:left:80",
            "--wear",
            "40:r:30:pit",
            "--speed",
            "max",
            "--surface",
            "ground",
            "--sprayed-above-mm",
            "31.5",
            "--bounces",
            "3",
            "--encoder-saw",
            "84:8",
            "--core-drift-px",
            "-0.5",
            "--bell-mouth-um",
            "30",
            "--lens-error-um",
            "0.3",
            "--frame-fault",
            "lose:7:once",
            "--wear-rate",
            "1:l:0.1",
            "--ovality-um",
            "-20.1",
            "--die",
            "83x0.9869",
            "--turned-teeth",
            "-3",
        ];
        let Options { bench, press, die } = Options::try_parse_from(given).unwrap();
        let sent = BenchConfig {
            root: "root".into(),
            stands: Stands::Tool("die".into()),
            teeth: Some(vec![12]),
            controller: ControllerKind::Sim,
            bench,
            press: Some(press),
            die: Some(die),
            rotary_carries: Carries::Head,
            pictures: Some("pictures".into()),
        };
        let text = serde_json::to_string(&sent).unwrap();
        assert!(!text.contains('\n'), "one line");
        let got: BenchConfig = serde_json::from_str(&text).unwrap();
        assert_eq!(format!("{got:?}"), format!("{sent:?}"));
        assert_eq!(got.bench.wear[1].value, "40:right:30:pit".parse().unwrap());
        assert_eq!(got.bench.speed.value, Speed(MAX_SPEED));
        let broken = text.replace("12:left:80", "12:left:900");
        assert!(serde_json::from_str::<BenchConfig>(&broken).is_err());
    }

    #[test]
    fn a_die_without_options_is_the_default_one() {
        let given = Options::try_parse_from(["x"]).unwrap().die;
        assert_eq!(format!("{given:?}"), format!("{:?}", DieArgs::default()));
    }

    #[test]
    fn what_cannot_be_is_refused_where_it_is_given() {
        for wrong in [
            ["--wear", "12:up:80"],
            ["--speed", "0"],
            ["--lens-error-um", "11"],
            ["--surface", "rusty"],
            ["--bounces", "0"],
            ["--encoder-saw", "0:3"],
            ["--encoder-saw", "84"],
            ["--encoder-saw", "84:NaN"],
            ["--shiver-um", "-1"],
            ["--sprayed-above-mm", "inf"],
            ["--open-share", "NaN"],
            ["--frame-fault", "drop:3"],
            ["--die", "many"],
        ] {
            assert!(
                Options::try_parse_from(["x", wrong[0], wrong[1]]).is_err(),
                "{wrong:?}"
            );
        }
        for beside in [
            ["--wear", "1:l:1"],
            ["--wear-rate", "1:l:1"],
            ["--die", "83x1"],
        ] {
            let both = ["x", "--die-mesh", "a.ply", beside[0], beside[1]];
            assert!(Options::try_parse_from(both).is_err(), "{beside:?}");
        }
    }
}
