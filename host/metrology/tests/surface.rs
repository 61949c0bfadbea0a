//! The distance against brute force, the sign against the winding number: two oracles that share nothing with the hierarchy
//! or the pseudo-normals.

mod support;

use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::surface::{Feature, Surface};
use nalgebra::{Rotation3, Vector3};
use support::{Random, on_every_ring84};

type V = Vector3<f64>;

/// Distance to a triangle by cases: the foot point if it lies inside by edge side tests, else the nearest edge.
fn triangle_distance(p: V, corners: [V; 3]) -> f64 {
    let segment = |a: V, b: V| {
        let ab = b - a;
        let length2 = ab.norm_squared();
        let t = if length2 > 0.0 {
            ((p - a).dot(&ab) / length2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (p - (a + ab * t)).norm()
    };
    let [a, b, c] = corners;
    let mut least = segment(a, b).min(segment(b, c)).min(segment(c, a));
    let cross = (b - a).cross(&(c - a));
    let area2 = cross.norm();
    let longest2 = (b - a)
        .norm_squared()
        .max((c - b).norm_squared())
        .max((a - c).norm_squared());
    if area2 > 1e-12 * longest2 {
        let n = cross / area2;
        let inside = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|&(from, to)| n.cross(&(to - from)).dot(&(p - from)) >= 0.0);
        if inside {
            least = least.min(n.dot(&(p - a)).abs());
        }
    }
    least
}

fn brute_force(mesh: &TriMesh, p: [f64; 3]) -> f64 {
    (0..mesh.triangles.len())
        .map(|i| triangle_distance(V::from(p), mesh.corners(i).map(V::from)))
        .fold(f64::INFINITY, f64::min)
}

/// Solid angle of the closed mesh seen from `p` over 4 pi (van Oosterom and Strackee 1983): 1 inside, 0 outside.
fn winding(mesh: &TriMesh, p: [f64; 3]) -> f64 {
    let total: f64 = (0..mesh.triangles.len())
        .map(|i| {
            let [a, b, c] = mesh.corners(i).map(|v| V::from(v) - V::from(p));
            let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
            let top = a.dot(&b.cross(&c));
            let bottom = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            2.0 * top.atan2(bottom)
        })
        .sum();
    total / (4.0 * std::f64::consts::PI)
}

/// Points on faces, edges and corners of the mesh, moved off by a random vector of the given length.
fn probes(mesh: &TriMesh, count: usize, random: &mut Random) -> Vec<[f64; 3]> {
    (0..count)
        .map(|i| {
            let triangle = (random.uniform() * mesh.triangles.len() as f64) as usize;
            let [a, b, c] = mesh.corners(triangle).map(V::from);
            let (u, v) = (random.uniform(), random.uniform());
            let base = match i % 3 {
                0 => a * (1.0 - u) + (b * (1.0 - v) + c * v) * u,
                1 => a * (1.0 - u) + b * u,
                _ => c,
            };
            let length = [0.0, 1e-9, 1e-6, 1e-3, 0.01, 0.3, 5.0, 100.0][(i / 3) % 8];
            let off = V::new(random.normal(), random.normal(), random.normal());
            (base + off / off.norm().max(1e-9) * length).into()
        })
        .collect()
}

fn check(name: &str, mesh: &TriMesh, count: usize, closed: bool) {
    let surface = Surface::new(mesh).unwrap();
    let mut random = Random::new(11);
    let points = probes(mesh, count, &mut random);
    let found = surface.closest_many(&points);
    let mut seen = [0usize; 3];
    for (&p, closest) in points.iter().zip(&found) {
        let expected = brute_force(mesh, p);
        let distance = closest.signed_distance_mm.abs();
        assert!(
            (distance - expected).abs() < 1e-9,
            "{name}: {p:?}: {distance} instead of {expected}"
        );
        let reach = (V::from(p) - V::from(closest.point)).norm();
        assert!(
            (reach - expected).abs() < 1e-9,
            "{name}: {p:?}: the point is {reach} away"
        );
        let alone = surface.closest(p).signed_distance_mm;
        assert!(
            (alone - closest.signed_distance_mm).abs() < 1e-12 || expected < 1e-7,
            "{name}: {p:?}: batch differs"
        );
        seen[match closest.feature {
            Feature::Face => 0,
            Feature::Edge(_) => 1,
            Feature::Corner(_) => 2,
        }] += 1;
        // On the surface itself the sign has no meaning and the winding number no value.
        if closed && expected > 1e-7 {
            let inside = winding(mesh, p);
            assert!(
                (inside - inside.round()).abs() < 1e-3,
                "{name}: oracle undecided: {inside}"
            );
            assert_eq!(
                closest.signed_distance_mm < 0.0,
                inside.round() == 1.0,
                "{name}: {p:?}: sign of {} at {:?}",
                closest.signed_distance_mm,
                closest.feature
            );
        }
    }
    assert!(
        seen.iter().all(|&n| n > 20),
        "{name}: face/edge/corner hits {seen:?}"
    );
}

/// A closed star-shaped body with random radii: ridges and valleys at all angles.
fn spiky(seed: u64, stacks: usize, slices: usize) -> TriMesh {
    let mut random = Random::new(seed);
    let mut vertices = vec![[0.0, 0.0, 9.0], [0.0, 0.0, -9.0]];
    for i in 1..stacks {
        let polar = std::f64::consts::PI * i as f64 / stacks as f64;
        for j in 0..slices {
            let around = std::f64::consts::TAU * j as f64 / slices as f64;
            let r = 4.0 + 6.0 * random.uniform();
            vertices.push([
                r * polar.sin() * around.cos(),
                r * polar.sin() * around.sin(),
                r * polar.cos(),
            ]);
        }
    }
    let at = |i: usize, j: usize| (2 + (i - 1) * slices + j % slices) as u32;
    let mut triangles = Vec::new();
    for j in 0..slices {
        triangles.push([0, at(1, j), at(1, j + 1)]);
        triangles.push([1, at(stacks - 1, j + 1), at(stacks - 1, j)]);
        for i in 1..stacks - 1 {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let turn = Rotation3::from_euler_angles(0.3, -0.7, 1.1);
    for vertex in &mut vertices {
        *vertex = (turn * V::from(*vertex) + V::new(40.0, -3.0, 12.0)).into();
    }
    TriMesh {
        vertices,
        triangles,
    }
}

/// A long thin box, cut into slivers of 66 mm x 0.1 mm and turned off the axes.
fn slivers() -> TriMesh {
    let n = 12;
    let mut vertices = Vec::new();
    for i in 0..n {
        let angle = std::f64::consts::TAU * i as f64 / n as f64;
        let r = if i % 2 == 0 { 0.3 } else { 0.22 };
        for z in [0.0, 66.0] {
            vertices.push([r * angle.cos(), r * angle.sin(), z]);
        }
    }
    let mut triangles = Vec::new();
    for i in 0..n as u32 {
        let (a, b) = (2 * i, 2 * ((i + 1) % n as u32));
        triangles.push([a, b, b + 1]);
        triangles.push([a, b + 1, a + 1]);
        let centre = 2 * n as u32;
        triangles.push([centre, b, a]);
        triangles.push([centre + 1, a + 1, b + 1]);
    }
    vertices.extend([[0.0, 0.0, 0.0], [0.0, 0.0, 66.0]]);
    let turn = Rotation3::from_euler_angles(0.6, 0.4, -0.2);
    for vertex in &mut vertices {
        *vertex = (turn * V::from(*vertex) + V::new(30.0, 20.0, -10.0)).into();
    }
    TriMesh {
        vertices,
        triangles,
    }
}

/// A cube whose top edge carries a T-junction closed by a sliver without area, with doubled corners and a repeated one.
fn degenerate_cube() -> TriMesh {
    let mut vertices: Vec<[f64; 3]> = (0..8)
        .map(|i| {
            [
                f64::from(i & 1),
                f64::from(i >> 1 & 1),
                f64::from(i >> 2 & 1),
            ]
            .map(|c| 4.0 * c)
        })
        .collect();
    // Middle of the edge between corners 4 and 5, and a copy of corner 7.
    vertices.push([2.0, 0.0, 4.0]);
    vertices.push(vertices[7]);
    let triangles = vec![
        [0, 2, 1],
        [1, 2, 3], // bottom
        [4, 8, 6],
        [8, 5, 9],
        [8, 9, 6], // top, split at the T-junction, with the copied corner
        [4, 5, 8], // no area
        [0, 1, 5],
        [0, 5, 4], // front, not split
        [2, 7, 3],
        [2, 6, 7], // back
        [0, 4, 6],
        [0, 6, 2], // left
        [1, 3, 7],
        [1, 7, 5], // right
        [3, 7, 9], // repeats a corner once joined
    ];
    TriMesh {
        vertices,
        triangles,
    }
}

#[test]
fn random_bodies_agree_with_brute_force() {
    for seed in 1..=4 {
        check(&format!("spiky {seed}"), &spiky(seed, 12, 18), 2400, true);
    }
}

#[test]
fn slivers_agree_with_brute_force() {
    check("slivers", &slivers(), 2400, true);
}

#[test]
fn triangles_without_area_agree_with_brute_force() {
    check("degenerate cube", &degenerate_cube(), 2400, true);
}

#[test]
fn ring_gears_agree_with_brute_force() {
    on_every_ring84(run_ring_gears);
}

fn run_ring_gears(mesh: TriMesh) {
    check("ring84", &mesh, 3000, true);
}

#[test]
fn a_large_mesh_built_in_parallel_agrees_with_brute_force() {
    check("large", &spiky(9, 80, 120), 240, true);
}

#[test]
fn one_and_many_threads_give_the_same_bytes() {
    let mesh = spiky(5, 80, 120);
    let points = probes(&mesh, 20_000, &mut Random::new(3));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let surface = Surface::new(&mesh).unwrap();
            let distances = flankscope_metrology::deviation::deviations(&surface, &points);
            let statistics = flankscope_metrology::deviation::statistics(&distances).unwrap();
            let bits: Vec<u64> = distances.iter().map(|d| d.to_bits()).collect();
            (bits, statistics.rms_mm.to_bits())
        })
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn a_part_of_the_surface_measures_like_the_whole_near_by() {
    let mesh = spiky(6, 20, 30);
    let whole = Surface::new(&mesh).unwrap();
    let points: Vec<[f64; 3]> = probes(&mesh, 3000, &mut Random::new(8));
    let wall = 40.0;
    let part = whole.restrict(|aabb| aabb.low[0] <= wall).unwrap();
    let mut compared = 0;
    for p in points {
        let expected = whole.closest(p);
        if expected.point[0] < wall - 1e-6 {
            compared += 1;
            // A point on the surface is 1e-15 mm off it to either side, by the triangle that is asked first.
            let off = part.closest(p).signed_distance_mm - expected.signed_distance_mm;
            assert!(off.abs() < 1e-12, "{off}");
        }
    }
    assert!(compared > 500);
    assert!(whole.restrict(|_| false).is_none());
}

/// Squares of such distances do not fit f32, in which the search compares boxes.
#[test]
fn points_beyond_all_measure_are_measured_too() {
    let mesh = spiky(11, 5, 7);
    let surface = Surface::new(&mesh).unwrap();
    let near = [0.2, 0.3, 0.4];
    let expected = brute_force(&mesh, near);
    for far in [1e15, 1e19, 1e25, 1e39, 1e150] {
        let away = [0.0, 0.6 * far, -0.8 * far];
        let distance = |p| surface.closest(p).signed_distance_mm;
        assert!((distance(away) / far - 1.0).abs() < 1e-12, "{far}");
        // A far point in a packet must not spoil its neighbours, wherever it stands.
        for points in [vec![near, away, near], vec![near, away], vec![away, near]] {
            for (p, found) in points.iter().zip(surface.closest_many(&points)) {
                let distance = found.signed_distance_mm;
                if *p == near {
                    assert!(
                        (distance.abs() - expected).abs() < 1e-9,
                        "{far}: {distance}"
                    );
                } else {
                    assert!((distance / far - 1.0).abs() < 1e-12, "{far}: {distance}");
                }
            }
        }
    }
}
