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
    let features = features.into();
    let profile_from_mm = features.along_mm(zone.radius_mm[0]);
    let size_mm = [
        features.along_mm(zone.radius_mm[1]) - profile_from_mm,
        zone.height_mm[1] - zone.height_mm[0],
    ];
    let empty = Field::unmeasured(size_mm, settings.cell_mm());
    let grids: Vec<Grid> = teeth
        .iter()
        .flat_map(|&tooth| features.sides().iter().map(move |&flank| (tooth, flank)))
        .map(|(tooth, flank)| Grid {
            tooth,
            flank,
            empty: empty.clone(),
            samples: Vec::new(),
            counts: measured.sight.map(|_| RayCounts::new(empty.wear_mm.len())),
            motions: vec![(Vector6::zeros(), 0); empty.wear_mm.len()],
            edge: features.gear().map(edge::TipBand::new),
        })
        .collect();
    let centre = Vector3::from(registration.map_or([0.0; 3], |r| r.centre_mm));
    // From the zone's corner.
    let in_zone = |place: &FlankPlace| {
        [
            place.profile_mm - profile_from_mm,
            place.height_mm - zone.height_mm[0],
        ]
    };
    let points = measured.points.par_iter().zip(places);
    let under_edges: Vec<Option<UnderEdge>> = points
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
    // Every grid takes its own points, in their order: the same sums on any number of threads.
    grids
        .into_par_iter()
        .map(|mut grid| {
            let points = measured.points.iter().zip(measured.closest).enumerate();
            for ((index, (point, closest)), (place, under)) in
                points.zip(places.iter().zip(&under_edges))
            {
                let Some(place) = place else {
                    if let (Some(gear), Some(under)) = (features.gear(), under)
                        && grid.is_of(under.tooth, under.flank)
                        && (zone.height_mm[0]..zone.height_mm[1]).contains(&under.height_mm)
                        && let Some(edge) = &mut grid.edge
                    {
                        edge.add_under(gear, under);
                    }
                    continue;
                };
                if !grid.is_of(place.tooth, place.flank) {
                    continue;
                }
                let at_mm = in_zone(place);
                if !(0.0..size_mm[1]).contains(&at_mm[1]) || !closest.signed_distance_mm.is_finite()
                {
                    continue;
                }
                let wear_mm = -closest.signed_distance_mm;
                if let Some(edge) = &mut grid.edge {
                    edge.add(place, wear_mm);
                }
                let Some(cell) = grid.empty.cell_at(at_mm) else {
                    continue;
                };
                if let (Some(counts), Some(sight)) = (&mut grid.counts, measured.sight) {
                    counts.points[cell] += 1;
                    counts.light[cell] += sight.light.get(index).map_or(0.0, |&e| f64::from(e));
                    // A sum here; divided by the number of points below.
                    counts.slant += sight.slant(*point, closest);
                }
                let sigma = measured
                    .sigma_mm
                    .and_then(|s| s.get(index))
                    .map_or(f64::NAN, |&s| f64::from(s));
                let sample = WearSample::of_point(at_mm, wear_mm, sigma * sigma);
                grid.samples.push(sample);
                let (sum, count) = &mut grid.motions[cell];
                *sum += motion_row(*point, closest.normal, centre);
                *count += 1;
            }
            for (met, [dark, undecoded]) in rays.iter().flatten() {
                for place in met {
                    if grid.is_of(place.tooth, place.flank)
                        && let Some(cell) = grid.empty.cell_at(in_zone(place))
                        && let Some(counts) = &mut grid.counts
                    {
                        counts.rays[cell] += 1;
                        counts.dark[cell] += dark;
                        counts.undecoded[cell] += undecoded;
                    }
                }
            }
            if let Some(counts) = &mut grid.counts {
                counts.slant /= grid.samples.len().max(1) as f64;
            }
            grid.wear(features, registration, settings)
        })
        .collect()
}

impl Grid {
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
