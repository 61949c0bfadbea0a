//! Configuration of a bench run: command-line options, bench file, and a document that passes both to the bench's process.
//!
//! [`BenchArgs`] are command-line options (by `clap`), a [`BenchFile`] has the other settings; [`BenchSetup`] contains both and
//! is a part of [`BenchConfig`], which the bench's process reads as one line of JSON.

use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::bench_file::BenchFile;
use crate::given::Given;
use crate::link::CameraLink;
use crate::world::{Carries, Surface, Wear};

/// Virtual seconds per real second at `--speed max`; rendering holds the clock, so this is reached only between frames.
const MAX_SPEED: f64 = 50.0;
/// Default seed.
const DEFAULT_SEED: u64 = 1;

/// Configuration of the bench's process.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchConfig {
    /// The host's shared-memory root.
    pub root: PathBuf,
    /// Die or target on the bench.
    pub stands: Stands,
    /// Teeth whose true wear is reported, instead of the tool file's.
    pub teeth: Option<Vec<u32>>,
    /// Implementation of the controller.
    pub controller: ControllerKind,
    /// Options and bench file.
    pub setup: BenchSetup,
    /// The press strokes, and a check is made every so many strokes; `None`: it stays open.
    pub checks_every: Option<u32>,
    /// Whether the die is placed by hand, eccentric and tilted; otherwise it is placed exactly.
    pub by_hand: bool,
    /// What the rotary stage carries: die or head.
    pub rotary_carries: Carries,
    /// Folder of pictures loaded into the DMD, as `flankscope patterns --adaptive` writes it; by default the patterns that the
    /// head file names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pictures: Option<PathBuf>,
}

/// Object in front of the head.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stands {
    /// The die of a tool file or its folder, with its head.toml or else the demo head.
    Tool(PathBuf),
    /// The calibration target of a folder, always with the demo head.
    Target(PathBuf),
}

/// Implementation of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControllerKind {
    /// The controller crate in the bench's own process.
    Sim,
    /// The firmware image in QEMU.
    Qemu,
}

/// The bench file: the option of every command that can run on the bench.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct BenchFileArgs {
    /// Further settings of the bench: form of the die, errors of stages and lenses, faults of the camera; `flankscope bench example`
    /// writes such a file
    #[arg(long, value_name = "BENCH.toml")]
    bench: Option<PathBuf>,
}

/// Options of a command that captures.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct BenchArgs {
    #[command(flatten)]
    file: BenchFileArgs,
    /// Seed of everything random
    #[arg(long, default_value_t = DEFAULT_SEED)]
    seed: u64,
    /// How many times faster than real time the bench runs, or max
    #[arg(long, value_name = "1|K|max", default_value = "1")]
    speed: Given<Speed>,
}

/// Options of a command before which a die stands.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct DieArgs {
    #[command(flatten)]
    bench: BenchArgs,
    /// Wear of a flank, up to 300 um: TOOTH:left|right:DEPTH_UM, and :KIND may follow: uniform, tip, pit, buildup, half (above
    /// half height), ramp, edge, spall, scratch-along, scratch-across, crater, crack, side (this flank of every tooth) or
    /// ring (the whole toothing)
    #[arg(long, value_name = "TOOTH:FLANK:DEPTH_UM")]
    wear: Vec<Given<Wear>>,
    /// Mesh of the die on the bench, instead of the CAD: PLY or STL, in mm and in the frame of the CAD, open or closed, up to five
    /// million triangles; it is the die as it is, so no wear can be added
    #[arg(long, value_name = "FILE", conflicts_with = "wear")]
    die_mesh: Option<PathBuf>,
    /// Surface of the die: matt spray, ground steel, steel polished by use, or ground steel under oil
    #[arg(long, value_name = "KIND", value_enum, default_value_t)]
    surface: SurfaceKind,
}

/// The wear of a press that strokes.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct WearRateArgs {
    /// Wear that each press cycle adds: TOOTH:FLANK:DEPTH_UM
    #[arg(long, value_name = "TOOTH:FLANK:DEPTH_UM", conflicts_with = "die_mesh")]
    pub wear_rate: Vec<Given<Wear>>,
}

/// The way of the bench's frames.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Simulated bench")]
pub struct CameraArgs {
    /// How frames come: written into shared memory, or as packets of a GigE Vision camera, by Aravis, on a network of their own
    /// (in a build with the feature aravis)
    #[arg(long, value_name = "LINK", value_enum, default_value_t)]
    pub camera: CameraLink,
}

/// The bench as one run has it.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchSetup {
    /// The bench file's name, if there is one.
    pub path: Option<PathBuf>,
    /// Its contents, else the defaults.
    pub file: BenchFile,
    /// Seed of everything random.
    pub seed: u64,
    /// How many times faster than real time the bench runs.
    pub speed: Given<Speed>,
    /// Wear of the CAD's flanks.
    pub wear: Vec<Given<Wear>>,
    /// Wear that each press cycle adds.
    pub wear_rate: Vec<Given<Wear>>,
    /// A mesh instead of the CAD.
    pub die_mesh: Option<PathBuf>,
    /// The die's surface.
    pub surface: SurfaceKind,
    /// How frames come.
    pub camera: CameraLink,
}

/// The bench file names another die, but the command line names one too.
#[derive(Debug, thiserror::Error)]
#[error("{}: [die] other = \"{other}\" beside --die-mesh: the mesh is the die; leave one of them out", path.display())]
pub struct TwoDies {
    path: PathBuf,
    other: String,
}

impl BenchFileArgs {
    /// Reads the bench file, for a command that captures nothing.
    ///
    /// # Errors
    /// The bench file cannot be read.
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        let file = self.bench.as_deref().map(BenchFile::load).transpose()?;
        Ok(BenchSetup {
            path: self.bench.clone(),
            file: file.unwrap_or_default(),
            seed: DEFAULT_SEED,
            speed: "1".parse()?,
            wear: Vec::new(),
            wear_rate: Vec::new(),
            die_mesh: None,
            surface: SurfaceKind::default(),
            camera: CameraLink::default(),
        })
    }
}

impl BenchArgs {
    /// Reads the bench file, without a die.
    ///
    /// # Errors
    /// The bench file cannot be read.
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        Ok(BenchSetup {
            seed: self.seed,
            speed: self.speed.clone(),
            ..self.file.setup()?
        })
    }
}

impl DieArgs {
    /// Reads the bench file, and adds the die's options.
    ///
    /// # Errors
    /// The bench file cannot be read, or names another die.
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        let setup = self.bench.setup()?;
        if let (Some(path), Some(other), Some(_)) =
            (&setup.path, &setup.file.die.other, &self.die_mesh)
        {
            let (path, other) = (path.clone(), other.to_string());
            return Err(TwoDies { path, other }.into());
        }
        Ok(BenchSetup {
            wear: self.wear.clone(),
            die_mesh: self.die_mesh.clone(),
            surface: self.surface,
            ..setup
        })
    }
}

impl BenchSetup {
    /// Largest number of reflections at the die.
    pub fn bounces(&self) -> u32 {
        let said = self.file.surface.bounces;
        said.unwrap_or_else(|| self.surface.bounces())
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
    /// Default number of reflections: on spray, the light from a second flank is neglected.
    #[must_use]
    pub fn bounces(self) -> u32 {
        match self {
            Self::Sprayed => 1,
            Self::Ground | Self::Polished | Self::Oiled => 5,
        }
    }

    /// Its reflection properties.
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

/// Virtual seconds per real second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed(pub f64);

/// The text is not a speed.
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Options {
        #[command(flatten)]
        die: DieArgs,
        #[command(flatten)]
        press: WearRateArgs,
    }

    #[test]
    fn what_was_given_arrives() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        let said = "[die]\nbell_mouth_um = 30\novality_um = -20.1\nturned_teeth = -3\nother = \"83x0.9869\"\n\
                    [surface]\nsprayed_above_mm = 31.5\nbounces = 3\n[stages]\nencoder_saw = \"84:8\"\n\
                    [head]\ncore_drift_px = -0.5\nlens_error_um = 0.3\n[camera]\nframe_fault = \"lose:7:once\"\n";
        std::fs::write(&path, said).unwrap();
        let path = path.to_str().unwrap();
        let given = [
            "x",
            "--bench",
            path,
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
            "--wear-rate",
            "1:l:0.1",
        ];
        let Options { die, press } = Options::try_parse_from(given).unwrap();
        let sent = BenchConfig {
            root: "root".into(),
            stands: Stands::Tool("die".into()),
            teeth: Some(vec![12]),
            controller: ControllerKind::Sim,
            setup: BenchSetup {
                wear_rate: press.wear_rate,
                ..die.setup().unwrap()
            },
            checks_every: Some(5),
            by_hand: true,
            rotary_carries: Carries::Head,
            pictures: Some("pictures".into()),
        };
        let text = serde_json::to_string(&sent).unwrap();
        assert!(!text.contains('\n'), "one line");
        let got: BenchConfig = serde_json::from_str(&text).unwrap();
        assert_eq!(format!("{got:?}"), format!("{sent:?}"));
        let BenchSetup { wear, speed, .. } = &got.setup;
        assert_eq!(wear[1].value, "40:right:30:pit".parse().unwrap());
        assert_eq!(speed.value, Speed(MAX_SPEED));
        assert_eq!(got.setup.bounces(), 3);
        assert_eq!(got.setup.file.die.ovality_um, -20.1);
        let broken = text.replace("12:left:80", "12:left:900");
        assert!(serde_json::from_str::<BenchConfig>(&broken).is_err());
    }

    #[test]
    fn what_cannot_be_is_refused_where_it_is_given() {
        for wrong in [
            ["--wear", "12:up:80"],
            ["--speed", "0"],
            ["--surface", "rusty"],
        ] {
            assert!(
                Options::try_parse_from(["x", wrong[0], wrong[1]]).is_err(),
                "{wrong:?}"
            );
        }
        for beside in [["--wear", "1:l:1"], ["--wear-rate", "1:l:1"]] {
            let both = ["x", "--die-mesh", "a.ply", beside[0], beside[1]];
            assert!(Options::try_parse_from(both).is_err(), "{beside:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bench.toml");
        std::fs::write(&path, "[die]\nother = \"83x1\"\n").unwrap();
        let bench = path.to_str().unwrap();
        let both = ["x", "--die-mesh", "a.ply", "--bench", bench];
        let refused = Options::try_parse_from(both).unwrap().die.setup();
        let said = refused.unwrap_err().to_string();
        assert!(
            said.contains("--die-mesh") && said.contains(bench),
            "{said}"
        );
    }
}
