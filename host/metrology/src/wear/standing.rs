//! Detection of missing teeth from a view's rays that pass the tip lands of the drawing.
//!
//! ```text
//!  camera ──ray──► cylinder of the tips, on a land ──► a point near it: the tooth stands
//!                                                  ├─► a point far behind: it is broken off there
//!                                                  └─► nothing, nor from its flanks, and its neighbours are seen: nothing stands
//! ```
//!
//! The camera of an internal gear stands inside the cylinder of its tips: a ray that passes this cylinder on a land meets nothing
//! before. Tip lands do not wear, so that no wear limit is involved.

use std::collections::BTreeMap;

use nalgebra::{Vector2, Vector3};
use serde::Serialize;

use crate::gear::{FlankPlace, GearData, GearKind};
use crate::surface::Closest;

/// Share of a land's width that is evaluated, about its middle: its edges are round, and the pose is known to micrometres.
const MIDDLE: f64 = 0.8;
/// Step of height, mm.
const STEP_MM: f64 = 0.5;
/// Least height of a missing piece that is reported, mm: shorter ones are dirt or highlights.
const LEAST_MM: f64 = 1.0;
/// Least number of rays on the land for a decision on a step.
const LEAST_RAYS: usize = 10;
/// A land that is displaced by less than this part of the tooth's depth still stands.
const DEPTH_PART: f64 = 0.25;
/// Largest share of a land's rays with points on it where it is missing ...
const MOST_SEEN: f64 = 0.1;
/// ... least share of rays with points far behind it ...
const LEAST_BEHIND: f64 = 0.5;
/// ... or least share of rays with either those or no point, if at least half of the other teeth's lands at that height are seen.
const LEAST_GONE: f64 = 0.8;
const LEAST_SEEN_OF_OTHERS: f64 = 0.5;

/// A camera ray in the tool frame.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Unit direction.
    pub direction: [f64; 3],
    /// Light that came back along it.
    pub brought: Brought,
}

/// Light that came back along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Brought {
    /// A point at this distance, mm.
    Point(f64),
    /// No fringes.
    Nothing,
    /// Light of which no point could be made: something is there.
    Light,
}

/// A tooth that does not stand, over a part of its height.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MissingTooth {
    /// Tooth, from 1.
    pub tooth: u32,
    /// Lower and upper end of the missing piece as far as it is in view, mm.
    pub height_mm: [f64; 2],
    /// Whether points lie far behind the land; else no point is seen there.
    pub seen_through: bool,
}

/// Counts of rays on one step of height of one tooth.
#[derive(Debug, Clone, Copy, Default)]
struct Step {
    rays: usize,
    on_land: usize,
    behind: usize,
    nothing: usize,
    on_flanks: usize,
}

impl Step {
    fn share(self, count: usize) -> f64 {
        count as f64 / self.rays.max(1) as f64
    }

    fn is_asked(self) -> bool {
        self.rays >= LEAST_RAYS
    }

    fn is_seen_through(self) -> bool {
        self.is_asked()
            && self.share(self.on_land) <= MOST_SEEN
            && self.share(self.behind) >= LEAST_BEHIND
    }

    /// Nothing came from land or flanks.
    fn is_empty(self) -> bool {
        self.is_asked()
            && self.share(self.on_land) <= MOST_SEEN
            && self.share(self.behind + self.nothing) >= LEAST_GONE
            && self.share(self.on_flanks) <= MOST_SEEN
    }
}

/// The teeth of which a piece does not stand, by the rays of one view from `camera_mm`; `places` says on which flank each point of
/// `closest` lies.
pub fn missing_teeth(
    gear: &GearData,
    camera_mm: [f64; 3],
    rays: impl Iterator<Item = Ray>,
    closest: &[Closest],
    places: &[Option<FlankPlace>],
) -> Vec<MissingTooth> {
    match gear.kind {
        GearKind::Internal => {}
        // Lands of an external gear may hide behind one another.
        GearKind::External => return Vec::new(),
    }
    let near_mm = DEPTH_PART * (gear.root_radius_mm - gear.tip_radius_mm).abs();
    let half_land_rad = MIDDLE * gear.half_tooth_rad(gear.tip_radius_mm).unwrap_or(0.0);
    let step_at = |height_mm: f64| (height_mm / STEP_MM).floor() as i64;
    let mut steps: BTreeMap<u32, BTreeMap<i64, Step>> = BTreeMap::new();
    for ray in rays {
        let Some(along_mm) = to_cylinder(camera_mm, ray.direction, gear.tip_radius_mm) else {
            continue;
        };
        let at = Vector3::from(camera_mm) + Vector3::from(ray.direction) * along_mm;
        let angle_rad = at.y.atan2(at.x);
        let tooth = gear.tooth_at(angle_rad);
        let off_rad = (angle_rad - gear.tooth_centre_rad(tooth)).sin();
        // Comparisons with NaN are false: such a ray is left out.
        if !(off_rad.abs() <= half_land_rad
            && (gear.height_mm[0]..gear.height_mm[1]).contains(&at.z))
        {
            continue;
        }
        let step = steps.entry(tooth).or_default().entry(step_at(at.z));
        let step = step.or_default();
        step.rays += 1;
        match ray.brought {
            Brought::Point(mm) if (mm - along_mm).abs() <= near_mm => step.on_land += 1,
            Brought::Point(mm) if mm - along_mm > near_mm => step.behind += 1,
            Brought::Nothing => step.nothing += 1,
            Brought::Point(_) | Brought::Light => {}
        }
    }
    for (hit, place) in closest.iter().zip(places) {
        if let Some(place) = place
            && hit.signed_distance_mm.abs() <= near_mm
            && let Some(of_tooth) = steps.get_mut(&place.tooth)
            && let Some(step) = of_tooth.get_mut(&step_at(place.height_mm))
        {
            step.on_flanks += 1;
        }
    }
    let others_seen = |tooth: u32, at: i64| {
        let others = steps.iter().filter(|(other, _)| **other != tooth);
        let asked: Vec<&Step> = others
            .filter_map(|(_, steps)| steps.get(&at).filter(|step| step.is_asked()))
            .collect();
        let sum = |of: fn(&Step) -> usize| asked.iter().map(|step| of(step)).sum::<usize>() as f64;
        !asked.is_empty()
            && sum(|step| step.on_land) >= LEAST_SEEN_OF_OTHERS * sum(|step| step.rays)
    };
    let mut missing = Vec::new();
    for (&tooth, of_tooth) in &steps {
        // The longest run of steps that are gone.
        let mut best: Option<(i64, i64)> = None;
        let mut run: Option<(i64, i64)> = None;
        for (&at, step) in of_tooth {
            let gone = step.is_seen_through() || step.is_empty() && others_seen(tooth, at);
            run = match run {
                _ if !gone => None,
                Some((from, to)) if to + 1 == at => Some((from, at)),
                _ => Some((at, at)),
            };
            if run.is_some_and(|(from, to)| best.is_none_or(|(a, b)| to - from > b - a)) {
                best = run;
            }
        }
        if let Some((from, to)) = best
            && (to + 1 - from) as f64 * STEP_MM >= LEAST_MM
        {
            missing.push(MissingTooth {
                tooth,
                height_mm: [from, to + 1].map(|at| at as f64 * STEP_MM),
                seen_through: of_tooth
                    .range(from..=to)
                    .any(|(_, step)| step.is_seen_through()),
            });
        }
    }
    missing
}

/// Distance along a ray from inside a cylinder about the axis to it, mm; none from outside, or along the axis.
fn to_cylinder(from_mm: [f64; 3], direction: [f64; 3], radius_mm: f64) -> Option<f64> {
    let from = Vector2::new(from_mm[0], from_mm[1]);
    let along = Vector2::new(direction[0], direction[1]);
    let (a, b) = (along.norm_squared(), from.dot(&along));
    let inside = radius_mm * radius_mm - from.norm_squared();
    (inside > 0.0 && a > 0.0).then(|| ((b * b + a * inside).sqrt() - b) / a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gear::Flank;
    use crate::gear::tests::ring84;
    use crate::surface::Feature;

    const CAMERA_MM: [f64; 3] = [19.0, 0.0, 33.0];

    /// Rays over four pitches and six millimetres about tooth 84's neighbours, each with what `brings` says of the land of a tooth
    /// at a height, mm beyond it; and a point of each flank of `sound` teeth at every height.
    fn view(
        brings: impl Fn(u32, f64) -> Option<f64>,
        sound: impl Fn(u32, f64) -> bool,
    ) -> Vec<MissingTooth> {
        view_of(
            |tooth, height| brings(tooth, height).map_or(Brought::Nothing, Brought::Point),
            sound,
        )
    }

    /// The same of everything that may come back; points by their distance beyond the land, mm.
    fn view_of(
        brings: impl Fn(u32, f64) -> Brought,
        sound: impl Fn(u32, f64) -> bool,
    ) -> Vec<MissingTooth> {
        let gear = ring84();
        let mut rays = Vec::new();
        let (mut closest, mut places) = (Vec::new(), Vec::new());
        for height in (0..120).map(|k| 30.0 + 0.05 * f64::from(k)) {
            for angle in (-100..=100).map(|k| 0.02 * gear.pitch_rad() * f64::from(k)) {
                let at = Vector3::new(
                    gear.tip_radius_mm * angle.cos(),
                    gear.tip_radius_mm * angle.sin(),
                    height,
                );
                let to = at - Vector3::from(CAMERA_MM);
                let tooth = gear.tooth_at(angle);
                rays.push(Ray {
                    direction: to.normalize().into(),
                    brought: match brings(tooth, height) {
                        Brought::Point(beyond) => Brought::Point(to.norm() + beyond),
                        other => other,
                    },
                });
                if sound(tooth, height) {
                    let point = gear.flank_point(tooth, Flank::Left, 41.4, height).unwrap();
                    let normal = gear.flank_normal(Flank::Left, point);
                    places.push(gear.place(point, normal));
                    closest.push(Closest {
                        point,
                        signed_distance_mm: -0.1,
                        normal,
                        triangle: 0,
                        feature: Feature::Face,
                        smoothness: 1.0,
                    });
                }
            }
        }
        missing_teeth(&gear, CAMERA_MM, rays.into_iter(), &closest, &places)
    }

    #[test]
    fn a_tooth_that_stands_is_not_missing_whatever_its_flanks_lost() {
        assert_eq!(view(|_, _| Some(0.2), |_, _| true), []);
        // A land too bright to be seen, with its flanks; a view without light; a flake of 0.4 mm.
        let bright = |tooth, _| (tooth != 2).then_some(0.0);
        assert_eq!(view(bright, |_, _| true), []);
        assert_eq!(view(|_, _| None, |_, _| false), []);
        // Bare steel under coarse fringes: light from a whole tooth, of which no point can be made.
        let undecoded = |tooth, _| match tooth {
            2 => Brought::Light,
            _ => Brought::Point(0.0),
        };
        assert_eq!(view_of(undecoded, |tooth, _| tooth != 2), []);
        let flake = |tooth, height: f64| {
            let there = tooth == 2 && (33.05..33.45).contains(&height);
            Some(if there { 1.5 } else { 0.0 })
        };
        assert_eq!(view(flake, |_, _| true), []);
    }

    #[test]
    fn a_tooth_that_is_gone_is_named_whether_something_lies_behind_or_nothing() {
        for behind in [None, Some(2.0)] {
            let gone = |tooth, _| if tooth == 2 { behind } else { Some(0.0) };
            let found = view(gone, |tooth, _| tooth != 2);
            assert!(
                found.len() == 1
                    && found[0].tooth == 2
                    && found[0].seen_through == behind.is_some(),
                "{found:?}"
            );
            let half = |tooth, height: f64| {
                if tooth == 2 && height > 33.0 {
                    behind
                } else {
                    Some(0.0)
                }
            };
            let found = view(half, |tooth, height| tooth != 2 || height < 33.0);
            assert!(
                found.len() == 1
                    && (found[0].height_mm[0] - 33.0).abs() <= 0.5
                    && found[0].height_mm[1] >= 35.5,
                "{found:?}"
            );
        }
    }
}
