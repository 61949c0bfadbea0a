//! Where a view's camera rays meet the CAD's flanks, and how many of them brought no point from there.
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

use super::Measured;
use super::field::Field;
use crate::feature::Features;
use crate::gear::FlankPlace;
use crate::surface::{Closest, Surface};

/// A point farther from the CAD may belong to a ray that meets another face than the point's foot lies on, mm.
const FAR_MM: f64 = 0.02;
/// Cosine of the angle to the normal below which a ray grazes: its place cannot be told.
const GRAZING: f64 = 0.05;

/// The camera of a view, in the tool frame.
#[derive(Debug, Clone, Copy)]
pub struct Sight<'a> {
    /// The surface that it sees.
    pub surface: &'a Surface,
    /// Its centre of projection, mm.
    pub camera_mm: [f64; 3],
    /// Unit directions of the rays that brought no point.
    pub without_point: &'a [[f64; 3]],
    /// Nearest and farthest distance at which the head measures, mm.
    pub range_mm: [f64; 2],
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

    /// Where the rays meet flanks or patches of the CAD: of every point, then of those without one. `places` says where the points
    /// lie.
    pub fn ray_places<'f>(
        &self,
        features: impl Into<Features<'f>>,
        measured: Measured<'_>,
        places: &[Option<FlankPlace>],
    ) -> Vec<FlankPlace> {
        let features = features.into();
        let points = measured.points.iter().zip(measured.closest);
        let of_points = points.zip(places).filter_map(|((point, closest), place)| {
            self.of_point(features, *point, closest, *place)
        });
        let without = self
            .without_point
            .iter()
            .filter_map(|direction| self.first_met(features, Vector3::from(*direction)));
        of_points.chain(without).collect()
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

    /// Where a ray first meets the surface, if that is on a flank.
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
    pub rays: Vec<u32>,
    pub points: Vec<u32>,
    /// Mean tangent of the angle between the rays and the flank's normal.
    pub slant: f64,
}

impl RayCounts {
    pub fn new(cells: usize) -> Self {
        Self {
            rays: vec![0; cells],
            points: vec![0; cells],
            slant: 0.0,
        }
    }
}

/// How well each cell of a zone was seen: of all views, by the one that brought most points from it and the cells around it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Visibility {
    /// Rays and points of that view in those cells; nothing where there is no point in the cell itself.
    blocks: Vec<[u32; 2]>,
    /// Largest tangent of the angle between rays and normal.
    slant: f64,
}

impl Visibility {
    /// Of one view. A point on the border of two cells falls into the one or the other, which over nine cells hardly counts.
    /// Cells without points say nothing here: they are holes as a whole.
    pub fn of(counts: &RayCounts, field: &Field) -> Self {
        let seen = |cell: &usize| counts.points[*cell] > 0;
        let block = |cell: usize| {
            let all = field.around(cell).chain([cell]).filter(seen);
            all.fold([0, 0], |[rays, points], c| {
                [rays + counts.rays[c], points + counts.points[c]]
            })
        };
        let blocks = (0..counts.points.len())
            .map(|cell| if seen(&cell) { block(cell) } else { [0, 0] })
            .collect();
        Self {
            blocks,
            slant: counts.slant,
        }
    }

    /// With what another view saw: what one of them shows is not hidden.
    pub fn add(&mut self, other: &Self) {
        for (best, block) in self.blocks.iter_mut().zip(&other.blocks) {
            if block[1] > best[1] {
                *best = *block;
            }
        }
        self.slant = self.slant.max(other.slant);
    }

    /// Share of each cell that was not seen: of the rays the part for which no point lies there, or what an opening with an
    /// unseen floor may take up ([`Field::groove_shares`]).
    ///
    /// The shadow of a wall as narrow as an opening that nothing would show elsewhere on the flank is not counted: neither noise
    /// ([`Field::unseen_groove_mm`]) nor the distance of the points lets it be seen there.
    pub fn unseen_shares(&self, field: &Field, noise_scale: f64) -> Vec<f64> {
        let block_mm = 3.0 * field.cell_area_mm2().sqrt();
        let grooves = field.groove_shares(self.slant, noise_scale);
        let shares = self.blocks.iter().zip(grooves).enumerate();
        let share = |(cell, (&[rays, points], groove)): (usize, (&[u32; 2], f64))| {
            if points == 0 {
                return groove;
            }
            let points = f64::from(points);
            let unseen = 1.0 - points / f64::from(rays.max(1));
            let spacing_mm = block_mm / points.sqrt();
            let anywhere_mm = field.unseen_groove_mm(cell, self.slant, noise_scale);
            (unseen - anywhere_mm.min(spacing_mm) / block_mm).max(groove)
        };
        shares.map(share).collect()
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
                without_point: &directions,
                range_mm: [15.0, 30.0],
            };
            let near = |place: &FlankPlace| {
                // The march ends 5 µm in front of the flank; a facet's sagitta is a thousandth of that.
                (place.tooth, place.flank) == (40, Flank::Left)
                    && (place.profile_mm - gear.profile_mm(radius)).abs() < 0.015
                    && (place.height_mm - height).abs() < 0.015
            };
            let met = sight.ray_places(&gear, NO_POINTS, &[]);
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
            let sight = Sight {
                without_point: &[],
                ..sight
            };
            let met = sight.ray_places(&gear, measured, &[place]);
            assert!(met.len() == 1 && near(&met[0]), "{met:?}");
        }
        // Past the patch, and away from it: nothing is met, nothing hangs.
        let away = [[0.0, 0.0, 1.0], (-towards(41.8, 33.0).0).normalize().into()];
        let sight = Sight {
            surface: &surface,
            camera_mm,
            without_point: &away,
            range_mm: [15.0, 30.0],
        };
        assert!(sight.ray_places(&gear, NO_POINTS, &[]).is_empty());
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
        let shares = |counts: &RayCounts, field: &Field| {
            Visibility::of(counts, field).unseen_shares(field, 1.0)
        };
        assert!(shares(&counts, &field).iter().all(|&s| s == 0.0));
        let whole = Visibility::of(&counts, &field);
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
        // What another view shows is not hidden.
        let mut both = Visibility::of(&counts, &field);
        both.add(&whole);
        assert!(both.unseen_shares(&field, 1.0).iter().all(|&s| s == 0.0));
        // A cell without any point is a hole as a whole, not counted twice; its neighbours say nothing of it.
        counts.points[50..60].fill(0);
        field.wear_mm[50..60].fill(f64::NAN);
        assert!(shares(&counts, &field).iter().all(|&s| s == 0.0));
    }
}
