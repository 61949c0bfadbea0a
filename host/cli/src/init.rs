//! `flankscope init`: a tool folder from a CAD mesh.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use flankscope_metrology::gear::GearData;
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_metrology::tool::gear_in_cad::{FoundGear, find_gear};
use flankscope_metrology::tool::{FILE_NAME, Tool};
use flankscope_report::numbered_ring;
use serde::Serialize;

use crate::geometry::{Cad, CadArgs, FileUnit, tell, write_file};
use crate::output::{Common, Outcome, write_whole};

/// Name of the CAD in the folder where it had to be moved to the tool frame.
const MOVED_CAD: &str = "cad.ply";
/// Name of the picture.
const RING: &str = "ring.svg";
/// Chord error, above which a CAD mesh takes too much of a limit, as a share of the warning limit.
const MOST_CHORD: f64 = 0.2;

/// Make a tool folder from a CAD mesh: find axis, teeth, involute and radii, write tool.toml and a picture of the numbered teeth.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope init die.stl --teeth 12,40,68 --warn-um 30 --limit-um 50 --out die\n\n\
    The mesh must be a spur gear, internal or external, anywhere in space: it is moved so that the gear's axis is z, its teeth are\n\
    counted anticlockwise from +x, seen from +z. Pitch circle is the one on which teeth and spaces are equally wide. A STEP file is\n\
    meshed first:\n  gmsh die.step -2 -bin -setnumber Mesh.MeshSizeFromCurvature 200 -setnumber Mesh.MeshSizeMax 5 -o die.stl"
)]
pub struct Args {
    /// CAD mesh: PLY, STL or OBJ
    #[arg(value_name = "CAD")]
    cad: PathBuf,
    /// Unit of the CAD mesh; the formats do not say
    #[arg(long, value_name = "UNIT", default_value = "mm")]
    cad_unit: FileUnit,
    /// Folder to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Critical teeth, for example 12,40,68
    #[arg(long, value_delimiter = ',', value_name = "N,N,...")]
    teeth: Option<Vec<u32>>,
    /// Wear from which a flank warns
    #[arg(long, value_name = "UM")]
    warn_um: Option<f64>,
    /// Wear from which a flank is no-go
    #[arg(long, value_name = "UM")]
    limit_um: Option<f64>,
    /// Name of the tool [default: that of the CAD file]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report<'a> {
    folder: &'a Path,
    gear: &'a GearData,
    chord_error_um: f64,
    /// The tool frame from that of the CAD file, row by row, mm.
    tool_from_file: [[f64; 4]; 4],
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.common.try_json()?;
    args.check()?;
    let cad_args = CadArgs {
        path: args.cad.clone(),
        cad_unit: args.cad_unit,
    };
    let Cad { mesh, orientation } = cad_args.load(&args.common)?;
    if let Some(why) = orientation.unsigned {
        bail!("{}: {why}", cad_args.trouble());
    }
    let (found, mesh) = find_gear(&mesh).with_context(|| cad_args.trouble())?;
    let toml = args.tool_toml(&found)?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let file = args.out.join(FILE_NAME);
    if args.is_moved(&found) {
        write_file(&args.out.join(MOVED_CAD), |out| {
            let cad = PointFile {
                triangles: &mesh.triangles,
                ..PointFile::from_points(&mesh.vertices)
            };
            cad.write(Format::Ply, out)
        })?;
    } else {
        let bytes = std::fs::read(&args.cad).with_context(|| cad_args.trouble())?;
        write_whole(&args.out.join(args.cad_name()?), &bytes)?;
    }
    let teeth = args.teeth.as_deref().unwrap_or_default();
    write_whole(
        &args.out.join(RING),
        numbered_ring(&found.gear, teeth).as_bytes(),
    )?;
    write_whole(&file, toml.as_bytes())?;
    // What was written is read by the rules of every command.
    if let Err(error) = Tool::load(&args.out) {
        std::fs::remove_file(&file)?;
        bail!("{error}; no {FILE_NAME} is written");
    }
    args.common.write_json(&Report {
        folder: &args.out,
        gear: &found.gear,
        chord_error_um: 1e3 * found.chord_error_mm,
        tool_from_file: found.rows(),
    })?;
    tell(&args.common, || args.told(&found));
    Ok(Outcome::Done)
}

impl Args {
    /// Everything that is missing, at once.
    fn check(&self) -> anyhow::Result<()> {
        let ending = self
            .cad
            .extension()
            .map(|ending| ending.to_ascii_lowercase());
        let is_step = ending.is_some_and(|ending| ending == "step" || ending == "stp");
        ensure!(
            !is_step,
            "{} is STEP, which is not read; mesh it first:  gmsh {0} -2 -bin -setnumber Mesh.MeshSizeFromCurvature 200 -setnumber \
             Mesh.MeshSizeMax 5 -o die.stl  (other ways: docs/guide.md)",
            self.cad.display()
        );
        let named = [
            (
                "--teeth N,N,...",
                self.teeth.is_some(),
                "the critical teeth",
            ),
            ("--warn-um UM", self.warn_um.is_some(), "wear that warns"),
            (
                "--limit-um UM",
                self.limit_um.is_some(),
                "wear that stops the press",
            ),
        ];
        let missing: Vec<String> = named
            .iter()
            .filter(|(_, given, _)| !given)
            .map(|(option, _, what)| format!("{option} ({what})"))
            .collect();
        ensure!(
            missing.is_empty(),
            "nobody but you knows these: {}",
            missing.join(", ")
        );
        let file = self.out.join(FILE_NAME);
        ensure!(
            !file.exists(),
            "{} is there already; it is not replaced",
            file.display()
        );
        Ok(())
    }

    /// Whether the mesh in the folder is another than the file: in mm and about z.
    fn is_moved(&self, found: &FoundGear) -> bool {
        found.is_moved() || !matches!(self.cad_unit, FileUnit::Mm)
    }

    fn cad_name(&self) -> anyhow::Result<String> {
        let name = self.cad.file_name().and_then(|name| name.to_str());
        Ok(name.context("the CAD file's name is no text")?.to_owned())
    }

    fn tool_toml(&self, found: &FoundGear) -> anyhow::Result<String> {
        let (Some(teeth), Some(warn_um), Some(limit_um)) =
            (&self.teeth, self.warn_um, self.limit_um)
        else {
            bail!("teeth and limits are missing");
        };
        let gear = &found.gear;
        // Stated to a tenth of a micrometre, rounded up; the mesh is never taken as exact.
        let chord_error_um = (1e4 * found.chord_error_mm).ceil().max(1.0) / 10.0;
        ensure!(
            chord_error_um <= MOST_CHORD * warn_um,
            "the facets of {} lie up to {chord_error_um} um from the involute, {:.1} um may be (a fifth of --warn-um); mesh the CAD finer",
            self.cad.display(),
            MOST_CHORD * warn_um
        );
        let cad = if self.is_moved(found) {
            MOVED_CAD.to_owned()
        } else {
            self.cad_name()?
        };
        let stem = self
            .cad
            .file_stem()
            .and_then(|stem| stem.to_str())
            .unwrap_or("die");
        let name = self.name.as_deref().unwrap_or(stem);
        // Millimetres and degrees to a millionth.
        let gear = GearData {
            module_mm: rounded(gear.module_mm),
            pressure_angle_deg: rounded(gear.pressure_angle_deg),
            tip_radius_mm: rounded(gear.tip_radius_mm),
            root_radius_mm: rounded(gear.root_radius_mm),
            first_tooth_centre_deg: rounded(gear.first_tooth_centre_deg),
            height_mm: gear.height_mm.map(rounded),
            radial_threshold_mm: rounded(gear.radial_threshold_mm),
            ..gear.clone()
        };
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let teeth: Vec<String> = teeth.iter().map(u32::to_string).collect();
        let [low, high] = gear.height_mm;
        Ok(format!(
            "# Made by `flankscope init`; docs/formats/tool.md has every key.\n\
             name = {}\n# serial = \"...\"   # of this die, so that its history stays with it\n\n\
             [cad]\nfile = {}\nunit = \"mm\"\nchord_error_um = {chord_error_um}   # facets lie within it of the involute\n\n\
             # Found in the CAD. Teeth and spaces are equally wide on the pitch circle; teeth follow the first one anticlockwise, seen\n\
             # from +z ({RING}).\n[gear]\n{}\n\
             [inspect]\nteeth = [{}]\nheight_mm = {:?}   # where the head looks\nwarn_um = {warn_um:?}\nlimit_um = {limit_um:?}\n\
             # as_built_um = 5.0   # standard uncertainty of the flanks' form as built; without it the CAD is taken as true\n",
            quoted(name),
            quoted(&cad),
            toml::to_string(&gear)?,
            teeth.join(", "),
            0.5 * (low + high),
        ))
    }

    fn told(&self, found: &FoundGear) -> String {
        let gear = &found.gear;
        let place = if self.is_moved(found) {
            format!("; moved to millimetres and its axis to z ({MOVED_CAD})")
        } else {
            String::new()
        };
        format!(
            "{:?} gear of {} teeth, module {:.4} mm, pressure angle {:.3} deg, tip radius {:.3} mm, root {:.3} mm, height {:.2} to {:.2} mm, \
             facets within {:.2} um{place}\n{}: {FILE_NAME}, CAD, {RING} with the numbers of the teeth\n\
             next: flankscope inspect --tool {} --link sim",
            gear.kind,
            gear.teeth,
            gear.module_mm,
            gear.pressure_angle_deg,
            gear.tip_radius_mm,
            gear.root_radius_mm,
            gear.height_mm[0],
            gear.height_mm[1],
            1e3 * found.chord_error_mm,
            self.out.display(),
            self.out.display(),
        )
    }
}

fn rounded(value: f64) -> f64 {
    (1e6 * value).round() / 1e6
}
