//! Profile, helix, pitch and runout of gears whose deviations are known in closed form.

use std::f64::consts::TAU;

use flankscope_metrology::gear::{Flank, GearData, Kind};
use flankscope_metrology::gear_evaluation::{
    GearEvaluation, GearEvaluationError, Quantity, Settings, evaluate,
};

fn gear(kind: Kind) -> GearData {
    let (tip_radius_mm, root_radius_mm) = match kind {
        Kind::Internal => (41.0, 43.25),
        Kind::External => (43.0, 40.75),
    };
    GearData {
        kind,
        teeth: 84,
        module_mm: 1.0,
        pressure_angle_deg: 20.0,
        tip_radius_mm,
        root_radius_mm,
        first_tooth_centre_deg: 180.0 / 84.0,
        height_mm: [0.0, 40.0],
        radial_threshold_mm: 50.0,
    }
}

/// Place on a flank: share of the usable profile from the root end, share of the height.
type Field<'a> = &'a dyn Fn(u32, Flank, f64, f64) -> f64;

/// Points on all flanks, each moved along the numerical normal of the involute by the field, mm.
fn cloud(gear: &GearData, settings: &Settings, field: Field<'_>) -> Vec<[f64; 3]> {
    let [a, b] = settings.usable_mm;
    let (root, tip) = if (a - gear.root_radius_mm).abs() < (b - gear.root_radius_mm).abs() {
        (a, b)
    } else {
        (b, a)
    };
    let roll = |r: f64| (r * r - gear.base_radius_mm().powi(2)).sqrt();
    let mut points = Vec::new();
    for tooth in 1..=gear.teeth {
        for flank in Flank::BOTH {
            for row in 0..120 {
                for column in 0..60 {
                    // A slanted raster, a little beyond the usable flank.
                    let share =
                        -0.03 + 1.06 * (f64::from(column) + f64::from(row % 7) / 7.0) / 60.0;
                    let level = (f64::from(row) + 0.5) / 120.0;
                    let length = roll(root) + share * (roll(tip) - roll(root));
                    let radius = length.hypot(gear.base_radius_mm());
                    let height =
                        gear.height_mm[0] + level * (gear.height_mm[1] - gear.height_mm[0]);
                    let on = |r: f64| gear.flank_point(tooth, flank, r, height).unwrap();
                    let (foot, near, far) = (on(radius), on(radius - 1e-5), on(radius + 1e-5));
                    let tangent = [far[0] - near[0], far[1] - near[1]];
                    let size = tangent[0].hypot(tangent[1]);
                    let mut normal = [-tangent[1] / size, tangent[0] / size];
                    // Out of the material: away from the tooth's middle.
                    let middle = gear.tooth_centre_rad(tooth);
                    let away = flank.sign() * (normal[1] * middle.cos() - normal[0] * middle.sin());
                    normal = normal.map(|n| n * away.signum());
                    let deviation = field(tooth, flank, share, level);
                    points.push([
                        foot[0] + deviation * normal[0],
                        foot[1] + deviation * normal[1],
                        foot[2],
                    ]);
                }
            }
        }
    }
    points
}

fn value(evaluation: &GearEvaluation, quantity: Quantity) -> f64 {
    let rating = evaluation
        .ratings
        .iter()
        .find(|r| r.quantity == quantity)
        .unwrap();
    rating.value_um.unwrap()
}

/// Class 9 of this gear allows some 18 to 40 um; 2 um is what was asked for.
const TOLERANCE_UM: f64 = 2.0;

#[track_caller]
fn assert_near(what: &str, got: f64, wanted: f64) {
    assert!(
        (got - wanted).abs() < TOLERANCE_UM,
        "{what}: {got} instead of {wanted}"
    );
}

#[test]
fn slopes_forms_and_pitches_of_class_nine_come_back() {
    for kind in [Kind::Internal, Kind::External] {
        let gear = gear(kind);
        let settings = Settings::of(&gear);
        // 16 um of profile slope, 8 um peak to peak of profile form, 24 um of helix slope, 12 um peak to peak of helix form,
        // and a cumulative pitch wave of 50 um with a jump of 15 um at one tooth.
        let ratio = gear.base_radius_mm() / gear.pitch_radius_mm();
        let arc = |tooth: u32| {
            let wave = 25.0 * (TAU * f64::from(tooth) / 84.0).sin();
            wave + if tooth == 30 { 15.0 } else { 0.0 }
        };
        let field = |tooth: u32, flank: Flank, share: f64, level: f64| {
            let profile = 16.0 * share + 4.0 * (TAU * 2.0 * share).cos();
            let helix = 24.0 * level + 6.0 * (TAU * 3.0 * level).cos();
            1e-3 * (profile + helix + flank.sign() * ratio * arc(tooth))
        };
        let evaluation = evaluate(&gear, &cloud(&gear, &settings, &field), &settings).unwrap();
        assert_eq!(evaluation.flanks.len(), 168);
        for flank in &evaluation.flanks {
            let (profile, helix) = (flank.profile.unwrap(), flank.helix.unwrap());
            let name = format!("{kind:?} tooth {} {}", flank.tooth, flank.flank);
            // Over the evaluated 95 % the wave of two periods is not quite orthogonal to the line; the brute force below
            // does the same sums on the field itself.
            let [total, form, slope] =
                by_brute_force(|x| 16.0 * x + 4.0 * (TAU * 2.0 * x).cos(), [0.0, 0.95]);
            assert_near(&format!("{name} F_alpha"), profile.total_um, total);
            assert_near(&format!("{name} f_f_alpha"), profile.form_um, form);
            assert_near(&format!("{name} f_H_alpha"), profile.slope_um, slope);
            let shortened = 1.0 / 40.0;
            let range = [shortened, 1.0 - shortened];
            let [total, form, slope] =
                by_brute_force(|x| 24.0 * x + 6.0 * (TAU * 3.0 * x).cos(), range);
            assert_near(&format!("{name} F_beta"), helix.total_um, total);
            assert_near(&format!("{name} f_f_beta"), helix.form_um, form);
            assert_near(&format!("{name} f_H_beta"), helix.slope_um, slope);
            let areal = flank.areal.unwrap();
            assert_near(&format!("{name} c01"), areal.c01_um, 12.0);
        }
        let singles: Vec<f64> = (0..84u32)
            .map(|i| arc(i + 1) - arc((i + 83) % 84 + 1))
            .collect();
        for side in [&evaluation.left, &evaluation.right] {
            for (got, wanted) in side.single_um.iter().zip(&singles) {
                assert_near("f_pi", got.unwrap(), *wanted);
            }
            let arcs: Vec<f64> = (1..=84).map(arc).collect();
            let high = arcs.iter().copied().fold(f64::MIN, f64::max);
            assert_near(
                "F_p",
                side.total_um.unwrap(),
                high - arcs.iter().copied().fold(f64::MAX, f64::min),
            );
        }
        assert_near(
            "f_p",
            value(&evaluation, Quantity::SinglePitch),
            singles.iter().fold(0.0, |m: f64, s| m.max(s.abs())),
        );
        // Both flanks of every tooth move together: the spaces keep their width but for the jump's neighbours.
        let spaces: Vec<f64> = (1..=84u32)
            .map(|tooth| ratio * (arc(tooth) - arc(tooth % 84 + 1)))
            .collect();
        let out = 2.0 * 20f64.to_radians().sin();
        let spread = spaces.iter().copied().fold(f64::MIN, f64::max)
            - spaces.iter().copied().fold(f64::MAX, f64::min);
        // Magnified by 1 / (2 sin 20 deg) = 1.46, and so is the tolerance.
        let runout = evaluation.runout_um.unwrap();
        assert!(
            (runout - spread / out).abs() < TOLERANCE_UM / out * 2.0,
            "{runout} {}",
            spread / out
        );
    }
}

/// Range, form and slope (over the whole) of a function over a part of 0..1.
fn by_brute_force(f: impl Fn(f64) -> f64, range: [f64; 2]) -> [f64; 3] {
    let n = 4_000;
    let xs: Vec<f64> = (0..=n)
        .map(|i| range[0] + (range[1] - range[0]) * f64::from(i) / f64::from(n))
        .collect();
    let mean_x = xs.iter().sum::<f64>() / xs.len() as f64;
    let mean = xs.iter().map(|&x| f(x)).sum::<f64>() / xs.len() as f64;
    let slope = xs
        .iter()
        .map(|&x| (x - mean_x) * (f(x) - mean))
        .sum::<f64>()
        / xs.iter().map(|x| (x - mean_x).powi(2)).sum::<f64>();
    let range_of = |g: &dyn Fn(f64) -> f64| {
        let values: Vec<f64> = xs.iter().map(|&x| g(x)).collect();
        values.iter().copied().fold(f64::MIN, f64::max)
            - values.iter().copied().fold(f64::MAX, f64::min)
    };
    [range_of(&|x| f(x)), range_of(&|x| f(x) - slope * x), slope]
}

#[test]
fn an_eccentric_gear_runs_out_by_twice_its_eccentricity_until_its_own_axis_is_taken() {
    let gear = gear(Kind::Internal);
    let mut settings = Settings::of(&gear);
    let perfect = cloud(&gear, &settings, &|_, _, _, _| 0.0);
    let moved: Vec<[f64; 3]> = perfect
        .iter()
        .map(|p| [p[0] + 0.012, p[1] - 0.009, p[2]])
        .collect();
    let evaluation = evaluate(&gear, &moved, &settings).unwrap();
    // An eccentricity e gives a runout of 2 e and a cumulative pitch of 2 e / cos 20 deg on one flank side.
    assert_near("F_r", evaluation.runout_um.unwrap(), 30.0);
    assert_near(
        "F_p",
        value(&evaluation, Quantity::CumulativePitch),
        30.0 / 20f64.to_radians().cos(),
    );
    let axis = evaluation.axis.unwrap();
    assert_near("x", axis.offset_um[0], 12.0);
    assert_near("y", axis.offset_um[1], -9.0);
    settings.best_fit_axis = true;
    let evaluation = evaluate(&gear, &moved, &settings).unwrap();
    assert_near("F_r about its own axis", evaluation.runout_um.unwrap(), 0.0);
    assert_near(
        "F_p about its own axis",
        value(&evaluation, Quantity::CumulativePitch),
        0.0,
    );
}

#[test]
fn a_class_that_the_uncertainty_does_not_allow_is_not_stated() {
    let gear = gear(Kind::Internal);
    let settings = Settings::of(&gear);
    let perfect = cloud(&gear, &settings, &|_, _, _, _| 0.0);
    let evaluation = evaluate(&gear, &perfect, &settings).unwrap();
    for rating in &evaluation.ratings {
        assert_eq!(rating.class, Some(1), "{rating:?}");
        let note = rating.note.as_deref().unwrap();
        assert!(
            note.starts_with("not capable for class 1: U/T = "),
            "{note}"
        );
        let least = rating.best_stateable_class.unwrap();
        assert!(5.0 / rating.quantity.tolerance_um(&gear, least) <= 0.3);
        assert!(5.0 / rating.quantity.tolerance_um(&gear, least - 1) > 0.3);
    }
}

#[test]
fn a_part_of_a_gear_gives_what_it_shows_and_no_more() {
    let gear = gear(Kind::Internal);
    let settings = Settings::of(&gear);
    let all = cloud(&gear, &settings, &|_, _, _, _| 0.0);
    let some: Vec<[f64; 3]> = all
        .iter()
        .copied()
        .filter(|p| p[1].atan2(p[0]).abs() < 0.2)
        .collect();
    let evaluation = evaluate(&gear, &some, &settings).unwrap();
    assert!(evaluation.flanks.len() < 20);
    assert!(evaluation.left.f_p_um.is_some() && evaluation.left.total_um.is_none());
    assert_eq!((evaluation.runout_um, evaluation.axis), (None, None));
    let settings = Settings {
        best_fit_axis: true,
        ..settings
    };
    assert_eq!(
        evaluate(&gear, &some, &settings),
        Err(GearEvaluationError::AxisNotFixed)
    );
}

#[test]
fn what_is_no_gear_cloud_is_named() {
    let gear = gear(Kind::Internal);
    let settings = Settings::of(&gear);
    let elsewhere: Vec<[f64; 3]> = (0..1000).map(|i| [f64::from(i), 0.0, 20.0]).collect();
    assert!(matches!(
        evaluate(&gear, &elsewhere, &settings),
        Err(GearEvaluationError::NotOnFlanks { .. })
    ));
    assert!(matches!(
        evaluate(&gear, &[], &settings),
        Err(GearEvaluationError::NotOnFlanks { .. })
    ));
    let fine = GearData {
        module_mm: 0.2,
        ..gear.clone()
    };
    assert!(matches!(
        evaluate(&fine, &elsewhere, &settings),
        Err(GearEvaluationError::Scope {
            key: "module_mm",
            ..
        })
    ));
    let settings = Settings {
        u95_um: f64::NAN,
        ..settings
    };
    assert!(matches!(
        evaluate(&gear, &elsewhere, &settings),
        Err(GearEvaluationError::Setting { key: "u95_um", .. })
    ));
}
