//! `scan --gear`: profile, helix and pitch of every tooth from the points of a scan, against dies whose deviations are known in
//! closed form.

use std::f64::consts::TAU;

use flankscope_gear_cad::{Meshing, write_ply};
use flankscope_tests::{Run, demo_gear, flankscope, run};
use serde_json::Value;

const PITCH_RADIUS_MM: f64 = 41.45;

fn base_mm() -> f64 {
    PITCH_RADIUS_MM * 20f64.to_radians().cos()
}

fn roll_mm(radius_mm: f64) -> f64 {
    (radius_mm * radius_mm - base_mm() * base_mm())
        .max(0.0)
        .sqrt()
}

/// Ends of the usable flank as roll lengths, and the tips': three quarters of a module beyond the pitch circle, a tenth of a module
/// from the tip.
fn rolls_mm() -> [f64; 3] {
    let gear = demo_gear();
    let tip_form_mm = gear.tip_radius_mm + 0.1 * gear.module_mm;
    [
        PITCH_RADIUS_MM + 0.75 * gear.module_mm,
        tip_form_mm,
        gear.tip_radius_mm,
    ]
    .map(roll_mm)
}

/// A scan of every seventh tooth, read as a gear.
fn scan(rest: &[&str]) -> Run {
    let common = ["scan", "--quiet", "--json", "-", "--speed", "max", "--gear"];
    run(flankscope().args(common).args(rest))
}

fn number(of: &Value) -> f64 {
    of.as_f64().unwrap_or_else(|| panic!("no number: {of}"))
}

/// A trace of every flank of the teeth in the middle of a view, and what is stated of its deviations (95 %), µm.
fn middle_traces<'a>(run: &'a Run, trace: &str) -> Vec<(&'a Value, f64)> {
    let gear = &run.json["gear"];
    let flanks = gear["flanks"].as_array();
    let flanks = flanks.unwrap_or_else(|| panic!("{} {}", run.json["reason"], run.stderr));
    let told = flanks
        .iter()
        .filter(|of| of["tooth"].as_u64().unwrap() % 7 == 4);
    let told: Vec<(&Value, f64)> = told
        .map(|of| {
            (
                &of[trace],
                number(&gear["u95_um"]).hypot(1.96 * number(&of[trace]["noise_um"])),
            )
        })
        .collect();
    assert_eq!(told.len(), 24);
    told
}

/// A figure lies within its uncertainty, and that is one that a gear can be read with.
#[track_caller]
fn assert_within(u95_um: f64, got: &Value, expected_um: f64) {
    let off_um = number(got) - expected_um;
    assert!(
        off_um.abs() <= u95_um,
        "{got} µm, {expected_um} µm were put in, U95 {u95_um} µm"
    );
    assert!(u95_um < 12.0, "{u95_um}");
}

#[test]
fn a_die_as_drawn_has_no_deviation_beyond_the_uncertainty_and_what_was_not_seen_is_named() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().to_str().unwrap();
    let drawn = scan(&["--views", "12x1", "--report", report]);
    let gear = &drawn.json["gear"];
    for (profile, u95_um) in middle_traces(&drawn, "profile") {
        for figure in ["total_um", "form_um", "slope_um"] {
            assert_within(u95_um, &profile[figure], 0.0);
        }
    }
    // A layer of fields 10 mm high shows no helix of 66 mm, and twelve views no pitch of all teeth.
    for flank in gear["flanks"].as_array().unwrap() {
        assert_eq!(flank["helix_not_told"]["code"], "helix_gap", "{flank}");
    }
    for rating in gear["ratings"].as_array().unwrap() {
        let symbol = rating["symbol"].as_str().unwrap();
        let told = ["F_alpha", "f_f_alpha", "f_H_alpha", "f_p"].contains(&symbol);
        assert_eq!(rating["value_um"].is_number(), told, "{rating}");
    }
    // F_p and F_r are less sure than the rest by what the rotary stage was found to err.
    let [all, cumulative, stage] =
        ["u95_um", "cumulative_u95_um", "stage_um"].map(|key| number(&gear[key]));
    assert!(
        stage > 5.0 && (cumulative - all - stage).abs() < 1e-9,
        "{gear}"
    );
    // The table has the same figures.
    let table = std::fs::read_to_string(folder.path().join("gear.csv")).unwrap();
    let mut lines = table.lines();
    let columns = lines.next().unwrap().split(',').count();
    let flanks = gear["flanks"].as_array().unwrap();
    assert_eq!(lines.clone().count(), flanks.len());
    for (line, flank) in lines.zip(flanks) {
        let fields: Vec<&str> = line.split(',').collect();
        assert_eq!(fields.len(), columns, "{line}");
        assert_eq!(fields[0], flank["tooth"].to_string());
        assert_eq!(
            fields[2].parse().ok(),
            flank["profile"]["total_um"].as_f64()
        );
        assert_eq!(fields[10].parse().ok(), flank["position_um"].as_f64());
    }
}

#[test]
fn known_slopes_and_pitches_come_back_within_their_uncertainty() {
    if !flankscope_test_requisites::dear() {
        return;
    }
    // Over the usable profile 14 µm more material at the root end, over the face width 20 µm more at the top, and every third tooth
    // is 12 µm astray along the pitch circle.
    let (profile_um, helix_um) = (-14.0, 20.0);
    let astray_um = |tooth: u32| if tooth.is_multiple_of(3) { 12.0 } else { 0.0 };
    let gear = demo_gear();
    let slices = Meshing {
        axial_slices: 88,
        ..Meshing::default()
    };
    let mut mesh = gear.mesh(&slices).unwrap();
    let [control, tip_form, tip] = rolls_mm();
    for p in &mut mesh.vertices {
        let radius = p[0].hypot(p[1]);
        if radius > gear.root_radius_mm + 1e-6 {
            continue;
        }
        // A space is centred on +x, tooth 1 follows it.
        let angle = p[1].atan2(p[0]);
        let pitches = angle.rem_euclid(TAU) / gear.pitch_angle_rad();
        let left = if pitches.fract() > 0.5 { 1.0 } else { -1.0 };
        // Turning an involute by an angle moves it by that times the base radius along its normals.
        let share = (roll_mm(radius) - control) / (tip_form - control);
        let along_normal_um = profile_um * share + helix_um * p[2] / 66.0;
        let along_pitch_um = astray_um(pitches as u32 + 1);
        let turned = 1e-3 * (left * along_normal_um / base_mm() + along_pitch_um / PITCH_RADIUS_MM);
        let (sin, cos) = (angle + turned).sin_cos();
        (p[0], p[1]) = (radius * cos, radius * sin);
    }
    let folder = tempfile::tempdir().unwrap();
    let die = folder.path().join("die.ply");
    let mut bytes = Vec::new();
    write_ply(&mesh, &mut bytes).unwrap();
    std::fs::write(&die, bytes).unwrap();
    let scanned = scan(&["--views", "12x9", "--die-mesh", die.to_str().unwrap()]);
    for (profile, u95_um) in middle_traces(&scanned, "profile") {
        assert_within(u95_um, &profile["slope_usable_um"], profile_um);
        let to_tip_um = profile_um * (tip - control) / (tip_form - control);
        assert_within(u95_um, &profile["slope_um"], to_tip_um);
        assert_within(u95_um, &profile["form_um"], 0.0);
    }
    for (helix, u95_um) in middle_traces(&scanned, "helix") {
        assert_within(u95_um, &helix["slope_um"], helix_um);
        assert_within(u95_um, &helix["form_um"], 0.0);
    }
    // Of two flanks, each with its own uncertainty, along the pitch circle.
    let mut pitches = 0;
    for side in ["left", "right"] {
        let u95_um = |tooth: usize| {
            let flanks = scanned.json["gear"]["flanks"].as_array().unwrap();
            let of = |f: &&Value| f["tooth"] == tooth && f["flank"] == side;
            let noise_um = number(&flanks.iter().find(of).unwrap()["position_noise_um"]);
            number(&scanned.json["gear"]["u95_um"]).hypot(1.96 * noise_um)
        };
        let singles = scanned.json["gear"][side]["single_um"].as_array().unwrap();
        for (before, single) in singles.iter().enumerate().skip(1) {
            if single.is_null() {
                continue;
            }
            let expected_um = astray_um(before as u32 + 1) - astray_um(before as u32);
            let both_um = u95_um(before).hypot(u95_um(before + 1)) * PITCH_RADIUS_MM / base_mm();
            assert_within(both_um, single, expected_um);
            pitches += 1;
        }
    }
    assert!(pitches >= 24, "{pitches}");
}

#[test]
fn what_claims_no_uncertainty_is_no_gear() {
    let refused = scan(&["--views", "12x1", "--method", "article"]);
    assert_eq!(refused.code, 3);
    assert!(
        refused.stderr.contains("--gear: the article's method"),
        "{}",
        refused.stderr
    );
}
