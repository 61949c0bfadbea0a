//! A scene traced by plain code of its own: closed-form surfaces, forward projection, fixed-point undistortion.
#![allow(dead_code)]

use std::f64::consts::TAU;

use flankscope_profilometry::frame::{FrameKind, FrameView};
use flankscope_profilometry::head::{DepthRange, HeadModel, Pinhole, RigidTransform, Sensor};
use flankscope_profilometry::pattern::PatternSet;
use flankscope_profilometry::{Accumulator, Decoder};
pub use flankscope_test_requisites::Random;

pub const WIDTH: usize = 150;
pub const HEIGHT: usize = 96;

/// Camera at the origin, projector 11 mm beside and 3 mm ahead, both looking at z = 22 mm: 30 degrees between them.
pub fn head() -> HeadModel {
    let length = 11f64.hypot(19.0);
    let (x, z) = (-11.0 / length, 19.0 / length);
    let rotation = [[z, 0.0, -x], [0.0, 1.0, 0.0], [x, 0.0, z]];
    let place = [11.0, 0.0, 3.0];
    let translation_mm =
        rotation.map(|row: [f64; 3]| -(0..3).map(|i| row[i] * place[i]).sum::<f64>());
    let camera = Pinhole {
        width_px: WIDTH as u32,
        height_px: HEIGHT as u32,
        focal_px: [350.0, 352.0],
        principal_px: [73.2, 49.1],
        distortion: [-0.12, 0.05, 2e-3, -1e-3, 0.01],
        residual: None,
    };
    let projector = Pinhole {
        width_px: 1024,
        height_px: 768,
        focal_px: [2250.0, 2250.0],
        principal_px: [511.5, 383.5],
        distortion: [-0.08, 0.02, -1e-3, 2e-3, 0.0],
        residual: None,
    };
    let projector_from_camera = RigidTransform {
        rotation,
        translation_mm,
    };
    HeadModel {
        sensor: Some(Sensor {
            full_well_e: 60_000.0,
            gain_e_per_dn: 1.0,
            read_noise_e: 7.0,
            offset_dn: 100.0,
            bits: 16,
        }),
        volume: Some(DepthRange {
            near_mm: 20.0,
            far_mm: 24.0,
        }),
        ..HeadModel::from_lenses("test", camera, projector, projector_from_camera)
    }
}

fn brown(k: &[f64; 5], x: f64, y: f64) -> [f64; 2] {
    let r2 = x.powi(2) + y.powi(2);
    let radial = 1.0 + k[0] * r2 + k[1] * r2.powi(2) + k[4] * r2.powi(3);
    [
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x.powi(2)),
        y * radial + k[2] * (r2 + 2.0 * y.powi(2)) + 2.0 * k[3] * x * y,
    ]
}

/// The ray (x, y, 1) of a pixel, by fixed-point iteration.
pub fn ray(head: &HeadModel, column: f64, row: f64) -> [f64; 2] {
    let camera = &head.camera;
    let target = [
        (column - camera.principal_px[0]) / camera.focal_px[0],
        (row - camera.principal_px[1]) / camera.focal_px[1],
    ];
    let mut guess = target;
    for _ in 0..200 {
        let [x, y] = brown(&camera.distortion, guess[0], guess[1]);
        guess = [guess[0] + target[0] - x, guess[1] + target[1] - y];
    }
    guess
}

/// The projector column that lights a point.
pub fn column(head: &HeadModel, point: [f64; 3]) -> f64 {
    let pose = &head.projector_from_camera;
    let p: Vec<f64> = (0..3)
        .map(|i| {
            (0..3).map(|j| pose.rotation[i][j] * point[j]).sum::<f64>() + pose.translation_mm[i]
        })
        .collect();
    let [x, _] = brown(&head.projector.distortion, p[0] / p[2], p[1] / p[2]);
    head.projector.focal_px[0] * x + head.projector.principal_px[0]
}

/// z of `n . p = d` along a ray.
pub fn plane(normal: [f64; 3], distance: f64) -> impl Fn([f64; 2]) -> f64 {
    move |[x, y]| distance / (normal[0] * x + normal[1] * y + normal[2])
}

/// Front of a sphere before a plane behind it.
pub fn sphere(centre: [f64; 3], radius: f64, behind_mm: f64) -> impl Fn([f64; 2]) -> f64 {
    move |[x, y]| {
        let a = x * x + y * y + 1.0;
        let b = x * centre[0] + y * centre[1] + centre[2];
        let c = centre.iter().map(|v| v * v).sum::<f64>() - radius * radius;
        let inside = b * b - a * c;
        if inside > 0.0 {
            (b - inside.sqrt()) / a
        } else {
            behind_mm
        }
    }
}

/// Light and noise.
pub struct Light {
    pub mean_e: f64,
    pub contrast: f64,
    pub noise_seed: Option<u64>,
}

/// One frame of counts. `gain` scales the light: the exposure.
pub fn frame(
    head: &HeadModel,
    columns: &[f64],
    patterns: &PatternSet,
    kind: FrameKind,
    gain: f64,
    light: &Light,
    random: &mut Random,
) -> Vec<u16> {
    let sensor = head.sensor.unwrap();
    columns
        .iter()
        .map(|&column| {
            let mut electrons = match kind {
                FrameKind::Dark => 0.0,
                FrameKind::Fringe { set, step, .. } => {
                    let fringes = patterns.sets[set];
                    let phase = TAU * fringes.periods * (column + 0.5) / 1024.0;
                    let shift = TAU * f64::from(step) / f64::from(fringes.steps);
                    gain * light.mean_e * (1.0 + light.contrast * (phase + shift).cos())
                }
                FrameKind::Code { .. } => unreachable!("this scene has no code"),
            };
            if light.noise_seed.is_some() {
                electrons += random.normal() * (electrons + sensor.read_noise_e.powi(2)).sqrt();
            }
            (sensor.offset_dn + electrons / sensor.gain_e_per_dn)
                .round()
                .clamp(0.0, 65535.0) as u16
        })
        .collect()
}

/// Projector columns of all pixels looking at a surface.
pub fn columns(head: &HeadModel, surface: impl Fn([f64; 2]) -> f64) -> Vec<f64> {
    (0..WIDTH * HEIGHT)
        .map(|index| {
            let [x, y] = ray(head, (index % WIDTH) as f64, (index / WIDTH) as f64);
            let z = surface([x, y]);
            column(head, [x * z, y * z, z])
        })
        .collect()
}

/// All frames of a view in capture order, exposure `i` with `gains[i]` of the light.
pub fn capture(
    head: &HeadModel,
    decoder: &Decoder,
    patterns: &PatternSet,
    columns: &[f64],
    gains: &[f64],
    light: &Light,
) -> Vec<(FrameKind, Vec<u16>)> {
    let mut random = Random(light.noise_seed.unwrap_or(0));
    decoder
        .capture_order()
        .map(|kind| {
            let gain = match kind {
                FrameKind::Dark => 1.0,
                FrameKind::Fringe { exposure, .. } | FrameKind::Code { exposure, .. } => {
                    gains[exposure]
                }
            };
            (
                kind,
                frame(head, columns, patterns, kind, gain, light, &mut random),
            )
        })
        .collect()
}

pub fn accumulate(decoder: &Decoder, frames: &[(FrameKind, Vec<u16>)]) -> Accumulator {
    let mut accumulator = decoder.begin();
    for (kind, pixels) in frames {
        accumulator
            .add(FrameView::packed(pixels, WIDTH, HEIGHT), *kind)
            .unwrap();
    }
    accumulator
}
