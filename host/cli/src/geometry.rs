//! Common parts of the geometry commands: arguments for CAD and cloud files of other programs, and output.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use flankscope_foundation::rigid::{Cloud as CloudFrame, Rigid, Tool};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::cloud::{self, Cloud};
use flankscope_metrology::io::mesh::{self, TriMesh};
use flankscope_metrology::registration::{Options, fit_pairs, parse_pairs};
use flankscope_metrology::surface::orientation::{Orientation, orient};

use crate::output::{Common, say};

/// The CAD mesh and its unit.
#[derive(clap::Args)]
pub struct CadArgs {
    /// CAD mesh: PLY, STL or OBJ.
    #[arg(long = "cad", value_name = "MESH")]
    pub path: PathBuf,
    /// Unit of the CAD mesh; the formats do not say.
    #[arg(long, value_name = "UNIT", default_value = "mm")]
    pub cad_unit: FileUnit,
}

/// Options of reading clouds.
#[derive(clap::Args, Clone, Copy)]
pub struct CloudReading {
    /// Unit of the cloud; the formats do not say. What is written is in mm.
    #[arg(long, value_name = "UNIT", default_value = "mm")]
    cloud_unit: FileUnit,
    /// Refuse a cloud with points that are not finite (NaN, infinity) [default: leave them out and count them].
    #[arg(long)]
    strict: bool,
}

/// A cloud of another program, all points finite.
pub struct LoadedCloud {
    pub cloud: Cloud,
    /// Number of the file's points that were left out because a coordinate is not finite.
    pub not_finite: usize,
}

impl CloudReading {
    /// Loads a cloud. Prints a note if points were left out.
    pub fn load(self, path: &Path, common: &Common) -> anyhow::Result<LoadedCloud> {
        let unit = self.cloud_unit.into();
        let loaded = match self.strict {
            true => cloud::load(path, unit).map(|cloud| (cloud, 0)),
            false => cloud::load_finite(path, unit),
        };
        let (cloud, not_finite) =
            loaded.with_context(|| format!("cannot use cloud {}", path.display()))?;
        if not_finite > 0 && !common.quiet {
            say(&format!(
                "note: cloud {}: {not_finite} of {} points are not finite (NaN or infinity) and are left out; --strict refuses such a file",
                path.display(),
                not_finite + cloud.points.len()
            ));
        }
        Ok(LoadedCloud { cloud, not_finite })
    }
}

/// Unit of a file.
#[derive(clap::ValueEnum, Clone, Copy)]
pub enum FileUnit {
    /// Millimetres.
    Mm,
    /// Metres.
    M,
    /// Micrometres.
    Um,
    /// Inches.
    Inch,
}

impl From<FileUnit> for Unit {
    fn from(unit: FileUnit) -> Self {
        match unit {
            FileUnit::Mm => Self::Mm,
            FileUnit::M => Self::M,
            FileUnit::Um => Self::Um,
            FileUnit::Inch => Self::Inch,
        }
    }
}

impl CadArgs {
    /// Loads the mesh and orients its triangles counter-clockwise seen from outside. Prints a note if the file had another
    /// orientation, or if outside is undefined.
    pub fn load(&self, common: &Common) -> anyhow::Result<Cad> {
        let (mut mesh, irregularity) = mesh::load_tolerant(&self.path, self.cad_unit.into())
            .with_context(|| self.trouble())?;
        if let Some(irregularity) = irregularity
            && !common.quiet
        {
            say(&format!(
                "note: CAD mesh {}: {irregularity}",
                self.path.display()
            ));
        }
        let orientation = orient(&mut mesh);
        if !orientation.is_plain() && !common.quiet {
            say(&format!(
                "note: CAD mesh {}: {orientation}",
                self.path.display()
            ));
        }
        Ok(Cad { mesh, orientation })
    }

    /// Beginning of error messages about this mesh.
    pub fn trouble(&self) -> String {
        format!("cannot use CAD mesh {}", self.path.display())
    }
}

/// A CAD mesh, with its outside.
pub struct Cad {
    pub mesh: TriMesh,
    pub orientation: Orientation,
}

/// Standard uncertainty of every point of the cloud in this file, mm, where it states them.
pub fn sigma_of(cloud: &Cloud, path: &Path) -> anyhow::Result<Option<Vec<f32>>> {
    let sigma_mm = cloud.sigma_mm();
    sigma_mm.with_context(|| format!("cannot use cloud {}", path.display()))
}

/// Where a registration begins.
#[derive(clap::Args)]
pub struct StartPose {
    /// Start pose: JSON with a 4x4 row-major matrix (bare, or under `tool_from_cloud`) [default: identity].
    #[arg(long, value_name = "T.json", conflicts_with = "pairs")]
    init: Option<PathBuf>,
    /// Start pose from picked pairs: per line cloud x,y,z, then CAD x,y,z, mm.
    #[arg(long, value_name = "P.csv")]
    pairs: Option<PathBuf>,
}

impl StartPose {
    /// Whether a file gives it.
    pub fn is_given(&self) -> bool {
        self.init.is_some() || self.pairs.is_some()
    }

    /// The pose; identity where none was given.
    pub fn pose(&self) -> anyhow::Result<Rigid<Tool, CloudFrame>> {
        if let Some(path) = &self.init {
            return read_pose(path)
                .with_context(|| format!("cannot use start pose {}", path.display()));
        }
        if let Some(path) = &self.pairs {
            return pose_of_pairs(path);
        }
        Ok(Options::default().initial)
    }
}

/// A pose is a bare matrix, or a document with a pose.
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum PoseFile {
    Bare([[f64; 4]; 4]),
    Document { tool_from_cloud: [[f64; 4]; 4] },
}

fn read_pose(path: &Path) -> anyhow::Result<Rigid<Tool, CloudFrame>> {
    let text = flankscope_foundation::files::read_text(path)?;
    // Parsed as generic JSON first, so that a syntax error is reported with line and column.
    let value: serde_json::Value = serde_json::from_str(&text)?;
    let pose: PoseFile = serde_json::from_value(value).map_err(|_| {
        anyhow::anyhow!("no pose in it; right would be [[r,r,r,x],[r,r,r,y],[r,r,r,z],[0,0,0,1]] or {{\"tool_from_cloud\": [[...]]}}, mm")
    })?;
    let (PoseFile::Bare(rows)
    | PoseFile::Document {
        tool_from_cloud: rows,
    }) = pose;
    Ok(Rigid::from_rows(&rows)?)
}

/// The pose from picked pairs of points.
pub fn pose_of_pairs(path: &Path) -> anyhow::Result<Rigid<Tool, CloudFrame>> {
    let fit = || -> anyhow::Result<_> {
        Ok(fit_pairs(&parse_pairs(
            &flankscope_foundation::files::read_text(path)?,
        )?)?)
    };
    fit().with_context(|| format!("cannot use pairs {}", path.display()))
}

/// Writes a large file atomically.
pub fn write_file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> anyhow::Result<()> {
    flankscope_foundation::files::stream_whole(path, write)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Prints one line about the result, unless `--quiet` is given or standard output carries the JSON.
pub fn tell(common: &Common, line: impl FnOnce() -> String) {
    let json_on_stdout = common.json.as_deref() == Some(Path::new("-"));
    if !common.quiet && !json_on_stdout {
        println!("{}", line());
    }
}

/// Milliseconds between two instants.
pub fn milliseconds(from: Instant, to: Instant) -> f64 {
    1e3 * to.duration_since(from).as_secs_f64()
}

/// Parses so many finite numbers with commas between them: the value of an option.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parsed: Result<Vec<f64>, _> = text.split(',').map(|x| x.trim().parse::<f64>()).collect();
    let numbers = parsed.map_err(|_| format!("{text:?} is no list of numbers"))?;
    let got = numbers.len();
    let numbers: [f64; N] = numbers
        .try_into()
        .map_err(|_| format!("{N} numbers are needed, not {got}"))?;
    match numbers.iter().all(|x| x.is_finite()) {
        true => Ok(numbers),
        false => Err(format!("{text:?} holds a number that is not finite")),
    }
}
