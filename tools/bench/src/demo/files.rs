//! The demo's folder: CAD, tool file and head file, as an engineer would keep them.

use super::{CHORD_ERROR_MM, HEIGHT_MM, gear};
use crate::world::{HeadOptics, Pinhole, SensorSpec, WorldConfig};
use flankscope_gear_cad::{GearKind, GearSpec, MeshError, Meshing, write_ply};
use flankscope_station::files::{stream_whole, write_whole};
use nalgebra::Isometry3;
use std::io;
use std::path::{Path, PathBuf};

/// Teeth that the demo inspects: a third of a turn apart.
const TEETH: [u32; 3] = [12, 40, 68];
/// Short exposure for lands, long one for flanks: see the `frames` example for the charge that each gives.
const EXPOSURES_US: [u32; 2] = [10_000, 50_000];
/// Half of the usable depth, mm. The field of 4 mm in depth moves four periods by 97 % of one period: too near to the next.
const HALF_DEPTH_MM: f64 = 1.9;

/// The files of a tool folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToolFiles {
    /// CAD of the die.
    pub cad: PathBuf,
    /// Gear data, what to inspect, limits.
    pub tool: PathBuf,
    /// Calibration of the head.
    pub head: PathBuf,
}

/// Why the folder was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DemoError {
    /// The die cannot be meshed.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A file or the folder cannot be written.
    #[error("cannot write {}: {source}; a folder with room for 2 MB that may be written to is needed", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
}

/// Writes `die.ply`, `tool.toml` and `head.toml` into `folder`, which is created if missing; each file whole or not at all.
pub fn write_tool(folder: &Path) -> Result<ToolFiles, DemoError> {
    let write = |path: &Path| {
        let path = path.to_owned();
        move |source| DemoError::Write { path, source }
    };
    std::fs::create_dir_all(folder).map_err(write(folder))?;
    let files = ToolFiles {
        cad: folder.join("die.ply"),
        tool: folder.join("tool.toml"),
        head: folder.join("head.toml"),
    };
    let gear = gear();
    let cad = gear.mesh(&Meshing {
        chord_error_mm: CHORD_ERROR_MM,
        ..Meshing::default()
    })?;
    stream_whole(&files.cad, |file| write_ply(&cad, io::BufWriter::new(file)))
        .map_err(write(&files.cad))?;
    write_whole(&files.tool, tool_toml(&gear).as_bytes()).map_err(write(&files.tool))?;
    let head = head_toml(&WorldConfig::new(cad, gear));
    write_whole(&files.head, head.as_bytes()).map_err(write(&files.head))?;
    Ok(files)
}

/// The tool file of the demo die.
pub fn tool_toml(gear: &GearSpec) -> String {
    let kind = match gear.kind {
        GearKind::Internal => "internal",
        GearKind::External => "external",
    };
    format!(
        "# The built-in demo: a sheet-bulk metal forming die with internal toothing.\n\
         name = \"demo\"\n\n\
         [cad]\nfile = \"die.ply\"\nunit = \"mm\"\nchord_error_um = {chord:?}\n\n\
         [gear] # axis z; tooth 1 is centred half a pitch from +x\n\
         kind = \"{kind}\"\nteeth = {teeth}\nmodule_mm = {module:?}\npressure_angle_deg = {pressure:?}\n\
         tip_radius_mm = {tip:?}\nroot_radius_mm = {root:?}\nfirst_tooth_centre_deg = {first:?}\n\
         height_mm = {height:?}\nradial_threshold_mm = 50.0\n\n\
         [inspect]\nteeth = {inspected:?}\nheight_mm = {HEIGHT_MM:?}\nzone_height_mm = [-3.0, 3.0] # about height_mm\n\
         warn_um = 30.0\nlimit_um = 50.0\n",
        chord = rounded(CHORD_ERROR_MM * 1e3),
        teeth = gear.teeth,
        module = gear.module_mm,
        pressure = rounded(gear.pressure_angle_rad.to_degrees()),
        tip = gear.tip_radius_mm,
        root = gear.root_radius_mm,
        first = gear.tooth_centre_rad(1).to_degrees(),
        height = gear.height_mm,
        inspected = TEETH,
    )
}

/// The head file of a world's head: its exact calibration.
pub fn head_toml(config: &WorldConfig) -> String {
    let HeadOptics {
        camera,
        projector,
        camera_size_px,
        projector_size_px,
        ..
    } = &config.optics;
    let focus_mm = config.optics.camera_objective.focus_mm;
    format!(
        "# The demo's head: a prism head for 20 mm working distance.\n\
         name = \"prism head 20 mm\"\nworking_distance_mm = 20.0\npattern_set = \"insitu12\"\n\
         exposures_us = {EXPOSURES_US:?}\nbinning = 3\n\n\
         {camera}\n{projector}\n{pair}\n{hand_eye}\n{sensor}\n\
         [volume] # along the camera's axis\nnear_mm = {near:?}\nfar_mm = {far:?}\n\n\
         [image_circle]\ncentre_px = {centre:?}\nradius_px = {radius:?}\n",
        camera = pinhole("camera", camera, *camera_size_px),
        projector = pinhole("projector", projector, *projector_size_px),
        pair = rigid(
            "projector_from_camera",
            &config.optics.projector_from_camera
        ),
        hand_eye = rigid("stage_from_camera", &config.optics.stage_from_camera),
        sensor = sensor(&config.sensor),
        near = focus_mm - HALF_DEPTH_MM,
        far = focus_mm + HALF_DEPTH_MM,
        centre = config.camera_bundle.centre_px,
        radius = 0.5 * config.camera_bundle.diameter_px,
    )
}

fn pinhole(table: &str, pinhole: &Pinhole, [width, height]: [usize; 2]) -> String {
    format!(
        "[{table}]\nwidth_px = {width}\nheight_px = {height}\nfocal_px = {:?}\nprincipal_px = {:?}\n\
         distortion = {:?} # k1 k2 p1 p2 k3\n",
        pinhole.focal_px, pinhole.centre_px, pinhole.distortion
    )
}

fn rigid(table: &str, transform: &Isometry3<f64>) -> String {
    let rotation = transform.rotation.to_rotation_matrix();
    let row = |i: usize| [0, 1, 2].map(|j| rotation[(i, j)]);
    format!(
        "[{table}]\nrotation = [\n  {:?},\n  {:?},\n  {:?},\n]\ntranslation_mm = {:?}\n",
        row(0),
        row(1),
        row(2),
        <[f64; 3]>::from(transform.translation.vector)
    )
}

fn sensor(spec: &SensorSpec) -> String {
    format!(
        "[sensor]\nfull_well_e = {:?}\ngain_e_per_dn = {:?}\nread_noise_e = {:?}\noffset_dn = {:?}\nbits = {}\n",
        spec.full_well_e,
        spec.gain_e_per_dn(),
        spec.read_noise_e,
        spec.offset_dn,
        spec.bits
    )
}

/// Without the last digits that a change of unit adds.
fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_is_complete_and_readable() {
        let folder = tempfile::tempdir().expect("a private folder");
        let files = write_tool(&folder.path().join("new/demo")).expect("written");
        let tool: toml::Table =
            toml::from_str(&std::fs::read_to_string(&files.tool).expect("there")).expect("TOML");
        let number = |table: &str, key: &str| tool[table][key].as_float().expect(key);
        let gear = gear();
        assert_eq!(number("gear", "tip_radius_mm"), gear.tip_radius_mm);
        assert_eq!(number("gear", "pressure_angle_deg"), 20.0);
        assert_eq!(number("cad", "chord_error_um"), 0.2);
        assert!((number("gear", "first_tooth_centre_deg") - 180.0 / 84.0).abs() < 1e-12);

        let head: toml::Table =
            toml::from_str(&std::fs::read_to_string(&files.head).expect("there")).expect("TOML");
        assert_eq!(head["camera"]["width_px"].as_integer(), Some(1920));
        let vector = |table: &str, key: &str| -> Vec<f64> {
            head[table][key]
                .as_array()
                .expect(key)
                .iter()
                .map(|v| v.as_float().expect(key))
                .collect()
        };
        // The projector's centre in the camera frame: -Rᵀ t = 22 mm from the focus point, 30 degrees aside.
        let rotation: Vec<Vec<f64>> = head["projector_from_camera"]["rotation"]
            .as_array()
            .expect("rows")
            .iter()
            .map(|row| {
                row.as_array()
                    .expect("row")
                    .iter()
                    .map(|v| v.as_float().expect("number"))
                    .collect()
            })
            .collect();
        let t = vector("projector_from_camera", "translation_mm");
        let centre = [0, 1, 2].map(|k| -(0..3).map(|i| rotation[i][k] * t[i]).sum::<f64>());
        let expected = [-11.0, 0.0, 22.0 - 22.0 * 30f64.to_radians().cos()];
        assert!(
            (0..3).all(|k| (centre[k] - expected[k]).abs() < 1e-9),
            "{centre:?}"
        );
        assert_eq!(
            vector("stage_from_camera", "translation_mm"),
            [19.5, 0.0, 0.0]
        );

        let ply = std::fs::read(&files.cad).expect("there");
        assert!(ply.starts_with(b"ply\nformat binary_little_endian 1.0\n"));
    }

    #[test]
    fn a_folder_that_cannot_be_is_named() {
        let folder = tempfile::tempdir().expect("a private folder");
        let file = folder.path().join("file");
        std::fs::write(&file, "in the way").expect("written");
        let error = write_tool(&file.join("demo")).expect_err("a file is no folder");
        assert!(error.to_string().contains("demo"), "{error}");
    }
}
