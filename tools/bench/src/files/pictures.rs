//! Pictures that the DMD is loaded with: a folder of `flankscope patterns --adaptive`.

use std::f64::consts::TAU;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, ensure};
use rayon::prelude::*;
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use crate::world::{DmdPass, PatternSpec};

/// What `adaptive.json` says: which pictures, and the folder of each pass.
#[derive(Deserialize)]
struct Index {
    set: String,
    passes: Vec<Pass>,
    /// There where fringes are not straight; how they are bent is taken from the pictures.
    bend: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Pass {
    lights: String,
}

/// What `patterns.json` of a pass says.
#[derive(Deserialize)]
struct Pictures {
    patterns: Vec<Picture>,
}

#[derive(Deserialize)]
struct Picture {
    file: String,
    #[serde(flatten)]
    shows: PatternSpec,
}

/// The patterns of a pass, and what the DMD shows of them in each pass.
///
/// # Errors
/// What cannot be read, is no grey image of the DMD's size, or shows other fringes than its set.
pub fn load(
    folder: &Path,
    size_px: [usize; 2],
) -> anyhow::Result<(Vec<PatternSpec>, Vec<DmdPass>)> {
    let index: Index = json(&folder.join("adaptive.json"))?;
    let set = index.set;
    // A set that is not known by its name is what its first pass shows.
    let mut known = PatternSpec::named(&set);
    let mut passes = Vec::new();
    for Pass { lights } in index.passes {
        let folder = folder.join(lights);
        let pictures: Pictures = json(&folder.join("patterns.json"))?;
        let shown: Vec<PatternSpec> = pictures.patterns.iter().map(|of| of.shows).collect();
        let patterns = known.get_or_insert_with(|| shown.clone());
        ensure!(
            shown == *patterns,
            "{} shows other fringes than {set}",
            folder.display()
        );
        // The mean over the phase steps is half of what a mirror gets.
        let finest = patterns.last().map_or(0.0, |last| last.periods);
        let mut sums = vec![0_u32; size_px[0] * size_px[1]];
        let mut seen = Fringes::new(patterns, size_px);
        for picture in &pictures.patterns {
            let is_fine = picture.shows.periods == finest;
            if !is_fine && index.bend.is_none() {
                continue;
            }
            let grey = image(&folder.join(&picture.file), size_px)?;
            if index.bend.is_some() {
                seen.add(&picture.shows, &grey);
            }
            if is_fine {
                for (sum, brightness) in sums.iter_mut().zip(grey) {
                    *sum += u32::from(brightness);
                }
            }
        }
        let steps = patterns.iter().filter(|of| of.periods == finest).count();
        let of = |sum: u32| (2.0 * f64::from(sum) / steps as f64).round().min(255.0) as u8;
        let pass = DmdPass::new(size_px, sums.into_iter().map(of).collect())?;
        passes.push(match index.bend {
            None => pass,
            Some(_) => pass.bent(seen.columns_px())?,
        });
    }
    let patterns = known.with_context(|| format!("{set} has no pass"))?;
    Ok((patterns, passes))
}

/// What the pictures of a pass show at every mirror: of each frequency, cosine and sine of its phase.
struct Fringes {
    size_px: [usize; 2],
    periods: Vec<f64>,
    phasors: Vec<Vec<[f32; 2]>>,
}

/// Fringes are told apart up to so many columns beside their own place, in the DMD's columns.
const FARTHEST_RATIO: f64 = 0.1;

impl Fringes {
    fn new(patterns: &[PatternSpec], size_px: [usize; 2]) -> Self {
        let mut periods: Vec<f64> = patterns.iter().map(|of| of.periods).collect();
        periods.dedup();
        let mirrors = size_px[0] * size_px[1];
        Self {
            size_px,
            phasors: vec![vec![[0.0; 2]; mirrors]; periods.len()],
            periods,
        }
    }

    fn add(&mut self, shows: &PatternSpec, grey: &[u8]) {
        let (sin, cos) = shows.step_rad().sin_cos();
        let Some(set) = self.periods.iter().position(|&of| of == shows.periods) else {
            return;
        };
        for ([re, im], &brightness) in self.phasors[set].iter_mut().zip(grey) {
            *re += f32::from(brightness) * cos as f32;
            *im -= f32::from(brightness) * sin as f32;
        }
    }

    /// Of every mirror the column whose straight fringes it shows: of all near it the one that all frequencies fit best.
    fn columns_px(&self) -> Vec<f32> {
        let columns = self.size_px[0] as f64;
        let finest = self.periods.len() - 1;
        let period_px = columns / self.periods[finest];
        let of_mirror = |at: usize| {
            let own = (at % self.size_px[0]) as f64;
            let phases = self
                .phasors
                .iter()
                .map(|of| f64::from(of[at][1]).atan2(f64::from(of[at][0])));
            let phases: Vec<f64> = phases.collect();
            let first = period_px * phases[finest] / TAU - 0.5;
            let reach = FARTHEST_RATIO * columns;
            let orders = ((own - reach - first) / period_px).ceil() as i32
                ..=((own + reach - first) / period_px).floor() as i32;
            let off = |column: f64| -> f64 {
                let of = |(periods, phase): (&f64, &f64)| {
                    let turns = periods * (column + 0.5) / columns - phase / TAU;
                    (turns - turns.round()).powi(2)
                };
                self.periods.iter().zip(&phases).map(of).sum()
            };
            let near = orders.map(|order| first + period_px * f64::from(order));
            let best = near.min_by(|a, b| off(*a).total_cmp(&off(*b)));
            best.unwrap_or(own) as f32
        };
        let mirrors = self.size_px[0] * self.size_px[1];
        (0..mirrors).into_par_iter().map(of_mirror).collect()
    }
}

fn json<T: DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    let told = || format!("cannot use {}", path.display());
    let text = std::fs::read(path).with_context(told)?;
    serde_json::from_slice(&text).with_context(told)
}

/// A grey image of the DMD, row by row.
fn image(path: &Path, size_px: [usize; 2]) -> anyhow::Result<Vec<u8>> {
    let told = || format!("cannot use {}", path.display());
    let file = File::open(path).with_context(told)?;
    let mut reader = png::Decoder::new(BufReader::new(file))
        .read_info()
        .with_context(told)?;
    let info = reader.info();
    let got = [info.width as usize, info.height as usize];
    ensure!(
        got == size_px
            && info.color_type == png::ColorType::Grayscale
            && info.bit_depth == png::BitDepth::Eight,
        "{} is {} x {} {:?} of {:?} bits; the bench's DMD takes grey ones of 8 bits, {} x {}",
        path.display(),
        got[0],
        got[1],
        info.color_type,
        info.bit_depth,
        size_px[0],
        size_px[1]
    );
    let mut grey = vec![0; size_px[0] * size_px[1]];
    reader.next_frame(&mut grey).with_context(told)?;
    Ok(grey)
}
