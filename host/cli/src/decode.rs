//! `flankscope decode`: Fringe images to a point cloud.

use crate::output::{Common, Outcome};

/// Fringe images to a point cloud.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    common: Common,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.common.write_json(&())?;
    Ok(Outcome::CouldNotRun)
}
