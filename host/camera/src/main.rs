//! `flankscope-camera`: the process between a camera and the host's shared memory.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use flankscope_camera::backend::Folder;
use flankscope_camera::serve::serve;
use flankscope_frames::{FrameSender, Overflow, SharedRoot};

/// Brings a camera's frames into the shared memory of a running `flankscope`, which starts this program by the command in
/// `[camera]` of its station.toml and adds the folder ROOT at the end.
#[derive(Parser)]
#[command(name = "flankscope-camera", version)]
struct Cli {
    #[command(subcommand)]
    camera: Camera,
}

#[derive(Subcommand)]
enum Camera {
    /// A folder of images with a camera.toml (docs/camera.md): frames by a line on standard input each, or at a rate.
    Folder {
        /// The images.
        images: PathBuf,
        /// Folder of the host's shared memory.
        root: PathBuf,
    },
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("flankscope-camera: {error:#}");
            ExitCode::from(3)
        }
    }
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    let Camera::Folder { images, root } = &cli.camera;
    let mut sink = FrameSender::open(&SharedRoot::of_owner(root)?, Overflow::Drop)?;
    let mut camera = Folder::new(images);
    serve(&mut camera, &mut sink, &mut |words| {
        eprintln!("flankscope-camera: {words}")
    })?;
    Ok(())
}
