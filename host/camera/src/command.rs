//! Which camera, from the command line: `flankscope-camera`, and whoever embeds it.

use std::path::{Path, PathBuf};

use clap::Subcommand;
use flankscope_frames::{FrameSender, Overflow, SharedRoot};

use crate::backend::{Backend, Folder};
use crate::screen::Screen;
use crate::serve::serve;

/// A camera, and where its frames go.
#[derive(Subcommand)]
pub enum Camera {
    /// A GigE Vision or USB3 Vision camera
    #[cfg(feature = "aravis")]
    Aravis {
        /// Which one, and what it cannot say of itself
        #[command(flatten)]
        settings: crate::backend::Settings,
        /// Its network is that of this process
        #[arg(long, value_name = "PID", hide = true)]
        network_of: Option<u32>,
        /// Where the frames go
        #[command(flatten)]
        to: Destination,
    },
    /// A GigE Vision or USB3 Vision camera (not in this build)
    #[cfg(not(feature = "aravis"))]
    Aravis {
        /// What would follow
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        rest: Vec<String>,
    },
    /// A folder of images with a camera.toml (docs/camera.md): frames by a line on standard input each, or at a rate
    Folder {
        /// The images
        images: PathBuf,
        /// Where the frames go
        #[command(flatten)]
        to: Destination,
    },
}

/// Where the frames go.
#[derive(clap::Args)]
pub struct Destination {
    /// Try the camera without a host: show each frame and its counts in the terminal until standard input ends
    #[arg(long)]
    dry_run: bool,
    /// Folder of the host's shared memory
    #[arg(required_unless_present = "dry_run", conflicts_with = "dry_run")]
    root: Option<PathBuf>,
}

/// How to get the cameras that a build is without.
pub const WITHOUT_ARAVIS: &str = "this build has no GigE Vision and USB3 Vision cameras: apt-get install libaravis-dev \
    libusb-1.0-0-dev, then build it with --features aravis";

/// Serves the host with this camera until its standard input ends.
///
/// # Errors
/// The host's memory is not there, or the camera cannot be configured.
pub fn run(camera: &Camera) -> anyhow::Result<()> {
    match camera {
        #[cfg(feature = "aravis")]
        Camera::Aravis {
            settings,
            network_of,
            to,
        } => {
            // Before the first thread.
            network_of.map_or(Ok(()), crate::namespace::join)?;
            let wanted = standard_input_is_open();
            bring(
                &mut crate::backend::Aravis::new(settings.clone()),
                to.root.as_deref(),
                &wanted,
            )
        }
        #[cfg(not(feature = "aravis"))]
        Camera::Aravis { .. } => anyhow::bail!(WITHOUT_ARAVIS),
        // It reads its triggers from standard input, and ends with it.
        Camera::Folder { images, to } => {
            bring(&mut Folder::new(images), to.root.as_deref(), &|| true)
        }
    }
}

/// Whether standard input has not ended yet, for cameras that read nothing from it.
#[cfg(feature = "aravis")]
fn standard_input_is_open() -> impl Fn() -> bool {
    use std::io::{Read, stdin};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    let ended = Arc::new(AtomicBool::new(false));
    let end = Arc::clone(&ended);
    std::thread::spawn(move || {
        let _what_it_says = stdin().read_to_end(&mut Vec::new());
        end.store(true, Ordering::Release);
    });
    move || !ended.load(Ordering::Acquire)
}

fn bring(
    camera: &mut impl Backend,
    root: Option<&Path>,
    wants: &dyn Fn() -> bool,
) -> anyhow::Result<()> {
    let say = &mut |words: &str| eprintln!("flankscope-camera: {words}");
    match root {
        Some(root) => {
            let mut sink = FrameSender::open(&SharedRoot::of_owner(root)?, Overflow::Drop)?;
            serve(camera, &mut sink, wants, say)?;
        }
        None => serve(camera, &mut Screen::new(), wants, say)?,
    }
    Ok(())
}
