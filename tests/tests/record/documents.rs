//! The documentation agrees with the code: its links lead somewhere, and figures that have a source in the repository are read from
//! there and compared.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use flankscope_instrument::settings::StationSettings;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::Word;
use flankscope_profilometry::PatternSet;
use flankscope_profilometry::pattern::NAMED;
use flankscope_protocol::{Fault, FaultClass};
use flankscope_test_requisites::workspace;
use flankscope_tests::write_small_tool;

fn read(path: &str) -> String {
    std::fs::read_to_string(workspace().join(path))
        .unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// All files of the repository whose names end like this.
fn files(extension: &str) -> Vec<PathBuf> {
    fn walk(folder: &Path, wanted: &str, into: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let built = name == "target" || name.starts_with('.');
            if path.is_dir() && !built {
                walk(&path, wanted, into);
            } else if path
                .extension()
                .is_some_and(|extension| extension == wanted)
            {
                into.push(path);
            }
        }
    }
    let mut found = Vec::new();
    walk(workspace(), extension, &mut found);
    found.sort();
    found
}

/// Without what stands between code fences.
fn prose(text: &str) -> String {
    let mut fenced = false;
    let lines = text.lines().filter(|line| {
        let fence = line.trim_start().starts_with("```");
        fenced ^= fence;
        !fenced && !fence
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Anchors that GitHub gives to the headings of a page.
fn anchors(text: &str) -> BTreeSet<String> {
    let prose = prose(text);
    let headings = prose.lines().filter(|line| line.starts_with('#'));
    headings
        .map(|line| {
            let heading = line.trim_start_matches('#').trim().to_lowercase();
            let kept = heading.chars().filter_map(|c| match c {
                ' ' => Some('-'),
                '-' | '_' => Some(c),
                c => c.is_alphanumeric().then_some(c),
            });
            kept.collect()
        })
        .collect()
}

#[test]
fn every_link_leads_to_a_file_and_a_heading_that_exist() {
    let mut seen = 0;
    let mut dead = Vec::new();
    for page in files("md") {
        let text = std::fs::read_to_string(&page).unwrap();
        let prose = prose(&text);
        let links = prose.split("](").skip(1);
        for link in links.filter_map(|rest| rest.split(')').next()) {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.with_file_name("").join(file),
            };
            let found = target.exists()
                && (anchor.is_empty()
                    || anchors(&std::fs::read_to_string(&target).unwrap()).contains(anchor));
            if !found {
                dead.push(format!("{}: {link}", page.display()));
            }
            seen += 1;
        }
    }
    assert!(dead.is_empty(), "{dead:#?}");
    assert!(seen > 100, "{seen}");
}

/// Comments and messages refer to pages as `docs/camera.md`.
#[test]
fn every_page_that_a_source_names_exists() {
    let mut seen = 0;
    for source in files("rs") {
        let text = std::fs::read_to_string(&source).unwrap();
        for rest in text.split("docs/").skip(1) {
            let ends = |c: char| !c.is_ascii_alphanumeric() && !"/._-".contains(c);
            let page = rest.split(ends).next().unwrap().trim_end_matches('.');
            if page.ends_with(".md") {
                let there = workspace().join("docs").join(page).is_file();
                assert!(there, "{}: docs/{page}", source.display());
                seen += 1;
            }
        }
    }
    assert!(seen > 10, "{seen}");
}

/// A newcomer reads it in five minutes.
#[test]
fn the_readme_is_short() {
    let lines = read("README.md").lines().count();
    assert!(lines <= 110, "{lines}");
}

/// `| 0 | go |` and so on.
#[test]
fn the_readme_states_the_exit_code_of_every_verdict() {
    let readme = read("README.md");
    for word in Word::ALL {
        let row = format!("| {} | {word}", word.exit_code());
        assert!(readme.lines().any(|line| line.starts_with(&row)), "{row}");
    }
}

/// "1–31 concern the link, 32–95 stop the instrument, 96 and above limit it".
#[test]
fn the_ranges_of_fault_numbers_are_those_of_the_protocol() {
    let stated = |text: &str| {
        let from = text.find("1–31 concern").expect("the ranges");
        let words = text[from..].split(|c: char| !c.is_ascii_digit());
        let numbers = words.filter_map(|word| word.parse::<u8>().ok());
        numbers.take(5).collect::<Vec<_>>()
    };
    for page in ["docs/formats/doctor.md", "protocol/src/fault.rs"] {
        let numbers = stated(&read(page));
        let [first_link, last_link, first_stop, last_stop, first_limit] = numbers[..] else {
            panic!("{page}: {numbers:?}");
        };
        for fault in Fault::ALL {
            let range = match fault.class() {
                FaultClass::Link => first_link..=last_link,
                FaultClass::Stop => first_stop..=last_stop,
                FaultClass::Limit => first_limit..=u8::MAX,
            };
            assert!(range.contains(&fault.code().0), "{page}: {fault:?}");
        }
        assert_eq!((last_link + 1, last_stop + 1), (first_stop, first_limit));
    }
}

/// The budgets in `firmware/README.md` are those that `cargo xtask firmware` checks.
#[test]
fn the_budgets_of_the_firmware_are_those_that_are_checked() {
    let source = read("tools/xtask/src/firmware.rs");
    let page = read("firmware/README.md");
    for (constant, row) in [
        ("FLASH_BUDGET", "| flash | "),
        ("STATIC_RAM_BUDGET", "| static RAM | "),
        ("RAM_BYTES", "| static RAM and stack | "),
    ] {
        let declared = format!("const {constant}: u32 = ");
        let line = source.lines().find_map(|line| line.strip_prefix(&declared));
        let kib = line.and_then(|line| line.strip_suffix(" * 1024;"));
        let stated = page.lines().find_map(|line| line.strip_prefix(row));
        let stated = stated.and_then(|line| line.split(" KiB").next());
        assert!(
            kib.is_some() && kib == stated,
            "{constant}: {kib:?}, {stated:?}"
        );
    }
}

/// Periods, steps and frames of the built-in sets in `docs/formats/plan.md`.
#[test]
fn the_built_in_pattern_sets_are_those_of_the_page() {
    let page = read("docs/formats/plan.md");
    for (name, sets) in NAMED {
        let frequencies: Vec<_> = sets.iter().map(|(p, n)| format!("{p} x {n}")).collect();
        let frames = PatternSet::named(name).unwrap().frames_per_exposure();
        let row = format!("| `{name}` | {} | {frames} | ", frequencies.join(", "));
        assert!(page.lines().any(|line| line.starts_with(&row)), "{row}");
    }
}

/// The first TOML block of a page.
fn example(page: &str) -> String {
    let text = read(page);
    let block = text.split("```toml\n").nth(1).expect("a block");
    block.split("```").next().unwrap().to_owned()
}

/// What `docs/formats/station.md` shows are the defaults, as it says, but for names and files, which have none.
#[test]
fn the_station_file_of_the_page_has_the_defaults() {
    let text = example("docs/formats/station.md").replace("file = \"poses.csv\"", "# no table");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("station.toml");
    std::fs::write(&path, text).unwrap();
    let mut shown = StationSettings::load(&path).unwrap_or_else(|error| panic!("{error}"));
    let default = StationSettings::default();
    assert_ne!(shown, default);
    shown.name = None;
    shown.controller.link = None;
    shown.camera = default.camera.clone();
    shown.stages.poses = default.stages.poses.clone();
    shown.history.file = None;
    shown.report.folder = None;
    assert_eq!(shown, default);
}

/// What `docs/formats/tool.md` shows is a tool file of the demo die.
#[test]
fn the_tool_file_of_the_page_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let demo = folder.path().join("demo");
    write_small_tool(&demo);
    std::fs::write(demo.join("tool.toml"), example("docs/formats/tool.md")).unwrap();
    let tool = Tool::load(&demo).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(tool.inspected(), [12, 40, 68]);
}

/// Sum of the "N of M flanks" in the row of a table that begins so.
fn flanks_of_row(page: &str, begins: &str) -> [u32; 2] {
    let mut rows = page.lines().filter(|line| line.starts_with(begins));
    let row = rows.next().unwrap_or_else(|| panic!("no row: {begins}"));
    let counts = row.split('|').filter_map(|cell| {
        let (hits, rest) = cell.trim().split_once(" of ")?;
        let (all, _) = rest.split_once(" flanks")?;
        Some([hits, all].map(|n| n.parse::<u32>().expect("a count")))
    });
    counts.fold([0; 2], |sum, cell| [sum[0] + cell[0], sum[1] + cell[1]])
}

/// Against CAD and since a baseline together.
#[test]
fn the_study_in_short_states_the_counts_of_the_study() {
    let (short, study) = (read("docs/study/summary.md"), read("docs/study/README.md"));
    for (of_short, of_study) in [
        (
            "go at or beyond the stop limit",
            "go at or beyond the stop limit",
        ),
        (
            "go or warn at 3 µm or more beyond the stop limit",
            "go or warn beyond the stop limit by 3 µm or more",
        ),
        ("go beyond the warning limit", "go beyond the warning limit"),
        (
            "false alarm on an undamaged flank",
            "false alarm: warn or no-go of a flank without damage",
        ),
    ] {
        let [short, study] = [(&short, of_short), (&study, of_study)]
            .map(|(page, row)| flanks_of_row(page, &format!("| {row} |")));
        assert_eq!(short, study, "{of_short}");
    }
}

/// `**Cleanup.**` among the guarantees has a row `| Cleanup | ..` whose files and tests are there.
#[test]
fn every_guarantee_names_tests_that_exist() {
    let text = read("SECURITY.md");
    let section = |heading: &str| {
        let from = text.find(heading).expect("a heading");
        text[from + heading.len()..]
            .split("\n## ")
            .next()
            .unwrap_or_default()
    };
    let promised = section("\n## Guarantees\n").lines();
    let promised: Vec<&str> = promised
        .filter_map(|line| line.strip_prefix("**")?.split_once(".**"))
        .map(|(promise, _)| promise)
        .collect();
    let rows = section("\n## Tests\n").lines().filter_map(|line| {
        let mut cells = line.strip_prefix("| ")?.split(" | ");
        Some((cells.next()?, cells.next()?))
    });
    let rows: Vec<_> = rows.filter(|(what, _)| *what != "guarantee").collect();
    let tested: Vec<&str> = rows.iter().map(|(promise, _)| *promise).collect();
    assert_eq!(tested, promised);
    for (promise, tests) in rows {
        let (mut file, mut named) = (String::new(), 0);
        for word in tests.split('`').skip(1).step_by(2) {
            if word.ends_with(".rs") {
                file = read(word);
                // A file without test functions is a test as a whole.
                named += usize::from(!file.contains("#[test]"));
            } else if word.contains('_') {
                let lines: Vec<&str> = file.lines().map(str::trim_start).collect();
                let test = [&"#[test]", &&*format!("fn {word}() {{")];
                let there = lines.windows(2).any(|pair| pair.iter().eq(test));
                assert!(there, "{promise}: {word}");
                named += 1;
            }
        }
        assert!(named > 0, "{promise}");
    }
}
