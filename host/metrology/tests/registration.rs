//! Registration against known poses: tolerances in micrometres against the truth.

mod support;

use flankscope_foundation::rigid::Rigid;
use flankscope_gear_cad::{GearKind, GearSpec, Meshing};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::registration::{
    Options, Prior, Registration, RegistrationFailure, Status, detect_teeth, register,
};
use flankscope_metrology::surface::Surface;
use flankscope_metrology::surface::sampling;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use support::{Random, on_every_ring84};

const DEG: f64 = std::f64::consts::PI / 180.0;

/// A noisy view of about three teeth, 10 mm high, off the gear's inner side.
fn patch(mesh: &TriMesh, count: usize, noise_mm: f64, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let mut points = Vec::new();
    let mut round = 0;
    while points.len() < count {
        round += 1;
        for p in sampling::sample(mesh, 2_000_000, seed * 1000 + round).unwrap() {
            let angle = p[1].atan2(p[0]);
            let inside = angle.abs() < 1.5 * std::f64::consts::TAU / 84.0
                && (p[2] - 33.0).abs() < 5.0
                && p[0].hypot(p[1]) < 44.0;
            if inside && points.len() < count {
                points.push(p.map(|c| c + noise_mm * random.normal()));
            }
        }
    }
    points
}

/// A motion of 0.4 degrees about a random axis through the patch's centre and 0.1 mm in a random direction.
fn disturb(seed: u64, angle_rad: f64, shift_mm: f64) -> Isometry3<f64> {
    let mut random = Random::new(seed);
    let mut direction =
        || Vector3::new(random.normal(), random.normal(), random.normal()).normalize();
    let centre = Vector3::new(42.0, 0.0, 33.0);
    let rotation = UnitQuaternion::from_scaled_axis(direction() * angle_rad);
    let shift = direction() * shift_mm;
    Isometry3::from_parts(
        Translation3::from(centre - rotation * centre + shift),
        rotation,
    )
}

/// Root mean square over the points of where the found pose puts them against where they belong: in the plane across
/// the axis, and along it.
fn errors_mm(truth: &[[f64; 3]], moved: &[[f64; 3]], found: &Registration) -> (f64, f64) {
    let (mut across, mut along) = (0.0, 0.0);
    for (t, m) in truth.iter().zip(moved) {
        let d = Vector3::from(found.tool_from_cloud.apply(*m)) - Vector3::from(*t);
        across += d.x * d.x + d.y * d.y;
        along += d.z;
    }
    let n = truth.len() as f64;
    ((across / n).sqrt(), along / n)
}

fn moved(points: &[[f64; 3]], by: &Isometry3<f64>) -> Vec<[f64; 3]> {
    points
        .iter()
        .map(|&p| (by * Point3::from(p)).into())
        .collect()
}

#[test]
fn a_noisy_patch_comes_back_and_the_axial_direction_is_not_invented() {
    on_every_ring84(run_a_noisy_patch_comes_back);
}

fn run_a_noisy_patch_comes_back(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    for seed in 1..=3 {
        let truth = patch(&mesh, 100_000, 0.010, seed);
        let cloud = moved(&truth, &disturb(seed, 0.4 * DEG, 0.1));
        let found = register(
            &surface,
            &cloud,
            None,
            &Options {
                teeth: Some(84),
                ..Options::default()
            },
        );
        assert!(found.is_registered(), "{:?}", found.status);
        let (across, _) = errors_mm(&truth, &cloud, &found);
        println!(
            "seed {seed}: {:.4} um in the plane, {} steps, noise {:.3} um",
            1e3 * across,
            found.iterations,
            1e3 * found.noise_mm
        );
        assert!(across < 0.24e-3, "seed {seed}: {across} mm");
        assert!(
            (found.noise_mm - 0.010).abs() < 0.5e-3,
            "{}",
            found.noise_mm
        );

        assert_eq!(
            found.weak_directions.len(),
            1,
            "{:?}",
            found.weak_directions
        );
        let weak = &found.weak_directions[0];
        assert!(
            weak.vector[5] > 0.999_999 && weak.prior_share == 0.0,
            "{weak:?}"
        );
        // Not moved: the patch's centre stays at the height where the start pose put it, up to the tilt's
        // effect on the shift across: 0.4 degrees of 0.1 mm.
        let start: f64 = cloud.iter().map(|p| p[2]).sum::<f64>() / cloud.len() as f64;
        let end: f64 = cloud
            .iter()
            .map(|&p| found.tool_from_cloud.apply(p)[2])
            .sum::<f64>()
            / cloud.len() as f64;
        assert!(
            (start - end).abs() < 0.7e-3,
            "moved {} mm along the axis",
            end - start
        );
    }
}

#[test]
fn the_prior_holds_the_axial_direction_and_says_so() {
    on_every_ring84(run_the_prior_holds_the_axial_direction);
}

fn run_the_prior_holds_the_axial_direction(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    let truth = patch(&mesh, 20_000, 0.010, 4);
    // The stage is off by 10 um in x and y and by 3 um along the axis; it claims 50 um and 5 um.
    let off = Isometry3::translation(0.010, -0.010, 0.003);
    let cloud = moved(&truth, &off);
    let prior = Prior::independent(
        Rigid::from_isometry(Isometry3::identity()),
        [1e-3; 3],
        [0.05, 0.05, 0.005],
    );
    let found = register(
        &surface,
        &cloud,
        None,
        &Options {
            prior: Some(prior),
            ..Options::default()
        },
    );
    assert!(found.is_registered(), "{:?}", found.status);
    let (across, along) = errors_mm(&truth, &cloud, &found);
    assert!(across < 0.5e-3, "{across}");
    // Nothing that the points tell moves a place on the axis along it: there the prior alone speaks.
    let on_axis = found.tool_from_cloud.apply([0.0, 0.0, 33.0])[2] - 33.0;
    assert!(on_axis.abs() < 0.05e-3, "{on_axis}");
    // The patch lies 42 mm beside it: what the tilt is uncertain by moves it along the axis.
    let tilt = 42.0 * found.covariance[(1, 1)].sqrt();
    assert!(
        (along - 0.003).abs() < 3.0 * tilt,
        "axial offset must stay with the prior: {along}, {tilt}"
    );
    assert!(found.weak_directions[0].prior_share > 0.999);
    assert!(
        (found.covariance[(5, 5)].sqrt() - 0.005).abs() < 0.5e-3,
        "{}",
        found.covariance[(5, 5)].sqrt()
    );
}

#[test]
fn the_stated_covariance_is_the_scatter_of_repeated_fits() {
    on_every_ring84(run_the_stated_covariance);
}

fn run_the_stated_covariance(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    let (mut sum, mut stated) = ([0.0f64; 2], [0.0f64; 2]);
    let runs = 24;
    for seed in 0..runs {
        let truth = patch(&mesh, 2_000, 0.010, 100 + seed);
        let found = register(&surface, &truth, None, &Options::default());
        let centre = Point3::from(found.centre_mm);
        let d = found.tool_from_cloud.isometry() * centre - centre;
        for k in 0..2 {
            sum[k] += d[k] * d[k];
            stated[k] += found.covariance[(3 + k, 3 + k)];
        }
    }
    for k in 0..2 {
        // The variance of 24 values scatters by 29 % (one sigma); robust weights lose about 5 %.
        let ratio = sum[k] / stated[k];
        assert!(
            (0.3..2.2).contains(&ratio),
            "axis {k}: measured over stated variance {ratio}"
        );
    }
}

#[test]
fn what_does_not_fit_is_indeterminate() {
    on_every_ring84(run_what_does_not_fit_is_indeterminate);
}

fn run_what_does_not_fit_is_indeterminate(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    let points = patch(&mesh, 5_000, 0.010, 5);
    let reason =
        |cloud: &[[f64; 3]], options: &Options| match register(&surface, cloud, None, options)
            .status
        {
            Status::Registered => None,
            Status::Indeterminate(reason) => Some(reason),
        };
    let plain = Options {
        teeth: Some(84),
        ..Options::default()
    };
    assert!(matches!(
        reason(&points[..3], &plain),
        Some(RegistrationFailure::TooFewPoints { points: 3, .. })
    ));
    let far = moved(&points, &Isometry3::translation(1000.0, 0.0, 0.0));
    assert!(matches!(
        reason(&far, &plain),
        Some(RegistrationFailure::Disjoint { .. })
    ));
    let mut bad = points.clone();
    bad[17][1] = f64::NAN;
    assert!(matches!(
        reason(&bad, &plain),
        Some(RegistrationFailure::NotFinite { index: 17 })
    ));

    // Points in the air before the teeth: near enough to start, but not the surface.
    let mut random = Random::new(1);
    let fog: Vec<[f64; 3]> = (0..5000)
        .map(|_| {
            [
                39.0 + 5.0 * random.uniform(),
                5.0 * random.uniform(),
                28.0 + 10.0 * random.uniform(),
            ]
        })
        .collect();
    assert!(
        matches!(
            reason(&fog, &plain),
            Some(RegistrationFailure::TooFewInliers { .. })
        ),
        "{:?}",
        reason(&fog, &plain)
    );

    // Turned by a good part of a pitch: whichever tooth it falls on, the rival is as good.
    let pitch = 360.0 / 84.0 * DEG;
    for share in [0.42, 0.5, 0.58] {
        let turned = moved(&points, &Isometry3::rotation(Vector3::z() * pitch * share));
        assert!(
            matches!(
                reason(&turned, &plain),
                Some(
                    RegistrationFailure::AmbiguousTooth { .. }
                        | RegistrationFailure::TooFewInliers { .. }
                        | RegistrationFailure::NotConverged { .. }
                )
            ),
            "share {share}: {:?}",
            reason(&turned, &plain)
        );
    }
    // A small turn is still told from its rival.
    let turned = moved(&points, &Isometry3::rotation(Vector3::z() * pitch * 0.15));
    assert_eq!(reason(&turned, &plain), None);

    // The stages say another place than the points.
    let prior = Prior::independent(
        Rigid::from_isometry(Isometry3::translation(0.3, 0.0, 0.0)),
        [1e-4; 3],
        [0.005; 3],
    );
    let contradicted = Options {
        prior: Some(prior),
        ..plain.clone()
    };
    let reason_given = reason(&points, &contradicted);
    assert!(
        matches!(
            reason_given,
            Some(
                RegistrationFailure::PriorViolated { .. }
                    | RegistrationFailure::TooFewInliers { .. }
            )
        ),
        "{reason_given:?}"
    );
}

#[test]
fn a_plane_is_unconstrained() {
    let mesh = TriMesh {
        vertices: vec![
            [-50.0, -50.0, 0.0],
            [50.0, -50.0, 0.0],
            [50.0, 50.0, 0.0],
            [-50.0, 50.0, 0.0],
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let mut random = Random::new(2);
    let points: Vec<[f64; 3]> = (0..2000)
        .map(|_| {
            [
                10.0 * random.normal(),
                10.0 * random.normal(),
                0.01 * random.normal() + 0.2,
            ]
        })
        .collect();
    let found = register(
        &Surface::new(&mesh).unwrap(),
        &points,
        None,
        &Options::default(),
    );
    assert!(
        matches!(
            found.status,
            Status::Indeterminate(RegistrationFailure::Unconstrained { unobserved: 3, .. })
        ),
        "{:?}",
        found.status
    );
    // What is observed was still found.
    let height = found.tool_from_cloud.apply([0.0, 0.0, 0.2])[2];
    assert!(height.abs() < 1.5e-3, "{height}");
}

#[test]
fn the_number_of_teeth_is_found() {
    on_every_ring84(run_the_number_of_teeth_is_found);
}

fn run_the_number_of_teeth_is_found(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    assert_eq!(detect_teeth(&mesh, &surface, 0.02), Some(84));
}

/// Internal and external gears with bores of other numbers of facets, some of them with a keyway.
#[test]
fn the_number_of_teeth_is_that_of_the_flanks_whatever_the_body_is() {
    for (number, teeth) in [12, 17, 24, 36, 60, 101].into_iter().enumerate() {
        // Internal teeth of fewer than 34 end within their base circle.
        let kinds = [GearKind::External, GearKind::Internal];
        for kind in kinds.into_iter().take(if teeth < 34 { 1 } else { 2 }) {
            let module_mm = [0.5, 1.0, 2.5][number % 3];
            let pitch_mm = 0.5 * module_mm * f64::from(teeth);
            let (inner, outer) = (pitch_mm - module_mm, pitch_mm + module_mm);
            let (tip_radius_mm, root_radius_mm, body_radius_mm) = match kind {
                GearKind::Internal => (inner, outer + 0.25 * module_mm, 1.4 * outer),
                GearKind::External => (outer, inner - 0.25 * module_mm, 0.4 * inner),
            };
            let gear = GearSpec {
                kind,
                teeth,
                module_mm,
                pressure_angle_rad: 20f64.to_radians(),
                tip_radius_mm,
                root_radius_mm,
                root_fillet_radius_mm: 0.0,
                turned_rad: 0.1,
                body_radius_mm,
                height_mm: [0.0, 6.0 * module_mm],
            };
            let solid = gear.mesh(&Meshing::default()).unwrap();
            let mut mesh = TriMesh {
                vertices: solid.vertices,
                triangles: solid.triangles,
            };
            let count = |mesh: &TriMesh| detect_teeth(mesh, &Surface::new(mesh).unwrap(), 0.02);
            assert_eq!(count(&mesh), Some(teeth), "{kind:?} {teeth}");
            // The walls of a keyway through the bore, as a body of its own.
            let (wide, far) = (0.1 * body_radius_mm, body_radius_mm);
            for wall in [-wide, wide] {
                let first = mesh.vertices.len() as u32;
                for (x, z) in [(0.0, 0.0), (far, 0.0), (far, module_mm), (0.0, module_mm)] {
                    mesh.vertices.push([x, wall, z]);
                }
                for corners in [[0, 1, 2], [0, 2, 3]] {
                    mesh.triangles.push(corners.map(|corner| first + corner));
                }
            }
            assert_eq!(count(&mesh), Some(teeth), "{kind:?} {teeth} with a keyway");
        }
    }
}

#[test]
fn one_and_many_threads_give_the_same_pose() {
    on_every_ring84(run_one_and_many_threads_give_the_same_pose);
}

fn run_one_and_many_threads_give_the_same_pose(mesh: TriMesh) {
    let surface = Surface::new(&mesh).unwrap();
    let cloud = moved(&patch(&mesh, 20_000, 0.010, 6), &disturb(6, 0.4 * DEG, 0.1));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let found = pool.install(|| register(&surface, &cloud, None, &Options::default()));
        found
            .tool_from_cloud
            .to_rows()
            .map(|row| row.map(f64::to_bits))
    };
    assert_eq!(run(1), run(4));
}
