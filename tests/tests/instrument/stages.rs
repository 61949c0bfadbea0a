//! A station's stages, end to end: what turns is the station's, the order of views is planned by its dynamics, and what its axes
//! cannot do is refused before anything moves.

use std::fs;

use flankscope_tests::{
    Run, bench, flankscope, inspect, inspect_full, run, small_tool, with_small_head,
};

/// A check before the instrument of this station file.
fn at(station: &str, args: &[&str]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("station.toml");
    fs::write(&path, station).unwrap();
    let at = ["--link", "sim", "--station", path.to_str().unwrap()];
    inspect(&[&at, args].concat())
}

/// Runs [`at`] by the built-in demo's head: stages that state less leave the pose to the neighbours, which only it shows.
fn full_at(station: &str, args: &[&str]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("station.toml");
    fs::write(&path, station).unwrap();
    let at = ["--link", "sim", "--station", path.to_str().unwrap()];
    inspect_full(&[&at, args].concat())
}

/// The same, and what it says on its way.
fn told(station: &str) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("station.toml");
    fs::write(&path, station).unwrap();
    let mut command = flankscope();
    command.args(["inspect", "--json", "-", "--speed", "max"]);
    let at = ["--link", "sim", "--station", path.to_str().unwrap()];
    run(with_small_head(&mut command, &at))
}

const HEAD: &str = "[stages]\nmoves = \"head\"\n";

/// In a press the head turns before a die that stands still: the same die is go, and no-go where it is worn, left and right.
#[test]
fn a_head_that_turns_before_a_die_that_stands_still_finds_the_same_wear() {
    let sound = at(HEAD, &[]);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    for wear in flankscope_test_requisites::at_least(1, &["40:left:80", "12:right:80"]) {
        let worn = full_at(HEAD, &["--wear", wear]);
        assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
        let flank = wear.trim_end_matches(":80");
        assert_eq!(worn.not_go(), [format!("{flank}:no-go")]);
    }
}

#[test]
fn the_plan_says_how_long_and_what_bounds_it() {
    let slow = "[stages.rotation]\naxis = 1\nspeed_deg_s = 40\nacceleration_deg_s2 = 320\ntravel_deg = [-360, 360]\n\
        home_deg = 0\nhome_speed_deg_s = 40\nhome_at = \"switch\"\n";
    for (station, bound) in [("", "rotation"), (slow, "rotation")] {
        let run = told(station);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let plan = run.stderr.lines().find(|line| line.contains("plan: "));
        let plan = plan.unwrap_or_else(|| panic!("no plan: {}", run.stderr));
        assert!(plan.contains(&format!("bounded by {bound}")), "{plan}");
        let total_s: f64 = plan
            .split("plan: ")
            .nth(1)
            .and_then(|rest| rest.split(" s:").next()?.parse().ok())
            .unwrap();
        // From the first move to the last exposure, as the controller's clock has it; what the plan leaves out is the LED's rise and fall,
        // questions to the stages, and the way out (0.8 s).
        let timing = &run.json["timing_ms"];
        let took_s =
            (timing["positioning"].as_f64().unwrap() + timing["exposure"].as_f64().unwrap()) / 1e3;
        assert!((total_s - took_s).abs() < 1.5, "{plan}: {timing}");
    }
}

#[test]
fn what_the_axes_cannot_do_is_refused_before_anything_moves() {
    let axis = "axis = 1\nspeed_deg_s = 80\nacceleration_deg_s2 = 320\nhome_deg = 0\nhome_speed_deg_s = 80\nhome_at = \"switch\"\n";
    for (station, words) in [
        (
            format!("[stages.rotation]\n{axis}travel_deg = [-360, inf]\n"),
            "stages.rotation.travel_deg = inf: a finite number",
        ),
        (
            format!("[stages.rotation]\n{axis}travel_deg = [-400, 360]\n"),
            "stages.rotation.travel_deg = -400.0: -360 to 0 deg at the lower end",
        ),
        (
            format!("[stages.rotation]\n{axis}"),
            "missing field `travel_deg`",
        ),
        // Tooth 12 stands at 131 degrees: no axis of this travel turns so far.
        (
            format!("[stages.rotation]\n{axis}travel_deg = [-20, 20]\n"),
            "is outside",
        ),
        (
            "[stages]\nmoves = \"both\"\n".into(),
            "expected one of `die`, `head`, `outside`",
        ),
    ] {
        let run = at(&station, &[]);
        assert_eq!(run.code, 3, "{station}: {}", run.stderr);
        assert!(run.stderr.contains(words), "{station}: {}", run.stderr);
    }
}

/// A program that states poses: what the host asks for, a little beside it. `SPOIL` is what it does with each answer.
fn arm(folder: &std::path::Path, spoil: &str, limit_s: f64) -> String {
    let program = folder.join("arm.sh");
    // The pose comes back as it was asked for; a shell has no JSON, and needs none.
    let script = format!(
        "while read asked; do\n\
         view=$(echo \"$asked\" | sed 's/.*\"view\":\\([0-9]*\\).*/\\1/')\n\
         pose=$(echo \"$asked\" | sed 's/.*\"tool_from_camera\":\\(\\[\\[.*\\]\\]\\).*/\\1/')\n\
         u=0.02\n{spoil}\n\
         echo \"{{\\\"view\\\":$view,\\\"tool_from_camera\\\":$pose,\\\"u_mm\\\":$u,\\\"u_mrad\\\":0.3}}\"\ndone\n"
    );
    fs::write(&program, script).unwrap();
    format!(
        "[stages.poses]\ncommand = [\"sh\", \"{}\"]\nlimit_s = {limit_s}\n",
        program.display()
    )
}

/// Poses from outside: the right verdict by stated poses, and never a go by what is late, foreign, or none.
#[test]
fn a_program_says_where_the_camera_stands_or_nothing_is_go() {
    let folder = tempfile::tempdir().unwrap();
    let honest = arm(folder.path(), "", 20.0);
    let sound = at(&honest, &[]);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    let worn = full_at(&honest, &["--wear", "40:left:80"]);
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    let spoiled = [
        (
            "[ $view = 2 ] && sleep 3",
            1.0,
            "did not answer for view 2 within 1 s",
        ),
        ("[ $view = 2 ] && pose='[[NaN]]'", 20.0, "what is no answer"),
        (
            "[ $view = 2 ] && u=0",
            20.0,
            "u_mm = 0; right is more than 0",
        ),
        (
            "[ $view = 2 ] && view=3",
            20.0,
            "answered for view 3 when it was asked for view 2",
        ),
        (
            "[ $view = 2 ] && exit 1",
            20.0,
            "ended before it answered for view 2",
        ),
    ];
    for &(spoil, limit_s, words) in flankscope_test_requisites::at_least(2, &spoiled) {
        let run = at(&arm(folder.path(), spoil, limit_s), &[]);
        assert_eq!(run.code, 2, "{spoil}: {}", run.json["reason"]);
        let features = run.json["features"].as_array().unwrap();
        let why =
            |feature: &serde_json::Value| feature["reason"].as_str().unwrap_or_default().to_owned();
        assert!(
            features.iter().any(|of| why(of).contains(words)),
            "{spoil}: {features:?}"
        );
        // The second view of the tool file's is of tooth 40.
        assert_eq!(
            run.not_go()
                .iter()
                .filter(|of| of.starts_with("40:"))
                .count(),
            2,
            "{spoil}"
        );
    }
}

/// A watch asks the same program for every view of every check: each is judged by its pose, and a check that got none is none.
#[test]
fn a_watch_goes_by_the_program_s_poses_from_check_to_check() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Views are numbered on from check to check. The third question is answered for another view.
    let noted = folder.join("asked");
    let note = format!(
        "echo \"$view\" >> {}\n[ $view = 3 ] && view=9",
        noted.display()
    );
    let station = folder.join("station.toml");
    fs::write(&station, arm(folder, &note, 20.0)).unwrap();
    let mut command = flankscope();
    command.args(["watch", "--quiet", "--json", "-", "--speed", "10"]);
    command.args(["--every", "3", "--cycles", "19", "--teeth", "40"]);
    let at = ["--link", "sim", "--station", station.to_str().unwrap()];
    with_small_head(&mut command, &at);
    let watched = run(command.stdin(std::process::Stdio::null()));
    let checks = watched.json["checks"].as_array().unwrap();
    // After the first stroke and then after every third, however busy the machine is: the simulated press waits.
    assert!(checks.len() >= 6, "{} {}", checks.len(), watched.stderr);
    // One check has the wrong answer: the third, unless an earlier one asked more than once.
    let words = "answered for view 9 when it was asked for view 3";
    let mut refused = 0;
    for (number, check) in checks.iter().enumerate() {
        let inspection = &check["inspection"];
        let said = inspection["features"].to_string();
        if said.contains(words) {
            refused += 1;
            assert_eq!(inspection["verdict"], "indeterminate", "{said}");
        } else {
            assert_eq!(inspection["verdict"], "go", "{number}: {said}");
        }
    }
    assert_eq!(refused, 1);
    let asked = fs::read_to_string(&noted).unwrap();
    let asked: Vec<usize> = asked.lines().map(|line| line.parse().unwrap()).collect();
    assert!(asked.len() >= checks.len(), "{asked:?}");
    assert_eq!(asked, (1..=asked.len()).collect::<Vec<_>>());
}

/// What measures by the stages says so, instead of never asking for the poses; and what an arm may not do says why.
#[test]
fn commands_that_do_not_go_by_poses_refuse_them_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let station = folder.join("station.toml");
    let program = arm(folder, "touch started", 20.0);
    let carried = format!("[stages]\nmoves = \"outside\"\n{program}");
    let out = folder.join("head.toml");
    let calibrate = ["calibrate", "-o", out.to_str().unwrap()];
    let watch = ["watch", "--cycles", "1"];
    for (text, args, words) in [
        (
            &program,
            &["scan"][..],
            "a scan lays its views together by where",
        ),
        (
            &program,
            &calibrate,
            "a calibration finds the head's place on its stages by where",
        ),
        (&carried, &["scan"], "a scan turns the die on its table"),
        (
            &carried,
            &calibrate,
            "the controller claims the press for them alone",
        ),
        (
            &carried,
            &watch,
            "the controller claims the press for them alone",
        ),
        (
            &carried,
            &["view", "--captures", "1"],
            "the controller claims the press for them alone",
        ),
    ] {
        fs::write(&station, text).unwrap();
        let mut command = flankscope();
        command.args(args).args(["--link", "sim", "--station"]);
        let refused = run(command.arg(&station).current_dir(folder));
        assert_eq!(refused.code, 3, "{args:?}: {}", refused.stderr);
        assert!(
            refused.stderr.contains(words),
            "{args:?}: {}",
            refused.stderr
        );
        assert!(
            refused.stderr.contains("stages."),
            "{args:?}: {}",
            refused.stderr
        );
    }
    assert!(!folder.join("started").exists(), "nothing was asked");
}

/// The same arm where it carries the head: before it answers it puts the head where it was asked to, or where `astray` puts `$pose`.
fn carrying(folder: &std::path::Path, astray: &str, spoil: &str, limit_s: f64) -> String {
    let held = folder.join("held.json");
    let moved = format!(
        "held=\"$pose\"\n{astray}\necho \"$held\" > {0}.next; mv {0}.next {0}\n{spoil}",
        held.display()
    );
    format!(
        "[stages]\nmoves = \"outside\"\n{}",
        arm(folder, &moved, limit_s)
    )
}

/// What a bench file says of an arm whose pose is in this file.
fn held_at(file: &std::path::Path) -> String {
    format!("[stages]\narm = \"{}\"\n", file.display())
}

/// A check with an arm of this station's that holds the head on the bench.
fn by_arm(folder: &std::path::Path, station: &str, args: &[&str]) -> Run {
    let held = folder.join("held.json");
    let _ = fs::remove_file(&held);
    let [option, bench] = bench(&held_at(&held));
    full_at(station, &[&[&*option, &*bench], args].concat())
}

/// An arm carries the head, the stages stay at home: the right verdict where it was, and never a go where it was not.
#[test]
fn an_arm_carries_the_head_or_nothing_is_go() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let honest = carrying(folder, "", "", 20.0);
    let sound = by_arm(folder, &honest, &[]);
    assert_eq!(sound.code, 0, "{} {}", sound.json["reason"], sound.stderr);
    // The stages were told to stay at home, and went nowhere.
    let poses = sound.json["truth"]["poses"].as_array().unwrap();
    assert_eq!(poses.len(), 3, "{poses:?}");
    let worn = by_arm(folder, &honest, &["--wear", "40:left:80"]);
    assert_eq!(worn.code, 1, "{} {}", worn.json["reason"], worn.stderr);
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    let spoiled = [
        (
            "[ $view = 2 ] && sleep 3",
            1.0,
            "did not answer for view 2 within 1 s",
        ),
        ("[ $view = 2 ] && pose='[[NaN]]'", 20.0, "what is no answer"),
        (
            "[ $view = 2 ] && view=3",
            20.0,
            "answered for view 3 when it was asked for view 2",
        ),
    ];
    for &(spoil, limit_s, words) in flankscope_test_requisites::at_least(1, &spoiled) {
        let run = by_arm(folder, &carrying(folder, "", spoil, limit_s), &[]);
        assert_eq!(run.code, 2, "{spoil}: {}", run.json["reason"]);
        let reasons = run.json["features"].as_array().unwrap().iter();
        let reasons: Vec<_> = reasons.map(|of| of["reason"].to_string()).collect();
        assert!(
            reasons.iter().any(|of| of.contains(words)),
            "{spoil}: {reasons:?}"
        );
        let open = run.not_go();
        let open = open.iter().filter(|of| of.starts_with("40:"));
        assert_eq!(open.count(), 2, "{spoil}");
    }
}

/// It says that it stands where it was asked to, by 0.02 mm, and holds the head 0.6 mm beside at view 2: what is seen contradicts it.
#[test]
fn an_arm_that_is_elsewhere_than_it_says_is_contradicted_by_what_is_seen() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The fourth number of the first row.
    let astray = "[ $view = 2 ] && held=$(echo \"$pose\" | awk -F, '{ sub(/]/, \"\", $4); printf \"%s,%s,%s,%.9f]\", $1, $2, $3, $4 + 0.6; \
        for (i = 5; i <= NF; i++) printf \",%s\", $i; print \"\" }')";
    let run = by_arm(folder, &carrying(folder, astray, "", 20.0), &[]);
    assert_eq!(run.code, 2, "{} {}", run.json["reason"], run.stderr);
    let open = run.not_go();
    assert!(open.iter().all(|of| of.starts_with("40:")), "{open:?}");
    assert_eq!(open.len(), 2, "{open:?}");
}

/// What the bench's stages are is what the station says they are, or nothing moves.
#[test]
fn a_stage_that_answers_as_another_model_moves_nothing() {
    let named = |turns: &str, raises: &str| {
        format!(
            "[stages.rotation]\naxis = 1\n{turns}speed_deg_s = 80\nacceleration_deg_s2 = 320\ntravel_deg = [-360, 360]\n\
             home_deg = 0\nhome_speed_deg_s = 80\nhome_at = \"switch-and-index\"\n\
             [stages.vertical]\naxis = 2\n{raises}speed_mm_s = 100\nacceleration_mm_s2 = 800\ntravel_mm = [-150, 150]\n\
             home_mm = 100\nhome_speed_mm_s = 100\nhome_at = \"switch-and-index\"\n"
        )
    };
    let ours = named("model = \"URS150BCC\"\n", "model = \"IMS300V\"\n");
    let right = at(&ours, &["--teeth", "40"]);
    assert_eq!(right.code, 0, "{} {}", right.json["reason"], right.stderr);
    for (station, trouble, words) in [
        (
            &ours,
            "other-model",
            "axis 1 of the stages answers as \"URS100BPP, SN0001\", station.toml names \"URS150BCC\"",
        ),
        (
            &ours,
            "no-model",
            "axis 2 of the stages answers as \"Unknown\", station.toml names \"IMS300V\"",
        ),
    ] {
        let [option, bench] = bench(&format!("[stages]\ntrouble = \"{trouble}\"\n"));
        let run = at(station, &["--teeth", "40", &option, &bench]);
        assert_eq!(run.code, 3, "{}", run.stderr);
        assert!(run.stderr.contains(words), "{}", run.stderr);
    }
    // A station that names none works as before.
    let [option, other] = bench("[stages]\ntrouble = \"other-model\"\n");
    let unnamed = at(&named("", ""), &["--teeth", "40", &option, &other]);
    assert_eq!(unnamed.code, 0, "{}", unnamed.stderr);
    for (model, words) in [
        ("", "1 to 20 printable ASCII characters without a comma"),
        ("URS150BCC, SN0001", "stages.rotation.model"),
        ("A MODEL OF 21 LETTERS", "stages.rotation.model"),
    ] {
        let bad = at(&named(&format!("model = \"{model}\"\n"), ""), &[]);
        assert_eq!(bad.code, 3);
        assert!(bad.stderr.contains(words), "{}", bad.stderr);
    }
}

/// A table does the same for every view, and is refused whole where it lacks one.
#[test]
fn a_table_says_where_the_camera_stands_or_the_check_does_not_begin() {
    let folder = tempfile::tempdir().unwrap();
    let demo = std::path::Path::new(small_tool());
    let head = flankscope_profilometry::HeadModel::load(&demo.join("head.toml")).unwrap();
    let hand_eye = head.stage_from_camera.unwrap();
    let hand_eye = hand_eye
        .rigid::<flankscope_foundation::rigid::Stage, flankscope_foundation::rigid::Camera>()
        .unwrap();
    let tool = flankscope_metrology::tool::Tool::load(demo).unwrap();
    let views = flankscope_jobs::plan::ViewPlan::nominal(&tool, &[12, 40, 68]).unwrap();
    let table = |beside_mm: f64, rows: usize| {
        let mut text = String::from("tooth,x_mm,y_mm,z_mm,qw,qx,qy,qz,u_mm,u_mrad\n");
        for view in views.iter().take(rows) {
            let pose = flankscope_metrology::kinematics::tool_from_camera(
                view.rotation_rad,
                view.vertical_mm,
                hand_eye,
            );
            let (t, q) = (pose.isometry().translation.vector, pose.isometry().rotation);
            text += &format!(
                "{},{},{},{},{},{},{},{},0.02,0.3\n",
                view.tooth,
                t.x + beside_mm,
                t.y,
                t.z,
                q.w,
                q.i,
                q.j,
                q.k
            );
        }
        let path = folder.path().join("poses.csv");
        fs::write(&path, text).unwrap();
        format!("[stages.poses]\nfile = \"{}\"\n", path.display())
    };
    let worn = full_at(&table(0.0, 3), &["--wear", "40:left:80"]);
    assert_eq!(worn.not_go(), ["40:left:no-go"], "{}", worn.stderr);
    for (beside_mm, rows, words) in [
        (0.0, 2, "poses.csv has no pose of tooth 68"),
        (
            2.5,
            3,
            "is 2.500 mm and 0.0 mrad from where it was asked for",
        ),
    ] {
        let refused = at(&table(beside_mm, rows), &[]);
        assert_eq!(refused.code, 3, "{}", refused.stderr);
        assert!(refused.stderr.contains(words), "{}", refused.stderr);
    }
    let carried = format!("[stages]\nmoves = \"outside\"\n{}", table(0.0, 3));
    let held = folder.path().join("held.json");
    let [option, bench] = bench(&held_at(&held));
    let refused = at(&carried, &[&option, &bench]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(
        refused.stderr.contains("the next of 3 views"),
        "{}",
        refused.stderr
    );
    let nobody = at("[stages]\nmoves = \"outside\"\n", &[]);
    assert_eq!(nobody.code, 3);
    assert!(
        nobody.stderr.contains("[stages.poses]"),
        "{}",
        nobody.stderr
    );
}
