//! Times this crate on the benchmark's data: `cargo xtask bench` makes the data, runs this and the peers, and prints the
//! table. Arguments: the data folder, then optionally parts of names to run. One JSON object per figure.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

use flankscope_metrology::cloud::merge::voxel_centroids;
use flankscope_metrology::deviation::deviations;
use flankscope_metrology::io::Unit;
use flankscope_metrology::io::mesh::{self, TriMesh};
use flankscope_metrology::registration::{Options, register};
use flankscope_metrology::surface::Surface;
use flankscope_metrology::{cloud::outlier, surface::sampling};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

struct Bench {
    folder: PathBuf,
    wanted: Vec<String>,
}

impl Bench {
    fn wants(&self, name: &str) -> bool {
        self.wanted.is_empty() || self.wanted.iter().any(|w| name.contains(w.as_str()))
    }

    /// Median of `repeats` runs after one that is not counted.
    fn time<T>(
        &self,
        name: &str,
        repeats: usize,
        mut work: impl FnMut() -> T,
        note: impl FnOnce(T) -> Option<String>,
    ) {
        if !self.wants(name) {
            return;
        }
        let mut last = black_box(work());
        let (mut all, mut processor) = (Vec::new(), Vec::new());
        for _ in 0..repeats {
            let (before, start) = (processor_ms(), Instant::now());
            last = black_box(work());
            all.push(start.elapsed().as_secs_f64() * 1e3);
            processor.push(processor_ms() - before);
        }
        all.sort_by(f64::total_cmp);
        processor.sort_by(f64::total_cmp);
        let (ms, cpu_ms) = (all[repeats / 2], processor[repeats / 2]);
        let note = note(last).map_or(String::new(), |note| format!(", \"note\": \"{note}\""));
        println!(
            "{{\"name\": \"{name}\", \"ms\": {ms:.4}, \"cpu_ms\": {cpu_ms:.4}, \"all\": {all:.3?}{note}}}"
        );
    }

    fn cloud(&self, name: &str) -> Outcome<Vec<[f64; 3]>> {
        let bytes = std::fs::read(self.folder.join(name))?;
        let numbers = bytes.as_chunks::<8>().0.iter();
        let numbers: Vec<f64> = numbers.map(|b| f64::from_le_bytes(*b)).collect();
        Ok(numbers.as_chunks::<3>().0.to_vec())
    }

    fn mesh(&self, name: &str) -> Outcome<TriMesh> {
        Ok(mesh::load(&self.folder.join(name), Unit::Mm)?)
    }
}

/// Processor time of all threads so far: unlike the clock's, it does not count what other programs took. 0 where the
/// system does not say.
fn processor_ms() -> f64 {
    let Ok(threads) = std::fs::read_dir("/proc/self/task") else {
        return 0.0;
    };
    let of_thread = |entry: std::fs::DirEntry| {
        let text = std::fs::read_to_string(entry.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    };
    threads.flatten().filter_map(of_thread).sum::<f64>() * 1e-6
}

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments
        .next()
        .ok_or("usage: bench FOLDER [part of a name]..")?;
    let bench = Bench {
        folder: Path::new(&folder).to_path_buf(),
        wanted: arguments.collect(),
    };
    registration(&bench)?;
    clouds(&bench)?;
    loading(&bench);
    distance(&bench)?;
    growth(&bench)
}

fn registration(bench: &Bench) -> Outcome<()> {
    let mesh = bench.mesh("feature.ply")?;
    let points = bench.cloud("feature.f64")?;
    let truth = std::fs::read(bench.folder.join("truth.f64"))?;
    let truth: Vec<f64> = truth
        .as_chunks::<8>()
        .0
        .iter()
        .map(|b| f64::from_le_bytes(*b))
        .collect();
    bench.time("prepare/feature", 15, || Surface::new(&mesh), |_| None);
    let surface = Surface::new(&mesh)?;
    let options = Options::default();
    let work = || register(&surface, &points, None, &options);
    bench.time("register", 15, work, |found| {
        let error2 = points.iter().map(|&p| {
            let at = found.tool_from_cloud.apply(p);
            let off = |i: usize| {
                let row = &truth[4 * i..4 * i + 4];
                at[i] - (row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3])
            };
            off(0).powi(2) + off(1).powi(2) + off(2).powi(2)
        });
        let error_um = 1e3 * (error2.sum::<f64>() / points.len() as f64).sqrt();
        let (steps, status) = (found.iterations, found.status);
        Some(format!(
            "{error_um:.3} µm to the truth, {steps} steps, {status:?}, CAD of {} triangles",
            mesh.triangles.len()
        ))
    });
    Ok(())
}

fn clouds(bench: &Bench) -> Outcome<()> {
    if bench.wants("sample") {
        let fine = bench.mesh("fine.ply")?;
        bench.time(
            "sample",
            15,
            || sampling::sample(&fine, 100_000, 1),
            |_| None,
        );
    }
    for name in ["feature", "view"] {
        let points = bench.cloud(&format!("{name}.f64"))?;
        for k in [8, 20] {
            let work = || outlier::statistical(&points, k, 2.0);
            bench.time(&format!("outliers/{name}/{k}"), 15, work, |kept| {
                Some(format!("{} kept", kept.iter().filter(|k| **k).count()))
            });
        }
    }
    for order in ["random", "scan"] {
        if !bench.wants(&format!("merge/{order}")) {
            continue;
        }
        let points = bench.cloud(&format!("{order}.f64"))?;
        let work = || voxel_centroids(&points, 0.05);
        bench.time(&format!("merge/{order}"), 5, work, |merged| {
            merged.ok().map(|merged| format!("{} points", merged.len()))
        });
    }
    Ok(())
}

fn loading(bench: &Bench) {
    for kind in ["ply", "stl"] {
        let path = bench.folder.join(format!("fine.{kind}"));
        let work = || mesh::load(&path, Unit::Mm);
        bench.time(&format!("load/{kind}"), 9, work, |_| None);
    }
}

fn distance(bench: &Bench) -> Outcome<()> {
    for name in ["coarse", "fine"] {
        let parts = [
            "prepare",
            "distance/random",
            "distance/sorted",
            "distance/scan",
        ];
        let names = parts.map(|part| match part.split_once('/') {
            Some((part, order)) => format!("{part}/{name}/{order}"),
            None => format!("{part}/{name}"),
        });
        if !names.iter().any(|name| bench.wants(name)) {
            continue;
        }
        let mesh = bench.mesh(&format!("{name}.ply"))?;
        let work = || Surface::new(&mesh);
        bench.time(&format!("prepare/{name}"), 5, work, |_| None);
        let surface = Surface::new(&mesh)?;
        for order in ["random", "sorted", "scan"] {
            let points = bench.cloud(&format!("{order}.f64"))?;
            let work = || deviations(&surface, &points);
            bench.time(&format!("distance/{name}/{order}"), 5, work, |distances| {
                let sum: f64 = distances.iter().map(|d| d * d).sum();
                let rms_um = 1e3 * (sum / distances.len() as f64).sqrt();
                Some(format!("rms {rms_um:.4} µm"))
            });
        }
    }
    Ok(())
}

/// How cost grows: with the points, with the triangles, with the views that are merged.
fn growth(bench: &Bench) -> Outcome<()> {
    if !bench.wants("growth") {
        return Ok(());
    }
    let ring = bench.cloud("random.f64")?;
    let coarse = Surface::new(&bench.mesh("coarse.ply")?)?;
    for n in [10_000, 30_000, 100_000, 300_000, 1_000_000, ring.len()] {
        let points = &ring[..n];
        let work = || deviations(&coarse, points);
        bench.time(&format!("growth/distance/points/{n}"), 5, work, |_| None);
    }
    for n in [10_000, 100_000, 1_000_000, ring.len()] {
        let work = || voxel_centroids(&ring[..n], 0.05);
        bench.time(&format!("growth/merge/points/{n}"), 3, work, |_| None);
    }
    // Views of as many points as the head sees cores.
    for views in [1, 3, 10, 43] {
        let points = &ring[..(views * 97_000).min(ring.len())];
        let work = || voxel_centroids(points, 0.05);
        bench.time(&format!("growth/merge/views/{views}"), 3, work, |_| None);
    }
    let feature = Surface::new(&bench.mesh("feature.ply")?)?;
    let cloud = bench.cloud("feature.f64")?;
    for n in [1_000, 3_000, 10_000, 30_000, cloud.len()] {
        let work = || register(&feature, &cloud[..n], None, &Options::default());
        bench.time(&format!("growth/register/points/{n}"), 9, work, |_| None);
        let work = || outlier::statistical(&cloud[..n], 20, 2.0);
        bench.time(&format!("growth/outliers/points/{n}"), 9, work, |_| None);
    }
    let mut meshes = vec![bench.mesh("coarse.ply")?, bench.mesh("fine.ply")?];
    for entry in std::fs::read_dir(&bench.folder)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if name.starts_with("between-") {
            meshes.push(bench.mesh(&name)?);
        }
    }
    for mesh in &meshes {
        let n = mesh.triangles.len();
        let name = format!("growth/prepare/triangles/{n}");
        bench.time(&name, 3, || Surface::new(mesh), |_| None);
        let surface = Surface::new(mesh)?;
        let work = || deviations(&surface, &ring[..1_000_000]);
        bench.time(&format!("growth/distance/triangles/{n}"), 3, work, |_| None);
    }
    Ok(())
}
