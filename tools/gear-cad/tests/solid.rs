//! The gear mesh against closed forms: area of an involute, position on it, watertightness.

use flankscope_gear_cad::{Flank, GearKind, GearSpec, Mesh, MeshError, Meshing, SpecError};
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

fn die() -> GearSpec {
    let pitch_radius_mm = 41.45;
    let module_mm = 2.0 * pitch_radius_mm / 84.0;
    GearSpec {
        kind: GearKind::Internal,
        teeth: 84,
        module_mm,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: pitch_radius_mm - module_mm,
        root_radius_mm: pitch_radius_mm + 1.25 * module_mm,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 88.5,
        height_mm: [0.0, 66.0],
    }
}

fn pinion() -> GearSpec {
    GearSpec {
        kind: GearKind::External,
        teeth: 50,
        module_mm: 2.0,
        pressure_angle_rad: 20f64.to_radians(),
        tip_radius_mm: 52.0,
        root_radius_mm: 47.5,
        root_fillet_radius_mm: 0.0,
        turned_rad: 0.0,
        body_radius_mm: 10.0,
        height_mm: [-3.0, 7.0],
    }
}

fn variants() -> Vec<(&'static str, GearSpec, Meshing)> {
    let few = GearSpec {
        teeth: 17,
        module_mm: 3.0,
        tip_radius_mm: 28.5,
        root_radius_mm: 21.75,
        ..pinion()
    };
    vec![
        ("internal", die(), Meshing::default()),
        (
            "internal, fillet",
            GearSpec {
                root_fillet_radius_mm: 0.2,
                ..die()
            },
            Meshing::default(),
        ),
        (
            "internal, turned",
            GearSpec {
                turned_rad: 0.3,
                ..die()
            },
            Meshing::default(),
        ),
        (
            "internal, sliced",
            die(),
            Meshing {
                axial_slices: 5,
                ..Meshing::default()
            },
        ),
        ("external", pinion(), Meshing::default()),
        (
            "external, fillet",
            GearSpec {
                root_fillet_radius_mm: 0.5,
                ..pinion()
            },
            Meshing::default(),
        ),
        (
            "external, root inside the base circle",
            few,
            Meshing::default(),
        ),
    ]
}

/// Area inside the toothed outline by Green's theorem: the integral of r²/2 over the angle of an involute is b² t³/6.
fn outline_area_mm2(gear: &GearSpec) -> f64 {
    let base = gear.base_radius_mm();
    let pitch = gear.pitch_angle_rad();
    let tip = gear.tooth_half_angle_rad(gear.tip_radius_mm);
    let root = gear.tooth_half_angle_rad(gear.root_radius_mm);
    let swept = |r: f64| gear.roll_angle_rad(r).powi(3) * base * base / 6.0;
    let flank = (swept(gear.tip_radius_mm) - swept(gear.root_radius_mm)).abs();
    let per_pitch = gear.tip_radius_mm.powi(2) * tip
        + gear.root_radius_mm.powi(2) * (0.5 * pitch - root)
        + 2.0 * flank;
    per_pitch * f64::from(gear.teeth)
}

fn assert_watertight(name: &str, mesh: &Mesh) {
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    for t in &mesh.triangles {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            assert_ne!(a, b, "{name}: collapsed edge");
            *edges.entry((a, b)).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(
            count, 1,
            "{name}: edge {a}-{b} walked {count} times in one direction"
        );
        assert!(edges.contains_key(&(b, a)), "{name}: edge {a}-{b} is open");
    }
    let vertices = mesh.vertices.len() as i64;
    let faces = mesh.triangles.len() as i64;
    // A ring is a torus: Euler characteristic 0.
    assert_eq!(
        vertices - edges.len() as i64 / 2 + faces,
        0,
        "{name}: not a ring"
    );
}

#[test]
fn every_variant_is_watertight() {
    for (name, gear, meshing) in variants() {
        assert_watertight(name, &gear.mesh(&meshing).expect(name));
    }
}

#[test]
fn volume_is_the_closed_form_within_the_chord_error() {
    for (name, gear, meshing) in variants()
        .into_iter()
        .filter(|(n, ..)| !n.contains("fillet") && !n.contains("base"))
    {
        let mesh = gear.mesh(&meshing).expect(name);
        let height = gear.height_mm[1] - gear.height_mm[0];
        // The body is a regular polygon, known exactly from its vertex count.
        let body_vertices = mesh
            .vertices
            .iter()
            .filter(|v| (v[0].hypot(v[1]) - gear.body_radius_mm).abs() < 1e-9)
            .count()
            / 2;
        let n = body_vertices as f64;
        let body = 0.5 * n * gear.body_radius_mm.powi(2) * (TAU / n).sin();
        let (expected, outline_length) = match gear.kind {
            GearKind::Internal => (body - outline_area_mm2(&gear), 84.0 * 8.0),
            GearKind::External => (outline_area_mm2(&gear) - body, 50.0 * 16.0),
        };
        let tolerance = outline_length * meshing.chord_error_mm * height;
        let got = mesh.volume_mm3();
        assert!(
            (got - expected * height).abs() < tolerance,
            "{name}: {got} against {}",
            expected * height
        );
        assert!(tolerance < 1e-3 * got, "the tolerance must mean something");
    }
}

#[test]
fn volume_of_a_ring_from_another_cad_kernel() {
    // Parameters and volume of a ring gear exported by Open CASCADE with 2 µm chords.
    let ring = GearSpec {
        module_mm: 1.0,
        tip_radius_mm: 41.0,
        root_radius_mm: 43.25,
        body_radius_mm: 51.25,
        ..die()
    };
    let mesh = ring
        .mesh(&Meshing {
            body_chord_error_mm: 2e-3,
            ..Meshing::default()
        })
        .expect("a valid ring");
    let wetted_mm2 = 66.0 * (84.0 * 8.0 + TAU * 51.25);
    assert!(
        (mesh.volume_mm3() - 177_987.0).abs() < wetted_mm2 * 4e-3,
        "{}",
        mesh.volume_mm3()
    );
}

/// Distance of a point in one transverse plane from the nearest involute flank, by Newton-free geometry: the string
/// through the point is tangent to the base circle, and the flank fixes how long it should be.
fn off_involute_mm(gear: &GearSpec, tooth: u32, flank: Flank, p: [f64; 2]) -> f64 {
    let base = gear.base_radius_mm();
    let radius = p[0].hypot(p[1]);
    let side = if flank == Flank::Left { 1.0 } else { -1.0 };
    let mirrored = if gear.kind == GearKind::Internal {
        side
    } else {
        -side
    };
    let angle = p[1].atan2(p[0]) - gear.flank_angle_rad(tooth, flank, gear.pitch_radius_mm());
    let angle = angle - TAU * (angle / TAU).round();
    let pitch_roll = gear.pressure_angle_rad.tan();
    let origin = pitch_roll - pitch_roll.atan();
    let pressure = (base / radius).acos();
    // String unwound along the base circle up to the tangent point against the straight string.
    base * (mirrored * angle + origin + pressure) - base * pressure.tan()
}

#[test]
fn flank_vertices_lie_on_the_involute_and_chords_within_the_error() {
    for (name, gear, meshing) in variants() {
        let mesh = gear.mesh(&meshing).expect(name);
        let mut on_flank = 0;
        let mut worst_mm: f64 = 0.0;
        let (low, high) = {
            let ends = [gear.tip_radius_mm, gear.flank_root_radius_mm()];
            (ends[0].min(ends[1]), ends[0].max(ends[1]))
        };
        for t in &mesh.triangles {
            let corners = t.map(|i| mesh.vertices[i as usize]);
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (p, q) = (corners[a], corners[b]);
                let (rp, rq) = (p[0].hypot(p[1]), q[0].hypot(q[1]));
                let within = |r: f64| r > low - 1e-9 && r < high + 1e-9;
                if p[2] != q[2] || (rp - rq).abs() < 1e-6 || !within(rp) || !within(rq) {
                    continue;
                }
                // Both ends on tooth 3's left flank?
                let off = |p: [f64; 3]| off_involute_mm(&gear, 3, Flank::Left, [p[0], p[1]]);
                if off(p).abs() > 1e-6 || off(q).abs() > 1e-6 {
                    continue;
                }
                on_flank += 1;
                assert!(off(p).abs() < 1e-9, "{name}: {} mm off", off(p));
                // Diagonals of the end cap may join flank points that are not neighbours: those edges are not chords.
                let roll_step = (gear.roll_angle_rad(rp) - gear.roll_angle_rad(rq)).abs();
                let widest = (8.0 * meshing.chord_error_mm
                    / (gear.base_radius_mm() * gear.roll_angle_rad(high)))
                .sqrt();
                if roll_step > 1.001 * widest {
                    continue;
                }
                for i in 1..20 {
                    let s = f64::from(i) / 20.0;
                    let m = [0, 1, 2].map(|k| p[k] + s * (q[k] - p[k]));
                    worst_mm = worst_mm.max(off(m).abs());
                }
            }
        }
        assert!(on_flank > 20, "{name}: found {on_flank} flank edges");
        assert!(
            worst_mm <= meshing.chord_error_mm,
            "{name}: chord error {worst_mm} mm"
        );
        assert!(
            worst_mm > 0.2 * meshing.chord_error_mm,
            "{name}: finer than asked ({worst_mm} mm)"
        );
    }
}

#[test]
fn a_space_is_centred_on_x_and_teeth_count_from_it() {
    let gear = die();
    let mesh = gear.mesh(&Meshing::default()).expect("valid");
    let on_x: Vec<f64> = mesh
        .vertices
        .iter()
        .filter(|v| v[1].abs() < 1e-12 && v[0] > 0.0)
        .map(|v| v[0])
        .filter(|&x| x < 50.0)
        .collect();
    assert!(
        !on_x.is_empty()
            && on_x
                .iter()
                .all(|&x| (x - gear.root_radius_mm).abs() < 1e-12),
        "{on_x:?}"
    );
    // Tips sit where tooth_centre_rad says; left is the side of larger angle.
    for tooth in [1, 2, 42, 84] {
        let centre = gear.tooth_centre_rad(tooth);
        assert!((centre - (f64::from(tooth) - 0.5) * TAU / 84.0).abs() < 1e-15);
        let tip = [
            gear.tip_radius_mm * centre.cos(),
            gear.tip_radius_mm * centre.sin(),
        ];
        assert!(
            mesh.vertices
                .iter()
                .any(|v| (v[0] - tip[0]).hypot(v[1] - tip[1]) < 1e-9),
            "tip of tooth {tooth}"
        );
        let r = gear.pitch_radius_mm();
        let [left, right] = [Flank::Left, Flank::Right].map(|f| gear.flank_angle_rad(tooth, f, r));
        assert!(
            (left - right - PI / 84.0).abs() < 1e-14,
            "tooth and space share the pitch circle"
        );
    }
}

#[test]
fn flank_triangles_face_along_the_involute_normal() {
    for (name, gear, meshing) in variants() {
        let mesh = gear.mesh(&meshing).expect(name);
        for (tooth, flank) in [
            (1, Flank::Left),
            (1, Flank::Right),
            (9, Flank::Left),
            (9, Flank::Right),
        ] {
            let mut seen = 0;
            for t in &mesh.triangles {
                let c = t.map(|i| mesh.vertices[i as usize]);
                let flat = c[0][2] == c[1][2] && c[1][2] == c[2][2];
                let involute =
                    |p: [f64; 3]| off_involute_mm(&gear, tooth, flank, [p[0], p[1]]).abs() < 1e-9;
                if flat || !c.iter().all(|&p| involute(p)) {
                    continue;
                }
                seen += 1;
                let u = [0, 1, 2].map(|k| c[1][k] - c[0][k]);
                let v = [0, 1, 2].map(|k| c[2][k] - c[0][k]);
                let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2]];
                let length = n[0].hypot(n[1]);
                let middle = (c[0][0] + c[1][0] + c[2][0]) / 3.0;
                let radius = middle.hypot((c[0][1] + c[1][1] + c[2][1]) / 3.0);
                let expected = gear.flank_normal(tooth, flank, radius);
                let cosine = (n[0] * expected[0] + n[1] * expected[1]) / length;
                assert!(
                    cosine > 0.9999,
                    "{name}, tooth {tooth} {flank:?}: cosine {cosine}"
                );
            }
            assert!(
                seen >= 10,
                "{name}: {seen} triangles on tooth {tooth} {flank:?}"
            );
        }
    }
}

#[test]
fn a_fillet_leaves_flank_and_root_without_a_corner() {
    for gear in [
        GearSpec {
            root_fillet_radius_mm: 0.2,
            ..die()
        },
        GearSpec {
            root_fillet_radius_mm: 0.5,
            ..pinion()
        },
    ] {
        let mesh = gear
            .mesh(&Meshing {
                chord_error_mm: 1e-6,
                ..Meshing::default()
            })
            .expect("valid");
        let slice = gear.height_mm[0];
        let pitch = gear.pitch_angle_rad();
        let outline: Vec<[f64; 2]> = mesh
            .vertices
            .iter()
            .filter(|v| v[2] == slice && (v[0].hypot(v[1]) - gear.body_radius_mm).abs() > 1e-6)
            .map(|v| [v[0], v[1]])
            .filter(|p| (0.0..0.5 * pitch).contains(&p[1].atan2(p[0])))
            .collect();
        // From the middle of the space to just before the tip corner the direction turns in small steps only.
        let inner: Vec<_> = outline
            .iter()
            .filter(|p| (p[0].hypot(p[1]) - gear.tip_radius_mm).abs() > 1e-3)
            .copied()
            .collect();
        let turns = inner.windows(3).map(|w| {
            let d = |a: [f64; 2], b: [f64; 2]| (b[1] - a[1]).atan2(b[0] - a[0]);
            let turn = d(w[1], w[2]) - d(w[0], w[1]);
            (turn - TAU * (turn / TAU).round()).abs()
        });
        let sharpest = turns.fold(0.0, f64::max);
        assert!(
            sharpest < 0.02,
            "{:?}: a corner of {sharpest} rad",
            gear.kind
        );
        assert!(inner.len() > 50);
    }
}

#[test]
fn impossible_gears_are_named() {
    let refused = |gear: GearSpec| gear.mesh(&Meshing::default()).expect_err("must be refused");
    let spec = |gear| match refused(gear) {
        MeshError::Spec(error) => error,
        other => panic!("{other}"),
    };
    assert!(matches!(
        spec(GearSpec { teeth: 3, ..die() }),
        SpecError::Teeth { got: 3, .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            module_mm: f64::NAN,
            ..die()
        }),
        SpecError::NotFinite {
            name: "module_mm",
            ..
        }
    ));
    assert!(matches!(
        spec(GearSpec {
            tip_radius_mm: 38.0,
            ..die()
        }),
        SpecError::RadiusOrder { .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            body_radius_mm: 42.0,
            ..die()
        }),
        SpecError::RadiusOrder { .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            root_radius_mm: 45.0,
            ..die()
        }),
        SpecError::Pointed {
            feature: "space",
            ..
        }
    ));
    assert!(matches!(
        spec(GearSpec {
            tip_radius_mm: 58.0,
            ..pinion()
        }),
        SpecError::Pointed {
            feature: "tooth",
            ..
        }
    ));
    assert!(matches!(
        spec(GearSpec {
            root_fillet_radius_mm: 0.6,
            ..die()
        }),
        SpecError::Fillet { .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            root_fillet_radius_mm: -0.1,
            ..die()
        }),
        SpecError::Fillet { .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            height_mm: [1.0, 1.0],
            ..die()
        }),
        SpecError::Height { .. }
    ));
    assert!(matches!(
        spec(GearSpec {
            pressure_angle_rad: 20.0,
            ..die()
        }),
        SpecError::PressureAngle { .. }
    ));
    let coarse = Meshing {
        chord_error_mm: 0.0,
        ..Meshing::default()
    };
    assert!(matches!(
        die().mesh(&coarse),
        Err(MeshError::ChordError {
            name: "chord_error_mm",
            ..
        })
    ));
    let none = Meshing {
        axial_slices: 0,
        ..Meshing::default()
    };
    assert!(matches!(
        die().mesh(&none),
        Err(MeshError::Slices { got: 0, .. })
    ));
    let huge = Meshing {
        chord_error_mm: 1e-9,
        axial_slices: 100_000,
        ..Meshing::default()
    };
    assert!(matches!(die().mesh(&huge), Err(MeshError::TooLarge { .. })));
}
