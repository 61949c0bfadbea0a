//! Effect of pose and temperature on a flank's figures in one view whose fit is known: computed through the fit's response.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use flankscope_foundation::order::median_of;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rayon::prelude::*;

use super::super::leakage::{self, Leakage};
use super::super::mount::Drift;
use super::super::{MountPose, PoseEvidence, SameMount, SeenFlank, Statement, Zone};
use super::{ExpansionUncertainty, PoseSensitivity, motion_row};
use crate::feature::Features;
use crate::gear::{Flank, FlankPlace};
use crate::registration::{Contact, Options, Prior, Registration, Response};
use crate::surface::Closest;

/// Least number of points of a flank that counts as evidence about the pose.
pub const LEAST_POINTS: usize = 100;

/// A view after its fit.
pub struct FittedView<'a> {
    /// Flanks or patches of the tool.
    pub features: Features<'a>,
    /// Zone that is judged.
    pub zone: &'a Zone,
    /// Result of the fit.
    pub registration: &'a Registration,
    /// Expected pose with its covariance that the fit was given.
    pub prior: &'a Prior,
    /// Expected pose with its covariance, from the stages.
    pub stages: &'a Prior,
    /// The part of the prior's covariance that is drawn anew with every approach of the stages.
    pub approach: Matrix6<f64>,
    /// The mounting of the baseline, where it is the same.
    pub same_mount: Option<&'a FoundMount>,
    /// Settings of the fit.
    pub options: &'a Options,
    /// Nearest surface point of every point.
    pub closest: &'a [Closest],
    /// Whether the fit used the point, in the same order.
    pub used: &'a [bool],
    /// Bands of height that the pose rests on alone, mm; none where it does not.
    pub datum_bands_mm: &'a [[f64; 2]],
    /// Place of every point; none off the features.
    pub places: &'a [Option<FlankPlace>],
    /// Thermal expansion; none where the tool is taken to be at the temperature of its CAD.
    pub expansion: Option<ExpansionUncertainty>,
    /// Whether the die's form as built is in doubt: only then is it asked how the pose passes it on, but of a patch's datum always.
    pub form_in_doubt: bool,
}

/// A mounting that was found to be the baseline's.
#[derive(Clone)]
pub struct FoundMount {
    /// Mounting that the baseline recorded.
    pub recorded: MountPose,
    /// Covariance of the approaches of the stages, those of the baseline and this one, about the tool's origin.
    pub approaches: Matrix6<f64>,
    /// Scales of its drift since, each with its probability.
    pub drifts: Vec<Drift>,
    /// Probability that it is another one all the same.
    pub remounted: f64,
}

/// Points of one flank in the judged radii and heights.
#[derive(Default)]
struct OnFlank {
    wear_mm: Vec<f64>,
    /// Sum of their motion rows about the cloud's centre.
    motion: Vector6<f64>,
}

impl OnFlank {
    fn motion(&self) -> Vector6<f64> {
        self.motion / self.wear_mm.len() as f64
    }
}

/// A part of a flank or patch whose form is off as a whole.
struct FormPart {
    key: (u32, Flank),
    height_mm: [f64; 2],
}

impl FormPart {
    fn whole(key: (u32, Flank)) -> Self {
        Self {
            key,
            height_mm: [f64::NEG_INFINITY, f64::INFINITY],
        }
    }

    fn holds(&self, place: &FlankPlace) -> bool {
        (place.tooth, place.flank) == self.key
            && (self.height_mm[0]..self.height_mm[1]).contains(&place.height_mm)
    }
}

impl FittedView<'_> {
    /// The sensitivities of both flanks of each of `teeth`, or of these patches.
    pub fn on(&self, teeth: &[u32]) -> Vec<PoseSensitivity> {
        let contacts: Vec<Contact> = self
            .closest
            .iter()
            .zip(self.used)
            .map(|(closest, &used)| Contact::from_closest(closest, self.registration, used))
            .collect();
        let response = Response::new(&contacts, self.registration, Some(self.prior), self.options);
        let of_each = teeth.par_iter();
        let of_each = of_each.map(|&tooth| self.of_tooth(tooth, &contacts, &response));
        of_each.flatten_iter().collect()
    }

    fn of_tooth(
        &self,
        tooth: u32,
        contacts: &[Contact],
        response: &Response<'_>,
    ) -> Vec<PoseSensitivity> {
        // One kelvin more than thought: every point farther from axis and seat by the expansion, less what the pose takes.
        let grown = |contact: &Contact| {
            let along: f64 = (0..3).map(|k| contact.point[k] * contact.normal[k]).sum();
            self.expansion.map_or(0.0, |of| of.per_k * along)
        };
        let answer = response.answer(|i| grown(&contacts[i]));
        let places = self.places;
        // A pose on a datum leaves no turn that shares wear between the sides, unless the datum wore.
        let mut datum_hides_mm = 0.0;
        let (evidence, others): (_, Vec<FormPart>) = match self.features {
            Features::Gear(_) if self.datum_bands_mm.is_empty() => {
                let seen = self.seen(places);
                let evidence = Arc::new(self.evidence(tooth, &seen));
                (
                    Some(evidence),
                    seen.into_keys().map(FormPart::whole).collect(),
                )
            }
            Features::Gear(_) => {
                datum_hides_mm = self.evidence(tooth, &self.seen(places)).datum_hides_mm();
                (None, self.parts_of_bands())
            }
            Features::Patches(_) => (None, self.keys().into_iter().map(FormPart::whole).collect()),
        };
        // Change of the pose by a unit error in the form of each other flank.
        let answers: Vec<_> = others
            .into_iter()
            .filter(|_| self.form_in_doubt || evidence.is_none())
            .filter(|part| part.key.0 != tooth || !self.datum_bands_mm.is_empty())
            .map(|part| {
                let on = |i: usize| f64::from(places[i].is_some_and(|place| part.holds(&place)));
                response.answer(on)
            })
            .collect();
        // Wear does not reach a band of the datum.
        let worn: Vec<Option<FlankPlace>> = places
            .iter()
            .zip(self.used)
            .map(|(place, used)| place.filter(|_| self.datum_bands_mm.is_empty() || !used))
            .collect();
        let leakage =
            leakage::of_feature(self.features, self.zone, tooth, response, contacts, &worn);
        let sides = self.features.sides().iter().zip(leakage);
        let of_side = |(&flank, leakage): (&Flank, Leakage)| {
            let (mut sum, mut count) = (0.0, 0.0);
            let mut passed_on = vec![0.0; answers.len()];
            for (contact, place) in contacts.iter().zip(places) {
                if place.is_some_and(|p| {
                    (p.tooth, p.flank) == (tooth, flank)
                        && self.zone.holds(p.radius_mm, p.height_mm)
                }) {
                    sum += grown(contact) + answer.at(contact);
                    count += 1.0;
                    for (passed_on, answer) in passed_on.iter_mut().zip(&answers) {
                        *passed_on += answer.at(contact);
                    }
                }
            }
            let mean = |sum: f64| if count > 0.0 { sum / count } else { 0.0 };
            let squares: f64 = passed_on.iter().map(|&sum| mean(sum).powi(2)).sum();
            PoseSensitivity {
                leakage,
                evidence: evidence.clone(),
                datum_hides_mm,
                form_scatter_mm: 0.0,
                others_form: squares.sqrt(),
                temperature_mm: self.expansion.map_or(0.0, |of| mean(sum).abs() * of.u_k),
            }
        };
        sides.map(of_side).collect()
    }

    /// The flanks or patches that were seen.
    fn keys(&self) -> BTreeSet<(u32, Flank)> {
        let seen = self.places.iter().flatten();
        seen.map(|place| (place.tooth, place.flank)).collect()
    }

    /// Parts of the datum's bands that have a form of their own: every flank as a whole (pitch), and each half of each band of it (helix).
    fn parts_of_bands(&self) -> Vec<FormPart> {
        let halves = self.datum_bands_mm.iter().flat_map(|&[low, high]| {
            let middle = 0.5 * (low + high);
            [[low, middle], [middle, high]]
        });
        let halves: Vec<[f64; 2]> = halves.collect();
        let of_flank = |key: (u32, Flank)| {
            let half = |&height_mm| FormPart { key, height_mm };
            let of_halves: Vec<FormPart> = halves.iter().map(half).collect();
            of_halves.into_iter().chain([FormPart::whole(key)])
        };
        self.keys().into_iter().flat_map(of_flank).collect()
    }

    /// Deviations and motion rows of each flank in view, of those with enough points.
    fn seen(&self, places: &[Option<FlankPlace>]) -> BTreeMap<(u32, Flank), OnFlank> {
        let centre = Vector3::from(self.registration.centre_mm);
        let mut flanks: BTreeMap<(u32, Flank), OnFlank> = BTreeMap::new();
        for (closest, place) in self.closest.iter().zip(places) {
            let Some(place) = place else { continue };
            if !self.zone.holds(place.radius_mm, place.height_mm)
                || !closest.signed_distance_mm.is_finite()
            {
                continue;
            }
            let on = flanks.entry((place.tooth, place.flank)).or_default();
            on.wear_mm.push(-closest.signed_distance_mm);
            on.motion += motion_row(closest.point, closest.normal, centre);
        }
        flanks.retain(|_, on| on.wear_mm.len() >= LEAST_POINTS);
        flanks
    }

    /// Evidence of the view about its own pose's turn about the axis.
    fn evidence(&self, tooth: u32, seen: &BTreeMap<(u32, Flank), OnFlank>) -> PoseEvidence {
        let centre = Vector3::from(self.registration.centre_mm);
        // A turn about the die's axis, as it moves the cloud's centre.
        let across = Vector3::z().cross(&centre);
        let about_axis = Vector6::new(0.0, 0.0, 1.0, across.x, across.y, across.z);
        let own = |flank| seen.get(&(tooth, flank)).map(OnFlank::motion);
        // Change of the left flank's wear less that of the right one, halved; a flank that is not seen is the other's mirror
        // image as far as a turn goes.
        let difference = match (own(Flank::Left), own(Flank::Right)) {
            (Some(left), Some(right)) => 0.5 * (right - left),
            (Some(left), None) => -left,
            (None, Some(right)) => right,
            (None, None) => Vector6::zeros(),
        };
        let unit = difference.dot(&about_axis);
        let flanks = seen
            .iter()
            .map(|(&(tooth, flank), on)| SeenFlank {
                tooth: Some(tooth),
                flank,
                median_mm: median_of(on.wear_mm.iter().copied()).unwrap_or(f64::NAN),
                per_turn: -on.motion().dot(&about_axis) / unit,
            })
            .collect();
        // The motion about the cloud's centre from the fitted pose to another one.
        let to = |expected: &Isometry3<f64>| {
            let motion = expected * self.registration.tool_from_cloud.isometry().inverse();
            let turn = motion.rotation.scaled_axis();
            let shift = motion * Point3::from(centre) - Point3::from(centre);
            Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
        };
        let back = to(self.stages.tool_from_cloud.isometry());
        let away = centre - Vector3::from(self.stages.pivot_mm);
        let sigma = |of: Vector6<f64>, covariance: &Matrix6<f64>| {
            of.dot(&(about(away, covariance) * of)).max(0.0).sqrt()
        };
        let all = &self.stages.covariance;
        // Of both sides alike: the mean of the two flanks' motions.
        let both = match (own(Flank::Left), own(Flank::Right)) {
            (Some(left), Some(right)) => -0.5 * (left + right),
            (Some(one), None) | (None, Some(one)) => -one,
            (None, None) => Vector6::zeros(),
        };
        let across = across.normalize();
        let same_mount = self.same_mount.map(|mount| {
            let back = to(mount
                .recorded
                .expected(&self.stages.tool_from_cloud)
                .isometry());
            let along: f64 = (0..3).map(|k| difference[3 + k] * across[k]).sum();
            let approaches = difference.dot(&(about(centre, &mount.approaches) * difference));
            let approaches_mm = approaches.max(0.0).sqrt();
            let stated = |drift: &Drift| Statement {
                probability: drift.probability,
                at_mm: difference.dot(&back) + along * drift.along_mm,
                sigma_mm: approaches_mm.hypot(along * drift.along_u_mm),
            };
            SameMount {
                stages: mount.drifts.iter().map(stated).collect(),
                remounted: mount.remounted,
                both_mm: both.dot(&back),
            }
        });
        PoseEvidence {
            tooth: Some(tooth),
            flanks,
            stages_mm: difference.dot(&back),
            approach_sigma_mm: sigma(difference, &self.approach),
            mount_sigma_mm: sigma(difference, &(all - self.approach)),
            stages_both_mm: both.dot(&back),
            both_sigma_mm: sigma(both, all),
            mount: None,
            same_mount,
        }
    }
}

/// A motion's covariance (rotation, translation) about a point that lies `away` from where it is stated.
fn about(away: Vector3<f64>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    // A rotation w moves that point by w x away = -[away]x w.
    let cross = Matrix3::new(
        0.0, -away.z, away.y, away.z, 0.0, -away.x, -away.y, away.x, 0.0,
    );
    let mut moved = Matrix6::identity();
    moved.fixed_view_mut::<3, 3>(3, 0).copy_from(&-cross);
    moved * covariance * moved.transpose()
}
