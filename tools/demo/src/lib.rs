//! The built-in demo as the files a user would write, in the instrument's own types: it sees both the bench and who measures.
//!
//! | folder | holds |
//! |---|---|
//! | a tool's | `die.ply`, `tool.toml`, `head.toml`, `cores.csv` ([`write_tool`]) |
//! | a target's | `target.toml`, and `head.toml` with the drawing's values ([`write_target`]) |
//! | captures | images of the target as another bench would have taken them ([`write_captures`]) |

mod captures;
mod files;
mod target;
mod tile;

use std::path::PathBuf;

pub use captures::{AROUND, TargetView, target_views, write_captures};
pub use files::{head, write_tool};
pub use target::{drawn_head, target, target_world, write_target};
pub use tile::{core_map, flat_field};

/// What the demo writes.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Write the demo tool's folder: CAD, tool.toml, head.toml.
    DemoTool {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
    },
    /// Write the demo calibration target's folder: target.toml, and head.toml with the drawing's values.
    DemoTarget {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
    },
    /// Write captures of the demo target as `calibrate --images` takes them: 22 views, 0.7 GB of images.
    DemoCaptures {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
        /// Seed of stage and plate errors, surface grain and noise.
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// The bench refuses what is photographed, or something cannot be written.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::DemoTool { out } => write_tool(out),
        Command::DemoTarget { out } => write_target(out),
        Command::DemoCaptures { out, seed } => {
            let target = target();
            let mut config = target_world(&target, *seed);
            config.run_seed = *seed;
            let views = target_views(&target, *seed, &AROUND);
            write_captures(out, &config, &views)
        }
    }
}
