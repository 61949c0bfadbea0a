//! A plan with a Gray code, end to end: the pictures that `patterns` writes, seen by a camera of this test's own, and `decode`.
//!
//! The camera looks mirrors up in the pictures; it knows no formula of fringe or code.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use flankscope_test_requisites::Random;

const CAMERA: [u32; 2] = [160, 120];
const MIRRORS: [u32; 2] = [256, 192];
const BASELINE_MM: f64 = 30.0;

fn flankscope(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_flankscope"))
        .args(arguments)
        .output()
        .expect("the binary starts")
}

struct Rig {
    folder: tempfile::TempDir,
    rows: bool,
}

/// Depth along a ray: a slanted plane, and behind it another.
fn depth_mm([x, y]: [f64; 2]) -> f64 {
    let step = if y > 0.11 { 9.0 } else { 0.0 };
    (100.0 + step) / (1.0 - 0.2 * x - 0.1 * y)
}

impl Rig {
    fn new(plan: &str, volume: &str) -> Self {
        let rig = Self {
            folder: tempfile::tempdir().expect("a folder"),
            rows: plan.contains("fringes_along"),
        };
        let (principal, shift) = rig.projector();
        let head = format!(
            "name = \"test\"\n[camera]\nwidth_px = 160\nheight_px = 120\nfocal_px = [200.0, 200.0]\nprincipal_px = [79.5, 59.5]\n\
             [projector]\nwidth_px = 256\nheight_px = 192\nfocal_px = [300.0, 300.0]\nprincipal_px = {principal:?}\n\
             [projector_from_camera]\nrotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\ntranslation_mm = {shift:?}\n\
             [sensor]\nfull_well_e = 10000.0\ngain_e_per_dn = 2.5\nread_noise_e = 5.0\noffset_dn = 100.0\nbits = 12\n{volume}"
        );
        std::fs::write(rig.path("head.toml"), head).expect("written");
        std::fs::write(rig.path("PLAN.toml"), plan).expect("written");
        std::fs::create_dir(rig.path("frames")).expect("created");
        rig
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().expect("UTF-8").to_owned()
    }

    /// Principal point and place of the projector: beside the camera, or above it.
    fn projector(&self) -> ([f64; 2], [f64; 3]) {
        match self.rows {
            false => ([217.5, 95.5], [-BASELINE_MM, 0.0, 0.0]),
            true => ([127.5, 175.5], [0.0, -BASELINE_MM, 0.0]),
        }
    }

    /// The pictures as `patterns` writes them, in the order of its manifest.
    fn pictures(&self) -> Vec<Vec<u8>> {
        let (head, plan, out) = (
            self.text("head.toml"),
            self.text("PLAN.toml"),
            self.text("dmd"),
        );
        let wrote = flankscope(&[
            "patterns", "--head", &head, "--set", &plan, "-o", &out, "-q",
        ]);
        let error = String::from_utf8_lossy(&wrote.stderr);
        assert!(wrote.status.success(), "{error}");
        let folder = self.path("dmd/plan");
        let manifest = std::fs::read(folder.join("patterns.json")).expect("a manifest");
        let manifest: serde_json::Value = serde_json::from_slice(&manifest).expect("JSON");
        let patterns = manifest["patterns"].as_array().expect("patterns");
        let read = |pattern: &serde_json::Value| {
            let file = folder.join(pattern["file"].as_str().expect("a name"));
            let file = std::io::BufReader::new(std::fs::File::open(file).expect("a picture"));
            let mut reader = png::Decoder::new(file).read_info().expect("PNG");
            let mut mirrors = vec![0; (MIRRORS[0] * MIRRORS[1]) as usize];
            reader.next_frame(&mut mirrors).expect("mirrors");
            mirrors
        };
        patterns.iter().map(read).collect()
    }

    /// What the camera sees of a picture: nine rays per pixel, each lit by the mirror that it meets.
    fn frame(&self, picture: &[u8], noise: &mut impl FnMut() -> f64) -> Vec<u16> {
        let (principal, shift) = self.projector();
        let mut counts = Vec::new();
        for row in 0..CAMERA[1] {
            for column in 0..CAMERA[0] {
                let mut light = 0.0;
                for part in 0..9 {
                    let [u, v] = [(column, part % 3), (row, part / 3)]
                        .map(|(at, part)| f64::from(at) + f64::from(part) / 3.0 - 1.0 / 3.0);
                    let ray = [(u - 79.5) / 200.0, (v - 59.5) / 200.0];
                    let z = depth_mm(ray);
                    let mirror = [0, 1].map(|axis| {
                        (300.0 * (ray[axis] + shift[axis] / z) + principal[axis]).round()
                    });
                    if (0..2).all(|i| (0.0..f64::from(MIRRORS[i])).contains(&mirror[i])) {
                        let at = mirror[1] as usize * MIRRORS[0] as usize + mirror[0] as usize;
                        light += f64::from(picture[at]) / 255.0 / 9.0;
                    }
                }
                // Tiles of two greys, in a lit room.
                let albedo = if (row / 16 + column / 16) % 2 == 0 {
                    1.0
                } else {
                    0.4
                };
                let electrons = 7000.0 * albedo * light + 400.0;
                let seen = electrons + noise() * (electrons + 25.0).sqrt();
                counts.push((100.0 + seen / 2.5).round().clamp(0.0, 4095.0) as u16);
            }
        }
        counts
    }

    fn store(&self, number: usize, counts: &[u16]) {
        let file = self.path(&format!("frames/{number:02}.png"));
        let file = std::fs::File::create(file).expect("created");
        let mut encoder = png::Encoder::new(file, CAMERA[0], CAMERA[1]);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        let bytes: Vec<u8> = counts
            .iter()
            .flat_map(|count| count.to_be_bytes())
            .collect();
        let mut writer = encoder.write_header().expect("header");
        writer.write_image_data(&bytes).expect("pixels");
    }

    fn capture(&self) {
        self.capture_as(|_, count| count);
    }

    /// Captures frames whose counts are changed, by pixel.
    fn capture_as(&self, change: impl Fn(usize, u16) -> u16) {
        let mut random = Random(5);
        for (number, picture) in self.pictures().iter().enumerate() {
            let mut counts = self.frame(picture, &mut || random.normal());
            for (pixel, count) in counts.iter_mut().enumerate() {
                *count = change(pixel, *count);
            }
            self.store(number, &counts);
        }
    }

    fn counts(&self, number: usize) -> Vec<u16> {
        let file = self.path(&format!("frames/{number:02}.png"));
        let file = std::io::BufReader::new(std::fs::File::open(file).expect("a frame"));
        let mut reader = png::Decoder::new(file).read_info().expect("PNG");
        let mut bytes = vec![0; 2 * (CAMERA[0] * CAMERA[1]) as usize];
        reader.next_frame(&mut bytes).expect("pixels");
        let pairs = bytes.chunks_exact(2);
        pairs
            .map(|pair| u16::from_be_bytes([pair[0], pair[1]]))
            .collect()
    }

    fn decode(&self) -> Output {
        let [images, plan, head, cloud] =
            ["frames", "PLAN.toml", "head.toml", "cloud.ply"].map(|name| self.text(name));
        flankscope(&[
            "decode", "--images", &images, "--plan", &plan, "--head", &head, "-o", &cloud,
            "--json", "-", "-q", "--smooth", "0",
        ])
    }

    /// Points away from the step's edge, how many of them are off by more than 2 mm (a fringe is 17), and what was dropped.
    fn judged(&self) -> (usize, usize, serde_json::Value) {
        let output = self.decode();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{error}");
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let (mut points, mut off) = (0, 0);
        for [x, y, z] in vertices(&self.path("cloud.ply")) {
            let ray = [x / z, y / z];
            if (ray[1] - 0.11).abs() > 0.02 {
                points += 1;
                off += usize::from((z - depth_mm(ray)).abs() > 2.0);
            }
        }
        (points, off, document["rejected"].clone())
    }
}

/// Positions of the vertices: four floats each, x y z first.
fn vertices(path: &Path) -> Vec<[f64; 3]> {
    let bytes = std::fs::read(path).expect("a cloud");
    let mark = b"end_header\n";
    let head = bytes.windows(mark.len()).position(|part| part == mark);
    let body = &bytes[head.expect("a header") + mark.len()..];
    let float = |four: &[u8]| f64::from(f32::from_le_bytes(four.try_into().expect("four bytes")));
    let vertex = |part: &[u8]| [0, 4, 8].map(|at| float(&part[at..at + 4]));
    body.chunks_exact(16).map(vertex).collect()
}

const ONE: &str = "[[set]]\nperiods = 16\nsteps = 4\n";
const ROWS: &str = "fringes_along = \"rows\"\n[[set]]\nperiods = 12\nsteps = 4\n";
/// Low first, as the pictures are written.
const TWO: &str = "[[set]]\nperiods = 2\nsteps = 4\n[[set]]\nperiods = 16\nsteps = 4\n";
const VOLUME: &str = "[volume]\nnear_mm = 80.0\nfar_mm = 140.0\n";
/// Cells away from the step.
const CELLS: usize = 160 * 112;

fn plan(sets: &str, bits: u32, stripes: u32, complement: bool) -> String {
    format!("{sets}[gray_code]\nbits = {bits}\nstripes = {stripes}\ncomplement = {complement}\n")
}

#[test]
fn the_code_finds_the_fringe_at_every_width_of_its_stripes() {
    for (what, plan, volume) in [
        ("a fringe each", plan(ONE, 4, 16, false), ""),
        ("a fringe each, complement", plan(ONE, 4, 16, true), ""),
        ("half a fringe", plan(ONE, 5, 32, false), ""),
        (
            "half a fringe, complement, more words than stripes",
            plan(ONE, 6, 32, true),
            "",
        ),
        ("columns, complement", plan(ONE, 8, 256, true), ""),
        ("rows", plan(ROWS, 4, 12, false), ""),
        ("rows, complement", plan(ROWS, 5, 24, true), ""),
        (
            "eight fringes, told by two periods",
            plan(TWO, 1, 2, false),
            "",
        ),
        ("four of eight", plan(TWO, 2, 4, true), ""),
        (
            "the volume tells which repetition",
            plan(ONE, 3, 16, false),
            VOLUME,
        ),
    ] {
        let rig = Rig::new(&plan, volume);
        rig.capture();
        let (points, off, rejected) = rig.judged();
        println!("{what}: {points} of {CELLS} points, {off} off, {rejected}");
        assert!(points >= CELLS * 95 / 100, "{what}: {points} {rejected}");
        assert!(off * 2000 <= points, "{what}: {off} of {points}");
    }
}

/// A projector whose white is brighter than its fringes' crests: where a bit is lit the camera saturates.
#[test]
fn a_saturated_bit_is_lit() {
    for complement in [false, true] {
        let rig = Rig::new(&plan(ONE, 4, 16, complement), "");
        rig.capture();
        let (points, _, _) = rig.judged();
        for number in 4..if complement { 12 } else { 8 } {
            let mut counts = rig.counts(number);
            for count in &mut counts {
                *count = (100 + 2 * (*count - 100)).min(4095);
            }
            rig.store(number, &counts);
        }
        let (brighter, off, rejected) = rig.judged();
        assert!(
            20 * brighter >= 19 * points,
            "{brighter} of {points}: {rejected}"
        );
        assert!(off * 2000 <= brighter, "{off} of {brighter}");
    }
}

/// The same frames with one thing wrong: what a decoder that ignored the code would not notice.
#[test]
fn what_the_code_does_not_say_is_dropped_and_counted() {
    let rig = Rig::new(&plan(ONE, 4, 16, false), "");
    rig.capture();
    let right: Vec<Vec<u8>> = (0..8)
        .map(|n| std::fs::read(rig.path(&format!("frames/{n:02}.png"))).expect("a frame"))
        .collect();
    let put = |n: usize, of: usize| {
        std::fs::write(rig.path(&format!("frames/{n:02}.png")), &right[of]).expect("written");
    };
    // Two bits exchanged: other words.
    put(4, 5);
    put(5, 4);
    let (points, off, _) = rig.judged();
    assert!(4 * off > points, "{off} of {points}");
    // A fringe where a bit should be: somewhere it is as bright as the threshold.
    put(4, 4);
    put(5, 0);
    let (_, _, rejected) = rig.judged();
    let dropped = rejected["uncertain_order"].as_u64().expect("a count");
    assert!(dropped > 3000, "{rejected}");
    put(5, 5);
    let (points, off, _) = rig.judged();
    assert!(points >= CELLS * 95 / 100 && off * 2000 <= points);
}

#[test]
fn bad_codes_are_refused_by_name() {
    let refused_of = |frames: usize, plan: &str, parts: &[&str]| {
        let rig = Rig::new(plan, "");
        for number in 0..frames {
            rig.store(number, &vec![100; (CAMERA[0] * CAMERA[1]) as usize]);
        }
        let output = rig.decode();
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{error}");
        for part in parts {
            assert!(error.contains(part), "\"{part}\" is not in: {error}");
        }
        assert!(!rig.path("cloud.ply").exists());
    };
    let refused = |plan: &str, parts: &[&str]| refused_of(8, plan, parts);
    refused(
        &plan(ONE, 0, 16, false),
        &["gray_code.bits", "PLAN.toml:5", "1 to 16"],
    );
    refused(&plan(ONE, 17, 16, false), &["gray_code.bits", "1 to 16"]);
    refused(&plan(ONE, 4, 0, false), &["gray_code.stripes", "above 0"]);
    refused(
        &plan(ONE, 4, 8, false),
        &["holds 2.00 fringes", "at least 2 times"],
    );
    // Eight words for sixteen fringes, and no volume to tell which.
    refused_of(7, &plan(ONE, 3, 16, false), &["volume"]);
    refused(
        &plan(ONE, 4, 16, true),
        &["8 images", "the plan has 12 frames"],
    );
    refused("[gray_code]\nbits = 4\nstripes = 16\n", &["[[set]]"]);
    refused(
        &format!("{}inverse = true\n", plan(ONE, 4, 16, false)),
        &["inverse", "complement"],
    );
    let listed = plan(ONE, 4, 16, false).replace(
        "steps = 4\n",
        "steps = 4\nframes = ['00.png', '01.png', '02.png', '03.png']\n",
    );
    refused(&listed, &["gray_code.frames", "one image per bit"]);
}

/// Counts of 12 bits in files of 16, without a described sensor: a spot that is lit twice as much as the rest saturates, and
/// none of its pixels that the sensor clips has a point, wherever the counts stand in the 16 bits.
#[test]
fn saturated_pixels_of_12_bits_in_files_of_16_have_no_point() {
    const SPOT: [std::ops::Range<usize>; 2] = [50..90, 30..60];
    let steps = "[[set]]\nperiods = 1\nsteps = 6\n[[set]]\nperiods = 16\nsteps = 6\n";
    let is_in_spot = |pixel: usize| {
        let [column, row] = [pixel % CAMERA[0] as usize, pixel / CAMERA[0] as usize];
        SPOT[0].contains(&column) && SPOT[1].contains(&row)
    };
    for (shift, source) in [(0, "clipping"), (4, "gaps")] {
        let rig = Rig::new(steps, "");
        let head = std::fs::read_to_string(rig.path("head.toml")).expect("read");
        let without = head.split("[sensor]").next().expect("a head");
        rig.capture_as(|pixel, count| {
            let gain = if is_in_spot(pixel) { 2 } else { 1 };
            (100 + gain * count.saturating_sub(100)).min(4095) << shift
        });
        std::fs::write(rig.path("head.toml"), without).expect("written");
        let output = rig.decode();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let counts = &document["counts"];
        assert_eq!(
            (
                &counts["source"],
                &counts["full_scale_dn"],
                &counts["shift_bits"]
            ),
            (&source.into(), &4095.into(), &shift.into()),
            "{document}"
        );
        assert!(counts["clipped_pixels"].as_u64() > Some(1000), "{document}");
        // The spot's dark tiles stay below the end of the counts.
        let saturated = document["rejected"]["saturated"].as_u64().expect("a count");
        assert!((400..900).contains(&saturated), "{document}");
        let pixel = |[x, y, z]: &[f64; 3]| {
            [200.0 * x / z + 79.5, 200.0 * y / z + 59.5].map(|px| px.round() as usize)
        };
        let is_over_exposed = |point: &&[f64; 3]| {
            let [column, row] = pixel(point);
            is_in_spot(row * CAMERA[0] as usize + column) && (row / 16 + column / 16) % 2 == 0
        };
        let points = vertices(&rig.path("cloud.ply"));
        assert!(points.len() > 15_000, "{}", points.len());
        let over_exposed = points.iter().filter(is_over_exposed).count();
        assert_eq!(over_exposed, 0);
    }
}
