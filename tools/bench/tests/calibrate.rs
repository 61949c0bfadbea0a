//! A calibration from captures of the demo target against the bench's own optics, which it never sees.

use std::sync::Arc;

use flankscope_bench::demo;
use flankscope_bench::world::{PatternSpec, World};
use flankscope_profilometry::calibrate::{
    CalibrationRecord, RecordError, SelfTest, Sighting, StagePose, Target, Unfit, adjust, hold_out,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::date::Date;
use flankscope_profilometry::triangulate::Triangulator;
use flankscope_profilometry::{
    DecodeOptions, Decoder, FrameKind, FrameView, HeadModel, PatternSet,
};

/// Standard uncertainty of stages that err by ±15 mdeg and ±5 µm, evenly distributed.
const STAGE_SIGMA: [f64; 2] = [151e-6, 2.9e-3];

struct Captures {
    target: Target,
    start: HeadModel,
    sightings: Vec<Sighting>,
    kept_aside: Vec<(Sighting, Vec<CellColumn>)>,
    blank: Vec<CellColumn>,
    sphere: Vec<CellColumn>,
}

/// Where the stages stand beyond facing a plate: rad, mm.
const OFFSETS: [[f64; 2]; 2] = [[0.05, 0.8], [-0.05, -0.8]];
const ASIDE: [[f64; 2]; 1] = [[0.0, 0.3]];

fn capture(seed: u64) -> Captures {
    let target = demo::target();
    let world = World::new(&demo::target_world(&target, seed)).expect("a world");
    let map = demo::core_map(&demo::head()).expect("cores");
    let mut start = demo::drawn_head();
    start.core_map = Some(Arc::new(map));
    let patterns = PatternSet::named("insitu12").expect("built in");
    let exposures = [target.exposure_us];
    let options = DecodeOptions::for_head(&start);
    let decoder = Decoder::new(&start, &patterns, &exposures, options).expect("a decoder");
    let mut state = seed;
    let mut error = move |half: f64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(99);
        half * (2.0 * ((state >> 11) as f64 / (1u64 << 53) as f64) - 1.0)
    };
    let mut number = 0;
    let mut shoot = |station: usize, [turn, lift]: [f64; 2]| {
        let facing = -std::f64::consts::FRAC_PI_4 * station as f64;
        let stage = StagePose {
            rotation_rad: facing + turn,
            vertical_mm: demo::HEIGHT_MM + lift,
        };
        number += 1;
        let rotation = stage.rotation_rad + error(15e-3 * std::f64::consts::PI / 180.0);
        let vertical = stage.vertical_mm + error(5e-3);
        (
            stage,
            cells(&world, &decoder, &target, [rotation, vertical], number),
        )
    };
    let (_, blank) = shoot(6, [0.0; 2]);
    let flat: Vec<f64> = blank.iter().map(|cell| cell.mean_e).collect();
    let mut sightings = Vec::new();
    let mut kept_aside = Vec::new();
    for plate in 0..target.plate.len() {
        for offset in OFFSETS {
            let (stage, cells) = shoot(plate, offset);
            let view = sightings.len();
            let sighting = Sighting::new(view, plate, stage, &cells, &flat, &target, &start);
            sightings.push(sighting.expect("dots"));
        }
    }
    for plate in [0, 3, 4] {
        for offset in ASIDE {
            let (stage, cells) = shoot(plate, offset);
            let sighting = Sighting::new(99, plate, stage, &cells, &flat, &target, &start);
            kept_aside.push((sighting.expect("dots"), cells));
        }
    }
    let (_, sphere) = shoot(7, [0.0; 2]);
    Captures {
        target,
        start,
        sightings,
        kept_aside,
        blank,
        sphere,
    }
}

fn cells(
    world: &World,
    decoder: &Decoder,
    target: &Target,
    [rotation, vertical]: [f64; 2],
    number: u32,
) -> Vec<CellColumn> {
    let view = world
        .prepare(rotation, vertical, &PatternSpec::insitu12())
        .expect("a view");
    let mut accumulator = decoder.begin();
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let order: Vec<FrameKind> = decoder.capture_order().collect();
    for (frame, kind) in order.into_iter().enumerate() {
        let pattern = match kind {
            FrameKind::Dark => 0,
            FrameKind::Fringe { set, step, .. } => 1 + 4 * set as u16 + step as u16,
        };
        let counter = 100 * number + frame as u32;
        world
            .render(
                &view,
                pattern,
                target.exposure_us,
                true,
                counter,
                &mut pixels,
            )
            .expect("a frame");
        accumulator
            .add(FrameView::packed(&pixels, width, height), kind)
            .expect("frames in order");
    }
    decoder.columns(&accumulator).expect("a whole view")
}

/// Errors of points all over the volume in the stage frame, µm: along the view, and across it.
fn point_errors_um(is: &HeadModel, said: &HeadModel) -> [f64; 2] {
    let (mut count, mut along, mut across) = (0.0, 0.0, 0.0);
    for depth in [20.5, 22.0, 23.5] {
        for pixel in [
            [959.5, 599.5],
            [1360.0, 599.5],
            [560.0, 599.5],
            [959.5, 880.0],
            [959.5, 320.0],
        ] {
            let ray = is.camera.undistort(pixel).expect("a lens");
            let (column, _) = Triangulator::new(is).column(ray, depth).expect("in front");
            let point = |head: &HeadModel| {
                let [x, y] = head.camera.undistort(pixel).expect("a lens");
                let hit = Triangulator::new(head).intersect([x, y], column);
                let z = hit.expect("a point").depth_mm;
                head.stage_from_camera
                    .expect("a hand-eye")
                    .point([x * z, y * z, z])
            };
            let (a, b) = (point(is), point(said));
            let off: [f64; 3] = std::array::from_fn(|k| 1e3 * (b[k] - a[k]));
            count += 1.0;
            along += off[0] * off[0];
            across += 0.5 * (off[1] * off[1] + off[2] * off[2]);
        }
    }
    [along, across].map(|sum: f64| (sum / count).sqrt())
}

#[test]
fn the_target_gives_the_head() {
    let Captures {
        target,
        start,
        sightings,
        kept_aside,
        blank,
        sphere,
    } = capture(3);
    let adjusted = adjust(&start, &target, &sightings, STAGE_SIGMA).expect("a calibration");
    let truth = demo::head();
    let [depth_um, lateral_um] = point_errors_um(&truth, &adjusted.head);
    let drawn_um = point_errors_um(&truth, &start);
    let stated_um = [adjusted.depth_sigma_mm, adjusted.lateral_sigma_mm].map(|mm| 1e3 * mm);
    eprintln!(
        "{} dots, {} dropped, {:.3} and {:.3} px left over; points off by {depth_um:.2} um in depth and {lateral_um:.2} um \
         across, stated {:.2} and {:.2}; by the drawing {:.0} and {:.0}",
        adjusted.marks,
        adjusted.dropped,
        adjusted.camera_rms_px,
        adjusted.projector_rms_px,
        stated_um[0],
        stated_um[1],
        drawn_um[0],
        drawn_um[1]
    );
    assert!(depth_um < 3.0 && lateral_um < 3.0);
    assert!(depth_um < 3.0 * stated_um[0] && lateral_um < 3.0 * stated_um[1]);
    assert!(drawn_um[0] > 100.0, "the start must not know the answer");

    // A fresh plate shows the noise of the points, and nothing of the calibration.
    let got = hold_out(&adjusted.head, &target, &kept_aside).expect("plates");
    let best = hold_out(&truth, &target, &kept_aside).expect("plates");
    eprintln!("fresh plates: {got:?}, by the bench's own optics: {best:?}");
    assert!(got.flatness_rms_um < 1.05 * best.flatness_rms_um);
    assert!(got.dots_rms_um < 1.05 * best.dots_rms_um);

    // The record belongs to its head and to its time.
    let today: Date = "2026-05-04".parse().expect("a day");
    let mut head = adjusted.head.clone();
    let record = CalibrationRecord::new(&adjusted, &head, &target.name, Some(got), today, 90);
    head.calibration = Some(record.clone());
    assert_eq!(head.fit_on(today), Err(Unfit::Untested));

    // Plane and sphere of a fit head, and of one whose lens has been knocked out of place since.
    let test = SelfTest::of(&head, &target, &blank, &sphere, today).expect("a self-test");
    eprintln!("{test:?}");
    let limits = test.limits;
    assert!(test.plane_points > 60_000 && test.sphere_points > 1_000);
    // The plane's points scatter by what the fresh plates show; of 99.7 % of a normal distribution the range is 6 sigma.
    assert!((3.0..12.0).contains(&(test.flatness_um / got.flatness_rms_um)));
    assert!(test.probing_size_um.abs() < limits.probing_size_um);
    let fit = |test: &SelfTest, day: Date| {
        let mut head = head.clone();
        head.self_test = Some(test.clone());
        head.fit_on(day)
    };
    assert_eq!(fit(&test, today.plus_days(limits.every_days)), Ok(()));
    assert!(matches!(
        fit(&test, today.plus_days(limits.every_days + 1)),
        Err(Unfit::Overdue { .. })
    ));
    let mut other = test.clone();
    other.geometry_blake3.clear();
    assert_eq!(fit(&other, today), Err(Unfit::Foreign { date: today }));
    let mut knocked = head.clone();
    knocked.camera.focal_px = knocked.camera.focal_px.map(|focal| 1.01 * focal);
    let failed = SelfTest::of(&knocked, &target, &blank, &sphere, today).expect("a self-test");
    eprintln!("{failed:?}");
    assert!(matches!(fit(&failed, today), Err(Unfit::Failed { .. })));

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("head.toml");
    let text = head.to_toml().expect("text");
    std::fs::write(&path, &text).expect("written");
    assert_eq!(
        HeadModel::load(&path).expect("its own file").calibration,
        Some(record.clone())
    );
    assert_eq!(record.counts_on(today.plus_days(90)), Ok(()));
    assert!(matches!(
        record.counts_on(today.plus_days(91)),
        Err(RecordError::Expired { .. })
    ));
    assert!(
        record
            .counts_on("2026-05-01".parse().expect("a day"))
            .is_err()
    );
    let focal = format!("{:?}", head.camera.focal_px[0]);
    let edited = text.replacen(&focal, "2530.25", 1);
    assert_ne!(edited, text);
    std::fs::write(&path, edited).expect("written");
    let refused = HeadModel::load(&path)
        .expect_err("an edited geometry")
        .to_string();
    assert!(
        refused.contains("changed after the calibration"),
        "{refused}"
    );
}
