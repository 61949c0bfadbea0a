//! What is no internal gear, end to end: an external gear looked at from outside, a flat die and a rack with patches.

use std::f64::consts::PI;
use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Mesh, Meshing, write_ply};
use flankscope_profilometry::HeadModel;
use flankscope_profilometry::head::RigidTransform;
use flankscope_test_requisites::dear;
use flankscope_tests::{Run, demo_gear, flankscope, inspect, run};

/// The demo head's focus is so far from the axis, and its pinhole so far from its focus, mm.
const FOCUS_RADIUS_MM: f64 = 41.5;
const STAND_OFF_MM: f64 = 22.0;

/// The demo tool's folder with the head beside the die instead of inside: its pinhole beyond the focus, looking at the axis.
fn head_outside(folder: &Path, focus_radius_mm: f64) {
    let made = run(flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(folder));
    assert_eq!(made.code, 0, "{}", made.stderr);
    let file = folder.join("head.toml");
    let mut head = HeadModel::load(&file).unwrap();
    head.stage_from_camera = Some(RigidTransform {
        // Columns along +z of the stage, rows along +y, view along -x.
        rotation: [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        translation_mm: [focus_radius_mm + STAND_OFF_MM, 0.0, 0.0],
    });
    std::fs::write(file, head.to_toml().unwrap()).unwrap();
}

/// A wheel with the demo die's teeth, module and height.
fn wheel() -> GearSpec {
    let ring = demo_gear();
    let pitch_mm = ring.pitch_radius_mm();
    GearSpec {
        kind: GearKind::External,
        tip_radius_mm: pitch_mm + ring.module_mm,
        root_radius_mm: pitch_mm - 1.25 * ring.module_mm,
        body_radius_mm: 20.0,
        ..ring
    }
}

/// Its tool folder, as an argument.
fn wheel_tool(folder: &Path, focus_radius_mm: f64) -> String {
    head_outside(folder, focus_radius_mm);
    let gear = wheel();
    let fine = Meshing {
        chord_error_mm: 0.2e-3,
        ..Meshing::default()
    };
    let mut ply = Vec::new();
    write_ply(&gear.mesh(&fine).unwrap(), &mut ply).unwrap();
    std::fs::write(folder.join("die.ply"), ply).unwrap();
    let tool = format!(
        "name = \"wheel\"\n[cad]\nfile = \"die.ply\"\nunit = \"mm\"\nchord_error_um = 0.2\n\
         [gear]\nkind = \"external\"\nteeth = {}\nmodule_mm = {}\npressure_angle_deg = 20.0\ntip_radius_mm = {}\n\
         root_radius_mm = {}\nfirst_tooth_centre_deg = {}\nheight_mm = [0.0, 66.0]\n\
         [inspect]\nteeth = [12, 40]\nheight_mm = 33.0\nwarn_um = 30.0\nlimit_um = 50.0\n",
        gear.teeth,
        gear.module_mm,
        gear.tip_radius_mm,
        gear.root_radius_mm,
        180.0 / f64::from(gear.teeth),
    );
    std::fs::write(folder.join("tool.toml"), tool).unwrap();
    folder.to_str().unwrap().to_owned()
}

#[test]
fn an_external_gear_is_judged_from_outside() {
    let folder = tempfile::tempdir().unwrap();
    let tool = wheel_tool(folder.path(), FOCUS_RADIUS_MM);
    let on = ["--tool", &tool, "--link", "sim"];
    let undamaged = inspect(&on);
    assert_eq!(
        undamaged.code, 0,
        "{} {}",
        undamaged.json["reason"], undamaged.stderr
    );
    assert_eq!(undamaged.json["features"].as_array().unwrap().len(), 4);
    for wear in ["12:left:80", "40:right:80"] {
        let worn = inspect(&[&on[..], &["--wear", wear]].concat());
        assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
        assert_eq!(worn.not_go(), [wear.replace(":80", ":no-go")]);
        let features = worn.json["features"].as_array().unwrap();
        let flank = features.iter().find(|f| f["verdict"] == "no-go").unwrap();
        let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| flank[key].as_f64().unwrap());
        assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    }
    // The floor of a crack is hidden by its walls.
    let crack = inspect(&[&on[..], &["--wear", "12:left:300:crack"]].concat());
    assert_eq!(crack.code, 2, "{} {}", crack.json["reason"], crack.stderr);
    assert_eq!(crack.not_go(), ["12:left:indeterminate"]);
}

#[test]
fn a_wheel_out_of_the_heads_depth_is_indeterminate_and_one_in_its_way_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    // Half of the zone is farther away than the head measures.
    let tool = wheel_tool(folder.path(), FOCUS_RADIUS_MM + 1.7);
    let far = inspect(&["--tool", &tool, "--link", "sim"]);
    assert_eq!(far.code, 2, "{} {}", far.json["reason"], far.stderr);
    let tool = wheel_tool(folder.path(), 20.0);
    let touching = inspect(&["--tool", &tool, "--link", "sim"]);
    assert_eq!(touching.code, 3, "{}", touching.stderr);
    assert!(
        touching.stderr.contains("from outside"),
        "{}",
        touching.stderr
    );
}

/// Half widths of the boss and of the plate, their faces' distance from the axis, and the plate's height, mm.
const BOSS_MM: f64 = 2.5;
const PLATE_MM: f64 = 12.0;
const BOSS_X_MM: f64 = 41.3;
const SHOULDER_X_MM: f64 = 41.8;
const BACK_X_MM: f64 = 52.0;
const HEIGHT_MM: f64 = 40.0;
/// Pitch plane of the rack.
const RACK_X_MM: f64 = 41.5;

/// A die drawn up along z: from one end of its back to the other by an outline of distances from the axis and y. `moved_mm` says how
/// far a corner of the outline, by its number, lies deeper at a height; where that is not a number, the die is open.
fn drawn(outline: &[[f64; 2]], heights: &[f64], moved_mm: impl Fn(usize, f64) -> f64) -> Mesh {
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let mut quad = |corners: [[f64; 3]; 4]| {
        if corners.iter().all(|corner| corner[0].is_finite()) {
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend(corners);
            let of = |k: [u32; 3]| k.map(|i| first + i);
            mesh.triangles.extend([of([0, 1, 2]), of([0, 2, 3])]);
        }
    };
    for corner in 0..outline.len() - 1 {
        let [[x0, y0], [x1, y1]] = [outline[corner], outline[corner + 1]];
        for z in heights.windows(2) {
            let at = |corner: usize, z: f64| {
                let [x, y] = outline[corner];
                [x + moved_mm(corner, z), y, z]
            };
            quad([
                at(corner, z[0]),
                at(corner, z[1]),
                at(corner + 1, z[1]),
                at(corner + 1, z[0]),
            ]);
            if y1 > y0 {
                let back = |y: f64, z: f64| [BACK_X_MM, y, z];
                quad([
                    back(y0, z[0]),
                    back(y1, z[0]),
                    back(y1, z[1]),
                    back(y0, z[1]),
                ]);
            }
        }
        if y1 > y0 {
            let end = |z: f64| {
                [
                    [x0, y0, z],
                    [x1, y1, z],
                    [BACK_X_MM, y1, z],
                    [BACK_X_MM, y0, z],
                ]
            };
            quad(end(heights[0]));
            let mut top = end(heights[heights.len() - 1]);
            top.reverse();
            quad(top);
        }
    }
    mesh
}

/// A flat die that faces the head inside: a boss in the middle of a plate. The boss's face has lost `loss_mm` at a place y, z.
fn plate(loss_mm: impl Fn(f64, f64) -> f64) -> Mesh {
    const STEP_MM: f64 = 0.1;
    let grid = |from: f64, to: f64| {
        let count = ((to - from) / STEP_MM).round() as usize;
        (0..=count).map(move |i| from + (to - from) * i as f64 / count as f64)
    };
    let mut outline = vec![
        [BACK_X_MM, -PLATE_MM],
        [SHOULDER_X_MM, -PLATE_MM],
        [SHOULDER_X_MM, -BOSS_MM],
    ];
    let first = outline.len();
    outline.extend(grid(-BOSS_MM, BOSS_MM).map(|y| [BOSS_X_MM, y]));
    let boss = first..outline.len();
    outline.extend([
        [SHOULDER_X_MM, BOSS_MM],
        [SHOULDER_X_MM, PLATE_MM],
        [BACK_X_MM, PLATE_MM],
    ]);
    // Fine only where the head looks.
    let [low, high] = [-4.0, 4.0].map(|off| 0.5 * HEIGHT_MM + off);
    let mut heights = vec![0.0];
    heights.extend(grid(low, high));
    heights.push(HEIGHT_MM);
    drawn(&outline, &heights, |corner, z| {
        if boss.contains(&corner) && (low..=high).contains(&z) {
            loss_mm(outline[corner][1], z)
        } else {
            0.0
        }
    })
}

/// A rack of module 1 whose teeth point at the axis. The flank towards +y of its middle tooth has lost `loss_mm` along its normal.
fn rack(loss_mm: f64) -> Mesh {
    let (sin, cos) = 20f64.to_radians().sin_cos();
    let [tip, root] = [RACK_X_MM - 1.0, RACK_X_MM + 1.25];
    let half = |x: f64| 0.25 * PI + (x - RACK_X_MM) * sin / cos;
    let mut outline = vec![[BACK_X_MM, -3.5 * PI], [root, -3.5 * PI]];
    for tooth in -3..=3 {
        let middle = PI * f64::from(tooth);
        let lost = if tooth == 0 { loss_mm / cos } else { 0.0 };
        outline.extend([
            [root, middle - half(root)],
            [tip, middle - half(tip)],
            [tip, middle + half(tip) - lost],
            [root, middle + half(root) - lost],
        ]);
    }
    outline.extend([[root, 3.5 * PI], [BACK_X_MM, 3.5 * PI]]);
    drawn(&outline, &[0.0, HEIGHT_MM], |_, _| 0.0)
}

/// The flat die's folder, as an argument.
fn plate_tool(folder: &Path, patches: &str) -> String {
    patch_tool(folder, &plate(|_, _| 0.0), patches)
}

fn patch_tool(folder: &Path, cad: &Mesh, patches: &str) -> String {
    let made = run(flankscope()
        .args(["bench", "demo-tool", "--out"])
        .arg(folder));
    assert_eq!(made.code, 0, "{}", made.stderr);
    put(&folder.join("die.ply"), cad);
    let tool = format!(
        "name = \"plate\"\n[cad]\nfile = \"die.ply\"\nunit = \"mm\"\n{patches}\n[inspect]\nwarn_um = 30.0\nlimit_um = 50.0\n"
    );
    std::fs::write(folder.join("tool.toml"), tool).unwrap();
    folder.to_str().unwrap().to_owned()
}

fn put(path: &Path, mesh: &Mesh) {
    let mut ply = Vec::new();
    write_ply(mesh, &mut ply).unwrap();
    std::fs::write(path, ply).unwrap();
}

const BOSS: &str = "[[patch]]\nname = \"boss\"\nseed_mm = [41.3, 0.51, 20.02]\nzone_mm = [[-2.0, 2.0], [-2.0, 2.0]]\n";
const LEFT: &str = "[[patch]]\nname = \"left shoulder\"\nseed_mm = [41.8, 5.0, 20.0]\n";
const RIGHT: &str = "[[patch]]\nname = \"right shoulder\"\nseed_mm = [41.8, -5.0, 20.0]\n";
const BOTH: &str = "datum = [\"left shoulder\", \"right shoulder\"]\n";

#[test]
fn a_flat_die_is_judged_by_its_patch() {
    let folder = tempfile::tempdir().unwrap();
    let tool = plate_tool(folder.path(), &format!("{BOSS}{BOTH}{LEFT}{RIGHT}"));
    let damaged = folder.path().join("damaged.ply");
    let on = ["--tool", &tool, "--link", "sim"];
    let with = |loss_mm: &dyn Fn(f64, f64) -> f64| {
        put(&damaged, &plate(loss_mm));
        inspect(&[&on[..], &["--die-mesh", damaged.to_str().unwrap()]].concat())
    };
    let of = |run: &Run| {
        let features = run.json["features"].as_array().unwrap();
        assert_eq!(features.len(), 1, "{features:?}");
        assert_eq!(features[0]["patch"], "boss");
        assert_eq!(features[0]["flank"], "face");
        features[0].clone()
    };
    let holds = |run: &Run, um: f64| {
        let feature = of(run);
        let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| feature[key].as_f64().unwrap());
        assert!((wear_um - um).abs() <= u95_um, "{um}: {wear_um} ± {u95_um}");
    };
    let sound = inspect(&on);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    holds(&sound, 0.0);
    // All of the face gone by the same depth, which by itself could as well be another place of the die.
    let even = with(&|_, _| 0.08);
    assert_eq!(even.code, 1, "{} {}", even.json["reason"], even.stderr);
    assert!(even.json["reason"].as_str().unwrap().contains("patch boss"));
    holds(&even, 80.0);
    // A round hole a little larger than the disc of a quarter of a square millimetre.
    let hole = with(&|y, z| if y.hypot(z - 20.7) < 0.6 { 0.08 } else { 0.0 });
    assert_eq!(hole.code, 1, "{} {}", hole.json["reason"], hole.stderr);
    let detail = &of(&hole)["detail"]["deepest_at_mm"];
    // From the zone's corner: 2 mm along, 2.7 mm up; the disc may lie anywhere in the hole.
    let off = (detail[0].as_f64().unwrap() - 2.0).hypot(detail[1].as_f64().unwrap() - 2.7);
    assert!(off < 0.4, "{detail}");
    // A hole without a floor hides what it likes; half a face that is gone is no go, whatever is seen behind it.
    let hidden = with(&|y, z| {
        if (y - 1.0).hypot(z - 21.0) < 0.6 {
            f64::NAN
        } else {
            0.0
        }
    });
    assert_eq!(
        hidden.code, 2,
        "{} {}",
        hidden.json["reason"], hidden.stderr
    );
    assert_eq!(of(&hidden)["code"], "hidden");
    let half = with(&|y, _| if y < 0.0 { f64::NAN } else { 0.0 });
    assert!([1, 2].contains(&half.code), "{}", half.json["reason"]);
    // Less than the warning limit.
    let shallow = with(&|_, _| 0.01);
    assert_eq!(
        shallow.code, 0,
        "{} {}",
        shallow.json["reason"], shallow.stderr
    );
    holds(&shallow, 10.0);
}

/// A flat die with a boss that runs up all of it: its face has lost so much between 26 and 34 mm of height, all of it there.
fn tall_plate(lost_mm: f64) -> Mesh {
    let outline = [
        [BACK_X_MM, -PLATE_MM],
        [SHOULDER_X_MM, -PLATE_MM],
        [SHOULDER_X_MM, -BOSS_MM],
        [BOSS_X_MM, -BOSS_MM],
        [BOSS_X_MM, BOSS_MM],
        [SHOULDER_X_MM, BOSS_MM],
        [SHOULDER_X_MM, PLATE_MM],
        [BACK_X_MM, PLATE_MM],
    ];
    let heights = [0.0, 6.0, 14.0, 26.0, 34.0, HEIGHT_MM];
    drawn(&outline, &heights, |corner, z| {
        let is_lost = [3, 4].contains(&corner) && (26.0..=34.0).contains(&z);
        if is_lost { lost_mm } else { 0.0 }
    })
}

/// Two faces 20 mm apart, which no view shows together: a view each, one verdict; and from recorded frames, to the last bit.
#[test]
fn patches_that_no_view_shows_together_are_judged_in_one_check_and_from_its_frames() {
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let face = |name: &str, z: f64| {
        let (low, high, seed) = (z - 4.5, z + 4.5, z + 0.1);
        format!(
            "[[patch]]\nname = {name:?}\nseed_mm = [{BOSS_X_MM}, 0.51, {seed}]\nbox_mm = [[41.0, -3.0, {low}], [42.0, 3.0, {high}]]\n\
             zone_mm = [[-2.0, 2.0], [-2.0, 2.0]]\n{BOTH}"
        )
    };
    let (lower, upper) = (face("lower", 10.0), face("upper", 30.0));
    let tool = patch_tool(
        folder.path(),
        &tall_plate(0.0),
        &format!("{lower}{upper}{LEFT}{RIGHT}"),
    );
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (worn, frames) = (path("worn.ply"), path("frames"));
    put(worn.as_ref(), &tall_plate(0.08));
    let live = inspect(&[
        "--tool",
        &tool,
        "--link",
        "sim",
        "--die-mesh",
        &worn,
        "--save-frames",
        &frames,
    ]);
    assert_eq!(live.code, 1, "{} {}", live.json["reason"], live.stderr);
    assert_eq!(live.not_go(), ["2:face:no-go"]);
    let features = live.json["features"].as_array().unwrap();
    let names: Vec<_> = features.iter().map(|of| of["patch"].as_str()).collect();
    assert_eq!(names, [Some("lower"), Some("upper")]);
    for (of, lost_um) in features.iter().zip([0.0, 80.0]) {
        let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| of[key].as_f64().unwrap());
        assert!((wear_um - lost_um).abs() <= u95_um, "{wear_um} ± {u95_um}");
    }

    let recorded = |arguments: &[&str]| {
        let on = [
            "inspect", "--quiet", "--json", "-", "--frames", &frames, "--tool", &tool,
        ];
        run(flankscope().args(on).args(arguments))
    };
    let again = recorded(&[]);
    assert_eq!(again.code, 1, "{} {}", again.json["reason"], again.stderr);
    assert_eq!(again.json["features"], live.json["features"]);
    let one = recorded(&["--teeth", "1"]);
    assert_eq!(one.code, 0, "{} {}", one.json["reason"], one.stderr);
    assert_eq!(one.json["features"][0], live.json["features"][0]);

    let index = folder.path().join("frames/frames.toml");
    let said = std::fs::read_to_string(&index).unwrap();
    let refused = |hint: &str| {
        let run = recorded(&[]);
        assert_eq!(run.code, 3, "{} {}", run.json["reason"], run.stderr);
        assert!(run.stderr.contains(hint), "{hint}: {}", run.stderr);
    };
    // A view that does not say of which patch it is.
    std::fs::write(&index, said.replacen("\ntooth = 2\n", "\n", 1)).unwrap();
    refused("does not say which patch");
    // A patch that was to be checked and has no frames; a scan is of a gear.
    std::fs::write(&index, said.replacen("\ntooth = 1\n", "\ntooth = 2\n", 1)).unwrap();
    refused("from two places");
    let views = said.split("[[view]]");
    let kept: Vec<&str> = views.filter(|of| !of.contains("\ntooth = 2\n")).collect();
    assert_eq!(kept.len(), 2, "{said}");
    std::fs::write(&index, kept.join("[[view]]")).unwrap();
    let half = recorded(&[]);
    assert_eq!(half.code, 2, "{} {}", half.json["reason"], half.stderr);
    let reason = half.json["reason"].as_str().unwrap();
    assert!(reason.contains("no frames of patch upper"), "{reason}");
    let scan = run(flankscope().args(["scan", "--frames", &frames, "--tool", &tool]));
    assert_eq!(scan.code, 3, "{}", scan.stderr);
    assert!(scan.stderr.contains("are for inspect"), "{}", scan.stderr);
    // Frames of one patch are none of the other: the tool file has them the other way round now.
    std::fs::write(&index, &said).unwrap();
    patch_tool(
        folder.path(),
        &tall_plate(0.0),
        &format!("{upper}{lower}{LEFT}{RIGHT}"),
    );
    refused("from the middle of the head's field");
}

/// Stored, computed again, followed and shown by its name, against the CAD and against a baseline.
#[test]
fn a_history_follows_a_patch() {
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let tool = plate_tool(folder.path(), &format!("{BOSS}{BOTH}{LEFT}{RIGHT}"));
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (file, baseline) = (path("press.db"), path("new.json"));
    let damaged = folder.path().join("damaged.ply");
    put(&damaged, &plate(|_, _| 0.08));
    let worn = ["--die-mesh", damaged.to_str().unwrap()];
    let check = |arguments: &[&str]| {
        let stored = ["--tool", &tool, "--link", "sim", "--history", &file];
        inspect(&[&stored, arguments].concat())
    };
    let new = check(&["--record-baseline", &baseline]);
    assert_eq!(new.code, 0, "{} {}", new.json["reason"], new.stderr);
    let lost = check(&worn);
    assert_eq!(lost.code, 1, "{} {}", lost.json["reason"], lost.stderr);
    let since = check(&[&["--baseline", &baseline][..], &worn].concat());
    assert_eq!(since.code, 1, "{} {}", since.json["reason"], since.stderr);
    let of = &since.json["features"][0];
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| of[key].as_f64().unwrap());
    assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    for (id, code) in [("1", 0), ("2", 1), ("3", 1)] {
        let again = run(flankscope().args([
            "replay", &file, id, "--tool", &tool, "--quiet", "--json", "-",
        ]));
        assert_eq!(again.code, code, "{id}: {} {}", again.json, again.stderr);
        assert_eq!(again.json["same"], true, "{id}: {}", again.json);
    }
    let pages = path("pages");
    let shown = run(flankscope().args([
        "history", &file, "--quiet", "--json", "-", "--report", &pages,
    ]));
    assert_eq!(shown.code, 0, "{}", shown.stderr);
    // The last check has a baseline, those before it have none: one figure.
    let followed = shown.json["flanks"].as_array().unwrap();
    assert_eq!(followed.len(), 1, "{followed:?}");
    assert_eq!(followed[0]["patch"], "boss");
    assert_eq!(followed[0]["points"][0]["wear_um"], wear_um);
    assert_eq!(shown.json["last"]["flanks"][0]["patch"], "boss");
    let page = std::fs::read_to_string(folder.path().join("pages/history.html")).unwrap();
    assert!(page.contains("patch boss"));
    assert!(!page.contains("tooth 1 face"));
}

#[test]
fn a_patch_that_cannot_be_judged_is_refused_or_indeterminate() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |patches: &str, hint: &str| {
        let tool = plate_tool(folder.path(), patches);
        let run = inspect(&["--tool", &tool, "--link", "sim"]);
        assert_eq!(
            run.code, 3,
            "{patches}: {} {}",
            run.json["reason"], run.stderr
        );
        assert!(run.stderr.contains(hint), "{hint}: {}", run.stderr);
    };
    // No datum: an even loss looks like a shift.
    refused(BOSS, "cannot be told from a patch that has moved");
    // Larger than the field.
    let whole = BOSS.replace("[-2.0, 2.0]]", "[-8.0, 8.0]]");
    refused(
        &format!("{whole}{BOTH}{LEFT}{RIGHT}"),
        "name several smaller ones",
    );
    // The side of the plate is beyond the head's depth, or turned away.
    let side = "[[patch]]\nname = \"side\"\nseed_mm = [48.0, 12.0, 20.0]\nbox_mm = [[46.0, 11.9, 15.0], [50.0, 12.1, 25.0]]\n";
    refused(
        &format!("{side}datum = [\"left shoulder\"]\n{LEFT}"),
        "outside the measuring volume",
    );
    let of_flanks = format!("{BOSS}{BOTH}{LEFT}{RIGHT}");
    for (option, hint) in [
        (["--wear", "1:left:80"], "no [gear]"),
        (["--teeth", "2"], "no patch that is judged"),
    ] {
        let tool = plate_tool(folder.path(), &of_flanks);
        let run = inspect(&[&["--tool", &tool, "--link", "sim"], &option[..]].concat());
        assert_eq!(run.code, 3, "{option:?}: {}", run.stderr);
        assert!(run.stderr.contains(hint), "{option:?}: {}", run.stderr);
    }
    // A datum that the view does not show cannot hold it.
    let far = "[[patch]]\nname = \"far\"\nseed_mm = [41.8, 5.0, 20.0]\nbox_mm = [[41.0, 9.0, 0.0], [43.0, 12.0, 40.0]]\n";
    let tool = plate_tool(folder.path(), &format!("{BOSS}datum = [\"far\"]\n{far}"));
    let unheld = inspect(&["--tool", &tool, "--link", "sim"]);
    assert_eq!(
        unheld.code, 2,
        "{} {}",
        unheld.json["reason"], unheld.stderr
    );
    // Nor one that leaves open how far away the patch is: the walls beside the boss.
    let wall = "[[patch]]\nname = \"wall\"\nseed_mm = [41.55, 2.5, 20.0]\n";
    let tool = plate_tool(folder.path(), &format!("{BOSS}datum = [\"wall\"]\n{wall}"));
    let slides = inspect(&["--tool", &tool, "--link", "sim"]);
    assert_eq!(
        slides.code, 2,
        "{} {}",
        slides.json["reason"], slides.stderr
    );
}

/// Whoever has the CAD of a part names its faces by points on them, and checks.
#[test]
fn init_makes_a_tool_of_faces_by_points_on_them() {
    let folder = tempfile::tempdir().unwrap();
    let (cad, out) = (folder.path().join("plate.ply"), folder.path().join("tool"));
    put(&cad, &plate(|_, _| 0.0));
    let init = |points: &[&str], limits: &[&str]| {
        let mut init = flankscope();
        init.arg("init").arg(&cad).args(["--json", "-", "--out"]);
        run(init.arg(&out).args(points).args(limits))
    };
    let limits = ["--warn-um", "30", "--limit-um", "50"];
    let missing = init(&["--patch", "41.3,0.51,20.02"], &[]);
    assert_eq!(missing.code, 3);
    for option in ["--datum", "--warn-um", "--limit-um"] {
        assert!(missing.stderr.contains(option), "{}", missing.stderr);
    }
    assert!(!missing.stderr.contains("--teeth"), "{}", missing.stderr);
    let toothless = init(&["--teeth", "1"], &limits);
    assert_eq!(toothless.code, 3);
    assert!(
        toothless.stderr.contains("name faces by --patch"),
        "{}",
        toothless.stderr
    );
    let shoulders = ["--datum", "left=41.8,5,20", "--datum", "41.8,-5,20"];
    for (patch, said) in [
        // 0.3 mm before the face.
        ("boss=41.0,0.51,20.02", "off the CAD"),
        // 0.4 mm from its rim.
        ("boss=41.3,2.1,20.02", "take a point farther inside"),
        ("boss=41.8,5.5,20.02", "share"),
        ("boss=41.3,0.51", "right would be X,Y,Z in mm"),
    ] {
        let refused = init(&[&["--patch", patch][..], &shoulders].concat(), &limits);
        assert_ne!(refused.code, 0, "{patch}");
        assert!(refused.stderr.contains(said), "{patch}: {}", refused.stderr);
        assert!(!out.exists(), "{patch}");
    }
    let boss = ["--patch", "boss=41.3,0.51,20.02"];
    let made = init(&[&boss[..], &shoulders].concat(), &limits);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let faces = made.json["patches"].as_array().unwrap();
    let names: Vec<_> = faces
        .iter()
        .map(|face| face["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["boss", "left", "datum 2"]);
    assert_eq!(made.json["chord_error_um"], 0.0);
    // The face is 5 mm wide, its rim 1.99 mm from the point: a square of 3 mm fits with a rim of 0.25 mm.
    assert_eq!(
        faces[0]["zone_mm"],
        serde_json::json!([[-1.5, 1.5], [-1.5, 1.5]])
    );
    let tool = out.to_str().unwrap();
    let on = ["--tool", tool, "--link", "sim"];
    let sound = inspect(&on);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    let damaged = folder.path().join("damaged.ply");
    put(&damaged, &plate(|_, _| 0.08));
    let worn = inspect(&[&on[..], &["--die-mesh", damaged.to_str().unwrap()]].concat());
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    assert_eq!(worn.json["features"][0]["patch"], "boss");
}

#[test]
fn a_racks_flank_is_judged_by_its_neighbours_and_not_by_lands_that_leave_it_open() {
    if !dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let flank = |name: &str, tooth: f64, side: f64| {
        let y = PI * tooth + side * 0.25 * PI;
        format!("[[patch]]\nname = {name:?}\nseed_mm = [{RACK_X_MM}, {y}, 20.3]\n")
    };
    let judged = flank("middle", 0.0, 1.0) + "zone_mm = [[-0.9, 0.9], [-4.0, 4.0]]\n";
    let neighbours = [
        ("a", -1.0, -1.0),
        ("b", -1.0, 1.0),
        ("c", 1.0, -1.0),
        ("d", 1.0, 1.0),
    ]
    .map(|(name, tooth, side)| flank(name, tooth, side))
    .concat();
    let lands = [-1.0, 1.0].map(|tooth| {
        let (x, y) = (RACK_X_MM - 1.0, PI * tooth);
        format!("[[patch]]\nname = \"land {tooth}\"\nseed_mm = [{x}, {y}, 20.3]\n")
    });
    let patches = format!("{judged}datum = [\"a\", \"b\", \"c\", \"d\"]\n{neighbours}");
    let tool = patch_tool(folder.path(), &rack(0.0), &patches);
    let worn_mesh = folder.path().join("worn.ply");
    put(&worn_mesh, &rack(0.08));
    let on = ["--tool", &tool, "--link", "sim"];
    let sound = inspect(&on);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    let worn = inspect(&[&on[..], &["--die-mesh", worn_mesh.to_str().unwrap()]].concat());
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    let feature = &worn.json["features"][0];
    let [wear_um, u95_um] = ["wear_um", "u95_um"].map(|key| feature[key].as_f64().unwrap());
    assert!((wear_um - 80.0).abs() <= u95_um, "{wear_um} ± {u95_um}");
    // Lands hold how far away the rack is, not where it lies along itself: there only the stages do, to some 0.05 mm.
    let patches = format!(
        "{judged}datum = [\"land -1\", \"land 1\"]\n{}",
        lands.concat()
    );
    patch_tool(folder.path(), &rack(0.0), &patches);
    let open = inspect(&on);
    assert_eq!(open.code, 2, "{} {}", open.json["reason"], open.stderr);
    assert_eq!(open.json["features"][0]["code"], "detection_limit");
}
