//! Autofocus: the setting of a lens at which the fringes have most contrast.
//!
//! Blur of a standard deviation `s` leaves `exp(-2 (pi f s)^2)` of fringes of frequency `f`, and its square grows with that of the
//! distance from best focus: over the focal power the logarithm of the contrast is a parabola, but for what is left of higher order
//! over a few dioptres. Coarse steps over the whole range find the highest place, fine ones about it give the parabola its vertex.

use nalgebra::{Matrix3, Vector3};

use crate::cloud::CellColumn;
use crate::head::HeadModel;

/// Settings over the whole range.
const COARSE: u16 = 9;
/// Settings about the highest of them, from neighbour to neighbour.
const FINE: u16 = 9;
/// Only this share of the field's radius is looked at: best focus is curved.
const MIDDLE: f64 = 0.25;
/// Fewest cells whose mean is a contrast.
const MIN_CELLS: usize = 200;
/// A vertex that is less sure than this share of a coarse step found nothing.
const MAX_SIGMA_RATIO: f64 = 0.2;

/// What the driver was told, and the fringes' contrast there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// What the driver was told.
    pub counts: u16,
    /// Mean contrast of the finest fringes in the middle of the field.
    pub contrast: f64,
}

/// Where the fringes are sharpest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpest {
    /// Counts, and parts of one.
    pub counts: f64,
    /// Standard uncertainty of that, by how far the contrasts lie from the parabola.
    pub sigma_counts: f64,
    /// Contrast there.
    pub contrast: f64,
}

/// Why no setting is the sharpest.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NotSharp {
    /// Too little of the field shows fringes.
    #[error(
        "at {counts} counts {got} cells in the middle of the field show fringes, at least {limit} are needed: is the plate there, and lit?"
    )]
    Dark {
        /// What the driver was told.
        counts: u16,
        /// Cells with fringes.
        got: usize,
        /// Fewest.
        limit: usize,
    },
    /// It goes on getting sharper.
    #[error(
        "the fringes are sharpest at {counts} counts, the end of the lens' range ({} to {}): bring the plate nearer to where the middle of the range is sharp",
        range[0], range[1]
    )]
    AtTheEnd {
        /// The sharpest of the coarse settings.
        counts: u16,
        /// All of them: least and most.
        range: [u16; 2],
    },
    /// No vertex, or a vague one.
    #[error(
        "the contrast of the fringes has no vertex between {} and {} counts: does the lens move, and do the fringes have contrast?",
        between[0], between[1]
    )]
    NoVertex {
        /// Where it was looked for.
        between: [u16; 2],
    },
}

impl Sharpness {
    /// Of a view of a white plate through a lens that was told `counts`.
    ///
    /// # Errors
    /// [`NotSharp::Dark`].
    pub fn of(counts: u16, cells: &[CellColumn], head: &HeadModel) -> Result<Self, NotSharp> {
        let size_px = [head.camera.width_px, head.camera.height_px].map(f64::from);
        let (centre_px, radius_px) = match &head.image_circle {
            Some(circle) => (circle.centre_px, circle.radius_px),
            None => (size_px.map(|px| 0.5 * px), 0.5 * size_px[0].min(size_px[1])),
        };
        let within = |cell: &&CellColumn| {
            let [x, y] = [0, 1].map(|k| cell.pixel[k] - centre_px[k]);
            x.hypot(y) <= MIDDLE * radius_px && cell.contrast > 0.0
        };
        let (mut sum, mut got) = (0.0, 0);
        for cell in cells.iter().filter(within) {
            sum += cell.contrast;
            got += 1;
        }
        match got >= MIN_CELLS {
            true => Ok(Self {
                counts,
                contrast: sum / got as f64,
            }),
            false => Err(NotSharp::Dark {
                counts,
                got,
                limit: MIN_CELLS,
            }),
        }
    }
}

fn steps([from, to]: [u16; 2], number: u16) -> Vec<u16> {
    let at = |step: u16| {
        let way = f64::from(step) / f64::from(number - 1);
        (f64::from(from) + way * (f64::from(to) - f64::from(from))).round() as u16
    };
    let mut steps: Vec<u16> = (0..number).map(at).collect();
    steps.dedup();
    steps
}

/// Settings to look at first.
#[must_use]
pub fn coarse(range: [u16; 2]) -> Vec<u16> {
    steps(range, COARSE)
}

/// Settings to look at next.
///
/// # Errors
/// [`NotSharp::AtTheEnd`].
pub fn fine(coarse: &[Sharpness]) -> Result<Vec<u16>, NotSharp> {
    let highest = (0..coarse.len())
        .max_by(|&a, &b| coarse[a].contrast.total_cmp(&coarse[b].contrast))
        .unwrap_or(0);
    let beside = highest
        .checked_sub(1)
        .and_then(|before| Some([coarse.get(before)?, coarse.get(highest + 1)?]));
    match (beside, coarse) {
        (Some(beside), _) => Ok(steps(beside.map(|beside| beside.counts), FINE)),
        (None, [first, .., last]) => Err(NotSharp::AtTheEnd {
            counts: coarse[highest].counts,
            range: [first.counts, last.counts],
        }),
        (None, _) => Err(NotSharp::NoVertex { between: [0, 0] }),
    }
}

/// The vertex of the fine settings.
///
/// # Errors
/// [`NotSharp::NoVertex`].
pub fn sharpest(fine: &[Sharpness]) -> Result<Sharpest, NotSharp> {
    let ends = || fine.iter().map(|of| of.counts);
    let between = [ends().min().unwrap_or(0), ends().max().unwrap_or(0)];
    let [least, most] = between.map(f64::from);
    let (middle, half) = (0.5 * (least + most), 0.5 * (most - least));
    vertex(fine, middle, half).ok_or(NotSharp::NoVertex { between })
}

/// Least squares of a parabola to the logarithms, over counts from -1 to 1.
fn vertex(fine: &[Sharpness], middle: f64, half: f64) -> Option<Sharpest> {
    let row = |of: &Sharpness| {
        let x = (f64::from(of.counts) - middle) / half;
        Vector3::new(1.0, x, x * x)
    };
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for of in fine {
        normal += row(of) * row(of).transpose();
        right += of.contrast.ln() * row(of);
    }
    let inverse = normal.try_inverse()?;
    let [c, b, a]: [f64; 3] = (inverse * right).into();
    let freedom = fine.len().checked_sub(3).filter(|&freedom| freedom > 0)?;
    let left_over = |of: &Sharpness| of.contrast.ln() - Vector3::new(c, b, a).dot(&row(of));
    let variance = fine.iter().map(|of| left_over(of).powi(2)).sum::<f64>() / freedom as f64;
    let x = -b / (2.0 * a);
    let by = Vector3::new(0.0, -1.0 / (2.0 * a), b / (2.0 * a * a));
    let sigma = (variance * by.dot(&(inverse * by))).sqrt();
    // Written so that a NaN fails.
    let found = a < 0.0 && x.abs() <= 1.0 && sigma <= MAX_SIGMA_RATIO;
    found.then(|| Sharpest {
        counts: middle + half * x,
        sigma_counts: half * sigma,
        contrast: (c + 0.5 * b * x).exp(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: [u16; 2] = [416, 616];

    /// Contrast through a lens that is sharp at `best` counts, by the blur of two objectives.
    fn shown(counts: u16, best: f64) -> f64 {
        let defocus_mm = 0.017 * (f64::from(counts) - best);
        let blur = |focused: f64| {
            2.0 * (std::f64::consts::PI * 0.19).powi(2) * {
                focused * focused + (0.13 * defocus_mm).powi(2)
            }
        };
        0.6 * (-blur(0.22) - blur(0.28)).exp()
    }

    fn seen(at: Vec<u16>, contrast: impl FnMut(u16) -> f64) -> Vec<Sharpness> {
        let mut contrast = contrast;
        let of = |counts| Sharpness {
            counts,
            contrast: contrast(counts),
        };
        at.into_iter().map(of).collect()
    }

    #[test]
    fn the_vertex_of_a_blurred_fringe_is_found_over_the_range() {
        for best in [445.3, 500.0, 516.0, 590.9] {
            let rough = seen(coarse(RANGE), |counts| shown(counts, best));
            let near = seen(fine(&rough).unwrap(), |counts| shown(counts, best));
            let found = sharpest(&near).unwrap();
            assert!((found.counts - best).abs() < 1e-6, "{best}: {found:?}");
            assert!((found.contrast - shown(0, 0.0)).abs() < 1e-9);
        }
    }

    #[test]
    fn noise_is_told_as_uncertainty() {
        // Twelve evenly drawn numbers (Knuth's MMIX) less six are nearly normal.
        let mut state = 5u64;
        let mut even = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut noise = move || 1e-4 * ((0..12).map(|_| even()).sum::<f64>() - 6.0);
        let mut pulls = 0.0;
        let draws = 400;
        for _ in 0..draws {
            let near = seen(steps([491, 541], FINE), |counts| {
                shown(counts, 512.0) + noise()
            });
            let found = sharpest(&near).unwrap();
            assert!(found.sigma_counts < 2.0, "{found:?}");
            pulls += ((found.counts - 512.0) / found.sigma_counts).powi(2);
        }
        // Student's t of 6 degrees of freedom has a variance of 1.5.
        let pull = pulls / f64::from(draws);
        assert!((1.0..2.2).contains(&pull), "{pull}");
    }

    #[test]
    fn what_has_no_vertex_is_refused() {
        let rough = seen(coarse(RANGE), |counts| shown(counts, 640.0));
        let error = fine(&rough).unwrap_err();
        assert_eq!(
            error,
            NotSharp::AtTheEnd {
                counts: 616,
                range: RANGE
            }
        );
        for contrast in [|_| 0.5, |_| f64::NAN, |c: u16| 1.0 / shown(c, 516.0)] {
            let near = seen(steps([491, 541], FINE), contrast);
            let between = [491, 541];
            assert_eq!(sharpest(&near), Err(NotSharp::NoVertex { between }));
        }
    }
}
