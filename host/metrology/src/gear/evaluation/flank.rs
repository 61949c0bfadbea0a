//! The figures of one flank.

use nalgebra::{Matrix3, Vector3};

use super::gather::OwnPoints;
use super::limits::roll_mm;
use super::not_told::split;
use super::trace::{self, Course, TracePoint, TraceProblem};
use super::{
    EvaluationRange, EvaluationSettings, FlankFigures, NotTold, PointNearFlank, TraceFigures, areal,
};
use crate::gear::GearData;

/// Fewer points than this near the measuring circle leave a flank's position open.
const LEAST_POSITION_POINTS: usize = 8;

/// Profile, helix, areal and position figures of the points of one flank.
pub(super) fn figures(
    gear: &GearData,
    own: &OwnPoints,
    limits: &EvaluationRange,
    settings: &EvaluationSettings,
) -> FlankFigures {
    let points: Vec<PointNearFlank> = own.points().collect();
    let flank = FlankPoints::new(gear, &points, limits, settings);
    let (profile, profile_not_told) = split(flank.profile());
    let (helix, helix_not_told) = split(flank.helix());
    let (areal, areal_not_told) = split(flank.areal());
    let (position, position_not_told) = split(position_um(&flank.near_position()));
    FlankFigures {
        tooth: own.tooth,
        flank: own.flank,
        profile,
        profile_not_told,
        helix,
        helix_not_told,
        areal,
        areal_not_told,
        position_um: position.map(|[um, _]| um),
        position_noise_um: position.map(|[_, noise_um]| noise_um),
        position_not_told,
    }
}

/// The points of a flank, and where on it they count. Lengths run from the root end (or the lower end) on.
struct FlankPoints<'a> {
    gear: &'a GearData,
    points: &'a [PointNearFlank],
    limits: &'a EvaluationRange,
    settings: &'a EvaluationSettings,
    /// Roll lengths of the measuring circle, the control circle and the tip form circle, mm.
    measuring_mm: f64,
    control_mm: f64,
    tip_form_mm: f64,
    /// Evaluated length of the profile, mm.
    evaluated_mm: f64,
    /// Height of mid face, mm.
    middle_mm: f64,
}

impl<'a> FlankPoints<'a> {
    fn new(
        gear: &'a GearData,
        points: &'a [PointNearFlank],
        limits: &'a EvaluationRange,
        settings: &'a EvaluationSettings,
    ) -> Self {
        let [low, high] = gear.height_mm;
        let roll = |radius| roll_mm(gear, radius);
        let control_mm = roll(limits.control_radius_mm);
        Self {
            gear,
            points,
            limits,
            settings,
            measuring_mm: roll(gear.pitch_radius_mm()),
            control_mm,
            tip_form_mm: roll(limits.tip_form_radius_mm),
            evaluated_mm: (roll(limits.evaluated_to_radius_mm) - control_mm).abs(),
            middle_mm: 0.5 * (low + high),
        }
    }

    fn towards_tip(&self) -> f64 {
        (self.tip_form_mm - self.control_mm).signum()
    }

    /// Length of the profile from the root end to a point, mm.
    fn along(&self, point: &PointNearFlank) -> f64 {
        (point.roll_mm - self.control_mm) * self.towards_tip()
    }

    fn usable_mm(&self) -> f64 {
        (self.tip_form_mm - self.control_mm).abs()
    }

    fn helix_mm(&self) -> f64 {
        let [low, high] = self.limits.helix_heights_mm;
        high - low
    }

    fn half_band_mm(&self) -> f64 {
        0.5 * self.settings.band_mm
    }

    fn is_at_mid_face(&self, point: &PointNearFlank) -> bool {
        (point.height_mm - self.middle_mm).abs() <= self.settings.band_mm
    }

    fn is_at_measuring_circle(&self, point: &PointNearFlank) -> bool {
        (point.roll_mm - self.measuring_mm).abs() <= self.half_band_mm()
    }

    fn profile(&self) -> Result<TraceFigures, NotTold> {
        let at_mid_face = self.points.iter().filter(|p| self.is_at_mid_face(p));
        let samples: Vec<TracePoint> = at_mid_face
            .map(|point| TracePoint {
                at: self.along(point),
                across: point.height_mm - self.middle_mm,
                deviation: point.deviation_mm,
            })
            .collect();
        let [from, to] = self
            .limits
            .slope_radii_mm
            .map(|radius| roll_mm(self.gear, radius));
        let course = Course {
            range: [0.0, self.evaluated_mm],
            stated_mm: (to - from).abs(),
            usable_mm: self.usable_mm(),
            cutoff_mm: cutoff(self.evaluated_mm),
            reach_mm: self.settings.band_mm,
            across_cutoff_mm: cutoff(self.helix_mm()),
        };
        let base_mm = self.gear.base_radius_mm();
        let radius = |at: f64| (self.control_mm + self.towards_tip() * at).hypot(base_mm);
        trace::figures(&samples, &course).map_err(|problem| match problem {
            TraceProblem::Entangled => NotTold::Entangled,
            TraceProblem::Gap(gap) => NotTold::ProfileGap {
                radii_mm: gap.map(radius),
                points: samples.len(),
                least: trace::LEAST,
            },
        })
    }

    fn helix(&self) -> Result<TraceFigures, NotTold> {
        let at_circle = self
            .points
            .iter()
            .filter(|p| self.is_at_measuring_circle(p));
        let samples: Vec<TracePoint> = at_circle
            .map(|point| TracePoint {
                at: point.height_mm,
                across: point.roll_mm - self.measuring_mm,
                deviation: point.deviation_mm,
            })
            .collect();
        let [low, high] = self.gear.height_mm;
        let course = Course {
            range: self.limits.helix_heights_mm,
            stated_mm: high - low,
            usable_mm: self.helix_mm(),
            cutoff_mm: cutoff(self.helix_mm()),
            reach_mm: self.half_band_mm(),
            across_cutoff_mm: cutoff(self.evaluated_mm),
        };
        trace::figures(&samples, &course).map_err(|problem| match problem {
            TraceProblem::Entangled => NotTold::Entangled,
            TraceProblem::Gap(heights_mm) => NotTold::HelixGap {
                heights_mm,
                points: samples.len(),
                least: trace::LEAST,
            },
        })
    }

    fn areal(&self) -> Result<areal::ArealTerms, NotTold> {
        let [low, high] = self.gear.height_mm;
        let unit: Vec<(f64, f64, f64)> = self
            .points
            .iter()
            .map(|point| {
                let u = 2.0 * self.along(point) / self.usable_mm() - 1.0;
                let v = 2.0 * (point.height_mm - self.middle_mm) / (high - low);
                (u, v, point.deviation_mm)
            })
            .collect();
        areal::terms(&unit).ok_or(NotTold::Terms { points: unit.len() })
    }

    /// Points near the measuring circle at mid face: across and up from -1 to 1, and their deviation, mm.
    fn near_position(&self) -> Vec<[f64; 3]> {
        self.points
            .iter()
            .filter(|p| self.is_at_mid_face(p) && self.is_at_measuring_circle(p))
            .map(|point| {
                let across = (point.roll_mm - self.measuring_mm) / self.half_band_mm();
                let up = (point.height_mm - self.middle_mm) / self.settings.band_mm;
                [across, up, point.deviation_mm]
            })
            .collect()
    }
}

/// Deviation on the measuring circle at mid face, from the plane through the points around (across and up from -1 to 1): a mean
/// would be that of where the points happen to lie. With its standard uncertainty by the points' scatter about the plane.
fn position_um(near: &[[f64; 3]]) -> Result<[f64; 2], NotTold> {
    let few = NotTold::FewPoints {
        points: near.len(),
        least: LEAST_POSITION_POINTS,
    };
    if near.len() < LEAST_POSITION_POINTS {
        return Err(few);
    }
    let (mut information, mut gradient) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for &[across, up, deviation] in near {
        let row = Vector3::new(1.0, across, up);
        information += row * row.transpose();
        gradient += row * deviation;
    }
    // Points to one side only, or along one line, would make the middle an extrapolation: it must not be less sure than a
    // single point.
    let inverse = information.try_inverse().filter(|inverse| {
        let variance = inverse[(0, 0)];
        variance > 0.0 && variance <= 1.0
    });
    let inverse = inverse.ok_or(few)?;
    let plane = inverse * gradient;
    let off_mm =
        |&[across, up, deviation]: &[f64; 3]| deviation - plane.dot(&Vector3::new(1.0, across, up));
    let squares: f64 = near.iter().map(|point| off_mm(point).powi(2)).sum();
    // Three are spent on the plane.
    let variance = squares / (near.len() - 3) as f64;
    Ok([plane[0], (variance * inverse[(0, 0)]).sqrt()].map(|mm| 1e3 * mm))
}

/// Cutoff of the Gaussian for an evaluated length.
fn cutoff(length_mm: f64) -> f64 {
    (length_mm / 30.0).max(0.025)
}
