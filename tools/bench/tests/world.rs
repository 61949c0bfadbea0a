//! The simulated world against closed forms: geometry, core structure and moiré, noise, and the truth.

use flankscope_bench::world::{BundleSpec, CoreTruth, PatternSpec, ViewState, World, WorldConfig};
use flankscope_gear_cad::Mesh;
use std::f64::consts::TAU;

/// A plane across the view at 41.5 mm, facing the head, at height 0.
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

/// The demo head before a plane: undistorted, evenly bright, without the individual traits that a test does not ask for.
fn plain_head() -> WorldConfig {
    let mut config = WorldConfig::new(plane(), flankscope_bench::demo::gear());
    config.optics.camera.distortion = [0.0; 5];
    config.optics.projector.distortion = [0.0; 5];
    config.surface.roughness_ratio = 0.0;
    config.surface.gloss_ratio = 0.0;
    config.sensor.core_exponent_spread = 0.0;
    config
}

fn frame(
    world: &World,
    view: &ViewState,
    pattern: u16,
    exposure_us: u32,
    counter: u32,
) -> Vec<f64> {
    let [width, height] = world.size_px();
    let mut counts = vec![0u16; width * height];
    world
        .render(view, pattern, exposure_us, true, counter, &mut counts)
        .expect("a valid frame");
    counts.into_iter().map(f64::from).collect()
}

/// Counts at the pixel nearest to each core of the truth, offset removed.
fn at_cores(world: &World, truth: &[CoreTruth], frame: &[f64]) -> Vec<f64> {
    let width = world.size_px()[0];
    let positions = world.camera_bundle().positions_px();
    let near = |t: &CoreTruth| {
        let [x, y] = positions[t.core as usize].map(|v| v.round() as usize);
        // Three by three pixels: most of one core's light.
        let window =
            (y - 1..=y + 1).flat_map(|row| (x - 1..=x + 1).map(move |column| row * width + column));
        window.map(|i| frame[i] - 100.0).sum::<f64>() / 9.0
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

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
    (sum / count).sqrt()
}

#[test]
fn the_phase_on_a_plane_is_that_of_similar_triangles() {
    let config = plain_head();
    let world = World::new(&config).expect("a valid world");
    let view = world
        .prepare(0.0, 0.0, &PatternSpec::insitu12())
        .expect("a valid view");
    let truth = world.truth(&view);
    assert!(truth.len() > 99_900, "the plane fills the field");
    let positions = world.camera_bundle().positions_px();
    let (sin30, cos30) = 30f64.to_radians().sin_cos();
    for (first, steps, periods, floor_rad) in [(1, 4, 4.0, 0.02), (5, 8, 48.0, 0.05)] {
        let measured = phases(&world, &view, first, steps, 20_000);
        let mut errors = Vec::new();
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
            assert!(
                *modulation > 0.1,
                "modulation {modulation} at {:?}",
                positions[t.core as usize]
            );
        }
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let spread = rms(errors.iter().map(|e| e - mean));
        println!(
            "{periods} periods: mean {mean:.5} rad, spread {spread:.4} rad over {} cores",
            errors.len()
        );
        // The mean of 80 000 cores: shot noise leaves nothing, a wrong half pixel would be 0.15 rad at 48 periods.
        assert!(mean.abs() < 0.003, "{periods} periods: mean {mean}");
        // What is left per core is the ripple of the projector's cores.
        assert!(
            spread < 2.0 * floor_rad * 48.0 / 48.0 + 0.05,
            "{periods} periods: spread {spread}"
        );
    }
}

#[test]
fn ripple_report() {
    let config = flankscope_bench::demo::world_config().expect("the demo die");
    let world = World::new(&config).expect("a valid world");
    let view = world
        .prepare(
            -config.gear.tooth_centre_rad(12),
            33.0,
            &PatternSpec::insitu12(),
        )
        .expect("valid");
    let truth = world.truth(&view);
    let measured = phases(&world, &view, 5, 8, 50_000);
    for flank in [true, false] {
        let of: Vec<(f64, f64)> = truth
            .iter()
            .zip(&measured)
            .filter(|(t, _)| {
                t.lit
                    && t.flank.is_some() == flank
                    && world.camera_bundle().gains()[t.core as usize] > 0.3
            })
            .map(|(t, (p, m))| {
                (
                    wrapped(p - TAU * 48.0 * (t.projector_px[0] + 0.5) / 1024.0),
                    *m,
                )
            })
            .collect();
        let spread = rms(of.iter().map(|e| e.0));
        let mean = of.iter().map(|e| e.0).sum::<f64>() / of.len() as f64;
        let modulation = of.iter().map(|e| e.1).sum::<f64>() / of.len() as f64;
        println!(
            "flank {flank}: mean {mean:.4} rms {spread:.4} rad = {:.2} um z, modulation {modulation:.3}",
            spread * 208.0 / std::f64::consts::PI
        );
    }
}

fn _unused(_: BundleSpec) {}
