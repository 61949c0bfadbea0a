//! The built-in demo as the files a user would write, in the instrument's own types: it sees both the bench and who measures.
//!
//! | folder | holds |
//! |---|---|
//! | a tool's | `die.ply`, `tool.toml`, `head.toml`, `cores.csv` ([`write_tool`]) |
//! | a target's | `target.toml`, and `head.toml` with the drawing's values ([`write_target`]) |
//! | both, for another head than the demo's | `optics.toml`, by which the bench has it ([`MadeHead`]) |
//! | captures | images of the target as another bench would have taken them ([`write_captures`]) |

mod captures;
mod files;
mod head;
mod target;
mod tile;

use std::path::PathBuf;

use flankscope_bench::files::MadeHead;

pub use captures::{TargetView, target_views, write_captures};
pub use files::write_tool;
pub use head::{head, head_of};
pub use target::{drawn_head, drawn_head_of, target, target_of, target_world, write_target};
pub use tile::{core_map, core_map_of, flat_field};

/// What the demo writes.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Write the demo tool's folder: CAD, tool.toml, head.toml.
    DemoTool {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
        /// Head that looks at it: 10mm, 20mm, liquid, small, twin, or an optics.toml; liquid@DPT or liquid@DPT,CELSIUS as driven [default: 20mm].
        #[arg(long, value_name = "NAME|FILE")]
        head: Option<MadeHead>,
    },
    /// Write the demo calibration target's folder: target.toml, and head.toml with the drawing's values.
    DemoTarget {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
        /// Head that is calibrated by it: 10mm, 20mm, liquid, small, twin, or an optics.toml; liquid@DPT or liquid@DPT,CELSIUS as driven [default: 20mm].
        #[arg(long, value_name = "NAME|FILE")]
        head: Option<MadeHead>,
    },
    /// Write captures of the demo target as `calibrate --images` takes them: 22 views, 0.7 GB of images.
    DemoCaptures {
        /// Folder to write into.
        #[arg(long, short)]
        out: PathBuf,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// The bench refuses what is photographed, or something cannot be written.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::DemoTool { out, head } => write_tool(out, head.as_ref()),
        Command::DemoTarget { out, head } => write_target(out, head.as_ref()),
        Command::DemoCaptures { out } => {
            /// Seed of stage and plate errors, surface grain and noise.
            const SEED: u64 = 1;
            let target = target();
            let mut config = target_world(&target, SEED);
            config.run_seed = SEED;
            let views = target_views(&target, SEED, &target.beside);
            write_captures(out, &config, &views)
        }
    }
}
