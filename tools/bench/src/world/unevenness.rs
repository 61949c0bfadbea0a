//! Residual distortion of a lens: smooth but irregular deviations of the light over the field, which no drawing shows.

use std::f64::consts::TAU;

use nalgebra::Vector2;
use serde::Deserialize;

use super::random::{Normals, Purpose, stream};

/// Number of waves in one lens.
const WAVES: usize = 6;
/// Their wavelengths relative to the field's diameter: too short for the distortion's polynomial, as long as polishing and index
/// errors cause.
const LENGTHS: [f64; 2] = [0.4, 0.8];

/// Number of coefficients of a [`Remainder`] along a side.
pub const SIDE: usize = 10;

/// A shift of the image over a square of the plane `z = 1`: uniform cubic B-splines along both axes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Remainder {
    /// Centre of the square.
    pub centre: [f64; 2],
    pub half_side: f64,
    /// Shift along the columns; coefficients of the smallest y first.
    pub columns_px: [[f64; SIDE]; SIDE],
    /// Shift along the rows.
    pub rows_px: Option<[[f64; SIDE]; SIDE]>,
}

/// Deviation of the light over the undistorted image plane `z = 1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Unevenness(Kind);

#[derive(Clone, Debug, PartialEq)]
enum Kind {
    /// A sum of plane waves.
    Waves(Vec<Wave>),
    /// As stated in a head file, in pixels of these focal lengths.
    Stated(Box<Remainder>, [f64; 2]),
}

#[derive(Clone, Debug, PartialEq)]
struct Wave {
    /// Wave vector: phase per unit of x and y.
    number: Vector2<f64>,
    phase_rad: f64,
    shift: Vector2<f64>,
}

impl Unevenness {
    /// Drawn from `seed`, different for every `lens`: root mean square `rms` along each axis, in units of the image plane, over a
    /// field of radius `field`.
    pub(crate) fn drawn(seed: u64, lens: u8, rms: f64, field: f64) -> Self {
        let mut random = Normals::new(stream(seed, Purpose::Unevenness(lens)));
        // The mean square of a wave is half of its squared amplitude.
        let height = rms * (2.0 / WAVES as f64).sqrt();
        let waves = (0..WAVES)
            .map(|_| {
                let [shortest, longest] = LENGTHS;
                let length = 2.0 * field * (shortest + (longest - shortest) * random.uniform());
                let unit = |angle: f64| Vector2::new(angle.cos(), angle.sin());
                Wave {
                    number: unit(TAU * random.uniform()) * (TAU / length),
                    phase_rad: TAU * random.uniform(),
                    shift: Vector2::new(random.next(), random.next()) * height,
                }
            })
            .collect();
        Self(Kind::Waves(waves))
    }

    /// The residual distortion in a head file, for a world that follows the file.
    pub(crate) fn stated(field: &Remainder, focal_px: [f64; 2]) -> Self {
        Self(Kind::Stated(Box::new(field.clone()), focal_px))
    }

    /// Deviation at a position.
    pub(crate) fn at(&self, place: Vector2<f64>) -> Vector2<f64> {
        match &self.0 {
            Kind::Waves(waves) => waves
                .iter()
                .map(|wave| wave.shift * (wave.number.dot(&place) + wave.phase_rad).sin())
                .sum(),
            Kind::Stated(field, focal_px) => {
                let shift_px = shift_px(field, place);
                Vector2::from([0, 1].map(|axis| shift_px[axis] / focal_px[axis]))
            }
        }
    }
}

/// Shift by a head file at a position, along columns and rows; constant beyond the border of its square.
fn shift_px(field: &Remainder, place: Vector2<f64>) -> [f64; 2] {
    let pieces = (SIDE - 3) as f64;
    // Weights of the coefficients: the cardinal cubic B-spline about its knot, the first of which lies one interval before the square.
    let counts: [[f64; SIDE]; 2] = [0, 1].map(|axis| {
        let along = (place[axis] - field.centre[axis]) / field.half_side;
        let at = (0.5 * (along + 1.0) * pieces).clamp(0.0, pieces);
        std::array::from_fn(|knot| cubic(at + 1.0 - knot as f64))
    });
    let summed = |coefficients: &[[f64; SIDE]; SIDE]| -> f64 {
        let rows = coefficients.iter().zip(counts[1]);
        rows.map(|(row, y)| {
            let row = row.iter().zip(counts[0]);
            y * row.map(|(coefficient, x)| coefficient * x).sum::<f64>()
        })
        .sum()
    };
    [
        summed(&field.columns_px),
        field.rows_px.as_ref().map_or(0.0, summed),
    ]
}

/// The cubic B-spline on whole knots, centred on 0.
fn cubic(from_centre: f64) -> f64 {
    let d = from_centre.abs();
    match d {
        0.0..1.0 => (4.0 - 6.0 * d * d + 3.0 * d * d * d) / 6.0,
        1.0..2.0 => (2.0 - d).powi(3) / 6.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coefficients linear in their knots reproduce a linear function, and a single one its spline.
    #[test]
    fn a_stated_shift_is_a_cubic_spline() {
        let mut field = Remainder {
            centre: [0.1, -0.2],
            half_side: 0.35,
            columns_px: std::array::from_fn(|j| {
                std::array::from_fn(|i| 0.3 * i as f64 - 0.2 * j as f64)
            }),
            rows_px: None,
        };
        // Ten intervals per unit; knot 1 is on the border of the square.
        for [x, y] in [[0.1, -0.2], [-0.2, 0.1], [0.33, -0.51]] {
            let [i, j] = [(x + 0.25) * 10.0 + 1.0, (y + 0.55) * 10.0 + 1.0];
            let [columns, rows] = shift_px(&field, Vector2::new(x, y));
            assert!((columns - (0.3 * i - 0.2 * j)).abs() < 1e-12, "{x} {y}");
            assert_eq!(rows, 0.0);
        }
        let border = shift_px(&field, Vector2::new(0.45, 0.0));
        assert_eq!(shift_px(&field, Vector2::new(3.0, 0.0)), border);
        field.columns_px = [[0.0; SIDE]; SIDE];
        field.columns_px[5][4] = 1.0;
        let [peak, _] = shift_px(&field, Vector2::new(0.05, -0.15));
        assert!((peak - 4.0 / 9.0).abs() < 1e-12, "{peak}");
    }

    /// Mean square over 200 lenses of six waves each, known to 5 %, equals the requested value.
    #[test]
    fn as_uneven_as_asked_for() {
        let (mut count, mut squares) = (0.0, 0.0);
        for seed in 0..200 {
            let lens = Unevenness::drawn(seed, 0, 1e-4, 0.227);
            for i in -5..=5 {
                for j in -5..=5 {
                    let place = Vector2::new(f64::from(i), f64::from(j)) * 0.03;
                    squares += lens.at(place).norm_squared();
                    count += 2.0;
                }
            }
        }
        let rms = f64::sqrt(squares / count);
        assert!((rms / 1e-4 - 1.0).abs() < 0.15, "{rms}");
        assert_ne!(
            Unevenness::drawn(1, 0, 1e-4, 0.2),
            Unevenness::drawn(1, 1, 1e-4, 0.2)
        );
    }
}
