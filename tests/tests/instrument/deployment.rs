//! What is installed beside the programs says what the programs understand.

use std::process::Command;

use flankscope_test_requisites::workspace;
use flankscope_tests::{flankscope, run};

fn deployed(name: &str) -> String {
    std::fs::read_to_string(workspace().join("tools/deploy").join(name)).unwrap()
}

fn help(command: &str) -> String {
    let output = flankscope().args([command, "--help"]).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn the_service_runs_commands_that_there_are() {
    let unit = deployed("flankscope@.service");
    let commands: Vec<&str> = unit
        .lines()
        .filter_map(|line| {
            line.strip_prefix("ExecStart")?
                .split_once("=/usr/bin/flankscope ")
        })
        .map(|(_, command)| command)
        .collect();
    assert_eq!(commands.len(), 2, "doctor, then watch");
    for command in commands {
        let (name, arguments) = command.split_once(' ').unwrap();
        let help = help(name);
        let options = arguments.split(' ').filter(|word| word.starts_with("--"));
        for option in options {
            assert!(help.contains(option), "{name} has no {option}");
        }
    }
    // Where systemd is there, it reads the unit as well.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flankscope@press.service");
    let here = std::env::current_exe().unwrap();
    std::fs::write(
        &file,
        unit.replace("/usr/bin/flankscope", here.to_str().unwrap()),
    )
    .unwrap();
    if let Ok(said) = Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(&file)
        .output()
    {
        let said = String::from_utf8_lossy(&said.stderr).into_owned();
        let ours: Vec<&str> = said
            .lines()
            .filter(|line| line.contains("flankscope@press.service:"))
            .collect();
        assert!(ours.is_empty(), "{ours:?}");
    }
}

/// The name that docs/hardware.md gives to the controller's port is the one that the installed rule makes, for the board that it names.
#[test]
fn the_documented_port_is_the_one_that_the_rule_names() {
    let rules = deployed("60-flankscope.rules");
    let rule = rules.replace("\\\n", " ");
    let rule = rule
        .lines()
        .find(|line| line.starts_with("SUBSYSTEM==\"tty\""));
    let rule = rule.expect("a rule for the board's serial port");
    let name = rule.split("SYMLINK+=\"").nth(1).unwrap();
    let name = name.split('"').next().unwrap();
    let (stem, serial) = name
        .split_once("$attr{serial}")
        .expect("by its serial number");
    assert_eq!(serial, "");
    // The ST-LINK of a NUCLEO-H743ZI2.
    assert!(rule.contains("ATTRS{idVendor}==\"0483\"") && rule.contains("374e"));
    let page = std::fs::read_to_string(workspace().join("docs/hardware.md")).unwrap();
    let link = page.lines().find(|line| line.starts_with("link = "));
    let said = link.and_then(|line| line.split('"').nth(1)).unwrap();
    let number = said
        .strip_prefix("/dev/")
        .and_then(|name| name.strip_prefix(stem));
    assert!(
        number.is_some_and(|number| !number.is_empty()),
        "{said}: {name}"
    );
    assert!(page.contains("tools/deploy/60-flankscope.rules"));
}

/// The buffers are as large as the camera's diagnosis asks for, for the largest frame.
#[test]
fn socket_buffers_hold_two_frames() {
    let conf = deployed("60-flankscope-sysctl.conf");
    let line = conf
        .lines()
        .find(|line| line.starts_with("net.core.rmem_max"))
        .unwrap();
    let bytes: u64 = line.split('=').nth(1).unwrap().trim().parse().unwrap();
    let frame = 2 * flankscope_frames::MAX_FRAME_PIXELS as u64;
    assert_eq!(bytes, (2 * frame).next_power_of_two());
}

#[test]
fn every_command_has_a_man_page_with_its_options_and_every_shell_knows_it() {
    let folder = tempfile::tempdir().unwrap();
    let made = run(flankscope().arg("manual").arg("--out").arg(folder.path()));
    assert_eq!(made.code, 0, "{}", made.stderr);
    let page = |name: &str| std::fs::read_to_string(folder.path().join("man").join(name)).unwrap();
    let all = page("flankscope.1");
    for command in [
        "inspect",
        "watch",
        "scan",
        "calibrate",
        "decode",
        "sample",
        "register",
        "deviation",
        "merge",
        "gear",
        "history",
        "replay",
        "trust",
        "doctor",
        "patterns",
        "article",
        "manual",
        "bench",
    ] {
        assert!(all.contains(command), "{command}");
        let own = page(&format!("flankscope-{command}.1")).replace("\\-", "-");
        let help = help(command);
        let options = help
            .split_whitespace()
            .filter(|word| word.starts_with("--"));
        for option in options.filter(|word| {
            word.len() > 2
                && word[2..]
                    .chars()
                    .all(|c| c.is_ascii_lowercase() || c == '-')
        }) {
            assert!(own.contains(option), "{command}: {option}");
        }
        // Options of every command, which its help names in one line.
        let common = ["--json", "--quiet", "--help"];
        let of_all = !["manual", "bench"].contains(&command);
        for option in common.iter().skip(if of_all { 0 } else { 2 }) {
            assert!(
                own.contains(&format!("{option}\\fR")),
                "{command}: {option}"
            );
        }
        for file in ["flankscope.bash", "_flankscope", "flankscope.fish"] {
            let script =
                std::fs::read_to_string(folder.path().join("completions").join(file)).unwrap();
            assert!(script.contains(command), "{file}: {command}");
        }
    }
}

/// Whatever the Debian package takes is there or is made by the lines that tools/deploy/README.md says, goes below /usr, and
/// leaves no file of tools/deploy out.
#[test]
fn the_debian_package_takes_what_there_is() {
    let asked = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args([
            "metadata",
            "--no-deps",
            "--offline",
            "--format-version",
            "1",
        ])
        .current_dir(workspace())
        .output()
        .unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&asked.stdout).unwrap();
    let mut packages = metadata["packages"].as_array().unwrap().iter();
    let package = packages.find(|p| p["name"] == "flankscope").unwrap();
    let deb = &package["metadata"]["deb"];
    let of_crate = workspace().join("host/cli");
    let manual = tempfile::tempdir().unwrap();
    let made = run(flankscope().arg("manual").arg("--out").arg(manual.path()));
    assert_eq!(made.code, 0, "{}", made.stderr);
    let bins = ["flankscope", "flankscope-camera"];
    let mut taken = Vec::new();
    for asset in deb["assets"].as_array().unwrap() {
        let part = |n: usize| asset[n].as_str().unwrap();
        let (source, target, mode) = (part(0), part(1), part(2));
        assert!(target.starts_with("usr/"), "{target}");
        if let Some(program) = source.strip_prefix("target/release/") {
            assert!(bins.contains(&program) && mode == "755", "{source}");
        } else if let Some(page) = source.strip_prefix("../../target/manual/") {
            let there = match page.strip_suffix("/*.1") {
                Some(folder) => manual.path().join(folder).join("flankscope.1"),
                None => manual.path().join(page),
            };
            assert!(there.is_file() && mode == "644", "{source}");
        } else {
            let there = source.replace("*.md", "README.md");
            assert!(of_crate.join(there).is_file() && mode == "644", "{source}");
        }
        taken.push(source.to_owned());
    }
    for entry in std::fs::read_dir(workspace().join("tools/deploy")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let asset = format!("../../tools/deploy/{name}");
        let other = ["README.md", "debian"].contains(&name.as_str());
        assert!(other || taken.contains(&asset), "{name} is in no package");
    }
    let licence = deb["license-file"][0].as_str().unwrap();
    let scripts = deb["maintainer-scripts"].as_str().unwrap();
    assert!(of_crate.join(licence).is_file());
    assert!(of_crate.join(scripts).join("postinst").is_file());
    // The lines that make what is packed are those of the README.
    let how = deployed("README.md");
    for line in [
        "manual --out target/manual",
        "cargo deb -p flankscope --no-build",
    ] {
        assert!(how.contains(line), "{line}");
    }
}
