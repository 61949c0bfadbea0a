//! Points of many views on one flank, gathered by parts of cells: the input of a scan's wear figures.
//!
//! All points of a scan do not fit into memory, so each part of a cell keeps sums, and its mean counts as one point. A ninth of
//! a cell blurs the rim of a damage by a fifteenth of the disc's diameter at most. Within a part every point counts by its
//! stated variance and what its view's calibration leaves where it lies in the field, which wear does not change; depths play
//! no part.

use std::collections::BTreeMap;

use flankscope_foundation::order::median_of;
use flankscope_foundation::rigid::{Rigid, Tool};
use nalgebra::{Point3, Vector3};

use super::edge::{TipBand, UnderEdge};
use super::field::{Field, WearSample};
use super::sight::{RayCounts, Visibility};
use super::{FlankWear, Measured, WearSettings, Zone, places};
use crate::gear::{Flank, FlankPlace, GearData};

/// Parts along each side of a cell: an odd number, so that the median of a cell's parts is one of them.
const PARTS: usize = 3;
/// Least standard uncertainty by which a point is weighted, mm: no view's pose is surer.
const LEAST_SIGMA_MM: f64 = 1e-3;

/// One point of a view on a flank.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct FlankPoint {
    /// Length along the involute from the base circle, mm.
    pub profile_mm: f32,
    /// Height, mm.
    pub height_mm: f32,
    /// Minus its deviation, mm.
    pub wear_mm: f32,
    /// Its standard uncertainty by noise, mm.
    pub sigma_mm: f32,
}

/// Points and rays of one view on one flank.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FlankView {
    /// Points whose foot lies on the flank.
    pub on: Vec<FlankPoint>,
    /// Points in the material whose nearest surface is the tip's land: where the edge is worn away.
    pub under: Vec<FlankPoint>,
    /// Intersections of the rays to the view's points with the flank of the CAD; their wear and uncertainty are zero.
    pub rays: Vec<FlankPoint>,
    /// Intersections of rays along which no fringes came back.
    pub dark: Vec<FlankPoint>,
    /// Intersections of rays that brought light, but no point.
    pub undecoded: Vec<FlankPoint>,
    /// Mean tangent of the angle between the view's rays and the flank's normal.
    pub slant: f64,
}

impl FlankView {
    /// The points of a view by the flank that they lie on.
    pub fn by_flank(gear: &GearData, measured: Measured<'_>) -> BTreeMap<(u32, Flank), Self> {
        let band = TipBand::new(gear);
        let mut flanks: BTreeMap<(u32, Flank), Self> = BTreeMap::new();
        let points = measured.points.iter().zip(measured.closest);
        let places = places(gear, measured.closest);
        for (i, ((point, closest), &place)) in points.zip(&places).enumerate() {
            let sigma_mm = measured.sigma_mm.and_then(|s| s.get(i)).copied();
            let kept = |place: &FlankPlace, wear_mm: f64| FlankPoint {
                profile_mm: place.profile_mm as f32,
                height_mm: place.height_mm as f32,
                wear_mm: wear_mm as f32,
                sigma_mm: sigma_mm.unwrap_or(f32::NAN),
            };
            if let Some(place) = place {
                let wear_mm = -closest.signed_distance_mm;
                if wear_mm.is_finite() {
                    let seen = flanks.entry((place.tooth, place.flank)).or_default();
                    let slant = measured.sight.map_or(0.0, |s| s.slant(*point, closest));
                    let count = seen.on.len() as f64;
                    seen.slant = (count * seen.slant + slant) / (count + 1.0);
                    seen.on.push(kept(&place, wear_mm));
                }
            } else if let Some(under) = UnderEdge::at_point(gear, *point) {
                let (place, wear_mm) = band.place_under(gear, &under);
                let seen = flanks.entry((under.tooth, under.flank)).or_default();
                seen.under.push(kept(&place, wear_mm));
            }
        }
        if let Some(sight) = measured.sight {
            let met = |place: &FlankPlace| FlankPoint {
                profile_mm: place.profile_mm as f32,
                height_mm: place.height_mm as f32,
                wear_mm: 0.0,
                sigma_mm: 0.0,
            };
            for place in sight.ray_places(gear, measured, &places) {
                let seen = flanks.entry((place.tooth, place.flank)).or_default();
                seen.rays.push(met(&place));
            }
            for place in sight.places_along(gear, sight.dark) {
                let seen = flanks.entry((place.tooth, place.flank)).or_default();
                seen.dark.push(met(&place));
            }
            for place in sight.places_along(gear, sight.undecoded) {
                let seen = flanks.entry((place.tooth, place.flank)).or_default();
                seen.undecoded.push(met(&place));
            }
        }
        flanks
    }
}

/// Sums of one part of a cell, weighted.
#[derive(Debug, Clone, Copy, Default)]
struct CellPart {
    weight: f64,
    at_mm: [f64; 2],
    wear_mm: f64,
    /// Of squared weights times the points' variances.
    variance: f64,
    count: f64,
    /// Of weights times squared wear, mm2.
    squares: f64,
    /// Sum of weights times cubed wear, mm3.
    cubes: f64,
}

impl CellPart {
    /// Sum of its points' squared differences from their mean, mm2: the weighted one, as if all weighed the same.
    fn within_mm2(&self) -> f64 {
        let mean_mm = self.wear_mm / self.weight;
        self.count * (self.squares / self.weight - mean_mm * mean_mm).max(0.0)
    }

    /// Sum of its points' cubed differences from their mean, mm3: the weighted one, as if all weighed the same.
    fn cubes_mm3(&self) -> f64 {
        let [mean, squares, cubes] =
            [self.wear_mm, self.squares, self.cubes].map(|sum| sum / self.weight);
        self.count * (cubes - 3.0 * mean * squares + 2.0 * mean.powi(3))
    }
}

/// One flank's zone on the way from points of many views to its wear.
#[derive(Debug, Clone)]
pub struct Gathered<'a> {
    gear: &'a GearData,
    zone: Zone,
    key: (u32, Flank),
    empty: Field,
    parts: Vec<CellPart>,
    visibility: Option<Visibility>,
    edge: TipBand,
    profile_from_mm: f64,
    points: usize,
}

impl<'a> Gathered<'a> {
    /// A zone of a flank of which nothing was seen so far.
    pub fn new(gear: &'a GearData, zone: Zone, key: (u32, Flank), settings: &WearSettings) -> Self {
        let profile_from_mm = gear.profile_mm(zone.radius_mm[0]);
        let size_mm = [
            gear.profile_mm(zone.radius_mm[1]) - profile_from_mm,
            zone.height_mm[1] - zone.height_mm[0],
        ];
        let empty = Field::unmeasured(size_mm, settings.cell_mm());
        Self {
            gear,
            zone,
            key,
            parts: vec![CellPart::default(); PARTS * PARTS * empty.wear_mm.len()],
            empty,
            visibility: None,
            edge: TipBand::new(gear),
            profile_from_mm,
            points: 0,
        }
    }

    /// Adds what a view saw, moved by a little since it was laid on the CAD. `further_mm2` says what variance the calibration
    /// adds at a place (tool frame, mm).
    pub fn add(
        &mut self,
        seen: &FlankView,
        motion: &Rigid<Tool, Tool>,
        further_mm2: impl Fn([f64; 3]) -> f64,
    ) {
        let mut counts = RayCounts::new(self.empty.wear_mm.len());
        counts.slant = seen.slant;
        for point in &seen.on {
            let Some((place, wear_mm, foot)) = self.moved(point, motion) else {
                continue;
            };
            self.edge.add(&place, wear_mm);
            let at_mm = self.at_mm(&place);
            let Some(cell) = self.empty.cell_at(at_mm) else {
                continue;
            };
            counts.points[cell] += 1;
            let variance_mm2 = f64::from(point.sigma_mm).powi(2);
            let all_mm2 = variance_mm2 + further_mm2(foot) + LEAST_SIGMA_MM * LEAST_SIGMA_MM;
            let weight = 1.0 / all_mm2;
            // An infinite variance would weigh nothing, but count as one more point.
            if !(variance_mm2.is_finite() && weight.is_finite()) {
                continue;
            }
            let part = self.part_of(cell, at_mm);
            let part = &mut self.parts[part];
            part.weight += weight;
            part.wear_mm += weight * wear_mm;
            part.variance += weight * weight * variance_mm2;
            part.count += 1.0;
            part.squares += weight * wear_mm * wear_mm;
            part.cubes += weight * wear_mm.powi(3);
            for (sum, at) in part.at_mm.iter_mut().zip(at_mm) {
                *sum += weight * at;
            }
            self.points += 1;
        }
        let kinds = [
            (&seen.rays, [0, 0]),
            (&seen.dark, [1, 0]),
            (&seen.undecoded, [0, 1]),
        ];
        if kinds.iter().any(|(rays, _)| !rays.is_empty()) {
            for (rays, [dark, undecoded]) in kinds {
                for ray in rays {
                    let met = self.moved(ray, motion);
                    let at_mm = met.map(|(place, ..)| self.at_mm(&place));
                    if let Some(cell) = at_mm.and_then(|at_mm| self.empty.cell_at(at_mm)) {
                        counts.rays[cell] += 1;
                        counts.dark[cell] += dark;
                        counts.undecoded[cell] += undecoded;
                    }
                }
            }
            let view = Visibility::from_counts(&counts, &self.empty);
            match &mut self.visibility {
                Some(all) => all.add(&view),
                None => self.visibility = Some(view),
            }
        }
        for point in &seen.under {
            if let Some((place, wear_mm, _)) = self.moved(point, motion) {
                self.edge.add(&place, wear_mm);
            }
        }
    }

    /// Place, wear and foot on the CAD of a point after a motion of its view; none beyond the zone's heights.
    fn moved(
        &self,
        point: &FlankPoint,
        motion: &Rigid<Tool, Tool>,
    ) -> Option<(FlankPlace, f64, [f64; 3])> {
        let (tooth, flank) = self.key;
        let (profile_mm, height_mm) = (f64::from(point.profile_mm), f64::from(point.height_mm));
        let radius_mm = self.gear.radius_mm(profile_mm);
        let foot = self.gear.flank_point(tooth, flank, radius_mm, height_mm)?;
        let normal = Vector3::from(self.gear.flank_normal(flank, foot));
        let from = Point3::from(foot);
        let shift = motion.isometry() * from - from;
        // Up the flank, away from the base circle.
        let mut up = Vector3::new(-normal.y, normal.x, 0.0);
        if up.dot(&Vector3::new(foot[0], foot[1], 0.0)) < 0.0 {
            up = -up;
        }
        let height_mm = height_mm + shift.z;
        let [low, high] = self.zone.height_mm;
        (low..high).contains(&height_mm).then(|| {
            let profile_mm = profile_mm + up.dot(&shift);
            let place = FlankPlace {
                tooth,
                flank,
                radius_mm,
                profile_mm,
                height_mm,
            };
            (place, f64::from(point.wear_mm) - normal.dot(&shift), foot)
        })
    }

    /// A place from the zone's corner along profile and height, mm.
    fn at_mm(&self, place: &FlankPlace) -> [f64; 2] {
        [
            place.profile_mm - self.profile_from_mm,
            place.height_mm - self.zone.height_mm[0],
        ]
    }

    /// Number of the part of a cell around a place in it.
    fn part_of(&self, cell: usize, at_mm: [f64; 2]) -> usize {
        let [column, row] = [0, 1].map(|k| {
            let within = (at_mm[k] / self.empty.cell_mm[k]).fract();
            ((within * PARTS as f64) as usize).min(PARTS - 1)
        });
        (cell * PARTS + row) * PARTS + column
    }

    /// Its wear; without its points, so that neither [`FlankWear::since`] nor [`FlankWear::together`] finds any in it.
    /// `registration_mm` is the standard uncertainty that the poses of the views leave in its deviation, mm.
    pub fn wear(self, registration_mm: f64, settings: &WearSettings) -> FlankWear {
        let samples = self.parts.iter().filter(|part| part.weight > 0.0);
        let samples = samples.map(|part| WearSample {
            at_mm: part.at_mm.map(|sum| sum / part.weight),
            wear_mm: part.wear_mm / part.weight,
            variance_mm2: part.variance / (part.weight * part.weight),
            merged: part.count,
            within_mm2: part.within_mm2(),
            cubes_mm3: part.cubes_mm3(),
        });
        let samples = samples.collect();
        let mut wear = FlankWear::new(
            self.key,
            self.empty,
            samples,
            self.visibility,
            registration_mm,
            settings,
        );
        wear.points = self.points;
        // All flanks of a die together would not fit into memory with them.
        wear.measured.views[0].samples = Vec::new();
        let level_mm = median_of(wear.field.wear_mm.iter().copied()).unwrap_or(f64::NAN);
        wear.tip = self.edge.loss(self.gear, level_mm, settings.calibration_mm);
        wear
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::gear::tests::ring84;
    use flankscope_foundation::random::{normal, uniform};

    const KEY: (u32, Flank) = (40, Flank::Left);
    const SIGMA_MM: f64 = 0.5e-3;

    fn zone() -> Zone {
        Zone {
            radius_mm: ring84().active_flank_mm(),
            height_mm: [29.0, 37.0],
        }
    }

    fn settings() -> WearSettings {
        WearSettings {
            cad_mm: 0.0,
            ..WearSettings::default()
        }
    }

    /// Points all over the zone with noise of half a micrometre, `away_mm` off by a damage.
    fn view(seed: u64, damage_mm: impl Fn(f64, f64) -> f64) -> FlankView {
        let (gear, zone) = (ring84(), zone());
        let [from, to] = zone.radius_mm.map(|r| gear.profile_mm(r));
        let [low, high] = zone.height_mm;
        let count = (411.0 * (to - from) * (high - low)) as u64;
        let on = (0..count)
            .map(|i| {
                let profile = from + (to - from) * uniform(seed, 3 * i);
                let height = low + (high - low) * uniform(seed, 3 * i + 1);
                let wear = damage_mm(profile - from, height - low);
                FlankPoint {
                    profile_mm: profile as f32,
                    height_mm: height as f32,
                    wear_mm: (wear + SIGMA_MM * normal(seed + 1000, i)) as f32,
                    sigma_mm: SIGMA_MM as f32,
                }
            })
            .collect();
        FlankView {
            on,
            ..FlankView::default()
        }
    }

    fn gathered(views: &[FlankView]) -> FlankWear {
        let gear = ring84();
        let mut all = Gathered::new(&gear, zone(), KEY, &settings());
        for view in views {
            all.add(
                view,
                &Rigid::from_isometry(nalgebra::Isometry3::identity()),
                |_| 0.0,
            );
        }
        all.wear(0.5e-3, &settings())
    }

    /// The same points, one by one.
    fn by_points(views: &[FlankView]) -> FlankWear {
        let (gear, zone) = (ring84(), zone());
        let [from, to] = zone.radius_mm.map(|r| gear.profile_mm(r));
        let points: Vec<([f64; 2], f64, f64)> = views
            .iter()
            .flat_map(|view| &view.on)
            .map(|p| {
                let at = [
                    f64::from(p.profile_mm) - from,
                    f64::from(p.height_mm) - zone.height_mm[0],
                ];
                (at, f64::from(p.wear_mm), f64::from(p.sigma_mm))
            })
            .collect();
        let size_mm = [to - from, zone.height_mm[1] - zone.height_mm[0]];
        FlankWear::of_points(KEY, size_mm, &points, &settings())
    }

    #[test]
    fn parts_of_cells_say_what_all_points_do() {
        // A pit as large as the disc, 60 um; an eighth of the height gone by 200 um; a ramp; nothing.
        let shapes: [fn(f64, f64) -> f64; 4] = [
            |x, y| {
                if (x - 0.9).hypot(y - 4.0) < 0.2821 {
                    10e-3
                } else {
                    0.0
                }
            },
            |_, y| if y > 7.0 { 200e-3 } else { 0.0 },
            |_, y| 10e-3 * y,
            |_, _| 0.0,
        ];
        for (k, shape) in shapes.into_iter().enumerate() {
            let views: Vec<FlankView> = (0..4).map(|seed| view(seed, shape)).collect();
            let (parts, points) = (gathered(&views), by_points(&views));
            let (read, exact) = (parts.judged.unwrap(), points.judged.unwrap());
            let deepest_mm = exact.wear_mm.value.abs();
            // The rim of a pit is blurred by a fifteenth of the diameter: at most a tenth of its mean.
            assert!(
                (read.wear_mm.value - exact.wear_mm.value).abs() <= 0.1 * deepest_mm + 0.1e-3,
                "{k}: {} {}",
                read.wear_mm.value,
                exact.wear_mm.value
            );
            let rough = 0.1 * deepest_mm.max(1e-3);
            assert!((read.mean_mm.value - exact.mean_mm.value).abs() < 0.02e-3 + 0.02 * rough);
            // The rim of a pit may look like a groove, which hides no more than was read anyway.
            for hidden_mm in [read.hidden_mm, exact.hidden_mm].into_iter().flatten() {
                assert!(k == 0 && hidden_mm <= 1.1 * deepest_mm, "{k}: {hidden_mm}");
            }
            assert_eq!(parts.points, points.points);
            // Where a part lies on the pit's rim its place is uncertain, and said to be; without an edge in the disc only noise
            // is left.
            let noise = parts.budget.noise_mm / points.budget.noise_mm;
            let edged = k == 0 || k == 3;
            assert!(edged || (0.3..3.0).contains(&noise), "{k}: {noise}");
        }
    }

    #[test]
    fn a_view_that_moved_takes_its_points_along() {
        let gear = ring84();
        let centre = gear.flank_point(40, Flank::Left, 41.4, 33.0).unwrap();
        let turn = UnitQuaternion::from_euler_angles(1e-5, -2e-5, 1e-4);
        let at = Point3::from(centre);
        let motion = nalgebra::Translation3::new(2e-3, -1e-3, 4e-3) * turn;
        let all = Gathered::new(&gear, zone(), KEY, &settings());
        let point = FlankPoint {
            profile_mm: gear.profile_mm(41.4) as f32,
            height_mm: 33.0,
            wear_mm: 10e-3,
            sigma_mm: 1e-3,
        };
        let (place, wear_mm, _) = all.moved(&point, &Rigid::from_isometry(motion)).unwrap();
        let normal = Vector3::from(gear.flank_normal(Flank::Left, centre));
        let there = motion * (at - 10e-3 * normal);
        let exact = gear.involute_deviation_mm(40, Flank::Left, there.coords.into());
        // A turn by 1e-4 of 10 um, and the second order of 5 um on a millimetre.
        assert!(
            (wear_mm + exact.unwrap()).abs() < 2e-5,
            "{wear_mm} {exact:?}"
        );
        assert!((place.height_mm - there.z).abs() < 1e-5);
        let radius = there.x.hypot(there.y);
        assert!((place.profile_mm - gear.profile_mm(radius)).abs() < 5e-3);
    }

    #[test]
    fn an_unseen_patch_larger_than_the_disc_may_hide_anything() {
        let mut views = vec![view(1, |_, _| 0.0)];
        let [from, _] = zone().radius_mm.map(|r| ring84().profile_mm(r) as f32);
        for view in &mut views {
            view.on
                .retain(|p| (p.profile_mm - from - 0.9).hypot(p.height_mm - 33.0) > 0.4);
        }
        let hidden = gathered(&views).judged.unwrap().hidden_mm.unwrap();
        assert!(hidden > 0.9 * settings().hidden_depth_mm, "{hidden}");
    }
}
