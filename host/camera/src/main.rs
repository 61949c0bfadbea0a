//! `flankscope-camera`: the process between a camera and the host's shared memory.

use std::process::ExitCode;

use clap::Parser;
use flankscope_camera::command::{Camera, run};

/// Brings a camera's frames into the shared memory of a running `flankscope`, which starts this program by the command in
/// `[camera]` of its station.toml and adds the folder ROOT at the end.
#[derive(Parser)]
#[command(name = "flankscope-camera", version)]
struct Cli {
    #[command(subcommand)]
    camera: Camera,
}

fn main() -> ExitCode {
    match run(&Cli::parse().camera) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("flankscope-camera: {error:#}");
            ExitCode::from(3)
        }
    }
}
