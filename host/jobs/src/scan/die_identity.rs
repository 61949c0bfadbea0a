//! Tests whether the die is that of the CAD. Views of another die may almost fit the CAD and give a plausible but wrong map.

use flankscope_metrology::gear::GearData;
use flankscope_metrology::multiview::adjustment::{Pose, Stages};
use flankscope_metrology::registration::stretch;
use flankscope_metrology::tool::Tool;
use flankscope_metrology::verdict::{Code, Reason};
use nalgebra::Point3;
use rayon::prelude::*;

use super::session::{Session, SessionError};
use super::stitch::Stitched;
use super::view::{SAMPLE, coordinates};
use flankscope_metrology::view::PlannedView;

/// Largest relative excess of the teeth's distances over the CAD's, all around: 10 µm over half a field of view, ten times the
/// scale error that a head's calibration leaves.
const MOST_STRETCH: f64 = 2e-3;

/// Number of views used: their median is known to a tenth of the error of one view.
const MOST_VIEWS: usize = 96;

/// The teeth must be clearly nearer to the position by stages and head file than to one tooth further: largest ratio of these distances.
const RIVAL_RATIO: f64 = 0.6;

/// Relative excess of the teeth's distances over the CAD's: median over views all around; `None` if no view gives a value.
pub(super) fn stretch_of_views(
    stitched: &Stitched,
    session: &Session,
    tool: &Tool,
) -> Result<Option<f64>, SessionError> {
    let views: Vec<_> = stitched
        .views
        .iter()
        .zip(&stitched.adjustment.poses)
        .collect();
    let found: Result<Vec<Option<f64>>, SessionError> = views
        .par_iter()
        .step_by(views.len().div_ceil(MOST_VIEWS).max(1))
        .map(|((view, _), pose)| {
            let points: Vec<[f64; 3]> = coordinates(&session.sample(*view, SAMPLE)?, SAMPLE)
                .into_iter()
                .map(|p| pose.apply(p))
                .collect();
            let closest = tool.surface.closest_many(&points);
            Ok(stretch::around(&points, &closest))
        })
        .collect();
    let mut found: Vec<f64> = found?.into_iter().flatten().collect();
    found.sort_by(f64::total_cmp);
    Ok(found.get(found.len() / 2).copied())
}

/// Why the teeth cannot be those of the CAD.
pub(super) fn unlike_teeth(stretch: f64, gear: &GearData) -> Option<Reason> {
    (stretch.abs() > MOST_STRETCH).then(|| {
        let teeth = f64::from(gear.teeth);
        let why = format!(
            "the teeth stand {:.2} % {} than the CAD's in every view, at most {:.1} % are accepted: this is another die, with \
             about {:.0} teeth on that circle or a module of {:.4} mm (the CAD has {} and {:.4} mm), or the head file is another \
             head's",
            100.0 * stretch.abs(),
            if stretch > 0.0 { "farther apart" } else { "closer together" },
            100.0 * MOST_STRETCH,
            teeth / (1.0 + stretch),
            gear.module_mm * (1.0 + stretch),
            gear.teeth,
            gear.module_mm,
        );
        Reason::instrument(Code::OtherDie, why)
    })
}

/// Rotation of the die about the axis relative to stages and head file, rad: mean over all views, so that eccentricity and
/// encoder errors cancel.
pub(super) fn turned_rad(
    found: &Stages,
    nominal: &Stages,
    planned: &[PlannedView],
    reach_mm: f64,
) -> f64 {
    let seen = Point3::new(0.0, 0.0, reach_mm);
    let turned = planned.iter().map(|view| {
        let at = Pose {
            rotation_rad: view.rotation_rad,
            vertical_mm: view.vertical_mm,
        };
        let p = found.tool_from_camera(at).isometry() * seen;
        let q = nominal.tool_from_camera(at).isometry() * seen;
        (p.y * q.x - p.x * q.y).atan2(p.x * q.x + p.y * q.y)
    });
    turned.sum::<f64>() / planned.len().max(1) as f64
}

/// Why the teeth cannot be numbered: the views would look the same one tooth further.
pub(super) fn ambiguous_teeth(turned_rad: f64, gear: &GearData) -> Option<Reason> {
    let rival_rad = gear.pitch_rad() - turned_rad.abs();
    (turned_rad.abs() > RIVAL_RATIO * rival_rad).then(|| {
        let why = format!(
            "ambiguous tooth: the teeth stand {:.2}° from where stages and head file say, their neighbours {:.2}° on the other \
             side, and all teeth look alike; at most {:.2}° are accepted: was the die put down turned, or is the hand-eye wrong?",
            turned_rad.to_degrees().abs(),
            rival_rad.to_degrees(),
            (gear.pitch_rad() * RIVAL_RATIO / (1.0 + RIVAL_RATIO)).to_degrees(),
        );
        Reason::instrument(Code::TurnedDie, why)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use flankscope_foundation::rigid::Rigid;
    use flankscope_metrology::gear::GearKind;

    fn gear() -> GearData {
        GearData {
            kind: GearKind::Internal,
            teeth: 84,
            module_mm: 0.9869,
            pressure_angle_deg: 20.0,
            tip_radius_mm: 40.463,
            root_radius_mm: 42.684,
            first_tooth_centre_deg: 180.0 / 84.0,
            height_mm: [0.0, 66.0],
            radial_threshold_mm: 50.0,
        }
    }

    #[test]
    fn a_turned_die_is_measured_without_its_eccentricity_and_ambiguous_near_half_a_pitch() {
        let looks = nalgebra::Matrix3::from_columns(&[
            nalgebra::Vector3::z(),
            -nalgebra::Vector3::y(),
            nalgebra::Vector3::x(),
        ]);
        let nominal = Stages::nominal(Rigid::from_isometry(nalgebra::Isometry3::from_parts(
            nalgebra::Translation3::new(19.5, 0.0, 0.0),
            nalgebra::UnitQuaternion::from_matrix(&looks),
        )));
        let planned: Vec<PlannedView> = (0..12)
            .map(|step| PlannedView {
                tooth: 1,
                rotation_rad: std::f64::consts::TAU * f64::from(step) / 12.0,
                vertical_mm: 33.0,
            })
            .collect();
        // Seven times 0.2 degrees, and 0.5 mm sideways.
        let mut found = nominal.clone();
        (found.parameters[2], found.parameters[3]) = (7.0, 1.0);
        let turned = turned_rad(&found, &nominal, &planned, 22.0);
        assert!(
            (turned.to_degrees() - 1.4).abs() < 0.01,
            "{} degrees",
            turned.to_degrees()
        );
        // 0.6 of the way to the rival: 4.286 degrees times 0.6 / 1.6.
        let refused = |deg: f64| ambiguous_teeth(deg.to_radians(), &gear());
        assert_eq!((refused(1.6), refused(-1.6)), (None, None));
        assert!(
            refused(-1.7)
                .map(|why| why.to_string())
                .is_some_and(|why| why.contains("1.70°") && why.contains("2.59°"))
        );
    }

    #[test]
    fn another_number_of_teeth_is_named() {
        let gear = gear();
        assert_eq!(unlike_teeth(1e-3, &gear), None);
        let wider = unlike_teeth(84.0 / 83.0 - 1.0, &gear).unwrap().to_string();
        assert!(
            wider.contains("1.20 % farther apart") && wider.contains("about 83 teeth"),
            "{wider}"
        );
        let closer = unlike_teeth(0.98 / 0.9869 - 1.0, &gear)
            .unwrap()
            .to_string();
        assert!(
            closer.contains("closer together") && closer.contains("0.9800 mm"),
            "{closer}"
        );
    }
}
