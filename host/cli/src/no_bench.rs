//! Replacement of the simulated bench in a build without it: no options, and a refusal.

use std::path::{Path, PathBuf};

use anyhow::bail;
use flankscope_frames::SharedRoot;
use flankscope_instrument::controller::ClientSettings;
use flankscope_instrument::settings::Stages;
use flankscope_record::origin::Link;

use crate::scene::Scene;

/// No options of a bench.
#[derive(clap::Args, Clone, Debug)]
pub struct BenchArgs {}

impl BenchArgs {
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        Ok(BenchSetup)
    }
}

/// No bench file.
#[derive(clap::Args, Clone, Debug)]
pub struct BenchFileArgs {}

impl BenchFileArgs {
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        Ok(BenchSetup)
    }
}

/// No options of a die.
#[derive(clap::Args, Clone, Debug)]
pub struct DieArgs {}

impl DieArgs {
    pub fn setup(&self) -> anyhow::Result<BenchSetup> {
        Ok(BenchSetup)
    }
}

/// No options of a press.
#[derive(clap::Args, Clone, Debug)]
pub struct WearRateArgs {}

/// No options of a camera.
#[derive(clap::Args, Clone, Debug)]
pub struct CameraArgs {}

/// No bench.
pub struct BenchSetup;

pub fn setup_with_camera(_: &DieArgs, _: &CameraArgs) -> anyhow::Result<BenchSetup> {
    Ok(BenchSetup)
}

pub fn setup_with_press(_: &DieArgs, _: &WearRateArgs) -> anyhow::Result<BenchSetup> {
    Ok(BenchSetup)
}

/// Seed of the random numbers that the host itself draws.
pub fn seed(_: &BenchSetup) -> u64 {
    1
}

/// A build without the bench has no such options, so nothing is refused.
pub fn fits_real_press(_: &BenchSetup, _: &Link) -> anyhow::Result<()> {
    Ok(())
}

/// A build without the bench has no such options, so nothing is refused.
pub fn fits_recording(_: &BenchSetup) -> anyhow::Result<()> {
    Ok(())
}

/// Empty, because there is no bench.
pub fn in_words(_: &BenchSetup) -> String {
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
        _: &BenchSetup,
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

    pub fn client_settings(&self) -> ClientSettings {
        match *self {}
    }

    pub fn finish(self) -> anyhow::Result<(serde_json::Value, Option<String>)> {
        match self {}
    }
}
