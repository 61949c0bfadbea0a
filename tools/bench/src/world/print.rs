//! Dark dots printed on white plates: a calibration target.

use nalgebra::{Isometry3, Point3};

/// Dots on some plates of a mesh.
#[derive(Clone, Debug)]
pub struct Print {
    /// Pose of each printed plate: triangles `2 i` and `2 i + 1` of the mesh are plate `i`.
    pub tool_from_plate: Vec<Isometry3<f64>>,
    /// Distance between neighbouring dots, mm.
    pub pitch_mm: f64,
    /// Radius of a dot, mm.
    pub radius_mm: f64,
    /// Radius of the larger ones, mm.
    pub key_radius_mm: f64,
    /// Column and row of the larger ones.
    pub keys: Vec<[i32; 2]>,
    /// Number of dots from the centre to the edge of a plate.
    pub reach: i32,
    /// Reflectance of a dot relative to the plate's.
    pub ink_ratio: f64,
}

impl Print {
    /// Reflectance at a point of a triangle relative to the white plate, with a blur of standard deviation `blur_mm` on the plate.
    pub(crate) fn ratio(&self, triangle: usize, point: Point3<f64>, blur_mm: f64) -> f64 {
        let Some(tool_from_plate) = self.tool_from_plate.get(triangle / 2) else {
            return 1.0;
        };
        let at = tool_from_plate.inverse_transform_point(&point);
        let place = [at.x, at.y].map(|x| (x / self.pitch_mm).round() as i32);
        if place.iter().any(|n| n.abs() > self.reach) {
            return 1.0;
        }
        let [x, y] = place.map(|n| f64::from(n) * self.pitch_mm);
        let radius_mm = if self.keys.contains(&place) {
            self.key_radius_mm
        } else {
            self.radius_mm
        };
        let beyond = ((at.x - x).hypot(at.y - y) - radius_mm) / blur_mm;
        1.0 - (1.0 - self.ink_ratio) * (1.0 - normal_cdf(beyond))
    }
}

/// Normal distribution function: the profile of a straight edge after Gaussian blur (Abramowitz and Stegun 26.2.17, 7.5e-8).
fn normal_cdf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * x.abs());
    let tail = t
        * (0.319_381_530
            + t * (-0.356_563_782
                + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let density = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    let above = density * tail;
    if x > 0.0 { 1.0 - above } else { above }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with the distribution function by numerical integration of the density.
    #[test]
    fn the_blurred_edge_is_a_normal_distribution() {
        let step = 1e-4;
        let mut sum = 0.0;
        for i in -80_000..40_000 {
            let x = f64::from(i) * step;
            if i % 5_000 == 0 {
                assert!((normal_cdf(x) - sum).abs() < 1e-6, "{x}: {sum}");
            }
            let middle = x + 0.5 * step;
            sum += step * (-0.5 * middle * middle).exp() / std::f64::consts::TAU.sqrt();
        }
    }

    #[test]
    fn dots_are_dark_where_they_are_printed() {
        let plate = Isometry3::translation(40.0, 0.0, 33.0);
        let print = Print {
            tool_from_plate: vec![plate],
            pitch_mm: 0.5,
            radius_mm: 0.1,
            key_radius_mm: 0.2,
            keys: vec![[2, 0]],
            reach: 3,
            ink_ratio: 0.25,
        };
        let at = |x: f64, y: f64| print.ratio(1, plate * Point3::new(x, y, 0.0), 0.01);
        assert!((at(0.5, -1.0) - 0.25).abs() < 1e-9);
        assert!((at(0.6, -1.0) - 0.625).abs() < 1e-6, "half of a rim");
        assert!((at(0.65, -1.0) - 1.0).abs() < 1e-5);
        assert!((at(1.15, 0.0) - 0.25).abs() < 1e-5, "a larger one");
        assert_eq!(at(2.0, 0.0), 1.0, "beyond the last column");
        assert_eq!(print.ratio(2, plate * Point3::origin(), 0.01), 1.0);
    }
}
