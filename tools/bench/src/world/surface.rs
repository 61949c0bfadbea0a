//! Reflection by the die's surface: matt spray, bare steel, steel under oil, with local variation.

use super::random::hash;
use super::{WorldError, microfacet};
use nalgebra::{Point3, Vector3};
use std::f64::consts::PI;

/// Diffuse reflectance of a matt sprayed surface, the reference for highlights.
pub(crate) const SPRAYED_RATIO: f64 = 0.3;

/// Reflectance of the die.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Fraction of light that is reflected diffusely.
    pub diffuse_ratio: f64,
    /// Relative standard deviation of the diffuse reflectance over the surface.
    pub roughness_ratio: f64,
    /// Size of the patches in which it varies, mm.
    pub grain_mm: f64,
    /// Height of the highlight relative to the sprayed surface's diffuse light.
    pub gloss_ratio: f64,
    /// Sharpness of the highlight: exponent of the cosine between normal and bisector (Blinn 1977).
    pub gloss_exponent: f64,
    /// Bare metal in addition.
    pub metal: Option<Metal>,
    /// A film of oil on all of it.
    pub oil: Option<Oil>,
}

/// Metal roughened by a tool, modelled by microfacets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metal {
    /// Fraction of the surface that is bare.
    pub share: f64,
    /// Roughness (Walter et al. 2007): slope of the microfacets.
    pub alpha: f64,
    /// Real part of the index of refraction.
    pub eta: f64,
    /// Its imaginary part.
    pub k: f64,
}

/// A transparent film, which reflects, and refracts the light on its way to the metal and back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oil {
    /// Index of refraction.
    pub index: f64,
    /// Roughness of its surface, due to waves.
    pub alpha: f64,
}

/// Edge between sprayed and bare surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SprayEdge {
    /// The die is sprayed above this height, mm in the tool frame.
    pub above_mm: f64,
    /// Raggedness of the edge's height, standard deviation in mm.
    pub ragged_mm: f64,
}

/// Refractive index of steel at about 530 nm.
const STEEL: (f64, f64) = (2.4, 3.4);
/// Size of the irregularities of a spray's edge, mm.
const SPRAY_LOBE_MM: f64 = 0.3;
/// Factor by which a film widens the reflection lobe of the metal below it: approximately its index.
const WIDENED: f64 = 1.4;

/// A direction from which light is reflected to an eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scattered {
    /// Unit vector away from the surface.
    pub towards: Vector3<f64>,
    /// Weight of the light from there, such that the mean over draws is the total light.
    pub weight: f64,
    /// Probability density of this direction, per steradian.
    pub density_per_sr: f64,
}

impl Surface {
    /// Matt spray, as metrologists apply it to a tool.
    pub fn sprayed() -> Self {
        Self {
            diffuse_ratio: SPRAYED_RATIO,
            roughness_ratio: 0.03,
            grain_mm: 0.12,
            gloss_ratio: 0.15,
            gloss_exponent: 24.0,
            metal: None,
            oil: None,
        }
    }

    /// Ground tool steel: mainly a lobe of roughness 0.3, and a little diffuse reflection.
    pub fn ground() -> Self {
        Self {
            diffuse_ratio: 0.15 * 0.3,
            roughness_ratio: 0.25,
            grain_mm: 0.06,
            gloss_ratio: 0.0,
            gloss_exponent: 1.0,
            metal: Some(Metal {
                share: 0.85,
                alpha: 0.3,
                eta: STEEL.0,
                k: STEEL.1,
            }),
            oil: None,
        }
    }

    /// Smoother steel, as after years in a press: a lobe of roughness 0.15 alone.
    pub fn polished() -> Self {
        Self {
            diffuse_ratio: 0.0,
            roughness_ratio: 0.0,
            metal: Some(Metal {
                share: 1.0,
                alpha: 0.15,
                eta: STEEL.0,
                k: STEEL.1,
            }),
            ..Self::ground()
        }
    }

    /// Ground steel under mineral oil.
    pub fn oiled() -> Self {
        Self {
            oil: Some(Oil {
                index: 1.47,
                alpha: 0.05,
            }),
            ..Self::ground()
        }
    }

    /// Light towards the eye relative to the light on a plane facing the lamp: π times the bidirectional reflectance and the
    /// cosine of incidence. All directions are unit vectors away from the surface.
    pub(crate) fn returned(
        &self,
        seed: u64,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        lamp: Vector3<f64>,
        eye: Vector3<f64>,
    ) -> f64 {
        let incidence = normal.dot(&lamp);
        let seen = normal.dot(&eye);
        if incidence <= 0.0 || seen <= 0.0 {
            return 0.0;
        }
        let Some(oil) = &self.oil else {
            return self.reflectance(seed, p_tool, normal, lamp, eye) * incidence;
        };
        // Light that the film reflects back to the metal from inside is neglected: the model loses this light and never gains any.
        let passed = [incidence, seen].map(|cos| 1.0 - microfacet::clear(cos, oil.index));
        let [lamp_inside, eye_inside] =
            [lamp, eye].map(|way| microfacet::refracted(&way, &normal, oil.index));
        let below = passed[0] * passed[1] / (oil.index * oil.index)
            * self.reflectance(seed, p_tool, normal, lamp_inside, eye_inside);
        let bisector = (lamp + eye).normalize();
        let above = microfacet::mirrors(oil.alpha, &normal, &bisector, [incidence, seen])
            * microfacet::clear(lamp.dot(&bisector), oil.index);
        (below + above) * incidence
    }

    /// π times the bidirectional reflectance without the film.
    fn reflectance(
        &self,
        seed: u64,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        lamp: Vector3<f64>,
        eye: Vector3<f64>,
    ) -> f64 {
        let bisector = (lamp + eye).normalize();
        let gloss = if self.gloss_ratio > 0.0 {
            self.gloss_ratio
                * SPRAYED_RATIO
                * normal.dot(&bisector).max(0.0).powf(self.gloss_exponent)
        } else {
            0.0
        };
        // Limited to three standard deviations, so that no patch is black or twice as bright.
        let patch = if self.roughness_ratio > 0.0 {
            1.0 + self.roughness_ratio * grain(seed, p_tool.coords / self.grain_mm).clamp(-3.0, 3.0)
        } else {
            1.0
        };
        let dull = self.diffuse_ratio * patch.max(0.05) + gloss;
        let Some(metal) = &self.metal else {
            return dull;
        };
        let cosines = [normal.dot(&lamp), normal.dot(&eye)];
        let fresnel = microfacet::metal(lamp.dot(&bisector), metal.eta, metal.k);
        dull + metal.share * fresnel * microfacet::mirrors(metal.alpha, &normal, &bisector, cosines)
    }

    /// A random direction from which light is reflected to the eye, from three uniform numbers. `None` below the surface.
    pub(crate) fn scattered(
        &self,
        seed: u64,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        eye: Vector3<f64>,
        [choice, u, v]: [f64; 3],
    ) -> Option<Scattered> {
        let lobes = self.lobes();
        let mut rest = choice;
        let chosen = lobes.iter().find(|(share, _)| {
            rest -= share;
            rest < 0.0
        });
        let (_, chosen) = chosen.unwrap_or(&lobes[0]);
        let from = match chosen {
            None => microfacet::by_cosine(&normal, [u, v]),
            Some(alpha) => microfacet::by_mirror(*alpha, &normal, &eye, [u, v]),
        };
        let (cos, seen) = (normal.dot(&from), normal.dot(&eye));
        if cos <= 0.0 || seen <= 0.0 {
            return None;
        }
        let bisector = (from + eye).normalize();
        let density: f64 = lobes
            .iter()
            .filter(|(share, _)| *share > 0.0)
            .map(|(share, lobe)| {
                share
                    * match lobe {
                        None => cos / PI,
                        Some(alpha) => {
                            microfacet::by_mirror_density(*alpha, &normal, &bisector, seen)
                        }
                    }
            })
            .sum();
        let returned = self.returned(seed, p_tool, normal, from, eye);
        Some(Scattered {
            towards: from,
            weight: returned / (PI * density),
            density_per_sr: density,
        })
    }

    /// Fractions of the draws, and their distributions: cosine, or microfacets of a roughness. The first is never empty without metal.
    fn lobes(&self) -> [(f64, Option<f64>); 3] {
        let Some(metal) = &self.metal else {
            return [(1.0, None), (0.0, None), (0.0, None)];
        };
        match &self.oil {
            None if self.diffuse_ratio + self.gloss_ratio == 0.0 => {
                [(1.0, Some(metal.alpha)), (0.0, None), (0.0, None)]
            }
            None => [(0.85, Some(metal.alpha)), (0.15, None), (0.0, None)],
            Some(oil) => [
                (0.7, Some((WIDENED * metal.alpha).min(1.0))),
                (0.15, None),
                (0.15, Some(oil.alpha)),
            ],
        }
    }

    pub(crate) fn validate(&self) -> Result<(), WorldError> {
        WorldError::check("diffuse_ratio", self.diffuse_ratio, 0.0, 1.0)?;
        WorldError::check("roughness_ratio", self.roughness_ratio, 0.0, 1.0)?;
        WorldError::check("grain_mm", self.grain_mm, 1e-3, 100.0)?;
        WorldError::check("gloss_ratio", self.gloss_ratio, 0.0, 1e3)?;
        WorldError::check("gloss_exponent", self.gloss_exponent, 1.0, 1e5)?;
        if let Some(metal) = &self.metal {
            WorldError::check("metal share", metal.share, 0.0, 1.0 - self.diffuse_ratio)?;
            WorldError::check("metal alpha", metal.alpha, 0.02, 1.0)?;
            WorldError::check("metal eta", metal.eta, 0.1, 10.0)?;
            WorldError::check("metal k", metal.k, 0.0, 20.0)?;
        }
        if let Some(oil) = &self.oil {
            WorldError::check("oil index", oil.index, 1.0, 2.0)?;
            WorldError::check("oil alpha", oil.alpha, 0.02, 1.0)?;
        }
        Ok(())
    }
}

/// The surface of a die, which may be sprayed in part.
#[derive(Clone, Debug)]
pub(crate) struct Finish {
    bare: Surface,
    sprayed: Surface,
    edge: Option<SprayEdge>,
    seed: u64,
}

impl Finish {
    pub(crate) fn new(
        bare: Surface,
        edge: Option<SprayEdge>,
        seed: u64,
    ) -> Result<Self, WorldError> {
        bare.validate()?;
        if let Some(edge) = &edge {
            WorldError::check("edge of the spray, mm", edge.above_mm, -1e3, 1e3)?;
            WorldError::check("its raggedness, mm", edge.ragged_mm, 0.0, 10.0)?;
        }
        Ok(Self {
            bare,
            sprayed: Surface::sprayed(),
            edge,
            seed,
        })
    }

    /// The surface at a position.
    fn at(&self, p_tool: Point3<f64>) -> &Surface {
        let sprayed = self.edge.is_some_and(|edge| {
            let off = grain(self.seed, p_tool.coords / SPRAY_LOBE_MM).clamp(-3.0, 3.0);
            p_tool.z > edge.above_mm + edge.ragged_mm * off
        });
        if sprayed { &self.sprayed } else { &self.bare }
    }

    /// See [`Surface::returned`].
    pub(crate) fn returned(
        &self,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        lamp: Vector3<f64>,
        eye: Vector3<f64>,
    ) -> f64 {
        self.at(p_tool)
            .returned(self.seed, p_tool, normal, lamp, eye)
    }

    /// See [`Surface::scattered`].
    pub(crate) fn scattered(
        &self,
        p_tool: Point3<f64>,
        normal: Vector3<f64>,
        eye: Vector3<f64>,
        draws: [f64; 3],
    ) -> Option<Scattered> {
        self.at(p_tool)
            .scattered(self.seed, p_tool, normal, eye, draws)
    }
}

/// Smooth noise of unit variance in space: random values on a lattice, interpolated.
fn grain(seed: u64, p: Vector3<f64>) -> f64 {
    let cell = p.map(f64::floor);
    let s = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let mut sum = 0.0;
    let mut power = 0.0;
    for corner in 0..8u8 {
        let bit = |axis: u8| f64::from((corner >> axis) & 1);
        let weight: f64 = (0..3)
            .map(|axis| {
                let t = s[usize::from(axis)];
                if bit(axis) == 1.0 { t } else { 1.0 - t }
            })
            .product();
        let at = [0u8, 1, 2].map(|axis| cell[usize::from(axis)] as i64 + bit(axis) as i64);
        // Uniform in ±√3: unit variance.
        let value = (hash(seed, at) >> 11) as f64 / (1u64 << 53) as f64;
        sum += weight * 3f64.sqrt() * (2.0 * value - 1.0);
        power += weight * weight;
    }
    sum / power.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surfaces() -> Vec<(&'static str, Surface)> {
        let matt = Surface {
            gloss_ratio: 0.0,
            roughness_ratio: 0.0,
            ..Surface::sprayed()
        };
        let even = |surface| Surface {
            roughness_ratio: 0.0,
            ..surface
        };
        vec![
            ("matt", matt),
            ("sprayed", even(Surface::sprayed())),
            ("ground", even(Surface::ground())),
            ("polished", even(Surface::polished())),
            ("oiled", even(Surface::oiled())),
        ]
    }

    fn at(theta: f64, phi: f64) -> Vector3<f64> {
        let (sin, cos) = theta.sin_cos();
        Vector3::new(sin * phi.cos(), sin * phi.sin(), cos)
    }

    /// Total reflection to the eye from a uniformly bright sky, by integration over the hemisphere.
    fn albedo(surface: &Surface, eye: Vector3<f64>) -> f64 {
        let steps = 600;
        let mut sum = 0.0;
        for i in 0..steps {
            for k in 0..2 * steps {
                let theta = 0.5 * PI * (f64::from(i) + 0.5) / f64::from(steps);
                let phi = PI * (f64::from(k) + 0.5) / f64::from(steps);
                let cell = (0.5 * PI / f64::from(steps)) * (PI / f64::from(steps)) * theta.sin();
                let returned =
                    surface.returned(1, Point3::origin(), Vector3::z(), at(theta, phi), eye);
                sum += returned / PI * cell;
            }
        }
        sum
    }

    #[test]
    fn no_surface_returns_more_than_it_gets_and_draws_return_as_much_as_brute_force() {
        for (name, surface) in surfaces() {
            for degrees in [0f64, 40.0, 70.0, 82.0] {
                let eye = at(degrees.to_radians(), 0.3);
                let all = albedo(&surface, eye);
                assert!(all <= 1.0, "{name} at {degrees}: {all}");
                if name == "matt" {
                    assert!((all - SPRAYED_RATIO).abs() < 1e-4);
                }
                // Van der Corput sequences in three bases replace random numbers.
                let count = 60_000u32;
                let radical = |mut i: u32, base: u32| {
                    let (mut value, mut digit) = (0.0, 1.0 / f64::from(base));
                    while i > 0 {
                        value += f64::from(i % base) * digit;
                        digit /= f64::from(base);
                        i /= base;
                    }
                    value
                };
                let drawn: f64 = (1..=count)
                    .filter_map(|i| {
                        let draws = [radical(i, 2), radical(i, 3), radical(i, 5)];
                        surface.scattered(1, Point3::origin(), Vector3::z(), eye, draws)
                    })
                    .map(|way| way.weight)
                    .sum::<f64>()
                    / f64::from(count);
                assert!(
                    (drawn / all - 1.0).abs() < 0.01,
                    "{name} at {degrees} degrees: {drawn}, not {all}"
                );
            }
        }
    }

    #[test]
    fn mirrors_that_absorb_nothing_lose_only_what_they_shade() {
        // A nearly perfect conductor. A single reflection of a rough face loses some light between its microfacets, a smooth one none.
        let white = |alpha| Surface {
            diffuse_ratio: 0.0,
            metal: Some(Metal {
                share: 1.0,
                alpha,
                eta: 1.0,
                k: 1e3,
            }),
            ..Surface::polished()
        };
        let eye = at(0.5, 0.0);
        let [smooth, rough] = [0.05, 0.5].map(|alpha| albedo(&white(alpha), eye));
        assert!((0.995..1.0).contains(&smooth), "{smooth}");
        assert!((0.6..0.8).contains(&rough), "{rough}");
    }

    #[test]
    fn lamp_and_eye_may_change_places() {
        for (name, surface) in surfaces() {
            for (a, b) in [(at(0.2, 0.1), at(1.2, 2.0)), (at(1.4, 0.0), at(0.9, 3.1))] {
                let there = surface.returned(1, Point3::origin(), Vector3::z(), a, b) / a.z;
                let back = surface.returned(1, Point3::origin(), Vector3::z(), b, a) / b.z;
                assert!((there / back - 1.0).abs() < 1e-9, "{name}: {there}, {back}");
            }
        }
    }

    #[test]
    fn oil_sends_light_to_where_bare_steel_is_dark_and_takes_some_where_it_shines() {
        let [bare, oiled] = [Surface::ground(), Surface::oiled()];
        let light = |s: &Surface, lamp, eye| {
            s.returned(
                1,
                Point3::origin(),
                Vector3::z(),
                at(lamp, 0.0),
                at(eye, PI),
            )
        };
        assert!(
            light(&oiled, 0.3, 0.3) > light(&bare, 0.3, 0.3),
            "its own highlight"
        );
        assert!(
            light(&oiled, 0.5, 0.2) < light(&bare, 0.5, 0.2),
            "beside it"
        );
    }

    #[test]
    fn a_die_sprayed_in_part_is_sprayed_above_the_edge() {
        let edge = SprayEdge {
            above_mm: 33.0,
            ragged_mm: 0.2,
        };
        let finish = Finish::new(Surface::ground(), Some(edge), 4).unwrap();
        let sprayed = |z: f64| {
            let of = (0..1000).filter(|i| {
                let place = Point3::new(0.37 * f64::from(*i), 0.0, z);
                finish.at(place) == &Surface::sprayed()
            });
            of.count()
        };
        assert_eq!([sprayed(32.3), sprayed(33.7)], [0, 1000]);
        assert!((300..700).contains(&sprayed(33.0)));
        let nowhere = Finish::new(Surface::ground(), None, 4).unwrap();
        assert_eq!(nowhere.at(Point3::new(0.0, 0.0, 99.0)), &Surface::ground());
    }
}
