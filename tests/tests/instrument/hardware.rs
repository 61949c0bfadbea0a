//! The way of docs/hardware.md from parts to verdict: every step that needs no hardware is walked as it is written there, every other
//! one is at least understood.

use flankscope_test_requisites::{has_aravis, workspace};
use flankscope_tests::{flankscope, run};

fn blocks(text: &str, language: &str) -> Vec<String> {
    let begin = format!("```{language}\n");
    let blocks = text.split(&begin).skip(1);
    blocks
        .filter_map(|block| Some(block.split("```").next()?.to_owned()))
        .collect()
}

/// What a line's comment says will come of it: nothing here, or an exit code.
fn expected(comment: &str) -> Option<i32> {
    match comment.trim() {
        "at the press" => None,
        other => Some(other.strip_prefix("exit ").map_or(0, |code| {
            code.parse().unwrap_or_else(|_| panic!("# {comment}"))
        })),
    }
}

#[test]
fn every_step_that_needs_no_hardware_leads_where_it_says() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let text = std::fs::read_to_string(workspace().join("docs/hardware.md")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for file in blocks(&text, "toml") {
        let name = file.lines().next().and_then(|line| line.strip_prefix("# "));
        std::fs::write(folder.path().join(name.expect("a name")), &file).unwrap();
    }
    let (mut walked, mut understood) = (0, 0);
    for line in blocks(&text, "sh").iter().flat_map(|block| block.lines()) {
        let Some(line) = line.strip_prefix("flankscope ") else {
            continue;
        };
        let (words, comment) = line.split_once(" # ").unwrap_or((line, ""));
        let words: Vec<&str> = words.split_whitespace().collect();
        let Some(code) = expected(comment) else {
            let help = run(flankscope().args(&words).arg("--help"));
            assert_eq!(help.code, 0, "{line}: {}", help.stderr);
            understood += 1;
            continue;
        };
        if words.contains(&"gige") && !has_aravis() {
            continue;
        }
        let mut command = flankscope();
        command.args(&words).current_dir(folder.path());
        if words[0] == "inspect" && !words.contains(&"--station") {
            command.args(["--speed", "max"]);
        }
        let done = run(&mut command);
        assert_eq!(done.code, code, "{line}: {}", done.stderr);
        walked += 1;
    }
    assert!(walked >= 9 && understood >= 5, "{walked}, {understood}");
    for made in [
        "alpha.ply",
        "patterns/insitu12/patterns.json",
        "rehearsed.toml",
    ] {
        assert!(folder.path().join(made).is_file(), "{made}");
    }
}
