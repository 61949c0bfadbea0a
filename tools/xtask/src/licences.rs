//! Licences and sources of everything that is linked, by `deny.toml`, without a tool to install and without the internet: what
//! `cargo xtask deny` checks beside the advisories, which need their database.

use std::path::Path;

use cargo_metadata::{CargoOpt, MetadataCommand, Package};
use spdx::{Expression, Licensee};

/// The registry that crates may come from; a crate without a source is of this repository.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";
/// Every workspace that is built into something that runs: manifests, below the repository.
const WORKSPACES: [&str; 5] = [
    "Cargo.toml",
    "host/python/Cargo.toml",
    "firmware/mps2-an386/Cargo.toml",
    "firmware/nucleo-h743zi/Cargo.toml",
    "firmware/netduinoplus2-f405/Cargo.toml",
];

/// Fails on every crate whose licence is not among those allowed, or that comes from elsewhere than the registry.
pub fn check(root: &Path) -> Result<(), String> {
    let allowed = allowed(root)?;
    let mut crates = 0;
    let mut wrong = Vec::new();
    for manifest in WORKSPACES {
        let metadata = MetadataCommand::new()
            .manifest_path(root.join(manifest))
            .features(CargoOpt::AllFeatures)
            .other_options(["--locked".to_owned()])
            .exec()
            .map_err(|error| format!("{manifest}: {error}"))?;
        crates += metadata.packages.len();
        let judged = metadata.packages.iter().filter_map(|package| {
            let error = judge(package, &allowed).err()?;
            Some(format!(
                "{manifest}: {} {}: {error}",
                package.name, package.version
            ))
        });
        wrong.extend(judged);
    }
    if !wrong.is_empty() {
        return Err(wrong.join("\n       "));
    }
    eprintln!("licences and sources: {crates} crates checked, all allowed by deny.toml");
    Ok(())
}

/// `[licenses] allow` of `deny.toml`.
fn allowed(root: &Path) -> Result<Vec<Licensee>, String> {
    let text = std::fs::read_to_string(root.join("deny.toml"))
        .map_err(|error| format!("deny.toml: {error}"))?;
    let file: toml::Table = text
        .parse()
        .map_err(|error| format!("deny.toml: {error}"))?;
    let allow = file
        .get("licenses")
        .and_then(|licenses| licenses.get("allow")?.as_array())
        .ok_or("deny.toml: [licenses] allow is missing")?;
    let parse = |licence: &toml::Value| {
        let name = licence.as_str().unwrap_or_default();
        Licensee::parse(name).map_err(|error| format!("deny.toml: {name}: {error}"))
    };
    allow.iter().map(parse).collect()
}

fn judge(package: &Package, allowed: &[Licensee]) -> Result<(), String> {
    if let Some(source) = &package.source
        && source.repr != REGISTRY
    {
        return Err(format!("comes from {source}, not from {REGISTRY}"));
    }
    let text = package.license.as_deref().ok_or("states no licence")?;
    // Older crates separate alternatives by a slash, which is no SPDX expression.
    let expression = Expression::parse(&text.replace('/', " OR "))
        .map_err(|error| format!("licence {text}: {error}"))?;
    let satisfied = expression.evaluate(|needed| allowed.iter().any(|one| one.satisfies(needed)));
    match satisfied {
        true => Ok(()),
        false => Err(format!(
            "licence {text} is not among those that deny.toml allows"
        )),
    }
}
