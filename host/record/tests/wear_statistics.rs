//! Trend, change and remaining cycles against closed forms, tables and simulated wear.

use flankscope_metrology::verdict::{Code, Word};
use flankscope_record::document::FeatureId;
use flankscope_record::history::{
    Check, FlankRow, Forecast, LEAST_POINTS, Passage, Point, Series, Trend, changes, series,
};
use flankscope_record::origin::{HeadId, Origin};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn left(tooth: u32) -> FeatureId {
    FeatureId {
        tooth,
        flank: flankscope_metrology::gear::Flank::Left,
        patch: None,
    }
}

/// A standard normal number (Box and Muller).
fn normal(random: &mut Pcg64) -> f64 {
    let (a, b): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

fn points(count: usize, step: f64, wear_um: impl FnMut(f64) -> f64) -> Vec<Point> {
    let mut wear_um = wear_um;
    (0..count)
        .map(|i| Point {
            check: i as i64 + 1,
            cycles: i as f64 * step,
            wear_um: wear_um(i as f64 * step),
            u_um: 0.1,
        })
        .collect()
}

#[test]
fn a_fifth_of_wild_figures_does_not_move_the_line() {
    let mut wild = points(20, 10.0, |cycles| 3.0 + 0.25 * cycles);
    for (at, um) in [(2, 900.0), (7, -400.0), (11, 650.0), (18, 1e6)] {
        wild[at].wear_um = um;
    }
    // 120 of 190 pairs lie on the line: their slope is the median, whatever the others are.
    let trend = Trend::of(&wild).unwrap();
    assert!((trend.rate_um - 0.25).abs() < 1e-12, "{trend:?}");
    assert!(
        (trend.now_um - (3.0 + 0.25 * 190.0)).abs() < 1e-9,
        "{trend:?}"
    );
    let [low, high] = trend.rate_um_95;
    assert!(low <= 0.25 && 0.25 <= high);
}

#[test]
fn without_enough_figures_or_without_cycles_there_is_no_trend() {
    assert_eq!(Trend::of(&points(LEAST_POINTS - 1, 1.0, |c| c)), None);
    assert!(Trend::of(&points(LEAST_POINTS, 1.0, |c| c)).is_some());
    assert_eq!(Trend::of(&points(50, 0.0, |_| 1.0)), None);
}

#[test]
fn the_interval_of_the_rate_holds_the_true_rate_in_95_of_100_cases() {
    let mut random = Pcg64::seed_from_u64(1);
    let runs = 1000;
    let held = (0..runs)
        .filter(|_| {
            let figures = points(25, 7.0, |cycles| 0.05 * cycles + normal(&mut random));
            let [low, high] = Trend::of(&figures).unwrap().rate_um_95;
            (low..=high).contains(&0.05)
        })
        .count();
    // Three standard deviations of a binomial count are 2 %; ranks are discrete, which only widens the interval.
    let share = held as f64 / f64::from(runs);
    assert!((0.93..0.98).contains(&share), "{share}");
}

#[test]
fn a_line_that_holds_alarms_as_rarely_as_the_table_says() {
    // 465 checks on average for k = 1/2 and h = 5, both sides (Montgomery). The run length is nearly exponential: 400 runs
    // give its mean to 23. The scatter itself is known to about 2 % from 3000 figures.
    let mut random = Pcg64::seed_from_u64(2);
    let runs = 400;
    let total: usize = (0..runs)
        .map(|_| {
            let figures = points(3000, 5.0, |cycles| {
                0.01 * cycles + 0.3 * normal(&mut random)
            });
            changes(&figures, 0.0).first().copied().unwrap_or(3000)
        })
        .sum();
    let mean = total as f64 / f64::from(runs);
    assert!((mean - 465.0).abs() < 100.0, "{mean}");
}

#[test]
fn the_first_checks_of_a_die_raise_no_alarm_by_chance() {
    // One false alarm in 465 checks is 3 % in 15 of them, were the scatter known; it is not, and must not make it more.
    let mut random = Pcg64::seed_from_u64(5);
    for count in [5, 6, 8, 10, 15] {
        let alarmed = (0..1000)
            .filter(|_| {
                let figures = points(count, 100.0, |cycles| {
                    0.05 * cycles + 0.5 * normal(&mut random)
                });
                !changes(&figures, 0.0).is_empty()
            })
            .count();
        assert!(alarmed <= 50, "{alarmed} of 1000 lines of {count} checks");
    }
    // A tenth of a millimetre is found as soon as it has lasted.
    let chipped = points(12, 100.0, |cycles| {
        let chip = if cycles >= 700.0 { 100.0 } else { 0.0 };
        0.05 * cycles + chip + 0.5 * normal(&mut random)
    });
    assert_eq!(changes(&chipped, 30.0), [7]);
}

#[test]
fn a_chip_and_a_new_rate_are_found_where_they_are() {
    let mut random = Pcg64::seed_from_u64(3);
    let (mut dated, mut before) = (0, 0);
    for _ in 0..200 {
        // Six standard deviations at once.
        let chip = points(60, 5.0, |cycles| {
            let chipped = if cycles >= 200.0 { 1.8 } else { 0.0 };
            0.01 * cycles + chipped + 0.3 * normal(&mut random)
        });
        let found = changes(&chip, 0.0);
        assert!(
            found.iter().any(|at| (35..=43).contains(at)),
            "chip at 40: {found:?}"
        );
        dated += usize::from(found.contains(&40));
        before += usize::from(found.first().is_some_and(|&at| at < 35));
    }
    // A neighbour is the likelier beginning when its own error exceeds 2.5 standard deviations upwards: 6 in 1000; two or
    // three neighbours together are as rare. 33 checks alarm by chance in 7 % of the runs.
    assert!(dated > 180, "{dated} of 200 are dated to the figure");
    assert!(before < 30, "{before} of 200 alarmed before");
    let faster = points(80, 5.0, |cycles| {
        0.01 * cycles + 0.05 * (cycles - 200.0).max(0.0) + 0.3 * normal(&mut random)
    });
    let forecast = Forecast::of(Series {
        id: left(40),
        warn_um: 30.0,
        limit_um: 50.0,
        points: faster,
    });
    let trend = forecast.trend.unwrap();
    assert!(
        (trend.rate_um - 0.06).abs() < 0.006,
        "the line since the change: {forecast:?}"
    );
}

#[test]
fn remaining_cycles_without_wandering_have_a_closed_form() {
    let way = Passage {
        distance_um: [20.0, 2.0],
        rate_um: [0.1, 0.0],
        wander_um: 0.0,
    };
    for (probability, z) in [(0.05, -1.644_854), (0.5, 0.0), (0.95, 1.644_854)] {
        let expected = (20.0 + 2.0 * z) / 0.1;
        let got = way.quantile(probability).unwrap();
        assert!(
            (got - expected).abs() < 0.05,
            "{probability}: {got} {expected}"
        );
    }
    // A rate that is hardly known: less is left with 5 % than the mean says.
    let unsure = Passage {
        rate_um: [0.1, 0.03],
        ..way
    };
    assert!(unsure.quantile(0.05).unwrap() < 140.0);
    // Nothing wears: no end in sight. Past the limit: nothing is left.
    let healthy = Passage {
        rate_um: [-0.01, 1e-3],
        ..way
    };
    assert_eq!(healthy.quantile(0.05), None);
    let past = Passage {
        distance_um: [-10.0, 1.0],
        ..way
    };
    assert_eq!(past.quantile(0.05), Some(0.0));
}

#[test]
fn remaining_cycles_agree_with_simulated_wear() {
    let way = Passage {
        distance_um: [10.0, 1.0],
        rate_um: [0.05, 0.015],
        wander_um: 0.4,
    };
    let mut random = Pcg64::seed_from_u64(4);
    let (paths, steps) = (40_000, 60);
    for cycles in [60.0, 150.0, 400.0] {
        let step: f64 = cycles / f64::from(steps);
        let spread = way.wander_um * step.sqrt();
        let passed = (0..paths)
            .filter(|_| {
                let mut left = way.distance_um[0] + way.distance_um[1] * normal(&mut random);
                let rate = way.rate_um[0] + way.rate_um[1] * normal(&mut random);
                (0..steps).any(|_| {
                    let before = left;
                    left -= rate * step + spread * normal(&mut random);
                    // Between two points a Brownian bridge touches the limit with this probability.
                    let touched = (-2.0 * before * left / (spread * spread)).exp();
                    before <= 0.0 || left <= 0.0 || random.random::<f64>() < touched
                })
            })
            .count() as f64
            / f64::from(paths);
        let sigma = (passed * (1.0 - passed) / f64::from(paths)).sqrt();
        let computed = way.probability(cycles);
        assert!(
            (computed - passed).abs() < 4.0 * sigma,
            "{cycles}: {computed} {passed} ± {sigma}"
        );
    }
}

#[test]
fn wandering_is_told_from_scatter() {
    let mut random = Pcg64::seed_from_u64(5);
    let mut walk = 0.0;
    let figures = points(2000, 4.0, |cycles| {
        walk += 0.2 * 2.0 * normal(&mut random);
        0.02 * cycles + walk + 0.5 * normal(&mut random)
    });
    let trend = Trend::of(&figures).unwrap();
    let wander = Passage::new(&trend, &figures[1000..], 0.1, 1e4).wander_um;
    // Four stretches of independent wandering at the longer lag: the estimate's own spread is about a third.
    assert!((0.1..0.35).contains(&wander), "{wander}");
    let calm = points(200, 4.0, |cycles| 0.02 * cycles);
    let trend = Trend::of(&calm).unwrap();
    assert!(Passage::new(&trend, &calm, 0.1, 1e4).wander_um < 1e-6);
}

#[test]
fn a_series_is_of_one_life_of_the_tool_and_of_one_baseline() {
    let check = |id, cycles, baseline: Option<&str>, verdict: Word, code: Option<Code>| Check {
        id,
        at: String::new(),
        tool: "die".into(),
        tool_cycles: cycles,
        press_cycles: cycles,
        baseline: baseline.map(str::to_owned),
        verdict,
        reason: String::new(),
        origin: Origin {
            link: "sim".into(),
            simulated: true,
            head: HeadId {
                name: "head".into(),
                blake3: String::new(),
                seal: "unsigned".into(),
            },
            station: "press 7".into(),
            operator: None,
            recording: None,
        },
        serial: None,
        flanks: vec![FlankRow {
            id: left(7),
            wear_um: Some(cycles as f64),
            u95_um: Some(1.96),
            warn_um: 30.0,
            limit_um: 50.0,
            verdict,
            code,
        }],
    };
    let checks = [
        check(1, 900, None, Word::NoGo, None),
        check(2, 0, None, Word::Go, None), // another die
        check(3, 10, Some("a"), Word::Go, None),
        check(4, 20, None, Word::Go, None),
        check(5, 30, None, Word::Indeterminate, Some(Code::Undecidable)),
        check(6, 40, None, Word::Indeterminate, Some(Code::Coverage)),
        check(7, 50, None, Word::Go, None),
    ];
    let found = series(&checks);
    assert_eq!(found.len(), 1);
    let used: Vec<i64> = found[0].points.iter().map(|p| p.check).collect();
    assert_eq!(used, [2, 4, 5, 7]);
    assert!((found[0].points[1].u_um - 1.0).abs() < 1e-12);
    assert!(series(&[]).is_empty());
}
