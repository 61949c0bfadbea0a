use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion};

use super::*;

/// A block of 20 x 10 x 5 mm: its upper face at z = 5 is triangles 2 and 3, the lower one 0 and 1.
fn block() -> TriMesh {
    let vertices = (0..8)
        .map(|i| {
            [
                20.0 * f64::from(i & 1),
                10.0 * f64::from(i >> 1 & 1),
                5.0 * f64::from(i >> 2),
            ]
        })
        .collect();
    TriMesh {
        vertices,
        triangles: vec![
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ],
    }
}

fn spec(name: &str, datum: &[&str]) -> PatchSpec {
    PatchSpec {
        name: name.into(),
        pick: Pick::Seed([10.0, 4.0, 5.0], 0.1),
        box_mm: None,
        origin_mm: None,
        up: None,
        zone_mm: None,
        datum: datum.iter().map(|name| (*name).into()).collect(),
    }
}

/// The middle of the upper face, judged, and a strip beside it as its datum.
fn pair() -> [PatchSpec; 2] {
    [
        PatchSpec {
            box_mm: Some([[5.0, 0.0, 4.0], [15.0, 10.0, 6.0]]),
            ..spec("face", &["strip"])
        },
        PatchSpec {
            box_mm: Some([[15.0, 0.0, 4.0], [20.0, 10.0, 6.0]]),
            ..spec("strip", &[])
        },
    ]
}

fn laid(specs: &[PatchSpec]) -> Result<Patches, PatchError> {
    let mesh = block();
    Patches::new(specs, &mesh, &Surface::new(&mesh).unwrap(), 0.25)
}

#[track_caller]
fn near(a: [f64; 3], b: [f64; 3]) {
    let off = (Vector3::from(a) - Vector3::from(b)).norm();
    assert!(off < 1e-9, "{a:?} {b:?}");
}

#[test]
fn a_patch_has_the_frame_area_and_rectangle_of_its_box() {
    let patches = laid(&pair()).unwrap();
    let face = patches.get(1).unwrap();
    assert_eq!(patches.judged(), [1]);
    assert!(face.rests_on(2) && !face.rests_on(1));
    assert!((face.area_mm2 - 100.0).abs() < 1e-9);
    near(face.origin_mm, [10.0, 5.0, 5.0]);
    // It faces along z, so y is up, and x along.
    near(face.axes[0], [1.0, 0.0, 0.0]);
    near(face.axes[1], [0.0, 1.0, 0.0]);
    near(face.axes[2], [0.0, 0.0, 1.0]);
    let [[left, right], [low, high]] = face.zone_mm;
    assert!((left + 4.75).abs() < 1e-9 && (right - 4.75).abs() < 1e-9);
    assert!((low + 4.75).abs() < 1e-9 && (high - 4.75).abs() < 1e-9);
    assert_eq!(face.place_mm([12.0, 4.0, 5.1]), [2.0, -1.0]);
    near(face.point_mm([2.0, -1.0]), [12.0, 4.0, 5.0]);
    // Both triangles of the upper face belong to both patches, and points to the one in whose box they lie.
    let at = |triangle, point| patches.at(triangle, point).map(|(number, _)| number);
    assert_eq!(at(2, [6.0, 1.0, 5.0]), Some(1));
    assert_eq!(at(3, [18.0, 8.0, 5.0]), Some(2));
    assert_eq!(at(2, [2.0, 1.0, 5.0]), None);
    assert_eq!(at(0, [6.0, 1.0, 0.0]), None);
}

#[test]
fn frames_turn_with_the_cad() {
    let motion = Isometry3::from_parts(
        Translation3::new(30.0, -7.0, 2.0),
        UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0),
    );
    let moved = |p: [f64; 3]| -> [f64; 3] { (motion * Point3::from(p)).coords.into() };
    let mut mesh = block();
    for vertex in &mut mesh.vertices {
        *vertex = moved(*vertex);
    }
    let surface = Surface::new(&mesh).unwrap();
    let up = (motion.rotation * Vector3::y()).into();
    let specs = ["face", "below"].map(|name| PatchSpec {
        pick: Pick::Facets(if name == "face" {
            vec![2, 3]
        } else {
            vec![0, 1]
        }),
        up: Some(up),
        datum: if name == "face" {
            vec!["below".into()]
        } else {
            Vec::new()
        },
        ..spec(name, &[])
    });
    let patches = Patches::new(&specs, &mesh, &surface, 0.25).unwrap();
    let face = patches.get(1).unwrap();
    near(face.origin_mm, moved([10.0, 5.0, 5.0]));
    let [along, higher] = face.place_mm(moved([13.0, 4.0, 5.0]));
    assert!((along - 3.0).abs() < 1e-9 && (higher + 1.0).abs() < 1e-9);
    assert!((face.area_mm2 - 200.0).abs() < 1e-9);
}

#[test]
fn a_seed_grows_to_edges_that_are_sharper_than_its_angle() {
    // A roof of facets, each tilted by 4 degrees more than the one before.
    let tilt = |k: usize| (4.0 * k as f64).to_radians();
    let mut ridge = vec![[0.0, 0.0]];
    for k in 0..8 {
        let [x, z]: [f64; 2] = ridge[k];
        ridge.push([x + tilt(k).cos(), z - tilt(k).sin()]);
    }
    let vertices: Vec<[f64; 3]> = ridge
        .iter()
        .flat_map(|&[x, z]| [[x, 0.0, z], [x, 1.0, z]])
        .collect();
    let triangles: Vec<[u32; 3]> = (0..8)
        .flat_map(|k| {
            [
                [2 * k, 2 * k + 2, 2 * k + 1],
                [2 * k + 1, 2 * k + 2, 2 * k + 3],
            ]
        })
        .collect();
    let mesh = TriMesh {
        vertices,
        triangles,
    };
    let surface = Surface::new(&mesh).unwrap();
    let picked = |angle_deg: f64| {
        let pick = Pick::Seed([0.5, 0.3, 0.0], angle_deg.to_radians());
        pick.triangles("roof", &mesh, &surface).unwrap()
    };
    // Two triangles a facet: up to 0, 8 and 12 degrees.
    assert_eq!(picked(1.0), [0, 1]);
    assert_eq!(picked(10.0), [0, 1, 2, 3, 4, 5]);
    assert_eq!(picked(12.1).len(), 8);
}

#[test]
fn what_is_no_patch_is_refused_by_name() {
    let [face, strip] = pair();
    let refused = |face: PatchSpec| laid(&[face, strip.clone()]).unwrap_err().to_string();
    for (wrong, hint) in [
        (
            PatchSpec {
                box_mm: Some([[5.0, 0.0, 6.0], [15.0, 10.0, 7.0]]),
                ..face.clone()
            },
            "\"face\" is empty",
        ),
        (
            PatchSpec {
                box_mm: Some([[5.0, 0.0, 4.0], [f64::NAN, 10.0, 6.0]]),
                ..face.clone()
            },
            "box_mm has NaN",
        ),
        (
            PatchSpec {
                box_mm: Some([[15.0, 0.0, 4.0], [5.0, 10.0, 6.0]]),
                ..face.clone()
            },
            "box_mm goes from 15 to 5",
        ),
        (
            PatchSpec {
                box_mm: Some([[5.0, 0.0, 4.0], [16.0, 10.0, 6.0]]),
                ..face.clone()
            },
            "\"face\" and \"strip\" share",
        ),
        (
            PatchSpec {
                zone_mm: Some([[-5.1, 4.0], [-4.0, 4.0]]),
                ..face.clone()
            },
            "lie on the patch",
        ),
        (
            PatchSpec {
                zone_mm: Some([[-0.2, 0.2], [-4.0, 4.0]]),
                ..face.clone()
            },
            "at most 0.126 mm2",
        ),
        (
            PatchSpec {
                pick: Pick::Seed([10.0, 4.0, 5.2], 0.1),
                ..face.clone()
            },
            "seed_mm is 0.200 mm off the CAD",
        ),
        (
            PatchSpec {
                origin_mm: Some([10.0, 4.0, 9.0]),
                ..face.clone()
            },
            "origin_mm is 4.000 mm off the CAD",
        ),
        (
            PatchSpec {
                pick: Pick::Facets(vec![2, 12]),
                ..face.clone()
            },
            "facet 12 is not in the CAD",
        ),
        (
            PatchSpec {
                pick: Pick::Facets(vec![2, 3, 10, 11]),
                box_mm: None,
                ..face.clone()
            },
            "degrees from the patch's normal",
        ),
        (
            PatchSpec {
                up: Some([0.0, 0.0, 1.0]),
                ..face.clone()
            },
            "up lies along its normal",
        ),
        (
            PatchSpec {
                up: Some([0.0; 3]),
                ..face.clone()
            },
            "up lies along its normal",
        ),
        (
            PatchSpec {
                datum: vec!["stripe".into()],
                ..face.clone()
            },
            "\"stripe\" is no patch of this file",
        ),
        (
            PatchSpec {
                datum: vec!["face".into()],
                ..face.clone()
            },
            "is judged itself",
        ),
        (
            PatchSpec {
                datum: Vec::new(),
                ..face.clone()
            },
            "cannot be told from a patch that has moved",
        ),
        (
            PatchSpec {
                name: "strip".into(),
                ..face.clone()
            },
            "a name of its own",
        ),
    ] {
        let said = refused(wrong);
        assert!(said.contains(hint), "{hint}: {said}");
    }
}
