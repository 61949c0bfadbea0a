//! `cargo xtask pages`: how far the code has moved on since the pages with figures were made.

use std::path::Path;

use crate::git;

/// What decides about a verdict: from light to word, and the bench that it is tried on.
const VERDICT: &[&str] = &[
    "host/profilometry/src",
    "host/geometry/src",
    "host/metrology/src",
    "host/jobs/src",
    "tools/bench/src",
];
/// What is timed.
const SPEED: &[&str] = &[
    "host/frames/src",
    "host/profilometry/src",
    "host/geometry/src",
    "host/metrology/src",
    "host/jobs/src",
];
/// Pages with figures, and the folders whose code they speak for.
const PAGES: [(&str, &[&str]); 9] = [
    ("docs/study/README.md", VERDICT),
    ("docs/study/ground/README.md", VERDICT),
    ("docs/study/families.md", VERDICT),
    ("docs/study/press.md", VERDICT),
    ("docs/study/resolution.md", VERDICT),
    ("docs/study/ground/resolution.md", VERDICT),
    ("docs/study/scan.md", VERDICT),
    ("docs/heads.md", VERDICT),
    ("BENCHMARK.md", SPEED),
];
/// So many commits of that code a page may lack when a version is released.
const MOST_COMMITS: usize = 40;
/// Fewest digits by which a page names a commit.
const LEAST_DIGITS: usize = 7;

/// Tells of every page how many commits of its code it lacks; for a `release`, fails where these are too many.
pub fn check(root: &Path, release: bool) -> Result<(), String> {
    let mut old = Vec::new();
    for (page, code) in PAGES {
        let text =
            std::fs::read_to_string(root.join(page)).map_err(|error| format!("{page}: {error}"))?;
        let said = match commit_of(root, &text) {
            None => Err("names no commit of this repository's history".to_owned()),
            Some(commit) => match commits_since(root, &commit, code)? {
                lacking if lacking <= MOST_COMMITS => {
                    Ok(format!("{commit}, {lacking} commits ago"))
                }
                lacking => Err(format!(
                    "{commit}, {lacking} commits ago, of which {MOST_COMMITS} are allowed at a release"
                )),
            },
        };
        match said {
            Ok(said) => eprintln!("{page}: {said}"),
            Err(said) => {
                eprintln!("{page}: OLD: {said}");
                old.push(page);
            }
        }
    }
    match release && !old.is_empty() {
        true => Err(format!("made of older code: {}", old.join(", "))),
        false => Ok(()),
    }
}

/// The first commit that a page names.
fn commit_of(root: &Path, page: &str) -> Option<String> {
    let words = page.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .filter(|word| word.len() >= LEAST_DIGITS && word.bytes().all(|b| b.is_ascii_hexdigit()))
        .find(|word| git(root, &["cat-file", "-e", &format!("{word}^{{commit}}")]).is_ok())
        .map(ToOwned::to_owned)
}

/// Commits after that one which changed one of the folders.
fn commits_since(root: &Path, commit: &str, code: &[&str]) -> Result<usize, String> {
    let range = format!("{commit}..HEAD");
    let counted = git(
        root,
        &[&["rev-list", "--count", &range, "--"][..], code].concat(),
    )?;
    let number = counted.parse();
    number.map_err(|error| format!("git rev-list {range}: \"{counted}\": {error}"))
}
