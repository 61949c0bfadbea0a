//! The arrows between the rooms. A dependency that is not listed here fails the check.

use std::path::Path;

/// A crate's folder, its name, and the crates of this workspace it may depend on.
type Room = (&'static str, &'static str, &'static [&'static str]);

const PROTOCOL: &str = "flankscope-protocol";
const CONTROLLER: &str = "flankscope-controller";
const SIM: &str = "flankscope-sim";
const FRAMES: &str = "flankscope-frames";
const PROFILOMETRY: &str = "flankscope-profilometry";
const METROLOGY: &str = "flankscope-metrology";
const STATION: &str = "flankscope-station";
const CLI: &str = "flankscope";
const BENCH: &str = "flankscope-bench";
const GEAR_CAD: &str = "flankscope-gear-cad";
const EVERYTHING: &[&str] = &[
    PROTOCOL,
    CONTROLLER,
    SIM,
    FRAMES,
    PROFILOMETRY,
    METROLOGY,
    STATION,
    CLI,
    BENCH,
    GEAR_CAD,
];

const ROOMS: &[Room] = &[
    ("protocol", PROTOCOL, &[]),
    ("firmware/controller", CONTROLLER, &[PROTOCOL]),
    ("firmware/sim", SIM, &[PROTOCOL, CONTROLLER]),
    (
        "firmware/mps2-an386",
        "flankscope-mps2-an386",
        &[PROTOCOL, CONTROLLER],
    ),
    (
        "firmware/nucleo-h743zi",
        "flankscope-nucleo-h743zi",
        &[PROTOCOL, CONTROLLER],
    ),
    ("host/frames", FRAMES, &[PROTOCOL]),
    ("host/profilometry", PROFILOMETRY, &[]),
    ("host/metrology", METROLOGY, &[]),
    (
        "host/station",
        STATION,
        &[PROTOCOL, FRAMES, PROFILOMETRY, METROLOGY],
    ),
    // The bench is a separate process; the command only embeds it, behind a feature.
    (
        "host/cli",
        CLI,
        &[FRAMES, PROFILOMETRY, METROLOGY, STATION, BENCH],
    ),
    ("tools/bench", BENCH, EVERYTHING),
    ("tools/gear-cad", GEAR_CAD, EVERYTHING),
    ("tools/xtask", "xtask", EVERYTHING),
    ("tests", "flankscope-tests", EVERYTHING),
];

/// What tests alone may see beside that (`[dev-dependencies]`): the CAD of a specimen, made by a leaf that shares no formula
/// with what is tested. Nothing that ships gets an arrow by this.
const TESTS_ONLY: &[(&str, &[&str])] = &[(METROLOGY, &[GEAR_CAD]), (CLI, &[GEAR_CAD])];

/// Fails on the first dependency that the tables do not allow, on a crate that is in no room, and on a bench that a
/// deployment could not leave out.
pub fn check(root: &Path) -> Result<(), String> {
    let mut arrows = 0;
    for &(folder, name, allowed) in ROOMS {
        let path = root.join(folder).join("Cargo.toml");
        let Ok(manifest) = std::fs::read_to_string(&path) else {
            if folder.starts_with("firmware/") {
                continue; // board images may follow later
            }
            return Err(format!("{} is missing", path.display()));
        };
        for dependency in workspace_dependencies(&manifest) {
            arrows += 1;
            let tests_only = TESTS_ONLY.iter().any(|(of, more)| {
                dependency.tests_only && *of == name && more.contains(&dependency.name.as_str())
            });
            if !allowed.contains(&dependency.name.as_str()) && !tests_only {
                return Err(format!(
                    "{name} must not depend on {}; it may on {allowed:?}",
                    dependency.name
                ));
            }
            if name == CLI && dependency.name == BENCH && !dependency.optional {
                return Err(
                    "the bench must stay optional in flankscope: a deployment builds without it"
                        .into(),
                );
            }
        }
    }
    for folder in ["protocol", "firmware", "host", "tools", "tests"] {
        check_known(root, Path::new(folder))?;
    }
    eprintln!("dependency arrows: {arrows} checked, all as designed");
    Ok(())
}

struct Dependency {
    name: String,
    optional: bool,
    tests_only: bool,
}

/// The dependencies on crates of this workspace, of every kind (normal, dev, build, per target).
fn workspace_dependencies(manifest: &str) -> Vec<Dependency> {
    let mut found = Vec::new();
    let (mut in_dependencies, mut tests_only) = (false, false);
    for line in manifest.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[') {
            let section = section.trim_end_matches(']');
            in_dependencies = section.ends_with("dependencies");
            tests_only = section.ends_with("dev-dependencies");
        } else if in_dependencies {
            let name = line
                .split(['=', '.', ' '])
                .next()
                .unwrap_or_default()
                .trim_matches('"');
            if EVERYTHING.contains(&name) {
                found.push(Dependency {
                    name: name.to_string(),
                    optional: line.contains("optional = true"),
                    tests_only,
                });
            }
        }
    }
    found
}

/// Every crate below `folder` must be in the table.
fn check_known(root: &Path, folder: &Path) -> Result<(), String> {
    if root.join(folder).join("Cargo.toml").is_file() {
        let known = ROOMS.iter().any(|(room, ..)| Path::new(room) == folder);
        return if known {
            Ok(())
        } else {
            Err(format!("{} is in no room of the table", folder.display()))
        };
    }
    let entries = std::fs::read_dir(root.join(folder))
        .map_err(|error| format!("{}: {error}", folder.display()))?;
    for entry in entries.flatten().filter(|entry| entry.path().is_dir()) {
        check_known(root, &folder.join(entry.file_name()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tree that follows the table, with one manifest replaced.
    fn tree(folder: &str, manifest: &str) -> Result<(), String> {
        let root = std::env::temp_dir().join(format!(
            "xtask-deps-{}-{}",
            std::process::id(),
            folder.replace('/', "-")
        ));
        let _ = std::fs::remove_dir_all(&root);
        for (room, ..) in ROOMS {
            std::fs::create_dir_all(root.join(room)).unwrap();
            std::fs::write(root.join(room).join("Cargo.toml"), "[dependencies]\n").unwrap();
        }
        std::fs::create_dir_all(root.join(folder)).unwrap();
        std::fs::write(root.join(folder).join("Cargo.toml"), manifest).unwrap();
        let result = check(&root);
        std::fs::remove_dir_all(&root).unwrap();
        result
    }

    #[test]
    fn forbidden_arrows_fail_whatever_the_kind() {
        assert!(
            tree(
                "host/station",
                "[dependencies]\nflankscope-protocol.workspace = true\n"
            )
            .is_ok()
        );
        assert!(
            tree(
                "host/metrology",
                "[dependencies]\nflankscope-profilometry.workspace = true\n"
            )
            .is_err()
        );
        assert!(
            tree(
                "host/profilometry",
                "[dev-dependencies]\nflankscope-bench = { workspace = true }\n"
            )
            .is_err()
        );
        assert!(
            tree(
                "protocol",
                "[target.'cfg(unix)'.dependencies]\nflankscope-station = { path = \"x\" }\n"
            )
            .is_err()
        );
        assert!(
            tree(
                "firmware/controller",
                "[build-dependencies]\n\"flankscope-sim\" = { path = \"x\" }\n"
            )
            .is_err()
        );
        assert!(
            tree(
                "host/cli",
                "[dependencies]\nflankscope-bench.workspace = true\n"
            )
            .is_err()
        );
        assert!(
            tree(
                "host/cli",
                "[dependencies]\nflankscope-bench = { workspace = true, optional = true }\n"
            )
            .is_ok()
        );
        assert!(tree("tools/stray", "[dependencies]\n").is_err());
        // A test may make its specimen, what it tests may not.
        let gear_cad = "dependencies]\nflankscope-gear-cad.workspace = true\n";
        assert!(tree("host/metrology", &format!("[dev-{gear_cad}")).is_ok());
        assert!(tree("host/metrology", &format!("[{gear_cad}")).is_err());
        assert!(tree("host/metrology", &format!("[build-{gear_cad}")).is_err());
        assert!(tree("host/profilometry", &format!("[dev-{gear_cad}")).is_err());
    }
}
