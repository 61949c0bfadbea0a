//! Steep openings: grooves, scratches and pits of given width, pitch and depth, single or side by side, cut into flanks of a bore.

use std::f64::consts::{PI, TAU};

use flankscope_bench::damage::{Rectangle, largest_mean_um};
use flankscope_bench::world::FlankId;
use flankscope_gear_cad::{GearSpec, Mesh};
use flankscope_tests::die::{Fine, Place, bore};

/// Number of mesh edges across an opening.
const EDGES_ACROSS: f64 = 8.0;
/// Longest edge along a groove, mm: the chord error of the involute is 0.1 µm there.
const ALONG_MM: f64 = 0.05;
/// Raster of the true values: this many steps per opening, but not finer than the second constant, mm.
const RASTER_PARTS: f64 = 8.0;
const FINEST_RASTER_MM: f64 = 0.004;

/// Cross-section of an opening.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Section {
    /// A flat floor between steep walls.
    Flat,
    /// V-shaped.
    Vee,
    /// A period of a cosine.
    Round,
}

impl Section {
    /// Fraction of the depth at a distance from the middle, relative to the width.
    fn at(self, t: f64) -> f64 {
        match (self, t.abs() < 0.5) {
            (_, false) => 0.0,
            (Self::Flat, true) => 1.0,
            (Self::Vee, true) => 1.0 - 2.0 * t.abs(),
            (Self::Round, true) => 0.5 * (1.0 + (TAU * t).cos()),
        }
    }
}

/// Plan view of an opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Plan {
    /// A line; the angle between the direction across it and the profile, rad: 0 is a line along the height.
    Line(f64),
    /// A round pit.
    Pit,
    /// Round pits in rows along the height, this far apart, mm.
    Rows(f64),
}

/// Openings on one flank, in a rectangle of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Structure {
    pub plan: Plan,
    pub section: Section,
    pub width_mm: f64,
    /// Distance between the middles of neighbours; `None` for a single opening.
    pub pitch_mm: Option<f64>,
    pub depth_mm: f64,
    /// Middle of one of them: profile length from the base circle, and height, mm.
    pub at_mm: [f64; 2],
    /// Area of the openings; the flank outside follows the drawing.
    pub within: Rectangle,
}

impl Structure {
    /// Loss at a profile length and height, mm.
    pub fn loss_mm(&self, profile_mm: f64, height_mm: f64) -> f64 {
        let inside = |[low, high]: [f64; 2], x: f64| (low..=high).contains(&x);
        if !inside(self.within.profile_mm, profile_mm) || !inside(self.within.height_mm, height_mm)
        {
            return 0.0;
        }
        let [x, y] = [profile_mm - self.at_mm[0], height_mm - self.at_mm[1]];
        // Distance to the nearest neighbour's middle.
        let nearest = |v: f64| match self.pitch_mm {
            Some(pitch) => v - pitch * (v / pitch).round(),
            None => v,
        };
        let off_mm = match self.plan {
            Plan::Line(angle) => nearest(x * angle.cos() + y * angle.sin()),
            Plan::Pit => nearest(x).hypot(nearest(y)),
            Plan::Rows(apart_mm) => (x - apart_mm * (x / apart_mm).round()).hypot(nearest(y)),
        };
        self.depth_mm * self.section.at(off_mm / self.width_mm)
    }

    /// The largest mean loss over a disc in the judged rectangle, µm.
    pub fn largest_mean_um(&self, judged: Rectangle, disc_area_mm2: f64) -> f64 {
        let disc_mm = 2.0 * (disc_area_mm2 / PI).sqrt();
        // A disc outside the area has no loss.
        let [low, high] = self.within.height_mm;
        let near = Rectangle {
            height_mm: [
                judged.height_mm[0].max(low - disc_mm),
                judged.height_mm[1].min(high + disc_mm),
            ],
            ..judged
        };
        let raster_mm = (self.width_mm / RASTER_PARTS).clamp(FINEST_RASTER_MM, 0.02);
        largest_mean_um(near, disc_area_mm2, raster_mm, |profile, height| {
            self.loss_mm(profile, height)
        })
    }

    /// The same structure with the depth that gives this largest mean loss, but at most `deepest_mm`.
    pub fn scaled_to(
        self,
        um: f64,
        judged: Rectangle,
        disc_area_mm2: f64,
        deepest_mm: f64,
    ) -> Self {
        let per_mm = Self {
            depth_mm: 1.0,
            ..self
        }
        .largest_mean_um(judged, disc_area_mm2);
        Self {
            depth_mm: (um / per_mm).min(deepest_mm),
            ..self
        }
    }

    /// Mesh size that its flank needs.
    fn fine(&self, gear: &GearSpec, id: FlankId) -> Fine {
        let step_mm = self.width_mm / EDGES_ACROSS;
        let step_mm = match self.plan {
            Plan::Line(angle) if angle.sin().abs() < 1e-9 => [step_mm, 2.0 * ALONG_MM],
            Plan::Line(angle) if angle.cos().abs() < 1e-9 => [ALONG_MM, step_mm],
            Plan::Line(_) | Plan::Pit | Plan::Rows(_) => [step_mm; 2],
        };
        let [low, high] = self.within.height_mm;
        let from_tip_mm = self
            .within
            .profile_mm
            .map(|profile| from_tip_mm(gear, profile));
        Fine {
            tooth: id.tooth,
            flank: id.flank,
            from_tip_mm: [from_tip_mm[0] - step_mm[0], from_tip_mm[1] + step_mm[0]],
            height_mm: [low - step_mm[1], high + step_mm[1]],
            step_mm,
        }
    }
}

/// Difference of the radius at a profile length from that of the tip, mm.
fn from_tip_mm(gear: &GearSpec, profile_mm: f64) -> f64 {
    let base_mm = gear.base_radius_mm();
    (base_mm * base_mm + 2.0 * base_mm * profile_mm).sqrt() - gear.tip_radius_mm
}

/// Profile length of a position, mm.
pub(super) fn profile_mm(gear: &GearSpec, place: Place) -> f64 {
    let (base_mm, radius_mm) = (
        gear.base_radius_mm(),
        gear.tip_radius_mm + place.from_tip_mm,
    );
    (radius_mm * radius_mm - base_mm * base_mm) / (2.0 * base_mm)
}

/// The gear's bore with structures on some flanks.
pub(super) fn cut(gear: &GearSpec, structures: &[(FlankId, Structure)]) -> Mesh {
    cut_into(gear, structures, |_| 0.0)
}

/// The gear's bore with structures on some flanks, of which every place has lost `base_mm` beside them.
pub(super) fn cut_into(
    gear: &GearSpec,
    structures: &[(FlankId, Structure)],
    base_mm: impl Fn(Place) -> f64,
) -> Mesh {
    let fine: Vec<Fine> = structures
        .iter()
        .map(|(id, of)| of.fine(gear, *id))
        .collect();
    let loss = |place: Place| {
        let id = FlankId {
            tooth: place.tooth,
            flank: place.flank,
        };
        let here = structures.iter().filter(|(of, _)| *of == id);
        let cut: f64 = here
            .map(|(_, of)| of.loss_mm(profile_mm(gear, place), place.height_mm))
            .sum();
        base_mm(place) + cut
    };
    bore(loss, &fine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_at_every_angle_lose_as_much() {
        let judged = Rectangle {
            profile_mm: [0.0, 2.0],
            height_mm: [0.0, 4.0],
        };
        for i in 0..8 {
            let groove = Structure {
                plan: Plan::Line(TAU * f64::from(i) / 8.0),
                section: Section::Flat,
                width_mm: 0.1,
                pitch_mm: None,
                depth_mm: 0.1,
                at_mm: [1.0, 2.0],
                within: judged,
            };
            // 0.1 mm across the middle of a disc of 0.25 mm²: 0.05613 mm² (chord geometry), 22.4 % of it.
            // The raster counts whole cells: at 45° one row more or less is a fraction 1 / (sqrt(2) RASTER_PARTS) of the groove.
            let row_um = 22.4 / (std::f64::consts::SQRT_2 * RASTER_PARTS);
            let um = groove.largest_mean_um(judged, 0.25);
            assert!((um - 22.4).abs() < row_um, "{i}: {um}");
        }
    }
}
