//! What stands in for the simulated bench in a build without it: no options, and a refusal.

use std::path::{Path, PathBuf};

use anyhow::bail;
use flankscope_frames::SharedRoot;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::{Stages, StationSettings};
use flankscope_record::origin::Link;

use crate::instrument::Scene;

/// No options of a bench.
#[derive(clap::Args, Clone, Debug)]
pub struct BenchArgs {}

/// No options of a press.
#[derive(clap::Args, Clone, Debug)]
pub struct PressArgs {}

/// No options of a die.
#[derive(clap::Args, Clone, Debug)]
pub struct DieArgs {}

/// No bench that `article` could scan on.
#[derive(clap::Args, Clone, Debug)]
pub struct ArticleBench {}

impl ArticleBench {
    pub fn args(&self) -> &BenchArgs {
        &BenchArgs {}
    }

    pub fn is_asked_for(&self) -> bool {
        false
    }

    pub fn scan(&self, _: [Option<&Path>; 2], _: &Path, _: bool) -> anyhow::Result<()> {
        bail!("this build has no simulated bench: name a scan's folder by --scan")
    }
}

/// Seed of what the host itself draws.
pub fn seed(_: &BenchArgs) -> u64 {
    1
}

/// A real press cannot be asked for anything else.
pub fn fits_real_press(_: &BenchArgs, _: &Link) -> anyhow::Result<()> {
    Ok(())
}

/// Recorded frames cannot be asked for anything else either.
pub fn fits_recording(_: &BenchArgs, _: Option<&DieArgs>) -> anyhow::Result<()> {
    Ok(())
}

/// Nothing stands on no bench.
pub fn in_words(_: &BenchArgs, _: &DieArgs) -> String {
    String::new()
}

pub fn demo_tool(_: &Path) -> anyhow::Result<PathBuf> {
    bail!("this build has no demo tool: name a folder with tool.toml and head.toml by --tool")
}

pub fn demo_target(_: &Path) -> anyhow::Result<PathBuf> {
    bail!("this build has no demo target: name a folder with target.toml and head.toml by --target")
}

/// A bench that never runs.
pub enum Bench {}

impl Bench {
    pub fn start(
        _: &BenchArgs,
        _: &Link,
        _: Scene<'_>,
        _: &Path,
        _: &SharedRoot,
        _: &Stages,
    ) -> anyhow::Result<Self> {
        bail!("this build has no simulated bench: name the controller's port by --link")
    }

    pub fn port(&self) -> &Path {
        match *self {}
    }

    pub fn client_settings(&self, _: &StationSettings) -> ClientSettings {
        match *self {}
    }

    pub fn finish(self) -> anyhow::Result<(serde_json::Value, Option<String>)> {
        match self {}
    }
}
