//! `flankscope merge`: one cloud of several, one point per occupied voxel.

use std::path::{Path, PathBuf};
use std::time::Instant;

use flankscope_metrology::cloud::merge;
use flankscope_metrology::io::cloud::{Cloud, FinitePoints, SIGMA_PROPERTIES};
use flankscope_metrology::io::ply::{Extra, Scalar};
use flankscope_metrology::io::points::Format;
use serde::Serialize;

use crate::geometry::{CloudReading, LoadedCloud, milliseconds, sigma_of, tell, write_file};
use crate::output::{Common, Outcome};

/// Merge clouds: one point in each cube of a grid, the centroid of its points or the most certain of them.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope merge view-1.ply view-2.ply --voxel-mm 0.05 -o merged.ply --json -\n\n\
    The clouds must be in the same frame. --keep best is for views that overlap at different angles or exposures: a measured point\n\
    stays, with its uncertainty, and less certain ones do not pull at it. Colours and other properties are not merged."
)]
pub struct Args {
    /// Clouds in the same coordinates: PLY, arrays (.npz) or text with `x y z` per line.
    #[arg(required = true, value_name = "CLOUD")]
    clouds: Vec<PathBuf>,
    #[command(flatten)]
    reading: CloudReading,
    /// Edge of the cubes, counted from the smallest coordinates of all clouds.
    #[arg(long, value_name = "S")]
    voxel_mm: f64,
    /// The point of each cube: the mean of all, or the best, which is the one with the least uncertainty (sigma_z or sigma of its cloud),
    /// of equal ones the first.
    #[arg(long, value_enum, default_value_t = Keep::Mean)]
    keep: Keep,
    /// Write the merged cloud, as binary PLY, text (name.xyz) or arrays for NumPy (name.npz), in double precision if any of the clouds is.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(clap::ValueEnum, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Keep {
    Mean,
    Best,
}

#[derive(Serialize)]
struct Report {
    clouds: usize,
    points: usize,
    /// Points of the files that were left out because a coordinate is not finite.
    points_not_finite: usize,
    count: usize,
    keep: Keep,
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
    let mut sigma = Sigma::default();
    let mut points_not_finite = 0;
    for path in &args.clouds {
        let LoadedCloud { cloud, not_finite } = args.reading.load(path, &args.common)?;
        points_not_finite += not_finite;
        if args.keep == Keep::Best {
            sigma.append(&cloud, path)?;
        }
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
    let (kept, extras) = match args.keep {
        Keep::Mean => (merge::voxel_centroids(&points, args.voxel_mm)?, Vec::new()),
        Keep::Best => {
            let best = merge::voxel_best(&points, &sigma.of_points_mm, args.voxel_mm)?;
            let kept = best.iter().map(|&at| points[at as usize]).collect();
            (kept, vec![sigma.of_points(&best)])
        }
    };
    let merged = Instant::now();
    let (before, after) = (points.len(), kept.len());
    drop(points);
    let cloud = Cloud {
        points: FinitePoints::new(kept)?,
        coordinate,
        extras,
    };
    write_file(&args.output, |out| cloud.write(format, out, &[]))?;
    args.common.write_json(&Report {
        clouds: args.clouds.len(),
        points: before,
        points_not_finite,
        count: after,
        keep: args.keep,
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

/// Standard uncertainties of the points of all clouds.
#[derive(Default)]
struct Sigma {
    /// Property of the first cloud.
    name: String,
    of_points_mm: Vec<f32>,
}

impl Sigma {
    /// Appends those of a cloud.
    fn append(&mut self, cloud: &Cloud, path: &Path) -> anyhow::Result<()> {
        let (Some(property), Some(sigma_mm)) = (cloud.sigma_property(), sigma_of(cloud, path)?)
        else {
            anyhow::bail!(
                "cloud {} states no uncertainty of its points: --keep best needs the property {} in every cloud, as decode and scan --cloud \
                 write it into PLY and .npz; without it only --keep mean is possible",
                path.display(),
                SIGMA_PROPERTIES.join(" or ")
            );
        };
        if self.name.is_empty() {
            self.name.clone_from(&property.name);
        }
        self.of_points_mm.extend(sigma_mm);
        Ok(())
    }

    /// Those of some points, as a property.
    fn of_points(self, points: &[u32]) -> Extra {
        let sigma_mm = points.iter().map(|&at| self.of_points_mm[at as usize]);
        Extra {
            name: self.name,
            kind: Scalar::F32,
            bytes: sigma_mm.flat_map(f32::to_le_bytes).collect(),
        }
    }
}
