//! `cargo xtask study` at work: captures, judges, and writes the page.

use clap::Parser;

/// Measure how often the verdict is right; write tables and plots.
#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    study: flankscope_study::Args,
}

fn main() -> anyhow::Result<()> {
    flankscope_study::run(&Cli::parse().study)
}
