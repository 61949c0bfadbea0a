//! `flankscope merge`: one cloud of several, one point per occupied voxel.

use std::path::PathBuf;
use std::time::Instant;

use flankscope_metrology::cloud::merge;
use flankscope_metrology::io::cloud::{Cloud, FinitePoints};
use flankscope_metrology::io::ply::Scalar;
use flankscope_metrology::io::points::Format;
use serde::Serialize;

use crate::geometry::{CloudUnit, load_cloud, milliseconds, tell, write_file};
use crate::output::{Common, Outcome};

/// Merge clouds: the points in each cube of a grid are replaced by their centroid.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope merge view-1.ply view-2.ply --voxel-mm 0.05 -o merged.ply --json -\n\n\
    The clouds must be in the same frame. Colours and other properties are not merged."
)]
pub struct Args {
    /// Clouds in the same coordinates: PLY, arrays (.npz) or text with `x y z` per line.
    #[arg(required = true, value_name = "CLOUD")]
    clouds: Vec<PathBuf>,
    #[command(flatten)]
    cloud_unit: CloudUnit,
    /// Edge of the cubes, counted from the smallest coordinates of all clouds.
    #[arg(long, value_name = "S")]
    voxel_mm: f64,
    /// Write the merged cloud, as binary PLY, text (name.xyz) or arrays for NumPy (name.npz), in double precision if any of the clouds is.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    clouds: usize,
    points: usize,
    count: usize,
    voxel_mm: f64,
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Elapsed {
    load: f64,
    merge: f64,
    write: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    merge::check_voxel_size(args.voxel_mm)?;
    let format = Format::of_cloud(&args.output)?;
    let start = Instant::now();
    let mut points: Vec<[f64; 3]> = Vec::new();
    let mut coordinate = Scalar::F32;
    for path in &args.clouds {
        let cloud = load_cloud(path, args.cloud_unit)?;
        if cloud.coordinate != Scalar::F32 {
            coordinate = Scalar::F64;
        }
        if points.is_empty() {
            points = cloud.points.into_inner();
        } else {
            points.extend_from_slice(&cloud.points);
        }
    }
    let loaded = Instant::now();
    let centroids = merge::voxel_centroids(&points, args.voxel_mm)?;
    let merged = Instant::now();
    let (before, after) = (points.len(), centroids.len());
    drop(points);
    let cloud = Cloud {
        points: FinitePoints::new(centroids)?,
        coordinate,
        extras: Vec::new(),
    };
    write_file(&args.output, |out| cloud.write(format, out, &[]))?;
    args.common.write_json(&Report {
        clouds: args.clouds.len(),
        points: before,
        count: after,
        voxel_mm: args.voxel_mm,
        elapsed_ms: Elapsed {
            load: milliseconds(start, loaded),
            merge: milliseconds(loaded, merged),
            write: milliseconds(merged, Instant::now()),
        },
    })?;
    tell(&args.common, || {
        format!(
            "{before} points of {} clouds: {after} in voxels of {} mm -> {}",
            args.clouds.len(),
            args.voxel_mm,
            args.output.display()
        )
    });
    Ok(Outcome::Done)
}
