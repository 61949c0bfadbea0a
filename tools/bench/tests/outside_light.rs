//! The bench's light beside that of a renderer that nobody here wrote (Mitsuba 3, a physically based path tracer), on the same
//! scene and through the same two pinholes.
//!
//! Finished frames lie in `../shared/outside`; `cargo xtask light` renders anew and names the folder in `FLANKSCOPE_RENDERED`.
//! A renderer's unit of light is its own: each scene has one scale, and everything else must agree.

use flankscope_bench::demo;
use flankscope_bench::world::{IdealView, Lanes, Metal, Pinhole, PixelLight, Surface};
use flankscope_gear_cad::Mesh;
use flankscope_test_requisites::shared;
use nalgebra::{
    Complex, Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion, Vector3,
};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;

/// Ways of light per pixel of finished frames, and of the coarser images that are rendered anew.
const PATHS: [u32; 2] = [16, 64];
/// Every so many columns and rows one pixel is looked at.
const STRIDE: u32 = 3;

/// Light of one pixel as rendered elsewhere, in counts: that of an evenly lit projector, then cosine and sine parts.
type Rendered = Vec<Option<[f64; 9]>>;

/// The surfaces as the outside script has them.
fn surface(name: &str) -> Surface {
    let matt = |ratio| Surface {
        diffuse_ratio: ratio,
        roughness_ratio: 0.0,
        gloss_ratio: 0.0,
        ..Surface::sprayed()
    };
    let steel = |share, alpha| Metal {
        share,
        alpha,
        eta: 2.4,
        k: 3.4,
    };
    match name {
        "sprayed" => matt(0.6),
        "ground" => Surface {
            metal: Some(steel(0.85, 0.3)),
            ..matt(0.15 * 0.3)
        },
        "polished" => Surface {
            metal: Some(steel(1.0, 0.15)),
            ..matt(0.0)
        },
        other => panic!("no surface {other}"),
    }
}

/// The head of the outside script, pixels `scale` times as large as the sensor's.
fn pinholes(scale: f64) -> [Pinhole; 2] {
    let ideal = |focal: f64, width: f64, height: f64| Pinhole {
        focal_px: [focal; 2],
        centre_px: [0.5 * (width - 1.0), 0.5 * (height - 1.0)],
        distortion: [0.0; 5],
        uneven: None,
    };
    [
        ideal(2530.0 / scale, 1920.0 / scale, 1200.0 / scale),
        ideal(2252.8, 1024.0, 768.0),
    ]
}

fn pose(file: &Path) -> Isometry3<f64> {
    let text = std::fs::read_to_string(file).expect("a pose");
    let values: Vec<f64> = text
        .split_whitespace()
        .map(|word| word.parse().expect("a number"))
        .collect();
    let m = Matrix4::from_row_slice(&values);
    let turn: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    Isometry3::from_parts(
        Translation3::from(m.fixed_view::<3, 1>(0, 3).into_owned()),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn)),
    )
}

/// What the bench makes of the scene, in the order of `pixels`.
fn ours(
    mesh: &Mesh,
    of: &str,
    (at, scale): (&Path, f64),
    frequencies: &[f64],
    (pixels, paths): (&[[u32; 2]], u32),
) -> Vec<Option<PixelLight>> {
    let [camera, projector] = pinholes(scale);
    let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), -30f64.to_radians());
    let shift = Vector3::new(11.0, 0.0, 22.0 - 22.0 * 30f64.to_radians().cos());
    let view = IdealView {
        mesh,
        surface: surface(of),
        bounces: 5,
        camera,
        projector,
        projector_size_px: [1024, 768],
        projector_from_camera: Isometry3::from_parts(
            Translation3::from(shift),
            UnitQuaternion::from_rotation_matrix(&turn),
        ),
        tool_from_camera: pose(at),
        frequencies: frequencies.to_vec(),
        seed: 7,
    };
    view.look(pixels, paths).expect("a scene")
}

fn lattice([width, height]: [u32; 2]) -> Vec<[u32; 2]> {
    (0..height)
        .step_by(STRIDE as usize)
        .flat_map(|row| (0..width).step_by(STRIDE as usize).map(move |c| [c, row]))
        .collect()
}

/// One frame of 16-bit counts.
fn counts(file: &Path) -> (Vec<u16>, [u32; 2]) {
    let decoder = png::Decoder::new(std::io::BufReader::new(
        std::fs::File::open(file).expect("a frame"),
    ));
    let mut reader = decoder.read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("an image");
    let values = bytes
        .chunks_exact(2)
        .map(|two| u16::from_be_bytes([two[0], two[1]]))
        .collect();
    (values, [info.width, info.height])
}

/// Contrast that fringes keep where a texture's columns are joined by straight lines, as the renderer does it: the mean of the
/// line against the cosine through its ends.
fn texture_contrast(periods: f64) -> f64 {
    let half = 0.5 * TAU * periods / 1024.0;
    (half.sin() / half).powi(2)
}

/// Light of the pixels by the frames of a folder; none where a pixel was ever full.
///
/// `sets` are the periods of each, its first frame and its steps.
fn by_frames(folder: &Path, sets: &[(f64, usize, u32)], pixels: &[[u32; 2]]) -> Rendered {
    const FULL: u16 = 3950;
    const OFFSET: f64 = 100.0;
    let mut found: Rendered = vec![Some([0.0; 9]); pixels.len()];
    for (number, (periods, first, steps)) in sets.iter().enumerate() {
        let contrast = texture_contrast(*periods);
        for step in 0..*steps {
            let (frame, [width, _]) =
                counts(&folder.join(format!("frame_{:02}.png", first + step as usize)));
            let (sin, cos) = (TAU * f64::from(step) / f64::from(*steps)).sin_cos();
            for (pixel, [column, row]) in found.iter_mut().zip(pixels) {
                let count = frame[(row * width + column) as usize];
                let Some(light) = pixel.as_mut().filter(|_| count < FULL) else {
                    *pixel = None;
                    continue;
                };
                // The frames are half the even light and half the fringes.
                let part = 2.0 * (f64::from(count) - OFFSET) / f64::from(*steps);
                light[0] += part / sets.len() as f64;
                light[1 + 2 * number] += 2.0 * part * cos / contrast;
                light[2 + 2 * number] -= 2.0 * part * sin / contrast;
            }
        }
    }
    found
}

/// Parts of a tooth space that light reaches differently: flanks in three bands of radius, lands and roots.
fn region(light: &PixelLight) -> String {
    let [x, y, _] = light.point_mm;
    let radius = x.hypot(y);
    let [nx, ny, _] = light.normal;
    let around = (x * ny - y * nx) / radius;
    if around.abs() < 0.6 {
        return if radius < 41.5 { "tips" } else { "roots" }.into();
    }
    let side = if around > 0.0 { "left" } else { "right" };
    let band = match radius {
        r if r < 41.1 => "inner",
        r if r < 41.7 => "middle",
        _ => "outer",
    };
    format!("{side} {band}")
}

/// Sums over a region: pixels, even light that is direct, over other places as rendered, and as ours.
#[derive(Clone, Copy, Default)]
struct Sums {
    pixels: usize,
    direct: f64,
    theirs: f64,
    ours: f64,
}

/// Compares the light over other places, region by region; returns the largest disagreement among those that count.
fn compare_indirect(
    what: &str,
    scale: f64,
    ours: &[Option<PixelLight>],
    theirs: impl Fn(usize, &PixelLight) -> Option<f64>,
) -> f64 {
    let mut regions: BTreeMap<String, Sums> = BTreeMap::new();
    for (i, light) in ours.iter().enumerate() {
        let Some(light) = light else { continue };
        let Some(their) = theirs(i, light) else {
            continue;
        };
        for name in [region(light), "all".into()] {
            let sums = regions.entry(name).or_default();
            sums.pixels += 1;
            sums.direct += scale * f64::from(light.direct[0]);
            sums.theirs += their;
            sums.ours += scale * f64::from(light.indirect[0]);
        }
    }
    println!("{what}: light over other places, per light that comes straight");
    println!("  region         pixels   theirs     ours    ratio");
    let mut worst = 0f64;
    for (name, sums) in regions {
        let ratio = sums.ours / sums.theirs;
        println!(
            "  {name:13} {:7} {:8.4} {:8.4} {ratio:8.3}",
            sums.pixels,
            sums.theirs / sums.direct,
            sums.ours / sums.direct
        );
        if sums.pixels > 500 && sums.theirs > 0.02 * sums.direct {
            worst = worst.max((ratio - 1.0).abs());
        }
    }
    worst
}

/// Fringes of one frequency on one pixel.
#[derive(Clone, Copy)]
struct Fringe {
    theirs: Complex<f64>,
    direct: Complex<f64>,
    indirect: Complex<f64>,
}

/// Fringes in lane `lane` and the next, by region, of the pixels that are lit.
fn fringes(
    theirs: &Rendered,
    ours: &[Option<PixelLight>],
    lane: usize,
) -> BTreeMap<String, Vec<Fringe>> {
    let mut regions: BTreeMap<String, Vec<Fringe>> = BTreeMap::new();
    for (their, our) in theirs.iter().zip(ours) {
        let (Some(their), Some(our)) = (their, our) else {
            continue;
        };
        let of = |lanes: &Lanes| Complex::new(f64::from(lanes[lane]), f64::from(lanes[lane + 1]));
        if our.direct[0] > 0.0 {
            regions.entry(region(our)).or_default().push(Fringe {
                theirs: Complex::new(their[lane], their[lane + 1]),
                direct: of(&our.direct),
                indirect: of(&our.indirect),
            });
        }
    }
    regions
}

/// The factor by which their fringes are larger than ours. Noise of either does not bend it: ours is direct light, which has none.
fn scale_of(regions: &BTreeMap<String, Vec<Fringe>>) -> f64 {
    let all = || regions.values().flatten();
    let sum = |of: fn(&Fringe) -> Complex<f64>| {
        all()
            .map(|f| of(f) * f.direct.conj())
            .sum::<Complex<f64>>()
            .re
    };
    sum(|f| f.theirs) / sum(|f| f.direct + f.indirect)
}

/// Compares direct light region by region: their fringes less what our other light adds, over our direct ones; returns the largest
/// distance from 1 beyond four standard errors (16 numbers are looked at).
fn compare_direct(what: &str, scale: f64, regions: &BTreeMap<String, Vec<Fringe>>) -> f64 {
    println!("{what}: direct light, theirs over ours");
    println!("  region         pixels    ratio phase/rad  std.error");
    let mut worst = 0f64;
    for (name, pixels) in regions {
        let power: f64 = pixels.iter().map(|f| f.direct.norm_sqr()).sum();
        let off = |f: &Fringe, ratio| f.theirs / scale - f.indirect - ratio * f.direct;
        let ratio: Complex<f64> = pixels
            .iter()
            .map(|f| off(f, Complex::ZERO) * f.direct.conj())
            .sum::<Complex<f64>>()
            / power;
        let squares: f64 = pixels
            .iter()
            .map(|f| (off(f, ratio) * f.direct.conj()).norm_sqr())
            .sum();
        let error = (0.5 * squares).sqrt() / power;
        println!(
            "  {name:13} {:7} {:8.4} {:9.4} {error:10.4}",
            pixels.len(),
            ratio.norm(),
            ratio.arg()
        );
        if pixels.len() > 500 {
            worst = worst.max((ratio - 1.0).norm() - 4.0 * error);
        }
    }
    worst
}

/// Compares where the other light comes from, by what it does to coarse fringes; returns the largest disagreement relative to what
/// it does, or to a tenth of the direct light where it does less.
fn compare_coarse(what: &str, scale: f64, regions: &BTreeMap<String, Vec<Fringe>>) -> f64 {
    const LEAST: f64 = 0.1;
    println!(
        "{what}: what other light adds along the direct fringe and across it, per direct light"
    );
    let mut worst = 0f64;
    for (name, pixels) in regions {
        let sum = |of: &dyn Fn(&Fringe) -> Complex<f64>| {
            pixels
                .iter()
                .map(|f| of(f) * f.direct.conj() / f.direct.norm())
                .sum::<Complex<f64>>()
        };
        let direct = sum(&|f| f.direct).re;
        let theirs = sum(&|f| f.theirs / scale - f.direct) / direct;
        let ours = sum(&|f| f.indirect) / direct;
        println!(
            "  {name:13} theirs {:7.4} {:7.4}, ours {:7.4} {:7.4}",
            theirs.re, theirs.im, ours.re, ours.im
        );
        if pixels.len() > 500 {
            worst = worst.max((ours - theirs).norm() / theirs.norm().max(LEAST));
        }
    }
    worst
}

/// Direct light within noise, indirect within 10 %, evenly lit and by coarse fringes.
fn assert_agreement(of: &str, direct: f64, even: f64, coarse: f64) {
    println!("{of}: direct {direct:.4} beyond noise, indirect {even:.3}, coarse {coarse:.3}");
    assert!(direct < 0.003, "direct light on {of} is {direct} off");
    assert!(even < 0.1, "light over other places on {of} is {even} off");
    assert!(
        coarse < 0.1,
        "light over other places on {of} comes from elsewhere: {coarse}"
    );
}

#[test]
fn finished_frames_of_another_renderer_show_the_bench_s_light() {
    let mesh = demo::gear()
        .mesh(&Default::default())
        .expect("the demo die");
    for (folder, of) in [("sprayed-new", "sprayed"), ("steel-new", "ground")] {
        let Some(folder) = shared(&format!("outside/{folder}")) else {
            return;
        };
        let pixels = lattice([960, 600]);
        let sets = [(4.0, 0, 4), (13.0, 4, 4), (41.0, 8, 4), (48.0, 16, 8)];
        let theirs = by_frames(&folder, &sets, &pixels);
        let frequencies = sets.map(|(periods, ..)| periods);
        let at = (&*folder.join("pose.txt"), 2.0);
        let ours = ours(&mesh, of, at, &frequencies, (&pixels, PATHS[0]));
        // Light over other places washes the 48 fringes out: they tell of direct light. The scale is the scene's one free number.
        let fine = fringes(&theirs, &ours, 7);
        let scale = scale_of(&fine);
        let direct = compare_direct(&format!("{of}, 48 periods"), scale, &fine);
        let even = compare_indirect(of, scale, &ours, |i, light| {
            Some(theirs[i]?[0] - scale * f64::from(light.direct[0]))
        });
        let coarse = fringes(&theirs, &ours, 1);
        let coarse = compare_coarse(&format!("{of}, 4 periods"), scale, &coarse);
        assert_agreement(of, direct, even, coarse);
    }
}

/// Light of the pixels by float images of 480 x 300: the even one, then cosine and sine parts of two frequencies.
fn by_images(file: &Path, frequencies: &[f64; 2], pixels: &[[u32; 2]]) -> Rendered {
    let bytes = std::fs::read(file).expect("images");
    let size = 480 * 300;
    assert_eq!(bytes.len(), 5 * 4 * size, "{}", file.display());
    let value = |lane: usize, [column, row]: [u32; 2]| {
        let at = 4 * (lane * size + (row * 480 + column) as usize);
        f64::from(f32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[at + i])))
    };
    let light = |pixel: &[u32; 2]| {
        let mut lanes = [0.0; 9];
        lanes[0] = value(0, *pixel);
        for lane in 1..5 {
            lanes[lane] = value(lane, *pixel) / texture_contrast(frequencies[(lane - 1) / 2]);
        }
        Some(lanes)
    };
    pixels.iter().map(light).collect()
}

#[test]
fn what_another_renderer_makes_of_the_die_today_is_the_bench_s_light() {
    let Some(folder) = std::env::var_os("FLANKSCOPE_RENDERED") else {
        eprintln!("not run: cargo xtask light renders anew and names the folder");
        return;
    };
    let folder = Path::new(&folder);
    let mesh = demo::gear()
        .mesh(&Default::default())
        .expect("the demo die");
    let pixels = lattice([480, 300]);
    let frequencies = [4.0, 48.0];
    for of in ["sprayed", "ground", "polished"] {
        let at = (&*folder.join("pose.txt"), 4.0);
        let ours = ours(&mesh, of, at, &frequencies, (&pixels, PATHS[1]));
        let [straight, all] =
            [2, 6].map(|n| by_images(&folder.join(format!("{of}-{n}.f32")), &frequencies, &pixels));
        // The one is direct light alone: of each pixel, its fringes, and the even light.
        let mut alone = fringes(&straight, &ours, 3);
        for pixel in alone.values_mut().flatten() {
            pixel.indirect = Complex::ZERO;
        }
        let scale = scale_of(&alone);
        let direct = compare_direct(&format!("{of}, 48 periods"), scale, &alone);
        let even = compare_indirect(of, scale, &ours, |i, _| Some(all[i]?[0] - straight[i]?[0]));
        let mut coarse = fringes(&all, &ours, 1);
        for (region, pixels) in fringes(&straight, &ours, 1) {
            for (both, alone) in coarse.get_mut(&region).into_iter().flatten().zip(pixels) {
                // Their direct light for ours: the rest is other light, whatever noise the direct one has.
                both.theirs += scale * both.direct - alone.theirs;
            }
        }
        let coarse = compare_coarse(&format!("{of}, 4 periods"), scale, &coarse);
        assert_agreement(of, direct, even, coarse);
    }
}
