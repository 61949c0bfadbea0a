//! Sums of frames: exposures, saturation, order, content.

mod bench_scene;

use bench_scene::*;
use flankscope_profilometry::cells::{CellGrid, Grid};
use flankscope_profilometry::frame::{FrameError, FrameKind, FrameLevel, FrameView};
use flankscope_profilometry::head::ImageCircle;
use flankscope_profilometry::pattern::PatternSet;
use flankscope_profilometry::{Accumulator, DecodeError, DecodeOptions, Decoder};

const LIGHT: Light = Light {
    mean_e: 8000.0,
    contrast: 0.5,
    noise_seed: Some(5),
};

fn decoder(exposures: usize, binning: usize, circle: Option<ImageCircle>) -> Decoder {
    let head = flankscope_profilometry::HeadModel {
        image_circle: circle,
        ..head()
    };
    let exposures_us: Vec<u32> = (1..=exposures as u32).collect();
    let options = DecodeOptions {
        binning,
        ..DecodeOptions::for_head(&head)
    };
    Decoder::new(
        &head,
        &PatternSet::named("insitu12").unwrap(),
        &exposures_us,
        options,
    )
    .unwrap()
}

fn frames(decoder: &Decoder, gains: &[f64]) -> Vec<(FrameKind, Vec<u16>)> {
    let head = head();
    let columns = columns(&head, plane([0.1, 0.1, 1.0], 22.0));
    capture(
        &head,
        decoder,
        &PatternSet::named("insitu12").unwrap(),
        &columns,
        gains,
        &LIGHT,
    )
}

fn blocks(decoder: &Decoder) -> &CellGrid {
    match decoder.grid() {
        Grid::Blocks(grid) => grid,
        Grid::Cores(_) => panic!("this head has no core map"),
    }
}

/// The phasors, by definition and in double precision.
#[test]
fn phasors_are_the_sums_of_their_definition() {
    let circle = ImageCircle {
        centre_px: [70.0, 50.0],
        radius_px: 45.0,
    };
    for (binning, circle) in [
        (1, None),
        (2, Some(circle)),
        (3, Some(circle)),
        (4, None),
        (5, None),
    ] {
        let decoder = decoder(2, binning, circle);
        let frames = frames(&decoder, &[1.0, 2.0]);
        let accumulator = accumulate(&decoder, &frames);
        let grid = blocks(&decoder);
        for row in 0..grid.rows {
            let span = grid.span(row);
            for column in span.begin..span.end {
                let cell = span.cell(column).unwrap();
                for (set, steps) in [(0, 4.0), (1, 8.0)] {
                    let (mut re, mut im, mut sum) = (0.0, 0.0, 0.0);
                    for (kind, pixels) in &frames {
                        let FrameKind::Fringe { set: of, step, .. } = *kind else {
                            continue;
                        };
                        if of != set {
                            continue;
                        }
                        let shift = std::f64::consts::TAU * f64::from(step) / steps;
                        for y in row * binning..(row + 1) * binning {
                            for x in column * binning..(column + 1) * binning {
                                let dn = f64::from(pixels[y * WIDTH + x]);
                                re += dn * shift.cos();
                                im -= dn * shift.sin();
                                sum += dn;
                            }
                        }
                    }
                    let got = accumulator.phasor(set, cell).unwrap();
                    assert_eq!(got.exposures, 2);
                    // 16 additions in single precision round by at most 2^-24 of the sum each.
                    let tolerance = 16.0 * sum / f64::from(1 << 24);
                    assert!(
                        (f64::from(got.re) - re).abs() <= tolerance,
                        "{} vs {re}",
                        got.re
                    );
                    assert!((f64::from(got.im) - im).abs() <= tolerance);
                    assert!((f64::from(got.sum) - sum).abs() <= tolerance);
                }
            }
        }
    }
}

#[test]
fn a_saturated_exposure_is_dropped_for_its_cell_alone() {
    let decoder = decoder(2, 3, None);
    let mut both = frames(&decoder, &[1.0, 2.0]);
    let untouched = accumulate(&decoder, &both);
    // One pixel of cell (7, 5), in one step of the fine frequency's second exposure.
    let spot = both
        .iter_mut()
        .find(|(kind, _)| {
            *kind
                == FrameKind::Fringe {
                    exposure: 1,
                    set: 1,
                    step: 6,
                }
        })
        .unwrap();
    spot.1[(5 * 3 + 1) * WIDTH + 7 * 3 + 2] = 65_000;
    let accumulator = accumulate(&decoder, &both);
    let hit = blocks(&decoder).span(5).cell(7).unwrap();
    let single = {
        let decoder = self::decoder(1, 3, None);
        let first: Vec<_> = both[..13].to_vec();
        accumulate(&decoder, &first).phasor(1, hit).unwrap()
    };
    assert_eq!(accumulator.phasor(1, hit).unwrap(), single);
    assert_eq!(accumulator.phasor(0, hit), untouched.phasor(0, hit));
    for cell in (0..decoder.grid().len()).filter(|&cell| cell != hit) {
        assert_eq!(accumulator.phasor(1, cell), untouched.phasor(1, cell));
    }
    assert_eq!(decoder.finish(&accumulator).unwrap().rejected.saturated, 0);

    // Saturated in the first exposure too: nothing is left.
    let spot = both
        .iter_mut()
        .find(|(kind, _)| {
            *kind
                == FrameKind::Fringe {
                    exposure: 0,
                    set: 1,
                    step: 0,
                }
        })
        .unwrap();
    spot.1[5 * 3 * WIDTH + 7 * 3] = 65_000;
    let accumulator = accumulate(&decoder, &both);
    assert_eq!(accumulator.phasor(1, hit).unwrap().exposures, 0);
    assert_eq!(decoder.finish(&accumulator).unwrap().rejected.saturated, 1);
}

#[test]
fn a_reset_accumulator_forgets_the_last_view() {
    let decoder = decoder(2, 2, None);
    let bright = frames(&decoder, &[1.0, 2.0]);
    let saturated: Vec<_> = bright
        .iter()
        .map(|(kind, pixels)| (*kind, vec![65_000; pixels.len()]))
        .collect();
    let fresh = decoder.finish(&accumulate(&decoder, &bright)).unwrap();
    let mut reused = accumulate(&decoder, &saturated);
    assert_eq!(
        decoder.finish(&reused).unwrap().rejected.saturated,
        decoder.grid().len()
    );
    reused.reset();
    for (kind, pixels) in &bright {
        reused
            .add(FrameView::packed(pixels, WIDTH, HEIGHT), *kind)
            .unwrap();
    }
    assert_eq!(decoder.finish(&reused).unwrap(), fresh);
}

#[test]
fn rows_may_be_padded() {
    let decoder = decoder(1, 3, None);
    let frames = frames(&decoder, &[1.0]);
    let packed = decoder.finish(&accumulate(&decoder, &frames)).unwrap();
    let stride = WIDTH + 17;
    let mut accumulator = decoder.begin();
    for (kind, pixels) in &frames {
        let mut padded = vec![65_535; stride * (HEIGHT - 1) + WIDTH];
        for row in 0..HEIGHT {
            padded[row * stride..][..WIDTH].copy_from_slice(&pixels[row * WIDTH..][..WIDTH]);
        }
        let view = FrameView {
            pixels: &padded,
            width: WIDTH,
            height: HEIGHT,
            stride,
        };
        accumulator.add(view, *kind).unwrap();
    }
    assert_eq!(decoder.finish(&accumulator).unwrap(), packed);
}

#[test]
fn frames_out_of_step_are_named_and_change_nothing() {
    let decoder = decoder(2, 3, None);
    let frames = frames(&decoder, &[1.0, 2.0]);
    let mut accumulator = decoder.begin();
    let pixels = vec![500; WIDTH * HEIGHT];
    let view = FrameView::packed(&pixels, WIDTH, HEIGHT);
    let fringe = |exposure, set, step| FrameKind::Fringe {
        exposure,
        set,
        step,
    };
    assert_eq!(
        accumulator.add(view, fringe(0, 0, 1)),
        Err(FrameError::Missing {
            got: fringe(0, 0, 1),
            expected: FrameKind::Dark,
            missing: 2
        })
    );
    for (index, (kind, good)) in frames.iter().enumerate() {
        let expected = *kind;
        assert_eq!(accumulator.expected(), Some(expected));
        if let Some((last, _)) = index.checked_sub(1).map(|last| &frames[last]) {
            assert_eq!(
                accumulator.add(view, *last),
                Err(FrameError::Repeated {
                    got: *last,
                    expected
                })
            );
        }
        assert!(matches!(
            accumulator.add(view, fringe(2, 0, 0)),
            Err(FrameError::NotPlanned { .. })
        ));
        assert!(matches!(
            accumulator.add(view, fringe(0, 1, 8)),
            Err(FrameError::NotPlanned { .. })
        ));
        assert!(matches!(
            decoder.finish(&accumulator),
            Err(DecodeError::Incomplete { received, planned: 25, .. }) if received == index
        ));
        accumulator
            .add(FrameView::packed(good, WIDTH, HEIGHT), expected)
            .unwrap();
    }
    assert_eq!(
        accumulator.add(view, FrameKind::Dark),
        Err(FrameError::Extra {
            got: FrameKind::Dark,
            planned: 25
        })
    );
    // The refused frames left no trace.
    assert_eq!(
        decoder.finish(&accumulator).unwrap(),
        decoder.finish(&accumulate(&decoder, &frames)).unwrap()
    );
    assert_eq!(
        self::decoder(2, 3, None).finish(&accumulator),
        Err(DecodeError::ForeignAccumulator)
    );
}

#[test]
fn frames_of_a_wrong_size_are_refused() {
    let mut accumulator = decoder(1, 1, None).begin();
    let pixels = vec![0; WIDTH * HEIGHT];
    let mut refuse = |width, height, stride, pixels: &[u16]| {
        accumulator
            .add(
                FrameView {
                    pixels,
                    width,
                    height,
                    stride,
                },
                FrameKind::Dark,
            )
            .unwrap_err()
    };
    assert!(
        matches!(refuse(WIDTH - 1, HEIGHT, WIDTH, &pixels), FrameError::Size { got_width, .. } if got_width == WIDTH - 1)
    );
    assert!(matches!(
        refuse(WIDTH, HEIGHT, WIDTH - 1, &pixels),
        FrameError::Stride { .. }
    ));
    assert!(matches!(
        refuse(WIDTH, HEIGHT, WIDTH, &pixels[1..]),
        FrameError::Short { .. }
    ));
    assert!(matches!(
        refuse(WIDTH, HEIGHT, usize::MAX, &pixels),
        FrameError::Short { .. }
    ));
}

#[test]
fn brightness_tells_dark_from_lit() {
    for circle in [
        None,
        Some(ImageCircle {
            centre_px: [70.0, 50.0],
            radius_px: 40.0,
        }),
    ] {
        let decoder = decoder(1, 3, circle);
        let mut accumulator = decoder.begin();
        let mut pixels = vec![60_000u16; WIDTH * HEIGHT];
        let mut expected = (0u64, 0u64);
        for row in 0..blocks(&decoder).rows {
            let span = blocks(&decoder).span(row);
            for y in row * 3..row * 3 + 3 {
                for x in span.begin * 3..span.end * 3 {
                    pixels[y * WIDTH + x] = 100 + ((x * 7 + y * 13) % 50) as u16;
                    expected = (
                        expected.0 + u64::from(pixels[y * WIDTH + x]),
                        expected.1 + 1,
                    );
                }
            }
        }
        let level = accumulator
            .add(FrameView::packed(&pixels, WIDTH, HEIGHT), FrameKind::Dark)
            .unwrap();
        assert_eq!(
            level,
            FrameLevel {
                mean_dn: expected.0 as f64 / expected.1 as f64,
                pixels: expected.1
            }
        );
        let fringe = FrameKind::Fringe {
            exposure: 0,
            set: 0,
            step: 0,
        };
        assert_eq!(level.check_content(FrameKind::Dark, 200.0), Ok(()));
        assert_eq!(level.check_content(fringe, 110.0), Ok(()));
        assert!(matches!(
            level.check_content(FrameKind::Dark, 110.0),
            Err(FrameError::DarkFrameLit { .. })
        ));
        assert!(matches!(
            level.check_content(fringe, 200.0),
            Err(FrameError::FringeFrameDark { .. })
        ));
    }
}

/// Sums of a pass: `halves` are the amplitudes left and right at the shortest exposure, of full scale; each half has phases of its
/// own.
fn pass(decoder: &Decoder, exposures_us: &[u32], halves: [f64; 2]) -> Accumulator {
    let [width, height] = decoder.size_px().map(|px| px as usize);
    let full = f64::from(decoder.full_scale_dn());
    let mut sums = decoder.begin();
    for kind in decoder.capture_order() {
        let counts = |half: usize| match kind {
            FrameKind::Fringe {
                exposure,
                set,
                step,
            } => {
                let longer = f64::from(exposures_us[exposure]) / f64::from(exposures_us[0]);
                let steps = PatternSet::named("insitu12").unwrap().sets[set].steps;
                let turn = std::f64::consts::TAU * f64::from(step) / f64::from(steps);
                let phase = 0.3 + set as f64 + 2.0 * half as f64;
                full * longer * halves[half] * (1.0 + (phase + turn).cos())
            }
            _ => 0.0,
        };
        let pixel = |at: usize| {
            let half = usize::from(at % width >= width / 2);
            (0.02 * full + counts(half)).min(full) as u16
        };
        let pixels: Vec<u16> = (0..width * height).map(pixel).collect();
        sums.add(FrameView::packed(&pixels, width, height), kind)
            .unwrap();
    }
    sums
}

#[test]
fn of_passes_every_cell_has_the_sums_of_the_one_that_lights_it() {
    const FINEST: usize = 1;
    let head = head();
    let exposures_us = [10_000, 40_000];
    let options = DecodeOptions {
        binning: 1,
        ..DecodeOptions::for_head(&head)
    };
    let set = PatternSet::named("insitu12").unwrap();
    let decoder = Decoder::new(&head, &set, &exposures_us, options).unwrap();
    let pass = |halves| pass(&decoder, &exposures_us, halves);
    let width = head.camera.width_px as usize;
    let cells = width * head.camera.height_px as usize;
    let amplitude = |sums: &Accumulator, cell: usize| {
        let phasor = sums.phasor(FINEST, cell).unwrap();
        phasor.re.hypot(phasor.im)
    };
    // The left half saturates in the long exposure of its own pass, and then has the smaller sum of the two.
    let (left, right) = (pass([0.2, 0.005]), pass([0.06, 0.075]));
    assert_eq!(left.phasor(FINEST, 0).unwrap().exposures, 1);
    assert!(amplitude(&left, 0) < amplitude(&right, 0));
    for (mut joined, other) in [(left.clone(), &right), (right.clone(), &left)] {
        decoder
            .join_passes(&mut joined, std::slice::from_ref(other))
            .unwrap();
        for cell in 0..cells {
            let own = if cell % width < width / 2 {
                &left
            } else {
                &right
            };
            for set in 0..=FINEST {
                assert_eq!(joined.phasor(set, cell), own.phasor(set, cell), "{cell}");
            }
        }
    }
    // Blinded in a pass: nothing of another stands in.
    let blind = pass([2.0, 0.005]);
    let mut joined = right.clone();
    decoder.join_passes(&mut joined, &[blind]).unwrap();
    assert_eq!(joined.phasor(FINEST, 0).unwrap().exposures, 0);
    assert_eq!(
        joined.phasor(FINEST, width - 1),
        right.phasor(FINEST, width - 1)
    );
    // A pass that is not whole is refused.
    assert!(matches!(
        decoder.join_passes(&mut joined, &[decoder.begin()]),
        Err(DecodeError::Incomplete { .. })
    ));
}
