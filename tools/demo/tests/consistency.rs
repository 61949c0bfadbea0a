//! The test whether a cell's frames follow one fringe, on a tile before the bench's head: calm, and shaken.

use std::sync::Arc;

use flankscope_bench::demo as die;
use flankscope_bench::world::{PatternSpec, World, WorldConfig};
use flankscope_demo as demo;
use flankscope_profilometry::decode::ConsistencyOptions;
use flankscope_profilometry::{
    Accumulator, DecodeOptions, Decoder, FrameKind, FrameView, HeadModel, PatternSet,
};

const EXPOSURES_US: [u32; 2] = [10_000, 20_000];

fn head() -> HeadModel {
    let map = demo::core_map().expect("cores");
    HeadModel {
        core_map: Some(Arc::new(map)),
        ..demo::head()
    }
}

fn decoder(head: &HeadModel, gate: ConsistencyOptions) -> Decoder {
    let options = DecodeOptions {
        consistency: Some(gate),
        ..DecodeOptions::for_head(head)
    };
    let patterns = PatternSet::named("insitu12").expect("a built-in set");
    Decoder::new(head, &patterns, &EXPOSURES_US, options).expect("a decoder")
}

/// Every frame of a view of a tile in focus.
fn capture(decoder: &Decoder, change: impl FnOnce(&mut WorldConfig)) -> Accumulator {
    let mut config = WorldConfig::new(die::tile(41.5, [0.0; 2]), die::gear());
    change(&mut config);
    let world = World::new(&config).expect("a world");
    let view = world
        .prepare(0.0, 0.0, &PatternSpec::insitu12())
        .expect("a view");
    let mut accumulator = decoder.begin();
    let [width, height] = world.size_px();
    let mut pixels = vec![0; width * height];
    let order: Vec<FrameKind> = decoder.capture_order().collect();
    for (number, kind) in order.into_iter().enumerate() {
        let (pattern, exposure) = match kind {
            FrameKind::Dark => (0, 0),
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => (1 + 4 * set as u16 + step as u16, exposure),
            FrameKind::Code { .. } => unreachable!("the bench shows no code"),
        };
        let exposure_us = EXPOSURES_US[exposure];
        world
            .render(
                &view,
                pattern,
                exposure_us,
                true,
                number as u32,
                &mut pixels,
            )
            .expect("a frame");
        accumulator
            .add(FrameView::packed(&pixels, width, height), kind)
            .expect("frames in order");
    }
    accumulator
}

/// Probability that noise exceeds a chi-square of even degrees of freedom.
fn tail(chi_square: f64, freedom: usize) -> f64 {
    let half = 0.5 * chi_square;
    let (mut term, mut sum) = (1.0, 0.0);
    for k in 0..freedom / 2 {
        sum += term;
        term *= half / (k as f64 + 1.0);
    }
    (-half).exp() * sum
}

#[test]
fn calm_frames_are_as_consistent_as_their_noise_and_shaken_ones_are_not() {
    let head = head();
    // A steady lamp and straight fibres leave noise alone: every p-value is as likely as any other.
    let pure = decoder(
        &head,
        ConsistencyOptions {
            response_ratio: 0.0,
            ..ConsistencyOptions::INSTRUMENT
        },
    );
    let sums = capture(&pure, |config| {
        config.sensor.lamp_noise_ratio = 0.0;
        config.sensor.core_exponent_spread = 0.0;
    });
    let twelve = 2 * (1 + 5);
    let mut p: Vec<f64> = pure
        .consistency(&sums)
        .expect("a whole view")
        .into_iter()
        .filter(|&(_, freedom)| freedom == twelve)
        .map(|(chi_square, freedom)| tail(f64::from(chi_square), freedom))
        .collect();
    assert!(p.len() > 60_000);
    // Neighbours share their pixels' noise: every fiftieth is on its own.
    p = p.into_iter().step_by(50).collect();
    p.sort_by(f64::total_cmp);
    let count = p.len() as f64;
    let distance = p
        .iter()
        .enumerate()
        .map(|(i, &p)| (p - (i as f64 + 0.5) / count).abs())
        .fold(0.0, f64::max);
    let limit = 1.63 / count.sqrt();
    eprintln!("Kolmogorov-Smirnov distance {distance:.4} of {count} cores, 1 % limit {limit:.4}");
    assert!(distance < limit);

    // The instrument as it is loses hardly a core to lamp and fibres. At the brightest cores a micrometre of vibration moves a
    // frame by twice its noise, two by four times: a check refuses views that lose a tenth.
    let gate = decoder(&head, ConsistencyOptions::INSTRUMENT);
    let lost = |vibration_um: f64| {
        let sums = capture(&gate, |config| config.vibration_um = vibration_um);
        let decoded = gate.finish(&sums).expect("a whole view");
        let lost = decoded.rejected.inconsistent as f64;
        let ratio = lost / (lost + decoded.cloud.len() as f64);
        eprintln!(
            "vibration {vibration_um} um: {:.2} % inconsistent",
            100.0 * ratio
        );
        ratio
    };
    assert!(lost(0.0) < 0.01);
    assert!(lost(1.0) > 0.1);
    assert!(lost(2.0) > 0.5);
}
