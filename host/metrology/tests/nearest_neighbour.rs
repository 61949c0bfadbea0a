//! What a nearest neighbour in a sampled reference makes of a perfect piece, against the closed form and the exact distance.
//!
//! The distance from a place on a surface to the nearest of randomly strewn points of density rho is Rayleigh distributed:
//! mean 1/(2 sqrt(rho)), standard deviation sqrt((4 - pi) / (4 pi rho)). At the densities of an article that reports
//! 36 +- 19 um for one view and 74 +- 37 um for all (about 200 and 50 points per mm2) this alone is what it reports.

use flankscope_metrology::deviation::{Order, SampleTree, deviations, statistics};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::surface::Surface;
use flankscope_metrology::surface::sampling::sample;

/// Side of the square, mm, and the margin at which probes keep off its edges.
const SIDE_MM: f64 = 20.0;
const MARGIN_MM: f64 = 1.0;
const NOISE_MM: f64 = 5e-3;
const PROBES: usize = 20_000;

fn square() -> TriMesh {
    let s = SIDE_MM;
    TriMesh {
        vertices: vec![[0.0, 0.0, 0.0], [s, 0.0, 0.0], [s, s, 0.0], [0.0, s, 0.0]],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// Points on the square with normal noise along z: the sum of twelve uniform numbers of the sampler itself.
fn probes(mesh: &TriMesh) -> Vec<[f64; 3]> {
    let uniform: Vec<f64> = sample(mesh, 12 * PROBES, 77)
        .expect("a square")
        .iter()
        .map(|p| p[0] / SIDE_MM)
        .collect();
    let inner = |c: f64| MARGIN_MM + c * (SIDE_MM - 2.0 * MARGIN_MM) / SIDE_MM;
    sample(mesh, PROBES, 5)
        .expect("a square")
        .iter()
        .zip(uniform.chunks(12))
        .map(|(p, twelve)| {
            let noise = twelve.iter().sum::<f64>() - 6.0;
            [inner(p[0]), inner(p[1]), NOISE_MM * noise]
        })
        .collect()
}

#[test]
fn the_nearest_neighbour_metric_reports_its_own_sampling_and_the_exact_one_the_noise() {
    let mesh = square();
    let probes = probes(&mesh);
    for (per_mm2, reported_um) in [(200.0, [36.0, 19.0]), (50.0, [74.0, 37.0])] {
        let count = (per_mm2 * SIDE_MM * SIDE_MM) as usize;
        let reference = sample(&mesh, count, 1).expect("a square");
        let tree = SampleTree::new(&reference).expect("finite points");
        let distances = tree.distances(&probes, Order::Two);
        let got = statistics(&distances).expect("distances");
        let pi = std::f64::consts::PI;
        let mean_mm = 0.5 / f64::sqrt(per_mm2);
        let std_mm = ((4.0 - pi) / (4.0 * pi * per_mm2)).sqrt();
        // The noise adds its square over twice the distance: 0.35 µm at 36 µm. The means of neighbouring probes are not
        // independent: 3 % covers both.
        assert!(
            (got.mean_mm / mean_mm - 1.0).abs() < 0.03,
            "{} mm against {mean_mm} mm",
            got.mean_mm
        );
        assert!(
            (got.std_mm / std_mm - 1.0).abs() < 0.03,
            "{} mm against {std_mm} mm",
            got.std_mm
        );
        // And that is what was reported, to a few µm.
        assert!(
            (got.mean_mm * 1e3 - reported_um[0]).abs() < 4.0,
            "{} µm",
            got.mean_mm * 1e3
        );
        assert!(
            (got.std_mm * 1e3 - reported_um[1]).abs() < 2.0,
            "{} µm",
            got.std_mm * 1e3
        );
    }
    let exact = deviations(&Surface::new(&mesh).expect("a square"), &probes);
    let exact = statistics(&exact).expect("distances");
    // The standard deviation of n normal numbers is known to 1/sqrt(2 n): five of these are 2.5 %.
    assert!(
        (exact.std_mm / NOISE_MM - 1.0).abs() < 0.025,
        "{} mm",
        exact.std_mm
    );
    assert!(exact.mean_mm.abs() < 5.0 * NOISE_MM / f64::sqrt(PROBES as f64));
}

/// The closed form over all densities that the article allows (docs/density.md), against a search through all points.
#[test]
fn the_closed_form_holds_from_three_to_seventeen_hundred_points_per_mm2() {
    const COUNT: usize = 4000;
    for per_mm2 in [2.9, 45.5, 151.0, 603.0, 1711.0] {
        let side = (COUNT as f64 / per_mm2).sqrt();
        let square = TriMesh {
            vertices: square()
                .vertices
                .iter()
                .map(|p| p.map(|c| c / SIDE_MM * side))
                .collect(),
            triangles: square().triangles,
        };
        let reference = sample(&square, COUNT, 3).expect("a square");
        // A tenth of the side off its edges: six mean spacings of these points.
        let probes = sample(&square, 2000, 4).expect("a square");
        let inner = |p: &&[f64; 3]| p[..2].iter().all(|c| (0.1..0.9).contains(&(c / side)));
        let nearest: Vec<f64> = probes
            .iter()
            .filter(inner)
            .map(|p| {
                let to = |q: &[f64; 3]| (p[0] - q[0]).hypot(p[1] - q[1]);
                reference.iter().map(to).fold(f64::INFINITY, f64::min)
            })
            .collect();
        let got = statistics(&nearest).expect("distances");
        let mean_mm = 0.5 / f64::sqrt(per_mm2);
        let std_mm = mean_mm * (4.0 / std::f64::consts::PI - 1.0).sqrt();
        // 1300 probes among 2600 points: means to 2 %, standard deviations to 3 %; three times that.
        assert!(
            (got.mean_mm / mean_mm - 1.0).abs() < 0.06,
            "{per_mm2}: {}",
            got.mean_mm
        );
        assert!(
            (got.std_mm / std_mm - 1.0).abs() < 0.09,
            "{per_mm2}: {}",
            got.std_mm
        );
    }
}
