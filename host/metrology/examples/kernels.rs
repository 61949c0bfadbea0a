//! Runs one stage of a check once, inside a function of its own, for an instruction counter: `cargo xtask bench --instructions`.

use std::hint::black_box;
use std::path::Path;

use flankscope_metrology::cloud::merge::voxel_centroids;
use flankscope_metrology::cloud::outlier;
use flankscope_metrology::deviation::deviations;
use flankscope_metrology::gear::{GearData, GearKind};
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh;
use flankscope_metrology::registration::{Options, register};
use flankscope_metrology::surface::Surface;
use flankscope_metrology::wear::{self, Measured, Sight, WearSettings, Zone};

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
    let usage = "usage: kernels counted distance|register|outliers|merge|wear FOLDER";
    let [Some(_), Some(kernel), Some(folder)] = [(); 3].map(|()| arguments.next()) else {
        return Err(usage.into());
    };
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
        "wear" => {
            let surface = Surface::new(&mesh::load(&folder.join("feature.ply"), Unit::Mm)?)?;
            let points = cloud(folder, "feature.f64", usize::MAX)?;
            let registered = register(&surface, &points, None, &Options::default());
            let to_tool = |&point| registered.tool_from_cloud.apply(point);
            let points: Vec<[f64; 3]> = points.iter().map(to_tool).collect();
            let closest = surface.closest_many(&points);
            let gear = ring();
            let [low_mm, high_mm] = gear.active_flank_mm();
            let zone = Zone {
                radius_mm: [low_mm, high_mm],
                height_mm: [57.0, 65.0],
            };
            let middle = gear.tooth_at(0.0);
            let teeth = [
                middle,
                middle % gear.teeth + 1,
                (middle + gear.teeth - 2) % gear.teeth + 1,
            ];
            let measured = Measured {
                points: &points,
                closest: &closest,
                sigma_mm: None,
                sight: Some(Sight {
                    surface: &surface,
                    camera_mm: [22.0, 0.0, 61.0],
                    dark: &[],
                    undecoded: &[],
                    range_mm: [15.0, 25.0],
                    light: &[],
                }),
            };
            let settings = WearSettings::default();
            wear::prepare();
            let wears = counted(|| {
                wear::evaluate(&gear, &zone, &teeth, measured, Some(&registered), &settings)
            });
            // An empty evaluation would be counted as a fast one.
            if wears.len() != 6 || wears.iter().any(|wear| wear.judged.is_none()) {
                return Err("not all six flanks were evaluated".into());
            }
        }
        _ => return Err(usage.into()),
    }
    Ok(())
}

/// The gear of the benchmark's meshes (`tools/xtask/src/bench/data.rs`).
fn ring() -> GearData {
    GearData {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm: 82.9 / 84.0,
        pressure_angle_deg: 20.0,
        tip_radius_mm: 41.45 - 82.9 / 84.0,
        root_radius_mm: 41.45 + 1.25 * 82.9 / 84.0,
        first_tooth_centre_deg: 0.0,
        height_mm: [0.0, 66.0],
        radial_threshold_mm: 50.0,
    }
}
