//! The joint solve against poses that are known, and against what a Gaussian says about one view.

use std::f64::consts::{PI, TAU};

use flankscope_foundation::rigid::Rigid;
use flankscope_metrology::multiview::adjustment::{
    CameraPose, Local, Overlap, PARAMETERS, Pose, Stages, ViewInformation, solve, take_off_common,
};
use flankscope_metrology::multiview::cylinder::CellObservation;
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
    Stages::nominal(Rigid::from_isometry(Isometry3::from_parts(
        pinhole, rotation,
    )))
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
fn laid(at: Pose, pose: CameraPose) -> ViewInformation {
    let (turn, shift) = (VIEW_RAD.powi(-2), VIEW_MM.powi(-2));
    let centre = pose.isometry() * Point3::new(0.0, 0.0, 22.0);
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
fn off(pose: &CameraPose, truth: &CameraPose) -> Vector3<f64> {
    let middle = Point3::new(0.0, 0.0, 22.0);
    pose.isometry() * middle - truth.isometry() * middle
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
    let found = solve(&stages(), &views, &[], Local::default()).unwrap();
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
            let inwards = Translation3::from(-outwards * radial_mm(&at));
            laid(at, Rigid::from_isometry(inwards * pose.isometry()))
        })
        .collect();
    let found = solve(&stages(), &views, &[], Local::default()).unwrap();
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
        if view == wrong {
            Rigid::from_isometry(turned * pose.isometry())
        } else {
            pose
        }
    };
    let views: Vec<ViewInformation> = (0..places.len())
        .map(|view| laid(places[view], at_wall(view)))
        .collect();
    let found = solve(&stages(), &views, &[], Local::default()).unwrap();
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
    let found = solve(&stages(), &views, &[], Local::default()).unwrap();
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

/// Cells of the wall that a view around a place sees, with what the wall and the view's error make of each deviation: flanks
/// face the axis and to both sides of it. `off` is where a point of the view lands, against where it should.
fn cell_observations(
    at: Pose,
    wall_mm: impl Fn([f64; 3]) -> f64,
    off: impl Fn(Point3<f64>) -> Vector3<f64>,
) -> Vec<CellObservation> {
    const COLUMNS: u32 = 2016;
    let column_rad = TAU / f64::from(COLUMNS);
    let middle = ((PI - at.rotation_rad).rem_euclid(TAU) / column_rad) as u32;
    let lowest = ((at.vertical_mm - 5.0).max(0.0) / 0.25) as u32;
    let mut cells: Vec<CellObservation> = (lowest..lowest + 40)
        .flat_map(|row| {
            (0..77).map(move |column| (row, (middle + COLUMNS + column - 38) % COLUMNS))
        })
        .map(|(row, column)| {
            let angle = column_rad * (f64::from(column) + 0.5) - PI;
            let foot = [
                RADIUS_MM * angle.cos(),
                RADIUS_MM * angle.sin(),
                0.25 * (f64::from(row) + 0.5),
            ];
            let facing = angle + PI + [-0.9, 0.0, 0.9][column as usize % 3];
            let normal = Vector3::new(facing.cos(), facing.sin(), 0.0);
            let outwards = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let lands = outwards * wall_mm(foot) + off(Point3::from(foot));
            CellObservation {
                cell: row * COLUMNS + column,
                weight: 2.5e5,
                deviation_mm: normal.dot(&lands) as f32,
                point: foot.map(|c| c as f32),
                normal: [normal.x as f32, normal.y as f32, 0.0],
            }
        })
        .collect();
    cells.sort_by_key(|observation| observation.cell);
    cells
}

/// Overlaps of all views that lie next to each other.
fn pairs(views: &[ViewInformation], seen: &[Vec<CellObservation>], reach_mm: f64) -> Vec<Overlap> {
    let centre = |view: usize| Point3::from(views[view].centre_mm);
    (0..views.len())
        .flat_map(|i| (i + 1..views.len()).map(move |j| [i, j]))
        .filter(|&[i, j]| (centre(i) - centre(j)).norm() < reach_mm)
        .filter_map(|[i, j]| {
            let centres = [i, j].map(|view| views[view].centre_mm);
            Overlap::between([i, j], [&seen[i], &seen[j]], centres)
        })
        .collect()
}

#[test]
fn a_conical_wall_leans_in_every_view_and_yet_no_view_leans() {
    let truth = stages();
    let places = places(12, 8);
    let taper_rad = 15e-3 / 66.0;
    let wall_mm = |[_, _, z]: [f64; 3]| taper_rad * (z - 33.0);
    // What is laid on the CAD follows the wall: it shifts inwards and leans.
    let motion = |at: &Pose| {
        let centre = truth.tool_from_camera(*at).isometry() * Point3::new(0.0, 0.0, 22.0);
        let outwards = Vector3::new(centre.x, centre.y, 0.0).normalize();
        let around = Vector3::z().cross(&outwards);
        let turn = UnitQuaternion::from_scaled_axis(-around * taper_rad);
        let shift = -outwards * wall_mm(centre.into());
        let about = Translation3::from(centre.coords + shift);
        about * turn * Translation3::from(-centre.coords)
    };
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|at| {
            let moved = motion(at) * truth.tool_from_camera(*at).isometry();
            laid(*at, Rigid::from_isometry(moved))
        })
        .collect();
    let seen: Vec<Vec<CellObservation>> = places
        .iter()
        .map(|at| cell_observations(*at, wall_mm, |p| motion(at) * p - p))
        .collect();
    let overlaps = pairs(&views, &seen, 9.0);
    assert_eq!(overlaps.len(), 7 * 12, "each with the one above");
    let farthest_mm = |overlaps: &[Overlap]| {
        let found = solve(&stages(), &views, overlaps, Local::default()).unwrap();
        let edge = Point3::new(5.0, 0.0, 22.0);
        let off = |(pose, at): (&CameraPose, &Pose)| {
            (pose.isometry() * edge - truth.tool_from_camera(*at).isometry() * edge).norm()
        };
        found.poses.iter().zip(&places).map(off).fold(0.0, f64::max)
    };
    // Laid on the CAD, the edge of a view is 1.1 µm off by the lean alone and up to 6.6 µm by where the wall stands. The
    // layers' places say how conical the wall is, 5 µm of form under each of 96 views: 0.027 mrad over these heights. And each
    // view says how it leans to 0.3 mrad: the lean that all share ends within 0.2 µm over 5 mm.
    let alone_mm = farthest_mm(&[]);
    assert!(alone_mm < 0.2e-3, "{} µm", alone_mm * 1e3);
    // A step of 1 µm between neighbours is seen by each of 84 pairs to half a µm.
    let together_mm = farthest_mm(&overlaps);
    assert!(together_mm < 0.1e-3, "{} µm", together_mm * 1e3);
}

#[test]
fn neighbours_hold_a_view_that_ran_out_as_a_ring_of_springs_does() {
    const AROUND: u32 = 84;
    let truth = stages();
    let places = places(AROUND, 1);
    let wrong = 30;
    let runout_mm = 2e-3;
    // The stage carried one view outwards; the piece is rough, and no view may take that for its own motion.
    let wall_mm =
        |[x, y, z]: [f64; 3]| 4e-3 * (90.0 * y.atan2(x)).sin() * (0.7 * z).cos() + 1e-5 * x;
    let outwards = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -places[wrong].rotation_rad)
        * Vector3::x();
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|&at| laid(at, truth.tool_from_camera(at)))
        .collect();
    let seen: Vec<Vec<CellObservation>> = (places.iter().enumerate())
        .map(|(view, at)| {
            let off = if view == wrong { -runout_mm } else { 0.0 };
            cell_observations(*at, wall_mm, |_| outwards * off)
        })
        .collect();
    // Next neighbours alone, so that they are a ring.
    let overlaps = pairs(&views, &seen, 4.0);
    assert_eq!(overlaps.len(), AROUND as usize);
    let local = Local::default();
    let found = solve(&stages(), &views, &overlaps, local).unwrap();
    let off =
        |view: usize| off(&found.poses[view], &truth.tool_from_camera(places[view])).dot(&outwards);
    // Springs: to where the stage should be (run-out), to the CAD (which knows the view, but not the form under it), and to
    // either neighbour: (patches of 25 cells) / (both views' 4 + 1 µm²) along the part of the normals that faces outwards.
    let stage = local.runout_mm.powi(-2);
    let cad = 1.0 / (VIEW_MM.powi(2) + local.form_mm.powi(2));
    let common = 53.0 * 40.0;
    let facing = (1.0 + 2.0 * 0.9_f64.cos().powi(2)) / 3.0;
    let neighbour = common / 25.0 / 10e-6 * facing;
    // A circulant: diagonal by its Fourier modes.
    let share = |modes: std::ops::Range<u32>| {
        let of_mode = |mode: u32| {
            let tie = neighbour * 2.0 * (1.0 - (TAU * f64::from(mode) / f64::from(AROUND)).cos());
            tie / (stage + cad + tie)
        };
        modes.map(of_mode).sum::<f64>() / f64::from(AROUND)
    };
    let expected_mm = runout_mm * share(0..AROUND);
    assert!(expected_mm > 0.25 * runout_mm, "{expected_mm} mm");
    let moved_mm = off(wrong);
    // Five shared parameters (eccentricity, ovality, the head's distance) take 1/84 each, and cells are whole: 5 %.
    assert!(
        (moved_mm / expected_mm - 1.0).abs() < 0.08,
        "{} µm, expected {} µm",
        moved_mm * 1e3,
        expected_mm * 1e3
    );
    // Without overlaps it stays where the stage should be.
    let alone = solve(&stages(), &views, &[], local).unwrap();
    assert!(alone.pose_residuals[wrong].norm() < 1e-9);
}

#[test]
fn what_the_field_makes_all_pairs_of_a_kind_say_moves_no_view() {
    let truth = stages();
    let mut places = places(84, 2);
    // The upper layer is looked at a little differently, so that its field's error is another.
    places
        .iter_mut()
        .skip(84)
        .for_each(|at| at.vertical_mm = 42.0);
    let views: Vec<ViewInformation> = places
        .iter()
        .map(|&at| laid(at, truth.tool_from_camera(at)))
        .collect();
    // Sideways, the calibration is 1 µm off at the edges of the field; more in one layer.
    let seen: Vec<Vec<CellObservation>> = places
        .iter()
        .map(|at| {
            let size_mm = if at.vertical_mm > 40.0 { 1.5e-3 } else { 1e-3 };
            let field = move |p: Point3<f64>| {
                let (sin, cos) = (-at.rotation_rad).sin_cos();
                let sideways = p.y * cos - p.x * sin;
                Vector3::new(-sin, cos, 0.0) * (size_mm * (sideways / 5.0).powi(3))
            };
            cell_observations(*at, |_| 0.0, field)
        })
        .collect();
    let mut overlaps = pairs(&views, &seen, 4.0);
    let alone = solve(&stages(), &views, &[], Local::default()).unwrap();
    let farthest_mm = |overlaps: &[Overlap]| {
        let found = solve(&stages(), &views, overlaps, Local::default()).unwrap();
        let off = |(pose, at): (&CameraPose, &Pose)| off(pose, &truth.tool_from_camera(*at)).norm();
        found.poses.iter().zip(&places).map(off).fold(0.0, f64::max)
    };
    // Every pair says that its views are turned too close: a ring of 84 cannot close so, unless all of it moves inwards.
    let believed_mm = farthest_mm(&overlaps);
    assert!(believed_mm > 0.5e-3, "{} µm", believed_mm * 1e3);
    take_off_common(&mut overlaps, &views, &alone.poses);
    let left_mm = farthest_mm(&overlaps);
    // Cells do not fall the same way in all views: some nm per pair.
    assert!(left_mm < 0.05e-3, "{} µm", left_mm * 1e3);
}
