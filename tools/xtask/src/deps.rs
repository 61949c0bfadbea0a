//! The arrows between the rooms. A dependency that is not listed here fails the check, and so does a source file that one
//! room takes from another.

use std::path::{Component, Path, PathBuf};

use cargo_metadata::{DependencyKind, MetadataCommand};

/// A room is a crate's folder; beside it stand the rooms that it may depend on.
type Room = (&'static str, &'static [&'static str]);

const PROTOCOL: &str = "protocol";
const CONTROLLER: &str = "firmware/controller";
const PIN_WIRE: &str = "firmware/pin-wire";
const SIM: &str = "firmware/sim";
const STM32_BOARD: &str = "firmware/stm32-board";
const FRAMES: &str = "host/frames";
const CAMERA: &str = "host/camera";
const FOUNDATION: &str = "host/foundation";
const PROFILOMETRY: &str = "host/profilometry";
const GEOMETRY: &str = "host/geometry";
const METROLOGY: &str = "host/metrology";
const ARTICLE: &str = "host/article";
const INSTRUMENT: &str = "host/instrument";
const RECORD: &str = "host/record";
const JOBS: &str = "host/jobs";
const REPORT: &str = "host/report";
const PLANT: &str = "host/plant";
const FLEET: &str = "host/fleet";
const CLI: &str = "host/cli";
const PYTHON: &str = "host/python";
const BENCH: &str = "tools/bench";
const DEMO: &str = "tools/demo";
const CAMPAIGN: &str = "tools/campaign";
const STUDY: &str = "tools/study";
const GEAR_CAD: &str = "tools/gear-cad";
const TEST_REQUISITES: &str = "tools/test-requisites";
const TESTS: &str = "tests";
const EVERYTHING: &[&str] = &[
    PROTOCOL,
    CONTROLLER,
    PIN_WIRE,
    SIM,
    FRAMES,
    CAMERA,
    FOUNDATION,
    PROFILOMETRY,
    GEOMETRY,
    METROLOGY,
    ARTICLE,
    INSTRUMENT,
    RECORD,
    JOBS,
    REPORT,
    PLANT,
    CLI,
    BENCH,
    DEMO,
    STUDY,
    GEAR_CAD,
    TEST_REQUISITES,
    TESTS,
];

const ROOMS: &[Room] = &[
    (PROTOCOL, &[]),
    (CONTROLLER, &[PROTOCOL]),
    (PIN_WIRE, &[]),
    (SIM, &[PROTOCOL, CONTROLLER]),
    ("firmware/mps2-an386", &[PROTOCOL, CONTROLLER, PIN_WIRE]),
    (STM32_BOARD, &[PROTOCOL, CONTROLLER]),
    ("firmware/nucleo-h743zi", &[STM32_BOARD]),
    ("firmware/netduinoplus2-f405", &[STM32_BOARD]),
    (FRAMES, &[PROTOCOL]),
    (CAMERA, &[FRAMES, FOUNDATION]),
    (FOUNDATION, &[]),
    (PROFILOMETRY, &[FOUNDATION]),
    // Meshes and points: neither gears nor views.
    (GEOMETRY, &[FOUNDATION]),
    (METROLOGY, &[FOUNDATION, GEOMETRY]),
    // Views, CAD and poses in, figures out: neither instrument nor session folder.
    (ARTICLE, &[FOUNDATION, PROFILOMETRY, METROLOGY]),
    // Frames and time: neither verdicts nor what is stored.
    (
        INSTRUMENT,
        &[PROTOCOL, FRAMES, FOUNDATION, PROFILOMETRY, METROLOGY],
    ),
    // What is stored is opened without an instrument; a scan's document has the figures of the article's method, too.
    (RECORD, &[FOUNDATION, PROFILOMETRY, METROLOGY, ARTICLE]),
    (
        JOBS,
        &[
            PROTOCOL,
            FRAMES,
            FOUNDATION,
            PROFILOMETRY,
            METROLOGY,
            ARTICLE,
            INSTRUMENT,
            RECORD,
        ],
    ),
    (
        REPORT,
        &[FOUNDATION, PROFILOMETRY, METROLOGY, ARTICLE, RECORD],
    ),
    // What is stored, and the pages of it that the instrument draws, too: no instrument.
    (PLANT, &[FOUNDATION, METROLOGY, RECORD, REPORT]),
    // What is stored, of many stations.
    (FLEET, &[RECORD]),
    // The bench, and what takes the frames of its GigE camera, are separate processes; the command only embeds them, behind features.
    (
        CLI,
        &[
            FRAMES,
            FOUNDATION,
            PROFILOMETRY,
            METROLOGY,
            ARTICLE,
            INSTRUMENT,
            RECORD,
            JOBS,
            REPORT,
            BENCH,
            DEMO,
            CAMERA,
        ],
    ),
    // What it computes is what the command computes; nothing of the instrument.
    (PYTHON, &[FOUNDATION, PROFILOMETRY, METROLOGY]),
    // Nothing that decodes, registers or judges: a world that shares a formula with the instrument proves nothing. Of the foundation it
    // takes the choice of vector instructions.
    (
        BENCH,
        &[
            PROTOCOL, FRAMES, FOUNDATION, CONTROLLER, SIM, PIN_WIRE, GEAR_CAD,
        ],
    ),
    (
        DEMO,
        &[
            PROTOCOL,
            FRAMES,
            FOUNDATION,
            PROFILOMETRY,
            METROLOGY,
            INSTRUMENT,
            RECORD,
            JOBS,
            BENCH,
            GEAR_CAD,
        ],
    ),
    (
        CAMPAIGN,
        &[
            FOUNDATION,
            METROLOGY,
            PROFILOMETRY,
            INSTRUMENT,
            RECORD,
            JOBS,
        ],
    ),
    (STUDY, EVERYTHING),
    (GEAR_CAD, &[]),
    (TEST_REQUISITES, &[]),
    // Nothing depends on it by name: it takes the place of a crate that would not run.
    ("tools/no-bindgen", &[]),
    ("tools/xtask", EVERYTHING),
    (TESTS, EVERYTHING),
];

/// What tests alone may see beside that (`[dev-dependencies]`): the CAD of a specimen, made by a leaf that shares no formula
/// with what is tested; what lies outside of the repository, and what runs in which run; and the host's pairing of triggers and
/// frames, which the bench's fault campaign asks whether it takes a spoiled view. Nothing that ships gets an arrow by this.
const TESTS_ONLY: &[Room] = &[
    (CONTROLLER, &[TEST_REQUISITES]),
    (PROFILOMETRY, &[TEST_REQUISITES]),
    (GEOMETRY, &[TEST_REQUISITES]),
    (METROLOGY, &[GEAR_CAD, TEST_REQUISITES]),
    (FRAMES, &[TEST_REQUISITES]),
    (INSTRUMENT, &[TEST_REQUISITES]),
    (RECORD, &[TEST_REQUISITES]),
    (JOBS, &[TEST_REQUISITES]),
    // Histories that the instrument itself has written.
    (PLANT, &[TESTS, TEST_REQUISITES]),
    // Checks that nobody made.
    (FLEET, &[METROLOGY, TEST_REQUISITES]),
    (CLI, &[GEAR_CAD, TEST_REQUISITES]),
    (BENCH, &[INSTRUMENT, TEST_REQUISITES]),
    (DEMO, &[TEST_REQUISITES]),
];

/// What a deployment leaves out of the command.
const OPTIONAL: &[(&str, &str)] = &[(CLI, BENCH), (CLI, DEMO), (CLI, CAMERA)];

/// One dependency between rooms.
#[derive(Clone, Debug)]
struct Arrow {
    from: String,
    to: String,
    tests_only: bool,
    optional: bool,
}

/// Fails on the first dependency that the tables do not allow, on a crate that is in no room, on a bench that a deployment
/// could not leave out, and on a source file outside of the room that compiles it.
pub fn check(root: &Path) -> Result<(), String> {
    let mut arrows = 0;
    for folder in crates(root)? {
        for arrow in arrows_from(root, &folder)? {
            judge(&arrow)?;
            arrows += 1;
        }
        sources(&root.join(&folder), &root.join(&folder))?;
    }
    eprintln!("dependency arrows: {arrows} checked, all as designed");
    Ok(())
}

/// The folders of all crates, each of which must be a room of the table.
pub fn crates(root: &Path) -> Result<Vec<String>, String> {
    let mut found = Vec::new();
    for folder in ["protocol", "firmware", "host", "tools", "tests"] {
        find_crates(root, Path::new(folder), &mut found)?;
    }
    let missing = ROOMS
        .iter()
        .find(|(room, _)| !found.iter().any(|at| at == room));
    match missing {
        Some((room, _)) => Err(format!("{room} is a room of the table but no crate")),
        None => Ok(found),
    }
}

fn find_crates(root: &Path, folder: &Path, found: &mut Vec<String>) -> Result<(), String> {
    if root.join(folder).join("Cargo.toml").is_file() {
        let name = folder.to_string_lossy().into_owned();
        if !ROOMS.iter().any(|(room, _)| *room == name) {
            return Err(format!("{name} is in no room of the table"));
        }
        found.push(name);
        return Ok(());
    }
    for entry in entries(&root.join(folder))?.filter(|entry| entry.is_dir()) {
        let name = entry.file_name().unwrap_or_default();
        find_crates(root, &folder.join(name), found)?;
    }
    Ok(())
}

fn entries(folder: &Path) -> Result<impl Iterator<Item = PathBuf>, String> {
    let entries =
        std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    Ok(entries.flatten().map(|entry| entry.path()))
}

/// The dependencies of a crate on crates of this repository, of every kind (normal, dev, build, per target), as Cargo
/// reads them.
fn arrows_from(root: &Path, folder: &str) -> Result<Vec<Arrow>, String> {
    let manifest = root.join(folder).join("Cargo.toml");
    let metadata = MetadataCommand::new()
        .manifest_path(&manifest)
        .no_deps()
        .exec()
        .map_err(|error| format!("{}: {error}", manifest.display()))?;
    let mut arrows = Vec::new();
    let packages = metadata.packages.iter();
    for package in packages.filter(|package| package.manifest_path == manifest) {
        for dependency in &package.dependencies {
            let Some(path) = &dependency.path else {
                continue; // not of this repository
            };
            let to = path
                .strip_prefix(root)
                .map_or_else(|_| path.to_string(), |to| to.to_string());
            arrows.push(Arrow {
                from: folder.to_owned(),
                to,
                tests_only: dependency.kind == DependencyKind::Development,
                optional: dependency.optional,
            });
        }
    }
    Ok(arrows)
}

fn judge(arrow: &Arrow) -> Result<(), String> {
    let Arrow { from, to, .. } = arrow;
    let allows = |rooms: &[Room]| {
        rooms
            .iter()
            .any(|(room, allowed)| room == from && allowed.contains(&to.as_str()))
    };
    let allowed = allows(ROOMS) || (arrow.tests_only && allows(TESTS_ONLY));
    if !allowed {
        return Err(format!("{from} must not depend on {to}"));
    }
    if OPTIONAL.contains(&(from, to)) && !arrow.optional {
        return Err(format!(
            "{to} must stay optional in {from}: a deployment builds without it"
        ));
    }
    Ok(())
}

/// Fails on a `#[path]` in `folder` that leads out of `room`.
fn sources(room: &Path, folder: &Path) -> Result<(), String> {
    for path in entries(folder)? {
        if path.is_dir() {
            if path.file_name().is_some_and(|name| name != "target") {
                sources(room, &path)?;
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = std::fs::read_to_string(&path)
                .map_err(|error| format!("{}: {error}", path.display()))?;
            if let Some(out) = leads_out(room, &path, &text) {
                return Err(format!(
                    "{} compiles {out}, which is outside of {}: make it a crate that both may depend on",
                    path.display(),
                    room.display()
                ));
            }
        }
    }
    Ok(())
}

/// The first `#[path]` of a source file that leads out of a room.
fn leads_out<'a>(room: &Path, file: &Path, text: &'a str) -> Option<&'a str> {
    let paths = text.lines().filter_map(|line| {
        let path = line.trim().strip_prefix("#[path")?.trim_start();
        path.strip_prefix('=')?
            .trim_start()
            .strip_prefix('"')?
            .split('"')
            .next()
    });
    paths.into_iter().find(|path| {
        let mut at = file.parent().unwrap_or(room).to_path_buf();
        for part in Path::new(path).components() {
            match part {
                Component::ParentDir => drop(at.pop()),
                part => at.push(part),
            }
        }
        !at.starts_with(room)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrow(from: &str, to: &str) -> Arrow {
        Arrow {
            from: from.into(),
            to: to.into(),
            tests_only: false,
            optional: false,
        }
    }

    #[test]
    fn this_repository_is_as_designed() {
        check(&crate::root()).unwrap();
    }

    #[test]
    fn cargo_tells_every_kind_of_dependency() {
        let of = |folder: &str| arrows_from(&crate::root(), folder).unwrap();
        let to = |folder: &str, to: &str| of(folder).into_iter().find(|arrow| arrow.to == to);
        assert!(!to(INSTRUMENT, PROTOCOL).unwrap().tests_only);
        assert!(to(METROLOGY, GEAR_CAD).unwrap().tests_only);
        assert!(to(CLI, BENCH).unwrap().optional);
        assert!(
            to("firmware/mps2-an386", PIN_WIRE).is_some(),
            "another workspace"
        );
        assert!(of(PROTOCOL).is_empty());
    }

    #[test]
    fn arrows_that_nobody_designed_fail() {
        assert!(judge(&arrow(INSTRUMENT, PROTOCOL)).is_ok());
        for (from, to) in [
            (METROLOGY, PROFILOMETRY),
            (GEOMETRY, METROLOGY),
            (BENCH, GEOMETRY),
            (PROFILOMETRY, BENCH),
            (PROTOCOL, INSTRUMENT),
            (FRAMES, INSTRUMENT),
            (JOBS, BENCH),
            (BENCH, JOBS),
            (INSTRUMENT, RECORD),
            (RECORD, INSTRUMENT),
            (RECORD, FRAMES),
            (RECORD, JOBS),
            (ARTICLE, JOBS),
            (ARTICLE, INSTRUMENT),
            (JOBS, REPORT),
            (BENCH, METROLOGY),
            (BENCH, PROFILOMETRY),
            (BENCH, DEMO),
            (CONTROLLER, SIM),
            (CLI, STUDY),
            (PYTHON, JOBS),
            (FLEET, JOBS),
            (RECORD, FLEET),
            (JOBS, PYTHON),
            (CLI, "somewhere/else"),
        ] {
            assert!(judge(&arrow(from, to)).is_err(), "{from} to {to}");
        }
    }

    #[test]
    fn tests_may_see_more_and_a_deployment_less() {
        let in_tests = |from, to| Arrow {
            tests_only: true,
            ..arrow(from, to)
        };
        assert!(judge(&in_tests(METROLOGY, GEAR_CAD)).is_ok());
        assert!(judge(&arrow(METROLOGY, GEAR_CAD)).is_err());
        assert!(judge(&in_tests(PROFILOMETRY, GEAR_CAD)).is_err());
        assert!(judge(&arrow(CLI, BENCH)).is_err());
        let optional = Arrow {
            optional: true,
            ..arrow(CLI, BENCH)
        };
        assert!(judge(&optional).is_ok());
    }

    #[test]
    fn a_file_of_another_room_is_found() {
        let file = Path::new("/r/tools/bench/src/qemu/mod.rs");
        let found = |text| leads_out(Path::new("/r/tools/bench"), file, text);
        let foreign = "    #[path = \"../../../../firmware/image/src/wire.rs\"]\nmod wire;";
        assert_eq!(
            found(foreign),
            Some("../../../../firmware/image/src/wire.rs")
        );
        assert_eq!(found("#[path = \"../../tests/common/mod.rs\"]"), None);
        assert_eq!(
            found("#[path=\"../../../demo/src/lib.rs\"]"),
            Some("../../../demo/src/lib.rs")
        );
        assert_eq!(found("// ../../../../x.rs"), None);
    }
}
