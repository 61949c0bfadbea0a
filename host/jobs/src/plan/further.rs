//! Further views of a tooth: turned about the axis until the head looks at one flank more steeply than with the tooth in the middle.
//!
//! Across the tooth both flanks are seen at a grazing angle, and what lies in narrow openings is hidden. At the side of the field
//! the rays meet one of them more steeply. The best turn has the largest sum of the cosines between rays and normals over the judged zone,
//! counting only what lies in the field and is not hidden by another tooth.

use std::f64::consts::TAU;

use flankscope_foundation::rigid::{Camera, Rigid, Stage};
use flankscope_metrology::gear::{Flank, GearData, GearKind};
use flankscope_metrology::tool::Tool;
use flankscope_metrology::view::{FurtherView, PlannedView};
use flankscope_profilometry::HeadModel;
use nalgebra::Vector3;

use super::FieldOfView;

/// Turns that are tried, in quarters of a pitch to either side.
const QUARTERS: i32 = 5;
/// A further view must see a flank this much more steeply, as a ratio of the sums of cosines.
const GAIN: f64 = 1.2;
/// Points along radius and height of a zone.
const RASTER: usize = 6;
/// Step of the march from a point towards the camera, mm.
const STEP_MM: f64 = 0.1;
/// Steps until a ray has left the teeth: they are not higher than that.
const MOST_STEPS: usize = 200;
/// A ray may come this near to a tooth, mm: it starts on one.
const GRAZE_MM: f64 = 0.02;

/// The further views of all teeth of a plan; none for patches, and none where the pose rests on bands of the flanks, which a
/// turned view shows in part only.
pub(crate) fn further_views(
    tool: &Tool,
    head: &HeadModel,
    views: &[PlannedView],
) -> Vec<FurtherView> {
    let (Some(gear), Some(first)) = (&tool.gear, views.first()) else {
        return Vec::new();
    };
    let has_datum_bands = |tool: &Tool| {
        let inspect = tool.inspect.as_ref();
        inspect.is_some_and(|inspect| !inspect.datum_height_mm.is_empty())
    };
    let hand_eye = head.stage_from_camera.and_then(|pose| pose.rigid().ok());
    let (Some(stage_from_camera), Ok(field), false) =
        (hand_eye, FieldOfView::of(head), has_datum_bands(tool))
    else {
        return Vec::new();
    };
    let at = Looking {
        tool,
        gear,
        field,
        stage_from_camera,
    };
    // All teeth have the same form.
    let turns = [Flank::Left, Flank::Right].map(|flank| (flank, at.best_turn_rad(first, flank)));
    let of_view = |view: &PlannedView| {
        let view = view.clone();
        turns.into_iter().filter_map(move |(flank, turn_rad)| {
            let view = PlannedView {
                rotation_rad: view.rotation_rad + turn_rad?,
                ..view.clone()
            };
            Some(FurtherView {
                flank: Some(flank),
                view,
            })
        })
    };
    views.iter().flat_map(of_view).collect()
}

/// The head before the tool.
struct Looking<'a> {
    tool: &'a Tool,
    gear: &'a GearData,
    field: FieldOfView,
    stage_from_camera: Rigid<Stage, Camera>,
}

impl Looking<'_> {
    /// The turn from a view that shows a flank most steeply; none if it gains too little.
    fn best_turn_rad(&self, from: &PlannedView, flank: Flank) -> Option<f64> {
        let pitch_rad = TAU / f64::from(self.gear.teeth);
        let turned = |quarters: i32| {
            let turn_rad = 0.25 * f64::from(quarters) * pitch_rad;
            (turn_rad, self.steepness(from, turn_rad, flank))
        };
        let (_, now) = turned(0);
        let best = (-QUARTERS..=QUARTERS).map(turned);
        let best = best.max_by(|a, b| a.1.total_cmp(&b.1));
        best.filter(|(_, then)| *then > GAIN * now)
            .map(|(turn_rad, _)| turn_rad)
    }

    /// Sum of the cosines between rays and normals over a raster of a flank's judged zone, as far as it is in view.
    fn steepness(&self, from: &PlannedView, turn_rad: f64, flank: Flank) -> f64 {
        let view = PlannedView {
            rotation_rad: from.rotation_rad + turn_rad,
            ..from.clone()
        };
        let Some(zone) = self.tool.zone_of(view.tooth) else {
            return 0.0;
        };
        let pose = view.tool_from_camera(self.stage_from_camera);
        let pose = pose.isometry();
        let camera = pose.translation.vector;
        let axis = pose.rotation * Vector3::z();
        let least_cos = 1.0 / 1f64.hypot(self.field.slope);
        let [near_mm, far_mm] = self.field.range_mm;
        let cosine = |point: [f64; 3]| {
            let to = Vector3::from(point) - camera;
            let (distance_mm, along) = (to.norm(), to.normalize());
            if along.dot(&axis) < least_cos || !(near_mm..far_mm).contains(&distance_mm) {
                return 0.0;
            }
            let normal = Vector3::from(self.gear.flank_normal(flank, point));
            match self.is_covered(point.into(), -along) {
                true => 0.0,
                false => along.dot(&normal).abs(),
            }
        };
        let part = |[low, high]: [f64; 2], at: usize| {
            low + (high - low) * (at as f64 + 0.5) / RASTER as f64
        };
        let raster = (0..RASTER * RASTER).filter_map(|at| {
            let radius_mm = part(zone.radius_mm, at % RASTER);
            let height_mm = part(zone.height_mm, at / RASTER);
            self.gear
                .flank_point(view.tooth, flank, radius_mm, height_mm)
        });
        raster.map(cosine).sum()
    }

    /// Whether a tooth lies between a point of a flank and the camera.
    fn is_covered(&self, point: Vector3<f64>, towards: Vector3<f64>) -> bool {
        for step in 1..=MOST_STEPS {
            let at = point + towards * (STEP_MM * step as f64);
            let (radius_mm, angle_rad) = (at.x.hypot(at.y), at.y.atan2(at.x));
            let is_out = match self.gear.kind {
                GearKind::Internal => radius_mm < self.gear.tip_radius_mm,
                GearKind::External => radius_mm > self.gear.tip_radius_mm,
            };
            if is_out {
                return false;
            }
            let middle_rad = self.gear.tooth_centre_rad(self.gear.tooth_at(angle_rad));
            let off_rad = (angle_rad - middle_rad).sin().asin().abs();
            let half_rad = self.gear.half_tooth_rad(radius_mm).unwrap_or(0.0);
            if off_rad * radius_mm < half_rad * radius_mm - GRAZE_MM {
                return true;
            }
        }
        true
    }
}
