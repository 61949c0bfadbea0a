//! Closest point of one triangle, with the feature (face, edge, corner) on which it lies.

use nalgebra::Vector3;

use crate::space::unit_normal;

/// The part of a triangle that holds a closest point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Feature {
    /// The interior.
    Face,
    /// Edge k, from corner k to corner (k + 1) mod 3.
    Edge(u8),
    /// Corner k.
    Corner(u8),
}

/// A triangle prepared for closest-point queries: one corner, two edges and their dot products.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prepared {
    a: Vector3<f64>,
    ab: Vector3<f64>,
    ac: Vector3<f64>,
    /// Unit normal; zero when the triangle has no area.
    normal: Vector3<f64>,
    ab_ab: f64,
    ab_ac: f64,
    ac_ac: f64,
}

/// Closest point of one triangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearestOnTriangle {
    pub point: Vector3<f64>,
    pub distance2_mm2: f64,
    pub feature: Feature,
}

impl Prepared {
    /// Prepares a triangle. One without area becomes the segment from its first to its second corner, so callers turn
    /// such triangles until that is the longest edge.
    pub fn new(corners: [[f64; 3]; 3]) -> Self {
        let normal = unit_normal(corners);
        let [a, b, c] = corners.map(Vector3::from);
        let ab = b - a;
        let ac = if normal.is_some() { c - a } else { ab };
        Self {
            a,
            ab,
            ac,
            normal: normal.map_or_else(Vector3::zeros, Vector3::from),
            ab_ab: ab.norm_squared(),
            ab_ac: ab.dot(&ac),
            ac_ac: ac.norm_squared(),
        }
    }

    /// Unit normal; zero when the triangle has no area.
    #[inline(always)]
    pub fn normal(&self) -> Vector3<f64> {
        self.normal
    }

    /// The closest point to `p`: Voronoi regions after Ericson, Real-Time Collision Detection (2005), section 5.1.5, with
    /// two changes: the dot products at b and c follow from those at a, and inside the face the distance is taken along
    /// the normal, which keeps long thin triangles exact where barycentric weights lose digits.
    #[inline(always)]
    pub fn nearest(&self, p: Vector3<f64>) -> NearestOnTriangle {
        let ap = p - self.a;
        let d1 = self.ab.dot(&ap);
        let d2 = self.ac.dot(&ap);
        if d1 <= 0.0 && d2 <= 0.0 {
            return self.at(p, self.a, Feature::Corner(0));
        }
        let d3 = d1 - self.ab_ab;
        let d4 = d2 - self.ab_ac;
        if d3 >= 0.0 && d4 <= d3 {
            return self.at(p, self.a + self.ab, Feature::Corner(1));
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let t = d1 / self.ab_ab;
            return self.at(p, self.a + self.ab * t, Feature::Edge(0));
        }
        let d5 = d1 - self.ab_ac;
        let d6 = d2 - self.ac_ac;
        if d6 >= 0.0 && d5 <= d6 {
            return self.at(p, self.a + self.ac, Feature::Corner(2));
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let t = d2 / self.ac_ac;
            return self.at(p, self.a + self.ac * t, Feature::Edge(2));
        }
        let va = d3 * d6 - d5 * d4;
        let (along_b, along_c) = (d4 - d3, d5 - d6);
        if va <= 0.0 && along_b >= 0.0 && along_c >= 0.0 {
            let t = along_b / (along_b + along_c);
            let point = self.a + self.ab + (self.ac - self.ab) * t;
            return self.at(p, point, Feature::Edge(1));
        }
        self.foot(p)
    }

    /// Result of [`Prepared::nearest`] for a point whose foot on the triangle's plane lies inside.
    #[inline(always)]
    pub fn foot(&self, p: Vector3<f64>) -> NearestOnTriangle {
        let height = self.normal.dot(&(p - self.a));
        NearestOnTriangle {
            point: p - self.normal * height,
            distance2_mm2: height * height,
            feature: Feature::Face,
        }
    }

    #[inline(always)]
    fn at(&self, p: Vector3<f64>, point: Vector3<f64>, feature: Feature) -> NearestOnTriangle {
        NearestOnTriangle {
            point,
            distance2_mm2: (p - point).norm_squared(),
            feature,
        }
    }
}
