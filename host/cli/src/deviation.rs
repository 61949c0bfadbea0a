//! `flankscope deviation`: Signed distance of every point of a cloud to a CAD mesh.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use flankscope_metrology::deviation::{self, Order, Statistics};
use flankscope_metrology::io::points::Format;
use flankscope_metrology::surface::orientation::Orientation;
use flankscope_metrology::surface::{Surface, sampling};
use serde::Serialize;

use crate::geometry::{Cad, CadArgs, CloudReading, LoadedCloud, milliseconds, tell, write_file};
use crate::output::{Common, Outcome};

/// Compute the signed distance of every point of a cloud to a CAD mesh.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope deviation --cad die.stl --cloud aligned.ply -o deviation.ply --json -"
)]
pub struct Args {
    #[command(flatten)]
    cad: CadArgs,
    /// Cloud in CAD coordinates: PLY, arrays (.npz) or text with `x y z` per line.
    #[arg(long, value_name = "CLOUD")]
    cloud: PathBuf,
    #[command(flatten)]
    reading: CloudReading,
    /// Distance to the surface itself (exact, signed), or to the nearest of 100 000 random points on it (the article's, unsigned).
    #[arg(long, value_enum, default_value_t = Metric::Surface)]
    metric: Metric,
    /// Order of the Minkowski distance, a number from 1 on or inf, for `--metric nearest`.
    #[arg(long, value_name = "P", default_value_t = Order::Two)]
    order: Order,
    /// Write the cloud, points in their order, with `deviation` of every point in mm, as binary PLY, text (name.xyz) or arrays for NumPy (name.npz).
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq)]
enum Metric {
    Surface,
    Nearest,
}

#[derive(Serialize)]
struct Report {
    /// Whether the sign is defined, positive for proud material: not for sampled points, nor for a mesh without an outside.
    signed: bool,
    orientation: Orientation,
    /// Points of the file that were left out because a coordinate is not finite.
    points_not_finite: usize,
    #[serde(flatten)]
    statistics: Statistics,
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Elapsed {
    load: f64,
    prepare: f64,
    query: f64,
    write: f64,
}

/// Number of random surface points of `--metric nearest`: the article's.
const NEAREST_SAMPLES: usize = 100_000;

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    if args.metric == Metric::Surface && args.order != Order::Two {
        anyhow::bail!(
            "--order applies to --metric nearest; the distance to the surface is Euclidean (order 2)"
        );
    }
    let format = Format::of_cloud(&args.output)?;
    let start = Instant::now();
    let Cad { mesh, orientation } = args.cad.load(&args.common)?;
    let LoadedCloud { cloud, not_finite } = args.reading.load(&args.cloud, &args.common)?;
    let loaded = Instant::now();
    let cad = || args.cad.trouble();
    let (mut deviations, prepared) = match args.metric {
        Metric::Surface => {
            let surface = Surface::oriented(&mesh, &orientation).with_context(cad)?;
            let prepared = Instant::now();
            (deviation::deviations(&surface, &cloud.points), prepared)
        }
        Metric::Nearest => {
            let samples = sampling::sample(&mesh, NEAREST_SAMPLES, 0).with_context(cad)?;
            let tree = deviation::SampleTree::new(&samples).with_context(cad)?;
            let prepared = Instant::now();
            (tree.distances(&cloud.points, args.order), prepared)
        }
    };
    let signed = args.metric == Metric::Surface && orientation.unsigned.is_none();
    if !signed {
        for deviation in &mut deviations {
            *deviation = deviation.abs();
        }
    }
    let queried = Instant::now();
    let statistics = deviation::statistics(&deviations)
        .with_context(|| format!("cloud {} has no points", args.cloud.display()))?;
    write_file(&args.output, |out| {
        let columns = [("deviation", &deviations[..])];
        cloud.write(format, out, &columns)
    })?;
    let report = Report {
        signed,
        orientation,
        points_not_finite: not_finite,
        statistics,
        elapsed_ms: Elapsed {
            load: milliseconds(start, loaded),
            prepare: milliseconds(loaded, prepared),
            query: milliseconds(prepared, queried),
            write: milliseconds(queried, Instant::now()),
        },
    };
    args.common.write_json(&report)?;
    tell(&args.common, || {
        format!(
            "{} points: mean {:+.2} um, std {:.2} um, rms {:.2} um, 95 % within {:.2} um, max {:.2} um -> {}",
            statistics.count,
            1e3 * statistics.mean_mm,
            1e3 * statistics.std_mm,
            1e3 * statistics.rms_mm,
            1e3 * statistics.p95_abs_mm,
            1e3 * statistics.max_abs_mm,
            args.output.display()
        )
    });
    Ok(Outcome::Done)
}
