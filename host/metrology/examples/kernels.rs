//! Runs one hot kernel once, inside a function of its own, for an instruction counter: `cargo xtask bench --instructions`.
//! Arguments: the benchmark's data folder, the kernel.

use std::hint::black_box;
use std::path::Path;

use flankscope_metrology::cloud::merge::voxel_centroids;
use flankscope_metrology::cloud::outlier;
use flankscope_metrology::deviation::deviations;
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh;
use flankscope_metrology::registration::{Options, register};
use flankscope_metrology::surface::Surface;

/// What the counter looks at.
#[inline(never)]
fn counted<T>(work: impl FnOnce() -> T) -> T {
    black_box(work())
}

fn cloud(folder: &Path, name: &str, most: usize) -> std::io::Result<Vec<[f64; 3]>> {
    let bytes = std::fs::read(folder.join(name))?;
    let numbers = bytes.as_chunks::<8>().0.iter();
    let numbers: Vec<f64> = numbers.map(|b| f64::from_le_bytes(*b)).collect();
    Ok(numbers
        .as_chunks::<3>()
        .0
        .iter()
        .take(most)
        .copied()
        .collect())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: kernels FOLDER distance|register|outliers|merge";
    let (folder, kernel) = (
        arguments.next().ok_or(usage)?,
        arguments.next().ok_or(usage)?,
    );
    let folder = Path::new(&folder);
    // All work on this thread, where it is counted.
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()?;
    match kernel.as_str() {
        "distance" => {
            let surface = Surface::new(&mesh::load(&folder.join("coarse.ply"), Unit::Mm)?)?;
            let points = cloud(folder, "sorted.f64", 100_000)?;
            counted(|| deviations(&surface, &points));
        }
        "register" => {
            let surface = Surface::new(&mesh::load(&folder.join("feature.ply"), Unit::Mm)?)?;
            let points = cloud(folder, "feature.f64", usize::MAX)?;
            counted(|| register(&surface, &points, None, &Options::default()));
        }
        "outliers" => {
            let points = cloud(folder, "view.f64", usize::MAX)?;
            counted(|| outlier::statistical(&points, 20, 2.0));
        }
        "merge" => {
            let points = cloud(folder, "random.f64", 300_000)?;
            counted(|| voxel_centroids(&points, 0.05)).map(drop)?;
        }
        _ => return Err(usage.into()),
    }
    Ok(())
}
