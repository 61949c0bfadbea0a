//! The commands of README, documentation and every `--help` exist, with options and values that are understood; those of the
//! README's beginning are run.

use flankscope_test_requisites::{has_aravis, workspace};
use flankscope_tests::{flankscope, run};

/// Arguments of a line's `flankscope`, and of the README's `cargo run` instead of it; without what a shell takes for a comment or a
/// redirection.
fn arguments(line: &str) -> Option<Vec<String>> {
    let line = line.split(" #").next()?.split(" > ").next()?.trim();
    let prefixes = ["cargo run --release -- ", "flankscope "];
    let arguments = prefixes
        .iter()
        .find_map(|prefix| line.strip_prefix(prefix))?;
    Some(arguments.split_whitespace().map(Into::into).collect())
}

/// Standard output of a run.
fn said(arguments: &[&str]) -> String {
    let output = flankscope().args(arguments).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

/// Help is wrapped at 100 columns: a line to which the next one's first word would not have been added goes on there.
fn unwrapped(help: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut wide = 0;
    for line in help.lines() {
        let word = line.split_whitespace().next().map_or(0, str::len);
        match lines.last_mut() {
            Some(last) if word > 0 && wide > 0 && wide + 1 + word > 100 => {
                *last += " ";
                *last += line.trim();
            }
            _ => lines.push(line.to_owned()),
        }
        wide = line.len();
    }
    lines
}

/// Arguments are read in order, and `--help` behind them ends well only where all before it are understood.
#[track_caller]
fn is_understood(arguments: &[String], line: &str) {
    let mut command = flankscope();
    let said = run(command.args(arguments).arg("--help"));
    assert_eq!(said.code, 0, "{line}: {}", said.stderr);
}

/// Lines of a page's shell blocks.
fn shell_lines(page: &str) -> Vec<String> {
    let text = std::fs::read_to_string(workspace().join(page)).unwrap();
    let blocks = text.split("```sh\n").skip(1);
    let lines = blocks.filter_map(|block| block.split("```").next());
    lines.flat_map(str::lines).map(Into::into).collect()
}

#[test]
fn every_command_of_the_documentation_is_understood() {
    let pages = [
        "README.md",
        "docs/commands.md",
        "docs/guide.md",
        "docs/hardware.md",
        "docs/heads.md",
        "docs/study/scan.md",
    ];
    let lines: Vec<_> = pages.iter().flat_map(|page| shell_lines(page)).collect();
    let ours: Vec<_> = lines
        .iter()
        .filter_map(|line| Some((line, arguments(line)?)))
        .filter(|(line, _)| has_aravis() || !line.contains("gige"))
        .collect();
    assert!(ours.len() >= 40, "{lines:?}");
    for (line, arguments) in ours {
        is_understood(&arguments, line);
    }
    let tasks = std::fs::read_to_string(workspace().join("tools/xtask/src/main.rs")).unwrap();
    for task in lines
        .iter()
        .filter_map(|line| line.strip_prefix("cargo xtask "))
    {
        let task = task.split_whitespace().next().unwrap();
        assert!(
            tasks.contains(&format!("\n  {task} ")),
            "cargo xtask {task}"
        );
    }
}

#[test]
fn every_example_of_a_help_text_is_understood() {
    let all = said(&["--help"]);
    let commands = all
        .split("Commands:")
        .nth(1)
        .unwrap()
        .split("\n\n")
        .next()
        .unwrap();
    let commands = commands.lines().filter_map(|line| {
        let name = line.strip_prefix("  ")?.split(' ').next()?;
        (!name.is_empty() && name != "help").then_some(name)
    });
    let mut examples = 0;
    for command in commands {
        let help = said(&[command, "--help"]);
        let before = examples;
        for line in unwrapped(&help).iter().map(|line| line.trim()) {
            if let Some(arguments) = arguments(line).filter(|_| line.starts_with("flankscope ")) {
                is_understood(&arguments, line);
                examples += 1;
            }
        }
        assert!(examples > before, "{command} has no example");
    }
    assert!(examples >= 15, "{examples}");
}

/// A newcomer's first steps: a check, a worn one with its page, a history, its page, a replay.
#[test]
fn the_readme_s_first_steps_lead_where_it_says() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let steps = [("inspect", 3), ("watch", 2), ("history", 1), ("replay", 1)];
    for (name, count) in steps {
        let lines = shell_lines("README.md");
        let ours = lines
            .iter()
            .filter_map(|line| arguments(line))
            .filter(|a| a[0] == name);
        // Lines without a calibration and an emulator; of watches the one that keeps a history.
        let ours = ours.filter(|a| {
            !["--head", "qemu"]
                .iter()
                .any(|far| a.iter().any(|word| word == far))
        });
        let ours = ours.filter(|a| name != "watch" || a.iter().any(|word| word == "--history"));
        for mut arguments in ours.take(count) {
            // A press that runs as fast as the machine does not wait for anybody: a watch keeps its speed.
            if name == "inspect" {
                arguments.extend(["--speed".into(), "max".into()]);
            }
            let mut command = flankscope();
            let done = run(command.args(&arguments).current_dir(folder.path()));
            let expected: &[i32] = match arguments.join(" ").contains("40:left:80") {
                true => &[1],
                // A wear of 48 µm on all left flanks at the end of the watch, warned of.
                false if name == "watch" => &[0, 1, 2, 4],
                false => &[0],
            };
            assert!(
                expected.contains(&done.code),
                "{arguments:?}: {} {}",
                done.code,
                done.stderr
            );
        }
    }
    for page in ["out/report.html", "out/index.html", "out/history.html"] {
        assert!(folder.path().join(page).is_file(), "{page}");
    }
}
