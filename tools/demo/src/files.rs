//! The demo tool as the files a user would write: CAD, tool.toml, head.toml.

use std::fmt::Write as _;
use std::path::Path;

use flankscope_bench::demo::{CHORD_ERROR_MM, HEIGHT_MM, gear};
use flankscope_bench::files::{MadeHead, OPTICS_FILE};
use flankscope_bench::world::HeadDesign;
use flankscope_foundation::files::{stream_whole, write_whole};
use flankscope_gear_cad::{GearSpec, Meshing};

use crate::head::head_of;
use crate::tile::core_map_file;

/// As much of a flank is judged up and down from the middle of the field; 4 mm before the 20 mm head, which is what a tool file
/// means that says nothing.
const ZONE_TENTHS_OF_FIELD: f64 = 4.0;
/// The corners of a zone lie within this part of the field's radius; of fields of 6 mm and more it leaves the zone as it is.
const SEEN_RATIO: f64 = 0.89;

/// Writes `die.ply`, `tool.toml`, `head.toml` and `cores.csv` into a folder, which is made if it is not there; `optics.toml`, too,
/// for any head but the demo's.
///
/// # Errors
/// The files cannot be written.
pub fn write_tool(folder: &Path, made: Option<&MadeHead>) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let gear = gear();
    let mesh = gear.mesh(&Meshing {
        chord_error_mm: CHORD_ERROR_MM,
        ..Meshing::default()
    })?;
    stream_whole(&folder.join("die.ply"), |file| {
        flankscope_gear_cad::write_ply(&mesh, file)
    })?;
    let optics = write_optics(folder, made)?;
    let mut tool = tool_toml(&gear)?;
    if made.is_some() {
        let half_mm = half_zone_mm(optics.field_mm, &gear);
        writeln!(tool, "zone_height_mm = [{:.2}, {half_mm:.2}]", -half_mm)?;
    }
    write_whole(&folder.join("tool.toml"), tool.as_bytes())?;
    let mut head = head_of(&optics);
    let (cores_csv, cores) = core_map_file(&optics)?;
    write_whole(&folder.join(&cores.file), cores_csv.as_bytes())?;
    head.cores = Some(cores);
    write_whole(&folder.join("head.toml"), head.to_toml()?.as_bytes())?;
    Ok(())
}

/// Half the height of a zone whose corners the field shows with a rim, so that rays at the border of the field hide nothing of it.
fn half_zone_mm(field_mm: f64, gear: &GearSpec) -> f64 {
    let half_flank_mm = 0.5 * (gear.root_radius_mm - gear.tip_radius_mm);
    let seen_mm = SEEN_RATIO * 0.5 * field_mm;
    let corner_mm = (seen_mm * seen_mm - half_flank_mm * half_flank_mm)
        .max(0.0)
        .sqrt();
    corner_mm.min(field_mm * ZONE_TENTHS_OF_FIELD / 10.0)
}

/// Writes how a head was made beside what stands before it, unless it is the demo's.
pub(crate) fn write_optics(folder: &Path, made: Option<&MadeHead>) -> anyhow::Result<HeadDesign> {
    let Some(made) = made else {
        return Ok(HeadDesign::demo());
    };
    write_whole(&folder.join(OPTICS_FILE), made.text.as_bytes())?;
    Ok(HeadDesign::clone(&made.optics))
}

fn tool_toml(gear: &GearSpec) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    writeln!(
        text,
        "# The demo die: 84 internal teeth on 82.9 mm, 66 mm high, about 10 kg of steel."
    )?;
    writeln!(text, "name = \"demo die\"\n")?;
    writeln!(
        text,
        "[cad]\nfile = \"die.ply\"\nunit = \"mm\"\nchord_error_um = {}\n",
        CHORD_ERROR_MM * 1e3
    )?;
    writeln!(text, "[gear]\nkind = \"internal\"\nteeth = {}", gear.teeth)?;
    writeln!(text, "module_mm = {}", gear.module_mm)?;
    writeln!(
        text,
        "pressure_angle_deg = {}",
        gear.pressure_angle_rad.to_degrees()
    )?;
    writeln!(text, "tip_radius_mm = {}", gear.tip_radius_mm)?;
    writeln!(text, "root_radius_mm = {}", gear.root_radius_mm)?;
    writeln!(
        text,
        "first_tooth_centre_deg = {} # a tooth space is centred on +x",
        180.0 / f64::from(gear.teeth)
    )?;
    writeln!(
        text,
        "height_mm = [{:.1}, {:.1}]\n",
        gear.height_mm[0], gear.height_mm[1]
    )?;
    writeln!(
        text,
        "[inspect]\nteeth = [12, 40, 68] # a third of a turn apart"
    )?;
    writeln!(text, "height_mm = {HEIGHT_MM:.1} # where the head looks")?;
    writeln!(text, "warn_um = 30.0\nlimit_um = 50.0")?;
    Ok(text)
}
