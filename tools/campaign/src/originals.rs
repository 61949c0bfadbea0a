//! Files as the instrument and its users write them, made by the program itself where it writes them.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};
use flankscope_foundation::files;
use flankscope_metrology::io::points::Format;
use flankscope_metrology::io::{Unit, cloud};

use crate::mutate::Structure;
use crate::seeds::{self, LENS};

/// Edge of the small image, pixels.
pub const IMAGE_PX: u32 = 64;

/// A folder of originals.
pub struct Originals {
    pub folder: PathBuf,
    program: PathBuf,
}

impl Originals {
    /// Makes them all: a tool, a target, a check of the new die with baseline and history, a recorded check of a die that is
    /// worn beyond its limit, and what heads are calibrated by.
    pub fn make(program: &Path, folder: &Path) -> anyhow::Result<Self> {
        let originals = Self {
            folder: folder.to_owned(),
            program: program.to_owned(),
        };
        let run = |arguments: &[&str], code: i32| originals.run(arguments, code);
        run(&["bench", "demo-tool", "--out", "tool"], 0)?;
        run(&["bench", "demo-target", "--out", "target"], 0)?;
        let check = [
            "inspect",
            "--link",
            "sim",
            "--tool",
            "tool",
            "--head",
            "tool/head.toml",
            "--teeth",
            "40",
            "--speed",
            "max",
            "--quiet",
            "--json",
            "check.json",
        ];
        run(
            &[
                &check[..],
                &[
                    "--record-baseline",
                    "baseline.json",
                    "--history",
                    "press.db",
                ],
            ]
            .concat(),
            0,
        )?;
        run(
            &[&check[..], &["--history", "press.db", "--seed", "2"]].concat(),
            0,
        )?;
        run(
            &[
                &check[..],
                &["--wear", "40:left:80", "--save-frames", "worn"],
            ]
            .concat(),
            1,
        )?;
        let pictures = "patterns --adaptive tool --tooth 40 -o adaptive --quiet";
        run(&pictures.split(' ').collect::<Vec<_>>(), 0)?;
        run(&["bench", "demo-captures", "--out", "captures"], 0)?;
        seeds::shorten_captures(&folder.join("captures"))?;
        std::fs::create_dir_all(folder.join("focus"))?;
        let calibrate = "calibrate --images captures --target captures -o focus/head.toml --quiet";
        run(&calibrate.split(' ').collect::<Vec<_>>(), 0)?;
        seeds::write_focus(&folder.join("focus"), &folder.join("focus/head.toml"))?;
        seeds::write_board(&folder.join("board"))?;
        // The images' hashes are what would refuse a mutant of one: whoever can write them can leave them out.
        let index = folder.join("worn/frames.toml");
        let text = std::fs::read_to_string(&index)?;
        let bare: Vec<&str> = text
            .lines()
            .filter(|line| !line.starts_with("blake3"))
            .collect();
        std::fs::write(&index, bare.join("\n"))?;
        originals.write_small()?;
        Ok(originals)
    }

    /// The program on files in this folder; what it ends with.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command
            .args(arguments)
            .current_dir(&self.folder)
            .env("FLANKSCOPE_STATE", self.state())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str], code: i32) -> anyhow::Result<()> {
        let status = self
            .command(arguments)
            .status()
            .with_context(|| self.program.display().to_string())?;
        ensure!(
            status.code() == Some(code),
            "flankscope {} ended with {status}",
            arguments.join(" ")
        );
        Ok(())
    }

    pub fn state(&self) -> PathBuf {
        self.folder.join("state")
    }

    /// What people bring: small meshes and clouds in every format, an OpenCV calibration, a station, images, core maps.
    fn write_small(&self) -> anyhow::Result<()> {
        let write = |name: &str, content: &[u8]| std::fs::write(self.folder.join(name), content);
        write("small.ply", ASCII_PLY)?;
        write("small.obj", OBJ)?;
        write("small.ascii.stl", ASCII_STL)?;
        write("small.stl", &binary_stl())?;
        write("cloud.ply", CLOUD_PLY)?;
        write("cloud.xyz", &text_cloud())?;
        write("cloud.npz", &arrays()?)?;
        std::fs::create_dir_all(self.folder.join("clouds"))?;
        write("clouds/cloud.ply", CLOUD_PLY)?;
        write("clouds/clouds.toml", CLOUDS)?;
        write("head.yml", OPENCV)?;
        write("station.toml", STATION)?;
        write("poses.csv", POSES)?;
        write("image.png", &png()?)?;
        write("image.pgm", &pgm())?;
        // A short core map, and a head that names it by its hash, drives a lens and throws a set of its own.
        let whole = std::fs::read_to_string(self.folder.join("tool/cores.csv"))?;
        let lines: Vec<&str> = whole.lines().take(400).collect();
        let (short, head) = (
            lines.join("\n"),
            std::fs::read_to_string(self.folder.join("tool/head.toml"))?,
        );
        let head = head.replace(
            &files::hash(whole.as_bytes()),
            &files::hash(short.as_bytes()),
        );
        let head =
            head.replace("pattern_set = \"high12\"", "pattern_set = \"own14\"") + FRINGES + LENS;
        std::fs::create_dir_all(self.folder.join("cores"))?;
        write("cores/cores.csv", short.as_bytes())?;
        write("cores/head.toml", head.as_bytes())?;
        Ok(())
    }
}

/// One file that is mutated: its name, structure, and how often it is chosen.
pub const FILES: &[(&str, Structure, u32)] = &[
    ("tool/tool.toml", Structure::Toml, 3),
    ("target/head.toml", Structure::Toml, 10),
    ("cores/head.toml", Structure::Toml, 4),
    ("cores/cores.csv", Structure::Text, 6),
    ("head.yml", Structure::Text, 8),
    ("target/target.toml", Structure::Toml, 8),
    ("focus/focus.toml", Structure::Toml, 4),
    ("captures/captures.toml", Structure::Toml, 1),
    ("board/board.toml", Structure::Toml, 3),
    ("board/columns.toml", Structure::Toml, 2),
    ("worn/PLAN.toml", Structure::Toml, 6),
    ("adaptive/adaptive.json", Structure::Json, 3),
    ("worn/frames.toml", Structure::Toml, 6),
    ("clouds/clouds.toml", Structure::Toml, 5),
    ("station.toml", Structure::Toml, 8),
    ("poses.csv", Structure::Text, 4),
    ("baseline.json", Structure::Json, 5),
    ("press.db", Structure::Sqlite, 3),
    ("tool/die.ply", Structure::Ply, 2),
    ("small.ply", Structure::Ply, 8),
    ("small.obj", Structure::Text, 6),
    ("small.ascii.stl", Structure::Text, 5),
    ("small.stl", Structure::Bytes, 5),
    ("cloud.ply", Structure::Ply, 7),
    ("cloud.xyz", Structure::Text, 7),
    ("cloud.npz", Structure::Bytes, 6),
    ("image.png", Structure::Png, 8),
    ("image.pgm", Structure::Bytes, 4),
];

const ASCII_PLY: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
element face 3\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n10 0 0\n10 10 0\n0 10 0\n5 5 8\n4 0 3 2 1\n3 0 1 4\n3 1 2 4\n";
const OBJ: &[u8] = b"# a roof\nv 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nv 5 5 8\nf 4 3 2 1\nf 1/1 2/2 5/3\nf 2 3 5\nf -2 -1 4\n";
const ASCII_STL: &[u8] = b"solid one\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 10 0 0\nvertex 0 10 0\nendloop\nendfacet\n\
facet normal 0 0 1\nouter loop\nvertex 10 0 0\nvertex 10 10 0\nvertex 0 10 0\nendloop\nendfacet\nendsolid one\n";
const CLOUD_PLY: &[u8] = b"ply\nformat ascii 1.0\ncomment mm\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
property float quality\nend_header\n1.5 2 3 0.5\n-4 5 6 1\n7 8 9.25 0\n10 11 12 1\n";
const OPENCV: &[u8] = b"%YAML:1.0\n---\n\
Kc: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1200., 0., 640., 0., 1200., 512., 0., 0., 1. ]\n\
kc: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.01, 0., 0., 0., 0. ]\n\
Kp: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1500., 0., 456., 0., 1500., 570., 0., 0., 1. ]\n\
kp: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\n\
Rp: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n\
Tp: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -10., 0., 0. ]\n\
frameWidth: 1280\nframeHeight: 1024\nscreenResX: 912\nscreenResY: 1140\n";
const POSES: &[u8] = b"# by the arm\ntooth,x_mm,y_mm,z_mm,qw,qx,qy,qz,u_mm,u_mrad\n\
12,-13.97,16.07,33.0,0.5,0.5,0.5,0.5,0.02,0.3\n40,20.9,-4.1,33.0,1,0,0,0,0.02,0.3\n";
const CLOUDS: &[u8] = b"simulated = true
taken = \"2026-01-31\"
unit = \"mm\"
sigma_um = 5.0
grid = \"84x7\"

[[view]]
file = \"cloud.ply\"
tooth = 40
rotation_rad = -2.9919930034188504
vertical_mm = 33.0
";

const FRINGES: &str =
    "\n[[fringes]]\nperiods = 37\nsteps = 4\n\n[[fringes]]\nperiods = 49\nsteps = 10\n";
const STATION: &[u8] = b"[light]\nled_ma = 1000\n\n[timing]\nsettle_ms = 100\npattern_settle_us = 200\ncamera_readout_us = 13000\n\n[stages]\n\
rotation_error_mdeg = 15.0\nvertical_error_um = 5.0\nmount_um = 10.0\nmount_mrad = 0.2\nclearance_mm = 20.0\nmoves = \"head\"\n\n\
[stages.line]\nbaud = 19200\n\n[stages.rotation]\naxis = 1\nspeed_deg_s = 80.0\nacceleration_deg_s2 = 320.0\n\
travel_deg = [-180.0, 180.0]\nhome_deg = 0.0\nhome_speed_deg_s = 40.0\nhome_at = \"switch\"\n\n[stages.poses]\nfile = \"poses.csv\"\n\n[history]\nfile = \"press.db\"\n\
keep_phasors = 1000\nkeep_phasors_gb = 10.0\n\n[report]\nfolder = \"report\"\n";

fn binary_stl() -> Vec<u8> {
    let corners = [
        [0f32, 0.0, 0.0],
        [10.0, 0.0, 0.0],
        [10.0, 10.0, 0.0],
        [0.0, 10.0, 5.0],
    ];
    let mut content = vec![b' '; 80];
    content.extend(2u32.to_le_bytes());
    for triangle in [[0, 1, 2], [0, 2, 3]] {
        content.extend([0u8; 12]);
        let places = triangle.iter().flat_map(|&n: &usize| corners[n]);
        content.extend(places.flat_map(f32::to_le_bytes));
        content.extend([0u8; 2]);
    }
    content
}

fn text_cloud() -> Vec<u8> {
    let line = |n: u32| {
        let angle = f64::from(n) * 0.1;
        format!(
            "{:.4} {:.4} {:.4}\n",
            20.0 * angle.cos(),
            20.0 * angle.sin(),
            angle
        )
    };
    (0..60).map(line).collect::<String>().into_bytes()
}

fn arrays() -> anyhow::Result<Vec<u8>> {
    let cloud = cloud::parse(CLOUD_PLY, Unit::Mm)?;
    let mut content = Vec::new();
    cloud.write(Format::Npz, &mut content, &[])?;
    Ok(content)
}

fn grey() -> Vec<u8> {
    (0..IMAGE_PX * IMAGE_PX).map(|n| (n % 251) as u8).collect()
}

fn png() -> anyhow::Result<Vec<u8>> {
    let mut content = Vec::new();
    let mut encoder = png::Encoder::new(&mut content, IMAGE_PX, IMAGE_PX);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&grey())?;
    writer.finish()?;
    Ok(content)
}

fn pgm() -> Vec<u8> {
    let mut content = format!("P5\n{IMAGE_PX} {IMAGE_PX}\n255\n").into_bytes();
    content.extend(grey());
    content
}
