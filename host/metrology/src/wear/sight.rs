//! Intersections of a view's camera rays with the CAD's flanks, and the number of rays that brought no point from there.
//!
//! ```text
//!  camera ──ray──► CAD ─ ─ ► where the material really is
//!                   │              │
//!               ray's place    point's place: its foot on the CAD
//! ```
//!
//! Walls of a damage hide part of its floor from a camera that looks along the flank: the rays that would have shown it end on
//! the wall or beyond, their points lie elsewhere. Where more rays arrive than points lie, something was not seen, however
//! smooth the points are that were.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::Measured;
use super::field::Field;
use super::unseen::Unseen;
use crate::feature::Features;
use crate::gear::FlankPlace;
use crate::surface::{Closest, Surface};

/// A point farther from the CAD may belong to a ray that meets another face than the point's foot lies on, mm.
const FAR_MM: f64 = 0.02;
/// Cosine of the angle to the normal below which a ray grazes, so that its place is uncertain.
const GRAZING: f64 = 0.05;
/// Least number of dark rays in a block that counts; fewer are dead cores and specks of dust (one core in a thousand is dead).
const LEAST_DARK: u32 = 3;
/// Rays that chance may leave dark in a block, or with a point outside of it, standard deviations.
const ALLOWED_SIGMAS: f64 = 3.0;

/// The camera of a view, in the tool frame.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// The surface that it sees.
    pub surface: &'a Surface,
    /// Its centre of projection, mm.
    pub camera_mm: [f64; 3],
    /// Unit directions of the rays along which no fringes came back.
    pub dark: &'a [[f64; 3]],
    /// Unit directions of those that brought light of which no point could be made.
    pub undecoded: &'a [[f64; 3]],
    /// Nearest and farthest distance at which the head measures, mm.
    pub range_mm: [f64; 2],
    /// Direct light of every point, in any unit; empty where it is not known.
    pub light: &'a [f32],
}

impl Sight<'_> {
    /// Tangent of the angle between the ray to a point and the CAD's normal there.
    pub fn slant(&self, point: [f64; 3], closest: &Closest) -> f64 {
        let ray = Vector3::from(point) - Vector3::from(self.camera_mm);
        let normal = Vector3::from(closest.normal);
        // A ray along the surface would have no tangent.
        let cosine = (ray.dot(&normal).abs() / ray.norm()).max(GRAZING);
        (1.0 - cosine * cosine).max(0.0).sqrt() / cosine
    }

    /// Intersections of the rays to the points with flanks or patches of the CAD. `places` holds the points' own places.
    pub fn ray_places<'f>(
        &self,
        features: impl Into<Features<'f>>,
        measured: Measured<'_>,
        places: &[Option<FlankPlace>],
    ) -> Vec<FlankPlace> {
        let features = features.into();
        let points = measured.points.par_iter().zip(measured.closest);
        let of_points = points.zip(places).filter_map(|((point, closest), place)| {
            self.of_point(features, *point, closest, *place)
        });
        of_points.collect()
    }

    /// Intersections of rays without a point.
    pub fn places_along<'f>(
        &self,
        features: impl Into<Features<'f>>,
        directions: &[[f64; 3]],
    ) -> Vec<FlankPlace> {
        let features = features.into();
        directions
            .par_iter()
            .filter_map(|direction| self.first_met(features, Vector3::from(*direction)))
            .collect()
    }

    fn of_point(
        &self,
        features: Features<'_>,
        point: [f64; 3],
        closest: &Closest,
        place: Option<FlankPlace>,
    ) -> Option<FlankPlace> {
        let from = Vector3::from(point) - Vector3::from(self.camera_mm);
        let off_mm = closest.signed_distance_mm;
        if place.is_some() {
            // The flank is flat over the length of a deviation.
            let direction = from.normalize();
            let cosine = direction.dot(&Vector3::from(closest.normal));
            if cosine.abs() < GRAZING {
                return place;
            }
            let met = Vector3::from(point) - direction * (off_mm / cosine);
            return features.place_near(met.into(), closest);
        }
        // Deep under an edge, or far off: its ray may have met a flank on the way.
        (off_mm.abs() > FAR_MM)
            .then(|| self.first_met(features, from.normalize()))
            .flatten()
    }

    /// First intersection of a ray with the surface; none off the flanks.
    fn first_met(&self, features: Features<'_>, direction: Vector3<f64>) -> Option<FlankPlace> {
        let met = self
            .surface
            .first_met(self.camera_mm, direction.into(), self.range_mm)?;
        features.place(&met)
    }
}

/// Rays that meet the cells of a zone in one view, and points that lie in them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RayCounts {
    /// All of them.
    pub rays: Vec<u32>,
    /// Those along which no fringes came back.
    pub dark: Vec<u32>,
    /// Those that brought light, but no point.
    pub undecoded: Vec<u32>,
    pub points: Vec<u32>,
    /// Sum of the points' direct light.
    pub light: Vec<f64>,
    /// Mean tangent of the angle between the rays and the flank's normal.
    pub slant: f64,
}

impl RayCounts {
    pub fn new(cells: usize) -> Self {
        Self {
            rays: vec![0; cells],
            dark: vec![0; cells],
            undecoded: vec![0; cells],
            points: vec![0; cells],
            light: vec![0.0; cells],
            slant: 0.0,
        }
    }
}

/// Numbers in a cell and the cells around it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Block {
    rays: u32,
    points: u32,
    dark: u32,
    undecoded: u32,
    /// More are dark than by chance, were those of the whole zone spread evenly over it.
    is_shadow: bool,
}

/// Points and rays per cell of a zone: of all views, by the one that brought most points from it and the cells around it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Visibility {
    /// Of that view in those cells; nothing where there is no point in the cell itself.
    blocks: Vec<Block>,
    /// Logarithm of the mean light of that view's points in the cell itself; not a number where it is not known.
    light: Vec<f64>,
    /// Largest tangent of the angle between rays and normal.
    slant: f64,
}

impl Visibility {
    /// Of one view. A point on the border of two cells falls into the one or the other, which over nine cells hardly counts.
    /// Cells without points are left out: they count as holes.
    pub fn from_counts(counts: &RayCounts, field: &Field) -> Self {
        let seen = |cell: &usize| counts.points[*cell] > 0;
        let block = |cell: usize| {
            let all = field.around(cell).chain([cell]).filter(seen);
            all.fold(Block::default(), |sum, c| Block {
                rays: sum.rays + counts.rays[c],
                points: sum.points + counts.points[c],
                dark: sum.dark + counts.dark[c],
                undecoded: sum.undecoded + counts.undecoded[c],
                is_shadow: false,
            })
        };
        let sum = |of: &[u32]| f64::from(of.iter().sum::<u32>());
        let dark_ratio = sum(&counts.dark) / sum(&counts.rays).max(1.0);
        let is_shadow = |block: &Block| {
            let expected = dark_ratio * f64::from(block.rays);
            let sigma = (expected * (1.0 - dark_ratio)).sqrt();
            block.dark >= LEAST_DARK && f64::from(block.dark) > expected + ALLOWED_SIGMAS * sigma
        };
        let blocks = (0..counts.points.len())
            .map(|cell| {
                if !seen(&cell) {
                    return Block::default();
                }
                let block = block(cell);
                Block {
                    is_shadow: is_shadow(&block),
                    ..block
                }
            })
            .collect();
        let light = counts.light.iter().zip(&counts.points);
        Self {
            blocks,
            light: light
                .map(|(sum, &points)| Some(sum / f64::from(points)).filter(|mean| *mean > 0.0))
                .map(|mean| mean.map_or(f64::NAN, f64::ln))
                .collect(),
            slant: counts.slant,
        }
    }

    /// Adds another view: a cell that one view shows is not hidden.
    pub fn add(&mut self, other: &Self) {
        let own = self.blocks.iter_mut().zip(&mut self.light);
        for ((best, light), (block, its)) in own.zip(other.blocks.iter().zip(&other.light)) {
            if block.points > best.points {
                (*best, *light) = (*block, *its);
            }
        }
        self.slant = self.slant.max(other.slant);
    }

    /// Logarithm of each cell's mean light; not a number where it is not known.
    pub fn light(&self) -> &[f64] {
        &self.light
    }

    /// Largest tangent of the angle between rays and normal.
    pub fn slant(&self) -> f64 {
        self.slant
    }

    /// Share of each cell in the shadow of a wall: that of its rays for which no point lies there.
    ///
    /// A ray along which no fringes came back says nothing of what it met; where light is scarce some are dark everywhere, and
    /// only what lies together counts. Light of which no point could be made met something: on bare steel its second reflections
    /// are why. Such rays count where more are missing than a strip as wide as points lie apart. Of the others the point may lie
    /// elsewhere, but beside its place on the CAD by its depth times the slant, so that of every border some pairs of ray and
    /// point lie on both sides: as many as points lie within that distance of it. They count as independent, three standard
    /// deviations are allowed, and one ray more. Where the surface seen at one border lies deeper than at the opposite one, as many
    /// points more leave there as the difference tells. Where the surface falls away from the camera its points lie farther apart: what
    /// lies deeper on one side and is seen there is not hidden. What those may hide is an opening as wide as they are, which
    /// begins where the deepest cell about it ends.
    pub fn shadows(&self, field: &Field, noise_scale: f64) -> Vec<Unseen> {
        let shadow = |(cell, block): (usize, &Block)| {
            if block.points == 0 {
                return Unseen::default();
            }
            let share = |count: u32| f64::from(count) / f64::from(block.rays);
            let dark = if block.is_shadow {
                share(block.dark)
            } else {
                0.0
            };
            let undecoded = share(block.undecoded) - 1.0 / f64::from(block.points).sqrt();
            let without_point = Unseen {
                share: dark + undecoded.max(0.0),
                depth_mm: f64::INFINITY,
                behind_walls: dark > 0.0,
            };
            without_point.or(self.moved(field, cell, block, noise_scale))
        };
        self.blocks.iter().enumerate().map(shadow).collect()
    }

    /// Shadow in each cell by rays whose points lie elsewhere.
    fn moved(&self, field: &Field, cell: usize, block: &Block, noise_scale: f64) -> Unseen {
        let block_mm = 3.0 * field.cell_area_mm2().sqrt();
        let points = f64::from(block.points);
        // On a slope that falls away from the camera points lie as much farther apart.
        let slope = field.slope(cell) * self.slant;
        let all = f64::from(block.rays - block.dark - block.undecoded) / (1.0 + slope);
        // More points leave a block where it ends in a groove than come in where it begins before it.
        let rays = all - points * (self.slant * field.step_mm(cell) / block_mm).min(1.0);
        let depths = || {
            let all = field.window(cell, 1).map(|c| field.wear_mm[c]);
            all.filter(|wear| wear.is_finite())
        };
        let count = depths().count() as f64;
        let square_mm2 = depths().map(|wear| wear * wear).sum::<f64>() / count;
        // Of single points, of which each cell has so many.
        let noise_mm2 = noise_scale * noise_scale * field.variance_mm2[cell] * points / count;
        let off_mm = self.slant * (square_mm2 + noise_mm2).sqrt();
        let crossing = 2.0 * points * (off_mm / block_mm).min(1.0);
        if rays - points < 1.0 + ALLOWED_SIGMAS * (1.0 + crossing).sqrt() {
            return Unseen::default();
        }
        let share = 1.0 - points / rays;
        let rim_mm = depths().fold(0.0, f64::max);
        Unseen::opening(share, share * block_mm, rim_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::Flank;
    use crate::gear::tests::ring84;
    use crate::io::mesh::TriMesh;

    /// The flank's middle millimetre by eight of tooth 40, in facets of 20 µm along the profile.
    fn patch() -> Surface {
        let gear = ring84();
        let (columns, rows) = (51_usize, 2);
        let mut mesh = TriMesh {
            vertices: Vec::new(),
            triangles: Vec::new(),
        };
        for row in 0..rows {
            for column in 0..columns {
                let radius = 41.4 + 0.02 * column as f64;
                let height = 29.0 + 8.0 * row as f64;
                let vertex = gear.flank_point(40, Flank::Left, radius, height);
                mesh.vertices.push(vertex.unwrap());
            }
        }
        for column in 0..columns as u32 - 1 {
            let [a, b] = [column, column + columns as u32];
            mesh.triangles.extend([[a, b, a + 1], [a + 1, b, b + 1]]);
        }
        let surface = Surface::new(&mesh).unwrap();
        // Outwards: where the closed form says so.
        let foot = gear.flank_point(40, Flank::Left, 41.8, 33.0).unwrap();
        let normal = gear.flank_normal(Flank::Left, foot);
        let out: [f64; 3] = std::array::from_fn(|k| foot[k] + 0.1 * normal[k]);
        if surface.closest(out).signed_distance_mm > 0.0 {
            return surface;
        }
        for triangle in &mut mesh.triangles {
            triangle.swap(1, 2);
        }
        Surface::new(&mesh).unwrap()
    }

    /// In front of the flank, 20 mm away, so that the rays meet it at some 60 degrees.
    fn camera() -> [f64; 3] {
        let foot = ring84().flank_point(40, Flank::Left, 41.8, 33.0).unwrap();
        let normal = Vector3::from(ring84().flank_normal(Flank::Left, foot));
        let along = Vector3::new(-normal.y, normal.x, 0.0);
        let inwards = if along.dot(&Vector3::from(foot)) > 0.0 {
            -along
        } else {
            along
        };
        (Vector3::from(foot) + 20.0 * (0.5 * normal + 0.75f64.sqrt() * inwards)).into()
    }

    const NO_POINTS: Measured<'static> = Measured {
        points: &[],
        closest: &[],
        sigma_mm: None,
        sight: None,
    };

    #[test]
    fn rays_meet_the_flank_where_they_were_aimed_at() {
        let (gear, surface, camera_mm) = (ring84(), patch(), camera());
        let towards = |radius: f64, height: f64| {
            let at = gear.flank_point(40, Flank::Left, radius, height).unwrap();
            (Vector3::from(at) - Vector3::from(camera_mm), at)
        };
        let aims = [[41.6, 31.0], [41.8, 33.0], [42.1, 35.5]];
        for [radius, height] in aims {
            let (to, at) = towards(radius, height);
            let directions = [to.normalize().into()];
            let sight = Sight {
                surface: &surface,
                camera_mm,
                dark: &directions,
                undecoded: &[],
                range_mm: [15.0, 30.0],
                light: &[],
            };
            let near = |place: &FlankPlace| {
                // The march ends 5 µm in front of the flank; a facet's sagitta is a thousandth of that.
                (place.tooth, place.flank) == (40, Flank::Left)
                    && (place.profile_mm - gear.profile_mm(radius)).abs() < 0.015
                    && (place.height_mm - height).abs() < 0.015
            };
            let met = sight.places_along(&gear, sight.dark);
            assert!(met.len() == 1 && near(&met[0]), "{met:?}");
            // The same ray with a point 60 µm under the flank: its foot lies a tenth of a millimetre off, the ray's place not.
            let slant = sight.slant(at, &surface.closest(at));
            assert!((slant - 3f64.sqrt()).abs() < 0.15, "{slant}");
            let point: [f64; 3] =
                (Vector3::from(at) + to.normalize() * (0.06 * 1f64.hypot(slant))).into();
            let closest = [surface.closest(point)];
            let place = gear.place(closest[0].point, closest[0].normal);
            let foot = place.unwrap();
            let off = (foot.profile_mm - gear.profile_mm(radius)).hypot(foot.height_mm - height);
            assert!((off - 0.06 * slant).abs() < 0.01, "{off}");
            let measured = Measured {
                points: &[point],
                closest: &closest,
                ..NO_POINTS
            };
            let sight = Sight { dark: &[], ..sight };
            let met = sight.ray_places(&gear, measured, &[place]);
            assert!(met.len() == 1 && near(&met[0]), "{met:?}");
        }
        // Past the patch, and away from it: nothing is met, nothing hangs.
        let away = [[0.0, 0.0, 1.0], (-towards(41.8, 33.0).0).normalize().into()];
        let sight = Sight {
            surface: &surface,
            camera_mm,
            dark: &away,
            undecoded: &[],
            range_mm: [15.0, 30.0],
            light: &[],
        };
        assert!(sight.places_along(&gear, sight.dark).is_empty());
    }

    #[test]
    fn missing_points_are_counted_where_rays_arrive() {
        let mut field = Field::unmeasured([1.0, 1.0], 0.1);
        let cells = field.wear_mm.len();
        field.wear_mm.fill(0.0);
        field.variance_mm2.fill(0.0);
        let mut counts = RayCounts::new(cells);
        counts.rays.fill(10);
        counts.points.fill(10);
        let shares = |counts: &RayCounts, field: &Field| -> Vec<f64> {
            let shadows = Visibility::from_counts(counts, field).shadows(field, 1.0);
            shadows.iter().map(|shadow| shadow.share).collect()
        };
        assert!(shares(&counts, &field).iter().all(|&s| s == 0.0));
        let whole = Visibility::from_counts(&counts, &field);
        // A shadow over the whole row 5 of half of its points.
        for column in 0..10 {
            counts.points[50 + column] = 5;
        }
        for (cell, share) in shares(&counts, &field).iter().enumerate() {
            let row = cell / 10;
            let expected = if (4..=6).contains(&row) {
                0.5 / 3.0
            } else {
                0.0
            };
            assert!((share - expected).abs() < 1e-12, "{cell}: {share}");
        }
        // A cell that another view shows is not hidden.
        let mut both = Visibility::from_counts(&counts, &field);
        both.add(&whole);
        let unseen = both.shadows(&field, 1.0);
        assert!(unseen.iter().all(|of| of.share == 0.0));
        // As many points beside their cells as there are steps in depth about them: no shadow is told from that.
        let mut rough = field.clone();
        for (cell, wear) in rough.wear_mm.iter_mut().enumerate() {
            *wear = if cell % 2 == 0 { 0.0 } else { 0.2 };
        }
        counts.slant = 2.0;
        assert!(shares(&counts, &rough).iter().all(|&s| s == 0.0));
        // A cell without any point is a hole as a whole, not counted twice; its neighbours say nothing of it.
        counts.points[50..60].fill(0);
        field.wear_mm[50..60].fill(f64::NAN);
        assert!(shares(&counts, &field).iter().all(|&s| s == 0.0));
    }

    #[test]
    fn dark_rays_count_where_they_lie_together_and_undecoded_ones_beyond_a_strip() {
        let mut field = Field::unmeasured([1.0, 1.0], 0.1);
        field.wear_mm.fill(0.0);
        field.variance_mm2.fill(0.0);
        let share = |dark: fn(usize) -> u32, undecoded: fn(usize) -> u32, cell: usize| {
            let mut counts = RayCounts::new(100);
            counts.rays.fill(10);
            for at in 0..100 {
                counts.dark[at] = dark(at);
                counts.undecoded[at] = undecoded(at);
                counts.points[at] = 10 - dark(at) - undecoded(at);
            }
            Visibility::from_counts(&counts, &field).shadows(&field, 1.0)[cell]
        };
        let none = |_| 0;
        // Four of a cell, and none elsewhere: the nine cells about it have lost four of ninety, and nothing says what is there.
        let found = share(|at| if at == 55 { 4 } else { 0 }, none, 55);
        assert!((found.share - 4.0 / 90.0).abs() < 1e-12, "{found:?}");
        assert_eq!(found.depth_mm, f64::INFINITY);
        // As many in every cell, as of a dim surface.
        assert_eq!(share(|_| 2, none, 55).share, 0.0);
        // Of a surface that sends light over a second one a tenth is forgiven, of a third of them what one row of points is not.
        assert_eq!(share(none, |_| 1, 55).share, 0.0);
        let found = share(none, |_| 3, 55);
        assert!(
            (found.share - (0.3 - 1.0 / 63f64.sqrt())).abs() < 1e-12,
            "{found:?}"
        );
    }
}
