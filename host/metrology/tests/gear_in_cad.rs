//! Gears found in CAD: involutes in closed form, with fillets tangent to them, rounded and chamfered tips and tip relief, come out with the
//! numbers that they were drawn with.

use std::f64::consts::TAU;

use flankscope_metrology::gear::{Flank, GearData, GearKind};
use flankscope_metrology::io::mesh::TriMesh;
use flankscope_metrology::tool::gear_in_cad::{FoundGear, find_gear};

/// Lowest height of the toothing, mm.
const LOW_MM: f64 = -2.5;
/// Facets of a flank along the profile.
const FLANK_FACETS: usize = 12;

/// Outline of a tooth besides its involute.
#[derive(Debug, Clone, Copy)]
struct Edges {
    /// Radius of the arc that touches the involute towards the root, in modules.
    fillet: f64,
    /// Its facets.
    fillet_facets: usize,
    /// Distance of the touching point from the form radius towards the tip, in modules.
    fillet_start: f64,
    /// Relief at the tip, mm, linear over the outer 35 % of the involute's length.
    relief_mm: f64,
    /// Chamfer of the tip's edge, in modules; 0 for a sharp edge.
    chamfer: f64,
}

fn drawn(kind: GearKind, teeth: u32, module_mm: f64, pressure_angle_deg: f64) -> GearData {
    let pitch_mm = 0.5 * module_mm * f64::from(teeth);
    let outwards = if kind == GearKind::External {
        1.0
    } else {
        -1.0
    };
    GearData {
        kind,
        teeth,
        module_mm,
        pressure_angle_deg,
        tip_radius_mm: pitch_mm + outwards * module_mm * if outwards > 0.0 { 1.0 } else { 0.7 },
        root_radius_mm: pitch_mm - outwards * 1.25 * module_mm,
        first_tooth_centre_deg: 0.4 * TAU.to_degrees() / f64::from(teeth),
        height_mm: [LOW_MM, LOW_MM + 5.0],
        radial_threshold_mm: pitch_mm + 3.0 * module_mm,
    }
}

/// Half of a tooth's outline from the tip to the middle of the space: radius and angle from the tooth's centre.
fn half_outline(gear: &GearData, edges: Edges) -> Vec<[f64; 2]> {
    let outwards = if gear.kind == GearKind::External {
        1.0
    } else {
        -1.0
    };
    let module_mm = gear.module_mm;
    let base_mm = gear.base_radius_mm();
    let mut form_mm = gear.pitch_radius_mm() - outwards * (1.0 - edges.fillet_start) * module_mm;
    if gear.kind == GearKind::External {
        form_mm = form_mm.max(1.004 * base_mm);
    }
    let tip_mm = gear.tip_radius_mm - outwards * edges.chamfer * module_mm;
    let roll = |radius: f64| (radius * radius - base_mm * base_mm).max(0.0).sqrt();
    // The length of an involute grows with the square of its roll length.
    let relief_from = (0.65 * roll(tip_mm).powi(2) + 0.35 * roll(form_mm).powi(2)).sqrt();
    let half = |radius: f64| {
        let beyond = ((roll(radius) - relief_from) / (roll(tip_mm) - relief_from)).max(0.0);
        gear.half_tooth_rad(radius).unwrap() - beyond * edges.relief_mm / base_mm
    };
    let mut outline = Vec::new();
    if edges.chamfer > 0.0 {
        let angle = half(tip_mm) - edges.chamfer * module_mm / gear.tip_radius_mm;
        outline.push([gear.tip_radius_mm, angle]);
    }
    for i in 0..=FLANK_FACETS {
        let radius = tip_mm + (form_mm - tip_mm) * i as f64 / FLANK_FACETS as f64;
        outline.push([radius, half(radius)]);
    }
    // The arc turns from the involute to the root, about a centre in the space.
    let angle = half(form_mm);
    let start = [form_mm * angle.cos(), form_mm * angle.sin(), 0.0];
    let normal = gear.flank_normal(Flank::Left, start);
    let radius_mm = edges.fillet * module_mm;
    let centre = [0, 1].map(|k| start[k] + radius_mm * normal[k]);
    let space = 0.5 * gear.pitch_rad();
    for i in 1..=edges.fillet_facets {
        let turn = outwards * TAU / 4.0 * i as f64 / edges.fillet_facets as f64;
        let [x, y] = [-normal[0], -normal[1]];
        let arm = [
            x * turn.cos() - y * turn.sin(),
            x * turn.sin() + y * turn.cos(),
        ];
        let [x, y] = [0, 1].map(|k| centre[k] + radius_mm * arm[k]);
        let (radius, angle) = (x.hypot(y), y.atan2(x));
        let before = outline.last().unwrap()[0];
        if angle >= 0.98 * space || outwards * (before - radius) <= 0.0 {
            break;
        }
        outline.push([radius, angle]);
    }
    outline
}

/// The toothing without end faces, in single precision, as an STL holds it.
fn mesh(gear: &GearData, edges: Edges) -> TriMesh {
    let half = half_outline(gear, edges);
    let mut outline: Vec<[f64; 2]> = Vec::new();
    for tooth in 1..=gear.teeth {
        let centre = gear.tooth_centre_rad(tooth);
        let place = |[radius, angle]: [f64; 2], sign: f64| {
            let at = centre + sign * angle;
            [radius * at.cos(), radius * at.sin()]
        };
        outline.extend(half.iter().rev().map(|&p| place(p, -1.0)));
        outline.extend(half.iter().map(|&p| place(p, 1.0)));
    }
    let count = outline.len() as u32;
    let single = |value: f64| f64::from(value as f32);
    let mut vertices = Vec::new();
    for z in gear.height_mm {
        vertices.extend(outline.iter().map(|[x, y]| [*x, *y, z].map(single)));
    }
    let mut triangles = Vec::new();
    for i in 0..count {
        let next = (i + 1) % count;
        triangles.push([i, next, next + count]);
        triangles.push([i, next + count, i + count]);
    }
    let mut mesh = TriMesh {
        vertices,
        triangles,
    };
    if gear.kind == GearKind::Internal {
        mesh.turn_inside_out();
    }
    mesh
}

fn found(gear: &GearData, edges: Edges) -> FoundGear {
    let found = find_gear(&mesh(gear, edges));
    found
        .unwrap_or_else(|error| panic!("{gear:?} {edges:?}: {error}"))
        .0
}

/// Differences from the drawing: module, relative; angle, degrees; tooth thickness on the pitch circle, um.
fn differences(drawn: &GearData, found: &GearData) -> [f64; 3] {
    let pitch_mm = drawn.pitch_radius_mm();
    let thickness_mm = |gear: &GearData| 2.0 * pitch_mm * gear.half_tooth_rad(pitch_mm).unwrap();
    [
        found.module_mm / drawn.module_mm - 1.0,
        found.pressure_angle_deg - drawn.pressure_angle_deg,
        1e3 * (thickness_mm(found) - thickness_mm(drawn)),
    ]
    .map(f64::abs)
}

#[test]
fn edges_beside_the_involute_do_not_move_it() {
    let plain = Edges {
        fillet: 0.35,
        fillet_facets: 8,
        fillet_start: 0.0,
        relief_mm: 0.0,
        chamfer: 0.0,
    };
    let all = [
        plain,
        Edges {
            fillet_facets: 30,
            ..plain
        },
        Edges {
            fillet: 0.2,
            fillet_facets: 24,
            fillet_start: 0.3,
            ..plain
        },
        Edges {
            chamfer: 0.12,
            ..plain
        },
        Edges {
            relief_mm: 0.01,
            ..plain
        },
        Edges {
            relief_mm: 0.03,
            fillet_facets: 24,
            chamfer: 0.08,
            ..plain
        },
    ];
    let mut worst = [0.0_f64; 3];
    for kind in [GearKind::External, GearKind::Internal] {
        for (teeth, angle_deg, module_mm) in [
            (17, 25.0, 1.0),
            (24, 20.0, 2.5),
            (40, 20.0, 2.0),
            (60, 14.5, 2.5),
            (84, 20.0, 1.0),
            (120, 25.0, 0.5),
        ] {
            if kind == GearKind::Internal && teeth < 40 {
                continue;
            }
            let drawn = drawn(kind, teeth, module_mm, angle_deg);
            for edges in all {
                let found = found(&drawn, edges);
                assert_eq!(found.gear.teeth, teeth, "{edges:?}");
                let off = differences(&drawn, &found.gear);
                let is_near = off[0] < 1e-5 && off[1] < 0.002 && off[2] < 0.5;
                assert!(is_near, "{drawn:?}, {edges:?}: {off:?}");
                worst = [0, 1, 2].map(|k| worst[k].max(off[k]));
            }
        }
    }
    println!(
        "largest differences: module {:.1e}, angle {:.1e} deg, thickness {:.3} um",
        worst[0], worst[1], worst[2]
    );
}
