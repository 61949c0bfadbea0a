//! Known surfaces, traced by other code, come back where they are and as uncertain as predicted.

mod bench_scene;

use bench_scene::*;
use flankscope_profilometry::decode::MaskOptions;
use flankscope_profilometry::head::{HeadModel, RigidTransform, SecondProjector};
use flankscope_profilometry::pattern::{FringeSet, PatternSet};
use flankscope_profilometry::{
    Accumulator, DecodeError, DecodeOptions, Decoded, Decoder, FrameView,
};

/// z along a camera ray (x, y, 1).
type Surface<'a> = &'a dyn Fn([f64; 2]) -> f64;

const BRIGHT: Light = Light {
    mean_e: 20_000.0,
    contrast: 0.6,
    noise_seed: None,
};

fn decode(
    head: &HeadModel,
    patterns: &PatternSet,
    columns: &[f64],
    gains: &[f64],
    light: &Light,
    binning: usize,
) -> Decoded {
    // Exposure times in proportion to the gains, so that all exposures show the same scene.
    let exposures_us: Vec<u32> = gains.iter().map(|gain| (1000.0 * gain) as u32).collect();
    let options = DecodeOptions {
        binning,
        ..DecodeOptions::for_head(head)
    };
    let decoder = Decoder::new(head, patterns, &exposures_us, options).unwrap();
    let frames = capture(head, &decoder, patterns, columns, gains, light);
    decoder.finish(&accumulate(&decoder, &frames)).unwrap()
}

#[test]
fn planes_and_spheres_come_back() {
    let head = head();
    let tilted = plane([0.21, -0.13, 1.0], 21.9);
    let ball = sphere([0.4, -0.3, 24.4], 3.2, 23.6);
    let surfaces: [(&str, Surface<'_>); 2] = [("plane", &tilted), ("sphere", &ball)];
    for (name, surface) in surfaces {
        let columns = columns(&head, surface);
        for set in ["article8", "insitu12", "scan16"] {
            let patterns = PatternSet::named(set).unwrap();
            let decoded = decode(&head, &patterns, &columns, &[1.0], &BRIGHT, 1);
            let cloud = &decoded.cloud;
            assert_eq!(cloud.len() + decoded.rejected.total(), decoded.cells);
            // A few cells fall off the projector or the volume at the corners.
            assert!(
                cloud.len() * 10 > decoded.cells * 9,
                "{name} {set}: {:?}",
                decoded.rejected
            );
            let mut worst = 0f64;
            for (point, cell) in cloud.points_mm.iter().zip(&cloud.cell) {
                let [x, y] = ray(&head, f64::from(cell[0]), f64::from(cell[1]));
                let z = surface([x, y]);
                let error = (point[0] - x * z)
                    .hypot(point[1] - y * z)
                    .hypot(point[2] - z);
                worst = worst.max(error);
            }
            // Rounding to whole counts of 12 000 is 2e-5 rad in four steps and sums in single precision as much:
            // 1e-6 mm at 50 columns per mm and 48 periods; ten times that is far below anything that matters.
            assert!(worst < 1e-5, "{name} {set}: {worst} mm");
        }
    }
}

/// A bright land beside a dim, steep flank: light that is smoothed for the order must not carry the land's columns over the edge.
#[test]
fn a_highlight_does_not_speak_for_what_lies_beyond_its_edge() {
    const EDGE_ROW: usize = HEIGHT / 2;
    const DIMMER: u16 = 25;
    let head = head();
    let at_edge = ray(&head, 75.0, EDGE_ROW as f64 - 0.5)[1];
    // On the flank an order every eight rows.
    let surface = |[_, y]: [f64; 2]| 22.0 + 17.0 * (y - at_edge).max(0.0);
    let columns = columns(&head, surface);
    for set in ["high12", "high16"] {
        let patterns = PatternSet::named(set).unwrap();
        let options = DecodeOptions::for_head(&head).with_smoothed_orders();
        let decoder = Decoder::new(&head, &patterns, &[1000], options).unwrap();
        let mut frames = capture(&head, &decoder, &patterns, &columns, &[1.0], &BRIGHT);
        for (_, pixels) in &mut frames {
            for dn in &mut pixels[EDGE_ROW * WIDTH..] {
                *dn = 100 + (*dn - 100) / DIMMER;
            }
        }
        let decoded = decoder.finish(&accumulate(&decoder, &frames)).unwrap();
        let near = |row: u16| usize::from(row).abs_diff(EDGE_ROW) < 6;
        let cells = decoded.cloud.cell.iter().filter(|cell| near(cell[1]));
        // Cells of the outermost columns lie off the projector.
        let (found, asked) = (cells.count(), 11 * WIDTH);
        assert!(
            20 * found > 19 * asked,
            "{set}: {found} of {asked}, {:?}",
            decoded.rejected
        );
        for (point, cell) in decoded.cloud.points_mm.iter().zip(&decoded.cloud.cell) {
            let z = surface(ray(&head, f64::from(cell[0]), f64::from(cell[1])));
            // A count lost to whole division is 1e-3 of the dim light: 1e-4 of an order.
            assert!(
                (point[2] - z).abs() < 1e-3,
                "{set} {cell:?}: {}",
                point[2] - z
            );
        }
    }
}

#[test]
fn contrast_and_orders_between_points_are_those_of_the_scene() {
    let head = head();
    let surface = plane([0.1, 0.2, 1.0], 22.1);
    let columns = columns(&head, &surface);
    let patterns = PatternSet::named("scan16").unwrap();
    let decoded = decode(&head, &patterns, &columns, &[1.0], &BRIGHT, 1);
    assert_eq!(decoded.contrast.len(), 3);
    for contrast in &decoded.contrast {
        assert!((contrast - BRIGHT.contrast).abs() < 1e-4, "{contrast}");
    }
    let decoder = Decoder::new(&head, &patterns, &[1000], DecodeOptions::for_head(&head)).unwrap();
    for [x, y] in [[0.0, 0.0], [0.1, -0.05], [-0.12, 0.08]] {
        let [near, far] = [21.0, 21.7].map(|z| [x * z, y * z, z]);
        let expected = (column(&head, far) - column(&head, near)) * 48.0 / 1024.0;
        let got = decoder.orders_between(near, far).unwrap();
        assert!(
            (got - expected).abs() < 1e-9 && got.abs() > 1.0,
            "{got} {expected}"
        );
    }
}

#[test]
fn three_to_eight_steps_and_one_to_three_frequencies_agree() {
    let head = head();
    let surface = plane([0.1, 0.2, 1.0], 22.1);
    let columns = columns(&head, &surface);
    let sets: [&[(f64, u32)]; 4] = [
        &[(4.0, 3), (24.0, 3)],
        &[(4.0, 4), (48.0, 5)],
        &[(3.0, 8)],
        &[(1.0, 5), (7.5, 4), (48.0, 8)],
    ];
    for set in sets {
        let sets = set
            .iter()
            .map(|&(periods, steps)| FringeSet::new(periods, steps))
            .collect();
        let patterns = PatternSet::new("test", sets).unwrap();
        let decoded = decode(&head, &patterns, &columns, &[1.0], &BRIGHT, 1);
        assert!(
            decoded.cloud.len() * 10 > decoded.cells * 9,
            "{set:?} {:?}",
            decoded.rejected
        );
        let finest = set[set.len() - 1].0;
        for (point, cell) in decoded.cloud.points_mm.iter().zip(&decoded.cloud.cell) {
            let z = surface(ray(&head, f64::from(cell[0]), f64::from(cell[1])));
            // As above, scaled to the periods.
            assert!(
                (point[2] - z).abs() < 1e-5 * 48.0 / finest,
                "{set:?} {}",
                point[2] - z
            );
        }
    }
}

#[test]
fn predicted_uncertainty_is_the_spread() {
    let head = head();
    let surface = plane([0.1, -0.2, 1.0], 22.0);
    let columns = columns(&head, &surface);
    for (set, gains, mean_e, binning) in [
        ("insitu12", &[1.0][..], 4000.0, 1),
        ("scan16", &[1.0, 2.0], 900.0, 1),
        ("article8", &[1.0], 3000.0, 3),
    ] {
        let patterns = PatternSet::named(set).unwrap();
        let light = Light {
            mean_e,
            contrast: 0.5,
            noise_seed: Some(11),
        };
        let decoded = decode(&head, &patterns, &columns, gains, &light, binning);
        let cloud = &decoded.cloud;
        assert!(
            cloud.len() * 10 > decoded.cells * 8,
            "{:?}",
            decoded.rejected
        );
        let (mut squares, mut sum) = (0.0, 0.0);
        for ((point, cell), sigma) in cloud
            .points_mm
            .iter()
            .zip(&cloud.cell)
            .zip(&cloud.sigma_z_mm)
        {
            let centre =
                |index: u16| f64::from(index) * binning as f64 + (binning - 1) as f64 / 2.0;
            let z = surface(ray(&head, centre(cell[0]), centre(cell[1])));
            let error = (point[2] - z) / f64::from(*sigma);
            squares += error * error;
            sum += error;
        }
        let count = cloud.len() as f64;
        let ratio = (squares / count).sqrt();
        // The rms of n draws is known to 1/sqrt(2 n); four of these, and 2 % for gates that cut the tails.
        let tolerance = 4.0 / (2.0 * count).sqrt() + 0.02;
        assert!((ratio - 1.0).abs() < tolerance, "{set}: {ratio} of {count}");
        assert!(
            (sum / count).abs() < 4.0 / count.sqrt() + 0.02,
            "{set}: bias {}",
            sum / count
        );
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let head = head();
    let columns = columns(&head, sphere([0.0, 0.0, 24.0], 3.0, 23.0));
    let light = Light {
        mean_e: 2000.0,
        contrast: 0.5,
        noise_seed: Some(3),
    };
    let patterns = PatternSet::named("scan16").unwrap();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| decode(&head, &patterns, &columns, &[1.0, 3.0], &light, 2))
    };
    let serial = run(1);
    assert!(serial.cloud.len() > 1000);
    for threads in [2, 5] {
        assert_eq!(serial, run(threads));
    }
}

#[test]
fn what_lies_outside_the_volume_is_not_guessed() {
    // Between the volume's far end and where its near end repeats (a period of the lowest frequency spans more than
    // 4.2 mm of depth) no fringe order leads into the volume.
    let head = head();
    let patterns = PatternSet::named("insitu12").unwrap();
    let behind = columns(&head, plane([0.0, 0.0, 1.0], 24.15));
    let decoded = decode(&head, &patterns, &behind, &[1.0], &BRIGHT, 1);
    assert_eq!(decoded.cloud.len(), 0);
    assert!(
        decoded.rejected.outside_volume > decoded.cells / 2,
        "{:?}",
        decoded.rejected
    );
}

/// Light on the left half only: without smoothing the mask is exactly that half, with smoothing its edge may move.
#[test]
fn the_mask_keeps_what_oscillates() {
    let head = head();
    let patterns = PatternSet::named("insitu12").unwrap();
    let columns = columns(&head, plane([0.0, 0.0, 1.0], 22.0));
    let run = |smoothing_px: f64| {
        let options = DecodeOptions {
            min_contrast: 0.0,
            patches: None,
            mask: Some(MaskOptions {
                threshold_dn: 500.0,
                smoothing_px,
            }),
            ..DecodeOptions::for_head(&head)
        };
        let decoder = Decoder::new(&head, &patterns, &[1000], options).unwrap();
        let mut frames = capture(&head, &decoder, &patterns, &columns, &[1.0], &BRIGHT);
        // A standard deviation of 12 000 / sqrt(2) = 8485 counts on the left, a twentieth of it (424) on the right.
        for (_, pixels) in &mut frames {
            for row in pixels.chunks_exact_mut(WIDTH) {
                row[WIDTH / 2..]
                    .iter_mut()
                    .for_each(|pixel| *pixel = 100 + (*pixel - 100) / 20);
            }
        }
        decoder.finish(&accumulate(&decoder, &frames)).unwrap()
    };
    let sharp = run(0.0);
    assert!(sharp.cloud.len() * 10 > sharp.cells * 4);
    assert!(
        sharp
            .cloud
            .cell
            .iter()
            .all(|cell| usize::from(cell[0]) < WIDTH / 2)
    );
    assert!(
        sharp.rejected.masked * 10 > sharp.cells * 4,
        "{:?}",
        sharp.rejected
    );
    // Four sigma right of the edge the left half adds 3e-5 of its 8485 counts.
    let smooth = run(3.0);
    assert!(smooth.cloud.len() > sharp.cloud.len());
    assert!(
        smooth
            .cloud
            .cell
            .iter()
            .all(|cell| usize::from(cell[0]) < WIDTH / 2 + 12)
    );
}

#[test]
fn an_ambiguous_volume_is_refused() {
    let mut head = head();
    let patterns = PatternSet::named("insitu12").unwrap();
    let new = |head: &HeadModel| {
        Decoder::new(head, &patterns, &[1000], DecodeOptions::for_head(head)).map(|_| ())
    };
    assert_eq!(new(&head), Ok(()));
    head.volume.as_mut().unwrap().far_mm = 32.0;
    assert!(
        matches!(new(&head), Err(DecodeError::VolumeTooDeep { spanned, .. }) if spanned > 0.95)
    );
    head.volume = None;
    assert_eq!(new(&head), Err(DecodeError::NeedsVolume { periods: 4.0 }));
    head.sensor = None;
    assert_eq!(new(&head), Err(DecodeError::NoSensor));
}

#[test]
fn head_files_survive_the_round_trip() {
    let folder = std::env::temp_dir().join(format!("flankscope-head-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("head.toml");
    let mut full = head();
    full.stage_from_camera = Some(full.projector_from_camera);
    full.pattern_set = Some("insitu12".to_owned());
    full.exposures_us = vec![10_000, 20_000];
    full.working_distance_mm = Some(20.0);
    for head in [head(), full] {
        std::fs::write(&path, head.to_toml().unwrap()).unwrap();
        assert_eq!(HeadModel::load(&path).unwrap(), head);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Light that falls off beside an edge, on a steep plane: smoothing takes a cell's phase from where it is bright, and the point has to
/// lie there, too. At the cell itself it would be off by the fall-off times the variance of the Gaussian times the slope: tens of
/// micrometres.
#[test]
fn smoothing_beside_an_edge_of_light_leaves_points_on_the_surface() {
    let head = head();
    let patterns = PatternSet::named("insitu12").unwrap();
    let surface = plane([1.2, 0.4, 1.0], 22.0);
    let columns = columns(&head, &surface);
    // Amplitude of a cell: even up to an edge, then by a factor of e lower every 2 px.
    let falls = |column: usize| (-(column as f64 - 75.0).max(0.0) / 2.0).exp();
    let mut off_um = [0.0; 2];
    for (off_um, smoothing_px) in off_um.iter_mut().zip([0.0, 0.7]) {
        let options = DecodeOptions {
            smoothing_px,
            patches: None,
            ..DecodeOptions::for_head(&head)
        };
        let decoder = Decoder::new(&head, &patterns, &[1000], options).unwrap();
        let mut frames = capture(&head, &decoder, &patterns, &columns, &[1.0], &BRIGHT);
        for (_, pixels) in &mut frames {
            for (at, pixel) in pixels.iter_mut().enumerate() {
                let light = f64::from(*pixel - 100) * falls(at % WIDTH);
                *pixel = 100 + light.round() as u16;
            }
        }
        let decoded = decoder.finish(&accumulate(&decoder, &frames)).unwrap();
        let cloud = &decoded.cloud;
        let mut beside = 0;
        for (point, cell) in cloud.points_mm.iter().zip(&cloud.cell) {
            // Bright enough that rounding is below a micrometre.
            if (70..84).contains(&cell[0]) {
                let [x, y, z] = *point;
                *off_um = f64::max(*off_um, 1e3 * (z - surface([x / z, y / z])).abs());
                beside += 1;
            }
        }
        assert!(beside > 900, "{beside}");
    }
    assert!(off_um[0] < 1.0 && off_um[1] < 3.0, "{off_um:?}");
}

/// A mean and an amplitude made of known parts, through optics of a known contrast, come back as these parts.
#[test]
fn direct_and_global_light_come_back() {
    let patterns = PatternSet::named("high12").unwrap();
    for (stated, optics) in [(Some(0.8), 0.8), (None, 1.0)] {
        let head = HeadModel {
            fringe_contrast: stated,
            ..head()
        };
        let columns = columns(&head, plane([0.0, 0.0, 1.0], 22.0));
        // With all mirrors on: 9000 electrons straight, 3000 over other ways. A fringe lights half of the scene.
        let (direct_e, global_e) = (9_000.0, 3_000.0);
        let mean_e = 0.5 * direct_e + 0.5 * global_e;
        let light = Light {
            mean_e,
            contrast: optics * 0.5 * direct_e / mean_e,
            noise_seed: Some(3),
        };
        let decoded = decode(&head, &patterns, &columns, &[1.0], &light, 1);
        let found = decoded.light.unwrap();
        assert_eq!(decoded.cloud.light.len(), decoded.cloud.len());
        // The median of some ten thousand cells, whose amplitude has a noise of sqrt(2 6000 / 4) = 55.
        assert!((found.direct_e - direct_e).abs() < 12.0, "{found:?}");
        assert!((found.global_e - global_e).abs() < 12.0, "{found:?}");
        assert!((found.global_ratio - 0.25).abs() < 1e-3, "{found:?}");
    }
}

/// A surface that grows brighter from row to row: its light is the same whether the longer exposure saturates there or not.
#[test]
fn the_light_of_a_point_does_not_say_which_exposures_count() {
    const GAINS: [f64; 2] = [1.0, 4.0];
    let head = head();
    let patterns = PatternSet::named("high12").unwrap();
    let columns = columns(&head, plane([0.0, 0.0, 1.0], 22.0));
    let exposures_us = GAINS.map(|gain| (1000.0 * gain) as u32);
    let options = DecodeOptions::for_head(&head);
    let decoder = Decoder::new(&head, &patterns, &exposures_us, options).unwrap();
    let full_dn = f64::from(decoder.full_scale_dn());
    let offset_dn = head.sensor.unwrap().offset_dn;
    let light = Light {
        // The longer exposure saturates in the brighter half.
        mean_e: 0.8 * (full_dn - offset_dn) / (GAINS[1] * (1.0 + BRIGHT.contrast)),
        ..BRIGHT
    };
    let part = |row: usize| 0.5 + 1.5 * row as f64 / HEIGHT as f64;
    let mut frames = capture(&head, &decoder, &patterns, &columns, &GAINS, &light);
    for (_, pixels) in &mut frames {
        for (at, dn) in pixels.iter_mut().enumerate() {
            let lit_dn = (f64::from(*dn) - offset_dn) * part(at / WIDTH);
            *dn = (offset_dn + lit_dn).round().min(full_dn) as u16;
        }
    }
    let cloud = decoder
        .finish(&accumulate(&decoder, &frames))
        .unwrap()
        .cloud;
    let expected_e_per_ms = light.mean_e * light.contrast;
    let mut rows = [0; HEIGHT];
    for (cell, &found) in cloud.cell.iter().zip(&cloud.fringes_e_per_ms) {
        let row = usize::from(cell[1]);
        rows[row] += 1;
        let ratio = f64::from(found) / (expected_e_per_ms * part(row));
        // Counts are whole numbers.
        assert!((ratio - 1.0).abs() < 0.01, "row {row}: {ratio}");
    }
    assert!(rows.iter().all(|&points| 2 * points > WIDTH), "{rows:?}");
}

/// The head with a projector on the other side, a little nearer and with another lens.
fn twin() -> HeadModel {
    let head = head();
    let length = 10f64.hypot(19.0);
    let (x, z) = (10.0 / length, 19.0 / length);
    let rotation = [[z, 0.0, -x], [0.0, 1.0, 0.0], [x, 0.0, z]];
    let place = [-10.0, 0.0, 3.0];
    let translation_mm =
        rotation.map(|row: [f64; 3]| -(0..3).map(|i| row[i] * place[i]).sum::<f64>());
    let mut projector = head.projector.clone();
    projector.focal_px = [2230.0, 2230.0];
    projector.distortion = [0.05, -0.02, 1e-3, -1e-3, 0.0];
    HeadModel {
        second_projector: Some(SecondProjector {
            projector,
            mirrors: None,
            circle: None,
            projector_from_camera: RigidTransform {
                rotation,
                translation_mm,
            },
        }),
        ..head
    }
}

/// The sums of a view that `first` and `second` of the twin's projectors light, each with its own frames.
fn lit_by_both(
    twin: &HeadModel,
    decoder: &Decoder,
    patterns: &PatternSet,
    light: [&Light; 2],
    columns: [Vec<f64>; 2],
    shadows: [&dyn Fn(usize) -> bool; 2],
) -> Accumulator {
    let mut sums = decoder.begin();
    let mut second = sums.take_second().unwrap();
    for (at, sums) in [&mut sums, &mut second].into_iter().enumerate() {
        let mut frames = capture(twin, decoder, patterns, &columns[at], &[1.0], light[at]);
        for (kind, pixels) in &mut frames {
            for (place, dn) in pixels.iter_mut().enumerate() {
                if shadows[at](place % WIDTH) {
                    *dn = 100;
                }
            }
            let frame = FrameView::packed(pixels, WIDTH, HEIGHT);
            sums.add(frame, *kind).unwrap();
        }
    }
    sums.put_second(second);
    sums
}

#[test]
fn two_projectors_measure_what_either_sees_and_nothing_that_they_contradict_each_other_on() {
    let twin = twin();
    let by_second = twin.with_projector(2).unwrap();
    let surface = plane([0.05, -0.03, 1.0], 21.9);
    let patterns = PatternSet::named("high12").unwrap();
    let decoder = Decoder::new(&twin, &patterns, &[1000], DecodeOptions::for_head(&twin)).unwrap();
    assert_eq!(decoder.projectors(), 2);
    let true_columns = columns(&by_second, &surface);
    // Over the last rows the second one's light comes from a place 0.2 mm deeper.
    let elsewhere = columns(&by_second, |ray| surface(ray) + 0.2);
    let misled = |row: usize| row >= 80;
    let second = (0..WIDTH * HEIGHT)
        .map(|place| match misled(place / WIDTH) {
            true => elsewhere[place],
            false => true_columns[place],
        })
        .collect();
    let sums = lit_by_both(
        &twin,
        &decoder,
        &patterns,
        [&BRIGHT; 2],
        [columns(&twin, &surface), second],
        [&|column| column < 40, &|column| column >= 110],
    );
    let decoded = decoder.finish(&sums).unwrap();
    let found = decoded.projectors.unwrap();
    let mut here = [0usize; 3];
    for (point, cell) in decoded.cloud.points_mm.iter().zip(&decoded.cloud.cell) {
        let [column, row] = cell.map(usize::from);
        let z = surface(ray(&twin, column as f64, row as f64));
        // Points seen by the misled projector alone are contradicted by nothing.
        let deeper = if misled(row) && column < 40 { 0.2 } else { 0.0 };
        let off = (point[2] - z - deeper).abs();
        assert!(off < 1e-5, "{cell:?}: {off} mm");
        here[usize::from(column >= 40) + usize::from(column >= 110)] += 1;
        assert!(!(misled(row) && (40..110).contains(&column)), "{cell:?}");
    }
    assert_eq!(here, [found.alone[1], found.both, found.alone[0]]);
    // The outermost columns are off the projectors.
    assert!(here[0] > 25 * HEIGHT && here[2] > 25 * HEIGHT, "{here:?}");
    assert!(
        here[1] > 69 * 80 && found.disagreeing > 69 * 16,
        "{found:?}"
    );
    assert!(found.apart_um.unwrap().abs() < 0.01, "{found:?}");
    assert_eq!(decoded.cloud.light.len(), decoded.cloud.len());
    // Round trip through bytes.
    let bytes = sums.to_bytes();
    assert_eq!(bytes.len(), sums.byte_count());
    let mut again = decoder.begin();
    again.restore(&bytes).unwrap();
    assert_eq!(decoder.finish(&again).unwrap(), decoded);
    let short = &bytes[..bytes.len() / 2];
    assert!(again.restore(short).is_err(), "one projector's alone");
    // A view of which one projector's frames are not there yet.
    let mut half = sums;
    let mut second = half.take_second().unwrap();
    second.reset();
    half.put_second(second);
    let error = decoder.finish(&half).unwrap_err();
    assert!(matches!(error, DecodeError::Incomplete { .. }), "{error}");
}

/// Points merged from both projectors scatter by their stated uncertainty, and by less than those of either alone.
#[test]
fn two_projectors_are_surer_than_one() {
    let twin = twin();
    let surface = plane([0.05, -0.03, 1.0], 21.9);
    let patterns = PatternSet::named("high12").unwrap();
    let options = DecodeOptions::for_head(&twin);
    let decoder = Decoder::new(&twin, &patterns, &[1000], options).unwrap();
    let [one, two] = [11, 12].map(|seed| Light {
        noise_seed: Some(seed),
        ..BRIGHT
    });
    let by_second = twin.with_projector(2).unwrap();
    let sums = lit_by_both(
        &twin,
        &decoder,
        &patterns,
        [&one, &two],
        [columns(&twin, &surface), columns(&by_second, &surface)],
        [&|_| false, &|_| false],
    );
    let both = decoder.finish(&sums).unwrap();
    let alone = twin.with_projector(1).unwrap();
    let single = decode(
        &alone,
        &patterns,
        &columns(&alone, &surface),
        &[1.0],
        &one,
        1,
    );
    // Root mean squares of error and of what was predicted for it, over the cells of both views.
    let errors = |decoded: &Decoded| {
        let (mut squares, mut predicted, mut count) = (0.0, 0.0, 0.0);
        let cloud = &decoded.cloud;
        for (i, cell) in cloud.cell.iter().enumerate() {
            if (30..120).contains(&cell[0]) {
                let z = surface(ray(&twin, f64::from(cell[0]), f64::from(cell[1])));
                squares += (cloud.points_mm[i][2] - z).powi(2);
                predicted += f64::from(cloud.sigma_z_mm[i]).powi(2);
                count += 1.0;
            }
        }
        [squares, predicted].map(|sum| f64::sqrt(sum / count))
    };
    let [error, predicted] = errors(&both);
    let [error_of_one, predicted_of_one] = errors(&single);
    // 8600 cells: a standard deviation is known to 1 %. The half distance as least uncertainty only adds.
    assert!(
        error < 1.05 * predicted && predicted < 1.3 * error,
        "{error} {predicted}"
    );
    assert!((error_of_one / predicted_of_one - 1.0).abs() < 0.05);
    // Alike but for 11 and 10 mm of base: about the square root of two.
    let gain = error_of_one / error;
    assert!((1.25..1.5).contains(&gain), "{gain}");
}
