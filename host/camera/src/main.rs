//! `flankscope-camera`: the process between a camera and the host's shared memory.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use flankscope_camera::command::{Camera, run};

/// Brings a camera's frames into the shared memory of a running `flankscope`, which starts this program by the command in
/// `[camera]` of its station.toml and adds the folder ROOT at the end.
#[derive(Parser)]
#[command(name = "flankscope-camera", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[command(flatten)]
    Camera(Camera),
    /// Write the man pages of this program
    Manual {
        /// Folder to write man/ into
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
}

fn manual(out: &Path) -> anyhow::Result<()> {
    let man = out.join("man");
    let cannot = || format!("cannot write {}", man.display());
    std::fs::create_dir_all(&man).with_context(cannot)?;
    clap_mangen::generate_to(Cli::command(), &man).with_context(cannot)
}

fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Camera(camera) => run(&camera),
        Command::Manual { out } => manual(&out),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("flankscope-camera: {error:#}");
            ExitCode::from(3)
        }
    }
}
