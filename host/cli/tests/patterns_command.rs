//! `patterns` as a user runs it.

mod support;

use support::{assert_refused, flankscope, json};

#[test]
fn every_set_gets_images_for_the_heads_mirrors_and_a_manifest() {
    let folder = tempfile::tempdir().unwrap();
    let demo = flankscope(folder.path(), &["bench", "demo-tool", "--out", "die"]);
    assert!(demo.status.success());
    let args = [
        "patterns",
        "--head",
        "die/head.toml",
        "-o",
        "out",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let sets = json(&output);
    for (set, (name, patterns)) in [
        ("article8", 8),
        ("insitu12", 12),
        ("scan16", 16),
        ("high12", 12),
        ("high16", 16),
    ]
    .iter()
    .enumerate()
    {
        let manifest = &sets[set];
        assert_eq!(manifest["set"], *name);
        assert_eq!(manifest["patterns"].as_array().unwrap().len(), *patterns);
        assert_eq!(manifest["mirrors"]["columns"], 1024);
        assert_eq!(manifest["packing"], "grey");
        for picture in manifest["files"].as_array().unwrap() {
            let path = folder
                .path()
                .join("out")
                .join(name)
                .join(picture["file"].as_str().unwrap());
            let content = std::fs::read(path).unwrap();
            let blake3 = flankscope_foundation::files::hash(&content);
            assert_eq!(picture["blake3"], blake3);
        }
        assert!(
            folder
                .path()
                .join("out")
                .join(name)
                .join("patterns.json")
                .is_file()
        );
    }

    // A head with the DLP4500's mirrors: rows half as far apart as columns.
    let head = std::fs::read_to_string(folder.path().join("die/head.toml")).unwrap();
    let (camera, rest) = head.split_once("[projector]").unwrap();
    let (projector, poses) = rest.split_once("[projector_from_camera]").unwrap();
    let numbers = |key: &str, value: &str| {
        let line = projector
            .lines()
            .find(|line| line.starts_with(key))
            .unwrap();
        (line.to_owned(), format!("{key} = {value}"))
    };
    let mut diamond = projector.to_owned();
    for (from, to) in [
        numbers("width_px", "912"),
        numbers("height_px", "1140"),
        numbers("focal_px", "[2253.0, 4506.0]"),
        numbers("principal_px", "[455.5, 569.5]"),
    ] {
        diamond = diamond.replace(&from, &to);
    }
    let mirrors = "[mirrors]\narrangement = \"diamond\"\ncolumns = 912\nrows = 1140\n\n";
    let write = |projector: &str, mirrors: &str| {
        let text = format!("{camera}[projector]{projector}{mirrors}[projector_from_camera]{poses}");
        std::fs::write(folder.path().join("die/other.toml"), text).unwrap();
    };
    write(&diamond, mirrors);
    let args = [
        "patterns",
        "--head",
        "die/other.toml",
        "--set",
        "insitu12",
        "-o",
        "bmp",
        "--json",
        "-",
    ];
    let output = flankscope(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let manifest = &json(&output)[0];
    assert_eq!(manifest["packing"], "dlpc350");
    assert_eq!(manifest["files"].as_array().unwrap().len(), 4);
    assert_eq!(manifest["patterns"][4]["bit_planes"], "R7..R0");

    let refused = |args: &[&str], words: &[&str]| {
        let args = [&["patterns", "-o", "no"], args].concat();
        assert_refused(
            folder.path(),
            "patterns",
            &flankscope(folder.path(), &args),
            words,
        );
    };
    refused(
        &["--head", "die/head.toml", "--pack", "dlpc350"],
        &["912 x 1140 diamond", "1024 x 768"],
    );
    refused(&["--set", "insitu13"], &["insitu13", "scan16"]);
    // Mirrors that do not fit the lens, or not the projector.
    write(projector, mirrors);
    refused(&["--head", "die/other.toml"], &["mirrors.columns", "912"]);
    let square = diamond.replace("4506.0", "2253.0");
    write(&square, mirrors);
    refused(
        &["--head", "die/other.toml"],
        &["mirrors.arrangement", "twice"],
    );
    write(&diamond, &mirrors.replace("diamond", "hexagonal"));
    refused(&["--head", "die/other.toml"], &["hexagonal"]);
}
