//! Photographs a tooth of the demo die and saves the frames as PNG, with brightness statistics and timings.
//!
//! ```text
//! cargo run --release -p flankscope-bench --example frames -- OUTPUT_DIR [TOOTH]
//! ```

use anyhow::{Context, Result};
use flankscope_bench::demo;
use flankscope_bench::world::{PatternSpec, ViewState, World};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments
        .next()
        .context("an output folder is needed: frames OUTPUT_DIR [TOOTH]")?;
    let tooth: u32 = arguments
        .next()
        .map_or(Ok(12), |t| t.parse())
        .context("TOOTH must be a whole number")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;

    let config = demo::world_config()?;
    let mut clock = Instant::now();
    let world = World::new(&config)?;
    println!("world       {:7.1} ms", lap_ms(&mut clock));
    let rotation_rad = -config.gear.tooth_centre_rad(tooth);
    let mut patterns = PatternSpec::insitu12();
    patterns.push(PatternSpec {
        periods: 0.0,
        step: 1,
        steps: 4,
    });
    let mut prepared = None;
    for _ in 0..3 {
        clock = Instant::now();
        prepared = Some(world.prepare(rotation_rad, demo::HEIGHT_MM, &patterns)?);
        println!("prepare     {:7.1} ms", lap_ms(&mut clock));
    }
    let view = prepared.context("a view was prepared")?;

    statistics(&world, &view)?;
    let frames = [
        ("black", 0, 10_000),
        ("coarse", 1, 20_000),
        ("fine", 5, 20_000),
        ("saturated", 5, 200_000),
        ("even", 13, 45_000),
    ];
    let [width, height] = world.size_px();
    let mut counts = vec![0u16; width * height];
    for (number, (name, pattern, exposure_us)) in frames.into_iter().enumerate() {
        clock = Instant::now();
        world.render(
            &view,
            pattern,
            exposure_us,
            true,
            number as u32,
            &mut counts,
        )?;
        println!("render      {:7.2} ms  {name}", lap_ms(&mut clock));
        save(
            &folder.join(format!("{name}.png")),
            &counts,
            width,
            [0, 0, width, height],
        )?;
        let centre = [width / 2 - 300, height / 2 - 200, 600, 400];
        save(
            &folder.join(format!("{name}-centre.png")),
            &counts,
            width,
            centre,
        )?;
    }
    Ok(())
}

/// Electrons per mean pixel of both flanks, and of what saturates, for the exposures in question.
fn statistics(world: &World, view: &ViewState) -> Result<()> {
    let truth = world.truth(view);
    let lit = truth.iter().filter(|t| t.lit).count();
    println!("cores       {:7} see the die, {lit} are lit", truth.len());
    let [width, height] = world.size_px();
    let mut counts = vec![0u16; width * height];
    let positions = world.camera_bundle().positions_px();
    for exposure_us in [10_000, 20_000, 50_000] {
        world.render(view, 5, exposure_us, true, 1000, &mut counts)?;
        let at = |core: u32| {
            let [x, y] = positions[core as usize].map(f64::round);
            f64::from(counts[(y as usize).min(height - 1) * width + (x as usize).min(width - 1)])
        };
        let mean = |of: &[u32]| {
            of.iter().map(|&c| (at(c) - 100.0) * 7.91).sum::<f64>() / of.len().max(1) as f64
        };
        let flank: Vec<u32> = truth
            .iter()
            .filter(|t| t.lit && t.flank.is_some())
            .map(|t| t.core)
            .collect();
        let land: Vec<u32> = truth
            .iter()
            .filter(|t| t.lit && t.flank.is_none())
            .map(|t| t.core)
            .collect();
        let full = truth.iter().filter(|t| at(t.core) >= 4095.0).count();
        println!(
            "{:3} ms      core peaks: flanks {:6.0} e ({} cores), lands {:6.0} e ({} cores), saturated {full}",
            exposure_us / 1000,
            mean(&flank),
            flank.len(),
            mean(&land),
            land.len()
        );
    }
    Ok(())
}

fn lap_ms(clock: &mut Instant) -> f64 {
    let ms = clock.elapsed().as_secs_f64() * 1e3;
    *clock = Instant::now();
    ms
}

/// Saves a window (left, top, width, height) as 8-bit grey; white is the largest 12-bit count.
fn save(
    path: &Path,
    counts: &[u16],
    stride: usize,
    [left, top, width, height]: [usize; 4],
) -> Result<()> {
    let grey: Vec<u8> = (top..top + height)
        .flat_map(|row| {
            counts[row * stride + left..row * stride + left + width]
                .iter()
                .map(|&dn| (dn >> 4) as u8)
        })
        .collect();
    let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(&grey)?;
    Ok(())
}
