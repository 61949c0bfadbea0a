//! The demo's calibration target: six plates with printed dots, a blank one and a sphere on a carrier that sits where the die
//! does, and the head as its drawing shows it.

use std::path::Path;

use flankscope_gear_cad::Mesh;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::{Dots, KEYS, Plate, Sphere, Target};
use flankscope_profilometry::head::Limits;
use flankscope_station::files::write_whole;
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::files::{transform_file, transform_of};
use super::{HEIGHT_MM, gear, head};
use crate::world::random::{Normals, Purpose, stream};
use crate::world::{Print, Surface, WorldConfig};

/// The plates reach this far from their middle, mm: beyond the field wherever the stages stand.
const HALF_MM: f64 = 7.0;
/// Angle from station to station of the carrier.
const STATION_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Printed plates: tilt about their x (along the die axis) and y (along the circumference) in rad, distance from the axis in mm.
const PRINTED: [([f64; 2], f64); 6] = [
    ([0.0, 0.22], 41.5),
    ([0.0, -0.22], 41.5),
    ([0.20, 0.0], 41.5),
    ([-0.20, 0.0], 41.5),
    ([0.14, 0.14], 41.0),
    ([-0.14, -0.14], 42.0),
];
/// The blank plate stands in best focus.
const BLANK_RADIUS_MM: f64 = 41.5;
/// The white of the plates comes to two thirds of the full well.
const EXPOSURE_US: u32 = 12_000;
/// Where the head clears the target: as far up as above the die.
const RETRACT_MM: f64 = 86.0;
/// The sphere: its front stands half a millimetre before best focus.
const SPHERE_DIAMETER_MM: f64 = 3.0;
const SPHERE_CENTRE_RADIUS_MM: f64 = 42.5;
/// It is sunk into a matt ground, which keeps the picture lit.
const SPHERE_GROUND_RADIUS_MM: f64 = 43.0;
/// Reflectance of the print relative to the plate.
const INK_RATIO: f64 = 0.25;

/// A plate on the carrier's station, facing the axis: x along the axis, y along the circumference, z towards the axis.
fn plate(station: usize, tilt: [f64; 2], radius_mm: f64) -> Isometry3<f64> {
    let axes = Rotation3::from_basis_unchecked(&[Vector3::z(), Vector3::y(), -Vector3::x()]);
    let facing = UnitQuaternion::from_rotation_matrix(&axes)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt[0])
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt[1]);
    let place = Translation3::new(radius_mm, 0.0, HEIGHT_MM);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), STATION_RAD * station as f64);
    turned * Isometry3::from_parts(place, facing)
}

/// A place on the carrier at mid-height.
fn station(number: usize, radius_mm: f64) -> Vector3<f64> {
    let (sin, cos) = (STATION_RAD * number as f64).sin_cos();
    Vector3::new(radius_mm * cos, radius_mm * sin, HEIGHT_MM)
}

/// A sphere's facets, rows of latitude about z: chords of 0.1 um on a radius of 1.5 mm.
fn sphere(centre: Vector3<f64>, radius_mm: f64, mesh: &mut Mesh) {
    const ROWS: u32 = 136;
    let first = mesh.vertices.len() as u32;
    let step_rad = std::f64::consts::PI / f64::from(ROWS);
    for row in 0..=ROWS {
        let (sin, cos) = (step_rad * f64::from(row)).sin_cos();
        for column in 0..2 * ROWS {
            let (y, x) = (step_rad * f64::from(column)).sin_cos();
            let vertex = centre + radius_mm * Vector3::new(sin * x, sin * y, -cos);
            mesh.vertices.push(vertex.into());
        }
    }
    for row in 0..ROWS {
        for column in 0..2 * ROWS {
            let at = |row: u32, column: u32| first + row * 2 * ROWS + column % (2 * ROWS);
            let [a, b] = [at(row, column), at(row, column + 1)];
            let [c, d] = [at(row + 1, column + 1), at(row + 1, column)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
}

/// The target as its certificate describes it.
#[must_use]
pub fn target() -> Target {
    let file = |pose: Isometry3<f64>| Plate {
        tool_from_plate: transform_file(&pose),
    };
    let printed = PRINTED.iter().enumerate();
    Target {
        name: "six dot plates, a blank one and a sphere".into(),
        exposure_us: EXPOSURE_US,
        retract_mm: RETRACT_MM,
        pose_sigma_mm: 2e-3,
        pose_sigma_rad: 50e-6,
        dots: Dots {
            pitch_mm: 0.5,
            diameter_mm: 0.25,
            key_diameter_mm: 0.35,
        },
        blank: file(plate(PRINTED.len(), [0.0; 2], BLANK_RADIUS_MM)),
        plate: printed
            .map(|(station, &(tilt, radius_mm))| file(plate(station, tilt, radius_mm)))
            .collect(),
        sphere: Some(Sphere {
            centre_mm: station(PRINTED.len() + 1, SPHERE_CENTRE_RADIUS_MM).into(),
            diameter_mm: SPHERE_DIAMETER_MM,
        }),
        limits: Some(Limits {
            flatness_um: 45.0,
            probing_form_um: 45.0,
            probing_size_um: 8.0,
            flatness_cells_um: Some(8.0),
            probing_form_cells_um: Some(8.0),
            every_days: 7,
        }),
    }
}

/// The target before the demo head: its plates lie as well as the certificate says, drawn from `seed`.
#[must_use]
pub fn target_world(target: &Target, seed: u64) -> WorldConfig {
    let mut random = Normals::new(stream(seed, Purpose::Target));
    let mut as_built = |plate: &Plate| {
        let mut draw = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.next());
        let turn = UnitQuaternion::from_scaled_axis(draw(target.pose_sigma_rad));
        let shift = draw(target.pose_sigma_mm);
        let mut pose = transform_of(&plate.tool_from_plate);
        pose.rotation = turn * pose.rotation;
        pose.translation.vector += shift;
        pose
    };
    let printed: Vec<Isometry3<f64>> = target.plate.iter().map(&mut as_built).collect();
    let blank = as_built(&target.blank);
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let ground = plate(PRINTED.len() + 1, [0.0; 2], SPHERE_GROUND_RADIUS_MM);
    for pose in printed.iter().chain([&blank, &ground]) {
        let first = mesh.vertices.len() as u32;
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        for [x, y] in corners {
            let corner = pose * Point3::new(HALF_MM * x, HALF_MM * y, 0.0);
            mesh.vertices.push(corner.coords.into());
        }
        mesh.triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| first + i)));
    }
    if let Some(artefact) = &target.sphere {
        let radius_mm = 0.5 * artefact.diameter_mm;
        sphere(artefact.centre_mm.into(), radius_mm, &mut mesh);
    }
    let mut config = WorldConfig::new(mesh, gear());
    // Lithography on ceramic: matt, and even to a percent.
    config.surface = Surface {
        roughness_ratio: 0.01,
        gloss_ratio: 0.0,
        ..Surface::sprayed()
    };
    config.print = Some(Print {
        tool_from_plate: printed,
        pitch_mm: target.dots.pitch_mm,
        radius_mm: 0.5 * target.dots.diameter_mm,
        key_radius_mm: 0.5 * target.dots.key_diameter_mm,
        keys: KEYS.to_vec(),
        reach: (HALF_MM / target.dots.pitch_mm) as i32,
        ink_ratio: INK_RATIO,
    });
    config
}

/// The demo head as its drawing shows it: no distortion, lenses and poses off by what assembly leaves.
#[must_use]
pub fn drawn_head() -> HeadModel {
    let mut head = head();
    head.name = "prism head 20 mm, drawing values".into();
    for (lens, stretch, shift_px) in [
        (&mut head.camera, 1.006, [3.0, -2.0]),
        (&mut head.projector, 0.995, [-2.0, 0.0]),
    ] {
        lens.distortion = [0.0; 5];
        lens.focal_px = lens.focal_px.map(|focal| stretch * focal);
        lens.principal_px = [0, 1].map(|k| lens.principal_px[k] + shift_px[k]);
    }
    let moved = |pose: &Isometry3<f64>, turn: Vector3<f64>, shift: Vector3<f64>| {
        let rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
        Isometry3::from_parts(
            Translation3::from(pose.translation.vector + shift),
            rotation,
        )
    };
    let projector = transform_of(&head.projector_from_camera);
    let turn = Vector3::new(1.5e-3, -2e-3, 1e-3);
    let shift = Vector3::new(0.04, 0.03, -0.05);
    head.projector_from_camera = transform_file(&moved(&projector, turn, shift));
    head.stage_from_camera = head.stage_from_camera.map(|hand_eye| {
        let turn = Vector3::new(5e-3, -4e-3, 6e-3);
        let shift = Vector3::new(0.25, -0.3, 0.2);
        transform_file(&moved(&transform_of(&hand_eye), turn, shift))
    });
    head
}

/// Writes `target.toml` and the drawing's `head.toml` into a folder, which is made if it is not there.
///
/// # Errors
/// The files cannot be written.
pub fn write_target(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    write_whole(&folder.join("target.toml"), target().to_toml()?.as_bytes())?;
    write_whole(
        &folder.join("head.toml"),
        drawn_head().to_toml()?.as_bytes(),
    )?;
    Ok(())
}
