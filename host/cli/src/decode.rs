//! `flankscope decode`: fringe images to a point cloud.

use std::io::{self, Write};
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use flankscope_foundation::npz::NpzWriter;
use flankscope_foundation::order::median_of;
use flankscope_metrology::io::ply::{Column, Scalar};
use flankscope_metrology::io::points::{Format, PointFile};
use flankscope_profilometry::counts::{CountRange, CountSource};
use flankscope_profilometry::decode::{
    Cloud, ConsistencyOptions, DecodeOptions, Decoder, LightMedians, LightParts, PatchOptions,
    PhaseMaps, Rejected,
};
use flankscope_profilometry::frame_order;
use flankscope_profilometry::head::HeadModel;
use flankscope_profilometry::plan::Plan;
use serde::Serialize;

use crate::grid::Grid;
use crate::output::{Common, Outcome, say};

/// Compute a point cloud from fringe images.
///
/// Reads grey PNG, TIFF or PGM images of one view, decodes them as the plan says and writes a binary PLY in the camera frame, in mm,
/// with the predicted standard uncertainty of the depth at every point (property sigma_z).
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  flankscope decode --images frames --plan PLAN.toml --head calibration.xml -o cloud.ply --json -\n\nThe formats of PLAN.toml and head.toml are described in docs/formats."
)]
pub struct Args {
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Patterns, exposures and image names.
    #[arg(long, value_name = "PLAN.toml")]
    plan: PathBuf,
    /// head.toml, or an OpenCV calibration (XML or YAML with Kc kc Kp kp Rp Tp).
    #[arg(long, value_name = "FILE")]
    head: PathBuf,
    /// Write the cloud here: binary PLY, text (name.xyz) or arrays for NumPy (name.npz).
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Which of two projectors showed the patterns.
    #[arg(long, value_name = "1|2", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    projector: u8,
    /// Decode blocks of pixels, or the cores of the head's map [default: cores if there is a map].
    #[arg(long, value_enum, value_name = "GRID")]
    grid: Option<Grid>,
    /// Gaussian smoothing of the finest fringes' phasors, sigma in camera pixels [default: 0.7, cores 0]. Coarser fringes, which only
    /// count the finest ones, are smoothed by 2 pixels; 0 smooths neither.
    #[arg(long, value_name = "PIXELS")]
    smooth: Option<f64>,
    /// Least contrast (amplitude over mean) of every frequency.
    #[arg(long, value_name = "RATIO", default_value_t = DecodeOptions::IMAGE_CONTRAST)]
    min_contrast: f64,
    /// Least amplitude of every frequency, in counts per pixel and exposure [default: the least at which rounding and read noise
    /// cannot change the fringe order, min_modulation_dn in the JSON].
    #[arg(long, value_name = "DN")]
    min_modulation: Option<f64>,
    /// Drop cells whose frames deviate from a sinusoid by more than noise does with this probability; 0 keeps all [default: 0.001
    /// where plan or head have a `[sensor]`].
    #[arg(long, value_name = "PROBABILITY")]
    frame_consistency: Option<f64>,
    /// Drop points with a larger predicted standard uncertainty of the depth.
    #[arg(long, value_name = "MM")]
    max_sigma: Option<f64>,
    /// Drop patches of fewer connected cells; 0 keeps all.
    #[arg(long, value_name = "CELLS", default_value_t = DecodeOptions::IMAGE_PATCH)]
    min_patch: usize,
    /// Also write direct and indirect light at every point (properties direct and global, in electrons).
    #[arg(long)]
    light_parts: bool,
    /// Also write phase, modulation, mean, fringe order, projector column and depth of every cell, as arrays for NumPy.
    #[arg(long, value_name = "MAPS.npz", value_parser = npz_file)]
    phase: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

fn npz_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().is_some_and(|ending| ending == "npz") {
        true => Ok(path),
        false => Err(
            "the maps are written as arrays for NumPy: a name that ends in .npz is needed".into(),
        ),
    }
}

#[derive(Serialize)]
struct Document<'a> {
    count: usize,
    cells: usize,
    rejected: Rejected,
    frames: usize,
    pattern_set: &'a str,
    /// Whether the uncertainties are based on assumed sensor properties.
    sensor_assumed: bool,
    /// Range of the counts, and how it is known.
    counts: CountRange,
    /// Smallest amplitude of each frequency, low to high, counts per pixel and exposure.
    min_modulation_dn: &'a [f64],
    /// Median ratio of the frames' noise to that predicted by `[sensor]`; limits and uncertainties are raised by it.
    frame_noise_ratio: f64,
    /// Median contrast of each frequency over the cells with a point, low to high.
    contrast: &'a [f64],
    /// Direct and global light with every mirror on, medians over the points.
    light: Option<LightMedians>,
    /// Median of the predicted standard uncertainties of the depth.
    sigma_z_median_mm: Option<f32>,
    elapsed_ms: Elapsed,
}

#[derive(Serialize)]
struct Elapsed {
    load: f64,
    decode: f64,
    write: f64,
}

/// Runs the subcommand.
pub fn run(args: &Args) -> anyhow::Result<Outcome> {
    let format = Format::of_cloud(&args.output)?;
    let start = Instant::now();
    let head = HeadModel::load(&args.head).context("head")?;
    let head = head.with_projector(args.projector);
    let mut head = head.context("--projector 2: the head has no [second_projector]")?;
    if let Some(grid) = args.grid {
        grid.impose(&mut head)?;
    }
    let plan = Plan::load(&args.plan).context("plan")?;
    let size_px = [head.camera.width_px, head.camera.height_px];
    let mut frames = plan.images(&args.images, size_px)?;
    let sensor_bits = plan.sensor.or(head.sensor).map(|sensor| sensor.bits);
    let counts = CountRange::take(&mut frames, sensor_bits);
    let views: Vec<_> = frames.iter().map(|(k, image)| (*k, image.view())).collect();
    frame_order::check(&plan.patterns, &views)
        .with_context(|| format!("images of {}", args.images.display()))?;
    let loaded = Instant::now();

    let sensor_assumed = head.take_sensor(plan.sensor, &counts);
    let defaults = DecodeOptions::for_images(&head, plan.dark_frame, sensor_assumed);
    let decoder = Decoder::new(
        &head,
        &plan.patterns,
        &plan.exposures_us,
        options(args, defaults),
    )?;
    let mut accumulator = decoder.begin();
    for (kind, view) in views {
        accumulator.add(view, kind)?;
    }
    let decoded = decoder.finish(&accumulator)?;
    let done = Instant::now();

    let cloud = &decoded.cloud;
    flankscope_foundation::files::stream_whole(&args.output, |file| {
        write_cloud(format, file, cloud, args.light_parts)
    })
    .with_context(|| format!("cannot write {}", args.output.display()))?;
    if let Some(path) = &args.phase {
        let maps = decoder.maps(&accumulator, &decoded)?;
        flankscope_foundation::files::stream_whole(path, |file| write_maps(file, &maps))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let milliseconds = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
    let document = Document {
        count: cloud.len(),
        cells: decoded.cells,
        rejected: decoded.rejected,
        frames: frames.len(),
        pattern_set: &plan.patterns.name,
        sensor_assumed,
        counts,
        min_modulation_dn: decoder.floors_dn(),
        frame_noise_ratio: decoded.frame_noise_ratio,
        contrast: &decoded.contrast,
        light: decoded.light,
        sigma_z_median_mm: median_of(cloud.sigma_z_mm.iter().map(|&s| f64::from(s)))
            .map(|s| s as f32),
        elapsed_ms: Elapsed {
            load: milliseconds(start, loaded),
            decode: milliseconds(loaded, done),
            write: milliseconds(done, Instant::now()),
        },
    };
    if !args.common.quiet {
        if counts.shift_bits > 0
            || matches!(
                counts.source,
                CountSource::Clipping | CountSource::LargestCount
            )
        {
            say(&format!(
                "note: {counts}; `bits` in [sensor] of the plan states it"
            ));
        }
        // What was assumed promises nothing about the noise.
        if !sensor_assumed && decoded.frame_noise_ratio > NOTABLE_NOISE_RATIO {
            say(&format!(
                "frames scatter {:.1} times as much as [sensor] predicts: limits and uncertainties were raised by that; \
                 check gain_e_per_dn and read_noise_e, or look for a flickering lamp and a bent response",
                decoded.frame_noise_ratio
            ));
        }
        say(&format!(
            "{} points of {} cells from {} frames -> {}",
            document.count,
            document.cells,
            document.frames,
            args.output.display()
        ));
    }
    args.common.write_json(&document)?;
    if document.count > 0 {
        return Ok(Outcome::Done);
    }
    say(&format!(
        "no cell has a point{}; docs/formats/decode.md says what each word of `rejected` (--json) means",
        most_rejected(&document.rejected)
    ));
    Ok(Outcome::INDETERMINATE)
}

/// Why most cells have no point, as the end of a sentence; empty if nothing was rejected.
fn most_rejected(rejected: &Rejected) -> String {
    let counts = serde_json::to_value(rejected).unwrap_or_default();
    let counts = counts.as_object().into_iter().flatten();
    let counts = counts.filter_map(|(word, count)| Some((word, count.as_u64()?)));
    match counts.max_by_key(|&(_, count)| count) {
        Some((word, count)) if count > 0 => format!(": {count} of them are `{word}`"),
        _ => String::new(),
    }
}

/// A noise ratio above this is reported: an imprecise sensor description explains about a tenth.
const NOTABLE_NOISE_RATIO: f64 = 1.5;

fn options(args: &Args, defaults: DecodeOptions) -> DecodeOptions {
    let consistency = args.frame_consistency;
    DecodeOptions {
        min_contrast: args.min_contrast,
        min_modulation_dn: args.min_modulation,
        max_sigma_z_mm: args.max_sigma,
        consistency: consistency
            .map(ConsistencyOptions::for_images)
            .or(defaults.consistency),
        smoothing_px: args.smooth.unwrap_or(defaults.smoothing_px),
        coarse_smoothing_px: match args.smooth {
            Some(0.0) => 0.0,
            _ => defaults.coarse_smoothing_px,
        },
        patches: defaults
            .patches
            .filter(|_| args.min_patch > 0)
            .map(|patches| PatchOptions {
                min_cells: args.min_patch,
                ..patches
            }),
        ..defaults
    }
}

fn write_maps(file: &mut dyn Write, maps: &PhaseMaps) -> io::Result<()> {
    let of_cells = maps.shape.as_slice();
    let of_sets = [&[maps.periods.len()], of_cells].concat();
    let mut npz = NpzWriter::new(file);
    npz.array("periods", &[maps.periods.len()], &maps.periods)?;
    npz.array("pixel_px", &[of_cells, &[2]].concat(), &maps.pixel_px)?;
    npz.array("phase_rad", &of_sets, &maps.phase_rad)?;
    npz.array("modulation_e", &of_sets, &maps.modulation_e)?;
    npz.array("mean_e", &of_sets, &maps.mean_e)?;
    npz.array("order", of_cells, &maps.order)?;
    npz.array("column_px", of_cells, &maps.column_px)?;
    npz.array("depth_mm", of_cells, &maps.depth_mm)?;
    npz.array("sigma_z_mm", of_cells, &maps.sigma_z_mm)?;
    npz.finish().map(drop)
}

/// Single precision, which is 1 nm at the working distance.
fn write_cloud(
    format: Format,
    file: &mut dyn Write,
    cloud: &Cloud,
    light_parts: bool,
) -> io::Result<()> {
    let electrons = |of: fn(&LightParts) -> f64| cloud.light.iter().map(of).collect::<Vec<_>>();
    let (direct_e, global_e) = (electrons(|l| l.direct_e), electrons(|l| l.global_e));
    let columns = [
        Column::Single("sigma_z", &cloud.sigma_z_mm),
        Column::Float("direct", &direct_e),
        Column::Float("global", &global_e),
    ];
    let points = PointFile {
        comment: "camera frame, mm; sigma_z is the standard uncertainty of z",
        coordinate: Scalar::F32,
        columns: if light_parts { &columns } else { &columns[..1] },
        ..PointFile::from_points(&cloud.points_mm)
    };
    points.write(format, file)
}
