//! What the pose and the temperature do to a flank's figures.

use flankscope_metrology::gear::{Flank, FlankPlace, GearData};
use flankscope_metrology::leakage;
use flankscope_metrology::registration::{Contact, Options, Prior, Registration, Response};
use flankscope_metrology::surface::Closest;
use flankscope_metrology::tool::Temperature;
use flankscope_metrology::wear::{Influence, Zone, places};

/// A view after its fit.
pub(super) struct Fitted<'a> {
    pub gear: &'a GearData,
    pub zone: &'a Zone,
    pub registration: &'a Registration,
    pub prior: &'a Prior,
    pub options: &'a Options,
    /// Every point on the surface, and whether the fit used it.
    pub closest: &'a [Closest],
    pub used: &'a [bool],
    pub temperature: Option<&'a Temperature>,
}

impl Fitted<'_> {
    /// The influences on both flanks of `tooth`.
    pub fn on(&self, tooth: u32) -> [Influence; 2] {
        let contacts: Vec<Contact> = self
            .closest
            .iter()
            .zip(self.used)
            .map(|(closest, &used)| Contact::of(closest, self.registration, used))
            .collect();
        let places = places(self.gear, self.closest);
        let response = Response::new(&contacts, self.registration, Some(self.prior), self.options);
        // One kelvin more than thought: every point farther from axis and seat by the expansion, less what the pose takes.
        let grown = |contact: &Contact| {
            let along: f64 = (0..3).map(|k| contact.point[k] * contact.normal[k]).sum();
            self.temperature.map_or(0.0, |t| t.expansion_per_k * along)
        };
        let answer = response.answer(|i| grown(&contacts[i]));
        Flank::BOTH.map(|flank| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (contact, place) in contacts.iter().zip(&places) {
                if place.is_some_and(|p| {
                    (p.tooth, p.flank) == (tooth, flank)
                        && self.zone.holds(p.radius_mm, p.height_mm)
                }) {
                    sum += grown(contact) + answer.at(contact);
                    count += 1.0;
                }
            }
            let per_kelvin: f64 = if count > 0.0 { sum / count } else { 0.0 };
            Influence {
                leakage: leakage::of_flank(
                    self.gear,
                    self.zone,
                    (tooth, flank),
                    &response,
                    &contacts,
                    &places,
                ),
                shared_mm: self.shared_mm((tooth, flank), &places),
                temperature_mm: self.temperature.map_or(0.0, |t| per_kelvin.abs() * t.u_k),
            }
        })
    }

    /// Wear that the other teeth show; none where the judged flank itself is in the fit, since then they show what it moved
    /// the pose by.
    fn shared_mm(&self, judged: (u32, Flank), places: &[Option<FlankPlace>]) -> f64 {
        let is_judged = |place: &Option<FlankPlace>| {
            place.is_some_and(|place| (place.tooth, place.flank) == judged)
        };
        if places
            .iter()
            .zip(self.used)
            .any(|(place, &used)| used && is_judged(place))
        {
            return 0.0;
        }
        leakage::shared_mm(self.zone, judged, self.closest, places)
    }
}
