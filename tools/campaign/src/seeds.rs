//! Originals that a command does more with than read: captures of a target, a head's focus series, a board in some poses. What
//! they name lies beside them, so that a mutant gets as far as the calculation.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::Captures;
use flankscope_profilometry::head::LensDrive;
use nalgebra::{Rotation3, Vector3};

/// Section of a head file on a driven lens.
pub const LENS: &str = "\n[lens]\nzero_counts = 516.0\ndpt_per_count = 0.0399\nrange = [416, 616]\nsettle_ms = 150\ncounts = 541\n";

/// Of the demo's captures, keeps the blank plate and one view of each printed plate, which is what an adjustment needs at least.
pub fn shorten_captures(folder: &Path) -> anyhow::Result<()> {
    let path = folder.join(Captures::FILE);
    let mut captures: Captures = toml::from_str(&std::fs::read_to_string(&path)?)?;
    let mut plates = std::collections::BTreeSet::new();
    captures.view.retain(|view| plates.insert(view.plate));
    captures.sphere.clear();
    for entry in std::fs::read_dir(folder)?.flatten() {
        let name = std::path::PathBuf::from(entry.file_name());
        let kept = name == captures.blank || captures.view.iter().any(|view| view.folder == name);
        if entry.path().is_dir() && !kept {
            std::fs::remove_dir_all(entry.path())?;
        }
    }
    std::fs::write(path, captures.to_toml()?)?;
    Ok(())
}

/// Three settings of a lens whose focal length grows with its power, from one calibrated head, and the file that lists them.
pub fn write_focus(folder: &Path, calibrated: &Path) -> anyhow::Result<()> {
    let mut table: BTreeMap<String, LensDrive> = toml::from_str(LENS)?;
    let lens = table.remove("lens").context("a lens")?;
    let mut series =
        "name = \"liquid\"\ndrift_dpt_per_kelvin = 0.05\ndrift_sigma_dpt_per_kelvin = 0.01\n\
                      celsius_sigma = 0.5\n"
            .to_owned();
    for (file, setting_dpt) in [("a.toml", -3.0), ("b.toml", 0.0), ("c.toml", 3.0)] {
        let mut head = HeadModel::load(calibrated)?;
        let driven = lens.driven_to(setting_dpt);
        head.lens = Some(driven.map_err(|bad| bad.in_file(calibrated, ""))?);
        for focal_px in &mut head.camera.focal_px {
            *focal_px *= 1.0 + 1e-3 * setting_dpt;
        }
        let blake3 = head.geometry_blake3();
        head.calibration.as_mut().context("calibrated")?.blake3 = blake3;
        std::fs::write(folder.join(file), head.to_toml()?)?;
        series += &format!(
            "[[focus]]\nsetting_dpt = {setting_dpt:.1}\ncelsius = 23.0\nfile = {file:?}\n"
        );
    }
    std::fs::write(folder.join("focus.toml"), series)?;
    Ok(())
}

const CAMERA_PX: [usize; 2] = [240, 180];
const CAMERA_FOCAL_PX: f64 = 302.0;
const CAMERA_PRINCIPAL_PX: [f64; 2] = [117.0, 92.0];
const PROJECTOR_PX: [f64; 2] = [400.0, 300.0];
const PROJECTOR_FOCAL_PX: f64 = 560.0;
const PROJECTOR_PRINCIPAL_PX: [f64; 2] = [205.0, 270.0];
const PROJECTOR_TURN_RAD: [f64; 3] = [0.17, 0.26, 0.05];
const PROJECTOR_SHIFT_MM: Vector3<f64> = Vector3::new(-118.0, -30.0, 40.0);
/// The board: 5 x 7 crossings.
const PITCH_MM: f64 = 22.0;
/// A pose: turns about x, then y, then z, rad; and the place of the board's middle before the camera, mm.
type Pose = ([f64; 3], [f64; 3]);
const POSES: [Pose; 5] = [
    ([0.35, 0.10, 0.05], [-8.0, 5.0, 330.0]),
    ([-0.30, 0.25, -0.10], [10.0, -6.0, 350.0]),
    ([0.10, -0.40, 0.20], [4.0, 8.0, 300.0]),
    ([-0.15, -0.20, 1.45], [-6.0, 0.0, 380.0]),
    ([0.40, -0.35, 0.60], [0.0, 4.0, 360.0]),
];
const PERIODS: [f64; 2] = [1.0, 16.0];
const STEPS: u32 = 3;

/// A checkerboard in five poses before two pinholes, in images of 240 x 180 pixels.
pub fn write_board(folder: &Path) -> anyhow::Result<()> {
    for (number, pose) in POSES.iter().enumerate() {
        let images = folder.join(format!("pose{}", number + 1));
        std::fs::create_dir_all(&images)?;
        for (axis, along) in ["columns", "rows"].into_iter().enumerate() {
            let all = PERIODS
                .iter()
                .flat_map(|&periods| (0..STEPS).map(move |step| (periods, step)));
            for (frame, (periods, step)) in all.enumerate() {
                let shift = std::f64::consts::TAU * f64::from(step) / f64::from(STEPS);
                let image = photograph(pose, |at_px| {
                    let turns = periods * (at_px[axis] + 0.5) / PROJECTOR_PX[axis];
                    0.5 + 0.4 * (std::f64::consts::TAU * turns + shift).cos()
                });
                std::fs::write(images.join(format!("{along}-{frame}.pgm")), image)?;
            }
        }
    }
    for along in ["columns", "rows"] {
        let mut plan = format!("fringes_along = \"{along}\"\n");
        for (set, periods) in PERIODS.iter().enumerate() {
            let frames =
                (0..STEPS).map(|step| format!("{along}-{}.pgm", set as u32 * STEPS + step));
            let frames: Vec<String> = frames.collect();
            plan +=
                &format!("[[set]]\nperiods = {periods:.1}\nsteps = {STEPS}\nframes = {frames:?}\n");
        }
        std::fs::write(folder.join(format!("{along}.toml")), plan)?;
    }
    let [width, height] = PROJECTOR_PX;
    let board = format!(
        "kind = \"checkerboard\"\ncolumns = 5\nrows = 7\npitch_mm = {PITCH_MM:.1}\npitch_sigma_mm = 0.01\n\
         columns_plan = \"columns.toml\"\nrows_plan = \"rows.toml\"\n\
         poses = [\"pose1\", \"pose2\", \"pose3\", \"pose4\", \"pose5\"]\n\
         [projector]\nwidth_px = {width}\nheight_px = {height}\n"
    );
    std::fs::write(folder.join("board.toml"), board)?;
    Ok(())
}

/// A pose in the light of a projector that shines as brightly as `light` says at each of its pixels: a binary PGM.
fn photograph((turns, middle): &Pose, light: impl Fn([f64; 2]) -> f64) -> Vec<u8> {
    let [camera_from_board, projector_from_camera] =
        [*turns, PROJECTOR_TURN_RAD].map(|[x, y, z]| Rotation3::from_euler_angles(x, y, z));
    let middle = Vector3::from(*middle);
    let normal = camera_from_board * Vector3::z();
    let [columns, rows] = CAMERA_PX;
    let mut image = format!("P5\n{columns} {rows}\n255\n").into_bytes();
    for pixel in 0..columns * rows {
        let mut seen = 0.0;
        // Nine rays per pixel, so that edges are as soft as a lens draws them.
        for part in 0..9 {
            let at = [pixel % columns, pixel / columns];
            let sub = [part % 3, part / 3].map(|third| (third as f64 - 1.0) / 3.0);
            let [x, y] =
                [0, 1].map(|i| (at[i] as f64 + sub[i] - CAMERA_PRINCIPAL_PX[i]) / CAMERA_FOCAL_PX);
            let ray = Vector3::new(x, y, 1.0);
            let point = ray * (normal.dot(&middle) / normal.dot(&ray));
            let on_board = camera_from_board.inverse() * (point - middle);
            let square = [on_board.x / PITCH_MM + 2.0, on_board.y / PITCH_MM + 3.0];
            let [column, row] = square.map(f64::floor);
            let inside = (-1.0..5.0).contains(&column) && (-1.0..7.0).contains(&row);
            let print = if inside && (column + row).rem_euclid(2.0) == 0.0 {
                60.0
            } else {
                250.0
            };
            let lit = projector_from_camera * point + PROJECTOR_SHIFT_MM;
            let at_px =
                [0, 1].map(|i| PROJECTOR_FOCAL_PX * lit[i] / lit[2] + PROJECTOR_PRINCIPAL_PX[i]);
            seen += print * light(at_px) / 9.0;
        }
        image.push(seen.round() as u8);
    }
    image
}
