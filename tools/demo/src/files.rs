//! The demo tool as the files a user would write: CAD, tool.toml, head.toml.

use std::fmt::Write as _;
use std::path::Path;

use flankscope_bench::demo::{CHORD_ERROR_MM, HEIGHT_MM, gear};
use flankscope_bench::files::DEMO_PATTERNS;
use flankscope_bench::world::{HeadOptics, Pinhole, SensorSpec};
use flankscope_gear_cad::{GearSpec, Meshing};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::head::{self, DepthRange, ImageCircle, RigidTransform, Sensor};
use flankscope_station::files::{stream_whole, write_whole};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::tile::core_map_file;

/// Exposures of the in-situ check, µs: lit tip lands fill a third of the well in 40 ms, steep flanks get half as much.
const EXPOSURES_US: [u32; 2] = [10_000, 40_000];
/// Pixels along a measuring cell: about one core (3.45 px).
const BINNING: u32 = 3;
/// Depths that the head measures, mm from the camera's pinhole: 3.4 mm about the focus at 22 mm.
const VOLUME: DepthRange = DepthRange {
    near_mm: 20.3,
    far_mm: 23.7,
};

/// Writes `die.ply`, `tool.toml`, `head.toml` and `cores.csv` into a folder, which is made if it is not there.
///
/// # Errors
/// The files cannot be written.
pub fn write_tool(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    let gear = gear();
    let mesh = gear.mesh(&Meshing {
        chord_error_mm: CHORD_ERROR_MM,
        ..Meshing::default()
    })?;
    stream_whole(&folder.join("die.ply"), |file| {
        flankscope_gear_cad::write_ply(&mesh, file)
    })?;
    write_whole(&folder.join("tool.toml"), tool_toml(&gear)?.as_bytes())?;
    let mut head = head();
    let (cores_csv, cores) = core_map_file(&head)?;
    write_whole(&folder.join(&cores.file), cores_csv.as_bytes())?;
    head.cores = Some(cores);
    write_whole(&folder.join("head.toml"), head.to_toml()?.as_bytes())?;
    Ok(())
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

/// The demo head as its calibration file describes it.
#[must_use]
pub fn head() -> HeadModel {
    let optics = HeadOptics::prism_20mm();
    let sensor = SensorSpec::imx174();
    let centre_px = optics.camera.centre_px;
    HeadModel {
        name: "prism head 20 mm".into(),
        working_distance_mm: Some(20.0),
        pattern_set: Some(DEMO_PATTERNS.into()),
        exposures_us: EXPOSURES_US.to_vec(),
        binning: BINNING,
        camera: pinhole_file(&optics.camera, optics.camera_size_px),
        projector: pinhole_file(&optics.projector, optics.projector_size_px),
        projector_from_camera: transform_file(&optics.projector_from_camera),
        stage_from_camera: Some(transform_file(&optics.stage_from_camera)),
        sensor: Some(Sensor {
            full_well_e: sensor.full_well_e,
            gain_e_per_dn: sensor.gain_e_per_dn(),
            read_noise_e: sensor.read_noise_e,
            offset_dn: sensor.offset_dn,
            bits: sensor.bits,
        }),
        volume: Some(VOLUME),
        image_circle: Some(ImageCircle {
            centre_px,
            radius_px: 575.0,
        }),
        cores: None,
        calibration: None,
        self_test: None,
        seal: None,
        core_map: None,
        mirrors: None,
        fringe_contrast: None,
    }
}

fn pinhole_file(pinhole: &Pinhole, [width, height]: [usize; 2]) -> head::Pinhole {
    head::Pinhole {
        width_px: width as u32,
        height_px: height as u32,
        focal_px: pinhole.focal_px,
        principal_px: pinhole.centre_px,
        distortion: pinhole.distortion,
        residual: None,
    }
}

pub(crate) fn transform_file(transform: &Isometry3<f64>) -> RigidTransform {
    let matrix = transform.rotation.to_rotation_matrix();
    RigidTransform {
        rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
        translation_mm: transform.translation.vector.into(),
    }
}

pub(crate) fn transform_of(file: &RigidTransform) -> Isometry3<f64> {
    let matrix = Matrix3::from_fn(|row, column| file.rotation[row][column]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    Isometry3::from_parts(
        Translation3::from(Vector3::from(file.translation_mm)),
        rotation,
    )
}
