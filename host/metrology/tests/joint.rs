//! The joint solve against poses that are known, and against what a Gaussian says about one view.

use std::f64::consts::{PI, TAU};

use flankscope_metrology::joint::{Local, PARAMETERS, Pose, Stages, ViewInformation, solve};
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// What each view knows of its own pose: about 1 µm, and that over a field of 10 mm.
const VIEW_MM: f64 = 1e-3;
const VIEW_RAD: f64 = 0.3e-3;
/// From the axis to the wall.
const RADIUS_MM: f64 = 41.5;

/// The head looks outwards along x, 22 mm from the wall, with its columns along z.
fn stages() -> Stages {
    let looks = nalgebra::Matrix3::from_columns(&[Vector3::z(), -Vector3::y(), Vector3::x()]);
    let rotation = UnitQuaternion::from_matrix(&looks);
    let pinhole = Translation3::new(RADIUS_MM - 22.0, 0.0, 0.0);
    Stages::nominal(Isometry3::from_parts(pinhole, rotation))
}

fn places(around: u32, layers: u32) -> Vec<Pose> {
    (0..layers)
        .flat_map(|layer| (0..around).map(move |step| (layer, step)))
        .map(|(layer, step)| Pose {
            rotation_rad: TAU * ((f64::from(step) + 0.5) / f64::from(around) - 0.5),
            vertical_mm: 66.0 * (f64::from(layer) + 0.5) / f64::from(layers),
        })
        .collect()
}

/// A view that was laid on the CAD at `pose`.
fn laid(at: Pose, pose: Isometry3<f64>) -> ViewInformation {
    let (turn, shift) = (VIEW_RAD.powi(-2), VIEW_MM.powi(-2));
    let centre = pose * Point3::new(0.0, 0.0, 22.0);
    ViewInformation {
        at,
        tool_from_camera: pose,
        centre_mm: centre.into(),
        information: Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift)),
        gradient: Vector6::zeros(),
        rms_mm: 1e-3,
        share: 1.0,
    }
}

/// How far the middle of the wall is from where it should be, mm.
fn off(pose: &Isometry3<f64>, truth: &Isometry3<f64>) -> Vector3<f64> {
    let middle = Point3::new(0.0, 0.0, 22.0);
    pose * middle - truth * middle
}

/// Everything off by about one standard deviation of what is known before.
fn by_hand() -> Stages {
    let mut truth = stages();
    for j in 0..PARAMETERS {
        truth.parameters[j] = 1.2 * (2.7 * j as f64 + 0.4).sin();
    }
    truth
}

#[test]
fn consistent_views_are_followed_from_half_a_millimetre_away() {
    let truth = by_hand();
    let places = places(12, 2);
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|&at| laid(at, truth.tool_from_camera(at)))
        .collect();
    let farthest = places
        .iter()
        .map(|&at| off(&stages().tool_from_camera(at), &truth.tool_from_camera(at)).norm())
        .fold(0.0, f64::max);
    assert!(farthest > 0.5, "{farthest} mm");
    let found = solve(&stages(), &views, Local::default()).unwrap();
    for (pose, &at) in found.poses.iter().zip(&places) {
        // Half a millimetre of eccentricity is known from 24 views to 5 µm / sqrt(12), so its prior pulls by 3 nm. The
        // encoder's first harmonic (here up to 12 µm at the wall, 7 µm expected) looks like eccentricity but for the wall's
        // distance, which form spoils: of it 1.5² / (1.5² + 7²) stays, 0.5 µm.
        let off_mm = off(pose, &truth.tool_from_camera(at)).norm();
        assert!(off_mm < 0.5e-3, "{} µm at {at:?}", off_mm * 1e3);
    }
}

#[test]
fn a_wall_that_is_oval_and_conical_does_not_move_the_views() {
    let truth = stages();
    let places = places(12, 2);
    let radial_mm = |at: &Pose| {
        // The head looks at the die's angle -rotation.
        10e-3 * (2.0 * at.rotation_rad).cos() + 15e-3 * (at.vertical_mm / 66.0 - 0.5)
    };
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|&at| {
            let pose = truth.tool_from_camera(at);
            // A wall farther out shows its points farther out; laid on the CAD, the view moves inwards.
            let outwards = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -at.rotation_rad)
                * Vector3::x();
            laid(at, Translation3::from(-outwards * radial_mm(&at)) * pose)
        })
        .collect();
    let found = solve(&stages(), &views, Local::default()).unwrap();
    for (pose, at) in found.poses.iter().zip(&places) {
        let off_mm = off(pose, &truth.tool_from_camera(*at)).norm();
        // What run-out could be of it: 0.3² of 5² + 1² µm², 0.3 %; the shared parameters cannot follow either.
        assert!(off_mm < 0.02 * 17.5e-3, "{} µm at {at:?}", off_mm * 1e3);
    }
}

#[test]
fn a_view_that_the_stage_turned_too_far_is_followed_as_far_as_a_gaussian_says() {
    let truth = stages();
    let places = places(24, 2);
    let wrong = 7;
    let error_rad = 15e-3 * PI / 180.0;
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -error_rad);
    let at_wall = |view: usize| {
        let pose = truth.tool_from_camera(places[view]);
        if view == wrong { turned * pose } else { pose }
    };
    let views: Vec<ViewInformation> = (0..places.len())
        .map(|view| laid(places[view], at_wall(view)))
        .collect();
    let found = solve(&stages(), &views, Local::default()).unwrap();
    let moved_mm = off(&found.poses[wrong], &truth.tool_from_camera(places[wrong])).norm();
    // σ_stage² / (σ_stage² + σ_view²) of 10.9 µm; the other 47 views hold the rest of the instrument to 1/47 of it.
    let stage_mm = error_rad / 3f64.sqrt() * RADIUS_MM;
    let share = stage_mm.powi(2) / (stage_mm.powi(2) + VIEW_MM.powi(2));
    let expected_mm = share * error_rad * RADIUS_MM;
    assert!(
        (moved_mm / expected_mm - 1.0).abs() < 1.0 / 20.0,
        "{} µm, expected {} µm",
        moved_mm * 1e3,
        expected_mm * 1e3
    );
    for (view, pose) in found.poses.iter().enumerate().filter(|(v, _)| *v != wrong) {
        let off_mm = off(pose, &truth.tool_from_camera(places[view])).norm();
        assert!(
            off_mm < expected_mm / 10.0,
            "view {view}: {} µm",
            off_mm * 1e3
        );
    }
}

#[test]
fn what_no_view_can_tell_is_named_weak_and_stays_where_it_was() {
    let places = places(12, 2);
    let truth = by_hand();
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|&at| {
            let mut view = laid(at, truth.tool_from_camera(at));
            // An extruded wall: nothing is known along the axis.
            view.information[(5, 5)] = 0.0;
            view
        })
        .collect();
    let found = solve(&stages(), &views, Local::default()).unwrap();
    assert!(found.condition > 1e3, "{}", found.condition);
    assert!(!found.weak.is_empty());
    for weak in &found.weak {
        assert!(
            weak.prior_share > 0.5 && weak.prior_share <= 1.0,
            "{weak:?}"
        );
    }
    let names: Vec<&str> = found.weak.iter().map(|weak| weak.name).collect();
    assert!(
        names
            .iter()
            .any(|name| name.ends_with("shift z") || name.ends_with("shift x")),
        "along the axis: {names:?}"
    );
}
