//! Sums as bytes and back: the same points, bit for bit.

mod bench_scene;

use bench_scene::*;
use flankscope_profilometry::{DecodeOptions, Decoder, FrameView, PatternSet, PhasorsError};

const LIGHT: Light = Light {
    mean_e: 8000.0,
    contrast: 0.5,
    noise_seed: Some(7),
};

fn decoder(patterns: &str, binning: usize) -> Decoder {
    let head = head();
    let options = DecodeOptions {
        binning,
        ..DecodeOptions::for_head(&head)
    };
    Decoder::new(
        &head,
        &PatternSet::named(patterns).unwrap(),
        &[1, 2],
        options,
    )
    .unwrap()
}

#[test]
fn points_come_back_bit_for_bit() {
    let decoder = decoder("insitu12", 3);
    let head = head();
    let columns = columns(&head, plane([0.1, 0.1, 1.0], 22.0));
    let patterns = PatternSet::named("insitu12").unwrap();
    // The longer exposure saturates here and there.
    let frames = capture(&head, &decoder, &patterns, &columns, &[1.0, 3.0], &LIGHT);
    let (width, height) = (
        head.camera.width_px as usize,
        head.camera.height_px as usize,
    );
    let mut captured = decoder.begin();
    for (kind, pixels) in &frames {
        captured
            .add(FrameView::packed(pixels, width, height), *kind)
            .unwrap();
    }
    let bytes = captured.to_bytes();
    assert_eq!(bytes.len(), captured.byte_count());
    let mut restored = decoder.begin();
    restored.restore(&bytes).unwrap();
    assert_eq!(restored.to_bytes(), bytes);
    let (before, after) = (
        decoder.finish(&captured).unwrap(),
        decoder.finish(&restored).unwrap(),
    );
    assert!(before.cloud.len() > 1000, "there is something to compare");
    let bits = |points: &[[f64; 3]]| -> Vec<u64> {
        points.iter().flatten().map(|x| x.to_bits()).collect()
    };
    assert_eq!(bits(&before.cloud.points_mm), bits(&after.cloud.points_mm));
    let sigma = |sigma: &[f32]| -> Vec<u32> { sigma.iter().map(|s| s.to_bits()).collect() };
    assert_eq!(
        sigma(&before.cloud.sigma_z_mm),
        sigma(&after.cloud.sigma_z_mm)
    );
    // An accumulator that was restored can be used again.
    restored.reset();
    for (kind, pixels) in &frames {
        restored
            .add(FrameView::packed(pixels, width, height), *kind)
            .unwrap();
    }
    assert_eq!(restored.to_bytes(), bytes);
}

#[test]
fn bytes_of_something_else_are_refused_by_name_and_change_nothing() {
    let decoder_3 = decoder("insitu12", 3);
    let mut sums = decoder_3.begin();
    let bytes = sums.to_bytes();
    let other = |patterns, binning| decoder(patterns, binning).begin().to_bytes();
    for foreign in [other("insitu12", 4), other("scan16", 3)] {
        let error = sums.restore(&foreign).unwrap_err();
        assert!(matches!(error, PhasorsError::Layout { .. }), "{error}");
    }
    for length in [0, 7, 15, 16, bytes.len() - 1] {
        assert!(sums.restore(&bytes[..length]).is_err(), "{length} bytes");
    }
    let long = [&bytes[..], &[0]].concat();
    assert!(matches!(
        sums.restore(&long),
        Err(PhasorsError::Length { .. })
    ));
    // A layout to come, and that of earlier releases.
    for magic in [b"PHASORS9", b"PHASORS2"] {
        let error = sums.restore(&[magic, &bytes[8..]].concat()).unwrap_err();
        assert!(matches!(error, PhasorsError::Magic { .. }), "{error}");
        let named = std::str::from_utf8(magic).unwrap();
        assert!(error.to_string().contains(named), "{error}");
    }
    assert_eq!(sums.received(), 0);
    sums.restore(&bytes).unwrap();
    assert_eq!(sums.received(), sums.planned());
}
