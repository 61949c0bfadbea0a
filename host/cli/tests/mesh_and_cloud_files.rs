//! Meshes and clouds as files: damaged ones are refused by every command that reads them, the formats agree, and a full disk is named.

mod support;

use flankscope_metrology::io::{mesh, ply};
use support::{assert_refused, flankscope, json, write_xyz};

/// A cube of 10 mm.
fn cube() -> mesh::TriMesh {
    let vertices = (0..8)
        .map(|i| {
            [
                f64::from(i & 1),
                f64::from(i >> 1 & 1),
                f64::from(i >> 2 & 1),
            ]
            .map(|c| 10.0 * c)
        })
        .collect();
    let triangles = vec![
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
        [2, 7, 3],
        [2, 6, 7],
        [0, 4, 6],
        [0, 6, 2],
        [1, 3, 7],
        [1, 7, 5],
    ];
    mesh::TriMesh {
        vertices,
        triangles,
    }
}

fn ply_mesh(header: &str, body: &[u8]) -> Vec<u8> {
    [format!("ply\n{header}end_header\n").as_bytes(), body].concat()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";
const FACE: &str = "property list uchar int vertex_indices\n";

/// Damaged meshes and a word that the error must contain.
fn bad_meshes() -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let mut stl = Vec::new();
    mesh::write_stl(&mut stl, &cube()).unwrap();
    let mut cut = stl.clone();
    cut.truncate(300);
    let mut lying = stl.clone();
    lying[80..84].copy_from_slice(&(u32::MAX - 1).to_le_bytes());
    let mut nan = stl.clone();
    nan[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut infinite = stl.clone();
    infinite[96..100].copy_from_slice(&f32::INFINITY.to_le_bytes());
    let mut metres = Vec::new();
    let mut small = cube();
    for v in &mut small.vertices {
        *v = v.map(|c| 1e-3 * c);
    }
    mesh::write_stl(&mut metres, &small).unwrap();
    let mut ply = Vec::new();
    ply::write_mesh(
        &mut ply,
        "cube",
        (&cube().vertices, ply::Scalar::F64),
        &[],
        &cube().triangles,
    )
    .unwrap();
    let mut cut_ply = ply.clone();
    cut_ply.truncate(ply.len() - 20);
    let little = "format binary_little_endian 1.0\n";
    let counts = format!("{little}element vertex 4294967295\n{XYZ}element face 1\n{FACE}");
    let hollow = format!("{little}element vertex 50000000\nelement face 1\n{FACE}");
    let faces = format!("{little}element vertex 0\n{XYZ}element face 4294967295\n{FACE}");
    let ascii = |points: &str, face: &str| {
        let header = format!("format ascii 1.0\nelement vertex 3\n{XYZ}element face 1\n{FACE}");
        ply_mesh(&header, format!("{points}{face}\n").as_bytes())
    };
    let three = "0 0 0\n10 0 0\n0 10 0\n";
    vec![
        ("empty.stl", vec![], "empty"),
        (
            "foreign.stl",
            b"\x89PNG\r\n\x1a\n and so on".repeat(20),
            "an image (PNG)",
        ),
        (
            "text.ply",
            b"hello, this is a letter\n".to_vec(),
            "neither PLY",
        ),
        ("cut.stl", cut, "truncated"),
        ("lying.stl", lying, "4294967294"),
        ("nan.stl", nan, "NaN"),
        ("infinite.stl", infinite, "inf"),
        ("metres.stl", metres, "--cad-unit m"),
        (
            "none.stl",
            [vec![b' '; 80], vec![0; 4]].concat(),
            "no triangles",
        ),
        (
            "open.stl",
            b"solid a\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n".to_vec(),
            "endsolid",
        ),
        (
            "nan_ascii.stl",
            b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 nan 0\n".to_vec(),
            "line 4",
        ),
        ("cut.ply", cut_ply, "truncated"),
        (
            "header.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 8\n".to_vec(),
            "end_header",
        ),
        ("count.ply", ply_mesh(&counts, &[0; 64]), "4294967295"),
        ("faces.ply", ply_mesh(&faces, &[0; 64]), "4294967295"),
        (
            "hollow.ply",
            ply_mesh(&hollow, &[0; 64]),
            "without any property",
        ),
        ("index.ply", ascii(three, "3 0 1 7"), "vertex 7"),
        ("negative.ply", ascii(three, "3 0 1 -5"), "vertex -5"),
        ("corners.ply", ascii(three, "2 0 1"), "2 corners"),
        (
            "nan.ply",
            ascii("0 0 0\n10 nan 0\n0 10 0\n", "3 0 1 2"),
            "line 11",
        ),
        (
            "word.ply",
            ascii("0 0 0\n10 zero 0\n0 10 0\n", "3 0 1 2"),
            "zero",
        ),
        (
            "huge.ply",
            ascii("0 0 0\n1e300 0 0\n0 1e300 0\n", "3 0 1 2"),
            "10000 mm",
        ),
        (
            "flat.ply",
            ascii("0 0 0\n10 0 0\n20 0 0\n", "3 0 1 2"),
            "degenerate",
        ),
        (
            "index.obj",
            b"v 0 0 0\nv 10 0 0\nv 0 10 0\nf 1 2 9\n".to_vec(),
            "vertex 8",
        ),
        (
            "zero.obj",
            b"v 0 0 0\nv 10 0 0\nv 0 10 0\nf 0 1 2\n".to_vec(),
            "vertex 0",
        ),
    ]
}

/// The run ended with exit 3, one readable line, and left nothing behind but its inputs.
#[test]
fn damaged_meshes_are_refused_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    write_xyz(&folder.path().join("cloud.xyz"), &[[1.0, 2.0, 3.0]; 200]);
    for (name, bytes, word) in bad_meshes() {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        for command in [
            vec!["sample", "--cad", name, "--count", "10", "-o", "out.ply"],
            vec![
                "register",
                "--cad",
                name,
                "--cloud",
                "cloud.xyz",
                "-o",
                "out.ply",
            ],
            vec![
                "deviation",
                "--cad",
                name,
                "--cloud",
                "cloud.xyz",
                "-o",
                "out.ply",
            ],
        ] {
            let output = flankscope(folder.path(), &command);
            assert_refused(
                folder.path(),
                &format!("{} {name}", command[0]),
                &output,
                &[name, word],
            );
        }
        std::fs::remove_file(folder.path().join(name)).unwrap();
    }
    let left: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|f| f.unwrap().file_name())
        .collect();
    assert_eq!(left, ["cloud.xyz"]);
}

#[test]
fn damaged_clouds_and_start_poses_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut stl = Vec::new();
    mesh::write_stl(&mut stl, &cube()).unwrap();
    std::fs::write(folder.path().join("cube.stl"), stl).unwrap();
    let grid: Vec<[f64; 3]> = (0..400)
        .map(|i| [f64::from(i % 20) * 0.5, f64::from(i / 20) * 0.5, 10.0])
        .collect();
    write_xyz(&folder.path().join("good.xyz"), &grid);

    let little = "format binary_little_endian 1.0\n";
    let count = ply_mesh(
        &format!("{little}element vertex 4294967295\n{XYZ}"),
        &[0; 24],
    );
    let nan = ply_mesh(&format!("{little}element vertex 1\n{XYZ}"), &[0xff; 12]);
    let clouds: [(&str, Vec<u8>, &str); 8] = [
        ("empty.xyz", vec![], "empty"),
        ("comment.xyz", b"# nothing\n".to_vec(), "no points"),
        (
            "nan.xyz",
            b"1 2 nan\n4 nan 6\n".to_vec(),
            "none of the 2 points",
        ),
        ("short.xyz", b"1 2 3\n4 5\n".to_vec(), "line 2"),
        (
            "image.xyz",
            b"\x89PNG\r\n\x1a\n\0\0".to_vec(),
            "neither PLY nor text",
        ),
        ("count.ply", count, "4294967295"),
        ("nan.ply", nan, "none of the 1 points"),
        (
            "noy.ply",
            ply_mesh(
                &format!("{little}element vertex 1\nproperty float x\n"),
                &[0; 12],
            ),
            "`y`",
        ),
    ];
    for (name, bytes, word) in clouds {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        for command in ["register", "deviation"] {
            let output = flankscope(
                folder.path(),
                &[
                    command, "--cad", "cube.stl", "--cloud", name, "-o", "out.ply",
                ],
            );
            assert_refused(
                folder.path(),
                &format!("{command} {name}"),
                &output,
                &[name, word],
            );
        }
        let args = [
            "merge",
            "good.xyz",
            name,
            "--voxel-mm",
            "0.5",
            "-o",
            "out.ply",
        ];
        let output = flankscope(folder.path(), &args);
        assert_refused(
            folder.path(),
            &format!("merge {name}"),
            &output,
            &[name, word],
        );
    }
    write_xyz(&folder.path().join("three.xyz"), &grid[..3]);
    let output = flankscope(
        folder.path(),
        &[
            "register",
            "--cad",
            "cube.stl",
            "--cloud",
            "three.xyz",
            "-o",
            "out.ply",
            "--json",
            "-",
        ],
    );
    assert_refused(
        folder.path(),
        "three points",
        &output,
        &["three.xyz", "3 points", "at least 100"],
    );

    let start_poses = [
        (
            "--init",
            "scale.json",
            "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]",
            "scales",
        ),
        (
            "--init",
            "mirror.json",
            "[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]",
            "mirrors",
        ),
        (
            "--init",
            "column.json",
            "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[5,6,7,1]]",
            "row-major",
        ),
        ("--init", "short.json", "[[1,0,0,0]]", "right would be"),
        ("--init", "broken.json", "[[1,0,0,0],\n[0,1", "line 2"),
        (
            "--pairs",
            "two.csv",
            "1,2,3,1,2,3\n4,5,6,4,5,6\n",
            "at least 3",
        ),
        (
            "--pairs",
            "line.csv",
            "0,0,0,0,0,0\n1,1,1,1,1,1\n2,2,2,2,2,2\n",
            "line",
        ),
        (
            "--pairs",
            "word.csv",
            "0,0,0,0,0,0\n1,1,1,1,1,one\n",
            "line 2",
        ),
    ];
    for (option, name, text, word) in start_poses {
        std::fs::write(folder.path().join(name), text).unwrap();
        let output = flankscope(
            folder.path(),
            &[
                "register", "--cad", "cube.stl", "--cloud", "good.xyz", option, name, "-o",
                "out.ply",
            ],
        );
        assert_refused(folder.path(), name, &output, &[name, word]);
    }
    for args in [
        vec![
            "deviation",
            "--cad",
            "cube.stl",
            "--cloud",
            "absent.ply",
            "-o",
            "out.ply",
        ],
        vec![
            "deviation",
            "--cad",
            "absent.stl",
            "--cloud",
            "good.xyz",
            "-o",
            "out.ply",
        ],
        vec![
            "deviation",
            "--cad",
            "cube.stl",
            "--cloud",
            "good.xyz",
            "-o",
            "absent/out.ply",
        ],
    ] {
        assert_refused(
            folder.path(),
            "absent",
            &flankscope(folder.path(), &args),
            &["absent"],
        );
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_named_and_the_device_stays() {
    use std::os::unix::fs::FileTypeExt;
    let folder = tempfile::tempdir().unwrap();
    let mut stl = Vec::new();
    mesh::write_stl(&mut stl, &cube()).unwrap();
    std::fs::write(folder.path().join("cube.stl"), stl).unwrap();
    let is_device = || std::fs::metadata("/dev/full").is_ok_and(|m| m.file_type().is_char_device());
    if !is_device() {
        println!("SKIPPED a_full_disk_is_named_and_the_device_stays: /dev/full is not there");
        return;
    }
    let output = flankscope(
        folder.path(),
        &[
            "sample",
            "--cad",
            "cube.stl",
            "--count",
            "10",
            "-o",
            "/dev/full",
        ],
    );
    assert_refused(
        folder.path(),
        "full",
        &output,
        &["/dev/full", "No space left"],
    );
    let output = flankscope(
        folder.path(),
        &[
            "sample",
            "--cad",
            "cube.stl",
            "--count",
            "10",
            "-o",
            "ok.ply",
            "--json",
            "/dev/full",
            "--quiet",
        ],
    );
    assert_refused(
        folder.path(),
        "full json",
        &output,
        &["/dev/full", "No space left"],
    );
    assert!(is_device(), "the device was replaced by a file");
}

#[test]
fn formats_agree() {
    let folder = tempfile::tempdir().unwrap();
    let cube = cube();
    let mut stl = Vec::new();
    mesh::write_stl(&mut stl, &cube).unwrap();
    let mut ply = Vec::new();
    ply::write_mesh(
        &mut ply,
        "cube",
        (&cube.vertices, ply::Scalar::F64),
        &[],
        &cube.triangles,
    )
    .unwrap();
    let corner = |i: u32| cube.vertices[i as usize].map(|c| c.to_string()).join(" ");
    let mut ascii_stl = String::from("solid cube\n");
    for t in &cube.triangles {
        let lines = t.map(|i| format!("vertex {}\n", corner(i))).concat();
        ascii_stl += &format!("facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet\n");
    }
    ascii_stl += "endsolid cube\n";
    let mut obj = String::from("# cube\n");
    let mut big = ply_mesh(
        &format!(
            "format binary_big_endian 1.0\nelement vertex 8\n{}element face 12\nproperty uchar flags\n{FACE}",
            XYZ.replace("float", "short")
        ),
        &[],
    );
    for v in &cube.vertices {
        obj += &format!("v {} {} {}\n", v[0], v[1], v[2]);
        big.extend(v.iter().flat_map(|&c| (c as i16).to_be_bytes()));
    }
    for t in &cube.triangles {
        obj += &format!("f {}/1 {}//2 -{}\n", t[0] + 1, t[1] + 1, 8 - t[2]);
        big.extend([9, 3]);
        big.extend(t.iter().flat_map(|&i| (i as i32).to_be_bytes()));
    }
    let points: Vec<[f64; 3]> = (0..50)
        .map(|i| {
            [
                f64::from(i) * 0.3 - 2.0,
                f64::from(i % 7) * 2.0 - 1.0,
                f64::from(i % 5) * 3.0 - 1.0,
            ]
        })
        .collect();
    write_xyz(&folder.path().join("points.xyz"), &points);
    let mut results = Vec::new();
    for (name, bytes) in [
        ("a.stl", stl),
        ("b.stl", ascii_stl.into_bytes()),
        ("c.ply", ply),
        ("d.ply", big),
        ("e.obj", obj.into_bytes()),
    ] {
        std::fs::write(folder.path().join(name), bytes).unwrap();
        let output = flankscope(
            folder.path(),
            &[
                "deviation",
                "--cad",
                name,
                "--cloud",
                "points.xyz",
                "-o",
                "d.ply",
                "--json",
                "-",
            ],
        );
        assert_eq!(output.status.code(), Some(0), "{name}: {output:?}");
        assert_eq!(json(&output)["count"], 50);
        results.push(std::fs::read(folder.path().join("d.ply")).unwrap());
    }
    assert!(results.windows(2).all(|pair| pair[0] == pair[1]));
    // By hand: the first point is outside three faces, at (-2, -1, -1).
    let table = ply::read(&results[0], ply::Want::Extras).unwrap();
    assert!((table.extras[0].values().next().unwrap() - 6f64.sqrt()).abs() < 1e-6);
}

/// A name says what is written, or nothing is: points are no STL.
#[test]
fn endings_that_are_not_written_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_xyz(&folder.join("cloud.xyz"), &[[1.0, 2.0, 3.0]; 20]);
    for name in ["out.stl", "out.txt", "out.PLYX"] {
        let args = ["merge", "cloud.xyz", "--voxel-mm", "1", "-o", name];
        let output = flankscope(folder, &args);
        assert_eq!(output.status.code(), Some(3), "{name}: {output:?}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(name) && said.contains("name.ply"), "{said}");
        assert!(!folder.join(name).exists());
    }
    for name in ["out.ply", "out.NPZ", "out.xyz", "out"] {
        let args = ["merge", "cloud.xyz", "--voxel-mm", "1", "-o", name];
        assert_eq!(flankscope(folder, &args).status.code(), Some(0), "{name}");
        assert!(folder.join(name).exists());
    }
}
