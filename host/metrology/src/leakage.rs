//! Wear that a registration takes for motion and hides.
//!
//! Leakage is the part of a wear field that the pose answers: norm of what it takes away over norm of the wear, both over
//! the judged zone. It is computed for three templates on the judged flank alone (uniform loss, a slope from tip to root,
//! a pit of 1 mm2), and for loss that a press spreads over all teeth: of this side, of both sides, of the whole ring with its
//! lands. What a turn hides of the first of these, the view's evidence tells ([`crate::wear::PoseEvidence`]); of the other two
//! what is left to see on the flanks tells how much may be hidden.

use crate::gear::{Flank, FlankPlace, GearData};
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
    /// A round pit of 1 mm2 in the middle of the zone.
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

    /// Standard uncertainty that the pose leaves in `wear_mm` of the judged flank, mm: rectangular, of all that it may hide.
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

/// The leakage of one flank. `places` says where each contact of the response lies, none off the flanks.
pub fn of_flank(
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
