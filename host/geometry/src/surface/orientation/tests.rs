use super::*;
use crate::surface::Surface;

/// A cube of side `2 r` about `centre`, corners counter-clockwise seen from outside.
fn cube(centre: [f64; 3], r: f64) -> TriMesh {
    let corner = |i: usize| -> [f64; 3] {
        std::array::from_fn(|k| centre[k] + if i >> k & 1 == 1 { r } else { -r })
    };
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    TriMesh {
        vertices: (0..8).map(corner).collect(),
        triangles: quads
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
    }
}

fn joined(meshes: &[TriMesh]) -> TriMesh {
    let mut all = TriMesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    for mesh in meshes {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&mesh.vertices);
        let moved = mesh.triangles.iter().map(|t| t.map(|i| i + first));
        all.triangles.extend(moved);
    }
    all
}

fn flip(mesh: &mut TriMesh, which: impl Fn(usize) -> bool) -> usize {
    let mut count = 0;
    for (index, triangle) in mesh.triangles.iter_mut().enumerate() {
        if which(index) {
            triangle.swap(0, 1);
            count += 1;
        }
    }
    count
}

fn distance(mesh: &TriMesh, at: [f64; 3]) -> f64 {
    Surface::new(mesh).unwrap().closest(at).signed_distance_mm
}

#[test]
fn a_solid_is_put_right_however_its_triangles_are_wound() {
    // Far from the origin, where volumes about it would cancel.
    let right = cube([5000.0, -3000.0, 100.0], 1.0);
    for pattern in 0..1 << 12 {
        let mut mesh = right.clone();
        let wrong = flip(&mut mesh, |i| pattern >> i & 1 == 1);
        let found = orient(&mut mesh);
        assert_eq!((found.turned, found.unsigned), (wrong, None), "{pattern:b}");
        assert_eq!(found.is_plain(), wrong == 0);
    }
    let mut inverted = right.clone();
    flip(&mut inverted, |_| true);
    let outside = [5000.0, -3000.0, 101.5];
    assert!(
        (distance(&inverted, outside) + 0.5).abs() < 1e-12,
        "as read"
    );
    orient(&mut inverted);
    assert!((distance(&inverted, outside) - 0.5).abs() < 1e-12);
}

#[test]
fn corners_that_are_not_shared_in_the_file_are_neighbours_all_the_same() {
    let mut mesh = cube([0.0; 3], 1.0);
    let soup: Vec<[f64; 3]> = (0..12).flat_map(|i| mesh.corners(i)).collect();
    mesh.triangles = (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    mesh.vertices = soup;
    flip(&mut mesh, |i| i % 3 == 0);
    let found = orient(&mut mesh);
    assert_eq!((found.turned, found.open_edges), (4, 0));
    assert!(distance(&mesh, [0.0, 0.0, 1.5]) > 0.0);
}

#[test]
fn the_shell_of_a_cavity_points_into_it_and_a_solid_within_out_of_itself() {
    // From outside in: solid, cavity, solid; and a solid beside them.
    let shells = [(0.0, 4.0), (0.0, 2.0), (0.0, 1.0), (20.0, 1.0)];
    for pattern in 0..1 << 4 {
        let meshes: Vec<TriMesh> = shells
            .iter()
            .enumerate()
            .map(|(i, &(x, r))| {
                let mut mesh = cube([x, 0.0, 0.0], r);
                flip(&mut mesh, |_| pattern >> i & 1 == 1);
                mesh
            })
            .collect();
        let mut mesh = joined(&meshes);
        assert_eq!(orient(&mut mesh).unsigned, None);
        for (x, sign) in [
            (4.5, 1.0),
            (3.5, -1.0),
            (1.6, 1.0),
            (0.8, -1.0),
            (20.5, -1.0),
        ] {
            assert!(
                distance(&mesh, [x, 0.0, 0.0]) * sign > 0.0,
                "{pattern:b} {x}"
            );
        }
    }
}

#[test]
fn an_open_mesh_keeps_the_order_of_its_file_and_says_so() {
    let tube = || {
        let mut mesh = cube([0.0; 3], 1.0);
        mesh.triangles.drain(..4); // without floor and lid
        mesh
    };
    for inverted in [false, true] {
        let mut mesh = tube();
        flip(&mut mesh, |_| inverted);
        let found = orient(&mut mesh);
        assert_eq!(
            (found.turned, found.unsigned, found.open_edges),
            (0, None, 8)
        );
        // A bore's wall points to its axis: an inverted tube is as good.
        assert_eq!(distance(&mesh, [0.9, 0.0, 0.0]) > 0.0, inverted);
        assert!(found.to_string().contains("not closed (8 edges"), "{found}");
    }
}

/// A cube whose lid has its own corners on one edge, off by the rounding of a float: no light passes. Without a triangle it has a hole.
#[test]
fn a_crack_is_no_hole() {
    let mut cracked = cube([0.0; 3], 1.0);
    let anywhere = |_: [f64; 3]| true;
    assert_eq!(orient(&mut cracked.clone()).rim.edges_mm.len(), 0);
    let (from, to) = (
        cracked.vertices[cracked.triangles[0][0] as usize],
        cracked.vertices[cracked.triangles[0][1] as usize],
    );
    let third = cracked.vertices[cracked.triangles[0][2] as usize];
    let middle: [f64; 3] = std::array::from_fn(|k| (from[k] + to[k]) / 2.0 + 1e-6);
    let first = cracked.vertices.len() as u32;
    cracked.vertices.extend([from, middle, to, third]);
    cracked.triangles[0] = [first, first + 1, first + 3];
    cracked.triangles.push([first + 1, first + 2, first + 3]);
    let found = orient(&mut cracked);
    assert_eq!((found.open_edges, found.rim.hole(anywhere)), (3, None));
    cracked.triangles.pop();
    let rim = orient(&mut cracked).rim;
    let hole = rim.hole(anywhere).expect("a hole");
    assert!(hole.iter().all(|c| c.abs() <= 1.0 + 1e-6), "{hole:?}");
    assert_eq!(rim.hole(|[.., z]| z.abs() > 2.0), None, "asked elsewhere");
}

/// A strip of squares, of which one triangle is wound against the rest.
#[test]
fn a_few_wrong_triangles_of_an_open_mesh_are_turned_and_many_refused() {
    let strip = |count: u32| TriMesh {
        vertices: (0..=count)
            .flat_map(|i| [[f64::from(i), 0.0, 0.0], [f64::from(i), 1.0, 0.0]])
            .collect(),
        triangles: (0..count)
            .flat_map(|i| {
                [
                    [2 * i, 2 * i + 2, 2 * i + 1],
                    [2 * i + 2, 2 * i + 3, 2 * i + 1],
                ]
            })
            .collect(),
    };
    let mut mesh = strip(10);
    flip(&mut mesh, |i| i == 7);
    assert_eq!(orient(&mut mesh).turned, 1);
    assert!(distance(&mesh, [3.6, 0.5, 0.2]) > 0.0);
    let mut mesh = strip(10);
    flip(&mut mesh, |i| i % 4 == 0);
    let as_read = mesh.clone();
    let found = orient(&mut mesh);
    assert!(
        matches!(found.unsigned, Some(Unsigned::Mixed { share, .. }) if (share - 0.25).abs() < 1e-12),
        "{found:?}"
    );
    assert_eq!(mesh, as_read, "what cannot be told stays as it is");
}

#[test]
fn triangles_that_repeat_are_dropped() {
    let mut again = cube([0.0; 3], 1.0);
    flip(&mut again, |i| i % 2 == 0);
    let mut mesh = joined(&[cube([0.0; 3], 1.0), again]);
    let found = orient(&mut mesh);
    assert_eq!(
        (
            found.triangles,
            found.repeated,
            found.open_edges,
            found.unsigned
        ),
        (12, 12, 0, None)
    );
    assert!(!found.is_plain());
    assert!(
        found.to_string().contains("12 triangles repeat others"),
        "{found}"
    );
    assert!(distance(&mesh, [0.0, 0.0, 1.5]) > 0.0);
}

/// Meshes that others send and that once took cubic time. n log n orients them in a second; the square of the number of triangles
/// would take minutes, and the cube would never end.
#[test]
fn no_mesh_takes_more_than_its_share() {
    let repeated = |count: usize| joined(&vec![cube([0.0; 3], 1.0); count / 12]);
    // Triangles about one edge, of which none is closed and all boxes hold the middle.
    let fan = |count: usize| TriMesh {
        vertices: [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
            .into_iter()
            .chain((0..count).map(|i| {
                let (s, c) = (i as f64).sin_cos();
                [s * (1.0 + i as f64), c * (1.0 + i as f64), 0.0]
            }))
            .collect(),
        triangles: (0..count as u32).map(|i| [0, 1, i + 2]).collect(),
    };
    // A casting full of pores.
    let pores = |count: usize| {
        let mut all = vec![cube([0.0; 3], 100.0)];
        let along = |i: usize| [(i % 40) as f64, (i / 40) as f64, 0.0].map(|at| 2.0 * at - 50.0);
        all.extend((0..count / 12).map(|i| cube(along(i), 0.5)));
        joined(&all)
    };
    let all = [repeated(480_000), fan(480_000), pores(60_000)];
    for mut mesh in all {
        let given = mesh.triangles.len();
        orient(&mut mesh);
        assert!(!mesh.triangles.is_empty() && mesh.triangles.len() <= given);
    }
    let many = orient(&mut pores(12 * 2500));
    assert_eq!(many.unsigned, Some(Unsigned::Parts { parts: 2501 }));
    assert!(
        !orient(&mut pores(12 * 50)).is_plain(),
        "pores were wound as solids"
    );
}

#[test]
fn a_strip_with_a_half_turn_has_no_outside() {
    const COUNT: u32 = 12;
    let at = |i: u32, side: f64| -> [f64; 3] {
        let turn = f64::from(i) / f64::from(COUNT) * std::f64::consts::TAU;
        let (s, c) = (0.5 * turn).sin_cos();
        let radius = 5.0 + side * c;
        [radius * turn.cos(), radius * turn.sin(), side * s]
    };
    let vertices: Vec<[f64; 3]> = (0..COUNT).flat_map(|i| [at(i, -1.0), at(i, 1.0)]).collect();
    let triangles = (0..COUNT).flat_map(|i| {
        // The last square joins its ends crosswise.
        let [a, b] = [2 * i, 2 * i + 1];
        let [c, d] = if i + 1 < COUNT {
            [a + 2, b + 2]
        } else {
            [1, 0]
        };
        [[a, c, b], [c, d, b]]
    });
    let mut mesh = TriMesh {
        vertices,
        triangles: triangles.collect(),
    };
    let found = orient(&mut mesh);
    assert!(
        matches!(found.unsigned, Some(Unsigned::OneSided { .. })),
        "{found:?}"
    );
}

/// Twice the area of a triangle's image on the unit sphere about a point, rad: van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 125, 1983.
fn solid_angle([a, b, c]: [[f64; 3]; 3], at: [f64; 3]) -> f64 {
    let [a, b, c] = [a, b, c].map(|corner| Vector3::from(corner) - Vector3::from(at));
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    2.0 * a.dot(&b.cross(&c)).atan2(below)
}

/// Sum of the winding numbers of these bodies about a point, by brute force.
fn winding(bodies: &[TriMesh], at: [f64; 3]) -> f64 {
    let angles = bodies.iter().flat_map(|body| {
        let triangles = 0..body.triangles.len();
        triangles.map(|index| solid_angle(body.corners(index), at))
    });
    angles.sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// A box that is turned about its middle, wound outwards.
fn turned_box(random: &mut impl FnMut() -> f64, centre: [f64; 3], half: [f64; 3]) -> TriMesh {
    let turn = nalgebra::Rotation3::from_euler_angles(random(), 2.0 * random(), 3.0 * random());
    let mut mesh = cube([0.0; 3], 1.0);
    for vertex in &mut mesh.vertices {
        let own: Vector3<f64> = std::array::from_fn(|k| vertex[k] * half[k]).into();
        *vertex = (turn * own + Vector3::from(centre)).into();
    }
    mesh
}

/// Bodies that overlap, stick out of one another, stand apart or touch, and cavities within them: the sign is that of the sum of
/// all winding numbers, however the file wound each of them.
#[test]
fn assemblies_have_the_sign_of_their_winding_numbers() {
    let mut draws = 0;
    let mut random = || {
        draws += 1;
        flankscope_foundation::random::uniform(83, draws)
    };
    let (mut asked, mut inside, mut buried) = (0, 0, 0);
    for assembly in 0..30 {
        let count = 2 + assembly % 19;
        let mut bodies: Vec<TriMesh> = Vec::new();
        for body in 0..count {
            let centre: [f64; 3] = std::array::from_fn(|_| 8.0 * random());
            let half: [f64; 3] = std::array::from_fn(|_| 0.4 + 1.6 * random());
            if assembly % 3 == 0 {
                // Apart, each with a cavity and a body in it.
                let centre = [10.0 * body as f64, 0.0, 0.0];
                bodies.push(turned_box(&mut random, centre, [2.0; 3]));
                let mut cavity = turned_box(&mut random, centre, [1.0; 3]);
                flip(&mut cavity, |_| true);
                bodies.push(cavity);
                bodies.push(turned_box(&mut random, centre, [0.5; 3]));
            } else if assembly % 3 == 1 {
                bodies.push(turned_box(&mut random, centre, half));
            } else {
                // Along the axes on a grid, so that faces and edges touch; never one within another.
                let at = [f64::from(body as u32), 0.0, 0.0];
                bodies.push(cube(at, if body % 2 == 0 { 0.5 } else { 0.7 }));
            }
        }
        let oriented = bodies.clone();
        for (n, body) in bodies.iter_mut().enumerate() {
            // If bodies cross, only the file's order tells whether a part wholly inside one of them is a cavity.
            let others = || oriented.iter().enumerate().filter(|&(m, _)| m != n);
            let is_in = |other: &TriMesh| {
                let mut corners = body.vertices.iter();
                corners.all(|&at| winding(std::slice::from_ref(other), at) > 0.5)
            };
            let is_held = assembly % 3 == 1 && others().any(|(_, other)| is_in(other));
            let wrong = !is_held && random() < 0.3;
            flip(body, |_| wrong);
        }
        let mut mesh = joined(&bodies);
        let found = orient(&mut mesh);
        assert_eq!((found.unsigned, found.open_edges), (None, 0), "{assembly}");
        let surface = Surface::oriented(&mesh, &found).unwrap();
        let low = surface.bounds().low.map(|v| v - 0.5);
        let size: [f64; 3] = std::array::from_fn(|k| surface.bounds().high[k] + 0.5 - low[k]);
        let points: Vec<[f64; 3]> = (0..10_000)
            .map(|_| std::array::from_fn(|k| low[k] + size[k] * random()))
            .collect();
        let mut distances_mm = vec![0.0; points.len()];
        surface.signed_distances(&points, &mut distances_mm);
        for (&point, distance_mm) in points.iter().zip(distances_mm) {
            if distance_mm.abs() < 1e-9 {
                continue;
            }
            let winding = winding(&oriented, point);
            let is_inside = winding > 0.5;
            assert_eq!(
                distance_mm < 0.0,
                is_inside,
                "{assembly}: {point:?} {winding} {distance_mm}"
            );
            assert_eq!(surface.closest(point).signed_distance_mm, distance_mm);
            asked += 1;
            inside += usize::from(is_inside);
            buried += usize::from(winding > 1.5);
        }
    }
    assert!(
        asked > 290_000 && inside > 20_000 && buried > 1_000,
        "{asked} {inside} {buried}"
    );
}
