//! A calibration from captures of the demo target against the bench's own optics, which it never sees.

use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use flankscope_bench::demo as die;
use flankscope_bench::world::{HeadOptics, PatternSpec, ViewState, World, WorldConfig};
use flankscope_demo::{self as demo, TargetView};
use flankscope_foundation::date::Date;
use flankscope_jobs::calibration::CaptureFolder;
use flankscope_profilometry::calibrate::cores::{self, FlatField};
use flankscope_profilometry::calibrate::{
    SelfTestError, Sighting, SphereAt, StagePose, Target, adjust, hold_out,
};
use flankscope_profilometry::cloud::CellColumn;
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::{CalibrationRecord, RecordError, SelfTest, Unfit};
use flankscope_profilometry::pattern::Axis;
use flankscope_profilometry::triangulate::Triangulator;
use flankscope_profilometry::{
    Accumulator, Cloud, DecodeOptions, Decoder, FrameKind, FrameView, HeadModel, PatternSet,
};
use nalgebra::{Matrix3, Point3, Translation3, Vector3};

/// Standard uncertainty of stages that err by ±15 mdeg and ±5 µm, evenly distributed.
const STAGE_SIGMA: [f64; 2] = [151e-6, 2.9e-3];

struct Captures {
    optics: HeadOptics,
    target: Target,
    start: HeadModel,
    sightings: Vec<Sighting>,
    kept_aside: Vec<(Sighting, Vec<CellColumn>)>,
    blank: Vec<CellColumn>,
    /// At every place of a self-test.
    spheres: Vec<Vec<CellColumn>>,
}

/// Where the stages stand beyond facing a plate: rad, mm.
const OFFSETS: [[f64; 2]; 2] = [[0.05, 0.8], [-0.05, -0.8]];
const ASIDE: [[f64; 2]; 1] = [[0.0, 0.3]];

/// All views of the target; the lenses are uneven by `lens_error_um`.
fn capture(seed: u64, lens_error_um: f64) -> Captures {
    let mut target = demo::target();
    // Three places of one bar are enough here, and quicker.
    target.test_place.truncate(3);
    let mut config = demo::target_world(&target, seed);
    if lens_error_um > 0.0 {
        config.optics.make_uneven(lens_error_um, config.head_seed);
    }
    let world = World::new(&config).expect("a world");
    let map = demo::core_map().expect("cores");
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
            vertical_mm: die::HEIGHT_MM + lift,
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
    let flat = [blank.iter().map(|cell| cell.mean_e).collect()];
    let mut sightings = Vec::new();
    let mut kept_aside = Vec::new();
    for plate in 0..target.plate.len() {
        for offset in OFFSETS {
            let (stage, cells) = shoot(plate, offset);
            let view = sightings.len();
            let sighting = Sighting::new(view, plate, stage, &[cells], &flat, &target, &start);
            sightings.push(sighting.expect("dots"));
        }
    }
    for plate in [0, 3, 4] {
        for offset in ASIDE {
            let (stage, cells) = shoot(plate, offset);
            let lit = std::slice::from_ref(&cells);
            let sighting = Sighting::new(99, plate, stage, lit, &flat, &target, &start);
            kept_aside.push((sighting.expect("dots"), cells));
        }
    }
    let places = target.test_place.iter();
    let spheres = places.map(|place| shoot(7, [place.turned_rad, place.raised_mm]).1);
    let spheres = spheres.collect();
    Captures {
        optics: config.optics,
        target,
        start,
        sightings,
        kept_aside,
        blank,
        spheres,
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
    let sums = sums(world, decoder, &view, &[target.exposure_us], 100 * number);
    decoder.columns(&sums).expect("a whole view")
}

/// Every frame of a view, added up.
fn sums(
    world: &World,
    decoder: &Decoder,
    view: &ViewState,
    exposures_us: &[u32],
    first_counter: u32,
) -> Accumulator {
    let mut accumulator = decoder.begin();
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let order: Vec<FrameKind> = decoder.capture_order().collect();
    for (counter, kind) in (first_counter..).zip(order) {
        let (pattern, exposure_us) = match kind {
            FrameKind::Dark => (0, exposures_us[0]),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => (1 + 4 * set as u16 + step as u16, exposures_us[exposure]),
            FrameKind::Code { .. } => unreachable!("the bench shows no code"),
        };
        world
            .render(view, pattern, exposure_us, true, counter, &mut pixels)
            .expect("a frame");
        accumulator
            .add(FrameView::packed(&pixels, width, height), kind)
            .expect("frames in order");
    }
    accumulator
}

/// A point and where it should be, mm.
type Pair = [Point3<f64>; 2];

/// A point of the camera frame as a head reads it from what the optics make of it.
fn read_back(is: &HeadOptics, said: &HeadModel, p: Point3<f64>) -> Point3<f64> {
    let seen = is.camera.project(p).expect("in front");
    let light = is.projector.project(is.projector_from_camera * p);
    let [column, _] = light.expect("in front");
    let [x, y] = said.camera.undistort(seen).expect("a lens");
    let hit = Triangulator::new(said, Axis::Columns).intersect([x, y], column);
    let z = hit.expect("a point").depth_mm;
    Point3::new(x * z, y * z, z)
}

/// Points all over the volume as a head puts them, and as they are, in the stage frame.
fn volume_points(is: &HeadOptics, said: &HeadModel) -> Vec<Pair> {
    let hand_eye = said.stage_from_camera.expect("a hand-eye");
    let mut pairs = Vec::new();
    for depth in [20.5, 22.0, 23.5] {
        for i in -4..=4 {
            for j in -3..=3 {
                let pixel = [959.5 + 100.0 * f64::from(i), 599.5 + 95.0 * f64::from(j)];
                let p = Point3::from(depth * is.camera.direction(pixel));
                let said = hand_eye.point(read_back(is, said, p).into());
                pairs.push([said.into(), is.stage_from_camera * p]);
            }
        }
    }
    pairs
}

/// Root mean square errors, µm: along the view, which is the stage's x, and across it.
fn errors_um(pairs: &[Pair]) -> [f64; 2] {
    let (mut along, mut across) = (0.0, 0.0);
    for [said, is] in pairs {
        let off = 1e3 * (said - is);
        along += off.x * off.x;
        across += 0.5 * (off.y * off.y + off.z * off.z);
    }
    [along, across].map(|sum: f64| (sum / pairs.len() as f64).sqrt())
}

/// Root mean square distance after the best rigid motion (Kabsch), µm: what is bent, wherever it lies.
fn form_error_um(pairs: &[Pair]) -> f64 {
    let count = pairs.len() as f64;
    let middle = |k: usize| pairs.iter().map(|p| p[k].coords).sum::<Vector3<f64>>() / count;
    let middles = [middle(0), middle(1)];
    let away = |pair: &Pair| [0, 1].map(|k| pair[k].coords - middles[k]);
    let cross = |pair: &Pair| {
        let [said, is] = away(pair);
        is * said.transpose()
    };
    let svd = pairs
        .iter()
        .map(cross)
        .sum::<Matrix3<f64>>()
        .svd(true, true);
    let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = u * mirror * v_t;
    let squares = |pair: &Pair| {
        let [said, is] = away(pair);
        (rotation * said - is).norm_squared()
    };
    1e3 * (pairs.iter().map(squares).sum::<f64>() / count).sqrt()
}

#[test]
fn the_target_gives_the_head() {
    let Captures {
        optics,
        target,
        start,
        sightings,
        kept_aside,
        blank,
        spheres,
    } = capture(3, 0.0);
    let adjusted = adjust(&start, &target, &sightings, STAGE_SIGMA).expect("a calibration");
    let truth = demo::head();
    let error_um = |head| errors_um(&volume_points(&optics, head));
    let [depth_um, lateral_um] = error_um(&adjusted.head);
    let plain_um = error_um(&adjusted.without_field);
    let drawn_um = error_um(&start);
    let stated_um = [adjusted.depth_sigma_mm, adjusted.lateral_sigma_mm].map(|mm| 1e3 * mm);
    eprintln!(
        "{} dots, {} dropped, {:.3} and {:.3} px left over; points off by {depth_um:.2} um in depth and {lateral_um:.2} um \
         across, stated {:.2} and {:.2}; without residual fields {:.2} and {:.2}; by the drawing {:.0} and {:.0}",
        adjusted.marks,
        adjusted.dropped,
        adjusted.camera_rms_px,
        adjusted.projector_rms_px,
        stated_um[0],
        stated_um[1],
        plain_um[0],
        plain_um[1],
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
    let record = CalibrationRecord::new(
        &adjusted,
        &head,
        &target.name,
        [Some(got), None],
        None,
        today,
        90,
    );
    head.calibration = Some(record.clone());
    assert_eq!(head.fit_on(today), Err(Unfit::Untested));

    // Plane and sphere of a fit head, and of one whose lens has been knocked out of place since.
    let planes = [vec![blank]];
    let spheres: Vec<_> = spheres.into_iter().map(|cells| vec![cells]).collect();
    let test = SelfTest::measure(&head, &target, &planes, &spheres, today).expect("a self-test");
    eprintln!("{test:?}");
    let limits = test.limits;
    assert!(
        test.figures.of_planes.plane_points > 60_000
            && test.figures.of_spheres.sphere_points > 1_000
    );
    // The plane's points scatter by what the fresh plates show; of 99.7 % of a normal distribution the range is 6 sigma.
    assert!((3.0..12.0).contains(&(test.figures.of_planes.flatness_um / got.flatness_rms_um)));
    assert!(test.figures.of_spheres.probing_size_um.abs() < limits.probing_size_um);
    assert_eq!(test.places, Some(3));
    // A sphere's centre lies as well as its points, which the calibration puts within 3 um; two centres within 3 sqrt 2.
    let spacing_um = test
        .figures
        .of_spheres
        .sphere_spacing_um
        .expect("two spheres");
    assert!(spacing_um.abs() < 4.3, "{spacing_um}");
    // The widest of three ranges of a thousand normal values is 8.1 of their standard deviations once in a hundred times; those
    // of cells are below a micrometre.
    assert!(
        test.figures
            .of_planes
            .flatness_cells_um
            .is_some_and(|um| um < 8.1)
    );
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
    let failed =
        SelfTest::measure(&knocked, &target, &planes, &spheres, today).expect("a self-test");
    eprintln!("{failed:?}");
    assert!(matches!(fit(&failed, today), Err(Unfit::Failed { .. })));
    // Two centres as the bench's optics have them, read with the knocked lens.
    let spheres_apart = target.sphere.expect("spheres");
    let off_um: Vec<f64> = target
        .spheres()
        .into_iter()
        .map(|SphereAt { stood, .. }| {
            let partner = spheres_apart.partner.expect("two");
            let [first, second] = [spheres_apart.centre_mm, partner.centre_mm].map(|centre_mm| {
                let at = stood.stage_from_tool() * Point3::from(centre_mm);
                read_back(&optics, &knocked, optics.stage_from_camera.inverse() * at)
            });
            1e3 * ((second - first).norm() - partner.spacing_mm)
        })
        .collect();
    let farthest_um = off_um
        .into_iter()
        .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let failed_um = failed
        .figures
        .of_spheres
        .sphere_spacing_um
        .expect("two spheres");
    eprintln!("knocked: {failed_um:.2} um, by the optics {farthest_um:.2}");
    assert!((failed_um - farthest_um).abs() < 4.3);
    let one = SelfTest::measure(&head, &target, &planes, &spheres[..1], today);
    assert!(
        matches!(
            one,
            Err(SelfTestError::Places {
                got: 1,
                expected: 3,
                ..
            })
        ),
        "{one:?}"
    );

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

/// The die as a head decodes it and as it is, in the stage frame: means over squares of a millimetre, so that noise and the
/// cores' pattern leave little.
fn die_points(config: &WorldConfig, head: &HeadModel) -> Vec<Pair> {
    const SQUARE_MM: f64 = 1.0;
    let world = World::new(config).expect("a world");
    let patterns = PatternSet::named("insitu12").expect("built in");
    let options = DecodeOptions::for_head(head);
    let decoder = Decoder::new(head, &patterns, &head.exposures_us, options).expect("a decoder");
    let view = world
        .prepare(0.0, die::HEIGHT_MM, &PatternSpec::insitu12())
        .expect("a view");
    let sums = sums(&world, &decoder, &view, &head.exposures_us, 0);
    let cloud = decoder.finish(&sums).expect("a whole view").cloud;
    let stage_from_tool = Translation3::new(0.0, 0.0, -die::HEIGHT_MM);
    let hand_eye = head.stage_from_camera.expect("a hand-eye");
    let positions = world.camera_bundle().positions_px();
    let truth: HashMap<[u16; 2], Point3<f64>> = world
        .truth(&view)
        .iter()
        .map(|core| {
            let pixel = positions[core.core as usize].map(|px| px.round() as u16);
            (pixel, stage_from_tool * Point3::from(core.point_tool_mm))
        })
        .collect();
    let mut squares: HashMap<[i32; 2], (f64, [Vector3<f64>; 2])> = HashMap::new();
    for (p, cell) in cloud.points_mm.iter().zip(&cloud.cell) {
        let Some(is) = truth.get(cell) else { continue };
        let said = Vector3::from(hand_eye.point(*p));
        // Beside an edge a core that is off by a hair sees something else.
        if (said - is.coords).norm() > 0.05 {
            continue;
        }
        let at = [is.y, is.z].map(|x| (x / SQUARE_MM).round() as i32);
        let (count, sums) = squares.entry(at).or_default();
        *count += 1.0;
        sums[0] += said;
        sums[1] += is.coords;
    }
    let pairs: Vec<Pair> = squares
        .values()
        .filter(|(count, _)| *count > 200.0)
        .map(|(count, sums)| sums.map(|sum| Point3::from(sum / *count)))
        .collect();
    assert!(pairs.len() > 30, "{} squares", pairs.len());
    pairs
}

/// Lenses that lead light astray by 2 µm as no distortion model does: found on the plates, and gone from fresh plates, from the
/// volume and from the die.
#[test]
fn an_uneven_lens_is_learnt_from_the_plates() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    const LENS_ERROR_UM: f64 = 2.0;
    let captured = capture(5, LENS_ERROR_UM);
    let (target, optics) = (&captured.target, &captured.optics);
    let adjusted =
        adjust(&captured.start, target, &captured.sightings, STAGE_SIGMA).expect("a calibration");
    let heads = [&adjusted.without_field, &adjusted.head];
    let aside = heads.map(|head| hold_out(head, target, &captured.kept_aside).expect("plates"));
    let volume_um = heads.map(|head| form_error_um(&volume_points(optics, head)));
    let mut die = die::world_config().expect("a die");
    die.optics = optics.clone();
    let die_um = heads.map(|head| form_error_um(&die_points(&die, head)));
    eprintln!(
        "without and with residual fields, um: form in the volume {volume_um:.2?}, of the die {die_um:.2?} (stated depth \
         {:.2}), fresh plates {aside:?}",
        1e3 * adjusted.depth_sigma_mm
    );
    assert!(volume_um[1] < 0.6 * volume_um[0]);
    assert!(die_um[1] < 0.8 * die_um[0]);
    assert!(aside[1].flatness_rms_um < aside[0].flatness_rms_um);
    assert!(aside[1].dots_rms_um < aside[0].dots_rms_um);
}

/// Images in a folder give the head that their frames give without it, bit for bit; what is wrong with a folder is named.
#[test]
fn captures_in_a_folder_give_the_same_head() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    const SEED: u64 = 7;
    let target = demo::target();
    let config = demo::target_world(&target, SEED);
    // One view of each plate, for what a test may cost.
    let mut views = demo::target_views(&target, SEED, &target.beside[..1]);
    views.retain(|view| view.plate.is_some() || view.folder == Path::new("blank"));
    let folder = tempfile::tempdir().expect("a folder");
    demo::write_captures(folder.path(), &config, &views).expect("captures");

    let drawn = || HeadModel::load(&folder.path().join("head.toml")).expect("a head");
    let open = || CaptureFolder::open(folder.path(), drawn(), target.clone());
    let from_files = open()
        .and_then(|mut captures| captures.calibrate(|_| {}))
        .expect("a calibration");

    // The same frames, from the world's hand to the decoder's.
    let world = World::new(&config).expect("a world");
    let patterns = PatternSet::named("insitu12").expect("built in");
    let exposures = [target.exposure_us];
    let decoder = |head: &HeadModel, options| {
        Decoder::new(head, &patterns, &exposures, options).expect("a decoder")
    };
    let frames = |decoder: &Decoder, view: &TargetView| {
        let [rotation, vertical] = view.true_pose;
        let state = world
            .prepare(rotation, vertical, &PatternSpec::insitu12())
            .expect("a view");
        sums(&world, decoder, &state, &exposures, view.first_frame)
    };
    let mut start = drawn();
    let without_circle = HeadModel {
        image_circle: None,
        ..drawn()
    };
    let by_pixel = DecodeOptions {
        grid: GridKind::Pixel,
        binning: 1,
        ..DecodeOptions::for_head(&without_circle)
    };
    let offset_dn = start.sensor.expect("a sensor").offset_dn;
    let flat = frames(&decoder(&without_circle, by_pixel), &views[0]);
    let flat = FlatField::from_view(&flat, offset_dn).expect("a flat field");
    start.core_map = Some(Arc::new(cores::find(&flat).expect("cores")));
    let by_core = decoder(&start, DecodeOptions::for_head(&start));
    let columns = |view: &TargetView| by_core.columns(&frames(&by_core, view)).expect("a view");
    let flat_e = [columns(&views[0]).iter().map(|cell| cell.mean_e).collect()];
    let sightings: Vec<Sighting> = views[1..]
        .iter()
        .enumerate()
        .map(|(number, view)| {
            let plate = view.plate.expect("a printed plate");
            let lit = [columns(view)];
            Sighting::new(number, plate, view.told, &lit, &flat_e, &target, &start).expect("dots")
        })
        .collect();
    let stage_sigma = [15e-3 * PI / 180.0, 5e-3].map(|half| half / 1.732_050_807_568_877_2);
    let adjusted = adjust(&start, &target, &sightings, stage_sigma).expect("a calibration");
    assert_eq!(from_files.views.len(), 6);
    assert_eq!(from_files.adjusted.head.camera, adjusted.head.camera);
    assert_eq!(from_files.adjusted.head.projector, adjusted.head.projector);
    assert_eq!(from_files.adjusted.marks, adjusted.marks);

    let refused = || {
        let head = open().and_then(|mut captures| captures.calibrate(|_| {}));
        head.expect_err("a bad folder").to_string()
    };
    // An image of another size, then none at all.
    let image = folder.path().join("blank/frame-03.png");
    std::fs::copy(&image, folder.path().join("kept.png")).expect("a copy");
    let file = std::fs::File::create(&image).expect("an image");
    let mut small = png::Encoder::new(file, 8, 8);
    small.set_color(png::ColorType::Grayscale);
    small.set_depth(png::BitDepth::Sixteen);
    let mut writer = small.write_header().expect("a header");
    writer.write_image_data(&[0; 128]).expect("an image");
    writer.finish().expect("an image");
    let why = refused();
    assert!(why.contains("frame-03.png has 8 x 8 pixels"), "{why}");
    std::fs::remove_file(&image).expect("removed");
    let why = refused();
    assert!(why.contains("holds 12 images, the plan has 13"), "{why}");
    // A manifest with a view too few, or with a plate that is not there.
    let manifest = folder.path().join("captures.toml");
    let text = std::fs::read_to_string(&manifest).expect("a manifest");
    let last = text.rfind("[[view]]").expect("views");
    std::fs::write(&manifest, &text[..last]).expect("written");
    let why = refused();
    assert!(
        why.contains("captures.toml") && why.contains("at least 6"),
        "{why}"
    );
    std::fs::write(&manifest, text.replacen("plate = 2", "plate = 9", 1)).expect("written");
    let why = refused();
    assert!(
        why.contains("view[1].plate") && why.contains("plate of the target"),
        "{why}"
    );
}

/// Distances of a plate's points from their plane, µm, with the places they are seen at and the cores that saw them.
fn off_plane_um(cloud: &Cloud) -> Vec<([u16; 2], [f64; 2], f64)> {
    let points: Vec<Vector3<f64>> = cloud.points_mm.iter().map(|p| Vector3::from(*p)).collect();
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let spread: Matrix3<f64> = points
        .iter()
        .map(|p| (p - middle) * (p - middle).transpose())
        .sum();
    let eigen = spread.symmetric_eigen();
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let away = normal * normal.z.signum();
    let off = |p: &Vector3<f64>| 1e3 * away.dot(&(p - middle));
    let seen = cloud.cell.iter().zip(&points);
    seen.map(|(cell, p)| (*cell, [p.x, p.y], off(p))).collect()
}

/// What a plane shows of single points is no noise: it comes again with the view (the cores of both bundles beat against each
/// other), and goes where points are averaged over the cells that wear is judged by.
#[test]
fn ripple_comes_again_and_goes_with_the_cells() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let target = demo::target();
    let world = World::new(&demo::target_world(&target, 3)).expect("a world");
    let mut head = demo::head();
    head.core_map = Some(Arc::new(demo::core_map().expect("cores")));
    let patterns = PatternSet::named("insitu12").expect("built in");
    let exposures = [target.exposure_us];
    let options = DecodeOptions::for_head(&head);
    let decoder = Decoder::new(&head, &patterns, &exposures, options).expect("a decoder");
    let blank = &demo::target_views(&target, 3, &[])[0];
    let [rotation, vertical] = blank.true_pose;
    let view = world
        .prepare(rotation, vertical, &PatternSpec::insitu12())
        .expect("a view");
    let [first, second] = [0, 100].map(|counter| {
        let sums = sums(&world, &decoder, &view, &exposures, counter);
        off_plane_um(&decoder.finish(&sums).expect("a whole view").cloud)
    });
    let rms = |off: &[f64]| (off.iter().map(|x| x * x).sum::<f64>() / off.len() as f64).sqrt();
    let again: HashMap<[u16; 2], f64> = second.iter().map(|(core, _, off)| (*core, *off)).collect();
    let changes: Vec<f64> = first
        .iter()
        .filter_map(|(core, _, off)| Some(off - again.get(core)?))
        .collect();
    let mut squares: HashMap<[i32; 2], Vec<f64>> = HashMap::new();
    for (_, at, off) in &first {
        let square = at.map(|x| (x / 0.25).floor() as i32);
        squares.entry(square).or_default().push(*off);
    }
    let means: Vec<f64> = squares
        .values()
        .filter(|points| points.len() > 40)
        .map(|points| points.iter().sum::<f64>() / points.len() as f64)
        .collect();
    let single: Vec<f64> = first.iter().map(|(_, _, off)| *off).collect();
    let [single, changes, means] = [single, changes, means].map(|off| rms(&off));
    eprintln!(
        "points {single:.2} um rms, from capture to capture {changes:.2}, means over 0.25 mm {means:.2}"
    );
    // The noise of two captures, mostly of photons: 0.4 um each.
    assert!(changes < 0.4 * single);
    // Cells shall tell micrometres.
    assert!(means < 1.0 && means < 0.3 * single);
}
