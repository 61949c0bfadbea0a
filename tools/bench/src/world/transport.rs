//! Light from the lamp to an eye by the die: directly, and with further reflections at other parts of the die.
//!
//! Further reflections are followed backwards (path tracing, Kajiya 1986): from a point that an eye sees, directions are drawn by
//! its scattering distribution, and where they hit the die, the light of the lamp is added. All frequencies and the uniform light
//! are carried at once, because light is linear: one tracing serves all frames of a view.

use super::lamp::{Lamp, Patch};
use super::rays::RayCaster;
use super::scene::{LANES, Lanes};
use super::surface::{Finish, Scattered};
use nalgebra::{Point3, Vector3};
use rand::RngExt;

/// Offset of a ray's start from the surface, mm: more than rounding errors, less than any feature.
pub(crate) const START_MM: f64 = 5e-4;

/// Standard deviation of a Gaussian relative to the side of the square that it represents; fringes with a period of one side are
/// reduced to one hundredth.
const SIGMA_PER_SIDE: f64 = 0.5;

/// A point of the die, and the direction to the eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub point: Point3<f64>,
    /// Unit vector out of the material.
    pub normal: Vector3<f64>,
    /// Unit vector towards the eye.
    pub eye: Vector3<f64>,
}

/// The die's surface for light transport.
pub(crate) struct Transport<'a> {
    pub rays: &'a RayCaster,
    pub finish: &'a Finish,
    /// Whether both sides of triangles reflect, because their orientation does not show the side of the material.
    pub either_side: bool,
    /// Largest number of reflections; 1 is direct light alone.
    pub bounces: u32,
}

impl Transport<'_> {
    /// Light directly from the lamp that a spot reflects to its eye.
    pub(crate) fn direct(&self, lamp: &impl Lamp, at: &Spot) -> Option<Lanes> {
        self.direct_about(lamp, at, 0.0)
    }

    /// The same light, with the fringes averaged over a patch about the spot.
    fn direct_about(&self, lamp: &impl Lamp, at: &Spot, sigma_mm: f64) -> Option<Lanes> {
        let to_lamp = lamp.position() - at.point;
        if at.normal.dot(&to_lamp) <= 0.0 {
            return None;
        }
        let arriving = lamp.arriving(&Patch {
            point: at.point,
            normal: at.normal,
            sigma_mm,
        })?;
        let start = at.point + START_MM * at.normal;
        if self.rays.blocked(start, lamp.position()) {
            return None;
        }
        let returned =
            self.finish
                .returned(at.point, at.normal, to_lamp.normalize(), at.eye) as f32;
        Some(arriving.map(|lane| lane * returned))
    }

    /// Light with at least one further reflection that a spot reflects to its eye: the mean of `paths` light paths.
    pub(crate) fn indirect(
        &self,
        lamp: &impl Lamp,
        at: &Spot,
        paths: u32,
        random: &mut impl rand::Rng,
    ) -> Lanes {
        let mut sum = [0f64; LANES];
        if self.bounces > 1 {
            let turn = std::array::from_fn(|_| random.random());
            // First directions are spread evenly over the lobes, with another rotation for each spot.
            for first in spread(turn).take(paths as usize) {
                self.follow(lamp, *at, first, f64::from(paths), random, &mut sum);
            }
        }
        sum.map(|lane| (lane / f64::from(paths.max(1))) as f32)
    }

    /// Follows one of `ways` light paths, with three uniform numbers for its first direction, and adds its reflected light.
    ///
    /// Fringes are finer than the distance between two paths, so those of single paths would remain where the mean of many washes
    /// out. Each path therefore uses the mean over the patch of a face that it represents (path differentials: Suykens and
    /// Willems 2001).
    pub(crate) fn follow(
        &self,
        lamp: &impl Lamp,
        mut at: Spot,
        first: [f64; 3],
        ways: f64,
        random: &mut impl rand::Rng,
        sum: &mut [f64; LANES],
    ) {
        let mut share = 1.0;
        // Squared distances between the ends of neighbouring paths for one path per direction, mm².
        let mut apart_mm2 = 0.0;
        for touched in 1..self.bounces {
            let draws = if touched == 1 {
                first
            } else {
                std::array::from_fn(|_| random.random())
            };
            let Some(Scattered {
                towards,
                weight,
                density_per_sr,
            }) = self.finish.scattered(at.point, at.normal, at.eye, draws)
            else {
                return;
            };
            share *= weight;
            let start = at.point + START_MM * at.normal;
            let Some(hit) = self.rays.nearest(start, towards) else {
                return;
            };
            let normal = match hit.normal.dot(&towards) {
                facing if facing < 0.0 => hit.normal,
                away if away > 0.0 && self.either_side => -hit.normal,
                _ => return,
            };
            at = Spot {
                point: start + hit.distance * towards,
                normal,
                eye: -towards,
            };
            apart_mm2 += hit.distance.powi(2) / density_per_sr;
            let patch_mm2 = apart_mm2 / (ways * normal.dot(&-towards));
            if let Some(light) = self.direct_about(lamp, &at, SIGMA_PER_SIDE * patch_mm2.sqrt()) {
                for (all, lane) in sum.iter_mut().zip(light) {
                    *all += share * f64::from(lane);
                }
            }
        }
    }
}

/// Infinite low-discrepancy sequence over the unit square or cube (Roberts 2018, R2 and R3), shifted by `turn`.
pub(crate) fn spread<const N: usize>(turn: [f64; N]) -> impl Iterator<Item = [f64; N]> {
    // The root of x^(N+1) = x + 1 above 1.
    let root = (0..40).fold(1.5f64, |root, _| (1.0 + root).powf(1.0 / (N as f64 + 1.0)));
    let steps: [f64; N] = std::array::from_fn(|axis| root.powi(-1 - axis as i32));
    (0u32..).map(move |number| {
        std::array::from_fn(|axis| (turn[axis] + f64::from(number) * steps[axis]).fract())
    })
}

#[cfg(test)]
mod tests {
    use super::super::random::{Purpose, stream};
    use super::super::surface::Surface;
    use super::*;
    use flankscope_gear_cad::Mesh;
    use std::f64::consts::PI;

    /// A lamp with light 1, measured on the surface, on selected points, and one fringe across y.
    struct Only<F> {
        position: Point3<f64>,
        normal: F,
    }

    impl<F: Fn(Point3<f64>) -> Option<Vector3<f64>> + Sync> Lamp for Only<F> {
        fn position(&self) -> Point3<f64> {
            self.position
        }
        fn arriving(&self, about: &Patch) -> Option<Lanes> {
            let p = about.point;
            let normal = (self.normal)(p)?;
            let cos = normal.dot(&(self.position - p).normalize());
            let mut lanes = [0f32; LANES];
            lanes[0] = (1.0 / cos) as f32;
            lanes[1] = (p.y.cos() / cos) as f32;
            Some(lanes)
        }
    }

    fn matt(ratio: f64) -> Finish {
        let surface = Surface {
            diffuse_ratio: ratio,
            roughness_ratio: 0.0,
            gloss_ratio: 0.0,
            ..Surface::sprayed()
        };
        Finish::new(surface, None, 1).unwrap()
    }

    /// Two triangles: corner and two edges, whose cross product is the normal.
    fn rectangles(of: &[[[f64; 3]; 3]]) -> RayCaster {
        let mut mesh = Mesh {
            vertices: vec![],
            triangles: vec![],
        };
        for [corner, u, v] in of {
            let first = mesh.vertices.len() as u32;
            for [along, across] in [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
                mesh.vertices
                    .push([0, 1, 2].map(|k| corner[k] + along * u[k] + across * v[k]));
            }
            mesh.triangles
                .extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| first + i)));
        }
        RayCaster::new(&mesh)
    }

    /// A spot at a position, seen along the normal from its side.
    fn spot(point: [f64; 3], normal: Vector3<f64>) -> Spot {
        let [along, _] = super::super::microfacet::tangents(&normal);
        Spot {
            point: point.into(),
            normal,
            eye: (normal + 0.3 * along).normalize(),
        }
    }

    fn indirect(transport: &Transport<'_>, lamp: &impl Lamp, at: &Spot, paths: u32) -> Lanes {
        transport.indirect(lamp, at, paths, &mut stream(5, Purpose::Paths(0)))
    }

    #[test]
    fn two_walls_light_each_other_as_their_form_factor_says() {
        let (a, b, c) = (2f64, 3f64, 1.5f64);
        let (x, y) = (a / c, b / c);
        // Howell, Menguc, Daun and Siegel, Thermal Radiation Heat Transfer, catalogue of configuration factors: an element
        // opposite the corner of a rectangle (B-3)
        let (ax, ay) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        let opposite = (x / ax * (y / ax).atan() + y / ay * (x / ay).atan()) / (2.0 * PI);
        // and one at the foot of a rectangle's corner perpendicular to its plane (B-4): b along the foot, a high, distance c.
        let square = ((b / c).atan() - c / a.hypot(c) * (b / a.hypot(c)).atan()) / (2.0 * PI);
        let walls = [
            // Above, looking down.
            ([[0.0, 0.0, c], [0.0, b, 0.0], [a, 0.0, 0.0]], opposite),
            // Beside, looking back along x: b wide in y, a high in z.
            ([[c, 0.0, 0.0], [0.0, 0.0, a], [0.0, b, 0.0]], square),
        ];
        for (wall, factor) in walls {
            let rays = rectangles(&[wall]);
            let [u, v] = [1, 2].map(|i| Vector3::from(wall[i]));
            let normal = u.cross(&v).normalize();
            let finish = matt(0.6);
            let transport = Transport {
                rays: &rays,
                finish: &finish,
                either_side: false,
                bounces: 5,
            };
            let lamp = Only {
                position: Point3::from(wall[0]) + 0.4 * u + 0.4 * v + 0.7 * normal,
                normal: |_| Some(normal),
            };
            let at = spot([0.0; 3], Vector3::z());
            let light = indirect(&transport, &lamp, &at, 40_000);
            let expected = 0.6 * 0.6 * factor;
            assert!(
                (f64::from(light[0]) / expected - 1.0).abs() < 0.01,
                "{} instead of {expected}",
                light[0]
            );
        }
    }

    #[test]
    fn in_a_closed_box_every_bounce_brings_what_the_last_one_left() {
        let box_of = [
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
            [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
            [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
            [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        ];
        let rays = rectangles(&box_of);
        let finish = matt(0.7);
        let inwards = |p: Point3<f64>| {
            let off = p.coords - Vector3::repeat(0.5);
            let axis = off.iamax();
            let mut normal = Vector3::zeros();
            normal[axis] = -off[axis].signum();
            Some(normal)
        };
        let lamp = Only {
            position: Point3::new(0.5, 0.5, 0.5),
            normal: inwards,
        };
        for bounces in [1, 2, 5] {
            let transport = Transport {
                rays: &rays,
                finish: &finish,
                either_side: false,
                bounces,
            };
            let at = spot([0.3, 0.6, 0.0], Vector3::z());
            let light = f64::from(indirect(&transport, &lamp, &at, 4_000)[0]);
            // With uniformly lit walls the form factors sum to 1 for any shape.
            let expected: f64 = (2..=bounces).map(|n| 0.7f64.powi(n as i32)).sum();
            assert!(
                (light - expected).abs() < 1e-3,
                "{bounces}: {light}, not {expected}"
            );
        }
    }

    #[test]
    fn steel_is_lit_over_steel_as_by_brute_force() {
        // Two flanks of a tooth space, 40 degrees apart, one lit by the lamp.
        let (sin, cos) = 20f64.to_radians().sin_cos();
        let wall = |side: f64| {
            let up = [side * sin, 0.0, cos];
            let [first, second] = if side > 0.0 {
                [[0.0, 2.0, 0.0], up]
            } else {
                [up, [0.0, 2.0, 0.0]]
            };
            // Their faces are opposite each other.
            [[side * 0.2, -1.0, 0.0], second, first]
        };
        let rays = rectangles(&[wall(1.0), wall(-1.0)]);
        let lamp = Only {
            position: Point3::new(-0.1, 0.4, 6.0),
            normal: |_| Some(Vector3::z()),
        };
        for surface in [Surface::ground(), Surface::polished(), Surface::oiled()] {
            let finish = Finish::new(surface, None, 3).unwrap();
            let transport = Transport {
                rays: &rays,
                finish: &finish,
                either_side: false,
                bounces: 2,
            };
            // On the left wall, halfway up; it faces right and slightly up.
            let normal = Vector3::new(cos, 0.0, sin);
            let point = Point3::new(-0.2 - 0.5 * sin, 0.1, 0.5 * cos);
            let eye = (Point3::new(0.1, -0.5, 6.0) - point).normalize();
            let at = Spot { point, normal, eye };
            let light = indirect(&transport, &lamp, &at, 60_000);
            // All directions equally, by a fine grid over the hemisphere.
            let steps = 500;
            let [along, across] = super::super::microfacet::tangents(&normal);
            let mut brute = [0.0; 2];
            for i in 0..steps {
                for k in 0..2 * steps {
                    let height = (f64::from(i) + 0.5) / f64::from(steps);
                    let turn = PI * (f64::from(k) + 0.5) / f64::from(steps);
                    let flat = (1.0 - height * height).sqrt();
                    let way = flat * (turn.cos() * along + turn.sin() * across) + height * normal;
                    let start = point + START_MM * normal;
                    let Some(hit) = rays.nearest(start, way) else {
                        continue;
                    };
                    let there = Spot {
                        point: start + hit.distance * way,
                        normal: hit.normal,
                        eye: -way,
                    };
                    if let Some(arriving) = transport.direct(&lamp, &there) {
                        let weight = finish.returned(point, normal, way, eye) / PI;
                        let cell = 2.0 * PI / (2.0 * f64::from(steps) * f64::from(steps));
                        for (sum, lane) in brute.iter_mut().zip(arriving) {
                            *sum += weight * cell * f64::from(lane);
                        }
                    }
                }
            }
            assert!(brute[0] > 1e-3, "the scene is lit");
            for (lane, by_force) in light.iter().zip(brute) {
                let off = f64::from(*lane) - by_force;
                assert!(
                    off.abs() < 0.02 * brute[0],
                    "{lane} instead of {by_force} on {finish:?}"
                );
            }
        }
    }

    #[test]
    fn light_that_may_touch_one_place_is_direct() {
        let rays = rectangles(&[[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
        let finish = matt(0.5);
        let transport = Transport {
            rays: &rays,
            finish: &finish,
            either_side: false,
            bounces: 1,
        };
        let lamp = Only {
            position: Point3::new(0.5, 0.5, 2.0),
            normal: |_| Some(Vector3::z()),
        };
        let at = spot([0.2, 0.2, 0.0], Vector3::z());
        assert_eq!(indirect(&transport, &lamp, &at, 100), [0.0; LANES]);
        let direct = transport.direct(&lamp, &at).unwrap();
        assert!((direct[0] - 0.5).abs() < 1e-6);
        let below = spot([0.2, 0.2, 0.0], -Vector3::z());
        assert!(transport.direct(&lamp, &below).is_none());
    }
}
