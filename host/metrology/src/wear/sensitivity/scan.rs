//! Effect of the adjusted poses of a scan's views on the flanks that they were planned for.

use std::collections::BTreeMap;
use std::sync::Arc;

use flankscope_foundation::rigid::{Camera, Rigid, Tool};
use nalgebra::{Matrix6, Vector3};

use super::super::leakage::{Leakage, of_feature};
use super::super::{PoseEvidence, Zone, places};
use super::{ExpansionUncertainty, PoseSensitivity, motion_row};
use crate::gear::{Flank, FlankPlace, GearData};
use crate::registration::{Contact, Options, Prior, Response};
use crate::surface::Surface;

/// Neighbouring points of a view share the form of the piece: so many patches are independent, each known to so much (mm), as
/// the adjustment counts them.
const PATCHES: f64 = 80.0;
const FORM_MM: f64 = 10e-3;
/// A flank with fewer of a view's sample lies at its rim.
const LEAST_OF_SAMPLE: usize = 25;

/// One view of a scan after the adjustment.
pub struct ScanView<'a> {
    /// Teeth of the tool.
    pub gear: &'a GearData,
    /// CAD surface of the tool.
    pub surface: &'a Surface,
    /// Tooth in the middle of the view.
    pub tooth: u32,
    /// Height of the view's middle, mm.
    pub vertical_mm: f64,
    /// Radii and heights of the tooth that the view was planned for.
    pub zone: Zone,
    /// Sample of the view's points, mm.
    pub sample: &'a [[f64; 3]],
    /// Adjusted pose.
    pub tool_from_camera: Rigid<Tool, Camera>,
    /// Centre of the view's points, mm.
    pub centre_mm: [f64; 3],
    /// Prior of the view's pose by the stages alone, as if nothing were known of die and head but their files: the wear of all
    /// flanks could have moved all views.
    pub prior: &'a Prior,
    /// Covariance of the adjusted pose about the centre.
    pub covariance: &'a Matrix6<f64>,
}

/// Effect of one view's pose on the flanks of its middle tooth.
#[derive(Clone)]
pub struct HeldView {
    tooth: u32,
    vertical_mm: f64,
    /// Left, right.
    leakage: Vec<Leakage>,
    /// Standard uncertainty of either flank's deviation by the pose, mm.
    sigma_mm: [f64; 2],
    /// Number of flanks in view.
    flanks: usize,
}

impl ScanView<'_> {
    /// Leakage and uncertainty of the view's pose on the flanks of its middle tooth.
    pub fn held(&self) -> HeldView {
        let located: Vec<[f64; 3]> = self
            .sample
            .iter()
            .map(|&p| self.tool_from_camera.apply(p))
            .collect();
        let closest = self.surface.closest_many(&located);
        let contacts: Vec<Contact> = closest
            .iter()
            .map(|hit| Contact {
                point: hit.point,
                normal: hit.normal,
                weight: FORM_MM.powi(-2),
            })
            .collect();
        let places = places(self.gear, &closest);
        let centre = Vector3::from(self.centre_mm);
        let squares: f64 = contacts
            .iter()
            .map(|of| (Vector3::from(of.point) - centre).norm_squared())
            .sum();
        let count = contacts.len().max(1) as f64;
        let options = Options {
            correlated_points: count / PATCHES,
            ..Options::default()
        };
        // The expected pose is where the view is: what is asked is how deviations would move it.
        let prior = Prior {
            tool_from_cloud: Rigid::from_isometry(*self.tool_from_camera.isometry()),
            ..self.prior.clone()
        };
        let at = (self.centre_mm, (squares / count).sqrt());
        let response = Response::of_points(&contacts, at, Some(&prior), &options);
        let mut seen: BTreeMap<(u32, Flank), usize> = BTreeMap::new();
        for place in places.iter().flatten() {
            *seen.entry((place.tooth, place.flank)).or_default() += 1;
        }
        let leakage = of_feature(
            self.gear, &self.zone, self.tooth, &response, &contacts, &places,
        );
        let sigma_mm = Flank::BOTH.map(|flank| {
            let own = |place: &Option<FlankPlace>| {
                place.is_some_and(|of| (of.tooth, of.flank) == (self.tooth, flank))
            };
            contacts
                .iter()
                .zip(&places)
                .filter(|(_, place)| own(place))
                .map(|(of, _)| {
                    let row = motion_row(of.point, of.normal, centre);
                    row.dot(&(self.covariance * row)).max(0.0).sqrt()
                })
                .fold(0.0, f64::max)
        });
        HeldView {
            tooth: self.tooth,
            vertical_mm: self.vertical_mm,
            leakage,
            sigma_mm,
            flanks: seen.values().filter(|n| **n >= LEAST_OF_SAMPLE).count(),
        }
    }
}

/// Standard uncertainty of a zone's deviation by the poses of the views that were planned for it, mm: that of the worst view,
/// at least `least_mm`.
pub fn registration_mm(held: &[HeldView], key: (u32, Flank), zone: &Zone, least_mm: f64) -> f64 {
    of_zone(held, key, zone)
        .map(|(of, side)| of.sigma_mm[side])
        .fold(least_mm, worse)
}

/// Effect of pose and temperature on the flanks of a scan.
pub struct ScanSensitivity<'a> {
    /// Teeth of the tool.
    pub gear: &'a GearData,
    /// All views.
    pub held: &'a [HeldView],
    /// Evidence of all flanks about the turn of the die.
    pub evidence: &'a Arc<PoseEvidence>,
    /// Standard uncertainty of the die's form by the scatter of its flanks, mm.
    pub form_scatter_mm: f64,
    /// Thermal expansion; none where the tool is taken to be at the temperature of its CAD.
    pub expansion: Option<ExpansionUncertainty>,
}

impl ScanSensitivity<'_> {
    /// Effect on one zone of a flank: that of the worst of the views that were planned for it. None without any view.
    pub fn on(&self, key: (u32, Flank), zone: &Zone) -> Option<PoseSensitivity> {
        let (worst, side) = of_zone(self.held, key, zone).reduce(|a, b| {
            let leaks = |(of, side): (&HeldView, usize)| of.leakage[side].worst();
            if leaks(b) > leaks(a) || leaks(b).is_nan() {
                b
            } else {
                a
            }
        })?;
        let leakage = worst.leakage[side];
        // Growing towards the axis by what a thermometer leaves: a flank feels the part along its normal, at most all of it
        // that its normal's angle lets through. That the poses may take it up is not counted on.
        let temperature_mm = self.expansion.map_or(0.0, |of| {
            let radius_mm = 0.5 * (zone.radius_mm[0] + zone.radius_mm[1]);
            let cos = (self.gear.base_radius_mm() / radius_mm).min(1.0);
            of.per_k * of.u_k * radius_mm * (1.0 - cos * cos).sqrt()
        });
        Some(PoseSensitivity {
            leakage,
            evidence: Some(Arc::clone(self.evidence)),
            datum_hides_mm: 0.0,
            form_scatter_mm: self.form_scatter_mm,
            // Every other flank in view passes on as much as this one.
            others_form: leakage.uniform * (worst.flanks.saturating_sub(1) as f64).sqrt(),
            temperature_mm,
        })
    }
}

/// The views that were planned for a zone of a flank, each with the index of its side; all views for a zone without any.
fn of_zone<'a>(
    held: &'a [HeldView],
    (tooth, flank): (u32, Flank),
    zone: &Zone,
) -> impl Iterator<Item = (&'a HeldView, usize)> {
    let side = usize::from(flank == Flank::Right);
    let [low, high] = zone.height_mm;
    let own = move |of: &&HeldView| of.tooth == tooth && (low..high).contains(&of.vertical_mm);
    let any = !held.iter().any(|of| own(&of));
    held.iter()
        .filter(move |of| any || own(of))
        .map(move |of| (of, side))
}

/// The larger; NaN if one is NaN.
fn worse(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}
