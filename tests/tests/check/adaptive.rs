//! Patterns that light only what is measured, against rays cast at every triangle of the drawing.

use std::path::{Path, PathBuf};

use flankscope_profilometry::HeadModel;
use flankscope_test_requisites::dear;
use flankscope_tests::{Run, flankscope, inspect, run};
use serde_json::Value;

/// Möller and Trumbore, Fast, minimum storage ray-triangle intersection (1997): distance along the ray.
fn meets(from: [f64; 3], ray: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> Option<f64> {
    let minus = |p: [f64; 3], q: [f64; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
    let (ab, ac, p) = (minus(b, a), minus(c, a), minus(from, a));
    let h = cross(ray, ac);
    let det = dot(ab, h);
    let u = dot(p, h) / det;
    let q = cross(p, ab);
    let v = dot(ray, q) / det;
    let t = dot(ac, q) / det;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

/// Triangles of the demo's drawing: binary PLY of doubles and lists of three.
fn triangles(path: &Path) -> Vec<[[f64; 3]; 3]> {
    let bytes = std::fs::read(path).unwrap();
    let mark = b"end_header\n";
    let end = bytes
        .windows(mark.len())
        .position(|part| part == mark)
        .unwrap()
        + mark.len();
    let head = String::from_utf8_lossy(&bytes[..end]);
    let count = |what: &str| -> usize {
        let line = head.lines().find_map(|line| line.strip_prefix(what));
        line.unwrap().trim().parse().unwrap()
    };
    let (vertices, faces) = (count("element vertex"), count("element face"));
    let number = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let corner = |i: usize| [0, 8, 16].map(|part| number(end + 24 * i + part));
    let index = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let start = end + 24 * vertices;
    assert_eq!(bytes.len(), start + 13 * faces, "another layout");
    let face = |i: usize| [1, 5, 9].map(|part| corner(index(start + 13 * i + part)));
    (0..faces).map(face).collect()
}

fn picture(path: &Path) -> Vec<u8> {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut mirrors = vec![0; 1024 * 768];
    reader.next_frame(&mut mirrors).unwrap();
    mirrors
}

/// What a mirror's light meets first: 0 a left flank, 1 a right one, 2 something else, none nothing.
struct Drawing {
    near: Vec<[[f64; 3]; 3]>,
    from: [f64; 3],
    head: HeadModel,
    turn_rad: f64,
    height_mm: f64,
}

impl Drawing {
    /// Camera to tool by the numbers of the head file: hand-eye, raised, turned back.
    fn in_tool(&self, p: [f64; 3], is_point: bool) -> [f64; 3] {
        let by = self.head.stage_from_camera.as_ref().unwrap();
        let mut q: [f64; 3] = std::array::from_fn(|i| {
            dot(by.rotation[i], p) + if is_point { by.translation_mm[i] } else { 0.0 }
        });
        if is_point {
            q[2] += self.height_mm;
        }
        let (sin, cos) = (-self.turn_rad).sin_cos();
        [cos * q[0] - sin * q[1], sin * q[0] + cos * q[1], q[2]]
    }

    /// Projector to camera, transposed by hand.
    fn in_camera(&self, p: [f64; 3]) -> [f64; 3] {
        let of = &self.head.projector_from_camera.rotation;
        std::array::from_fn(|i| (0..3).map(|k| of[k][i] * p[k]).sum())
    }

    fn region(&self, column: f64, row: f64) -> Option<usize> {
        let projector = &self.head.projector;
        let [x, y] = projector.undistort([column, row]).unwrap();
        let ray = self.in_tool(self.in_camera([x, y, 1.0]), false);
        let met = self
            .near
            .iter()
            .filter_map(|t| Some((meets(self.from, ray, *t)?, t)));
        let (along, of) = met.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let at: [f64; 3] = std::array::from_fn(|i| self.from[i] + along * ray[i]);
        let edge = |k: usize| -> [f64; 3] { std::array::from_fn(|i| of[k][i] - of[0][i]) };
        let mut normal = cross(edge(1), edge(2));
        let size = dot(normal, normal).sqrt();
        normal = normal.map(|part| part / size);
        let radius = at[0].hypot(at[1]);
        let across = (at[0] * normal[1] - at[1] * normal[0]) / radius;
        // Flanks of the demo die end at its root, 42.68 mm; lands and faces look inwards or along the axis.
        Some(match across {
            a if radius < 42.6 && a > 0.75 => 0,
            a if radius < 42.6 && a < -0.75 => 1,
            _ => 2,
        })
    }
}

/// The demo die's folder, and the folder that it lies in.
fn demo_tool() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let tool = folder.path().join("tool");
    let made = run(flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(&tool));
    assert_eq!(made.code, 0, "{}", made.stderr);
    (folder, tool)
}

#[test]
fn mirrors_light_the_flanks_that_rays_through_every_triangle_meet() {
    let (folder, tool) = demo_tool();
    let out = folder.path().join("out");
    let written = run(flankscope()
        .args([
            "patterns",
            "--set",
            "high12",
            "--tooth",
            "40",
            "--margin",
            "0.1",
            "--json",
            "-",
            "-q",
            "--adaptive",
        ])
        .arg(&tool)
        .arg("-o")
        .arg(&out));
    assert_eq!(written.code, 0, "{}", written.stderr);
    let json = &written.json;
    assert_eq!(json["format"], "flankscope/adaptive/1");
    let view = &json["view"];
    let number = |value: &Value| value.as_f64().unwrap();
    let mut drawing = Drawing {
        near: Vec::new(),
        from: [0.0; 3],
        head: HeadModel::load(&tool.join("head.toml")).unwrap(),
        turn_rad: number(&view["rotation_rad"]),
        height_mm: number(&view["vertical_mm"]),
    };
    // Where the light comes from: what the projector's frame has at zero.
    let away = drawing
        .head
        .projector_from_camera
        .translation_mm
        .map(|mm| -mm);
    drawing.from = drawing.in_tool(drawing.in_camera(away), true);
    // Tooth 40 of 84 and its neighbours, by the drawing's angle of 360/84 degrees a tooth.
    let middle = (-drawing.turn_rad).sin_cos();
    let faces = triangles(&tool.join("die.ply"));
    drawing.near = faces
        .into_iter()
        .filter(|t| t.iter().any(|p| dot([middle.1, middle.0, 0.0], *p) > 35.0))
        .collect();
    let plain = folder.path().join("plain");
    let head = tool.join("head.toml");
    let flat = run(flankscope()
        .args(["patterns", "--set", "high12", "-q", "--head"])
        .arg(&head)
        .arg("-o")
        .arg(&plain));
    assert_eq!(flat.code, 0, "{}", flat.stderr);
    let plain = picture(&plain.join("high12/pattern-07.png"));
    let shown =
        ["left", "right", "rest"].map(|pass| picture(&out.join(pass).join("pattern-07.png")));
    // Flanks as the set has them, lands no brighter than they are.
    let passes = json["passes"].as_array().unwrap().iter();
    let bright: Vec<f64> = passes.map(|of| number(&of["brightness_ratio"])).collect();
    assert_eq!(bright[..2], [1.0, 1.0]);
    assert!((0.05..1.0).contains(&bright[2]), "{bright:?}");
    // 0.1 mm is 12 mirrors at the near end of the volume; a block more for rounding, one for the block's own size.
    let reach = 24.0;
    let (mut inside, mut dark, mut other) = ([0; 3], 0, 0);
    for row in (3..768).step_by(53) {
        for column in (5..1024).step_by(11) {
            let at = row * 1024 + column;
            let near = |step: f64| {
                let offsets = [
                    [0.0, 0.0],
                    [step, 0.0],
                    [-step, 0.0],
                    [0.0, step],
                    [0.0, -step],
                ];
                offsets.map(|[x, y]| drawing.region(column as f64 + x, row as f64 + y))
            };
            let own = drawing.region(column as f64, row as f64);
            // A mirror amid others of its kind (a block's middle decides for its mirrors) is lit in its own pass, as the set has it.
            if let Some(of) = own
                && near(4.0).iter().all(|found| *found == own)
            {
                let brightness = (bright[of] * f64::from(plain[at])).round() as u8;
                assert_eq!(
                    shown[of][at], brightness,
                    "column {column} row {row}: {own:?}"
                );
                inside[of] += 1;
                // And far from any border in no other.
                let around: Vec<_> = [reach, 16.0, 8.0].into_iter().flat_map(near).collect();
                if around.iter().all(|found| *found == own) {
                    for pass in (0..3).filter(|pass| *pass != of) {
                        assert_eq!(shown[pass][at], 0, "column {column} row {row}: {own:?}");
                        dark += 1;
                    }
                }
            }
            other += 1;
        }
    }
    println!("{inside:?} mirrors in their own pass, {dark} dark in others, of {other}");
    // Of 1 400 mirrors a good part lies well inside a region.
    assert!(inside[0] > 80 && inside[1] > 80 && inside[2] > 40 && dark > 40);
    // Three passes of twelve frames and one dark frame of the head's exposures.
    let frames = json["time"]["frames"].as_u64().unwrap();
    let plain_frames = json["time"]["plain_frames"].as_u64().unwrap();
    assert_eq!(frames - 1, 3 * (plain_frames - 1));
    let loading = json["loading"].as_array().unwrap();
    assert_eq!(loading.len(), 3);
    assert!(loading.iter().all(|of| number(&of["at_most_s"]) > 0.0));
}

#[test]
fn what_cannot_be_lit_is_refused_by_name() {
    let (folder, tool) = demo_tool();
    for (arguments, said) in [
        (["--tooth", "85", "--margin", "0.1"], "teeth 1 to 84"),
        (["--tooth", "40", "--margin", "NaN"], "0 to 2 mm"),
        (
            ["--tooth", "40", "--height=900", "--margin=0"],
            "no mirror lights a flank",
        ),
    ] {
        let out = folder.path().join("out");
        let refused = run(flankscope()
            .args(["patterns", "-q", "--adaptive"])
            .arg(&tool)
            .arg("-o")
            .arg(&out)
            .args(arguments));
        assert_eq!(refused.code, 3, "{arguments:?}: {}", refused.stderr);
        assert!(refused.stderr.contains(said), "{said}: {}", refused.stderr);
    }
}

/// Pictures of tooth 40 of the demo die, this far beyond what a pass lights.
fn pictures(tool: &Path, out: &Path, margin_mm: &str) {
    let written = run(flankscope()
        .args(["patterns", "--tooth", "40", "--margin", margin_mm, "-q"])
        .arg("--adaptive")
        .arg(tool)
        .arg("-o")
        .arg(out));
    assert_eq!(written.code, 0, "{}", written.stderr);
}

/// A check of a tool folder in passes.
fn in_passes(tool: &Path, pictures: &Path, arguments: &[&str]) -> Run {
    let fixed = ["--link", "sim", "--tool"];
    let [tool, pictures] = [tool, pictures].map(|path| path.to_str().unwrap());
    inspect(&[&fixed[..], &[tool, "--adaptive", pictures], arguments].concat())
}

/// A check of tooth 12 with half of its left flank worn by 80 um: no-go there, as it was stored and as it was recorded. The live one
/// and that of the recording.
fn found_stored_and_recorded(folder: &Path, tool: &Path, pictures: &Path) -> [Run; 2] {
    let [store, frames] = ["press.db", "frames"].map(|name| folder.join(name));
    let [store, frames] = [&store, &frames].map(|path| path.to_str().unwrap());
    let worn = ["--wear", "12:left:80:half", "--teeth", "12"];
    let kept = ["--history", store, "--save-frames", frames];
    let seen = in_passes(tool, pictures, &[&worn[..], &kept].concat());
    assert_eq!(seen.code, 1, "{}", seen.stderr);
    assert_eq!(seen.flank(12, "left"), Some("no-go"));
    assert_eq!(seen.flank(12, "right"), Some("go"));
    let again = run(flankscope()
        .args(["replay", store, "1", "--quiet", "--json", "-"])
        .arg("--tool")
        .arg(tool));
    assert_eq!(again.code, 1, "{}", again.stderr);
    assert_eq!(again.json["same"], true, "{}", again.json);
    let recorded = run(flankscope()
        .args(["inspect", "--quiet", "--json", "-", "--frames", frames])
        .arg("--tool")
        .arg(tool));
    assert_eq!(recorded.code, 1, "{}", recorded.stderr);
    assert_eq!(recorded.json["features"], seen.json["features"]);
    [seen, recorded]
}

#[test]
fn a_check_in_passes_finds_wear_and_is_replayed() {
    let (folder, tool) = demo_tool();
    let out = folder.path().join("out");
    // Pictures of tooth 40 do for tooth 12, which the stages bring to the same place.
    pictures(&tool, &out, "0.1");
    let [seen, recorded] = found_stored_and_recorded(folder.path(), &tool, &out);
    // A dark frame, and 12 patterns at two exposures in three passes.
    assert_eq!(seen.json["frames"]["triggered"], 1 + 3 * 2 * 12);
    // The recording says what each pass lit.
    let of_recipe = &seen.json["recipe"]["lit_ratios"];
    assert_eq!(of_recipe.as_array().unwrap().len(), 3);
    assert_eq!(recorded.json["recipe"]["lit_ratios"], *of_recipe);
}

#[test]
fn pictures_that_do_not_fit_a_check_are_refused_before_anything_moves() {
    let (folder, tool) = demo_tool();
    let out = folder.path().join("out");
    pictures(&tool, &out, "0");
    let refused = |tool: &Path, said: &str, arguments: &[&str]| {
        let seen = in_passes(tool, &out, arguments);
        assert_eq!(seen.code, 3, "{said}: {}", seen.stderr);
        assert!(seen.stderr.contains(said), "{said}: {}", seen.stderr);
    };
    // Of another height: what must be lit is dark.
    let file = tool.join("tool.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let moved = text.replace("\nheight_mm = 33.0", "\nheight_mm = 62.0");
    assert_ne!(moved, text);
    std::fs::write(&file, moved).unwrap();
    refused(&tool, "stay dark in the pictures", &["--teeth", "40"]);
    std::fs::write(&file, text).unwrap();
    let file = tool.join("head.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replace("\"high12\"", "\"insitu12\"")).unwrap();
    refused(&tool, "the pictures show high12", &[]);
    std::fs::write(out.join("adaptive.json"), "{}").unwrap();
    refused(&tool, "missing field", &[]);
}

/// On smoother steel, light over a second flank hides most of what one pass lights.
#[test]
fn passes_show_of_polished_steel_what_all_mirrors_at_once_do_not() {
    if !dear() {
        return;
    }
    let (folder, tool) = demo_tool();
    // One view by either set of patterns, none from the side.
    let file = tool.join("tool.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let once = text.replace("[inspect]\n", "[inspect]\nremeasure = 0\n");
    assert_ne!(text, once, "no table [inspect]");
    std::fs::write(&file, once).unwrap();
    let out = folder.path().join("out");
    pictures(&tool, &out, "0.03");
    let path = tool.to_str().unwrap();
    let steel = ["--surface", "polished", "--teeth", "40", "--seed", "3"];
    let worn = ["--wear", "40:left:80:half"];
    let coverage = |seen: &Run| {
        let flanks = seen.json["features"].as_array().unwrap().iter();
        let of = |flank: &Value| flank["coverage_ratio"].as_f64().unwrap();
        flanks.map(of).fold(1.0, f64::min)
    };
    let plain = inspect(&[&["--link", "sim", "--tool", path][..], &steel].concat());
    let passes = in_passes(&tool, &out, &steel);
    println!("seen {:.2} and {:.2}", coverage(&plain), coverage(&passes));
    assert!(coverage(&passes) > 0.8 && coverage(&passes) > 1.5 * coverage(&plain));
    // What is seen reads right.
    for flank in passes.json["features"].as_array().unwrap() {
        let read = &flank["detail"]["absolute_um"];
        let [wear_um, u95_um] = ["value", "u95"].map(|key| read[key].as_f64().unwrap());
        assert!(wear_um.abs() < u95_um, "{flank}");
        // Where light still hides too much to judge, the claim is a lower bound, of a sound flank none above zero.
        assert!(
            flank["at_least_um"].as_f64().is_none_or(|um| um <= 0.0),
            "{flank}"
        );
    }
    let worn = in_passes(&tool, &out, &[&steel[..], &worn].concat());
    assert_ne!(worn.flank(40, "left"), Some("go"), "{}", worn.stderr);
}
