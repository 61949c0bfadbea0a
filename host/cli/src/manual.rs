//! `flankscope manual`: man pages and shell completions, generated from the command definitions.

use std::path::PathBuf;

use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;

use crate::output::{Outcome, write_whole};

/// Write man pages and shell completions
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope manual --out manual\nwrites manual/man/*.1 and manual/completions"
)]
pub struct Args {
    /// Folder to write man/ and completions/ into
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let (man, completions) = (args.out.join("man"), args.out.join("completions"));
    for folder in [&man, &completions] {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    let mut command = crate::Cli::command();
    clap_mangen::generate_to(command.clone(), &man)
        .with_context(|| format!("cannot write {}", man.display()))?;
    for (shell, file) in [
        (Shell::Bash, "flankscope.bash"),
        (Shell::Zsh, "_flankscope"),
        (Shell::Fish, "flankscope.fish"),
    ] {
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut command, "flankscope", &mut script);
        write_whole(&completions.join(file), &script)?;
    }
    Ok(Outcome::Done)
}
