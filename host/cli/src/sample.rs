//! `flankscope sample`: Area-uniform random points on a CAD mesh.

use crate::output::{Common, Outcome};

/// Area-uniform random points on a CAD mesh.
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
