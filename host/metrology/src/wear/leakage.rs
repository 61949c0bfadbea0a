//! Wear that a registration takes for motion and hides.
//!
//! Leakage is the part of a wear field that the pose answers: norm of what it takes away over norm of the wear, both over
//! the judged zone. It is computed for three templates on the judged flank alone (uniform loss, a slope from tip to root,
//! a pit of 1 mm2), and for loss that a press spreads over all teeth: of this side, of both sides, of the whole ring with its
//! lands. What a turn hides of the first of these, the view's evidence tells ([`crate::wear::PoseEvidence`]); of the other two
//! what is left to see on the flanks tells how much may be hidden.

use crate::feature::Features;
use crate::gear::{Flank, FlankPlace};
use crate::registration::{Contact, Response};
use crate::wear::Zone;

/// Beyond this leakage of wear on the judged flank what is left to see says too little.
pub const RECOVERABLE: f64 = 0.50;
/// Radius of a round pit of 1 mm2, mm.
const PIT_RADIUS_MM: f64 = 0.564_189_583_547_756_3;

/// Leakage of one flank per template, 0 (nothing hidden) to about 1 (all hidden); NaN where nothing was seen.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Leakage {
    /// Uniform loss of the judged flank.
    pub uniform: f64,
    /// Loss falling linearly from tip to root of the judged flank.
    pub slope: f64,
    /// A round pit of 1 mm2 in the middle of the zone, or as near to it as the flank was seen.
    pub pit: f64,
    /// Uniform loss of this side of every tooth in view.
    pub side: f64,
    /// Uniform loss of both sides of every tooth in view.
    pub flanks: f64,
    /// Uniform loss of everything in view, lands included.
    pub ring: f64,
}

impl Leakage {
    /// The worst of the templates on the judged flank alone.
    pub fn worst(&self) -> f64 {
        worst(&[self.uniform, self.slope, self.pit])
    }

    /// The worst of the templates that leave both sides alike.
    pub fn worst_of_all(&self) -> f64 {
        worst(&[self.flanks, self.ring])
    }

    /// Standard uncertainty of `wear_mm` of the judged flank by leakage, mm: rectangular over all wear that the pose may hide.
    pub fn u_mm(&self, wear_mm: f64) -> f64 {
        wear_mm.abs() * self.worst() / 3f64.sqrt()
    }

    /// Standard uncertainty by wear of all flanks alike, of which `seen_mm` are left to see, mm: rectangular, by all that may
    /// be hidden beside it; not finite where the pose hides all of it.
    pub fn u_of_all_mm(&self, seen_mm: f64) -> f64 {
        let hidden = self.worst_of_all();
        seen_mm.abs() * hidden / (1.0 - hidden).max(0.0) / 3f64.sqrt()
    }
}

/// The largest; NaN if one is NaN, which f64::max would pass over.
fn worst(of: &[f64]) -> f64 {
    of.iter().fold(
        0.0,
        |worst, &x| if x > worst || x.is_nan() { x } else { worst },
    )
}

/// Wear that one place has by each template, for one side of a tooth.
struct Templates {
    key: (u32, Flank),
    tip: f64,
    root: f64,
    middle: [f64; 2],
}

impl Templates {
    /// Uniform, slope, pit, side, flanks: in the order of [`Leakage`].
    fn at(&self, place: &FlankPlace) -> [f64; 5] {
        let (tooth, flank) = self.key;
        let side = f64::from(place.flank == flank);
        if (place.tooth, place.flank) != (tooth, flank) {
            return [0.0, 0.0, 0.0, side, 1.0];
        }
        let slope = (self.root - place.profile_mm) / (self.root - self.tip);
        let away = (place.profile_mm - self.middle[0]).hypot(place.height_mm - self.middle[1]);
        let pit = f64::from(away <= PIT_RADIUS_MM);
        [1.0, slope.clamp(0.0, 1.0), pit, side, 1.0]
    }
}

/// Place of the pit on a side of a tooth: the middle of the zone, or the seen place nearest to it where the pit would lie outside of
/// what was seen, as on a neighbour of which a view shows a part.
fn place_of_pit(
    middle: [f64; 2],
    key: (u32, Flank),
    zone: &Zone,
    places: &[Option<FlankPlace>],
) -> [f64; 2] {
    let from_middle =
        |place: &FlankPlace| (place.profile_mm - middle[0]).hypot(place.height_mm - middle[1]);
    let on_side = places.iter().flatten().filter(|place| {
        (place.tooth, place.flank) == key && zone.holds(place.radius_mm, place.height_mm)
    });
    let nearest = on_side.min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)));
    match nearest {
        Some(place) if from_middle(place) > PIT_RADIUS_MM => [place.profile_mm, place.height_mm],
        _ => middle,
    }
}

/// The leakage of both flanks of a tooth, left first, or of a patch. `places` says where each contact of the response lies, none
/// off the features. A patch slopes from end to end of its zone.
pub fn of_feature<'a>(
    features: impl Into<Features<'a>>,
    zone: &Zone,
    tooth: u32,
    response: &Response<'_>,
    contacts: &[Contact],
    places: &[Option<FlankPlace>],
) -> Vec<Leakage> {
    let features = features.into();
    let [from, to] = zone.radius_mm.map(|r| features.along_mm(r));
    let [tip, root] = features.gear().map_or([from, to], |gear| {
        [gear.tip_radius_mm, gear.root_radius_mm].map(|r| gear.profile_mm(r))
    });
    let [low, high] = zone.height_mm;
    let middle = [0.5 * (from + to), 0.5 * (low + high)];
    let templates = features.sides().iter().map(|&flank| Templates {
        key: (tooth, flank),
        tip,
        root,
        middle: place_of_pit(middle, (tooth, flank), zone, places),
    });
    let templates: Vec<Templates> = templates.collect();
    // One pass over the contacts for all that is asked: five templates for either side, and the ring.
    let answers = response.answers(|i| {
        let mut fields = [0.0; 11];
        if let Some(place) = &places[i] {
            let of_sides = templates.iter().flat_map(|side| side.at(place));
            for (field, wear) in fields.iter_mut().zip(of_sides) {
                *field = -wear;
            }
        }
        fields[10] = -1.0;
        fields
    });
    let of_side = |side: usize| {
        let mut hidden = [0.0; 5];
        let mut worn = [0.0; 5];
        let (mut of_ring, mut count) = (0.0, 0.0);
        for (contact, place) in contacts.iter().zip(places) {
            let Some(place) = place.as_ref().filter(|place| {
                (place.tooth, place.flank) == templates[side].key
                    && zone.holds(place.radius_mm, place.height_mm)
            }) else {
                continue;
            };
            for (k, wear) in templates[side].at(place).into_iter().enumerate() {
                if wear > 0.0 {
                    hidden[k] += answers[5 * side + k].at(contact).powi(2);
                    worn[k] += wear * wear;
                }
            }
            of_ring += answers[10].at(contact).powi(2);
            count += 1.0;
        }
        let leaks = |k: usize| f64::sqrt(hidden[k] / worn[k]);
        Leakage {
            uniform: leaks(0),
            slope: leaks(1),
            pit: leaks(2),
            side: leaks(3),
            flanks: leaks(4),
            ring: f64::sqrt(of_ring / count),
        }
    };
    (0..templates.len()).map(of_side).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};

    use super::*;
    use crate::gear::GearData;
    use crate::gear::tests::ring84;
    use crate::registration::{Options, Prior};
    use flankscope_foundation::random::uniform;
    use flankscope_foundation::rigid::Rigid;

    /// The leakage of one flank, template by template: what [`of_feature`] has to equal. `places` says where each contact of the
    /// response lies, none off the flanks.
    fn of_flank(
        gear: &GearData,
        zone: &Zone,
        (tooth, flank): (u32, Flank),
        response: &Response<'_>,
        contacts: &[Contact],
        places: &[Option<FlankPlace>],
    ) -> Leakage {
        let [tip, root] = [gear.tip_radius_mm, gear.root_radius_mm].map(|r| gear.profile_mm(r));
        let [from, to] = zone.radius_mm.map(|r| gear.profile_mm(r));
        let middle = [
            0.5 * (from + to),
            0.5 * (zone.height_mm[0] + zone.height_mm[1]),
        ];
        let middle = place_of_pit(middle, (tooth, flank), zone, places);
        let own = |place: &&FlankPlace| (place.tooth, place.flank) == (tooth, flank);
        let leaks = |shape: &dyn Fn(&FlankPlace) -> f64| {
            let field = |i: usize| places[i].as_ref().map_or(0.0, |place| -shape(place));
            let answer = response.answer(field);
            let (mut hidden, mut worn) = (0.0, 0.0);
            for (i, place) in places.iter().enumerate() {
                let Some(place) = place.as_ref().filter(own) else {
                    continue;
                };
                if !zone.holds(place.radius_mm, place.height_mm) {
                    continue;
                }
                let wear = shape(place);
                if wear > 0.0 {
                    hidden += answer.at(&contacts[i]).powi(2);
                    worn += wear * wear;
                }
            }
            (hidden / worn).sqrt()
        };
        let ring = {
            let answer = response.answer(|_| -1.0);
            let hidden: Vec<f64> = contacts
                .iter()
                .zip(places)
                .filter(|(_, place)| {
                    place.as_ref().is_some_and(|place| {
                        own(&place) && zone.holds(place.radius_mm, place.height_mm)
                    })
                })
                .map(|(contact, _)| answer.at(contact).powi(2))
                .collect();
            (hidden.iter().sum::<f64>() / hidden.len() as f64).sqrt()
        };
        let on_own = |place: &FlankPlace, depth: f64| if own(&place) { depth } else { 0.0 };
        Leakage {
            uniform: leaks(&|place| on_own(place, 1.0)),
            slope: leaks(&|place| {
                on_own(
                    place,
                    ((root - place.profile_mm) / (root - tip)).clamp(0.0, 1.0),
                )
            }),
            pit: leaks(&|place| {
                let away = (place.profile_mm - middle[0]).hypot(place.height_mm - middle[1]);
                on_own(place, f64::from(away <= PIT_RADIUS_MM))
            }),
            side: leaks(&|place| f64::from(place.flank == flank)),
            flanks: leaks(&|_| 1.0),
            ring,
        }
    }

    #[test]
    fn one_pass_for_all_templates_says_what_one_pass_each_does() {
        let gear = ring84();
        let zone = Zone {
            radius_mm: gear.active_flank_mm(),
            height_mm: [29.0, 37.0],
        };
        // Flanks of three teeth, and lands.
        let (contacts, places): (Vec<Contact>, Vec<Option<FlankPlace>>) = (0..6000)
            .map(|i| {
                let u = |k: u64| uniform(11, 8 * i + k);
                let tooth = 39 + (3.0 * u(0)) as u32;
                let flank = Flank::BOTH[usize::from(u(1) < 0.5)];
                let radius = 41.0 + 2.2 * u(2);
                let point = gear
                    .flank_point(tooth, flank, radius, 28.0 + 10.0 * u(3))
                    .unwrap();
                let land = u(4) < 0.2;
                let normal = if land {
                    let out = -Vector3::new(point[0], point[1], 0.0).normalize();
                    out.into()
                } else {
                    gear.flank_normal(flank, point)
                };
                let contact = Contact {
                    point,
                    normal,
                    weight: if u(5) < 0.3 { 0.0 } else { 1e4 * (0.5 + u(6)) },
                };
                (contact, gear.place(point, normal))
            })
            .unzip();
        let pose = Rigid::from_isometry(Isometry3::identity());
        let prior = Prior::independent(pose, [2e-4; 3], [1e-2; 3]);
        let options = Options::default();
        let centre = gear.flank_point(40, Flank::Left, 42.0, 33.0).unwrap();
        let response = Response::of_points(&contacts, (centre, 4.0), Some(&prior), &options);
        let both = of_feature(&gear, &zone, 40, &response, &contacts, &places);
        for (of, flank) in both.into_iter().zip(Flank::BOTH) {
            let simple = of_flank(&gear, &zone, (40, flank), &response, &contacts, &places);
            assert_eq!(of, simple, "{flank}");
            assert!(of.uniform > 0.0 && of.ring > of.pit);
        }
    }

    /// A neighbour at the rim of the field shows a corner of its zone: what the pose may hide there is known, and not a number only
    /// where nothing was seen.
    #[test]
    fn a_flank_seen_in_part_has_its_pit_where_it_was_seen() {
        let gear = ring84();
        let zone = Zone {
            radius_mm: gear.active_flank_mm(),
            height_mm: [29.0, 37.0],
        };
        let (contacts, places): (Vec<Contact>, Vec<Option<FlankPlace>>) = (0..4000)
            .map(|i| {
                let u = |k: u64| uniform(12, 4 * i + k);
                let tooth = 39 + (2.0 * u(0)) as u32;
                let flank = Flank::BOTH[usize::from(u(1) < 0.5)];
                // Of tooth 40 the left flank is seen above 35.5 mm, the right one not at all.
                let flank = if tooth == 40 { Flank::Left } else { flank };
                let low = if tooth == 40 { 35.5 } else { 29.0 };
                let height = low + (37.0 - low) * u(2);
                let point = gear.flank_point(tooth, flank, 41.0 + u(3), height).unwrap();
                let normal = gear.flank_normal(flank, point);
                let weight = if tooth == 39 { 1e4 } else { 0.0 };
                let contact = Contact {
                    point,
                    normal,
                    weight,
                };
                (contact, gear.place(point, normal))
            })
            .unzip();
        let pose = Rigid::from_isometry(Isometry3::identity());
        let prior = Prior::independent(pose, [2e-4; 3], [1e-2; 3]);
        let options = Options::default();
        let centre = gear.flank_point(40, Flank::Left, 41.5, 33.0).unwrap();
        let response = Response::of_points(&contacts, (centre, 4.0), Some(&prior), &options);
        let both = of_feature(&gear, &zone, 40, &response, &contacts, &places);
        assert!((0.0..1.0).contains(&both[0].worst()), "{:?}", both[0]);
        assert!(both[1].worst().is_nan(), "{:?}", both[1]);
    }
}
