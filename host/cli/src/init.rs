//! `flankscope init`: a tool folder from a CAD mesh.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail, ensure};
use clap::ValueEnum as _;
use flankscope_metrology::gear::GearData;
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_metrology::tool::gear_in_cad::{FoundGear, find_gear};
use flankscope_metrology::tool::{FILE_NAME, Tool};
use flankscope_report::numbered_ring;
use serde::Serialize;

use crate::geometry::{Cad, CadArgs, FileUnit, tell, write_file};
use crate::init_patches::{FacePoint, FaceReport, Faces};
use crate::output::{Common, Outcome, write_whole};

/// Name of the CAD in the folder where it had to be moved to the tool frame.
const MOVED_CAD: &str = "cad.ply";
/// Name of the picture.
const RING: &str = "ring.svg";
/// Chord error, above which a CAD mesh takes too much of a limit, as a share of the warning limit.
const MOST_CHORD: f64 = 0.2;

/// Make a tool folder from a CAD mesh: find axis, teeth, involute and radii, write tool.toml and a picture of the numbered teeth; of a
/// part without teeth, its faces by points on them.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope init die.stl --teeth 12,40,68 --warn-um 30 --limit-um 50 --out die\n\n\
    The mesh must be a spur gear, internal or external, anywhere in space: it is moved so that the gear's axis is z, its teeth are\n\
    counted anticlockwise from +x, seen from +z. Pitch circle is the one on which teeth and spaces are equally wide. A STEP file is\n\
    meshed first:\n  gmsh die.step -2 -bin -setnumber Mesh.MeshSizeFromCurvature 200 -setnumber Mesh.MeshSizeMax 5 -o die.stl\n\n\
    A part without teeth:\n  flankscope init die.stl --patch boss=41.3,0,20 --datum 41.8,5,20 --datum 41.8,-5,20 --warn-um 30 --limit-um 50 --out die"
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
    /// Face to judge of a part without teeth, by a point on it, mm; may be repeated
    #[arg(
        long,
        value_name = "[NAME=]X,Y,Z",
        allow_hyphen_values = true,
        conflicts_with = "teeth"
    )]
    patch: Vec<FacePoint>,
    /// Face that the workpiece never touches: the pose rests on it; may be repeated
    #[arg(
        long,
        value_name = "[NAME=]X,Y,Z",
        allow_hyphen_values = true,
        conflicts_with = "teeth"
    )]
    datum: Vec<FacePoint>,
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
    /// Null of a part without teeth.
    gear: Option<&'a GearData>,
    /// Empty of a gear.
    patches: Vec<FaceReport<'a>>,
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
    if !args.patch.is_empty() {
        return args.write_faces(&Faces::new(&args.patch, &args.datum, &mesh)?);
    }
    let (found, mesh) = find_gear(&mesh).map_err(|error| {
        anyhow!(
            "{}: {error}; of a part without teeth, name faces by --patch and --datum",
            cad_args.trouble()
        )
    })?;
    let toml = args.tool_toml(&found)?;
    args.make_folder()?;
    if args.is_moved(&found) {
        write_file(&args.out.join(MOVED_CAD), |out| {
            let cad = PointFile {
                triangles: &mesh.triangles,
                ..PointFile::from_points(&mesh.vertices)
            };
            cad.write(Format::Ply, out)
        })?;
    } else {
        args.copy_cad()?;
    }
    let teeth = args.teeth.as_deref().unwrap_or_default();
    write_whole(
        &args.out.join(RING),
        numbered_ring(&found.gear, teeth).as_bytes(),
    )?;
    args.write_tool(&toml)?;
    args.common.write_json(&Report {
        folder: &args.out,
        gear: Some(&found.gear),
        patches: Vec::new(),
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
        let is_part = !(self.patch.is_empty() && self.datum.is_empty());
        let named = [
            (
                "--teeth N,N,...",
                self.teeth.is_some() || is_part,
                "the critical teeth; of a part without teeth --patch and --datum",
            ),
            (
                "--patch X,Y,Z",
                !(self.patch.is_empty() && is_part),
                "a face to judge",
            ),
            (
                "--datum X,Y,Z",
                !(self.datum.is_empty() && is_part),
                "faces that the workpiece never touches",
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

    fn make_folder(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the folder {}", self.out.display()))
    }

    fn copy_cad(&self) -> anyhow::Result<()> {
        let bytes = std::fs::read(&self.cad)
            .with_context(|| format!("cannot read {}", self.cad.display()))?;
        write_whole(&self.out.join(self.cad_name()?), &bytes)
    }

    /// Writes the tool file; what was written is read by the rules of every command.
    fn write_tool(&self, toml: &str) -> anyhow::Result<()> {
        let file = self.out.join(FILE_NAME);
        write_whole(&file, toml.as_bytes())?;
        if let Err(error) = Tool::load(&self.out) {
            std::fs::remove_file(&file)?;
            bail!("{error}; no {FILE_NAME} is written");
        }
        Ok(())
    }

    /// The folder of a part without teeth.
    fn write_faces(&self, faces: &Faces) -> anyhow::Result<Outcome> {
        let (Some(warn_um), Some(limit_um)) = (self.warn_um, self.limit_um) else {
            bail!("limits are missing");
        };
        let chord_error_um = self.chord_error_um(faces.chord_error_mm, warn_um)?;
        let unit = self.cad_unit.to_possible_value();
        let toml = format!(
            "{}\n{}[inspect]\nwarn_um = {warn_um:?}\nlimit_um = {limit_um:?}\n",
            self.head_toml(
                &self.cad_name()?,
                unit.as_ref().map_or("mm", |unit| unit.get_name()),
                chord_error_um,
                "the judged faces",
            ),
            faces.toml()
        );
        self.make_folder()?;
        self.copy_cad()?;
        self.write_tool(&toml)?;
        self.common.write_json(&Report {
            folder: &self.out,
            gear: None,
            patches: faces.report(),
            chord_error_um,
            tool_from_file: std::array::from_fn(|i| {
                std::array::from_fn(|k| if i == k { 1.0 } else { 0.0 })
            }),
        })?;
        tell(&self.common, || {
            format!(
                "{}facets within {chord_error_um} um\n{}: {FILE_NAME} and CAD\nnext: flankscope inspect --tool {} --link sim",
                faces.told(),
                self.out.display(),
                self.out.display(),
            )
        });
        Ok(Outcome::Done)
    }

    /// Chord error as the tool file states it, µm: rounded up to a tenth.
    ///
    /// # Errors
    /// It would take too much of the warning limit.
    fn chord_error_um(&self, chord_error_mm: f64, warn_um: f64) -> anyhow::Result<f64> {
        let chord_error_um = (1e4 * chord_error_mm).ceil() / 10.0;
        ensure!(
            chord_error_um <= MOST_CHORD * warn_um,
            "the facets of {} lie up to {chord_error_um} um from the surface, {:.1} um may be (a fifth of --warn-um); mesh the CAD finer",
            self.cad.display(),
            MOST_CHORD * warn_um
        );
        Ok(chord_error_um)
    }

    /// The lines of a tool file before gear or patches.
    fn head_toml(&self, cad: &str, unit: &str, chord_error_um: f64, surface: &str) -> String {
        let quoted = |text: &str| toml::Value::from(text).to_string();
        let stem = self.cad.file_stem().and_then(|stem| stem.to_str());
        let name = self.name.as_deref().or(stem).unwrap_or("die");
        format!(
            "# Made by `flankscope init`; docs/formats/tool.md has every key.\n\
             name = {}\n# serial = \"...\"   # of this die, so that its history stays with it\n\n\
             [cad]\nfile = {}\nunit = {}\nchord_error_um = {chord_error_um}   # facets lie within it of {surface}\n",
            quoted(name),
            quoted(cad),
            quoted(unit),
        )
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
        // The mesh of a gear is never taken as exact.
        let chord_error_um = self.chord_error_um(found.chord_error_mm, warn_um)?.max(0.1);
        let cad = if self.is_moved(found) {
            MOVED_CAD.to_owned()
        } else {
            self.cad_name()?
        };
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
        let teeth: Vec<String> = teeth.iter().map(u32::to_string).collect();
        let [low, high] = gear.height_mm;
        let zone = zone_toml(&gear);
        Ok(format!(
            "{}\n\
             # Found in the CAD. Teeth and spaces are equally wide on the pitch circle; teeth follow the first one anticlockwise, seen\n\
             # from +z ({RING}).\n[gear]\n{}\n\
             [inspect]\nteeth = [{}]\nheight_mm = {:?}   # where the head looks\n{zone}warn_um = {warn_um:?}\nlimit_um = {limit_um:?}\n\
             # as_built_um = 5.0   # standard uncertainty of the flanks' form as built; without it the CAD is taken as true\n",
            self.head_toml(&cad, "mm", chord_error_um, "the involute",),
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

/// Half the height of the judged zone, mm, and the area of the disc of wear, mm², where a tool file does not state them.
const USUAL_HALF_MM: f64 = 4.0;
const USUAL_AREA_MM2: f64 = 0.25;
/// Share of the toothing's height that a zone takes at most, and of the largest disc in the zone that the disc of wear takes.
const ZONE_SHARE: f64 = 0.9;
const DISC_SHARE: f64 = 0.5;

/// Keys of the judged zone and of the disc of wear, where the gear is too small for the usual ones.
fn zone_toml(gear: &GearData) -> String {
    let [low_mm, high_mm] = gear.height_mm;
    let half_mm = (0.5 * ZONE_SHARE * (high_mm - low_mm)).min(USUAL_HALF_MM);
    let [from_mm, to_mm] = gear.active_flank_mm().map(|radius| gear.profile_mm(radius));
    let room_mm = (to_mm - from_mm).abs().min(2.0 * half_mm);
    let area_mm2 = (DISC_SHARE * 0.25 * PI * room_mm * room_mm).min(USUAL_AREA_MM2);
    let mut keys = String::new();
    if half_mm < USUAL_HALF_MM {
        let half_mm = rounded(half_mm);
        keys += &format!(
            "zone_height_mm = [{:?}, {half_mm:?}]   # the toothing is low\n",
            -half_mm
        );
    }
    if area_mm2 < USUAL_AREA_MM2 {
        let area_mm2 = (1e3 * area_mm2).floor() / 1e3;
        keys += &format!("wear_area_mm2 = {area_mm2:?}   # the flank is small\n");
    }
    keys
}

fn rounded(value: f64) -> f64 {
    (1e6 * value).round() / 1e6
}
