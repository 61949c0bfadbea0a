//! `flankscope doctor`: everything is looked at, nothing moves, and what has failed says what would be right.

use flankscope_protocol::Line;
use flankscope_tests::{Run, bench, expire, flankscope, inspect, press_tool, run};
use serde_json::Value;

fn doctor(arguments: &[&str]) -> Run {
    run(flankscope()
        .args(["doctor", "--quiet", "--json", "-"])
        .args(arguments))
}

fn finding<'a>(run: &'a Run, check: &str) -> &'a Value {
    let findings = run.json["findings"].as_array().expect("findings");
    let of = |finding: &&Value| finding["check"] == check;
    findings
        .iter()
        .find(of)
        .unwrap_or_else(|| panic!("{check}: {}", run.json))
}

fn expect(run: &Run, check: &str, health: &str, seen: &str, remedy: &str) {
    let finding = finding(run, check);
    assert_eq!(finding["health"], health, "{finding}");
    for (key, words) in [("seen", seen), ("remedy", remedy)] {
        let said = finding[key].as_str().unwrap_or_default();
        assert!(said.contains(words), "{words}: {finding}");
    }
}

#[test]
fn the_bench_is_healthy_and_says_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let history = folder.path().join("bench.db");
    let history = history.to_str().unwrap();
    let baseline = folder.path().join("new.json");
    let baseline = baseline.to_str().unwrap();
    let one_tooth = ["--teeth", "40", "--link", "sim"];
    let go = |more: &[&str]| {
        let check = inspect(&[&one_tooth[..], more].concat());
        assert_eq!(check.code, 0, "{} {}", check.json["reason"], check.stderr);
        check
    };
    go(&["--record-baseline", baseline, "--approaches", "3"]);
    let check = go(&["--baseline", baseline, "--history", history]);
    let healthy = doctor(&[
        "--link",
        "sim",
        "--history",
        history,
        "--station",
        "bench 1",
    ]);
    assert_eq!(healthy.code, 0, "{} {}", healthy.json, healthy.stderr);
    assert_eq!(healthy.json["healthy"], true);
    assert_eq!(healthy.json["station"], "bench 1");
    for check in [
        "program",
        "key",
        "tool",
        "controller",
        "press",
        "camera",
        "history",
        "repeatability",
        "shared memory",
        "disk",
        "clock",
    ] {
        expect(&healthy, check, "ok", "", "");
    }
    // Of the demo head nobody claims that it was calibrated.
    expect(
        &healthy,
        "head",
        "attention",
        "not calibrated",
        "flankscope calibrate",
    );
    // No station's file says which stages these should be.
    let answers = "axis 1 answers as \"URS150BCC, SN0001\"; axis 2 answers as \"IMS300V, SN0001\"";
    expect(&healthy, "stages", "attention", answers, "station.toml");
    let camera = &finding(&healthy, "camera")["figures"];
    assert_eq!(
        (&camera["model"], &camera["bits"]),
        (&"simulated camera".into(), &12.into())
    );
    let controller = &finding(&healthy, "controller")["figures"];
    assert_eq!(controller["baud"], Line::HOST.baud);
    assert_eq!(controller["firmware"], check.json["versions"]["firmware"]);
    assert_eq!(finding(&healthy, "history")["figures"]["checks"], 1);
    let id = finding(&healthy, "key")["figures"]["id"].as_str().unwrap();
    assert!(id.len() == 16, "{id}");

    let shown = flankscope().args(["doctor"]).output().unwrap();
    let table = String::from_utf8(shown.stdout).unwrap();
    assert_eq!(table.lines().count(), 11, "one line each: {table}");
}

/// Whatever is wrong is named with its remedy, beside everything else.
#[test]
fn what_has_failed_says_what_would_be_right() {
    let folder = tempfile::tempdir().unwrap();
    let tool = press_tool(&folder.path().join("die"));
    let nowhere = "/dev/flankscope-is-not-here";
    let absent = doctor(&["--link", nowhere, "--tool", &tool]);
    assert_eq!(absent.code, 3, "{}", absent.json);
    assert_eq!(absent.json["healthy"], false);
    expect(
        &absent,
        "controller",
        "failed",
        nowhere,
        "plug the controller in",
    );
    expect(&absent, "stages", "not_asked", "controller", "");
    expect(&absent, "tool", "ok", "demo die", "");
    expect(&absent, "head", "ok", "self-test due", "");

    // Without the camera's program the port is asked all the same.
    let station = folder.path().join("press.toml");
    let text =
        format!("[controller]\nlink = \"{nowhere}\"\n[camera]\ncommand = [\"no-such-camera\"]\n");
    std::fs::write(&station, text).unwrap();
    let blind = doctor(&["--station", station.to_str().unwrap(), "--tool", &tool]);
    assert_eq!(blind.code, 3, "{}", blind.json);
    expect(
        &blind,
        "controller",
        "failed",
        nowhere,
        "plug the controller in",
    );
    expect(
        &blind,
        "camera",
        "failed",
        "no-such-camera",
        "camera.command",
    );

    let bare = doctor(&["--link", nowhere]);
    assert_eq!(bare.code, 3);
    expect(&bare, "tool", "failed", "without --tool", "--tool DIR");
    expect(&bare, "head", "not_asked", "", "");
    expect(&bare, "shared memory", "ok", "", "");

    let head = folder.path().join("die/head.toml");
    expire(&head);
    let changed = doctor(&["--link", nowhere, "--tool", &tool]);
    expect(
        &changed,
        "head",
        "failed",
        "not believed",
        "flankscope trust",
    );
    let trusted = run(flankscope()
        .arg("trust")
        .arg(&head)
        .args(["--quiet", "--name", "tester"]));
    assert_eq!(trusted.code, 0, "{}", trusted.stderr);
    let expired = doctor(&["--link", nowhere, "--tool", &tool]);
    expect(
        &expired,
        "head",
        "failed",
        "expired after 2001-06-30",
        "flankscope calibrate",
    );

    let history = folder.path().join("no.db");
    std::fs::write(&history, "no history").unwrap();
    let broken = doctor(&["--link", "sim", "--history", history.to_str().unwrap()]);
    assert_eq!(broken.code, 3);
    expect(&broken, "history", "failed", "no.db", "");
    expect(&broken, "controller", "ok", "", "");

    let bad = doctor(&["--link", "sim", "--tool", folder.path().to_str().unwrap()]);
    assert_eq!(bad.code, 3);
    expect(&bad, "tool", "failed", "tool.toml", "docs/formats/tool.md");
    expect(&bad, "controller", "not_asked", "", "");
}

/// The stages say what they are; others than the station's are a failure, and so are ones that cannot say it.
#[test]
fn the_stages_say_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let station = folder.path().join("station.toml");
    let text = "[stages.vertical]\naxis = 2\nmodel = \"IMS300V\"\nspeed_mm_s = 100\nacceleration_mm_s2 = 800\n\
        travel_mm = [-150, 150]\nhome_mm = 100\nhome_speed_mm_s = 100\nhome_at = \"switch\"\n";
    let rotation = "[stages.rotation]\naxis = 1\nmodel = \"URS150BCC\"\nspeed_deg_s = 80\nacceleration_deg_s2 = 320\n\
        travel_deg = [-360, 360]\nhome_deg = 0\nhome_speed_deg_s = 80\nhome_at = \"switch\"\n";
    std::fs::write(&station, format!("{text}{rotation}")).unwrap();
    let station = station.to_str().unwrap();
    let right = doctor(&["--link", "sim", "--station", station]);
    expect(&right, "stages", "ok", "URS150BCC, SN0001", "");
    let figures = &finding(&right, "stages")["figures"];
    assert_eq!(figures["rotation"]["model"], "URS150BCC");
    assert_eq!(figures["vertical"]["answers_as"], "IMS300V, SN0001");
    assert_eq!(figures["homed"], false, "nothing moves");
    for (trouble, seen) in [
        ("other-model", "axis 1 answers as \"URS100BPP, SN0001\""),
        ("no-model", "axis 2 answers as \"Unknown\""),
    ] {
        let [option, bench] = bench(&format!("[stages]\ntrouble = \"{trouble}\"\n"));
        let other = doctor(&["--link", "sim", "--station", station, &option, &bench]);
        assert_eq!(other.code, 3);
        expect(&other, "stages", "failed", seen, "correct its model");
    }
}
