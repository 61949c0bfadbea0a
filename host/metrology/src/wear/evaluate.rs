//! Wear of flanks or patches from the points of one cloud that is laid on the CAD.

use flankscope_foundation::order::median_of;
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;

use super::edge::{self, UnderEdge};
use super::field::{Field, WearSample};
use super::sensitivity::motion_row;
use super::sight::{RayCounts, Visibility};
use super::{FlankWear, Measured, WearSettings, Zone};
use crate::feature::Features;
use crate::gear::{Flank, FlankPlace};
use crate::registration::Registration;
use crate::surface::Closest;

/// The grid over one flank's zone.
struct Grid {
    tooth: u32,
    flank: Flank,
    empty: Field,
    samples: Vec<WearSample>,
    counts: Option<RayCounts>,
    /// Sums of the points' motion rows and their number, cell by cell, for the uncertainty by the registration.
    motions: Vec<(Vector6<f64>, u32)>,
    /// Band along the tip edge; none on a patch.
    edge: Option<edge::TipBand>,
}

/// Place of each closest point; none off the flanks or patches.
pub fn places<'a>(
    features: impl Into<Features<'a>>,
    closest: &[Closest],
) -> Vec<Option<FlankPlace>> {
    // The place is that of the CAD point, not of the measured one: wear must not move a point out of its zone.
    let features = features.into();
    closest.par_iter().map(|c| features.place(c)).collect()
}

/// Evaluates all sides of each of `teeth`, which number a gear's teeth or a tool's patches.
///
/// `registration` brings the covariance of the pose into the uncertainty.
pub fn evaluate<'a>(
    features: impl Into<Features<'a>>,
    zone: &Zone,
    teeth: &[u32],
    measured: Measured<'_>,
    registration: Option<&Registration>,
    settings: &WearSettings,
) -> Vec<FlankWear> {
    let features = features.into();
    let places = places(features, measured.closest);
    let of = registration;
    evaluate_placed(features, zone, teeth, measured, &places, of, settings)
}

/// As [`evaluate`], for points whose places are known ([`places`]).
pub fn evaluate_placed<'a>(
    features: impl Into<Features<'a>>,
    zone: &Zone,
    teeth: &[u32],
    measured: Measured<'_>,
    places: &[Option<FlankPlace>],
    registration: Option<&Registration>,
    settings: &WearSettings,
) -> Vec<FlankWear> {
    let placed = Placed::new(features.into(), zone, measured, places, registration);
    let empty = Field::unmeasured(placed.frame.size_mm, settings.cell_mm());
    let grids: Vec<Grid> = teeth
        .iter()
        .flat_map(|&tooth| {
            placed
                .features
                .sides()
                .iter()
                .map(move |&flank| (tooth, flank))
        })
        .map(|of| Grid::new(of, &empty, &placed))
        .collect();
    // Every grid takes its own points, in their order: the same sums on any number of threads.
    grids
        .into_par_iter()
        .map(|mut grid| {
            grid.take_points(&placed);
            grid.take_rays(&placed);
            grid.wear(placed.features, registration, settings)
        })
        .collect()
}

/// A zone's own coordinates, from its corner along profile and height.
struct ZoneFrame {
    corner_mm: [f64; 2],
    size_mm: [f64; 2],
}

impl ZoneFrame {
    fn of(features: Features<'_>, zone: &Zone) -> Self {
        let along_mm = zone.radius_mm.map(|radius_mm| features.along_mm(radius_mm));
        Self {
            corner_mm: [along_mm[0], zone.height_mm[0]],
            size_mm: [
                along_mm[1] - along_mm[0],
                zone.height_mm[1] - zone.height_mm[0],
            ],
        }
    }

    fn at_mm(&self, place: &FlankPlace) -> [f64; 2] {
        [
            place.profile_mm - self.corner_mm[0],
            place.height_mm - self.corner_mm[1],
        ]
    }
}

/// Where rays met the CAD, and what each adds to a cell's counts of dark and of undecoded ones.
type RayPlaces = (Vec<FlankPlace>, [u32; 2]);

/// What all grids have in common: the cloud with its places, and the rays of the camera that saw it.
struct Placed<'a> {
    features: Features<'a>,
    frame: ZoneFrame,
    measured: Measured<'a>,
    places: &'a [Option<FlankPlace>],
    /// Of points off the flanks.
    under_edges: Vec<Option<UnderEdge>>,
    rays: Option<[RayPlaces; 3]>,
    /// About which the pose's covariance turns.
    centre: Vector3<f64>,
}

impl<'a> Placed<'a> {
    fn new(
        features: Features<'a>,
        zone: &Zone,
        measured: Measured<'a>,
        places: &'a [Option<FlankPlace>],
        registration: Option<&Registration>,
    ) -> Self {
        let points = measured.points.par_iter().zip(places);
        let under_edges = points
            .map(|(point, place)| match (place, features.gear()) {
                (None, Some(gear)) => UnderEdge::at_point(gear, *point),
                _ => None,
            })
            .collect();
        let rays = measured.sight.map(|sight| {
            [
                (sight.ray_places(features, measured, places), [0, 0]),
                (sight.places_along(features, sight.dark), [1, 0]),
                (sight.places_along(features, sight.undecoded), [0, 1]),
            ]
        });
        Self {
            features,
            frame: ZoneFrame::of(features, zone),
            measured,
            places,
            under_edges,
            rays,
            centre: Vector3::from(registration.map_or([0.0; 3], |r| r.centre_mm)),
        }
    }
}

impl Grid {
    fn new((tooth, flank): (u32, Flank), empty: &Field, placed: &Placed<'_>) -> Self {
        let cells = empty.wear_mm.len();
        Self {
            tooth,
            flank,
            empty: empty.clone(),
            samples: Vec::new(),
            counts: placed.measured.sight.map(|_| RayCounts::new(cells)),
            motions: vec![(Vector6::zeros(), 0); cells],
            edge: placed.features.gear().map(edge::TipBand::new),
        }
    }

    /// Takes the points of its flank, and those under its tip edge.
    fn take_points(&mut self, placed: &Placed<'_>) {
        let frame = &placed.frame;
        let heights_mm = 0.0..frame.size_mm[1];
        let places = placed.places.iter().zip(&placed.under_edges);
        for (index, (place, under)) in places.enumerate() {
            let Some(place) = place else {
                if let (Some(gear), Some(under)) = (placed.features.gear(), under)
                    && self.is_of(under.tooth, under.flank)
                    && heights_mm.contains(&(under.height_mm - frame.corner_mm[1]))
                    && let Some(edge) = &mut self.edge
                {
                    edge.add_under(gear, under);
                }
                continue;
            };
            let at_mm = frame.at_mm(place);
            if self.is_of(place.tooth, place.flank) && heights_mm.contains(&at_mm[1]) {
                self.take_point(index, place, at_mm, placed);
            }
        }
        if let Some(counts) = &mut self.counts {
            counts.slant /= self.samples.len().max(1) as f64;
        }
    }

    fn take_point(
        &mut self,
        index: usize,
        place: &FlankPlace,
        at_mm: [f64; 2],
        placed: &Placed<'_>,
    ) {
        let measured = &placed.measured;
        let (point, closest) = (measured.points[index], &measured.closest[index]);
        if !closest.signed_distance_mm.is_finite() {
            return;
        }
        let wear_mm = -closest.signed_distance_mm;
        if let Some(edge) = &mut self.edge {
            edge.add(place, wear_mm);
        }
        let Some(cell) = self.empty.cell_at(at_mm) else {
            return;
        };
        if let (Some(counts), Some(sight)) = (&mut self.counts, measured.sight) {
            counts.points[cell] += 1;
            counts.light[cell] += sight.light.get(index).map_or(0.0, |&e| f64::from(e));
            // A sum, until all points are taken.
            counts.slant += sight.slant(point, closest);
        }
        let sigma = measured.sigma_mm.and_then(|s| s.get(index));
        let sigma = sigma.map_or(f64::NAN, |&s| f64::from(s));
        let sample = WearSample::of_point(at_mm, wear_mm, sigma * sigma);
        self.samples.push(sample);
        let (sum, count) = &mut self.motions[cell];
        *sum += motion_row(point, closest.normal, placed.centre);
        *count += 1;
    }

    /// Counts the rays that met its flank.
    fn take_rays(&mut self, placed: &Placed<'_>) {
        for (met, [dark, undecoded]) in placed.rays.iter().flatten() {
            for place in met {
                if self.is_of(place.tooth, place.flank)
                    && let Some(cell) = self.empty.cell_at(placed.frame.at_mm(place))
                    && let Some(counts) = &mut self.counts
                {
                    counts.rays[cell] += 1;
                    counts.dark[cell] += dark;
                    counts.undecoded[cell] += undecoded;
                }
            }
        }
    }

    fn is_of(&self, tooth: u32, flank: Flank) -> bool {
        (self.tooth, self.flank) == (tooth, flank)
    }

    fn wear(
        self,
        features: Features<'_>,
        registration: Option<&Registration>,
        settings: &WearSettings,
    ) -> FlankWear {
        // The pose's uncertainty differs between the ends of a flank and its middle: the largest counts.
        let registration_mm = registration.map_or(0.0, |registration| {
            self.motions
                .iter()
                .filter(|(_, count)| *count > 0)
                .map(|(sum, count)| {
                    let motion = sum / f64::from(*count);
                    motion.dot(&(registration.covariance * motion)).max(0.0)
                })
                .fold(0.0, f64::max)
                .sqrt()
        });
        let visibility = self
            .counts
            .map(|counts| Visibility::from_counts(&counts, &self.empty));
        let mut wear = FlankWear::new(
            (self.tooth, self.flank),
            self.empty,
            self.samples,
            visibility,
            registration_mm,
            settings,
        );
        // Pose and temperature move edge and flank alike; calibration does not.
        let level_mm = median_of(wear.field.wear_mm.iter().copied()).unwrap_or(f64::NAN);
        let edge = self.edge.as_ref().zip(features.gear());
        wear.tip = edge.and_then(|(edge, gear)| edge.loss(gear, level_mm, settings.calibration_mm));
        wear
    }
}
