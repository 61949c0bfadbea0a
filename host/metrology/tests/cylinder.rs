//! The unrolled map against closed forms: weights by hand, form from its own terms.

use std::f64::consts::{PI, TAU};

use flankscope_metrology::multiview::cylinder::{Around, CylinderMap, Layout, cell_observations};
use flankscope_metrology::surface::{Closest, Feature};

const LAYOUT: Layout = Layout {
    columns: 72,
    rows: 20,
    height_mm: [0.0, 66.0],
    around: Around::Angle,
};
/// What the map grants a view's pose, mm.
const VIEW_MM: f64 = 1e-3;

/// A point over the wall of a bore of 41.5 mm at an angle and height, `off_mm` proud of it.
fn hit(angle_rad: f64, z_mm: f64, off_mm: f64) -> Closest {
    let (sin, cos) = angle_rad.sin_cos();
    Closest {
        point: [41.5 * cos, 41.5 * sin, z_mm],
        signed_distance_mm: off_mm,
        // Outward of the material: towards the axis.
        normal: [-cos, -sin, 0.0],
        triangle: 0,
        feature: Feature::Face,
        smoothness: 1.0,
    }
}

/// Adds one view by its points.
fn add(map: &mut CylinderMap, hits: &[Closest], sigma_mm: &[f32]) {
    map.add_view(&cell_observations(&LAYOUT, hits, sigma_mm), |_| 0.0);
}

#[test]
fn form_comes_back_as_it_was_put_in() {
    let mut map = CylinderMap::new(LAYOUT);
    let radial_mm = |angle: f64, z: f64| {
        2e-3 + 0.4e-3 * angle.cos() - 0.7e-3 * angle.sin()
            + 10e-3 * (2.0 * (angle - 0.3)).cos()
            + 15e-3 * (z / 66.0 - 0.5)
    };
    for row in 0..LAYOUT.rows {
        let z = 66.0 * (row as f64 + 0.5) / LAYOUT.rows as f64;
        let hits: Vec<Closest> = (0..LAYOUT.columns)
            .map(|column| {
                let angle = TAU * ((column as f64 + 0.5) / LAYOUT.columns as f64 - 0.5);
                // A bore that is larger has material missing along its inward normal.
                hit(angle, z, -radial_mm(angle, z))
            })
            .collect();
        add(&mut map, &hits, &vec![1e-3; hits.len()]);
    }
    assert_eq!(map.coverage(), 1.0);
    let form = map.form().unwrap();
    for (what, got, put_in) in [
        ("size", form.size_mm, 2e-3),
        ("ovality", form.ovality_mm, 20e-3),
        ("taper", form.taper_mm, 15e-3),
        ("direction", form.ovality_rad, 0.3),
    ] {
        // Witnesses keep places as f32: 4 nm of 41.5 mm, some 1e-7 of a form.
        assert!((got - put_in).abs() < 1e-8, "{what}: {got} for {put_in}");
    }
}

#[test]
fn a_cell_weighs_views_by_what_they_know_and_says_when_they_disagree() {
    let at = |off_mm| vec![hit(0.01, 10.0, off_mm)];
    let cell = |map: &CylinderMap| map.cells().next().unwrap();
    let (a, b) = (3e-3_f64, 1e-3_f64);

    let mut agreeing = CylinderMap::new(LAYOUT);
    add(&mut agreeing, &at(10e-3), &[a as f32]);
    add(&mut agreeing, &at(11e-3), &[b as f32]);
    let weight = |sigma: f64| 1.0 / (sigma * sigma + VIEW_MM * VIEW_MM);
    let (wa, wb) = (weight(a), weight(b));
    let mean_mm = (wa * 10e-3 + wb * 11e-3) / (wa + wb);
    let got = cell(&agreeing);
    // Sigmas come as f32.
    assert!((got.deviation_mm - mean_mm).abs() < 1e-9);
    assert!(
        (got.sigma_mm - (wa + wb).powf(-0.5)).abs() < 1e-9,
        "no variance between them"
    );
    assert_eq!((got.views, got.inconsistent), (2, false));

    let mut quarrelling = CylinderMap::new(LAYOUT);
    add(&mut quarrelling, &at(0.0), &[b as f32]);
    add(&mut quarrelling, &at(40e-3), &[b as f32]);
    let got = cell(&quarrelling);
    // DerSimonian and Laird for two equal weights w: Q = w d²/2, τ² = (Q - 1) / w.
    let w = weight(b);
    let between = (w * 40e-3_f64.powi(2) / 2.0 - 1.0) / w;
    let expected = (1.0 / (2.0 * w) + between / 2.0).sqrt();
    assert!((got.deviation_mm - 20e-3).abs() < 1e-9);
    assert!(
        (got.sigma_mm - expected).abs() < 1e-8,
        "{} for {expected}",
        got.sigma_mm
    );
    assert!(got.inconsistent);
}

#[test]
fn points_of_one_view_are_one_witness() {
    let mut map = CylinderMap::new(LAYOUT);
    let hits = vec![hit(0.01, 10.0, 5e-3); 400];
    add(&mut map, &hits, &[1e-3; 400]);
    let cell = map.cells().next().unwrap();
    assert_eq!(cell.views, 1);
    // However many points: no surer than a view's pose.
    assert!(cell.sigma_mm >= VIEW_MM, "{} mm", cell.sigma_mm);
}

#[test]
fn edges_strangers_and_points_beside_the_height_do_not_count() {
    let mut map = CylinderMap::new(LAYOUT);
    let edge = Closest {
        smoothness: 0.5,
        ..hit(0.0, 10.0, 1e-3)
    };
    let hits = [
        edge,
        hit(0.0, 10.0, 0.9),
        hit(0.0, -0.5, 1e-3),
        hit(PI, 66.5, 1e-3),
    ];
    add(&mut map, &hits, &[1e-3; 4]);
    assert_eq!(map.cells().count(), 0);
    assert!(map.form().is_none());
}
