//! `flankscope decode` as a user runs it: on real frames, and on everything that can be wrong with the input.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use flankscope_test_requisites::{python_with, shared};
use kiddo::{ImmutableKdTree, SquaredEuclidean};

const PLAN: &str = r#"
name = "two times three"
step_sign = -1
phase_origin_px = 0.0

[[set]]
periods = 16
steps = 3
frames = ["frame_00.png", "frame_01.png", "frame_02.png"]

[[set]]
periods = 1
steps = 3
frames = ["frame_03.png", "frame_04.png", "frame_05.png"]
"#;

fn decode(images: &Path, plan: &Path, head: &Path, output: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_flankscope"))
        .arg("decode")
        .args([
            "--images".as_ref(),
            images.as_os_str(),
            "--plan".as_ref(),
            plan.as_os_str(),
        ])
        .args([
            "--head".as_ref(),
            head.as_os_str(),
            "-o".as_ref(),
            output.as_os_str(),
        ])
        .args(more)
        .output()
        .expect("the binary starts")
}

/// Positions of a binary little endian PLY whose vertices are floats, x y z first.
fn positions(path: &Path) -> Vec<[f64; 3]> {
    let bytes = std::fs::read(path).expect("the cloud exists");
    let end = bytes
        .windows(11)
        .position(|window| window == b"end_header\n")
        .expect("a PLY header")
        + 11;
    let header = String::from_utf8_lossy(&bytes[..end]);
    assert!(header.contains("format binary_little_endian 1.0"));
    let count: usize = header
        .lines()
        .find_map(|line| line.strip_prefix("element vertex "))
        .and_then(|count| count.parse().ok())
        .expect("a vertex count");
    let floats = header
        .lines()
        .filter(|line| line.starts_with("property float "))
        .count();
    assert_eq!(
        bytes.len() - end,
        count * floats * 4,
        "header and body agree"
    );
    let axis = |vertex: &[u8], axis: usize| {
        let bytes: [u8; 4] = vertex[4 * axis..4 * axis + 4]
            .try_into()
            .expect("four bytes");
        f64::from(f32::from_le_bytes(bytes))
    };
    bytes[end..]
        .chunks_exact(4 * floats)
        .map(|vertex| [axis(vertex, 0), axis(vertex, 1), axis(vertex, 2)])
        .collect()
}

/// The calibration's projector column of a camera point, by plain arithmetic (README of the data: OpenCV conventions).
fn projector_column(point: [f64; 3]) -> f64 {
    let r = [
        [9.64402318e-01, -1.20346159e-01, 2.35467508e-01],
        [1.53437316e-01, 9.79882836e-01, -1.27619177e-01],
        [-2.15372086e-01, 1.59205735e-01, 9.63466883e-01],
    ];
    let t = [-1.45282562e+02, -3.64983406e+01, 6.79231644e+01];
    let p: Vec<f64> = (0..3)
        .map(|i| (0..3).map(|j| r[i][j] * point[j]).sum::<f64>() + t[i])
        .collect();
    let (x, y) = (p[0] / p[2], p[1] / p[2]);
    2601.52563 * x * (1.0 - 3.14900056e-02 * (x * x + y * y)) + 866.541504
}

/// The camera pixel of a camera point, likewise.
fn camera_pixel(point: [f64; 3]) -> [f64; 2] {
    let (x, y) = (point[0] / point[2], point[1] / point[2]);
    let radial = 1.0 - 5.80352657e-02 * (x * x + y * y);
    [
        2195.12036 * x * radial + 843.5,
        2195.12036 * y * radial + 675.5,
    ]
}

/// NumPy reads the maps, finds in the frames the phases that they have (three steps: Creath 1988), and columns by order and
/// phase.
fn maps_are_what_numpy_makes_of_the_frames(data: &Path, maps: &Path) {
    let Some(python) = python_with(&["numpy"]) else {
        return;
    };
    // The frames as bytes, so that Python needs no library for images.
    let folder = tempfile::tempdir().expect("a folder");
    for frame in 0..6 {
        let name = format!("frame_{frame:02}.png");
        let file = std::io::BufReader::new(std::fs::File::open(data.join(&name)).expect("a frame"));
        let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut pixels).expect("pixels");
        assert_eq!(info.color_type, png::ColorType::Grayscale);
        assert_eq!(info.bit_depth, png::BitDepth::Eight);
        std::fs::write(folder.path().join(format!("{frame}")), pixels).expect("written");
    }
    let script = r#"
import sys, numpy as np
maps = np.load(sys.argv[1])
shape = maps["column_px"].shape
assert shape == (1352, 1688), shape
assert maps["periods"].tolist() == [1, 16]
tau = 2 * np.pi
for at, frames in [(1, (0, 1, 2)), (0, (3, 4, 5))]:
    frames = [np.fromfile(f"{sys.argv[2]}/{n}", np.uint8).reshape(shape).astype(float) for n in frames]
    sums = sum(frame * np.exp(2j * np.pi * n / 3) for n, frame in enumerate(frames))
    phase, seen = maps["phase_rad"][at], np.abs(sums) > 30
    seen &= np.isfinite(phase)
    off = np.angle(np.exp(1j * (phase - np.angle(sums))))[seen]
    assert seen.sum() > 100_000 and np.abs(off).max() < 1e-4, (seen.sum(), np.abs(off).max())
told = maps["order"] != -2**31
assert (told == np.isfinite(maps["column_px"])).all() and told.sum() > 90_000
# 16 periods over the projector's width, which the head file says; the phase is zero at column 0.
width = np.median(maps["column_px"][told] / ((maps["order"] + maps["phase_rad"][1] / tau)[told] / 16))
column = (maps["order"] + maps["phase_rad"][1] / tau) * width / 16
assert abs(width / round(width) - 1) < 1e-3, width
# Smoothing moves a phase by less than half a fringe.
assert np.abs(column - maps["column_px"])[told].max() <= width / 32 * 1.001
points = np.isfinite(maps["depth_mm"])
assert (told | ~points).all() and (maps["sigma_z_mm"][points] > 0).all()
print(points.sum())
"#;
    let said = Command::new(python)
        .args(["-c", script])
        .args([maps, folder.path()])
        .output()
        .expect("Python starts");
    let errors = String::from_utf8_lossy(&said.stderr);
    assert!(said.status.success(), "{errors}");
}

#[test]
fn real_frames_agree_with_the_reference_cloud() {
    let Some(data) = shared("data/fringe-skull") else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let plan = folder.path().join("PLAN.toml");
    std::fs::write(&plan, PLAN).expect("written");
    let cloud = folder.path().join("cloud.ply");
    let maps = folder.path().join("maps.npz");
    let output = decode(
        &data,
        &plan,
        &data.join("calibration.xml"),
        &cloud,
        &["--json", "-", "--phase", maps.to_str().expect("UTF-8")],
    );
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );

    let points = positions(&cloud);
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(document["count"], points.len());
    let rejected: u64 = document["rejected"]
        .as_object()
        .expect("reasons")
        .values()
        .map(|count| count.as_u64().expect("a count"))
        .sum();
    assert_eq!(points.len() as u64 + rejected, 1688 * 1352);

    maps_are_what_numpy_makes_of_the_frames(&data, &maps);

    let reference = positions(&data.join("reference.ply"));
    assert_eq!(reference.len(), 93_876);
    let tree: ImmutableKdTree<f64, 3> =
        ImmutableKdTree::new_from_slice(&points).expect("finite points");
    let mut distances_mm: Vec<f64> = reference
        .iter()
        .map(|point| {
            tree.query(point)
                .nearest_one::<SquaredEuclidean<f64>>()
                .execute()
                .distance
                .sqrt()
        })
        .collect();
    distances_mm.sort_by(f64::total_cmp);
    let near = distances_mm.partition_point(|&distance| distance <= 1.0);
    let quantile = |part: usize| distances_mm[distances_mm.len() * part / 100];
    println!(
        "{} points; {near} of {} within 1 mm; median {:.4} mm, 75 % {:.4} mm, 90 % {:.4} mm",
        points.len(),
        reference.len(),
        quantile(50),
        quantile(75),
        quantile(90)
    );
    assert!(near >= 80_000, "{near}");
    assert!(quantile(50) <= 0.20, "{}", quantile(50));
    assert!(quantile(75) <= 0.25, "{}", quantile(75));

    // Wrong fringe orders: same camera pixel, but one or more whole fringes (1824 / 16 columns) aside.
    let mut by_pixel = vec![None; 1688 * 1352];
    let index = |pixel: [f64; 2]| pixel[1].round() as usize * 1688 + pixel[0].round() as usize;
    for &point in &points {
        by_pixel[index(camera_pixel(point))] = Some(point);
    }
    let (mut compared, mut slipped) = (0, 0);
    for &point in &reference {
        if let Some(ours) = by_pixel[index(camera_pixel(point))] {
            compared += 1;
            let fringes = (projector_column(ours) - projector_column(point)) * 16.0 / 1824.0;
            slipped += usize::from(fringes.round() != 0.0);
        }
    }
    println!("{slipped} of {compared} pixels are wrong by a whole fringe");
    assert!(compared >= 80_000);
    assert!(slipped * 1000 <= compared, "{slipped} of {compared}");
}

/// A folder with a head, a plan and six frames of a flat grey field, small enough for every test.
struct Scene {
    folder: tempfile::TempDir,
}

const HEAD: &str = r#"
name = "test"
[camera]
width_px = 32
height_px = 24
focal_px = [40.0, 40.0]
principal_px = [15.5, 11.5]
[projector]
width_px = 64
height_px = 48
focal_px = [80.0, 80.0]
principal_px = [31.5, 23.5]
[projector_from_camera]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation_mm = [-50.0, 0.0, 0.0]
"#;

const SMALL_PLAN: &str = "[[set]]\nperiods = 1\nsteps = 3\n[[set]]\nperiods = 8\nsteps = 3\n";

impl Scene {
    fn new() -> Self {
        let scene = Self {
            folder: tempfile::tempdir().expect("a folder"),
        };
        std::fs::create_dir(scene.path("images")).expect("created");
        scene.write("head.toml", HEAD);
        scene.write("PLAN.toml", SMALL_PLAN);
        for frame in 0..6 {
            scene.image(
                &format!("images/{frame}.png"),
                32,
                24,
                png::ColorType::Grayscale,
            );
        }
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("written");
    }

    fn image(&self, name: &str, width: u32, height: u32, colour: png::ColorType) {
        let file = std::fs::File::create(self.path(name)).expect("created");
        let mut encoder = png::Encoder::new(file, width, height);
        encoder.set_color(colour);
        let mut writer = encoder.write_header().expect("header");
        let bytes = vec![100; (width * height) as usize * colour.samples()];
        writer.write_image_data(&bytes).expect("pixels");
    }

    /// Runs, expects exit 3, nothing written, and an error that says all of `expected`.
    fn refuses(&self, expected: &[&str]) {
        let output = self.run(&[]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{error}");
        for part in expected {
            assert!(error.contains(part), "\"{part}\" is not in: {error}");
        }
        let left: Vec<_> = std::fs::read_dir(self.folder.path())
            .expect("a folder")
            .map(|entry| {
                entry
                    .expect("an entry")
                    .file_name()
                    .into_string()
                    .expect("a name")
            })
            .filter(|name| !["images", "head.toml", "PLAN.toml"].contains(&name.as_str()))
            .collect();
        assert!(left.is_empty(), "{left:?}");
    }

    fn run(&self, more: &[&str]) -> Output {
        decode(
            &self.path("images"),
            &self.path("PLAN.toml"),
            &self.path("head.toml"),
            &self.path("cloud.ply"),
            more,
        )
    }
}

#[test]
fn a_field_without_fringes_is_an_empty_cloud_with_reasons() {
    let scene = Scene::new();
    let output = scene.run(&["--json", "-"]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("768 of them are `low_contrast`"), "{told}");
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(document["count"], 0);
    assert_eq!(document["rejected"]["low_contrast"], 32 * 24);
    assert!(document["elapsed_ms"]["decode"].as_f64().expect("a time") >= 0.0);
    assert_eq!(positions(&scene.path("cloud.ply")), Vec::<[f64; 3]>::new());
}

#[test]
fn missing_and_extra_frames_are_counted() {
    let scene = Scene::new();
    std::fs::remove_file(scene.path("images/3.png")).expect("removed");
    scene.refuses(&["holds 5 images", "the plan has 6 frames"]);
    scene.image("images/3.png", 32, 24, png::ColorType::Grayscale);
    scene.image("images/6.png", 32, 24, png::ColorType::Grayscale);
    scene.refuses(&["holds 7 images", "the plan has 6 frames"]);
}

#[test]
fn a_named_frame_that_does_not_exist_is_named() {
    let scene = Scene::new();
    let plan = "[[set]]\nperiods = 1\nsteps = 3\nframes = ['0.png', '1.png', 'two.png']\n";
    scene.write("PLAN.toml", plan);
    scene.refuses(&["two.png"]);
}

#[test]
fn frames_of_two_sizes_are_refused() {
    let scene = Scene::new();
    scene.image("images/4.png", 32, 23, png::ColorType::Grayscale);
    scene.refuses(&["4.png has 32 x 23 pixels", "32 x 24"]);
}

#[test]
fn colour_is_refused() {
    let scene = Scene::new();
    scene.image("images/0.png", 32, 24, png::ColorType::Rgb);
    scene.refuses(&["0.png is Rgb", "must be grey"]);
}

#[test]
fn truncated_and_foreign_images_are_refused() {
    let scene = Scene::new();
    let whole = std::fs::read(scene.path("images/2.png")).expect("read");
    for length in [0, 7, 20, whole.len() / 2, whole.len() - 14] {
        std::fs::write(scene.path("images/2.png"), &whole[..length]).expect("written");
        scene.refuses(&["2.png is not a whole PNG image"]);
    }
    std::fs::write(scene.path("images/2.png"), b"P5 32 24 255 and so on").expect("written");
    scene.refuses(&["2.png is not a whole PNG image"]);
}

#[test]
fn an_image_header_that_lies_costs_nothing() {
    let scene = Scene::new();
    // A header that claims 2^31-1 columns and rows; the checksum is right, so only the size gives it away.
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bytes.extend([
        0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 16, 0, 0, 0, 0,
    ]);
    let mut crc = !0u32;
    for &byte in &bytes[12..] {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg());
        }
    }
    bytes.extend((!crc).to_be_bytes());
    bytes.extend(b"\0\0\0\x08IDAT\0\0\0\0\0\0\0\0\0\0\0\0");
    std::fs::write(scene.path("images/0.png"), bytes).expect("written");
    scene.refuses(&["0.png"]);
}

#[test]
fn unknown_keys_come_with_file_line_and_the_right_ones() {
    let scene = Scene::new();
    scene.write(
        "PLAN.toml",
        "[[set]]\nperiods = 1\nsteps = 3\nfrequency = 2\n",
    );
    scene.refuses(&["PLAN.toml:4", "frequency", "periods"]);
    scene.write("PLAN.toml", SMALL_PLAN);
    scene.write(
        "head.toml",
        &HEAD.replace("height_px = 24", "height_px = 24\nhight = 3"),
    );
    scene.refuses(&["head.toml:6", "hight", "focal_px"]);
}

#[test]
fn values_beyond_their_limits_come_with_file_and_line() {
    let scene = Scene::new();
    scene.write(
        "PLAN.toml",
        "[[set]]\nperiods = 1\nsteps = 3\n[[set]]\nperiods = 8\nsteps = 2\n",
    );
    scene.refuses(&["PLAN.toml:6", "set[1].steps = 2", "3 to 64"]);
    scene.write(
        "PLAN.toml",
        "[[set]]\nperiods = 8\nsteps = 3\n[[set]]\nperiods = 64\nsteps = 3\n",
    );
    scene.refuses(&["lowest frequency has 8 periods", "[volume]"]);
    scene.write("PLAN.toml", SMALL_PLAN);
    scene.write("head.toml", &HEAD.replace("[40.0, 40.0]", "[40.0, nan]"));
    scene.refuses(&["head.toml:6", "camera.focal_px", "positive"]);
    scene.write(
        "head.toml",
        &HEAD.replace("[[1.0, 0.0, 0.0]", "[[0.9, 0.0, 0.0]"),
    );
    scene.refuses(&[
        "head.toml:14",
        "projector_from_camera.rotation",
        "rotation matrix",
    ]);
    scene.write(
        "head.toml",
        "<?xml version=\"1.0\"?><opencv_storage><Kc/></opencv_storage>",
    );
    scene.refuses(&["head.toml:1: Kc = 0 numbers"]);
}

#[test]
fn an_unwritable_place_is_named() {
    let scene = Scene::new();
    let place = scene.path("no/such/folder/cloud.ply");
    let output = decode(
        &scene.path("images"),
        &scene.path("PLAN.toml"),
        &scene.path("head.toml"),
        &place,
        &[],
    );
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot write"));
}
