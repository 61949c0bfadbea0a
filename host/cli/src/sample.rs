//! `flankscope sample`: Area-uniform random points on a CAD mesh.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_metrology::surface::sampling;
use serde::Serialize;

use crate::geometry::{Cad, CadArgs, milliseconds, tell, write_file};
use crate::output::{Common, Outcome};

/// Sample random points on a CAD mesh, uniformly by area.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope sample --cad die.stl --count 100000 --seed 1 -o alpha.ply"
)]
pub struct Args {
    #[command(flatten)]
    cad: CadArgs,
    /// Number of points.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,
    /// Seed; the same seed gives the same file.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// Points as binary PLY, text (name.xyz) or arrays for NumPy (name.npz).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    count: usize,
    seed: u64,
    triangles: usize,
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Elapsed {
    load: f64,
    sample: f64,
    write: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = Format::of_cloud(&args.output)?;
    let start = Instant::now();
    let Cad { mesh, .. } = args.cad.load(&args.common)?;
    let loaded = Instant::now();
    let points = sampling::sample(&mesh, args.count as usize, args.seed)
        .with_context(|| args.cad.trouble())?;
    let sampled = Instant::now();
    write_file(&args.output, |out| {
        PointFile::from_points(&points).write(format, out)
    })?;
    let report = Report {
        count: points.len(),
        seed: args.seed,
        triangles: mesh.triangles.len(),
        elapsed_ms: Elapsed {
            load: milliseconds(start, loaded),
            sample: milliseconds(loaded, sampled),
            write: milliseconds(sampled, Instant::now()),
        },
    };
    args.common.write_json(&report)?;
    tell(&args.common, || {
        format!(
            "{} points from {} triangles -> {}",
            report.count,
            report.triangles,
            args.output.display()
        )
    });
    Ok(Outcome::Done)
}
