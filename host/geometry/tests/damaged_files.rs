//! Thousands of damaged files: whatever the bytes, the answer is a mesh that keeps its promises or an error.

use flankscope_geometry::io::Unit;
use flankscope_geometry::io::cloud;
use flankscope_geometry::io::mesh::{self, MeshError, TriMesh};
use flankscope_geometry::io::ply;
use flankscope_geometry::surface::Surface;
use flankscope_test_requisites::Random;

fn tetrahedron() -> TriMesh {
    TriMesh {
        vertices: vec![
            [0.0, 0.0, 0.0],
            [10.0, 0.0, 0.0],
            [0.0, 10.0, 0.0],
            [0.0, 0.0, 10.0],
        ],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

fn originals() -> Vec<Vec<u8>> {
    let mesh = tetrahedron();
    let mut stl = Vec::new();
    mesh::write_stl(&mut stl, &mesh).unwrap();
    let mut little = Vec::new();
    ply::write_mesh(
        &mut little,
        "tetrahedron",
        (&mesh.vertices, ply::Scalar::F64),
        &[],
        &mesh.triangles,
    )
    .unwrap();
    let text = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0 1\n10 0 0 2\n0 10 0 3\n0 0 10 4\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";
    let mut big =
        b"ply\nformat binary_big_endian 1.0\nelement edge 2\nproperty list ushort short at\n\
        element vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list int uint vertex_index\nend_header\n"
            .to_vec();
    big.extend([0, 1, 0, 7, 0, 0]);
    for value in [0.0f32, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 10.0, 0.0] {
        big.extend(value.to_be_bytes());
    }
    big.extend([0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2]);
    let solid = b"solid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 10 0 0\nvertex 0 10 0\nendloop\nendfacet\nendsolid t\n";
    let obj = b"v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1/1 3/2 2/3\nf -4 -3 -1\nf 1 2 3 4\n";
    vec![
        stl,
        little,
        text.to_vec(),
        big,
        solid.to_vec(),
        obj.to_vec(),
    ]
}

#[test]
fn no_damage_gets_through_or_brings_the_reader_down() {
    let mut random = Random(20);
    let (mut accepted, mut refused) = (0, 0);
    for original in originals() {
        assert!(
            mesh::parse(&original, Unit::Mm).is_ok(),
            "{}",
            String::from_utf8_lossy(&original)
        );
        for _ in 0..4000 {
            let mut bytes = original.clone();
            for _ in 0..1 + (random.uniform() * 4.0) as usize {
                let at = (random.uniform() * bytes.len() as f64) as usize;
                match (random.uniform() * 4.0) as u32 {
                    0 => bytes[at] = (random.uniform() * 256.0) as u8,
                    1 => bytes[at] ^= 1 << (random.uniform() * 8.0) as u32,
                    2 => bytes.truncate(at.max(1)),
                    _ => bytes.insert(
                        at,
                        b"0123456789 -\n\xff"[(random.uniform() * 14.0) as usize],
                    ),
                }
            }
            match mesh::parse(&bytes, Unit::Mm) {
                Ok(mesh) => {
                    accepted += 1;
                    mesh.check().unwrap();
                    if let Ok(surface) = Surface::new(&mesh) {
                        assert!(
                            surface
                                .closest([1.0, 2.0, 3.0])
                                .signed_distance_mm
                                .is_finite()
                        );
                    }
                }
                // Read by commands that say what they ignore.
                Err(MeshError::StlIrregular { .. }) => {
                    let (mesh, _) = mesh::parse_tolerant(&bytes, Unit::Mm).unwrap();
                    mesh.check().unwrap();
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
            if let Ok(cloud) = cloud::parse(&bytes, Unit::Mm) {
                assert!(cloud.points.iter().flatten().all(|c| c.is_finite()));
            }
            if let Ok((cloud, _)) = cloud::parse_finite(&bytes, Unit::Mm) {
                assert!(!cloud.points.is_empty());
                assert!(cloud.points.iter().flatten().all(|c| c.is_finite()));
            }
        }
    }
    // Both kinds occur, else the damage tests nothing.
    assert!(
        accepted > 1000 && refused > 1000,
        "{accepted} accepted, {refused} refused"
    );
}
