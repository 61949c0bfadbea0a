//! `flankscope calibrate --images` with an ordinary board, as a user runs it: on other people's frames of a checkerboard, and on folders
//! that lack things.

use std::path::Path;
use std::process::{Command, Output};

use flankscope_test_requisites::{dear, shared};
use nalgebra::{Matrix3, Vector3};

const BOARD: &str = "kind = \"checkerboard\"\ncolumns = 9\nrows = 13\npitch_mm = 10.0\ncolumns_plan = \"columns.toml\"\n\
                     rows_plan = \"rows.toml\"\n[projector]\nwidth_px = 1824\nheight_px = 1140\n";

fn flankscope(arguments: &[&Path], state: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_flankscope"))
        .args(arguments)
        .env("FLANKSCOPE_STATE", state.join("state"))
        .output()
        .expect("the binary starts")
}

fn succeeds(arguments: &[&Path], state: &Path) {
    let done = flankscope(arguments, state);
    assert_eq!(
        done.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
}

fn plan(along: &str, first: usize) -> String {
    let set = |periods: usize, first: usize| {
        let frames = (first..first + 3).map(|frame| format!("\"frame_{frame:02}.png\""));
        let frames: Vec<String> = frames.collect();
        format!(
            "[[set]]\nperiods = {periods}\nsteps = 3\nframes = [{}]\n",
            frames.join(", ")
        )
    };
    format!(
        "step_sign = -1\nphase_origin_px = 0.0\nfringes_along = \"{along}\"\n{}{}",
        set(16, first),
        set(1, first + 3)
    )
}

/// `board.toml` and both plans, of the frames that `data/boards` holds.
fn describe(folder: &Path) {
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    write("board.toml", BOARD);
    write("columns.toml", &plan("columns", 0));
    write("rows.toml", &plan("rows", 6));
}

/// Positions of a binary little endian PLY whose vertices begin with three floats.
fn positions(path: &Path) -> Vec<Vector3<f64>> {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes
        .windows(11)
        .position(|window| window == b"end_header\n")
        .unwrap()
        + 11;
    let header = String::from_utf8_lossy(&bytes[..end]);
    let vertices = header.split("element vertex").nth(1).unwrap();
    let vertex = 4 * vertices
        .lines()
        .filter(|line| line.starts_with("property float"))
        .count();
    assert!(vertex >= 12, "{header}");
    let value = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()));
    let point = |vertex: &[u8]| {
        Vector3::new(
            value(&vertex[..4]),
            value(&vertex[4..8]),
            value(&vertex[8..12]),
        )
    };
    bytes[end..].chunks_exact(vertex).map(point).collect()
}

/// The pixel of a point by OpenCV's formula.
fn pixel(p: &Vector3<f64>, [fx, fy, cx, cy]: [f64; 4], [k1, k2, p1, p2]: [f64; 4]) -> [f64; 2] {
    let (x, y) = (p.x / p.z, p.y / p.z);
    let r2 = x * x + y * y;
    let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
    [
        fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx,
        fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + cy,
    ]
}

/// A point and where it should be.
type Pair = (Vector3<f64>, Vector3<f64>);

/// Median distance of pairs after the best similarity (Umeyama 1991) of those that fit.
fn median_after_similarity(pairs: &[Pair]) -> f64 {
    let mut kept: Vec<usize> = (0..pairs.len()).collect();
    let mut off = Vec::new();
    for _ in 0..10 {
        let count = kept.len() as f64;
        let mean = |side: fn(&Pair) -> Vector3<f64>| {
            kept.iter()
                .map(|&at| side(&pairs[at]))
                .sum::<Vector3<f64>>()
                / count
        };
        let (from, to) = (mean(|pair| pair.0), mean(|pair| pair.1));
        let cross: Matrix3<f64> = kept
            .iter()
            .map(|&at| (pairs[at].1 - to) * (pairs[at].0 - from).transpose())
            .sum();
        let spread: f64 = kept
            .iter()
            .map(|&at| (pairs[at].0 - from).norm_squared())
            .sum();
        let svd = cross.svd(true, true);
        let rotation = svd.u.unwrap() * svd.v_t.unwrap();
        assert!(rotation.determinant() > 0.0);
        let scale = svd.singular_values.sum() / spread;
        off = pairs
            .iter()
            .map(|(p, q)| (scale * (rotation * (p - from)) - (q - to)).norm() / scale)
            .collect();
        let mut sorted = off.clone();
        sorted.sort_by(f64::total_cmp);
        let limit = 3.0 * sorted[sorted.len() / 2];
        kept = (0..pairs.len()).filter(|&at| off[at] < limit).collect();
    }
    off.sort_by(f64::total_cmp);
    off[off.len() / 2]
}

/// A rig, its checkerboard and its skull, all other people's: the skull decoded with the head that the checkerboard gives lies on the
/// cloud that the rig's authors made with theirs.
#[test]
fn other_peoples_checkerboard_measures_their_skull() {
    if !dear() {
        return;
    }
    let (Some(boards), Some(skull)) = (shared("data/boards"), shared("data/fringe-skull")) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    describe(folder.path());
    let (head, json, board) = (at("head.toml"), at("calibration.json"), at("board.toml"));
    let words = [
        "calibrate",
        "--quiet",
        "--images",
        "--board",
        "-o",
        "--json",
    ]
    .map(Path::new);
    let [calibrate, quiet, images, of_board, to, to_json] = words;
    let arguments = [
        calibrate, quiet, images, &boards, of_board, &board, to, &head, to_json, &json,
    ];
    succeeds(&arguments, folder.path());
    let document: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    // The distances, as other programs give them.
    let reprojection = &document["reprojection_px"];
    assert!(number(&reprojection["camera"]) < 0.3, "{reprojection}");
    assert!(number(&reprojection["projector"]) < 1.0, "{reprojection}");
    let poses = document["poses"].as_array().unwrap();
    assert_eq!(poses.len(), 5);
    for pose in poses {
        assert_eq!(pose["used"], true, "{pose}");
        // Measured without it, a board of 80 mm x 120 mm is flat to a tenth of a millimetre: paper on a plate is hardly better.
        assert!(
            number(&pose["left_out"]["flatness_rms_um"]) < 150.0,
            "{pose}"
        );
        assert!(
            number(&pose["left_out"]["projector_rms_px"]) < 1.0,
            "{pose}"
        );
    }
    let record = &document["calibration"];
    assert_eq!(record["frames"], serde_json::json!(["camera", "projector"]));
    let unknown = record["board"]["unknown"].as_array().unwrap();
    assert!(unknown.contains(&"stage_from_camera".into()) && unknown.contains(&"scale".into()));
    assert!(record["board"]["scale_sigma_ratio"].is_null());

    let (plan_of_skull, cloud) = (at("skull.toml"), at("skull.ply"));
    std::fs::write(&plan_of_skull, plan("columns", 0)).unwrap();
    let words = ["decode", "--quiet", "--images", "--plan", "--head", "-o"].map(Path::new);
    let [decode, quiet, images, by_plan, by_head, to] = words;
    let arguments = [
        decode,
        quiet,
        images,
        &skull,
        by_plan,
        &plan_of_skull,
        by_head,
        &head,
        to,
        &cloud,
    ];
    succeeds(&arguments, folder.path());
    // What one pixel sees in both: the rig's own lens puts the reference into the picture, ours the cloud.
    let values: Vec<f64> = document["parameters"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| number(&p["value"]))
        .collect();
    let own = |p: &Vector3<f64>| {
        pixel(
            p,
            values[..4].try_into().unwrap(),
            values[4..8].try_into().unwrap(),
        )
    };
    let theirs = |p: &Vector3<f64>| {
        pixel(
            p,
            [2195.12036, 2195.12036, 843.5, 675.5],
            [-0.058_035_265_7, 0.0, 0.0, 0.0],
        )
    };
    let whole = |at: [f64; 2]| at.map(|px| px.round() as i32);
    let measured: std::collections::HashMap<[i32; 2], Vector3<f64>> = positions(&cloud)
        .into_iter()
        .map(|p| (whole(own(&p)), p))
        .collect();
    let pairs: Vec<_> = positions(&skull.join("reference.ply"))
        .into_iter()
        .filter_map(|p| Some((p, *measured.get(&whole(theirs(&p)))?)))
        .collect();
    assert!(pairs.len() > 60_000, "{}", pairs.len());
    let median_mm = median_after_similarity(&pairs);
    eprintln!(
        "{} pairs, median {median_mm:.3} mm; {reprojection}",
        pairs.len()
    );
    assert!(median_mm < 0.3, "{median_mm}");

    // Where the head is on its stage nobody has told it: nothing is judged with it.
    for command in ["inspect", "scan"] {
        let refused = flankscope(
            &[Path::new(command), Path::new("--head"), &head],
            folder.path(),
        );
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(3), "{said}");
        assert!(
            said.contains("ordinary board") && said.contains("stage_from_camera"),
            "{said}"
        );
    }
}

/// All that is missing is said at once.
#[test]
fn what_a_folder_lacks_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let images = folder.path().join("images");
    std::fs::create_dir_all(images.join("pose1")).unwrap();
    let head = folder.path().join("head.toml");
    let [calibrate, of_images, to] = ["calibrate", "--images", "-o"].map(Path::new);
    let refused = |lacks: &[&str]| {
        let done = flankscope(&[calibrate, of_images, &images, to, &head], folder.path());
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(3), "{said}");
        for lack in lacks {
            assert!(said.contains(lack), "{lack} in {said}");
        }
        assert!(!head.exists());
    };
    let keys = [
        "kind =",
        "columns =",
        "rows =",
        "pitch_mm =",
        "[projector]",
        "columns_plan =",
        "rows_plan =",
    ];
    refused(
        &[
            &[
                "board.toml: what board",
                "captures.toml",
                "poses: 1 folders",
            ],
            &keys[..],
        ]
        .concat(),
    );
    // Of a file that is there only what it lacks.
    describe(&images);
    std::fs::write(
        images.join("board.toml"),
        BOARD.replace("rows = 13\n", "").replace("10.0", "-1.0"),
    )
    .unwrap();
    refused(&[
        "rows =",
        "pitch_mm = -1: must be",
        "poses: 1 folders",
        "frame_00.png",
        "frame_11.png",
    ]);
    std::fs::write(
        images.join("board.toml"),
        BOARD.replace("\"rows.toml\"", "\"columns.toml\""),
    )
    .unwrap();
    refused(&["rows_plan: fringes_along = \"rows\"", "poses: 1 folders"]);
    std::fs::write(images.join("board.toml"), BOARD.replace("kind", "sort")).unwrap();
    refused(&["unknown field `sort`"]);
}
