//! The simulated world against closed forms: geometry, core structure and moiré, noise.

use flankscope_bench::demo;
use flankscope_bench::world::{
    BundleSpec, CoreTruth, DmdPass, PatternSpec, ViewState, World, WorldConfig, WorldError,
};
use flankscope_gear_cad::Mesh;
use std::f64::consts::TAU;

/// A plane across the view at 41.5 mm, facing the head.
fn plane() -> Mesh {
    let x = 41.5;
    Mesh {
        vertices: vec![
            [x, -20.0, -20.0],
            [x, 20.0, -20.0],
            [x, 20.0, 20.0],
            [x, -20.0, 20.0],
        ],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
    }
}

/// The demo head before a plain plane, without distortion.
fn before_a_plane() -> WorldConfig {
    let mut config = WorldConfig::new(plane(), demo::gear());
    config.optics.camera.distortion = [0.0; 5];
    config.optics.projector.distortion = [0.0; 5];
    config.surface.roughness_ratio = 0.0;
    config.surface.gloss_ratio = 0.0;
    config.sensor.core_exponent_spread = 0.0;
    config
}

/// A bundle without individual traits.
fn ideal(spec: &BundleSpec) -> BundleSpec {
    BundleSpec {
        jitter_ratio: 0.0,
        gain_spread_ratio: 0.0,
        dead_ratio: 0.0,
        crosstalk_ratio: 0.0,
        ..spec.clone()
    }
}

fn even() -> PatternSpec {
    PatternSpec {
        periods: 0.0,
        step: 1,
        steps: 4,
    }
}

fn frame(
    world: &World,
    view: &ViewState,
    pattern: u16,
    exposure_us: u32,
    counter: u32,
) -> Vec<u16> {
    let [width, height] = world.size_px();
    let mut counts = vec![0u16; width * height];
    world
        .render(view, pattern, exposure_us, true, counter, &mut counts)
        .expect("a valid frame");
    counts
}

/// Mean count of the three by three pixels around each core of the truth, offset removed: most of one core's light.
fn at_cores(world: &World, truth: &[CoreTruth], frame: &[u16]) -> Vec<f64> {
    let width = world.size_px()[0];
    let near = |t: &CoreTruth| {
        let [x, y] =
            world.camera_bundle().positions_px()[t.core as usize].map(|v| v.round() as usize);
        let window =
            (y - 1..=y + 1).flat_map(|row| (x - 1..=x + 1).map(move |column| row * width + column));
        window.map(|i| f64::from(frame[i]) - 100.0).sum::<f64>() / 9.0
    };
    truth.iter().map(near).collect()
}

/// Phase and modulation per core by the plain sums over the steps of one set, patterns `first..first + steps`.
fn phases(
    world: &World,
    view: &ViewState,
    first: u16,
    steps: u16,
    exposure_us: u32,
) -> Vec<(f64, f64)> {
    let truth = world.truth(view);
    let mut sums = vec![[0.0; 3]; truth.len()];
    for step in 0..steps {
        let shown = at_cores(
            world,
            truth,
            &frame(
                world,
                view,
                first + step,
                exposure_us,
                u32::from(first + step),
            ),
        );
        let (sin, cos) = (TAU * f64::from(step) / f64::from(steps)).sin_cos();
        for (sum, value) in sums.iter_mut().zip(shown) {
            *sum = [sum[0] + value, sum[1] + value * cos, sum[2] - value * sin];
        }
    }
    sums.into_iter()
        .map(|[all, c, s]| (s.atan2(c), 2.0 * c.hypot(s) / all))
        .collect()
}

fn wrapped(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    (values.iter().map(|v| (v - centre).powi(2)).sum::<f64>() / (values.len() as f64 - 1.0)).sqrt()
}

#[test]
fn the_phase_on_a_plane_is_that_of_similar_triangles() {
    let world = World::new(&before_a_plane()).expect("a valid world");
    let view = world
        .prepare(0.0, 0.0, &PatternSpec::insitu12())
        .expect("a valid view");
    let truth = world.truth(&view);
    assert!(truth.len() > 99_900, "the plane fills the field");
    let positions = world.camera_bundle().positions_px();
    let (sin30, cos30) = 30f64.to_radians().sin_cos();
    for (first, steps, periods) in [(1, 4, 4.0), (5, 8, 48.0)] {
        let measured = phases(&world, &view, first, steps, 20_000);
        let (mut errors, mut modulations) = (Vec::new(), Vec::new());
        for (t, (phase, modulation)) in truth.iter().zip(&measured) {
            if !t.lit || world.camera_bundle().gains()[t.core as usize] == 0.0 {
                continue;
            }
            // 22 mm before the camera; the projector is turned by 30 degrees about the focus point.
            let along_mm = (positions[t.core as usize][0] - 959.5) / 2530.0 * 22.0;
            let column = 511.5 + 2252.8 * along_mm * cos30 / (22.0 + along_mm * sin30);
            assert!(
                (column - t.projector_px[0]).abs() < 1e-6,
                "truth {} against {column}",
                t.projector_px[0]
            );
            errors.push(wrapped(phase - TAU * periods * (column + 0.5) / 1024.0));
            modulations.push(*modulation);
        }
        assert!(errors.len() > 80_000);
        // Over 80 000 cores shot noise leaves nothing; half a pixel would be 0.147 rad at 48 periods, 0.012 rad at 4.
        assert!(
            mean(&errors).abs() < 0.001,
            "{periods} periods: mean {} rad",
            mean(&errors)
        );
        // What is left per core are the projector's cores and the neighbours' light: 0.1 core pitches at most.
        let pitch_rad = TAU * periods / 1024.0 * world.projector_bundle().spec().pitch_px();
        assert!(
            deviation(&errors) < 0.1 * pitch_rad + 0.02,
            "{periods} periods: {} rad",
            deviation(&errors)
        );
        assert!(
            (0.2..0.7).contains(&mean(&modulations)),
            "{periods} periods: modulation {}",
            mean(&modulations)
        );
    }
}

#[test]
fn a_pass_lights_what_its_mirrors_reach_and_nothing_else() {
    let mut config = before_a_plane();
    config.optics.dmd_leak_ratio = 0.0;
    let size_px = config.optics.projector_size_px;
    let middle = size_px[0] / 2;
    let mask = |lit: &dyn Fn(usize) -> u8| {
        let brightness = (0..size_px[0] * size_px[1]).map(|at| lit(at % size_px[0]));
        DmdPass::new(size_px, brightness.collect()).expect("one for each mirror")
    };
    config.passes = vec![
        mask(&|column| if column < middle { 255 } else { 0 }),
        mask(&|_| 255),
        mask(&|_| 51),
    ];
    let world = World::new(&config).expect("a valid world");
    // Pattern 1 of the first pass, 2 of the second, 3 of the third.
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let truth = world.truth(&view);
    let [half, all, faint] =
        [1, 2, 3].map(|pattern| at_cores(&world, truth, &frame(&world, &view, pattern, 20_000, 1)));
    // Blur and crosstalk of both bundles carry light over some pitches.
    let reach_px = 8.0 * world.projector_bundle().spec().pitch_px();
    let edge_px = middle as f64 - 0.5;
    let mut seen = [0; 2];
    for (at, t) in truth.iter().enumerate() {
        let from_edge_px = t.projector_px[0] - edge_px;
        if !t.lit || all[at] < 200.0 || from_edge_px.abs() < reach_px {
            continue;
        }
        let is_dark = from_edge_px > 0.0;
        seen[usize::from(is_dark)] += 1;
        let ratio = half[at] / all[at];
        let expected = if is_dark { 0.0 } else { 1.0 };
        assert!((ratio - expected).abs() < 0.1, "{t:?}: {ratio}");
        assert!((faint[at] / all[at] - 0.2).abs() < 0.1, "{t:?}");
    }
    assert!(seen.into_iter().all(|count| count > 20_000), "{seen:?}");
    let wrong = DmdPass::new(size_px, vec![255; 7]);
    assert!(matches!(wrong, Err(WorldError::Buffer { got: 7, .. })));
}

#[test]
fn shivering_within_a_frame_takes_contrast_as_a_gaussian_does_and_moves_nothing() {
    let shiver_um = 30.0;
    let still = World::new(&before_a_plane()).expect("a valid world");
    let shaken = World::new(&WorldConfig {
        shiver_um,
        ..before_a_plane()
    })
    .expect("a valid world");
    let views = [&still, &shaken].map(|world| {
        let view = world.prepare(0.0, 0.0, &PatternSpec::insitu12());
        (world, view.expect("a valid view"))
    });
    let measured = [0, 1].map(|of| {
        let (world, view) = &views[of];
        [(1, 4), (5, 8)].map(|(first, steps)| phases(world, view, first, steps, 20_000))
    });
    let truth = still.truth(&views[0].1);
    let alive = |t: &CoreTruth| t.lit && still.camera_bundle().gains()[t.core as usize] > 0.0;
    for (set, periods) in [4.0, 48.0].into_iter().enumerate() {
        let pairs = measured[0][set].iter().zip(&measured[1][set]);
        let lit: Vec<[(f64, f64); 2]> = truth
            .iter()
            .zip(pairs)
            .filter(|(of, _)| alive(of))
            .map(|(_, (still, shaken))| [*still, *shaken])
            .collect();
        assert!(lit.len() > 80_000, "{}", lit.len());
        let kept = |at: usize| mean(&lit.iter().map(|of| of[at].1).collect::<Vec<_>>());
        // 2252.8 px at 22 mm: so many turns of phase pass a point that moves by the shiver.
        let turns = periods * 1e-3 * shiver_um * 2252.8 / 22.0 / 1024.0;
        let expected = (-0.5 * (TAU * turns).powi(2)).exp();
        let ratio = kept(1) / kept(0);
        assert!(
            (ratio - expected).abs() < 0.01,
            "{periods} periods: {ratio} instead of {expected}"
        );
        let moved: Vec<f64> = lit.iter().map(|[a, b]| wrapped(b.0 - a.0)).collect();
        assert!(mean(&moved).abs() < 0.002, "{periods} periods");
    }
}

#[test]
fn a_head_that_warms_moves_its_cores_along_the_rows() {
    let mut world = World::new(&before_a_plane()).expect("a valid world");
    let shown = |world: &World| {
        let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
        frame(world, &view, 1, 20_000, 1)
    };
    let before = shown(&world);
    let shift_px = 3;
    world
        .shift_cores(f64::from(shift_px))
        .expect("within limits");
    let after = shown(&world);
    let [width, height] = world.size_px();
    // Which displacement along rows and columns fits best, by the squares of what is left in the middle of the image.
    let left = |dx: i64, dy: i64| -> f64 {
        let rows = height / 2 - 100..height / 2 + 100;
        let columns = width / 2 - 100..width / 2 + 100;
        let places = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
        let off = |(row, column): (usize, usize)| {
            let from = (row as i64 - dy) as usize * width + (column as i64 - dx) as usize;
            (f64::from(after[row * width + column]) - f64::from(before[from])).powi(2)
        };
        places.map(off).sum()
    };
    let tried = (-5..=5).flat_map(|dx| (-2..=2).map(move |dy| (dx, dy)));
    let best = tried.min_by(|a, b| left(a.0, a.1).total_cmp(&left(b.0, b.1)));
    assert_eq!(best, Some((i64::from(shift_px), 0)));
    assert!(world.shift_cores(11.0).is_err());
}

#[test]
fn modulation_is_that_of_a_gaussian_blur() {
    let mut config = before_a_plane();
    (config.camera_bundle, config.projector_bundle) = (
        ideal(&config.camera_bundle),
        ideal(&config.projector_bundle),
    );
    for objective in [
        &mut config.optics.camera_objective,
        &mut config.optics.projector_objective,
    ] {
        objective.defocus_sigma_pitch_per_mm = 0.0;
        objective.focus_sigma_pitch = 0.5;
    }
    (
        config.optics.contrast_centre,
        config.optics.contrast_edge,
        config.optics.dmd_leak_ratio,
    ) = (0.6, 0.6, 0.0);
    let world = World::new(&config).expect("a valid world");
    let view = world
        .prepare(0.0, 0.0, &PatternSpec::insitu12())
        .expect("a valid view");
    let measured = phases(&world, &view, 5, 8, 20_000);
    let positions = world.camera_bundle().positions_px();
    let central = |core: u32| {
        let [x, y] = positions[core as usize];
        (x - 959.5).hypot(y - 599.5) < 60.0
    };
    let centre: Vec<f64> = world
        .truth(&view)
        .iter()
        .zip(&measured)
        .filter(|(t, _)| central(t.core))
        .map(|(_, m)| m.1)
        .collect();
    // Blurs in DMD pixels: the projector's; the camera's, foreshortened by cos 30; and the area of a core (0.2 pitch).
    let camera_px =
        0.5 * config.camera_bundle.pitch_px() * (2252.8 / 2530.0) * 30f64.to_radians().cos();
    let pitch_px = config.projector_bundle.pitch_px();
    let variance_px2 = (0.5 * pitch_px).powi(2) + camera_px.powi(2) + (0.2 * pitch_px).powi(2);
    let wave = TAU * 48.0 / 1024.0;
    let before_sensor = 0.6 * (-0.5 * variance_px2 * wave * wave).exp();
    // On the sensor each core's image of 1 px, seen by squares of 3 px, blurs a little more: 1 + 3²/12 px² at most.
    let on_sensor = 2252.8 / 2530.0 * 30f64.to_radians().cos() * wave;
    let least = before_sensor * (-0.5 * (1.0 + 0.75) * on_sensor * on_sensor).exp();
    let got = mean(&centre);
    assert!(
        got < before_sensor * 1.005 && got > least * 0.995,
        "{got} outside {least}..{before_sensor}"
    );
}

/// Reciprocal lattice vectors of a bundle, cycles per px: length `2/√3` per pitch, 30 degrees off the lattice directions.
fn reciprocal(spec: &BundleSpec) -> [[f64; 2]; 3] {
    let length = 2.0 / (3f64.sqrt() * spec.pitch_px());
    [30f64, 90.0, 150.0].map(|deg| {
        let angle = spec.rotation_rad + deg.to_radians();
        [length * angle.cos(), length * angle.sin()]
    })
}

/// Amplitude of a wave in samples at places, relative to their mean.
fn amplitude(
    samples: impl Iterator<Item = ([f64; 2], f64)> + Clone,
    cycles_per_px: [f64; 2],
) -> f64 {
    let (count, sum) = samples
        .clone()
        .fold((0.0, 0.0), |(n, s), (_, value)| (n + 1.0, s + value));
    let level = sum / count;
    // The mean is taken off first: over a window with an edge it would leak into every frequency.
    let (c, s) = samples.fold((0.0, 0.0), |(c, s), ([x, y], value)| {
        let (sin, cos) = (TAU * (cycles_per_px[0] * x + cycles_per_px[1] * y)).sin_cos();
        (c + (value - level) * cos, s + (value - level) * sin)
    });
    2.0 * f64::hypot(c, s) / sum
}

#[test]
fn core_structure_and_moire_are_in_the_raw_frame() {
    let config = before_a_plane();
    let world = World::new(&config).expect("a valid world");
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let shown = frame(&world, &view, 1, 20_000, 7);
    let width = world.size_px()[0];

    // Core structure: the camera bundle's lattice in the pixels of a window in the middle.
    let pixels = || {
        (500..700usize)
            .flat_map(move |y| (860..1060usize).map(move |x| ([x as f64, y as f64], (y, x))))
            .map(|(at, (y, x))| (at, f64::from(shown[y * width + x]) - 100.0))
    };
    let jitter = |ratio: f64| (-0.5 * (TAU * ratio * 2.0 / 3f64.sqrt()).powi(2)).exp();
    for wave in reciprocal(&config.camera_bundle) {
        // A lattice of Gaussian spots: twice the spot's transfer at that frequency, less by the jitter of the cores.
        let squared = wave[0] * wave[0] + wave[1] * wave[1];
        let expected =
            2.0 * (-0.5 * TAU * TAU * squared).exp() * jitter(config.camera_bundle.jitter_ratio);
        let got = amplitude(pixels(), wave);
        assert!(
            (got - expected).abs() < 0.1 * expected,
            "core structure {got}, expected {expected}"
        );
    }

    // Moiré: the projector's lattice, sampled by the camera's cores.
    let truth = world.truth(&view);
    let light = at_cores(&world, truth, &shown);
    let positions = world.camera_bundle().positions_px();
    let gains = world.camera_bundle().gains();
    let central: Vec<([f64; 2], f64)> = truth
        .iter()
        .zip(light)
        .filter(|(t, _)| {
            let [x, y] = positions[t.core as usize];
            gains[t.core as usize] > 0.0 && (x - 959.5).hypot(y - 599.5) < 200.0
        })
        .map(|(t, value)| (t.projector_px, value / f64::from(gains[t.core as usize])))
        .collect();
    let strongest =
        reciprocal(&config.projector_bundle).map(|wave| amplitude(central.iter().copied(), wave));
    // The same waves turned by 0.15 rad belong to nothing in the scene.
    let turned = BundleSpec {
        rotation_rad: config.projector_bundle.rotation_rad + 0.15,
        ..config.projector_bundle.clone()
    };
    let nothing = reciprocal(&turned).map(|wave| amplitude(central.iter().copied(), wave));
    let least = strongest.into_iter().fold(f64::INFINITY, f64::min);
    let background = nothing.into_iter().fold(0.0, f64::max);
    assert!(least > 0.03, "moiré {strongest:?}");
    assert!(
        least > 5.0 * background,
        "moiré {strongest:?} over {nothing:?}"
    );
}

#[test]
fn variance_grows_with_the_mean_by_the_gain_and_starts_at_the_read_noise() {
    let mut config = before_a_plane();
    config.sensor.lamp_noise_ratio = 0.0;
    let world = World::new(&config).expect("a valid world");
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let gain: f64 = 32_400.0 / 4096.0;
    let rows = |of: &[u16]| -> Vec<f64> {
        of[560 * 1920..640 * 1920]
            .iter()
            .map(|&v| f64::from(v))
            .collect()
    };

    // Dark: read noise and rounding (1/12), around the offset.
    let mut dark = vec![0u16; 1920 * 1200];
    world
        .render(&view, 1, 50_000, false, 3, &mut dark)
        .expect("a dark frame");
    let dark = rows(&dark);
    let expected = ((7f64 / gain).powi(2) + 1.0 / 12.0).sqrt();
    assert!((mean(&dark) - 100.0).abs() < 0.02, "{}", mean(&dark));
    assert!(
        (deviation(&dark) - expected).abs() < 0.02 * expected,
        "{} against {expected}",
        deviation(&dark)
    );

    // Photon transfer: two frames of the same scene differ by noise only.
    for exposure_us in [5_000, 20_000] {
        let [a, b] = [1, 2].map(|counter| rows(&frame(&world, &view, 1, exposure_us, counter)));
        // By brightness, because it varies over the frame.
        let mut bins = vec![(0.0, 0.0, 0.0); 40];
        for (p, q) in a.iter().zip(&b) {
            let level = 0.5 * (p + q);
            if let Some(bin) = bins.get_mut((level / 100.0) as usize) {
                *bin = (
                    bin.0 + 1.0,
                    bin.1 + level - 100.0,
                    bin.2 + 0.5 * (p - q).powi(2),
                );
            }
        }
        let mut used = 0;
        // The first bins hold dark pixels, sorted by their own noise: see above.
        for (count, sum, squares) in bins.into_iter().skip(2).filter(|bin| bin.0 > 4000.0) {
            let (level, variance): (f64, f64) = (sum / count, squares / count);
            let expected = level / gain + (7f64 / gain).powi(2) + 1.0 / 12.0;
            // A variance of n values is known to sqrt(2/n): five times that, and a bin's width of signal.
            let tolerance = 5.0 * expected * (2.0 / count).sqrt() + 0.02 * expected;
            assert!(
                (variance - expected).abs() < tolerance,
                "at {level} DN: {variance} against {expected}"
            );
            used += 1;
        }
        assert!(used >= 3, "{exposure_us} us: {used} levels");
    }
}

#[test]
fn full_wells_and_the_converter_stop_the_signal() {
    let world = World::new(&before_a_plane()).expect("a valid world");
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let shown = frame(&world, &view, 1, 2_000_000, 1);
    assert_eq!(shown.iter().max(), Some(&4095));
    let middle = &shown[600 * 1920 + 900..600 * 1920 + 1000];
    let full = middle.iter().filter(|&&dn| dn == 4095).count();
    assert!(
        full > 90,
        "{full} of 100 pixels saturate at 40 times the well"
    );
}

#[test]
fn brightness_is_the_light_budget() {
    let mut config = before_a_plane();
    (config.camera_bundle, config.projector_bundle) = (
        ideal(&config.camera_bundle),
        ideal(&config.projector_bundle),
    );
    config.sensor.prnu_ratio = 0.0;
    let world = World::new(&config).expect("a valid world");
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let shown = frame(&world, &view, 1, 10_000, 1);
    let window: Vec<f64> = (580..620)
        .flat_map(|y| {
            shown[y * 1920 + 940..y * 1920 + 980]
                .iter()
                .map(|&dn| (f64::from(dn) - 100.0) * 32_400.0 / 4096.0)
        })
        .collect();
    // 406 e-/ms at half brightness on reflectance 0.3, tilted by 30 degrees to the projector; leak 0.1 % of full light.
    let expected = 406.0 * 10.0 * 30f64.to_radians().cos() * 1.002;
    assert!(
        (mean(&window) - expected).abs() < 0.02 * expected,
        "{} against {expected}",
        mean(&window)
    );
}

#[test]
fn seeds_decide_everything() {
    let config = before_a_plane();
    let other_run = WorldConfig {
        run_seed: 2,
        ..config.clone()
    };
    let other_head = WorldConfig {
        head_seed: 2,
        ..config.clone()
    };
    let shot = |config: &WorldConfig, counter| {
        let world = World::new(config).expect("a valid world");
        let view = world.prepare(0.1, 0.2, &[even()]).expect("a valid view");
        frame(&world, &view, 1, 10_000, counter)
    };
    let reference = shot(&config, 5);
    let one_thread = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool of one");
    assert!(
        one_thread.install(|| shot(&config, 5)) == reference,
        "the number of threads must not matter"
    );
    for (name, other) in [
        ("counter", shot(&config, 6)),
        ("run", shot(&other_run, 5)),
        ("head", shot(&other_head, 5)),
    ] {
        let changed = other.iter().zip(&reference).filter(|(a, b)| a != b).count();
        assert!(
            changed > reference.len() / 4,
            "another {name} changes the frame, here only {changed} pixels"
        );
    }
}

#[test]
fn what_cannot_be_rendered_is_named() {
    let config = before_a_plane();
    let world = World::new(&config).expect("a valid world");
    let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
    let mut small = vec![0u16; 10];
    assert_eq!(
        world.render(&view, 0, 10, true, 0, &mut small),
        Err(WorldError::Buffer {
            got: 10,
            need: 1920 * 1200
        })
    );
    let mut right = vec![0u16; 1920 * 1200];
    assert_eq!(
        world.render(&view, 2, 10, true, 0, &mut right),
        Err(WorldError::Pattern { got: 2, last: 1 })
    );
    let prepare = |rotation, vertical, patterns: &[PatternSpec]| {
        world.prepare(rotation, vertical, patterns).err()
    };
    assert!(matches!(
        prepare(f64::NAN, 0.0, &[]),
        Some(WorldError::Parameter {
            name: "rotation_rad",
            ..
        })
    ));
    assert!(matches!(
        prepare(0.0, f64::INFINITY, &[]),
        Some(WorldError::Parameter {
            name: "vertical_mm",
            ..
        })
    ));
    let nan = PatternSpec {
        periods: f64::NAN,
        step: 0,
        steps: 4,
    };
    assert!(matches!(
        prepare(0.0, 0.0, &[nan]),
        Some(WorldError::Parameter {
            name: "periods",
            ..
        })
    ));
    let five = PatternSpec::sequence(&[(1.0, 3), (2.0, 3), (3.0, 3), (4.0, 3), (5.0, 3)]);
    assert_eq!(
        prepare(0.0, 0.0, &five),
        Some(WorldError::Frequencies { got: 5, max: 4 })
    );
    let cores = WorldConfig {
        camera_bundle: BundleSpec {
            cores: 3,
            ..config.camera_bundle.clone()
        },
        ..config
    };
    assert!(matches!(
        World::new(&cores).err(),
        Some(WorldError::Cores { got: 3, .. })
    ));
}

/// The layer is seen, the metal below it is what is worn.
#[test]
fn a_film_is_seen_before_the_metal_and_hides_no_truth() {
    let film_um = 15.0;
    let seen = |config: &WorldConfig, rotation_rad: f64, vertical_mm: f64| {
        let world = World::new(config).expect("a valid world");
        let view = world
            .prepare(rotation_rad, vertical_mm, &[even()])
            .expect("a valid view");
        world.truth(&view).to_vec()
    };
    // Before a plane that faces the head, the layer is as much nearer as it is thick, however obliquely a core looks.
    let bare = before_a_plane();
    let filmed = WorldConfig {
        film_um,
        ..bare.clone()
    };
    let [without, with] = [&bare, &filmed].map(|config| seen(config, 0.0, 0.0));
    assert!(with.len() > 80_000 && with.len() == without.len());
    let nearer_um: Vec<f64> = without
        .iter()
        .zip(&with)
        .map(|(a, b)| 1e3 * (a.point_tool_mm[0] - b.point_tool_mm[0]))
        .collect();
    let average_um = mean(&nearer_um);
    // A field of 10 mm is no more than a few of the longer waves.
    assert!((average_um - film_um).abs() < 0.2 * film_um, "{average_um}");
    assert!(nearer_um.iter().all(|um| (0.0..2.0 * film_um).contains(um)));

    let mut worn = demo::world_config().expect("the demo");
    worn.wear = vec!["40:left:50:half".parse().expect("wear")];
    let filmed = WorldConfig {
        film_um,
        ..worn.clone()
    };
    let rotation_rad = -worn.gear.tooth_centre_rad(40);
    let [without, with] = [&worn, &filmed].map(|config| seen(config, rotation_rad, 33.0));
    let mut compared = 0;
    for (a, b) in without.iter().zip(&with) {
        assert_eq!((a.core, a.flank, a.wear_mm), (b.core, b.flank, b.wear_mm));
        compared += usize::from(a.wear_mm > 0.0 && a.point_tool_mm != b.point_tool_mm);
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn bent_bundles_pass_on_the_stated_share_of_the_light() {
    let mut world = World::new(&before_a_plane()).expect("a valid world");
    let light = |world: &World| {
        let view = world.prepare(0.0, 0.0, &[even()]).expect("a valid view");
        let counts = frame(world, &view, 1, 10_000, 1);
        // Without light every count is 100 on average.
        counts
            .iter()
            .map(|&count| f64::from(count) - 100.0)
            .sum::<f64>()
    };
    let whole = light(&world);
    world.dim(0.7).expect("a share");
    let ratio = light(&world) / whole;
    // Cores answer linearly here, and millions of electrons are counted.
    assert!((ratio - 0.7).abs() < 0.005, "{ratio}");
    assert!(world.dim(1.1).is_err() && world.dim(f64::NAN).is_err());
}
