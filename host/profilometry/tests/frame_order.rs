//! Frames in another order than their plan's are noticed, those in order are not, however they are lit.

use std::f64::consts::TAU;

use flankscope_profilometry::frame::FrameKind;
use flankscope_profilometry::frame_order::{self, FrameOrderError};
use flankscope_profilometry::gray::GrayCode;
use flankscope_profilometry::io::images::GreyImage;
use flankscope_profilometry::pattern::{FringeSet, PatternSet};

const SIZE: [usize; 2] = [240, 160];

fn patterns(sets: &[(f64, u32)]) -> PatternSet {
    let set = |&(periods, steps): &(f64, u32)| FringeSet {
        periods,
        steps,
        phase_origin_px: 0.0,
    };
    PatternSet::new("order", sets.iter().map(set).collect()).unwrap()
}

fn check(patterns: &PatternSet, frames: &[(FrameKind, GreyImage)]) -> Result<(), FrameOrderError> {
    let views: Vec<_> = frames.iter().map(|(k, of)| (*k, of.view())).collect();
    frame_order::check(patterns, &views)
}

/// A ball before a wall, seen slanted, in a room with some light; `gamma` bends the projector's response.
fn views(patterns: &PatternSet, dark: bool, gamma: f64) -> Vec<(FrameKind, GreyImage)> {
    let column = |x: f64, y: f64| {
        let r2 = (x - 120.0).powi(2) + (y - 80.0).powi(2);
        let ball = (2500.0 - r2).max(0.0).sqrt();
        0.1 + 0.8 * (x + 0.3 * y + 0.3 * ball) / 300.0
    };
    let image = |light: &dyn Fn(f64) -> f64| GreyImage {
        pixels: (0..SIZE[0] * SIZE[1])
            .map(|index| {
                let (x, y) = ((index % SIZE[0]) as f64, (index / SIZE[0]) as f64);
                let albedo = if x > 200.0 {
                    0.0
                } else {
                    0.5 + 0.4 * (x / 31.0).sin()
                };
                let grain = (index * 7919 % 13) as f64 / 6.5 - 1.0;
                (10.0 + 220.0 * albedo * light(column(x, y)).powf(gamma) + grain).round() as u16
            })
            .collect(),
        width: SIZE[0],
        height: SIZE[1],
        bits: 8,
        stated_largest_dn: None,
    };
    let mut views = Vec::new();
    if dark {
        views.push((FrameKind::Dark, image(&|_| 0.0)));
    }
    for picture in patterns.pictures() {
        let kind = FrameKind::from_picture(picture, 0);
        let light = |at: f64| match kind {
            FrameKind::Fringe { set, step, .. } => {
                let FringeSet { periods, steps, .. } = patterns.sets[set];
                let shift = f64::from(step) / f64::from(steps);
                0.5 + 0.5 * (TAU * (periods * at + shift)).cos()
            }
            FrameKind::Code { bit, .. } => {
                let code = patterns.code.unwrap();
                f64::from(u8::from(code.is_lit(bit, at, 1.0)))
            }
            FrameKind::Dark => 0.0,
        };
        views.push((kind, image(&light)));
    }
    views
}

/// The frames of `order`, each as what the plan takes it for.
fn shuffled(views: &[(FrameKind, GreyImage)], order: &[usize]) -> Vec<(FrameKind, GreyImage)> {
    let taken = order.iter().map(|&at| views[at].1.clone());
    views.iter().map(|(kind, _)| *kind).zip(taken).collect()
}

#[test]
fn frames_in_order_are_let_through() {
    for sets in [
        &[(1.0, 3), (16.0, 3)][..],
        &[(1.0, 4), (8.0, 4), (32.0, 12)],
        &[(32.0, 12)],
        &[(36.0, 4), (39.0, 4), (48.0, 4)],
    ] {
        for (dark, gamma) in [(false, 1.0), (true, 1.0), (true, 2.2)] {
            let patterns = patterns(sets);
            let found = check(&patterns, &views(&patterns, dark, gamma));
            assert_eq!(found, Ok(()), "{sets:?} {gamma}");
        }
    }
    // Nothing but grain says nothing.
    let patterns = patterns(&[(4.0, 12)]);
    let mut views = views(&patterns, false, 1.0);
    for (at, (_, image)) in views.iter_mut().enumerate() {
        for (index, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = (2 + (index * 31 + at * 17) % 3) as u16;
        }
    }
    assert_eq!(check(&patterns, &views), Ok(()));
}

#[test]
fn other_orders_are_named() {
    let two = patterns(&[(1.0, 3), (16.0, 3)]);
    let seen = views(&two, false, 1.0);
    // Fine fringes first.
    let found = check(&two, &shuffled(&seen, &[3, 4, 5, 0, 1, 2]));
    assert!(
        matches!(found, Err(FrameOrderError::Sets { .. })),
        "{found:?}"
    );
    // Step by step instead of set by set: three steps follow any fringe, four do not.
    let two = patterns(&[(1.0, 4), (16.0, 4)]);
    let seen = views(&two, false, 1.0);
    for order in [[0, 4, 1, 5, 2, 6, 3, 7], [4, 0, 5, 1, 6, 2, 7, 3]] {
        let found = check(&two, &shuffled(&seen, &order));
        assert!(
            matches!(found, Err(FrameOrderError::Steps { .. })),
            "{order:?}: {found:?}"
        );
    }
    let one = patterns(&[(32.0, 12)]);
    let seen = views(&one, true, 1.0);
    let right: Vec<usize> = (0..13).collect();
    // frame_1, frame_10, frame_11, frame_12, frame_2 ...; every other one first; the dark frame last.
    let by_name = [0, 1, 10, 11, 12, 2, 3, 4, 5, 6, 7, 8, 9];
    let halves = [0, 1, 3, 5, 7, 9, 11, 2, 4, 6, 8, 10, 12];
    for order in [by_name, halves] {
        let found = check(&one, &shuffled(&seen, &order));
        assert!(
            matches!(found, Err(FrameOrderError::Steps { .. })),
            "{found:?}"
        );
    }
    assert_eq!(check(&one, &shuffled(&seen, &right)), Ok(()));
    let dark_last = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 0];
    let found = check(&one, &shuffled(&seen, &dark_last));
    assert!(found.is_err(), "{found:?}");
    let exchanged = [7, 1, 2, 3, 4, 5, 6, 0, 8, 9, 10, 11, 12];
    let found = check(&one, &shuffled(&seen, &exchanged));
    assert!(
        matches!(found, Err(FrameOrderError::Dark { .. })),
        "{found:?}"
    );
    let coded = patterns(&[(32.0, 4)]);
    let code = GrayCode {
        bits: 5,
        stripes: 32.0,
        origin_px: 0.0,
        complement: false,
    };
    let coded = coded.with_code(Some(code)).unwrap();
    let seen = views(&coded, false, 1.0);
    assert_eq!(check(&coded, &seen), Ok(()));
    let found = check(&coded, &shuffled(&seen, &[0, 1, 2, 3, 8, 7, 6, 5, 4]));
    assert!(
        matches!(found, Err(FrameOrderError::Code { .. })),
        "{found:?}"
    );
}
