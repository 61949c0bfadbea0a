use super::*;
use flankscope_foundation::date::Date;

const DRIFT: f64 = 0.05;
/// From lens to stop, mm.
const APART_MM: f64 = 1.5;

/// A change that makes the series invalid, and a word of the resulting error message.
type Wrong<T> = (fn(&mut T), &'static str);

/// A head behind a thin lens of a power: its focal lengths, and where its pinholes appear. `bent` adds what no mean of settings can
/// follow.
fn head_at(power_dpt: f64, bent_px: f64) -> HeadModel {
    let power = 1e-3 * power_dpt;
    let stretch = 1.0 / (1.0 - APART_MM * power);
    let back_mm = -APART_MM * APART_MM * power * stretch;
    let lens = |focal_px: f64, size: [u32; 2]| Pinhole {
        width_px: size[0],
        height_px: size[1],
        focal_px: [focal_px * stretch; 2],
        principal_px: size.map(|px| 0.5 * f64::from(px - 1) - focal_px * stretch * power * 0.02),
        distortion: [-0.08 * stretch * stretch, 0.05, 4e-4, -3e-4, 0.0],
        residual: None,
    };
    let mut camera = lens(2530.0, [1920, 1200]);
    camera.focal_px[0] += bent_px * (2.0 * power_dpt).sin();
    let (sin, cos) = (-0.5f64 + 1e-5 * power_dpt).sin_cos();
    let rotation = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
    let projector_from_camera = RigidTransform {
        rotation,
        translation_mm: [-22.0 * sin + back_mm * sin, 0.0, 22.0 * (1.0 - cos)],
    };
    let mut head = HeadModel::from_lenses(
        "thin",
        camera,
        lens(2253.0, [1024, 768]),
        projector_from_camera,
    );
    head.stage_from_camera = Some(RigidTransform {
        rotation: [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]],
        translation_mm: [19.5 + back_mm, 0.0, 0.0],
    });
    let sharp_mm = 22.0 - 0.4 * power_dpt;
    head.volume = Some(DepthRange {
        near_mm: sharp_mm - 1.7,
        far_mm: sharp_mm + 1.7,
    });
    head.calibration = Some(record(&head));
    head
}

fn record(head: &HeadModel) -> CalibrationRecord {
    let date: Date = "2026-01-31".parse().unwrap();
    CalibrationRecord {
        date,
        expires: date.plus_days(180),
        target: "six dot plates".into(),
        link: Some("sim".into()),
        simulated: Some(true),
        frames: vec![],
        unit: "mm".into(),
        blake3: head.geometry_blake3(),
        views: 12,
        dots: 3000,
        dropped: 0,
        camera_rms_px: 0.2,
        projector_rms_px: 0.2,
        depth_sigma_um: 0.9,
        lateral_sigma_um: 1.6,
        farther_sigma_um: None,
        hold_out: None,
        without_field: None,
        board: None,
        second_projector: None,
        focus: None,
    }
}

fn series(settings_dpt: &[f64]) -> FocusSeries {
    let focus = |&setting_dpt: &f64| Focus {
        setting_dpt,
        celsius: 23.0,
        file: format!("{setting_dpt}.toml").into(),
    };
    FocusSeries {
        name: "liquid".into(),
        drift_dpt_per_kelvin: DRIFT,
        drift_sigma_dpt_per_kelvin: 0.01,
        celsius_sigma: 0.5,
        focus: settings_dpt.iter().map(focus).collect(),
    }
}

fn heads(settings_dpt: &[f64], bent_px: f64) -> FocusedHeads {
    let series = series(settings_dpt);
    let of = |focus: &Focus| {
        let head = head_at(focus.setting_dpt, bent_px);
        (focus.clone(), focus.file.clone(), head)
    };
    let nodes = series.focus.iter().map(of).collect();
    FocusedHeads::new(series, nodes).unwrap()
}

fn off_um(head: &HeadModel, truth: &HeadModel) -> [f64; 2] {
    apart_mm(head, truth).unwrap().map(|mm| 1e3 * mm)
}

#[test]
fn at_a_setting_the_head_is_its_own_calibration() {
    let heads = heads(&[3.0, -3.0, 0.0], 2.0);
    for setting_dpt in [-3.0, 0.0, 3.0] {
        let (head, record) = heads.at(setting_dpt, 23.0).unwrap();
        let truth = head_at(setting_dpt, 2.0);
        assert!(off_um(&head, &truth).iter().all(|um| *um < 1e-6));
        let focus = record.focus.as_ref().unwrap();
        assert!(focus.interpolation_um.iter().all(|um| *um < 1e-6));
        assert_eq!(focus.between_dpt, [-3.0, 0.0, 3.0]);
        let [drift_um, _] = focus.drift_um;
        assert!((record.depth_sigma_um - 0.9f64.hypot(drift_um)).abs() < 1e-9);
    }
}

#[test]
fn between_settings_it_is_off_by_less_than_it_says() {
    // For a thin lens three settings over 6 dpt interpolate to negligible error. An oscillation beyond that must be reported.
    for (settings_dpt, bent_px) in [
        (&[-3.0, 0.0, 3.0][..], 0.0),
        (&[-3.0, -2.0, 0.0, 2.0, 3.0][..], 0.0),
        (&[-1.0, -0.5, 0.0, 0.5, 1.0][..], 1.0),
    ] {
        let heads = heads(settings_dpt, bent_px);
        for setting_dpt in [-0.8, -0.4, 0.25, 0.7] {
            let (head, record) = heads.at(setting_dpt, 23.0).unwrap();
            let off = off_um(&head, &head_at(setting_dpt, bent_px));
            let said = record.focus.as_ref().unwrap().interpolation_um;
            for (off_um, said_um) in off.into_iter().zip(said) {
                assert!(
                    off_um < said_um,
                    "{setting_dpt}: {off_um} against {said_um}"
                );
            }
            // The nearest setting itself would be off by several times that.
            let nearest = settings_dpt
                .iter()
                .copied()
                .min_by(|a, b| (a - setting_dpt).abs().total_cmp(&(b - setting_dpt).abs()));
            let nearest = off_um_of(nearest.unwrap(), setting_dpt, bent_px);
            assert!(off[0] < nearest[0] / 3.0, "{off:?} against {nearest:?}");
            let own_um = record.depth_sigma_um.powi(2) - said[0].powi(2);
            assert!(own_um >= 0.9f64.powi(2), "{record:?}");
        }
    }
}

fn off_um_of(setting_dpt: f64, truth_dpt: f64, bent_px: f64) -> [f64; 2] {
    off_um(&head_at(setting_dpt, bent_px), &head_at(truth_dpt, bent_px))
}

#[test]
fn warmth_moves_the_focus_and_is_paid_for() {
    let heads = heads(&[-3.0, 0.0, 3.0], 0.0);
    // Ten kelvins more are half a dioptre.
    let (warm, record) = heads.at(1.0, 33.0).unwrap();
    let off = off_um(&warm, &head_at(1.5, 0.0));
    assert!(off[0] < 0.1 && off[1] < 0.1, "{off:?}");
    // Of 0.01 dpt/K over 10 K, and of half a kelvin's 0.025 dpt here and in the settings; what a dioptre moves the points by is
    // the lens's own.
    let [[a, _], [b, _]] = [1.45, 1.55].map(|dpt| off_um_of(dpt, 1.5, 0.0));
    let per_dpt_um = (a + b) / 0.1;
    let squares: f64 = [0.125f64, 0.75, 0.375].iter().map(|w| w * w).sum();
    let sigma_dpt = f64::hypot(0.1, 0.025 * (1.0 + squares).sqrt());
    let said_um = record.focus.as_ref().unwrap().drift_um[0];
    assert!(
        (said_um / (per_dpt_um * sigma_dpt) - 1.0).abs() < 0.01,
        "{said_um} against {}",
        per_dpt_um * sigma_dpt
    );
    assert!(record.depth_sigma_um > said_um);
}

#[test]
fn beyond_the_settings_nothing_is_said() {
    let heads = heads(&[-3.0, 0.0, 3.0], 0.0);
    let words = |setting_dpt, celsius| heads.at(setting_dpt, celsius).unwrap_err().to_string();
    let said = words(3.2, 23.0);
    assert!(
        said.contains("3.2 dpt") && said.contains("-3 to 3 dpt"),
        "{said}"
    );
    // Warmer, less current reaches as far.
    let said = words(2.8, 33.0);
    assert!(said.contains("-3.5 to 2.5 dpt"), "{said}");
    assert!(heads.at(2.5, 33.0).is_ok());
    for (setting_dpt, celsius) in [(f64::NAN, 23.0), (0.0, f64::INFINITY), (0.0, 101.0)] {
        let error = heads.at(setting_dpt, celsius).unwrap_err();
        assert!(matches!(error, FocusError::State { .. }), "{error}");
    }
}

#[test]
fn what_is_no_series_is_refused_by_name() {
    let refused = |change: fn(&mut FocusSeries)| {
        let mut series = series(&[-3.0, 0.0, 3.0]);
        change(&mut series);
        series.check().unwrap_err().key
    };
    let wrong: [Wrong<FocusSeries>; 6] = [
        (|s| s.focus.truncate(2), "focus"),
        (|s| s.focus[1].setting_dpt = f64::NAN, "focus.setting_dpt"),
        (|s| s.focus[1].setting_dpt = -2.95, "focus.setting_dpt"),
        (|s| s.focus[1].celsius = 200.0, "focus.celsius"),
        (
            |s| s.drift_dpt_per_kelvin = f64::INFINITY,
            "drift_dpt_per_kelvin",
        ),
        (|s| s.celsius_sigma = -0.1, "celsius_sigma"),
    ];
    for (change, key) in wrong {
        assert_eq!(refused(change), key);
    }
}

#[test]
fn heads_that_are_not_one_are_refused_by_file() {
    let refused = |change: fn(&mut HeadModel)| {
        let series = series(&[-3.0, 0.0, 3.0]);
        let of = |focus: &Focus| {
            let mut head = head_at(focus.setting_dpt, 0.0);
            if focus.setting_dpt == 0.0 {
                change(&mut head);
            }
            (focus.clone(), focus.file.clone(), head)
        };
        let nodes = series.focus.iter().map(of).collect();
        FocusedHeads::new(series, nodes).unwrap_err().to_string()
    };
    let wrong: [Wrong<HeadModel>; 5] = [
        (|head| head.calibration = None, "has no [calibration]"),
        (|head| head.volume = None, "must have [volume]"),
        (|head| head.binning = 3, "is another head"),
        (
            |head| head.calibration.as_mut().unwrap().simulated = Some(false),
            "by another target or at another place",
        ),
        // Turned away, its rays meet no light.
        (
            |head| head.projector_from_camera.translation_mm[2] = -100.0,
            "do not meet",
        ),
    ];
    for (change, why) in wrong {
        let words = refused(change);
        assert!(words.contains("0.toml") && words.contains(why), "{words}");
    }
}
