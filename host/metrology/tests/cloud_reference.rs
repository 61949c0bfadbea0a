//! Clouds laid on clouds: against known motions of surfaces in closed form.

mod support;

use flankscope_foundation::rigid::Rigid;
use flankscope_metrology::cloud_surface::CloudSurface;
use flankscope_metrology::registration::{
    Options, Registration, RegistrationFailure, RegistrationTarget, Status, register,
};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use support::Random;

const NOISE_MM: f64 = 0.005;

/// Waves of 0.5 mm, no two directions alike.
fn waves(x: f64, y: f64) -> f64 {
    0.5 * (x + 0.3 * y).sin() * (0.7 * y).cos()
}

/// Random places with `low` <= x < `high` and |y| < 5 mm, with noise in all directions.
fn drawn(
    surface: impl Fn(f64, f64) -> f64,
    count: usize,
    [low, high]: [f64; 2],
    seed: u64,
) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| {
            let x = low + (high - low) * random.uniform();
            let y = 10.0 * random.uniform() - 5.0;
            [x, y, surface(x, y)].map(|c| c + NOISE_MM * random.normal())
        })
        .collect()
}

fn moved(points: &[[f64; 3]], by: &Isometry3<f64>) -> Vec<[f64; 3]> {
    let moved = |&p: &[f64; 3]| (by * Point3::from(p)).into();
    points.iter().map(moved).collect()
}

fn motion() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.010, -0.012, 0.015));
    Isometry3::from_parts(Vector3::new(0.10, -0.15, 0.08).into(), turn)
}

fn options() -> Options {
    Options {
        capture_mm: 1.0,
        most_inlier_mm: 0.05,
        ..Options::for_noise(NOISE_MM)
    }
}

/// Largest distance of a corner of the patch from where it belongs.
fn error_mm(found: &Registration, motion: &Isometry3<f64>) -> f64 {
    let left = found.tool_from_cloud.isometry() * motion;
    let corners = [[-5.0, -5.0], [-5.0, 5.0], [5.0, -5.0], [5.0, 5.0]];
    corners
        .iter()
        .map(|&[x, y]| {
            let corner = Point3::new(x, y, 0.0);
            (left * corner - corner).norm()
        })
        .fold(0.0, f64::max)
}

/// A plane through points of a curved surface lies off it by curvature times radius squared over four at most: 20 of 40 000
/// points on 100 mm2 reach 0.126 mm, the waves bend by 0.55 / mm. Noise adds 5 um over the root of what it is averaged over.
const BENT_MM: f64 = 0.55 * 0.126 * 0.126 / 4.0;

#[test]
fn a_cloud_comes_back_onto_another_of_the_same_surface() {
    let reference = CloudSurface::new(&drawn(waves, 40_000, [-5.0, 5.0], 1), NOISE_MM).unwrap();
    let cloud = moved(&drawn(waves, 20_000, [-5.0, 5.0], 2), &motion());
    let found = register(&reference, &cloud, None, &options());
    assert_eq!(found.status, Status::Registered);
    let error_mm = error_mm(&found, &motion());
    assert!(error_mm < BENT_MM, "{error_mm}");
    // Noise of both clouds, the reference's averaged over a neighbourhood.
    let expected_mm = NOISE_MM * (1.0_f64 + 3.0 / 20.0).sqrt();
    assert!(
        (found.noise_mm - expected_mm).abs() < BENT_MM,
        "{} instead of {expected_mm}",
        found.noise_mm
    );
}

#[test]
fn what_lies_beyond_the_other_cloud_pulls_nothing() {
    // Beyond x = 1 the reference has nothing: two fifths of the cloud have no partner.
    let reference = CloudSurface::new(&drawn(waves, 24_000, [-5.0, 1.0], 3), NOISE_MM).unwrap();
    let cloud = moved(&drawn(waves, 20_000, [-5.0, 5.0], 4), &motion());
    let found = register(&reference, &cloud, None, &options());
    assert_eq!(found.status, Status::Registered);
    let share = found.inliers as f64 / cloud.len() as f64;
    assert!((0.55..0.65).contains(&share), "{share}");
    // Held on six tenths of the length, the far corner moves up to three times as far.
    let error_mm = error_mm(&found, &motion());
    assert!(error_mm < 3.0 * BENT_MM, "{error_mm}");
}

#[test]
fn what_a_cloud_cannot_tell_is_not_registered() {
    let plane = |_: f64, _: f64| 0.0;
    let reference = CloudSurface::new(&drawn(plane, 10_000, [-5.0, 5.0], 5), NOISE_MM).unwrap();
    let cloud = drawn(plane, 5_000, [-4.0, 4.0], 6);
    let found = register(&reference, &cloud, None, &options());
    assert!(
        matches!(
            found.status,
            Status::Indeterminate(RegistrationFailure::Unconstrained { .. })
        ),
        "{:?}",
        found.status
    );
    let far = Options {
        initial: Rigid::from_isometry(Isometry3::translation(0.0, 0.0, 30.0)),
        ..options()
    };
    let found = register(&reference, &cloud, None, &far);
    assert!(
        matches!(
            found.status,
            Status::Indeterminate(RegistrationFailure::Disjoint { .. })
        ),
        "{:?}",
        found.status
    );
}

#[test]
fn distances_are_those_to_the_plane_and_beyond_the_rim_to_the_rim() {
    let flat: Vec<[f64; 3]> = (0..10_000)
        .map(|i| [0.1 * f64::from(i % 100), 0.1 * f64::from(i / 100), 2.0])
        .collect();
    let flat = CloudSurface::new(&flat, NOISE_MM).unwrap();
    let distance_mm = flat.distance_mm([3.03, 4.07, 2.5]);
    assert!((distance_mm - 0.5).abs() < 1e-9, "{distance_mm}");
    let distance_mm = flat.distance_mm([9.9 + 3.0, 5.0, 2.0 + 4.0]);
    assert!((distance_mm - 5.0).abs() < 1e-9, "{distance_mm}");
    let mut smooth = [false; 3];
    let asked = [[3.0, 4.0, 2.1], [12.0, 5.0, 2.0], [5.0, 5.0, 1.9]];
    flat.each_foot(&asked, &mut smooth, |foot, smooth| {
        *smooth = foot.smooth;
        let upright = foot.normal[2].abs();
        assert!((upright - 1.0).abs() < 1e-9, "{upright}");
    });
    assert_eq!(smooth, [true, false, true]);
}

#[test]
fn sharp_edges_are_left_out_and_blunt_ones_are_not() {
    // A roof whose faces meet at the angle given, seen at its ridge and 2 mm beside it.
    let seen = |between_deg: f64, noise_mm: f64| {
        let slope = (0.5 * between_deg).to_radians().tan();
        let mut random = Random::new(7);
        let roof: Vec<[f64; 3]> = (0..20_000)
            .map(|_| {
                let (x, y) = (10.0 * random.uniform() - 5.0, 10.0 * random.uniform());
                [x, y, -slope * x.abs() + noise_mm * random.normal()]
            })
            .collect();
        let surface = CloudSurface::new(&roof, noise_mm).unwrap();
        let ridge = (0..200).map(|i| [0.0, 1.0 + 0.04 * f64::from(i), 0.0]);
        let beside = (0..200).map(|i| [2.0, 1.0 + 0.04 * f64::from(i), -2.0 * slope]);
        let asked: Vec<[f64; 3]> = ridge.chain(beside).collect();
        let mut smooth = vec![false; 400];
        surface.each_foot(&asked, &mut smooth, |foot, smooth| *smooth = foot.smooth);
        let count = |part: &[bool]| part.iter().filter(|&&smooth| smooth).count();
        (count(&smooth[..200]), count(&smooth[200..]))
    };
    let (ridge, beside) = seen(60.0, 0.0);
    assert!(ridge < 5 && beside == 200, "{ridge} {beside}");
    let (ridge, beside) = seen(10.0, 0.0);
    assert!(ridge == 200 && beside == 200, "{ridge} {beside}");
    // Noise as large as the neighbourhood is wide is no edge.
    let (_, beside) = seen(10.0, 0.05);
    assert!(beside > 190, "{beside}");
}

#[test]
fn a_handful_of_points_is_no_surface() {
    let few = drawn(waves, 19, [-5.0, 5.0], 8);
    let error = CloudSurface::new(&few, NOISE_MM).err().unwrap();
    assert_eq!(
        error.to_string(),
        "19 reference points cannot be searched; right would be 20 to 4294967295"
    );
}
