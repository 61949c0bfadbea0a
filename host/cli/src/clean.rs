//! `flankscope clean`: crops, denoises and thins a cloud.

use std::path::PathBuf;

use flankscope_metrology::cloud::{merge, outlier};
use flankscope_metrology::io::cloud::Cloud;
use flankscope_metrology::io::points::Format;
use serde::Serialize;

use crate::geometry::{CloudReading, LoadedCloud, numbers, tell, write_file};
use crate::output::{Common, Outcome};

/// Crop, denoise and thin a cloud; the points that stay keep their order and all of their properties.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope clean scan.ply --crop 30,45,-10,10,28,38 --denoise 20,2 --voxel-mm 0.05 -o clean.ply\n\n\
    What is asked for is done in that order: crop, denoise, thin."
)]
pub struct Args {
    /// Cloud: PLY, arrays (.npz) or text with `x y z` per line
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,
    #[command(flatten)]
    reading: CloudReading,
    /// Keep points with x from X0 to X1, y from Y0 to Y1 and z from Z0 to Z1, mm
    #[arg(long, value_name = "X0,X1,Y0,Y1,Z0,Z1", allow_hyphen_values = true, value_parser = numbers::<6>)]
    crop: Option<[f64; 6]>,
    /// Drop points whose mean distance to their K nearest neighbours exceeds the mean of all by more than S standard deviations
    #[arg(long, value_name = "K,S", value_parser = numbers::<2>)]
    denoise: Option<[f64; 2]>,
    /// Keep the first point in each cube of this edge, counted from the smallest coordinates
    #[arg(long, value_name = "S", conflicts_with = "share")]
    voxel_mm: Option<f64>,
    /// Keep this share of the points, evenly through the file
    #[arg(long, value_name = "P")]
    share: Option<f64>,
    /// Write the cloud: PLY (name.ply), text (name.xyz) or arrays for NumPy (name.npz)
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    common: Common,
}

#[derive(Serialize)]
struct Report {
    points: usize,
    /// Points of the file that were left out because a coordinate is not finite.
    points_not_finite: usize,
    count: usize,
    cropped: usize,
    outliers: usize,
    thinned: usize,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    args.check()?;
    args.common.try_json()?;
    let format = Format::of_cloud(&args.output)?;
    let LoadedCloud {
        mut cloud,
        not_finite,
    } = args.reading.load(&args.cloud, &args.common)?;
    let points = cloud.points.len();
    let stage = |kept: Option<Vec<bool>>, cloud: Cloud| match kept {
        Some(kept) => {
            let dropped = kept.iter().filter(|kept| !**kept).count();
            (dropped, cloud.keep(&kept))
        }
        None => (0, cloud),
    };
    let (cropped, outliers, thinned);
    (cropped, cloud) = stage(args.inside(&cloud), cloud);
    (outliers, cloud) = stage(args.near(&cloud), cloud);
    (thinned, cloud) = stage(args.thin(&cloud)?, cloud);
    let count = cloud.points.len();
    anyhow::ensure!(
        count > 0,
        "no point of {} is left: {cropped} of {points} lie outside --crop, {outliers} are outliers; nothing is written",
        args.cloud.display()
    );
    write_file(&args.output, |out| cloud.write(format, out, &[]))?;
    args.common.write_json(&Report {
        points,
        points_not_finite: not_finite,
        count,
        cropped,
        outliers,
        thinned,
    })?;
    tell(&args.common, || {
        format!(
            "{points} points: {cropped} outside, {outliers} outliers, {thinned} thinned out, {count} left -> {}",
            args.output.display()
        )
    });
    Ok(Outcome::Done)
}

impl Args {
    fn check(&self) -> anyhow::Result<()> {
        anyhow::ensure!(
            self.crop.is_some()
                || self.denoise.is_some()
                || self.voxel_mm.is_some()
                || self.share.is_some(),
            "nothing to do: name --crop, --denoise, --voxel-mm or --share"
        );
        if let Some([x0, x1, y0, y1, z0, z1]) = self.crop {
            let is_box = x0 < x1 && y0 < y1 && z0 < z1;
            anyhow::ensure!(
                is_box,
                "--crop holds no space: each first number must be below its second"
            );
        }
        if let Some([k, sigmas]) = self.denoise {
            let is_count = k.fract() == 0.0 && (1.0..=1000.0).contains(&k);
            anyhow::ensure!(
                is_count,
                "--denoise: {k} neighbours; a whole number from 1 to 1000 is right"
            );
            anyhow::ensure!(
                sigmas >= 0.0,
                "--denoise: {sigmas} standard deviations; 0 or more are right"
            );
        }
        if let Some(share) = self.share {
            anyhow::ensure!(
                share > 0.0 && share <= 1.0,
                "--share is {share}; above 0 and up to 1 is right"
            );
        }
        Ok(self.voxel_mm.map_or(Ok(()), merge::check_voxel_size)?)
    }

    fn inside(&self, cloud: &Cloud) -> Option<Vec<bool>> {
        let [x0, x1, y0, y1, z0, z1] = self.crop?;
        let ranges = [x0..=x1, y0..=y1, z0..=z1];
        let is_inside = |point: &[f64; 3]| (0..3).all(|k| ranges[k].contains(&point[k]));
        Some(cloud.points.iter().map(is_inside).collect())
    }

    fn near(&self, cloud: &Cloud) -> Option<Vec<bool>> {
        let [k, sigmas] = self.denoise?;
        Some(outlier::statistical(&cloud.points, k as usize, sigmas))
    }

    fn thin(&self, cloud: &Cloud) -> anyhow::Result<Option<Vec<bool>>> {
        let count = cloud.points.len();
        if let Some(share) = self.share {
            // Point number i stays where the count of those to keep grows.
            let before = |i: usize| (share * i as f64).floor();
            return Ok(Some(
                (0..count).map(|i| before(i + 1) > before(i)).collect(),
            ));
        }
        let Some(voxel_mm) = self.voxel_mm else {
            return Ok(None);
        };
        let mut kept = vec![false; count];
        for group in merge::voxel_groups(&cloud.points, voxel_mm)? {
            if let Some(&first) = group.first() {
                kept[first as usize] = true;
            }
        }
        Ok(Some(kept))
    }
}
