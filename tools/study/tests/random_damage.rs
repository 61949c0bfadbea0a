//! Random damage cut into the die, photographed, decoded and judged, against the exact distance of die and drawing.
//!
//! Sixteen damages with `FLANKSCOPE_TEST_ALL=1`, else six; and dies of families that the verdict
//! once presumed away. Rates with bounds are the study's (`cargo xtask study families`).

use std::collections::BTreeMap;

use flankscope_bench::damage::{Damage, Rectangle, Workpiece};
use flankscope_bench::demo;
use flankscope_bench::world::{FlankId, World};
use flankscope_bench::zones::{Judged, compare};
use flankscope_gear_cad::Flank;
use flankscope_metrology::verdict::{Code, Word};
use flankscope_study::{Draw, Family, Judgement, draws, random_damages};
use flankscope_test_requisites::everything;

/// Limits of the demo tool, µm.
const WARN_UM: f64 = 30.0;
const LIMIT_UM: f64 = 50.0;
/// Rates that are allowed, and the share of figures whose U95 is to hold the truth.
const MOST_FALSE_GO: f64 = 0.05;
const MOST_FALSE_ALARM: f64 = 0.01;
const LEAST_HELD: f64 = 0.9;
/// Draws the damages; nothing was chosen by it.
const SEED: u64 = 13;

/// The drawing's chords lie up to 0.2 µm inside the involute: a sample's foot may lie on the neighbouring chord.
const CHORD_UM: f64 = 0.2;

#[test]
fn what_is_cut_into_a_flank_is_there_and_nothing_else() {
    let config = demo::world_config().expect("the demo");
    let gear = &config.gear;
    let base = gear.base_radius_mm();
    let radius_mm = [
        gear.tip_radius_mm + 0.1 * gear.module_mm,
        gear.pitch_radius_mm() + 0.75 * gear.module_mm,
    ];
    let judged = Rectangle {
        profile_mm: radius_mm.map(|r| (r * r - base * base) / (2.0 * base)),
        height_mm: [demo::HEIGHT_MM - 4.0, demo::HEIGHT_MM + 4.0],
    };
    let flanks = [Flank::Left, Flank::Right].map(|flank| FlankId { tooth: 40, flank });
    let workpiece = Workpiece::new(&config.cad, gear, &flanks, judged).expect("its flanks");
    let zones = |damages: &[(FlankId, Damage)]| {
        let mut world = World::new(&config).expect("a world");
        let die = workpiece.cut(damages).expect("a die");
        assert!(
            !die.is_closed(),
            "a finer flank meets its neighbours' edges"
        );
        world.stand(Some(die)).expect("a die");
        let found = compare(
            &world,
            &Judged {
                cad: config.cad.clone(),
                gear: gear.clone(),
                flanks: flanks.to_vec(),
                radius_mm,
                height_mm: judged.height_mm,
                disc_area_mm2: 0.25,
            },
        );
        flanks.map(|id| found[&id])
    };
    for zone in zones(&[]) {
        assert_eq!(zone.missing_ratio, 0.0);
        assert!(zone.zone_max_wear_um.is_some_and(|um| um.abs() < 1e-3));
        assert!(zone.max_disc_proud_um.is_some_and(|um| um.abs() < 1e-3));
    }
    // Wider than the disc: its flat bottom is the figure. The other flank knows nothing of it.
    let spot = Damage::spot(7, judged, 1.5, 40.0);
    assert!((spot.largest_mean_um(0.25) - 40.0).abs() < 1e-9);
    let [worn, sound] = zones(&[(flanks[0], spot)]);
    let um = worn.max_disc_wear_um.expect("a surface");
    assert!((um - 40.0).abs() < CHORD_UM, "{um}");
    assert!(worn.max_disc_proud_um.is_some_and(|um| um.abs() < 1e-3));
    assert!(sound.zone_max_wear_um.is_some_and(|um| um.abs() < 1e-3));
    // Scaled to what its closed form says; a rim is known to half an edge of the mesh in a disc's radius.
    let random = Damage::draw(1, judged, 0.25, 50.0);
    let [worn, _] = zones(&[(flanks[0], random)]);
    let um = worn.max_disc_wear_um.expect("a surface");
    assert!((um - 50.0).abs() < 50.0 * 0.025 / 0.28, "{um}");
}

fn truth_um(one: &Judgement) -> f64 {
    one.truth.max_disc_wear_um.expect("a zone with a surface")
}

/// Error and U95, µm.
fn error_um(one: &Judgement) -> Option<[f64; 2]> {
    Some([one.found.wear_um? - truth_um(one), one.found.u95_um?])
}

fn by_wear(one: &Judgement) -> bool {
    let reason = one.found.reason.as_deref();
    one.found.verdict == Word::NoGo && reason.is_some_and(|why| why.starts_with("wear "))
}

#[test]
fn random_damage_is_not_passed_and_sound_flanks_are_not_refused() {
    let count = if everything() { 16 } else { 6 };
    let all = random_damages(count, SEED, |line| println!("{line}")).expect("the bench");
    assert_eq!(all.len(), count as usize);

    let share =
        |what: &str, hit: &dyn Fn(&Judgement) -> bool, among: &dyn Fn(&Judgement) -> bool| {
            let among: Vec<&Judgement> = all.iter().filter(|one| among(one)).collect();
            let hits = among.iter().filter(|one| hit(one)).count();
            println!("{what}: {hits} of {}", among.len());
            hits as f64 / among.len().max(1) as f64
        };
    let is = |word: Word| move |one: &Judgement| one.found.verdict == word;
    let beyond_limit = |one: &Judgement| truth_um(one) > LIMIT_UM;
    let below_warn = |one: &Judgement| truth_um(one) < WARN_UM;
    let false_go = share("go beyond the stop limit", &is(Word::Go), &beyond_limit);
    let passed = |one: &Judgement| one.found.verdict.passes();
    share("go or warn beyond the stop limit", &passed, &beyond_limit);
    share(
        "stopped beyond the stop limit",
        &is(Word::NoGo),
        &beyond_limit,
    );
    share(
        "indeterminate beyond the stop limit",
        &is(Word::Indeterminate),
        &beyond_limit,
    );
    let beyond_warn = |one: &Judgement| truth_um(one) > WARN_UM;
    share("go beyond the warning limit", &is(Word::Go), &beyond_warn);
    let false_alarm = share(
        "no-go by wear below the warning limit",
        &by_wear,
        &below_warn,
    );
    share("go below the warning limit", &is(Word::Go), &below_warn);
    share(
        "indeterminate below the warning limit",
        &is(Word::Indeterminate),
        &below_warn,
    );
    let measured = |one: &Judgement| error_um(one).is_some();
    let holds = |one: &Judgement| error_um(one).is_some_and(|[e, u95]| e.abs() <= u95);
    share("U95 holds the truth", &holds, &measured);
    let held = share(
        "U95 holds the truth where the verdict is go or warn",
        &holds,
        &|one| passed(one) && measured(one),
    );
    let too_high = share(
        "figure beyond U95 above the truth",
        &|one| error_um(one).is_some_and(|[e, u95]| e > u95),
        &measured,
    );

    // Shape by shape: how many, how many not held, bias, largest error over U95.
    let mut shapes: BTreeMap<&str, Vec<[f64; 2]>> = BTreeMap::new();
    let mut reasons: BTreeMap<Code, u32> = BTreeMap::new();
    for one in &all {
        shapes.entry(one.shape).or_default().extend(error_um(one));
        if let Some(code) = one.found.code {
            *reasons.entry(code).or_default() += 1;
        }
        if !holds(one) || (is(Word::Go)(one) && beyond_warn(one)) {
            println!(
                "not held: {} on {} {}, true {:.2} um, found {:?} ± {:?} um, {} {}",
                one.shape,
                one.found.id.tooth,
                one.found.id.flank,
                truth_um(one),
                one.found.wear_um,
                one.found.u95_um,
                one.found.verdict,
                one.found.reason.as_deref().unwrap_or(""),
            );
        }
    }
    for (shape, errors) in shapes {
        let mean = errors.iter().map(|e| e[0]).sum::<f64>() / errors.len().max(1) as f64;
        let u95 = errors.iter().map(|e| e[1]).sum::<f64>() / errors.len().max(1) as f64;
        let worst = errors.iter().map(|e| e[0].abs()).fold(0.0, f64::max);
        let missed = errors.iter().filter(|[e, u95]| e.abs() > *u95).count();
        println!(
            "{shape}: {} figures, {missed} not held; bias {mean:.2}, worst {worst:.2}, U95 {u95:.2} um",
            errors.len()
        );
    }
    println!("indeterminate: {reasons:?}");

    assert!(false_go <= MOST_FALSE_GO, "{false_go}");
    assert!(false_alarm <= MOST_FALSE_ALARM, "{false_alarm}");
    // The head looks along a flank, so the walls of a steep or narrow damage hide part of its bottom: what is read is then a
    // lower bound, and the flank is stopped or refused (`hidden`). U95 is asked for where a flank passes, and nowhere may a
    // figure be too high. Of the few figures of a short run one may be outside by chance.
    if everything() {
        assert!(held >= LEAST_HELD, "{held}");
        assert!(too_high <= 1.0 - LEAST_HELD, "{too_high}");
    }
}

/// Draws the dies of the families; nothing was chosen by it.
const FAMILY_SEED: u64 = 2029;
/// Dies of each family where everything must run, and of the first ones else.
const DIES: u32 = 2;

/// A go beyond the stop limit is never right. Rough dies and dies of class 7 are go, but for one flank by chance; how many dies with
/// hairlines are not is told, and docs/study/families.md has the rates.
#[test]
fn no_family_is_passed_beyond_the_limit() {
    let (families, dies) = match everything() {
        true => (&Family::ALL[..], DIES),
        false => (&[Family::Texture, Family::Class7][..], 1),
    };
    let of_all =
        draws(families, (1, dies), FAMILY_SEED, |line| println!("{line}")).expect("the bench");
    for &family in families {
        let all: Vec<&Draw> = of_all.iter().filter(|d| d.family == family).collect();
        assert!(all.len() >= dies as usize);
        assert!(!all.iter().any(|d| d.is_false_go()), "{}", family.name());
        let refused = all.iter().filter(|one| one.word != Word::Go).count();
        println!("{}: {refused} of {} are not go", family.name(), all.len());
        if family.is_sound() {
            let hairlines = family == Family::Hairlines;
            assert!(refused <= 1 || hairlines, "{}: {refused}", family.name());
        } else {
            assert!(all.iter().any(|d| d.is_beyond()), "{}", family.name());
        }
    }
}
