//! Structure below a cell against the verdict: whatever is beyond the limit is never passed, and what a die in use looks like
//! after a week is.
//!
//! Every ray is followed to the surface by brute force (`wear/unseen.rs`), the truth is the largest mean over discs of a raster
//! of 5 µm. Seeds from 31000 on were not looked at while constants were chosen. `FLANKSCOPE_TEST_ALL=1` draws three times as many.

use flankscope_test_requisites::everything;
use rayon::prelude::*;

use super::campaign::limits;
use super::*;
use crate::verdict::Word;
use crate::wear::looked::{hairlines, looked_at, waves};
use flankscope_foundation::random::uniform;

const SIZE_MM: [f64; 2] = [1.7, 3.0];
const SEED: u64 = 31_000;
/// Side of the raster that the truth is summed over, and steps between discs, mm.
const RASTER_MM: f64 = 5e-3;
const STEP_MM: f64 = 0.05;

fn draws() -> u64 {
    if everything() { 60 } else { 20 }
}

/// Depth by place on the zone, mm.
type DepthMap = Box<dyn Fn([f64; 2]) -> f64 + Send + Sync>;

/// The largest mean loss over any disc, mm.
fn truth_mm(surface: &DepthMap) -> f64 {
    let radius = (limits().area_mm2 / std::f64::consts::PI).sqrt();
    let [columns, rows] = SIZE_MM.map(|size| (size / RASTER_MM) as usize);
    // Sums of rows of cells, so that a disc is a sum of differences.
    let sums: Vec<Vec<f64>> = (0..rows)
        .map(|row| {
            let at = |column: usize| [column, row].map(|i| (i as f64 + 0.5) * RASTER_MM);
            let mut sum = vec![0.0];
            for column in 0..columns {
                sum.push(sum[column] + surface(at(column)));
            }
            sum
        })
        .collect();
    let steps = |size: f64| ((size - 2.0 * radius) / STEP_MM) as usize;
    let mean = |[x, y]: [f64; 2]| {
        let (mut sum, mut count) = (0.0, 0);
        let rows = [y - radius, y + radius].map(|y| (y / RASTER_MM) as usize);
        for (row, sums) in sums.iter().enumerate().take(rows[1] + 1).skip(rows[0]) {
            let off = (row as f64 + 0.5) * RASTER_MM - y;
            let half = (radius * radius - off * off).max(0.0).sqrt();
            let [from, to] = [x - half, x + half].map(|x| (x / RASTER_MM).round() as usize);
            sum += sums[to] - sums[from];
            count += to - from;
        }
        sum / count as f64
    };
    let middles = (0..=steps(SIZE_MM[0])).flat_map(|i| {
        (0..=steps(SIZE_MM[1])).map(move |k| [i, k].map(|n| radius + n as f64 * STEP_MM))
    });
    middles.map(mean).fold(0.0, f64::max)
}

/// Verdicts on surfaces that `surface` draws from the stream of a seed, with their truth, µm.
fn verdicts(
    surface: impl Fn(&dyn Fn(f64, f64) -> f64, u64) -> DepthMap + Sync,
) -> Vec<(f64, Word)> {
    (0..draws())
        .into_par_iter()
        .map(|i| {
            let seed = SEED + i;
            let next = std::cell::Cell::new(0);
            let draw = |low: f64, high: f64| {
                next.set(next.get() + 1);
                low + (high - low) * uniform(seed, next.get())
            };
            let slant = draw(1.5, 3.0);
            let surface = surface(&draw, seed);
            let wear = looked_at(&surface, SIZE_MM, slant, seed);
            (
                1e3 * truth_mm(&surface),
                judge(&wear, &limits()).verdict.word(),
            )
        })
        .collect()
}

#[track_caller]
fn assert_beyond_is_never_passed(family: &str, verdicts: &[(f64, Word)]) {
    let beyond: Vec<_> = verdicts
        .iter()
        .filter(|(um, _)| *um > limits().wear.limit_um)
        .collect();
    let passed: Vec<_> = beyond.iter().filter(|(_, word)| word.passes()).collect();
    println!(
        "{family}: {} of {} beyond the limit passed: {passed:?}",
        passed.len(),
        beyond.len()
    );
    assert!(
        beyond.len() as u64 >= draws() / 4,
        "{family}: {}",
        beyond.len()
    );
    assert!(20 * passed.len() <= beyond.len(), "{family}: {passed:?}");
}

#[track_caller]
fn assert_go(family: &str, verdicts: &[(f64, Word)]) {
    let refused: Vec<_> = verdicts
        .iter()
        .filter(|(_, word)| *word != Word::Go)
        .collect();
    println!(
        "{family}: {} of {} are no go: {refused:?}",
        refused.len(),
        verdicts.len()
    );
    assert!(
        20 * refused.len() <= verdicts.len(),
        "{family}: {refused:?}"
    );
}

/// A profile across parallel lines at an angle to the direction that the camera looks along, within half a zone.
fn lines(
    draw: &dyn Fn(f64, f64) -> f64,
    profile: impl Fn(f64) -> f64 + Send + Sync + 'static,
) -> DepthMap {
    let angle = draw(-1.2, 1.2);
    Box::new(move |[x, y]| {
        let inside = (0.3..1.5).contains(&x) && (0.4..2.6).contains(&y);
        if inside {
            profile(x * angle.cos() + y * angle.sin())
        } else {
            0.0
        }
    })
}

#[test]
fn grooves_side_by_side() {
    let found = verdicts(|draw, _| {
        let width = draw(0.035, 0.08);
        let (pitch, depth) = (width / draw(0.4, 0.8), draw(0.1, 0.3));
        lines(draw, move |x| {
            if x.rem_euclid(pitch) < width {
                depth
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("grooves", &found);
}

#[test]
fn v_grooves_side_by_side() {
    let found = verdicts(|draw, _| {
        let (width, depth) = (draw(0.045, 0.1), draw(0.1, 0.3));
        lines(draw, move |x| {
            depth * (1.0 - (2.0 * x.rem_euclid(width) / width - 1.0).abs())
        })
    });
    assert_beyond_is_never_passed("V grooves", &found);
}

#[test]
fn pits_side_by_side() {
    let found = verdicts(|draw, _| {
        let (width, depth) = (draw(0.06, 0.12), draw(0.1, 0.3));
        let pitch = width * draw(1.02, 1.15);
        Box::new(move |[x, y]| {
            let inside = (0.3..1.5).contains(&x) && (0.4..2.6).contains(&y);
            let away = |v: f64| v.rem_euclid(pitch) - 0.5 * pitch;
            if inside && away(x).hypot(away(y)) < 0.5 * width {
                depth
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("pits", &found);
}

/// Grooves with most of the surface left in place between them, along or nearly along the height, all over the zone and on even wear.
#[test]
fn grooves_apart() {
    let found = verdicts(|draw, _| {
        let width = draw(0.03, 0.1);
        let pitch = width * draw(1.5, 8.0);
        let depth = (width * draw(3.0, 10.0)).min(0.4);
        let (even, angle, from) = (draw(0.0, 30e-3), draw(-0.1, 0.1), draw(0.0, pitch));
        Box::new(move |[x, y]: [f64; 2]| {
            let across = x * angle.cos() + y * angle.sin() + from;
            even + match across.rem_euclid(pitch) < width {
                true => depth,
                false => 0.0,
            }
        })
    });
    assert_beyond_is_never_passed("grooves apart", &found);
}

/// Texture over a part of a disc only: grooves in a strip, pits in an island.
#[test]
fn textures_that_fill_no_disc() {
    let strips = verdicts(|draw, _| {
        let width = draw(0.035, 0.11);
        let (pitch, depth) = (width / draw(0.4, 0.8), draw(0.1, 0.35));
        let (strip, turn, at) = (
            draw(0.25, 0.6),
            draw(-1.2, 1.2),
            [draw(0.0, 1.7), draw(0.5, 2.5)],
        );
        let grooves = lines(draw, move |x| {
            if x.rem_euclid(pitch) < width {
                depth
            } else {
                0.0
            }
        });
        Box::new(move |[x, y]| {
            let across = (x - at[0]) * turn.cos() + (y - at[1]) * turn.sin();
            if across.abs() < 0.5 * strip {
                grooves([x, y])
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("strips of grooves", &strips);
    let islands = verdicts(|draw, _| {
        let width = draw(0.045, 0.12);
        let (pitch, depth) = (width * draw(1.02, 1.2), draw(0.1, 0.4));
        let (radius, at) = (draw(0.2, 0.4), [draw(0.1, 1.6), draw(0.5, 2.5)]);
        Box::new(move |[x, y]| {
            let away = |v: f64| v.rem_euclid(pitch) - 0.5 * pitch;
            let inside = (x - at[0]).hypot(y - at[1]) < radius;
            if inside && away(x).hypot(away(y)) < 0.5 * width {
                depth
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("islands of pits", &islands);
}

/// Pits with sound material between them, in patches that are narrower than a disc: the deeper they are, the fewer need be there.
#[test]
fn pits_apart() {
    let found = verdicts(|draw, _| {
        let width = draw(0.06, 0.11);
        let (pitch, depth) = (width * draw(1.2, 2.2), width * draw(3.0, 5.0));
        let size = [draw(0.33, 1.2), draw(0.33, 1.2)];
        let at = [0, 1].map(|k| draw(0.0, SIZE_MM[k] - size[k]));
        Box::new(move |p: [f64; 2]| {
            let inside = (0..2).all(|k| (at[k]..at[k] + size[k]).contains(&p[k]));
            let [x, y] = p.map(|v| v.rem_euclid(pitch) - 0.5 * pitch);
            if inside && x.hypot(y) < 0.5 * width {
                depth
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("pits apart", &found);
}

#[test]
fn single_cracks() {
    let found = verdicts(|draw, _| {
        let (width, depth, at) = (draw(0.08, 0.16), draw(0.2, 0.35), draw(0.6, 1.1));
        lines(draw, move |x| {
            if (at..at + width).contains(&x) {
                depth
            } else {
                0.0
            }
        })
    });
    assert_beyond_is_never_passed("cracks", &found);
}

#[test]
fn flanks_after_a_week() {
    let hair = verdicts(|_, seed| Box::new(hairlines(3, [0.1, 0.3], [5e-3, 25e-3], seed)));
    assert_go("hairlines", &hair);
    let rough = verdicts(|draw, seed| {
        let (rms, length) = (draw(1e-3, 3e-3), draw(0.05, 0.3));
        Box::new(waves(rms, length, seed))
    });
    assert_go("rough", &rough);
    let shallow = verdicts(|draw, seed| {
        let (at, radius, depth) = (
            [draw(0.4, 1.3), draw(0.5, 2.5)],
            draw(0.2, 0.6),
            draw(3e-3, 15e-3),
        );
        let rough = waves(1e-3, 0.1, seed);
        Box::new(move |p: [f64; 2]| {
            let away = (p[0] - at[0]).hypot(p[1] - at[1]) / radius;
            rough(p) + if away < 1.0 { depth } else { 0.0 }
        })
    });
    assert_go("shallow spalls", &shallow);
}
