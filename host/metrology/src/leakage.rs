//! Wear that a registration takes for motion and hides.
//!
//! Leakage is the part of a wear field that the pose answers: norm of what it takes away over norm of the wear, both over
//! the judged zone. It is computed for three templates on the judged flank alone (uniform loss, a slope from tip to root,
//! a pit of 1 mm2) and, since a press wears all teeth alike, for uniform loss of the same side of every tooth in view,
//! of which a fit to the neighbours takes a part for motion. How much that may be, the rest that the neighbours show tells.

use std::collections::BTreeMap;

use crate::gear::{Flank, FlankPlace, GearData};
use crate::registration::{Contact, Response};
use crate::surface::Closest;
use crate::wear::Zone;

/// Up to this leakage nothing is corrected.
pub const ACCEPTED: f64 = 0.10;
/// Beyond this leakage wear cannot be recovered.
pub const RECOVERABLE: f64 = 0.50;
/// Of shared wear no more than this counts as hidden: what the neighbours then show of it is too little to tell more by.
const MOST_SHARED: f64 = 0.75;
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
    /// Uniform loss of this side of every tooth in view: what the neighbours' own wear tells of the part that the pose hides.
    pub common: f64,
}

/// What the leakage allows to be said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Recovery {
    /// Wear counts as measured.
    Accepted,
    /// Wear is divided by the part that stays visible.
    Corrected {
        /// 1 / (1 - leakage).
        factor: f64,
    },
    /// The pose hides too much.
    Refused,
}

impl Leakage {
    /// The worst of the three templates on the judged flank.
    pub fn worst(&self) -> f64 {
        // f64::max would pass over a NaN.
        [self.uniform, self.slope, self.pit]
            .into_iter()
            .fold(
                0.0,
                |worst, x| if x > worst || x.is_nan() { x } else { worst },
            )
    }

    /// What may be done about it.
    pub fn recovery(&self) -> Recovery {
        let worst = self.worst();
        if worst <= ACCEPTED {
            Recovery::Accepted
        } else if worst <= RECOVERABLE {
            Recovery::Corrected {
                factor: 1.0 / (1.0 - self.uniform),
            }
        } else {
            Recovery::Refused
        }
    }

    /// Standard uncertainty by wear that all teeth share, when `seen_mm` of it is left to see on the others, mm. The pose has
    /// divided it between left and right flanks; how it really was, nothing tells: rectangular, by all that may be hidden.
    pub fn u_shared_mm(&self, seen_mm: f64) -> f64 {
        let hidden = self.common.min(MOST_SHARED);
        seen_mm.abs() * hidden / (1.0 - hidden) / 3f64.sqrt()
    }

    /// Standard uncertainty that leakage leaves in `wear_mm` (rectangular): of the whole leakage where nothing is
    /// corrected, of the spread between the templates where it is, mm.
    pub fn u_mm(&self, wear_mm: f64) -> f64 {
        let open = match self.recovery() {
            Recovery::Corrected { factor } => (self.worst() - self.uniform).abs() * factor,
            Recovery::Accepted | Recovery::Refused => self.worst(),
        };
        wear_mm.abs() * open / 3f64.sqrt()
    }
}

/// Teeth beside the judged one that must show the same for it to count as shared, and points on each.
const LEAST_TEETH: usize = 2;
const LEAST_POINTS: usize = 100;

/// Wear that the same side of the other teeth in view shows, mm: the median of their means over the zone's radii and
/// heights; 0 where fewer than two are seen.
pub fn shared_mm(
    zone: &Zone,
    (tooth, flank): (u32, Flank),
    closest: &[Closest],
    places: &[Option<FlankPlace>],
) -> f64 {
    let mut teeth: BTreeMap<u32, (f64, usize)> = BTreeMap::new();
    for (closest, place) in closest.iter().zip(places) {
        let Some(place) = place else { continue };
        let wear_mm = -closest.signed_distance_mm;
        if place.flank == flank
            && place.tooth != tooth
            && zone.holds(place.radius_mm, place.height_mm)
            && wear_mm.is_finite()
        {
            let (sum, count) = teeth.entry(place.tooth).or_default();
            (*sum, *count) = (*sum + wear_mm, *count + 1);
        }
    }
    let mut means: Vec<f64> = teeth
        .values()
        .filter(|(_, count)| *count >= LEAST_POINTS)
        .map(|(sum, count)| sum / *count as f64)
        .collect();
    if means.len() < LEAST_TEETH {
        return 0.0;
    }
    let middle = means.len() / 2;
    *means.select_nth_unstable_by(middle, f64::total_cmp).1
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
        common: leaks(&|place| f64::from(place.flank == flank)),
    }
}
