//! Frames from elsewhere through the whole instrument: no controller, no camera process, no bench.

use std::path::{Path, PathBuf};

use flankscope_test_requisites::{at_least, shared};
use flankscope_tests::{Run, bench, flankscope, inspect, run, small_tool, tool_of_noise_alone};
use serde_json::Value;

/// What the outside renderer's head is off the place that its file says, µm.
const HEAD_OFF_UM: [f64; 2] = [35.0, -20.0];

fn check(folder: &Path, arguments: &[&str]) -> Run {
    let mut command = flankscope();
    command.args(["inspect", "--quiet", "--json", "-", "--frames"]);
    run(command.arg(folder).args(arguments))
}

/// A check of frames that the small head recorded.
fn check_small(folder: &Path, arguments: &[&str]) -> Run {
    check(folder, &[&["--tool", small_tool()], arguments].concat())
}

/// An index in a folder of its own, for images that lie where nothing can be written.
fn index_of(outside: &Path, plan: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = format!(
        "simulated = true\nplan = {:?}\nhead = {:?}\nimages = {outside:?}\n[[view]]\ntooth = 40\n",
        outside.join(plan),
        outside.join("head.toml")
    );
    std::fs::write(folder.path().join("frames.toml"), text).unwrap();
    folder
}

fn feature<'a>(run: &'a Run, flank: &str) -> &'a Value {
    let features = run.json["features"].as_array().unwrap();
    let of = features
        .iter()
        .find(|f| f["tooth"] == 40 && f["flank"] == flank);
    of.unwrap_or_else(|| panic!("no {flank} flank: {}", run.json["features"]))
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

#[test]
fn a_sprayed_die_of_an_outside_renderer_is_go_and_where_the_head_was() {
    let Some(outside) = shared("outside/sprayed-new") else {
        return;
    };
    for (plan, frames) in [("plan-insitu12.toml", 12), ("plan-scan16.toml", 16)] {
        let folder = index_of(&outside, plan);
        let new = check(folder.path(), &["--teeth", "40"]);
        let json = &new.json;
        assert_eq!(new.code, 0, "{plan}: {} {}", json["reason"], new.stderr);
        assert_eq!(json["features"].as_array().unwrap().len(), 2, "{plan}");
        for flank in ["left", "right"] {
            let of = feature(&new, flank);
            let (wear, u95) = (number(&of["wear_um"]), number(&of["u95_um"]));
            assert!(
                wear.abs() <= u95,
                "{plan} {flank}: {wear} ± {u95} µm of nothing"
            );
        }
        let shift = &json["registration"][0]["shift_mm"];
        for (axis, off_um) in HEAD_OFF_UM.into_iter().enumerate() {
            let found_um = 1e3 * number(&shift[axis]);
            assert!((found_um - off_um).abs() < 2.0, "{plan}: {shift}");
        }
        let count = &json["frames"];
        assert_eq!(
            [
                &count["triggered"],
                &count["received"],
                &count["bytes_copied"]
            ],
            [&frames.into(), &frames.into(), &Value::from(0)]
        );
        assert_eq!(json["link"], "recorded frames");
        assert_eq!(json["simulated"], true);
        assert_eq!(json["recording"]["blake3"].as_str().unwrap().len(), 64);
        assert!(json["versions"]["firmware"].is_null(), "no controller");
    }
}

/// Light that goes from flank to flank spoils coarse fringes: what is left of them is not enough to judge, damaged or not.
#[test]
fn coarse_fringes_on_bare_steel_are_indeterminate() {
    let (new, worn) = ("outside/steel-new", "outside/steel-half80");
    let cases = [
        (worn, "plan-insitu12.toml"),
        (new, "plan-insitu12.toml"),
        (worn, "plan-scan16.toml"),
        (new, "plan-scan16.toml"),
    ];
    for &(set, plan) in at_least(1, &cases) {
        let Some(outside) = shared(set) else {
            return;
        };
        let folder = index_of(&outside, plan);
        let seen = check(folder.path(), &["--teeth", "40"]);
        assert_eq!(seen.code, 2, "{set} {plan}: {}", seen.stderr);
    }
}

/// High fringes are washed out on their way over a second flank. 80 µm are missing over half of the left flank, so some disc lies
/// within it as a whole.
#[test]
fn high_fringes_judge_bare_steel() {
    let of = |set: &str| {
        let outside = shared(set)?;
        let folder = index_of(&outside, "plan-high16.toml");
        Some(check(folder.path(), &["--teeth", "40"]))
    };
    let (Some(new), Some(worn)) = (of("outside/steel-new"), of("outside/steel-half80")) else {
        return;
    };
    assert_eq!(new.code, 0, "{} {}", new.json["reason"], new.stderr);
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    for (run, flank, missing_um) in [
        (&new, "left", 0.0),
        (&new, "right", 0.0),
        (&worn, "left", 80.0),
        (&worn, "right", 0.0),
    ] {
        let found = feature(run, flank);
        // Where the edge of what is missing counts as texture on rough steel, a lower bound is claimed instead of an interval.
        let holds = match found["at_least_um"].as_f64() {
            Some(at_least_um) => at_least_um <= missing_um,
            None => (number(&found["wear_um"]) - missing_um).abs() <= number(&found["u95_um"]),
        };
        assert!(holds, "{flank}: {found} of {missing_um} µm");
        let verdict = if missing_um > 0.0 { "no-go" } else { "go" };
        assert_eq!(found["verdict"], verdict, "{flank}");
    }
}

#[test]
fn a_recorded_check_is_stored_reported_and_computed_again() {
    let Some(outside) = shared("outside/sprayed-new") else {
        return;
    };
    let folder = index_of(&outside, "plan-insitu12.toml");
    let history = folder.path().join("checks.db");
    let report = folder.path().join("report");
    let [history, report] = [&history, &report].map(|path| path.to_str().unwrap());
    let stored = check(folder.path(), &["--history", history, "--report", report]);
    assert_eq!(stored.code, 0, "{}", stored.stderr);
    assert_eq!(stored.json["id"], 1);
    let page = std::fs::read_to_string(Path::new(report).join("report.html")).unwrap();
    assert!(page.contains("recorded frames"));
    // The images are not asked again.
    std::fs::remove_file(folder.path().join("frames.toml")).unwrap();
    let head = outside.join("head.toml");
    let mut replay = flankscope();
    replay.args(["replay", history, "1", "--quiet", "--json", "-", "--head"]);
    let again = run(replay.arg(head));
    assert_eq!(
        again.code, 0,
        "{} {}",
        again.json["differences"], again.stderr
    );
    assert_eq!(again.json["same"], true);
    assert_eq!(again.json["recording"], stored.json["recording"]);
}

/// What two documents of the same frames must share to the last bit: all but how long things took.
fn measured(run: &Run) -> Value {
    let mut of = serde_json::Map::new();
    for key in [
        "verdict",
        "reason",
        "features",
        "registration",
        "evidence",
        "recipe",
        "hashes",
        "tool",
        "temperature_degc",
        "press_cycles",
        "simulated",
        "head",
    ] {
        let mut value = run.json[key].clone();
        assert!(
            key == "temperature_degc" || !value.is_null(),
            "{key} is missing: {}",
            run.stderr
        );
        if key == "head" {
            // The same file, but a copy: nobody says of it that it came with the program.
            value.as_object_mut().unwrap().remove("seal");
        }
        for view in value.as_array_mut().into_iter().flatten() {
            if let Some(view) = view.as_object_mut() {
                view.remove("elapsed_ms");
            }
        }
        of.insert(key.into(), value);
    }
    let frames = &run.json["frames"];
    of.insert(
        "frames".into(),
        serde_json::json!([frames["triggered"], frames["received"]]),
    );
    of.into()
}

/// One capture of one tooth on the bench, recorded.
fn recorded(folder: &Path, arguments: &[&str]) -> Run {
    let frames = folder.join("frames");
    let live = inspect(&[&["--save-frames", frames.to_str().unwrap()][..], arguments].concat());
    assert!(frames.join("frames.toml").exists(), "{}", live.stderr);
    live
}

#[test]
fn a_live_check_that_was_recorded_is_the_same_to_the_last_bit() {
    let folder = tempfile::tempdir().unwrap();
    let live = recorded(
        folder.path(),
        &["--teeth", "40,12", "--wear", "40:left:80", "--seed", "7"],
    );
    assert_eq!(live.code, 1, "{}", live.stderr);
    assert_eq!(
        live.json["frames"]["bytes_copied"],
        50 * 640 * 480 * 2,
        "frames leave the shared memory when they are asked for, and are counted"
    );
    let again = check_small(&folder.path().join("frames"), &[]);
    assert_eq!(again.code, 1, "{}", again.stderr);
    assert_eq!(measured(&again), measured(&live));
    assert_eq!(again.json["frames"]["bytes_copied"], 0);
    let exposure = |run: &Run| number(&run.json["timing_ms"]["exposure"]);
    let apart = exposure(&again) - exposure(&live);
    assert!(
        apart.abs() < 1e-6,
        "the triggers are recorded, too: {apart} ms"
    );
    // One of the two alone is judged as it was.
    let one = check_small(&folder.path().join("frames"), &["--teeth", "12"]);
    assert_eq!(one.code, 0, "{}", one.stderr);
    assert_eq!(one.json["features"].as_array().unwrap().len(), 2);
    assert_eq!(
        one.json["features"],
        Value::from(&live.json["features"].as_array().unwrap()[2..])
    );
}

/// A pit at the limit is measured again, live (see `remeasure.rs`): both captures are in the recording, and judged together
/// there.
#[test]
fn a_repetition_is_recorded_and_counts_again() {
    let folder = tempfile::tempdir().unwrap();
    let tool = tool_of_noise_alone(&folder.path().join("tool"), "20mm", "");
    let of_tool = ["--tool", &tool];
    let pit = [
        "--link",
        "sim",
        "--teeth",
        "12,40",
        "--wear",
        "40:left:38.6:pit",
        "--seed",
        "6",
    ];
    let live = recorded(folder.path(), &[&of_tool[..], &pit].concat());
    assert_eq!(
        live.json["frames"]["received"], 75,
        "{}",
        live.json["features"]
    );
    let again = check(&folder.path().join("frames"), &of_tool);
    assert_eq!(measured(&again), measured(&live));
    let twice = again.json["evidence"].as_array().unwrap();
    let captures = |of: &Value| of["phasors"].as_array().unwrap().len();
    assert_eq!(twice.iter().map(captures).collect::<Vec<_>>(), [1, 2]);
}

/// A copy of a recording whose files share no fate with it.
struct Copied {
    folder: tempfile::TempDir,
}

impl Copied {
    fn of(frames: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let copied = Self { folder };
        let capture = copied.path("capture-0001");
        std::fs::create_dir(&capture).unwrap();
        for from in [frames.to_owned(), frames.join("capture-0001")] {
            for entry in std::fs::read_dir(&from).unwrap() {
                let path = entry.unwrap().path();
                if path.is_file() {
                    let to = copied.path("").join(path.strip_prefix(frames).unwrap());
                    std::fs::copy(&path, to).unwrap();
                }
            }
        }
        copied
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn frame(&self, number: usize) -> PathBuf {
        self.path(&format!("capture-0001/frame-{number:04}.pgm"))
    }

    /// Without digests, as somebody else's recording.
    fn without_digests(self) -> Self {
        self.index(|text| {
            let lines = text.lines().filter(|line| !line.starts_with("blake3"));
            lines.map(|line| format!("{line}\n")).collect()
        })
    }

    fn index(self, change: impl Fn(&str) -> String) -> Self {
        let path = self.path("frames.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        let changed = change(&text);
        assert_ne!(changed, text);
        std::fs::write(path, changed).unwrap();
        self
    }

    fn swap(self, a: usize, b: usize) -> Self {
        let [a, b] = [a, b].map(|frame| self.frame(frame));
        let aside = self.path("aside");
        std::fs::rename(&a, &aside).unwrap();
        std::fs::rename(&b, &a).unwrap();
        std::fs::rename(&aside, &b).unwrap();
        self
    }

    fn rewrite(self, number: usize, change: impl Fn(Vec<u8>) -> Vec<u8>) -> Self {
        let path = self.frame(number);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, change(bytes)).unwrap();
        self
    }

    #[track_caller]
    fn is(&self, code: i32, words: &[&str]) {
        let run = check_small(self.folder.path(), &[]);
        let said = format!("{} {}", run.json["reason"], run.stderr);
        assert_eq!(run.code, code, "{said}");
        for word in words {
            assert!(said.contains(word), "{word:?} is not in {said}");
        }
    }
}

/// Frame 0 is dark, 1 to 4 are coarse and 5 to 12 fine at the short exposure, 13 to 24 the same at the long one.
#[test]
fn what_is_wrong_with_a_recording_is_named_and_never_go() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(recorded(folder.path(), &["--teeth", "40"]).code, 0);
    let frames = folder.path().join("frames");
    let copy = || Copied::of(&frames);
    copy().is(0, &[]);
    copy().without_digests().is(0, &[]);
    let lacks = |name: &str, words: &[&str]| {
        let of = copy();
        std::fs::remove_file(of.path(name)).unwrap();
        of.is(3, words);
    };
    lacks(
        "capture-0001/frame-0007.pgm",
        &["holds 24 images", "25 frames"],
    );
    lacks("head.toml", &["head.toml"]);
    lacks("PLAN.toml", &["PLAN.toml"]);
    let more = copy();
    std::fs::copy(more.frame(7), more.path("capture-0001/z.pgm")).unwrap();
    more.is(3, &["holds 26 images"]);
    let header = |text: &'static str| move |_: Vec<u8>| text.as_bytes().to_vec();
    copy()
        .rewrite(3, header("P5 639 480 4095\n"))
        .is(3, &["639 x 480", "640 x 480", "frame-0003"]);
    copy()
        .rewrite(3, header("P5 640 480 255\n"))
        .is(3, &["8 bits", "the sensor 12"]);
    copy()
        .rewrite(3, header("P2 640 480 4095\n"))
        .is(3, &["neither a PNG nor"]);
    copy()
        .index(|text| text.replace("\"capture-0001\"", "\"../elsewhere\""))
        .is(3, &["frames.toml:", "images ="]);
    copy()
        .index(|text| text.replace("blake3 = [", "blake3 = [\"ab\", "))
        .is(3, &["64 hexadecimal"]);
    copy()
        .index(|text| text.replace("exposed_us = [", "exposed_us = [[0, 1], "))
        .is(3, &["exposed_us"]);
    copy()
        .index(|text| text.replace("tooth = 40", "tooth = 41"))
        .is(3, &["tooth 41", "tooth 40"]);
    copy()
        .index(|text| text.replace("tooth = 40", "tooth = 400"))
        .is(3, &["tooth 400"]);
    copy()
        .index(|text| text.replace("teeth = [40]", "teeth = [40, 12]"))
        .is(2, &["no frames of tooth 12"]);
    let linked = copy();
    std::fs::remove_file(linked.frame(2)).unwrap();
    std::os::unix::fs::symlink(frames.join("capture-0001/frame-0002.pgm"), linked.frame(2))
        .unwrap();
    linked.is(3, &["outside", "frame-0002"]);
}

/// What names and headers do not tell, the content does.
#[test]
fn frames_that_are_not_the_recorded_ones_or_in_another_order_are_never_go() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(recorded(folder.path(), &["--teeth", "40"]).code, 0);
    let frames = folder.path().join("frames");
    let copy = || Copied::of(&frames);
    let cut = |mut bytes: Vec<u8>| {
        bytes.truncate(bytes.len() / 2);
        bytes
    };
    let stretched_below = |header: &'static str| {
        move |bytes: Vec<u8>| {
            let counts = bytes["P5\n640 480\n4095\n".len()..].as_chunks::<2>().0;
            let counts = counts.iter().map(|&dn| 16 * u16::from_be_bytes(dn));
            let counts = counts.flat_map(u16::to_be_bytes);
            header.bytes().chain(counts).collect()
        }
    };
    copy().rewrite(9, cut).is(2, &["is not what was recorded"]);
    copy().swap(9, 10).is(2, &["is not what was recorded"]);
    let foreign = || copy().without_digests();
    foreign()
        .rewrite(9, cut)
        .is(2, &["ends before its last pixel"]);
    foreign()
        .rewrite(9, stretched_below("P5\n640 480\n65535\n"))
        .is(2, &["the sensor ends at 4095"]);
    foreign()
        .rewrite(9, stretched_below("P5\n640 480\n4095\n"))
        .is(2, &["above the largest value of its header"]);
    let again = foreign();
    std::fs::copy(again.frame(9), again.frame(10)).unwrap();
    again.is(2, &["frame-0010.pgm is ", "frame-0009.pgm again"]);
    foreign().swap(9, 10).is(2, &["do not follow one fringe"]);
    foreign().swap(0, 3).is(2, &["the dark frame has a mean"]);
    foreign().swap(4, 5).is(2, &["do not follow one fringe"]);
    // Mirrored coarse fringes are fringes, too: they put the die where it is not.
    foreign().swap(2, 4).swap(14, 16).is(2, &["registration"]);
    // A frame that came late, by the clocks.
    let late = copy().index(|text| {
        let (before, rest) = text.split_once("exposed_us = [[").unwrap();
        let (first, after) = rest.split_once(',').unwrap();
        let earlier = first.parse::<u64>().unwrap() - 5_000;
        format!("{before}exposed_us = [[{earlier},{after}")
    });
    late.is(2, &["was exposed for"]);
}

/// Exposures of a sound die beside those of a damaged one, all frames of an exposure or those of one frequency.
#[test]
fn exposures_of_two_scenes_are_named_and_never_go() {
    let [sound, later, worn, pitted] = [0; 4].map(|_| tempfile::tempdir().unwrap());
    let same = ["--teeth", "40", "--seed", "7"];
    assert_eq!(recorded(sound.path(), &same).code, 0);
    assert_eq!(
        recorded(later.path(), &["--teeth", "40", "--seed", "8"]).code,
        0
    );
    let damages = [(&worn, "40:left:80"), (&pitted, "40:left:80:pit")];
    for (folder, damage) in damages {
        let live = recorded(folder.path(), &[&same[..], &["--wear", damage]].concat());
        assert_eq!(live.code, 1, "{damage}: {}", live.stderr);
    }
    let of = |folder: &tempfile::TempDir| Copied::of(&folder.path().join("frames"));
    let with = |base: &tempfile::TempDir, frames: std::ops::Range<usize>, from: &Copied| {
        let mixed = of(base).without_digests();
        for frame in frames {
            std::fs::copy(from.frame(frame), mixed.frame(frame)).unwrap();
        }
        mixed
    };
    let named = ["do not show one scene"];
    let (short, long, long_coarse, long_fine) = (1..13, 13..25, 13..17, 17..25);
    let parts = [&short, &long, &long_coarse, &long_fine];
    for (damaged, parts) in [(&worn, &parts[..]), (&pitted, &parts[..2])] {
        for (base, other) in [(&sound, damaged), (damaged, &sound)] {
            for &frames in parts {
                with(base, frames.clone(), &of(other)).is(2, &named);
            }
        }
    }
    // Captured again, as a live check does: the second capture counts alone.
    let again = with(&sound, long, &of(&worn));
    let second = again.path("capture-0002");
    std::fs::create_dir(&second).unwrap();
    for frame in 0..25 {
        let name = format!("capture-0001/frame-{frame:04}.pgm");
        let to = second.join(format!("frame-{frame:04}.pgm"));
        std::fs::copy(later.path().join("frames").join(name), to).unwrap();
    }
    let again = again.index(|text| {
        let (before, view) = text.split_once("[[view]]").unwrap();
        let second = view.replace("capture-0001", "capture-0002");
        format!("{before}[[view]]{view}\n[[view]]{second}")
    });
    let run = check_small(again.folder.path(), &[]);
    assert_eq!(run.code, 0, "{} {}", run.json["reason"], run.stderr);
    assert_eq!(run.json["frames"]["received"], 50);
    let captures = run.json["evidence"][0]["phasors"].as_array().unwrap();
    assert_eq!(captures.len(), 1, "{captures:?}");
    let rejected = &run.json["registration"][0]["light"]["rejected"];
    let disagree = number(&rejected["exposures_disagree"]);
    assert!(disagree < 1e-3 * number(&run.json["registration"][0]["points"]));
}

#[test]
fn a_bench_does_not_change_frames_that_were_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let index = "simulated = true\n[[view]]\ntooth = 40\n";
    std::fs::write(folder.path().join("frames.toml"), index).unwrap();
    std::fs::write(
        folder.path().join("PLAN.toml"),
        "pattern_set = \"insitu12\"\n",
    )
    .unwrap();
    for arguments in [
        &["--wear", "40:left:80"][..],
        &["--link", "sim"],
        &["--save-frames", "elsewhere"],
    ] {
        let refused = check(folder.path(), arguments);
        assert_eq!(refused.code, 3, "{arguments:?}: {}", refused.stderr);
        assert!(refused.stderr.contains("--frames"), "{}", refused.stderr);
    }
    // And a recording is not written over another.
    let full = folder.path().to_str().unwrap();
    let refused = inspect(&["--save-frames", full]);
    assert_eq!(refused.code, 3);
    assert!(refused.stderr.contains("not empty"), "{}", refused.stderr);
}

fn scan(arguments: &[&str]) -> Run {
    let mut command = flankscope();
    run(command
        .args(["scan", "--quiet", "--json", "-"])
        .args(arguments))
}

/// A scan that was recorded, on the bench, is the live one again; what it lacks is missed.
#[test]
fn a_scan_that_was_recorded_is_the_same_to_the_last_bit() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    let path = frames.to_str().unwrap();
    let [option, oval] = bench("[die]\novality_um = 20.0\n");
    let live = scan(&[
        "--views",
        "6x2",
        "--speed",
        "max",
        &option,
        &oval,
        "--save-frames",
        path,
    ]);
    assert!(frames.join("frames.toml").exists(), "{}", live.stderr);
    let again = scan(&["--frames", path]);
    assert_eq!(
        again.code, live.code,
        "{} {}",
        again.json["reason"], again.stderr
    );
    for key in [
        "verdict",
        "reason",
        "features",
        "flank_means",
        "form",
        "spacing",
        "views",
        "coverage",
        "coverage_ratio",
        "registration",
        "joint",
        "teeth_stretch_ratio",
        "hashes",
        "tool",
        "simulated",
        "inconsistent_ratio",
    ] {
        assert_eq!(again.json[key], live.json[key], "{key}");
    }
    for key in ["triggered", "received"] {
        assert_eq!(again.json["frames"][key], 12 * 25);
        assert_eq!(live.json["frames"][key], 12 * 25);
    }
    assert_eq!(again.json["link"], "recorded frames");
    assert!(!again.json["form"].is_null() && !again.json["features"].is_null());
    // Without one of its views the same grid was not seen whole.
    let index = std::fs::read_to_string(frames.join("frames.toml")).unwrap();
    let last = index.rfind("[[view]]").unwrap();
    std::fs::write(frames.join("frames.toml"), &index[..last]).unwrap();
    let less = scan(&["--frames", path]);
    assert_eq!(less.code, 2, "{}", less.json["reason"]);
    assert_eq!(less.json["views"], "6x2");
    // Of the views that there are, and no others, it may be: eleven of no grid.
    let grid = index[..last].replace("grid = \"6x2\"\n", "");
    std::fs::write(frames.join("frames.toml"), grid).unwrap();
    let eleven = scan(&["--frames", path]);
    assert_eq!(
        eleven.json["views"], "11 recorded views",
        "{}",
        eleven.stderr
    );
    assert_eq!(
        eleven.json["coverage"]["of_teeth"],
        live.json["coverage"]["of_teeth"]
    );
    // A table of poses, by which no scan goes, is not passed over.
    let table = format!("poses = \"poses.csv\"\n{index}");
    std::fs::write(frames.join("frames.toml"), table).unwrap();
    let posed = scan(&["--frames", path]);
    assert_eq!(posed.code, 3, "{}", posed.json["reason"]);
    assert!(posed.stderr.contains("poses.csv"), "{}", posed.stderr);
    // A place that the grid does not have.
    let moved = index.replacen("vertical_mm = 16.5", "vertical_mm = 17.5", 1);
    assert_ne!(moved, index);
    std::fs::write(frames.join("frames.toml"), moved).unwrap();
    let off = scan(&["--frames", path]);
    assert_eq!(off.code, 3);
    assert!(
        off.stderr
            .contains("not taken from a place of its grid 6x2"),
        "{}",
        off.stderr
    );
}
