//! What is done to a die against the truth about it: every built-in shape against its closed form.

use std::f64::consts::{PI, TAU};

use flankscope_bench::demo;
use flankscope_bench::world::{FlankId, VIEW_HALF_MM, World, WorldConfig};
use flankscope_bench::zones::{Judged, ZoneTruth, compare};
use flankscope_gear_cad::{Flank, GearSpec};

const DISC_MM2: f64 = 0.25;
/// Depth of every damage here, µm.
const DEPTH_UM: f64 = 100.0;
/// The drawing's chords lie up to 0.2 µm inside the involute: a sample's foot may lie on the neighbouring chord.
const CHORD_UM: f64 = 0.2;

fn judged(config: &WorldConfig, teeth: &[u32]) -> Judged {
    let gear = &config.gear;
    Judged {
        cad: config.cad.clone(),
        gear: gear.clone(),
        flanks: teeth
            .iter()
            .flat_map(|&tooth| [Flank::Left, Flank::Right].map(|flank| FlankId { tooth, flank }))
            .collect(),
        // A tenth of a module behind the tip to three quarters beyond the pitch circle, as a tool file without a zone has it.
        radius_mm: [
            gear.tip_radius_mm + 0.1 * gear.module_mm,
            gear.pitch_radius_mm() + 0.75 * gear.module_mm,
        ],
        height_mm: [
            demo::HEIGHT_MM - VIEW_HALF_MM,
            demo::HEIGHT_MM + VIEW_HALF_MM,
        ],
        disc_area_mm2: DISC_MM2,
    }
}

/// The truth about tooth 40's left and right flank with some damages.
fn truth(wear: &[&str]) -> [ZoneTruth; 2] {
    let mut config = demo::world_config().expect("the demo");
    config.wear = wear.iter().map(|w| w.parse().expect("valid")).collect();
    let judged = judged(&config, &[40]);
    let world = World::new(&config).expect("a world");
    let zones = compare(&world, &judged);
    [Flank::Left, Flank::Right].map(|flank| zones[&FlankId { tooth: 40, flank }])
}

fn of_kind(kind: &str) -> ZoneTruth {
    let [worn, sound] = truth(&[&format!("40:left:{DEPTH_UM}:{kind}")]);
    assert_sound(&sound);
    worn
}

#[track_caller]
fn assert_sound(zone: &ZoneTruth) {
    assert_eq!(zone.missing_ratio, 0.0);
    for um in [
        zone.max_disc_wear_um,
        zone.max_disc_proud_um,
        zone.zone_mean_wear_um,
        zone.zone_max_wear_um,
    ] {
        assert!(um.is_some_and(|um| um.abs() < 1e-6), "{zone:?}");
    }
}

#[track_caller]
fn assert_um(name: &str, got: Option<f64>, expected_um: f64, tolerance_um: f64) {
    let got = got.unwrap_or_else(|| panic!("{name} is missing"));
    println!("{name}: {got:.3} µm, expected {expected_um:.3} ± {tolerance_um:.3}");
    assert!(
        (got - expected_um).abs() <= tolerance_um,
        "{name}: {got} µm against {expected_um} ± {tolerance_um} µm"
    );
}

/// Radius of the disc, mm.
fn disc_mm() -> f64 {
    (DISC_MM2 / PI).sqrt()
}

/// Mean over the disc of what is `depth(x, y)` deep at a distance of x and y from its middle, relative to the area.
fn disc_mean(depth: impl Fn(f64, f64) -> f64) -> f64 {
    const FINE: i32 = 1000;
    let cell = 2.0 * disc_mm() / f64::from(FINE);
    let (mut sum, mut cells) = (0.0, 0.0);
    for i in 0..FINE {
        for j in 0..FINE {
            let [x, y] = [i, j].map(|k| (f64::from(k) + 0.5) * cell - disc_mm());
            if x.hypot(y) <= disc_mm() {
                sum += depth(x, y);
                cells += 1.0;
            }
        }
    }
    sum / cells
}

/// A strip of the sampling grid more or less at the rim of a disc: what a depth that jumps is known to, relative.
const JUMP: f64 = 0.02 / 0.28;

#[test]
fn a_sound_die_has_no_wear_at_all() {
    for zone in truth(&[]) {
        assert_sound(&zone);
    }
}

#[test]
fn even_wear_is_its_depth_everywhere() {
    let zone = of_kind("uniform");
    assert_um("disc", zone.max_disc_wear_um, DEPTH_UM, CHORD_UM);
    assert_um("mean", zone.zone_mean_wear_um, DEPTH_UM, CHORD_UM);
    assert_um("max", zone.zone_max_wear_um, DEPTH_UM, CHORD_UM);
    // The least loss, with the sign of proud material.
    assert_um("proud", zone.max_disc_proud_um, -DEPTH_UM, CHORD_UM);
    assert_eq!(zone.missing_ratio, 0.0);
}

#[test]
fn half_is_gone_and_half_is_not() {
    let zone = of_kind("half");
    assert_um("disc", zone.max_disc_wear_um, DEPTH_UM, CHORD_UM);
    assert_um("mean", zone.zone_mean_wear_um, 0.5 * DEPTH_UM, 1.0);
    assert_um("proud", zone.max_disc_proud_um, 0.0, 1e-6);
}

#[test]
fn a_ramp_rises_over_the_upper_half() {
    let zone = of_kind("ramp");
    // A disc at the upper rim has its middle its radius below.
    let at_top = DEPTH_UM * (1.0 - disc_mm() / VIEW_HALF_MM);
    let step = DEPTH_UM * 0.02 / VIEW_HALF_MM;
    assert_um("disc", zone.max_disc_wear_um, at_top, step + CHORD_UM);
    assert_um("mean", zone.zone_mean_wear_um, 0.25 * DEPTH_UM, CHORD_UM);
    assert_um("max", zone.zone_max_wear_um, DEPTH_UM, step + CHORD_UM);
}

#[test]
fn an_edge_wears_by_e_every_two_millimetres() {
    let zone = of_kind("edge");
    let mean = 2.0 / (2.0 * VIEW_HALF_MM) * (1.0 - (-VIEW_HALF_MM).exp());
    assert_um("mean", zone.zone_mean_wear_um, DEPTH_UM * mean, CHORD_UM);
    let disc = disc_mean(|x, _| (-(x + disc_mm()) / 2.0).exp());
    let step = DEPTH_UM * 0.02 / 2.0;
    assert_um(
        "disc",
        zone.max_disc_wear_um,
        DEPTH_UM * disc,
        step + CHORD_UM,
    );
    assert_um("max", zone.zone_max_wear_um, DEPTH_UM, step + CHORD_UM);
}

#[test]
fn a_spall_is_flat_and_as_wide_as_stated() {
    let zone = of_kind("spall");
    assert_um("disc", zone.max_disc_wear_um, DEPTH_UM, CHORD_UM);
    // Its volume: a flat cone of rim 0.1 mm around 1.05 mm. The part beyond the zone's rim is not in the zone's mean.
    let config = demo::world_config().expect("the demo");
    let (middle, from, to) = profile_mm(&config.gear, &judged(&config, &[40]));
    let volume = integral([from - middle, to - middle], |x, y| {
        ((1.05 - x.hypot(y)) / 0.1 + 0.5).clamp(0.0, 1.0)
    });
    let area = (to - from) * 2.0 * VIEW_HALF_MM;
    let mean = DEPTH_UM * volume / area;
    // The rim's folds are followed by edges of 0.035 mm: an error within the area of a rim of that width.
    let rim = DEPTH_UM * TAU * 1.05 * 0.035 * 0.25 / area;
    assert_um("mean", zone.zone_mean_wear_um, mean, rim + CHORD_UM);
}

/// Profile length of the middle of a flank, and of the zone's ends, mm.
fn profile_mm(gear: &GearSpec, judged: &Judged) -> (f64, f64, f64) {
    let base = gear.base_radius_mm();
    let at = |r: f64| (r * r - base * base) / (2.0 * base);
    (
        0.5 * (at(gear.tip_radius_mm) + at(gear.root_radius_mm)),
        at(judged.radius_mm[0]),
        at(judged.radius_mm[1]),
    )
}

/// Integral over the zone's width and its height around the middle.
fn integral([from, to]: [f64; 2], depth: impl Fn(f64, f64) -> f64) -> f64 {
    const FINE: i32 = 2000;
    let (dx, dy) = (
        (to - from) / f64::from(FINE),
        2.0 * VIEW_HALF_MM / f64::from(FINE),
    );
    let mut sum = 0.0;
    for i in 0..FINE {
        for j in 0..FINE {
            sum += depth(
                from + (f64::from(i) + 0.5) * dx,
                (f64::from(j) + 0.5) * dy - VIEW_HALF_MM,
            );
        }
    }
    sum * dx * dy
}

#[test]
fn scratches_are_round_grooves() {
    let groove = |x: f64| (1.0 - (x / 0.15).powi(2)).max(0.0);
    let disc = DEPTH_UM * disc_mean(|x, _| groove(x));
    // The parabola's chords over 0.035 mm are 0.035² / (8 · 0.15² / 2) of its depth short, two thirds of it on average.
    let chord = DEPTH_UM * 0.035f64.powi(2) / (4.0 * 0.15f64.powi(2));
    for kind in ["scratch-along", "scratch-across"] {
        let zone = of_kind(kind);
        assert_um(kind, zone.max_disc_wear_um, disc, chord + 0.01 * disc);
        assert_um(
            kind,
            zone.zone_max_wear_um,
            DEPTH_UM,
            chord + CHORD_UM + 0.5,
        );
        assert_um(kind, zone.max_disc_proud_um, 0.0, 1e-6);
    }
}

#[test]
fn a_crater_has_a_bowl_and_a_wall() {
    let zone = of_kind("crater");
    let bowl = disc_mean(|x, y| 1.0 - (x.hypot(y) / 0.6).powi(2));
    assert_um("bowl", zone.max_disc_wear_um, DEPTH_UM * bowl, 1.0);
    let wall = |x: f64, y: f64| {
        let away = (x + 0.75).hypot(y);
        if away < 0.6 {
            (away / 0.6).powi(2) - 1.0
        } else if away < 0.9 {
            0.25 * ((away - 0.6) / 0.3 * PI).sin().powi(2)
        } else {
            0.0
        }
    };
    // The disc that lies best on the wall is somewhat farther out than its crest.
    let best = (0..40)
        .map(|i| f64::from(i) * 0.01)
        .map(|out| disc_mean(|x, y| wall(x + out, y)))
        .fold(0.0, f64::max);
    assert_um("wall", zone.max_disc_proud_um, DEPTH_UM * best, 0.5);
}

#[test]
fn a_crack_is_narrow_and_deep() {
    let zone = of_kind("crack");
    let disc = DEPTH_UM * disc_mean(|x, _| (1.0 - x.abs() / 0.05).max(0.0));
    // Five cells of the grid lie across it: their sum is that of the area to half a cell's share.
    assert_um(
        "disc",
        zone.max_disc_wear_um,
        disc,
        0.5 * JUMP * disc + 0.04 * disc,
    );
    // The sample nearest to its bottom is up to half a cell away, the mesh's vertices half an edge.
    let max = zone.zone_max_wear_um.expect("a deepest sample");
    let slope = DEPTH_UM / 0.05;
    assert!(
        max <= DEPTH_UM + CHORD_UM && max >= DEPTH_UM - slope * (0.01 + 0.5 * 0.0125),
        "{max}"
    );
}

#[test]
fn a_side_wears_on_every_tooth_and_the_ring_everywhere() {
    let mut config = demo::world_config().expect("the demo");
    let judged = judged(&config, &[1, 23, 84]);
    config.wear = vec!["7:right:55:side".parse().expect("valid")];
    let world = World::new(&config).expect("a world");
    for (id, zone) in compare(&world, &judged) {
        if id.flank == Flank::Right {
            assert_um("side", zone.zone_mean_wear_um, 55.0, CHORD_UM);
            assert_um("side", zone.max_disc_wear_um, 55.0, CHORD_UM);
        } else {
            assert_sound(&zone);
        }
    }

    config.wear = vec!["1:left:55:ring".parse().expect("valid")];
    let world = World::new(&config).expect("a world");
    for zone in compare(&world, &judged).values() {
        assert_um("ring", zone.zone_mean_wear_um, 55.0, CHORD_UM);
        assert_um("ring", zone.max_disc_wear_um, 55.0, CHORD_UM);
        assert_um("ring", zone.zone_max_wear_um, 55.0, CHORD_UM);
    }
    // Lands move outwards by the same, and the parallel of a ring gear's outline is closed: the material lost is the depth
    // times the toothing's area, less what convex and concave corners take from each other.
    let radii = |cad: &flankscope_gear_cad::Mesh| {
        let of = |v: &[f64; 3]| v[0].hypot(v[1]);
        let teeth = || cad.vertices.iter().map(of).filter(|r| *r < 60.0);
        (
            teeth().fold(f64::INFINITY, f64::min),
            teeth().fold(0.0, f64::max),
        )
    };
    let (was, is) = (radii(&config.cad), radii(world.die().mesh()));
    // A land's chords are 0.2 µm from its arc.
    assert!((is.0 - was.0 - 0.055).abs() < 0.3e-3, "{was:?} {is:?}");
    assert!((is.1 - was.1 - 0.055).abs() < 0.3e-3, "{was:?} {is:?}");
}

#[test]
fn damages_add_up() {
    let [left, right] = truth(&[
        "1:left:20:ring",
        "3:left:30:side",
        "40:left:40:uniform",
        "40:right:25:half",
    ]);
    assert_um("left", left.zone_mean_wear_um, 90.0, CHORD_UM);
    assert_um("right", right.max_disc_wear_um, 45.0, CHORD_UM);
    assert_um("right", right.max_disc_proud_um, -20.0, CHORD_UM);
}
