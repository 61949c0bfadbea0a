//! Originals that a command does more with than read: captures of a target, a head's focus series, a board in some poses. What
//! they name lies beside them, so that a mutant gets as far as the calculation.

use std::path::Path;

use anyhow::Context;
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::calibrate::Captures;
use flankscope_profilometry::head::LensDrive;

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
    let lens = LensDrive {
        zero_counts: 516.0,
        dpt_per_count: 0.0399,
        range: [416, 616],
        settle_ms: 150,
        counts: 516,
    };
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

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Rows of the matrix that turns about x, then y, then z.
fn turned([a, b, c]: Vector) -> [Vector; 3] {
    let ((sa, ca), (sb, cb), (sc, cc)) = (a.sin_cos(), b.sin_cos(), c.sin_cos());
    [
        [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa],
        [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
}

const CAMERA_PX: [usize; 2] = [240, 180];
const CAMERA_FOCAL_PX: f64 = 302.0;
const CAMERA_PRINCIPAL_PX: [f64; 2] = [117.0, 92.0];
const PROJECTOR_PX: [f64; 2] = [400.0, 300.0];
const PROJECTOR_FOCAL_PX: f64 = 560.0;
const PROJECTOR_PRINCIPAL_PX: [f64; 2] = [205.0, 270.0];
const PROJECTOR_TURN: Vector = [0.17, 0.26, 0.05];
const PROJECTOR_SHIFT_MM: Vector = [-118.0, -30.0, 40.0];
/// The board: 5 x 7 crossings.
const PITCH_MM: f64 = 22.0;
/// Turns of the board, and the place of its middle before the camera, mm.
const POSES: [(Vector, Vector); 5] = [
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
fn photograph((turns, middle): &(Vector, Vector), light: impl Fn([f64; 2]) -> f64) -> Vec<u8> {
    let board = turned(*turns);
    let [along, across, normal] = [0, 1, 2].map(|k| [board[0][k], board[1][k], board[2][k]]);
    let projector = turned(PROJECTOR_TURN);
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
            let depth = dot(normal, *middle) / dot(normal, [x, y, 1.0]);
            let point = [x * depth, y * depth, depth];
            let away = [0, 1, 2].map(|i| point[i] - middle[i]);
            let square = [
                dot(along, away) / PITCH_MM + 2.0,
                dot(across, away) / PITCH_MM + 3.0,
            ];
            let [column, row] = square.map(f64::floor);
            let inside = (-1.0..5.0).contains(&column) && (-1.0..7.0).contains(&row);
            let print = if inside && (column + row).rem_euclid(2.0) == 0.0 {
                60.0
            } else {
                250.0
            };
            let lit = [0, 1, 2].map(|i| dot(projector[i], point) + PROJECTOR_SHIFT_MM[i]);
            let at_px =
                [0, 1].map(|i| PROJECTOR_FOCAL_PX * lit[i] / lit[2] + PROJECTOR_PRINCIPAL_PX[i]);
            seen += print * light(at_px) / 9.0;
        }
        image.push(seen.round() as u8);
    }
    image
}
