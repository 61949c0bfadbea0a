//! Random surface points: uniform by area, the same for any thread count; and what they do to the nearest-point metric.

mod support;

use flankscope_metrology::deviation::{Order, SampleTree, deviations, statistics};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::surface::Surface;
use flankscope_metrology::surface::sampling::{self, Region, SampleError};
use support::Random;

/// Two triangles with areas 1 : 3, far apart, and one without area.
fn unequal() -> TriMesh {
    TriMesh {
        vertices: vec![
            [0.0, 0.0, 0.0],
            [2.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [10.0, 0.0, 5.0],
            [13.0, 0.0, 5.0],
            [10.0, 2.0, 5.0],
        ],
        triangles: vec![[0, 1, 2], [0, 1, 1], [3, 4, 5]],
    }
}

#[test]
fn points_are_uniform_by_area_between_and_inside_triangles() {
    let n = 100_000;
    let points = sampling::sample(&unequal(), n, 3).unwrap();
    let first: Vec<_> = points.iter().filter(|p| p[2] == 0.0).collect();
    // Binomial: 25 % of 100 000 with a standard deviation of 137; five of them are allowed.
    assert!(
        (first.len() as f64 - 25_000.0).abs() < 5.0 * 137.0,
        "{}",
        first.len()
    );
    // The corner triangles at half size hold a quarter each: every one of the four parts does.
    let part = |test: &dyn Fn(f64, f64) -> bool| {
        let inside = first.iter().filter(|p| test(p[0] / 2.0, p[1])).count();
        inside as f64 / first.len() as f64
    };
    for share in [
        part(&|u, _| u > 0.5),
        part(&|_, v| v > 0.5),
        part(&|u, v| u + v < 0.5),
        part(&|u, v| u <= 0.5 && v <= 0.5 && u + v >= 0.5),
    ] {
        // Standard deviation sqrt(0.25 x 0.75 / 25 000) = 0.0027.
        assert!((share - 0.25).abs() < 5.0 * 0.0027, "{share}");
    }
    assert!(points.iter().all(|p| p[0] >= 0.0 && p[1] >= 0.0));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let run = |threads: usize, seed| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| sampling::sample(&unequal(), 30_000, seed).unwrap())
    };
    assert_eq!(run(1, 9), run(4, 9));
    assert_ne!(run(1, 9), run(1, 10));
}

#[test]
fn nothing_to_sample_is_named() {
    assert_eq!(
        sampling::sample(&unequal(), 0, 1),
        Err(SampleError::NoPoints)
    );
    let mut flat = unequal();
    flat.triangles = vec![[0, 1, 1]];
    assert!(matches!(
        sampling::sample(&flat, 5, 1),
        Err(SampleError::NoArea { triangles: 1, .. })
    ));
}

#[test]
fn the_region_is_a_window_about_the_centre_of_mass_across_the_seam_at_pi() {
    let region = Region::default();
    let centre = [-42.0, -0.1, 30.0];
    let at =
        |angle: f64, radius: f64, height: f64| [radius * angle.cos(), radius * angle.sin(), height];
    let pi = std::f64::consts::PI;
    assert!(region.contains(centre, at(pi - 0.19, 42.0, 39.0)));
    assert!(region.contains(centre, at(-pi + 0.19, 42.0, 21.0)));
    assert!(!region.contains(centre, at(pi - 0.21, 42.0, 30.0)));
    assert!(!region.contains(centre, at(pi, 42.0, 40.5)));
    assert!(!region.contains(centre, at(pi, 50.1, 30.0)));
}

/// The distance to the nearest of random points has the Rayleigh distribution of their spacing even for perfect points on
/// a perfect part: mean 0.5 / sqrt(density), standard deviation over mean 0.523. The distance to the surface has none of it.
#[test]
fn the_nearest_point_metric_measures_its_own_sampling() {
    let side = 20.0;
    let mesh = TriMesh {
        vertices: vec![
            [0.0, 0.0, 0.0],
            [side, 0.0, 0.0],
            [side, side, 0.0],
            [0.0, side, 0.0],
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let per_mm2 = 200.0;
    let samples = sampling::sample(&mesh, (per_mm2 * side * side) as usize, 1).unwrap();
    let mut random = Random::new(4);
    // Off the rim, where neighbours are missing; with 5 um of true noise.
    let mut coordinate = || 1.0 + (side - 2.0) * random.uniform();
    let plane: Vec<[f64; 2]> = (0..40_000).map(|_| [coordinate(), coordinate()]).collect();
    let points: Vec<[f64; 3]> = plane
        .iter()
        .map(|p| [p[0], p[1], 0.005 * random.normal()])
        .collect();

    let nearest = SampleTree::new(&samples)
        .unwrap()
        .distances(&points, Order::Two);
    let nearest = statistics(&nearest).unwrap();
    let expected_mm = 0.5 / f64::sqrt(per_mm2);
    // 80 000 samples share the plane: their own scatter moves the mean by well below 2 %; 5 um of noise adds 1 %.
    assert!(
        (nearest.mean_mm / expected_mm - 1.0).abs() < 0.04,
        "{nearest:?}"
    );
    assert!(
        (nearest.std_mm / nearest.mean_mm - 0.523).abs() < 0.02,
        "{nearest:?}"
    );

    let exact = statistics(&deviations(&Surface::new(&mesh).unwrap(), &points)).unwrap();
    assert!((exact.std_mm - 0.005).abs() < 0.1e-3, "{exact:?}");
    assert!(exact.mean_mm.abs() < 0.1e-3, "{exact:?}");
}
