//! Pictures for the DMD: a folder written by `flankscope patterns --adaptive`.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, ensure};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::world::{DmdPass, PatternSpec};

/// Contents of `adaptive.json`: pictures, and the folder of each pass.
#[derive(Deserialize)]
struct Index {
    set: String,
    passes: Vec<Pass>,
}

#[derive(Deserialize)]
struct Pass {
    lights: String,
}

/// Contents of `patterns.json` of a pass.
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

/// The patterns of a pass, and what the DMD displays of them in each pass.
///
/// # Errors
/// A file cannot be read, is not a grey image of the DMD's size, or shows other fringes than its set.
pub fn load(
    folder: &Path,
    size_px: [usize; 2],
) -> anyhow::Result<(Vec<PatternSpec>, Vec<DmdPass>)> {
    let index: Index = json(&folder.join("adaptive.json"))?;
    let set = index.set;
    // A set that is not known by name is defined by the patterns of its first pass.
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
        // The mean over the phase steps is half of a mirror's brightness.
        let finest = patterns.last().map_or(0.0, |last| last.periods);
        let mut sums = vec![0_u32; size_px[0] * size_px[1]];
        for picture in &pictures.patterns {
            if picture.shows.periods != finest {
                continue;
            }
            let grey = image(&folder.join(&picture.file), size_px)?;
            for (sum, brightness) in sums.iter_mut().zip(grey) {
                *sum += u32::from(brightness);
            }
        }
        let steps = patterns.iter().filter(|of| of.periods == finest).count();
        let of = |sum: u32| (2.0 * f64::from(sum) / steps as f64).round().min(255.0) as u8;
        passes.push(DmdPass::new(size_px, sums.into_iter().map(of).collect())?);
    }
    let patterns = known.with_context(|| format!("{set} has no pass"))?;
    Ok((patterns, passes))
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
