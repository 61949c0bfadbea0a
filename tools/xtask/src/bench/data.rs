//! The data of the benchmark: made here, the same bytes every time, read by us and by every peer.
//!
//! | file | holds |
//! |---|---|
//! | `coarse.ply` | toothed surface of a ring gear, 84 teeth x 40 chords x 2 = 6 720 triangles, each 66 mm long |
//! | `fine.ply`, `fine.stl` | the same surface with 56 chords and 66 layers: 620 928 triangles |
//! | `between-N.ply` | the same surface with N triangles, between coarse and fine |
//! | `random.f64`, `sorted.f64`, `scan.f64` | points on it with 20 µm of noise, in three orders |
//! | `feature.ply` | CAD of one feature: the upper 10 mm of three teeth with their end face |
//! | `feature.f64`, `truth.f64` | 100 000 points on it with 5 µm of noise, moved by 0.4° and 0.1 mm; the way back |
//! | `view.f64` | 100 000 points of one view as a camera gives them: row by row, with a few wild ones |
//!
//! Clouds are x, y, z as little-endian f64, mm; poses are 4 x 4, row by row.

use std::f64::consts::TAU;
use std::io::{BufWriter, Write};
use std::path::Path;

use flankscope_gear_cad::{GearKind, GearSpec, Mesh, Meshing, write_ply, write_stl};

pub const RING_POINTS: usize = 4_210_000;
pub const FEATURE_POINTS: usize = 100_000;
/// Written last: a folder without it is made again.
const DONE: &str = "done-2";
/// Meshes between coarse and fine, as chords per pitch and layers: how cost grows with triangles.
const BETWEEN: [(usize, u32); 3] = [(40, 4), (48, 12), (56, 24)];

type P = [f64; 3];

/// Fills `folder` unless it is filled; the ring's clouds get so many points.
pub fn make(folder: &Path, ring_points: usize) -> Result<(), String> {
    if folder.join(DONE).is_file() {
        return Ok(());
    }
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    eprintln!("making the benchmark's data in {}", folder.display());
    let coarse = toothed(40, 1)?;
    let fine = toothed(56, 66)?;
    save(folder, "coarse.ply", |out| write_ply(&coarse, out))?;
    save(folder, "fine.ply", |out| write_ply(&fine, out))?;
    save(folder, "fine.stl", |out| write_stl(&fine, "gear", out))?;
    for (chords, slices) in BETWEEN {
        let mesh = toothed(chords, slices)?;
        let name = format!("between-{}.ply", mesh.triangles.len());
        save(folder, &name, |out| write_ply(&mesh, out))?;
    }
    ring(folder, &fine, ring_points)?;
    feature(folder)?;
    cloud(folder, "view.f64", &view())?;
    save(folder, DONE, |_| Ok(()))
}

fn gear() -> GearSpec {
    GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm: 82.9 / 84.0,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 41.45 - 82.9 / 84.0,
        root_radius_mm: 41.45 + 1.25 * 82.9 / 84.0,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 88.5,
        height_mm: [0.0, 66.0],
    }
}

/// The toothed surface alone, with `chords` per pitch: the chord error that gives them is found by bisection.
fn toothed(chords: usize, slices: u32) -> Result<Mesh, String> {
    let gear = gear();
    let (mut low, mut high) = (1e-6f64, 0.5f64);
    for _ in 0..60 {
        let middle = (low * high).sqrt();
        let mesh = gear
            .mesh(&Meshing {
                chord_error_mm: middle,
                body_chord_error_mm: 0.5,
                axial_slices: 1,
            })
            .map_err(|e| e.to_string())?;
        let got = surface_only(&mesh).len() / (2 * 84);
        if got == chords {
            let meshing = Meshing {
                chord_error_mm: middle,
                body_chord_error_mm: 0.5,
                axial_slices: slices,
            };
            let mesh = gear.mesh(&meshing).map_err(|e| e.to_string())?;
            return Ok(compact(&mesh, surface_only(&mesh)));
        }
        if got > chords {
            low = middle;
        } else {
            high = middle;
        }
    }
    Err(format!("no chord error gives {chords} chords per pitch"))
}

/// Triangles of the teeth without wall and end faces.
fn surface_only(mesh: &Mesh) -> Vec<[u32; 3]> {
    let keep = |t: &&[u32; 3]| {
        let corners = t.map(|i| mesh.vertices[i as usize]);
        let level = corners.iter().all(|c| c[2] == corners[0][2]);
        !level && corners.iter().all(|c| c[0].hypot(c[1]) < 60.0)
    };
    mesh.triangles.iter().filter(keep).copied().collect()
}

fn compact(mesh: &Mesh, triangles: Vec<[u32; 3]>) -> Mesh {
    let mut new = vec![u32::MAX; mesh.vertices.len()];
    let mut out = Mesh::default();
    for triangle in triangles {
        out.triangles.push(triangle.map(|i| {
            let slot = &mut new[i as usize];
            if *slot == u32::MAX {
                *slot = out.vertices.len() as u32;
                out.vertices.push(mesh.vertices[i as usize]);
            }
            *slot
        }));
    }
    out
}

fn ring(folder: &Path, mesh: &Mesh, count: usize) -> Result<(), String> {
    let mut random = Random(1);
    let mut points = sample(mesh, count, 0.02, &mut random);
    cloud(folder, "random.f64", &points)?;
    // A scan: view by view (one tooth each), row by row of 20 µm, along the row.
    let pitch = TAU / 84.0;
    points.sort_by_cached_key(|p| {
        let angle = p[1].atan2(p[0]).rem_euclid(TAU);
        let tooth = (angle / pitch) as u64;
        let row = (p[2].max(0.0) / 0.02) as u64;
        (tooth << 56) | (row << 32) | (angle / TAU * f64::from(u32::MAX)) as u64
    });
    cloud(folder, "scan.f64", &points)?;
    points.sort_by_cached_key(|p| {
        let cell = p.map(|c| ((c + 128.0) * 8192.0) as u64);
        spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
    });
    cloud(folder, "sorted.f64", &points)
}

/// Every third bit (Z order).
fn spread(mut x: u64) -> u64 {
    x &= 0x1F_FFFF;
    x = (x | x << 32) & 0x001F_0000_0000_FFFF;
    x = (x | x << 16) & 0x001F_0000_FF00_00FF;
    x = (x | x << 8) & 0x100F_00F0_0F00_F00F;
    x = (x | x << 4) & 0x10C3_0C30_C30C_30C3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

fn feature(folder: &Path) -> Result<(), String> {
    let meshing = Meshing {
        chord_error_mm: 0.2e-3,
        body_chord_error_mm: 0.5,
        axial_slices: 66,
    };
    let mesh = gear().mesh(&meshing).map_err(|e| e.to_string())?;
    let pitch = TAU / 84.0;
    let keep = |t: &&[u32; 3]| {
        let corners = t.map(|i| mesh.vertices[i as usize]);
        corners.iter().all(|c| {
            let angle = c[1].atan2(c[0]);
            c[2] > 55.9 && c[0].hypot(c[1]) < 43.0 && angle.abs() < 1.51 * pitch
        })
    };
    let part = compact(&mesh, mesh.triangles.iter().filter(keep).copied().collect());
    save(folder, "feature.ply", |out| write_ply(&part, out))?;

    let mut random = Random(2);
    let mut points = sample(&part, FEATURE_POINTS, 0.005, &mut random);
    // The cloud was taken with the head turned by 0.4° about a slanted axis through the feature and shifted by 0.1 mm.
    let centre = [41.5, 0.0, 61.0];
    let axis = [0.36, 0.48, 0.8];
    let rotation = rotation(axis, 0.4f64.to_radians());
    let shift = [0.06, -0.06, 0.1 * 0.28f64.sqrt()];
    let mut truth = [0.0; 16];
    truth[15] = 1.0;
    for i in 0..3 {
        truth[4 * i..4 * i + 3].copy_from_slice(&rotation[i]);
        let turned: f64 = (0..3).map(|j| rotation[i][j] * centre[j]).sum();
        truth[4 * i + 3] = centre[i] - turned + shift[i];
    }
    for point in &mut points {
        let at: P = std::array::from_fn(|k| point[k] - truth[4 * k + 3]);
        *point = std::array::from_fn(|k| (0..3).map(|i| rotation[i][k] * at[i]).sum());
    }
    cloud(folder, "feature.f64", &points)?;
    save(folder, "truth.f64", |out| {
        truth
            .iter()
            .try_for_each(|value| out.write_all(&value.to_le_bytes()))
    })
}

/// Rodrigues' rotation about a unit axis.
fn rotation([x, y, z]: P, angle: f64) -> [[f64; 3]; 3] {
    let (sin, cos) = angle.sin_cos();
    let v = 1.0 - cos;
    [
        [cos + x * x * v, x * y * v - z * sin, x * z * v + y * sin],
        [y * x * v + z * sin, cos + y * y * v, y * z * v - x * sin],
        [z * x * v - y * sin, z * y * v + x * sin, cos + z * z * v],
    ]
}

/// What a camera in the bore sees of the teeth at +x: the nearest surface along x, for 250 rows across and 400 columns
/// along the axis; 5 µm of noise, one point in 200 wild.
fn view() -> Vec<P> {
    const ROWS: usize = 250;
    const COLUMNS: usize = FEATURE_POINTS / ROWS;
    let meshing = Meshing {
        chord_error_mm: 0.2e-3,
        body_chord_error_mm: 0.5,
        axial_slices: 1,
    };
    let Ok(mesh) = gear().mesh(&meshing) else {
        return Vec::new();
    };
    let edges: Vec<[P; 2]> = surface_only(&mesh)
        .iter()
        .flat_map(|t| {
            let c = t.map(|i| mesh.vertices[i as usize]);
            [[c[0], c[1]], [c[1], c[2]], [c[2], c[0]]]
        })
        .filter(|e| e.iter().all(|p| p[2] == 0.0 && p[0] > 30.0))
        .collect();
    let mut random = Random(3);
    let mut points = Vec::with_capacity(FEATURE_POINTS);
    for row in 0..ROWS {
        let y = -3.1 + 6.2 * (row as f64 + 0.5) / ROWS as f64;
        let x = edges
            .iter()
            .filter(|[a, b]| (a[1] - y) * (b[1] - y) <= 0.0 && a[1] != b[1])
            .map(|[a, b]| a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]))
            .fold(f64::INFINITY, f64::min);
        for column in 0..COLUMNS {
            let z = 28.0 + 10.0 * (column as f64 + 0.5) / COLUMNS as f64;
            let wild = random.uniform() < 0.005;
            let off = if wild { 0.5 } else { 0.005 } * random.normal();
            points.push([x + off, y, z]);
        }
    }
    points
}

/// Points uniform by area, moved off the surface by normal noise.
fn sample(mesh: &Mesh, count: usize, noise_mm: f64, random: &mut Random) -> Vec<P> {
    let corners = |t: usize| mesh.triangles[t].map(|i| mesh.vertices[i as usize]);
    let minus = |a: P, b: P| -> P { std::array::from_fn(|k| a[k] - b[k]) };
    let cross = |t: usize| -> P {
        let [a, b, c] = corners(t);
        let (u, v) = (minus(b, a), minus(c, a));
        [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ]
    };
    let norm = |v: P| v.iter().map(|c| c * c).sum::<f64>().sqrt();
    let mut total = 0.0;
    let running: Vec<f64> = (0..mesh.triangles.len())
        .map(|t| {
            total += norm(cross(t));
            total
        })
        .collect();
    (0..count)
        .map(|_| {
            let target = random.uniform() * total;
            let t = running.partition_point(|&sum| sum <= target);
            let t = t.min(running.len() - 1);
            let ([a, b, c], n) = (corners(t), cross(t));
            let (s, v) = (random.uniform().sqrt(), random.uniform());
            let off = noise_mm * random.normal() / norm(n);
            std::array::from_fn(|k| {
                a[k] * (1.0 - s) + b[k] * s * (1.0 - v) + c[k] * s * v + off * n[k]
            })
        })
        .collect()
}

/// SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Box and Muller.
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }
}

fn cloud(folder: &Path, name: &str, points: &[P]) -> Result<(), String> {
    save(folder, name, |out| {
        points
            .as_flattened()
            .iter()
            .try_for_each(|c| out.write_all(&c.to_le_bytes()))
    })
}

fn save(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&mut BufWriter<std::fs::File>) -> std::io::Result<()>,
) -> Result<(), String> {
    let path = folder.join(name);
    let result = std::fs::File::create(&path).and_then(|file| {
        let mut out = BufWriter::with_capacity(1 << 20, file);
        write(&mut out)?;
        out.flush()
    });
    result.map_err(|error| format!("{}: {error}", path.display()))
}
