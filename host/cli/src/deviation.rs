//! `flankscope deviation`: Signed distance of every point of a cloud to a CAD mesh.

use crate::output::{Common, Outcome};

/// Signed distance of every point of a cloud to a CAD mesh.
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
