//! Renders objects in space by parallel projection with hidden surfaces.

use super::colour;

type Vector = [f64; 3];

/// Number of shades of a face, dark where it is seen from the side.
const SHADES: f64 = 24.0;
const DARK: f64 = 110.0;
const BRIGHT: f64 = 236.0;
/// Lines and dots are drawn in front of the faces that they lie on: offset as a fraction of the picture's width.
const ON_FACE: f64 = 0.004;
const BACKGROUND: [u8; 3] = [255; 3];

/// Margin around the objects, as a factor.
const MARGIN: f64 = 1.05;

/// A picture to which objects are added in any order.
pub struct Canvas {
    size_px: [usize; 2],
    px_per_mm: f64,
    /// Centre of the picture: to the right and up.
    middle_mm: [f64; 2],
    /// Directions to the right, up, and towards the viewer.
    axes: [Vector; 3],
    on_face_mm: f64,
    pixels: Vec<[u8; 3]>,
    /// Depth buffer: height of the visible object towards the viewer, mm.
    height_mm: Vec<f32>,
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn minus(a: Vector, b: Vector) -> Vector {
    [0, 1, 2].map(|k| a[k] - b[k])
}

impl Canvas {
    /// An empty picture that all of these points fit into (mm; at least one), for a viewer at `azimuth_rad` about the z axis and
    /// `elevation_rad` above the xy plane (less than a right angle).
    pub fn fitting(
        points_mm: impl Iterator<Item = Vector>,
        size_px: [usize; 2],
        [azimuth_rad, elevation_rad]: [f64; 2],
    ) -> Self {
        let (sin_az, cos_az) = azimuth_rad.sin_cos();
        let (sin_el, cos_el) = elevation_rad.sin_cos();
        let axes = [
            [-sin_az, cos_az, 0.0],
            [-sin_el * cos_az, -sin_el * sin_az, cos_el],
            [cos_el * cos_az, cos_el * sin_az, sin_el],
        ];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in points_mm {
            for k in 0..2 {
                let along = dot(axes[k], point);
                low[k] = low[k].min(along);
                high[k] = high[k].max(along);
            }
        }
        let scales = [0, 1].map(|k| size_px[k] as f64 / (MARGIN * (high[k] - low[k])));
        let px_per_mm = scales[0].min(scales[1]);
        let px_per_mm = if px_per_mm.is_finite() {
            px_per_mm
        } else {
            1.0
        };
        let count = size_px[0] * size_px[1];
        Self {
            size_px,
            px_per_mm,
            middle_mm: [0, 1].map(|k| 0.5 * (low[k] + high[k])),
            axes,
            on_face_mm: ON_FACE * size_px[0] as f64 / px_per_mm,
            pixels: vec![BACKGROUND; count],
            height_mm: vec![f32::NEG_INFINITY; count],
        }
    }

    /// The direction towards the viewer.
    #[must_use]
    pub fn towards(&self) -> Vector {
        self.axes[2]
    }

    /// Column and row, px, and height towards the viewer, mm.
    fn seen(&self, p_mm: Vector) -> Vector {
        let [right, up, near] = self.axes.map(|axis| dot(axis, p_mm));
        [
            0.5 * self.size_px[0] as f64 + (right - self.middle_mm[0]) * self.px_per_mm,
            0.5 * self.size_px[1] as f64 - (up - self.middle_mm[1]) * self.px_per_mm,
            near,
        ]
    }

    fn put(&mut self, [column, row]: [f64; 2], near_mm: f64, colour: [u8; 3]) {
        let (column, row) = (column.floor(), row.floor());
        let [width, height] = self.size_px;
        let inside = column >= 0.0 && row >= 0.0 && column < width as f64 && row < height as f64;
        if !inside {
            return;
        }
        let at = row as usize * width + column as usize;
        if near_mm as f32 > self.height_mm[at] {
            self.height_mm[at] = near_mm as f32;
            self.pixels[at] = colour;
        }
    }

    /// A triangle whose corners run anticlockwise seen from outside; brighter the more it faces the viewer. It is invisible from
    /// behind, so that a viewer looks through the near wall of a bore.
    pub fn face(&mut self, corners_mm: [Vector; 3]) {
        let [a, b, c] = corners_mm.map(|corner| self.seen(corner));
        // Rows increase downwards, so anticlockwise in space is clockwise in the picture.
        let area = (c[0] - a[0]) * (b[1] - a[1]) - (b[0] - a[0]) * (c[1] - a[1]);
        if area <= 0.0 {
            return;
        }
        let [u, v] = [
            minus(corners_mm[1], corners_mm[0]),
            minus(corners_mm[2], corners_mm[0]),
        ];
        let across = [
            u[1] * v[2] - u[2] * v[1],
            u[2] * v[0] - u[0] * v[2],
            u[0] * v[1] - u[1] * v[0],
        ];
        let facing = dot(across, self.axes[2]) / dot(across, across).sqrt();
        let shade = (facing * SHADES).round() / SHADES;
        let colour = [(DARK + (BRIGHT - DARK) * shade) as u8; 3];
        let size_px = self.size_px;
        let range = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().max(0.0);
            let high = a[k].max(b[k]).max(c[k]).ceil().min(size_px[k] as f64);
            low as usize..high.max(0.0) as usize
        };
        for row in range(1) {
            for column in range(0) {
                let [x, y] = [column as f64 + 0.5, row as f64 + 0.5];
                let weight = |p: Vector, q: Vector| {
                    ((x - p[0]) * (q[1] - p[1]) - (q[0] - p[0]) * (y - p[1])) / area
                };
                let weights = [weight(b, c), weight(c, a), weight(a, b)];
                if weights.iter().all(|weight| *weight >= 0.0) {
                    let near_mm = dot(weights, [a[2], b[2], c[2]]);
                    self.put([x, y], near_mm, colour);
                }
            }
        }
    }

    /// A line.
    pub fn line(&mut self, ends_mm: [Vector; 2], colour: [u8; 3]) {
        let [from, to] = ends_mm.map(|end| self.seen(end));
        let across = minus(to, from);
        let steps = across[0].abs().max(across[1].abs()).ceil().clamp(1.0, 1e5);
        for step in 0..=steps as usize {
            let t = step as f64 / steps;
            let [x, y, near] = [0, 1, 2].map(|k| from[k] + t * across[k]);
            self.put([x, y], near + self.on_face_mm, colour);
        }
    }

    /// A square dot, `side_px` wide.
    pub fn dot(&mut self, p_mm: Vector, side_px: usize, colour: [u8; 3]) {
        let [x, y, near] = self.seen(p_mm);
        let first = 0.5 * (side_px as f64 - 1.0);
        for row in 0..side_px {
            for column in 0..side_px {
                let at = [x - first + column as f64, y - first + row as f64];
                self.put(at, near + self.on_face_mm, colour);
            }
        }
    }

    /// The picture, as a `data:` address.
    #[must_use]
    pub fn data_uri(&self) -> String {
        colour::rgb_data_uri(self.size_px[0], self.size_px[1], &self.pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: [u8; 3] = [255, 0, 0];
    const BLUE: [u8; 3] = [0, 0, 255];

    /// 105 by 63 px of 0.1 mm, seen from x.
    fn from_x() -> Canvas {
        let corners = [[0.0, -5.0, -3.0], [9.0, 5.0, 3.0]];
        let canvas = Canvas::fitting(corners.into_iter(), [105, 63], [0.0; 2]);
        assert!((canvas.px_per_mm - 10.0).abs() < 1e-9);
        canvas
    }

    fn at(canvas: &Canvas, [column, row]: [usize; 2]) -> [u8; 3] {
        canvas.pixels[row * 105 + column]
    }

    #[test]
    fn a_point_is_where_a_viewer_on_the_x_axis_sees_it_and_the_nearer_is_in_front() {
        let mut canvas = from_x();
        // y to the right, z up.
        canvas.dot([-3.0, 1.0, 2.0], 1, RED);
        assert_eq!(at(&canvas, [62, 11]), RED);
        canvas.dot([-4.0, 1.0, 2.0], 1, BLUE);
        assert_eq!(at(&canvas, [62, 11]), RED);
        canvas.dot([3.0, 1.0, 2.0], 1, BLUE);
        assert_eq!(at(&canvas, [62, 11]), BLUE);
        assert_eq!(
            canvas.pixels.iter().filter(|p| **p != BACKGROUND).count(),
            1
        );
        // Objects outside the picture are not drawn.
        canvas.dot([0.0, 50.0, 0.0], 3, RED);
        canvas.line([[0.0, 40.0, -40.0], [0.0, 40.0, 40.0]], RED);
        assert_eq!(
            canvas.pixels.iter().filter(|p| **p != BACKGROUND).count(),
            1
        );
    }

    #[test]
    fn a_face_covers_its_area_hides_what_lies_behind_and_is_not_seen_from_behind() {
        let triangle = [[1.0, -2.0, -2.0], [1.0, 2.0, -2.0], [1.0, -2.0, 2.0]];
        let mut canvas = from_x();
        canvas.dot([0.0, -1.0, -1.0], 1, RED);
        canvas.line([[2.0, -2.0, -1.95], [2.0, 2.0, -1.95]], BLUE);
        canvas.face(triangle);
        let count = |canvas: &Canvas, of: fn(&[u8; 3]) -> bool| {
            canvas.pixels.iter().filter(|p| of(p)).count() as f64
        };
        assert_eq!(count(&canvas, |p| *p == RED), 0.0);
        assert!(count(&canvas, |p| *p == BLUE) >= 40.0);
        // Half of 40 px by 40 px. Its edges pass through the centres of 120 pixels, which may or may not count (Pick's theorem).
        let drawn = count(&canvas, |p| *p != BACKGROUND);
        assert!((741.0..=861.0).contains(&drawn), "{drawn}");
        // It faces the viewer.
        assert_eq!(at(&canvas, [42, 36]), [BRIGHT as u8; 3]);

        let [a, b, c] = triangle;
        let mut canvas = from_x();
        canvas.face([a, c, b]);
        assert_eq!(count(&canvas, |p| *p != BACKGROUND), 0.0);
    }

    #[test]
    fn from_above_heights_shrink_by_the_cosine_and_everything_fits() {
        let direction = [std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_3];
        let corners = [[0.0, 0.0, -4.0], [10.0, 0.0, 4.0]];
        let canvas = Canvas::fitting(corners.into_iter(), [105, 60], direction);
        // Seen from y, x runs to the left; 5 mm is in the centre.
        let seen = canvas.seen([4.0, 0.0, 2.0]);
        let expected = [62.5, 20.0, 3.0_f64.sqrt()];
        let off = (0..3).map(|k| (seen[k] - expected[k]).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{seen:?}");
        // A tall object needs another scale.
        let tall = [[0.0, 0.0, -4.0], [1.0, 0.0, 4.0]];
        let canvas = Canvas::fitting(tall.into_iter(), [105, 21], direction);
        assert!((canvas.px_per_mm - 5.0).abs() < 1e-9);
        // A single point has no size.
        let canvas = Canvas::fitting([[1.0; 3]].into_iter(), [105, 21], direction);
        assert_eq!(canvas.seen([1.0; 3])[0], 52.5);
    }
}
