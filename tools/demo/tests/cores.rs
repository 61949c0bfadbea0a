//! Cores found in a flat field, and what decoding core by core is worth, on tiles before the bench's head.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use flankscope_bench::demo as die;
use flankscope_bench::world::{Bundle, PatternSpec, World, WorldConfig};
use flankscope_demo as demo;
use flankscope_profilometry::calibrate::cores::{self, FindError, FlatField};
use flankscope_profilometry::decode::GridKind;
use flankscope_profilometry::head::CoreMap;
use flankscope_profilometry::{
    Cloud, DecodeOptions, Decoder, FrameKind, FrameView, HeadModel, PatternSet,
};

static MAP: LazyLock<Arc<CoreMap>> = LazyLock::new(|| Arc::new(demo::core_map().expect("cores")));

fn head() -> HeadModel {
    HeadModel {
        core_map: Some(Arc::clone(&MAP)),
        ..demo::head()
    }
}

/// Every frame of one view.
fn capture(world: &World, decoder: &Decoder, first_frame: u32) -> Cloud {
    let patterns = PatternSpec::insitu12();
    let view = world.prepare(0.0, 0.0, &patterns).expect("a view");
    let mut accumulator = decoder.begin();
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let order: Vec<FrameKind> = decoder.capture_order().collect();
    for (number, kind) in order.into_iter().enumerate() {
        let (pattern, exposure_us) = match kind {
            FrameKind::Dark => (0, 10_000),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => (1 + 4 * set as u16 + step as u16, [10_000, 40_000][exposure]),
            FrameKind::Code { .. } => unreachable!("the bench shows no code"),
        };
        let counter = first_frame + number as u32;
        world
            .render(&view, pattern, exposure_us, true, counter, &mut pixels)
            .expect("a frame");
        accumulator
            .add(FrameView::packed(&pixels, width, height), kind)
            .expect("frames in order");
    }
    decoder.finish(&accumulator).expect("a complete view").cloud
}

fn decoder(head: &HeadModel, grid: GridKind, binning: usize) -> Decoder {
    let options = DecodeOptions {
        grid,
        binning,
        ..DecodeOptions::for_head(head)
    };
    let patterns = PatternSet::named("insitu12").expect("a built-in set");
    Decoder::new(head, &patterns, &[10_000, 40_000], options).expect("a decoder")
}

/// Distances from the tile, µm. The camera looks along +x from x = 19.5 mm.
fn heights_um(cloud: &Cloud, radius_mm: f64, field_mm: f64) -> Vec<f64> {
    cloud
        .points_mm
        .iter()
        .filter(|p| p[0].hypot(p[1]) < field_mm)
        .map(|p| (p[2] - (radius_mm - 19.5)) * 1e3)
        .collect()
}

fn mean_and_rms(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (mean, (squares / values.len() as f64).sqrt())
}

/// The finder against the bundle's own list, which it never sees.
#[test]
fn every_lit_core_is_found_where_it_is() {
    let map = &*MAP;
    let config = WorldConfig::new(die::tile(41.5, [0.0; 2]), die::gear());
    let bundle = Bundle::camera(&config.camera_bundle, config.head_seed).expect("the bundle");
    let pitch = config.camera_bundle.pitch_px();
    let rows = config.optics.camera_size_px[1];
    let mut by_row: Vec<Vec<[f64; 2]>> = vec![Vec::new(); rows];
    for &at in &map.positions_px {
        by_row[at[1] as usize].push(at);
    }
    // The DMD is flatter than its bundle: above and below this no light arrives. Blur reaches over the edge.
    let half_lit_px = 384.0 / 512.0 * 575.0 - 5.0 * pitch;
    let inside = |&[x, y]: &[f64; 2]| {
        (x - 959.5).hypot(y - 599.5) < 575.0 - 2.0 * pitch && (y - 599.5).abs() < half_lit_px
    };
    let (mut lit, mut found, mut squares) = (0u32, 0u32, 0.0);
    for (at, &gain) in bundle.positions_px().iter().zip(bundle.gains()) {
        if gain == 0.0 || !inside(at) {
            continue;
        }
        lit += 1;
        let near = by_row[at[1] as usize - 1..at[1] as usize + 2]
            .iter()
            .flatten();
        let nearest = near
            .map(|p| (p[0] - at[0]).hypot(p[1] - at[1]))
            .fold(f64::INFINITY, f64::min);
        if nearest < 0.5 * pitch {
            found += 1;
            squares += nearest * nearest;
        }
    }
    let missed = f64::from(lit - found) / f64::from(lit);
    let rms_px = (squares / f64::from(found) / 2.0).sqrt();
    eprintln!("{found} of {lit} cores, centres to {rms_px:.4} px rms per axis");
    // Dim cores between bright ones may be missed: a point fewer, no wrong one.
    assert!(missed < 0.01, "{missed} of the lit cores are missed");
    let within = map.positions_px.iter().filter(|at| inside(at)).count();
    assert!(
        within as f64 <= 1.001 * f64::from(lit),
        "{within} found of {lit}"
    );
    // What the uncertainty budget grants a centre: 0.05 pitches.
    assert!(rms_px < 0.05 * pitch, "{rms_px} px rms");
    assert!((map.core_sigma_px / config.sensor.core_sigma_px - 1.0).abs() < 0.02);
    assert!((map.pitch_px().expect("many cores") / pitch - 1.0).abs() < 0.02);
}

/// On a plane the pixels of one core all show its one phase: a staircase. Core by core it is gone.
///
/// The projector is blurred by 0.6 of its cores' pitch, so that its own cores (a part of the light, not of the camera)
/// leave less than a micrometre.
#[test]
fn the_staircase_disappears_core_by_core() {
    let head = head();
    let grids = [
        (GridKind::Pixel, 1),
        (GridKind::Pixel, 3),
        (GridKind::Core, 1),
    ];
    let decoders = grids.map(|(grid, binning)| decoder(&head, grid, binning));
    for radius_mm in [41.5, 42.3] {
        let mut config = WorldConfig::new(die::tile(radius_mm, [0.0; 2]), die::gear());
        config.optics.projector_objective.focus_sigma_pitch = 0.6;
        let world = World::new(&config).expect("a world");
        let [pixels, blocks, cores] = decoders.each_ref().map(|decoder| {
            let heights = heights_um(&capture(&world, decoder, 0), radius_mm, 4.5);
            let (mean, rms) = mean_and_rms(&heights);
            eprintln!(
                "tile at {radius_mm} mm: {} points, mean {mean:.3} um, {rms:.2} um rms",
                heights.len()
            );
            assert!(heights.len() > 60_000 && mean.abs() < 0.2, "{mean} um");
            rms
        });
        // A centre known to 0.05 pitches leaves 2.6 um of depth at 30 degrees and 30 um pitch.
        assert!(cores < 2.6, "{cores} um rms core by core");
        assert!(pixels > 2.5 * cores, "{pixels} um rms pixel by pixel");
        assert!(blocks > 1.5 * cores, "{blocks} um rms in blocks of 3 x 3");
    }
}

/// Repeated captures of one plane scatter as predicted: per core the spread over its predicted uncertainty.
#[test]
fn points_scatter_as_predicted() {
    const CAPTURES: u32 = 12;
    let head = head();
    let decoder = decoder(&head, GridKind::Core, 1);
    let config = WorldConfig::new(die::tile(41.5, [0.0; 2]), die::gear());
    let world = World::new(&config).expect("a world");
    let mut sums: HashMap<[u16; 2], [f64; 4]> = HashMap::new();
    for number in 0..CAPTURES {
        let cloud = capture(&world, &decoder, 1_000 * number);
        for ((point, &sigma), &cell) in cloud
            .points_mm
            .iter()
            .zip(&cloud.sigma_z_mm)
            .zip(&cloud.cell)
        {
            let offset = (point[2] - 22.0) * 1e3;
            let variance = (f64::from(sigma) * 1e3).powi(2);
            let sum = sums.entry(cell).or_default();
            for (sum, term) in sum.iter_mut().zip([1.0, offset, offset * offset, variance]) {
                *sum += term;
            }
        }
    }
    let ratios: Vec<f64> = sums
        .values()
        .filter(|sum| sum[0] == f64::from(CAPTURES))
        .map(|[n, sum, squares, variance]| (squares - sum * sum / n) / (n - 1.0) / (variance / n))
        .collect();
    let cores = ratios.len();
    let ratio = (ratios.iter().sum::<f64>() / cores as f64).sqrt();
    eprintln!("{cores} cores, {CAPTURES} captures: spread over prediction {ratio:.3}");
    assert!(cores > 70_000);
    assert!((0.9..1.1).contains(&ratio), "{ratio}");
}

#[test]
fn flat_fields_that_show_no_cores_are_refused() {
    let mut flat = FlatField::new(64, 48, 100.0, 3_800);
    assert_eq!(cores::find(&flat), Err(FindError::NoFrame));
    let dark = vec![101u16; 64 * 48];
    flat.add(FrameView::packed(&dark, 64, 48))
        .expect("the size");
    assert!(matches!(cores::find(&flat), Err(FindError::Dim { got_dn, .. }) if got_dn == 1.0));
    let even = vec![2_000u16; 64 * 48];
    let mut flat = FlatField::new(64, 48, 100.0, 3_800);
    flat.add(FrameView::packed(&even, 64, 48))
        .expect("the size");
    assert!(matches!(
        cores::find(&flat),
        Err(FindError::Few { got: 0, .. })
    ));
    let mut bright = even.clone();
    bright[7] = 3_801;
    flat.add(FrameView::packed(&bright, 64, 48))
        .expect("the size");
    assert!(matches!(
        cores::find(&flat),
        Err(FindError::Saturated { got: 1, .. })
    ));
    // A chessboard: cores at twice the pixel pitch cannot be told apart.
    let chess: Vec<u16> = (0..64 * 48)
        .map(|i| {
            if (i % 64) % 2 == 0 && (i / 64) % 2 == 0 {
                2_000
            } else {
                500
            }
        })
        .collect();
    let mut flat = FlatField::new(64, 48, 100.0, 3_800);
    flat.add(FrameView::packed(&chess, 64, 48))
        .expect("the size");
    assert!(matches!(cores::find(&flat), Err(FindError::Pitch { .. })));
    let wrong = flat.add(FrameView::packed(&chess[..64 * 40], 64, 40));
    assert!(wrong.is_err(), "another size");
}
