//! Random damage against the verdict: what is beyond the limit is never passed, what is sound is not refused, whatever the
//! damage's shape and wherever the holes are.
//!
//! A damage is drawn on a flank's zone, its truth found by brute force over all discs of a raster, its points sampled with
//! noise and a calibration error of the stated size, then judged. `FLANKSCOPE_TEST_ALL=1` draws 10 000, else a few thousand.

use std::f64::consts::TAU;

use flankscope_test_requisites::everything;
use rayon::prelude::*;

use super::*;
use crate::gear::Flank;
use crate::verdict::Rule;
use crate::wear::{FlankWear, WearSettings};
use flankscope_foundation::random::{normal, uniform};

/// The zone, mm, and its raster for the truth, mm.
const SIZE_MM: [f64; 2] = [1.7, 3.0];
const RASTER_MM: f64 = 0.02;
/// Points of the 20 mm head on a flank, 1/mm2.
const DENSITY: f64 = 411.0;
/// Stated and real noise of a point, mm: the ripple of the projector's cores is not stated.
const STATED_MM: f64 = 0.35e-3;
const REAL_MM: f64 = 1.2e-3;
const WARN_UM: f64 = 30.0;
const LIMIT_UM: f64 = 50.0;

pub(super) fn limits() -> FlankLimits {
    let rule = Rule::new(WARN_UM, LIMIT_UM);
    let settings = WearSettings::default();
    FlankLimits {
        wear: rule,
        proud: rule,
        cell: Rule::new(2.0 * WARN_UM, 2.0 * LIMIT_UM),
        tip: None,
        least_coverage: 0.8,
        area_mm2: settings.area_mm2,
        hidden_depth_um: 1e3 * settings.hidden_depth_mm,
    }
}

fn settings() -> WearSettings {
    WearSettings {
        cad_mm: 0.0,
        ..WearSettings::default()
    }
}

/// A stream of random numbers.
struct Draw {
    seed: u64,
    next: u64,
}

impl Draw {
    fn new(seed: u64) -> Self {
        Self { seed, next: 0 }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.next += 1;
        low + (high - low) * uniform(self.seed, self.next)
    }

    fn normal(&mut self) -> f64 {
        self.next += 1;
        normal(self.seed ^ 0x00c0_ffee, self.next)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.uniform(0.0, count as f64) as usize).min(count - 1)
    }

    fn place(&mut self) -> [f64; 2] {
        SIZE_MM.map(|size| self.uniform(0.0, size))
    }
}

/// A shape of damage, of no particular depth.
#[derive(Debug, Clone)]
enum Shape {
    /// Beyond a line, with an edge so wide.
    Step {
        at: [f64; 2],
        across: [f64; 2],
        width: f64,
    },
    /// Rising from a line over so long.
    Ramp {
        at: [f64; 2],
        across: [f64; 2],
        length: f64,
    },
    /// Falling off from a line by a length.
    Edge {
        at: [f64; 2],
        across: [f64; 2],
        length: f64,
    },
    /// Round, flat or a bowl.
    Spall {
        at: [f64; 2],
        radius: f64,
        flat: bool,
    },
    /// A groove through a place, so wide and so long.
    Scratch {
        at: [f64; 2],
        across: [f64; 2],
        width: f64,
        length: f64,
    },
    /// A band-limited random field: waves.
    Random(Vec<([f64; 2], f64, f64)>),
    /// Several of them.
    Sum(Vec<(f64, Shape)>),
}

impl Shape {
    fn draw(draw: &mut Draw, kinds: usize) -> Self {
        let (at, angle) = (draw.place(), draw.uniform(0.0, TAU));
        let across = [angle.cos(), angle.sin()];
        match draw.below(kinds) {
            0 => Self::Step {
                at,
                across,
                width: draw.uniform(0.0, 0.3),
            },
            1 => Self::Ramp {
                at,
                across,
                length: draw.uniform(0.2, 4.0),
            },
            2 => Self::Edge {
                at,
                across,
                length: draw.uniform(0.1, 3.0),
            },
            3 => Self::Spall {
                at,
                radius: draw.uniform(0.15, 1.5),
                flat: draw.below(2) == 0,
            },
            4 => Self::Scratch {
                at,
                across,
                width: draw.uniform(0.05, 0.5),
                length: draw.uniform(0.3, 6.0),
            },
            5 => {
                // Correlation lengths from a cell to the zone.
                let length = 0.1 * 30f64.powf(draw.uniform(0.0, 1.0));
                let waves = (0..12).map(|_| {
                    let wave = [draw.normal() / length, draw.normal() / length];
                    (wave, draw.uniform(0.0, TAU), draw.normal())
                });
                Self::Random(waves.collect())
            }
            _ => {
                let count = 2 + draw.below(3);
                let parts = (0..count).map(|_| (draw.uniform(0.1, 1.0), Self::draw(draw, 6)));
                Self::Sum(parts.collect())
            }
        }
    }

    fn at(&self, p: [f64; 2]) -> f64 {
        let beyond = |at: &[f64; 2], across: &[f64; 2]| {
            (p[0] - at[0]) * across[0] + (p[1] - at[1]) * across[1]
        };
        match self {
            Self::Step { at, across, width } => (beyond(at, across) / width + 0.5).clamp(0.0, 1.0),
            Self::Ramp { at, across, length } => (beyond(at, across) / length).clamp(0.0, 1.0),
            Self::Edge { at, across, length } => (-(beyond(at, across).abs()) / length).exp(),
            Self::Spall { at, radius, flat } => {
                let away = (p[0] - at[0]).hypot(p[1] - at[1]) / radius;
                if away >= 1.0 {
                    0.0
                } else if *flat {
                    1.0
                } else {
                    (1.0 - away * away).powi(2)
                }
            }
            Self::Scratch {
                at,
                across,
                width,
                length,
            } => {
                let along = (p[0] - at[0]) * across[1] - (p[1] - at[1]) * across[0];
                f64::from(beyond(at, across).abs() < 0.5 * width && along.abs() < 0.5 * length)
            }
            Self::Random(waves) => waves
                .iter()
                .map(|([x, y], phase, height)| height * (x * p[0] + y * p[1] + phase).cos())
                .sum(),
            Self::Sum(parts) => parts.iter().map(|(part, shape)| part * shape.at(p)).sum(),
        }
    }
}

/// A shape on the raster: what the truth is found from.
struct Raster {
    columns: usize,
    rows: usize,
    depth: Vec<f64>,
}

impl Raster {
    fn from_shape(shape: &Shape) -> Self {
        let [columns, rows] = SIZE_MM.map(|size| (size / RASTER_MM).round() as usize);
        let place = |i: usize, count: usize| {
            (i as f64 + 0.5) * SIZE_MM[usize::from(count == rows)] / count as f64
        };
        let depth = (0..columns * rows)
            .map(|i| shape.at([place(i % columns, columns), place(i / columns, rows)]))
            .collect();
        Self {
            columns,
            rows,
            depth,
        }
    }

    /// The largest mean over any disc in the zone, and its middle; brute force.
    fn largest(&self, area_mm2: f64) -> (f64, [f64; 2]) {
        let mut sums = vec![0.0; (self.columns + 1) * self.rows];
        for row in 0..self.rows {
            for column in 0..self.columns {
                let at = row * (self.columns + 1) + column;
                sums[at + 1] = sums[at] + self.depth[row * self.columns + column];
            }
        }
        let radius = (area_mm2 / std::f64::consts::PI).sqrt() / RASTER_MM;
        let reach = radius.floor() as usize;
        let halves: Vec<usize> = (0..=2 * reach)
            .map(|i| {
                (radius * radius - (i as f64 - reach as f64).powi(2))
                    .max(0.0)
                    .sqrt() as usize
            })
            .collect();
        let count: usize = halves.iter().map(|half| 2 * half + 1).sum();
        let mut best = (f64::NEG_INFINITY, [0.0; 2]);
        for row in reach..self.rows - reach {
            for column in reach..self.columns - reach {
                let sum: f64 = halves
                    .iter()
                    .enumerate()
                    .map(|(i, &half)| {
                        let line = (row + i - reach) * (self.columns + 1) + column;
                        sums[line + half + 1] - sums[line - half]
                    })
                    .sum();
                if sum > best.0 {
                    best = (sum, [column, row].map(|i| (i as f64 + 0.5) * RASTER_MM));
                }
            }
        }
        (best.0 / count as f64, best.1)
    }
}

/// Points on a damage of `scale` times the shape, um; none in the hole.
fn measure(
    draw: &mut Draw,
    damage: impl Fn([f64; 2]) -> f64,
    hole: Option<([f64; 2], f64)>,
) -> FlankWear {
    let pitch = DENSITY.powf(-0.5);
    let offset_mm = settings().calibration_mm * draw.normal();
    let [columns, rows] = SIZE_MM.map(|size| (size / pitch).floor() as usize);
    let mut points = Vec::with_capacity(columns * rows);
    for i in 0..columns * rows {
        let cell = [i % columns, i / columns];
        let at: [f64; 2] = std::array::from_fn(|k| {
            (cell[k] as f64 + draw.uniform(0.0, 1.0)) * SIZE_MM[k] / [columns, rows][k] as f64
        });
        let missing = hole.is_some_and(|(p, radius)| (at[0] - p[0]).hypot(at[1] - p[1]) < radius);
        if !missing {
            let wear_mm = 1e-3 * damage(at) + offset_mm + REAL_MM * draw.normal();
            points.push((at, wear_mm, STATED_MM));
        }
    }
    FlankWear::of_points((40, Flank::Left), SIZE_MM, &points, &settings())
}

/// Number of damages that are drawn.
fn count() -> u64 {
    if everything() { 10_000 } else { 3_000 }
}

/// One damage: its true depth, whether it has a hole, and the decisions with and without the refusal of hidden wear.
struct Case {
    truth_um: f64,
    hole: bool,
    decision: Decision,
    blind: Decision,
    within: bool,
}

fn case(seed: u64) -> Case {
    let mut draw = Draw::new(seed);
    let shape = Shape::draw(&mut draw, 7);
    let raster = Raster::from_shape(&shape);
    let (largest, deepest) = raster.largest(limits().area_mm2);
    let target_um = draw.uniform(0.0, 120.0);
    // A shape that only stands proud cannot be scaled to a loss. Nothing is deeper than half a millimetre: the measuring
    // volume ends, and the tooth.
    let most = raster
        .depth
        .iter()
        .fold(0.0_f64, |most, d| most.max(d.abs()));
    let scale = if largest > 0.0 {
        (target_um / largest).min(500.0 / most)
    } else {
        10.0
    };
    let truth_um = scale * largest;
    let hole = (draw.below(3) == 0).then(|| {
        let at = if draw.below(4) == 0 {
            draw.place()
        } else {
            deepest
        };
        (at, draw.uniform(0.05, 0.6))
    });
    let wear = measure(&mut draw, |p| scale * shape.at(p), hole);
    let with = |refusals| judge_with(&wear, &limits(), refusals);
    Case {
        truth_um,
        hole: hole.is_some(),
        decision: with(Refusals::ALL),
        blind: with(Refusals {
            hidden: false,
            coverage: false,
            ..Refusals::ALL
        }),
        within: wear
            .wear_mm()
            .is_some_and(|mm| (1e3 * mm.value - truth_um).abs() <= 1e3 * mm.u95()),
    }
}

fn refused_by_wear(decision: &Decision) -> bool {
    decision.verdict == Verdict::NoGo && decision.cause.is_some_and(|cause| cause.figure == "wear")
}

#[test]
fn random_damage_is_never_passed_and_sound_flanks_are_not_refused() {
    let cases: Vec<Case> = (0..count()).into_par_iter().map(case).collect();
    let share = |of: &dyn Fn(&Case) -> bool, among: &dyn Fn(&Case) -> bool| {
        let among: Vec<&Case> = cases.iter().filter(|case| among(case)).collect();
        let hits = among.iter().filter(|case| of(case)).count();
        (hits as f64 / among.len() as f64, hits, among.len())
    };
    let beyond_limit = |case: &Case| case.truth_um > LIMIT_UM;
    let beyond_warn = |case: &Case| case.truth_um > WARN_UM;
    let go = |case: &Case| case.decision.verdict == Verdict::Go;
    let passed = |case: &Case| matches!(case.decision.verdict, Verdict::Go | Verdict::Warn);
    let false_go = share(&go, &beyond_limit);
    let false_pass = share(&passed, &beyond_limit);
    let false_go_at_warn = share(&go, &beyond_warn);
    let false_alarm = share(&|case| refused_by_wear(&case.decision), &|case| {
        !beyond_warn(case)
    });
    let whole = |case: &Case| !case.hole;
    let coverage = share(&|case| case.within, &whole);
    let useful = share(&go, &|case| whole(case) && case.truth_um < 15.0);
    println!(
        "{} damages: go beyond limit {false_go:?}, go or warn beyond limit {false_pass:?}, go beyond warn {false_go_at_warn:?}, \
         no-go below warn {false_alarm:?}, U95 holds {coverage:?}, go below 15 um {useful:?}",
        cases.len()
    );
    assert!(false_go.0 <= 0.05 && false_pass.0 <= 0.05 && false_go_at_warn.0 <= 0.05);
    assert!(false_alarm.0 <= 0.01);
    // Edges of damage between points, and the place of a maximum, are all that the stated uncertainty does not know to 95 %.
    assert!(coverage.0 >= 0.9);
    // An instrument that never says go is safe and useless. Single cells and proud material refuse some of these.
    assert!(useful.0 > 0.4);

    // Without the refusal, holes where the damage is deepest let it pass.
    let holed = |case: &Case| case.hole && beyond_limit(case);
    let blind = |case: &Case| matches!(case.blind.verdict, Verdict::Go | Verdict::Warn);
    let (with, without) = (share(&passed, &holed), share(&blind, &holed));
    println!("with holes: passed {with:?}, without the refusal {without:?}");
    assert!(with.0 <= 0.05);
    assert!(without.0 > 0.05);
}

#[test]
fn any_damage_of_the_discs_area_is_found_wherever_it_lies() {
    let radius = (limits().area_mm2 / std::f64::consts::PI).sqrt();
    (0..count() / 10).into_par_iter().for_each(|seed| {
        let mut draw = Draw::new(1 << 40 | seed);
        // Anywhere in the zone, up to its very border.
        let at: [f64; 2] = std::array::from_fn(|k| draw.uniform(radius, SIZE_MM[k] - radius));
        let depth_um = 2.0 * WARN_UM;
        let spot = Shape::Spall {
            at,
            radius,
            flat: true,
        };
        let wear = measure(&mut draw, |p| depth_um * spot.at(p), None);
        let decision = judge(&wear, &limits());
        assert!(
            decision.verdict != Verdict::Go,
            "{at:?}: {decision:?} {:?}",
            wear.judged
        );
        // A disc of the lattice lies within 0.14 of its radius of the damage: it holds 91 % of it at least. Points at the rim
        // are sparse: one part in twenty.
        let read_um = 1e3 * wear.judged.unwrap().raw_mm;
        assert!(read_um > 0.86 * depth_um - 3.0 * 2.0, "{at:?}: {read_um}");
    });
}

/// Damages that earlier versions let pass, each with the right verdict.
#[test]
fn the_shapes_that_once_passed_are_refused() {
    let [_, height] = SIZE_MM;
    let upper = |share: f64| Shape::Step {
        at: [0.0, height * (1.0 - share)],
        across: [0.0, 1.0],
        width: 0.2,
    };
    let shapes = [
        (
            "even",
            Shape::Step {
                at: [0.0, -9.0],
                across: [0.0, 1.0],
                width: 0.2,
            },
        ),
        ("upper half", upper(0.5)),
        ("upper third", upper(1.0 / 3.0)),
        ("upper quarter", upper(0.25)),
        (
            "ramp",
            Shape::Ramp {
                at: [0.0, 0.5 * height],
                across: [0.0, 1.0],
                length: 0.5 * height,
            },
        ),
        (
            "edge",
            Shape::Edge {
                at: [0.0, height],
                across: [0.0, 1.0],
                length: 2.0,
            },
        ),
        (
            "spall",
            Shape::Spall {
                at: [0.85, 1.5],
                radius: 1.05,
                flat: true,
            },
        ),
    ];
    for (name, shape) in shapes {
        let truth = Raster::from_shape(&shape).largest(limits().area_mm2).0;
        for depth_um in [60.0, 200.0] {
            let mut draw = Draw::new(77);
            let wear = measure(&mut draw, |p| depth_um * shape.at(p), None);
            let decision = judge(&wear, &limits());
            let depth_mm = wear.wear_mm().unwrap();
            let (value, u95) = (1e3 * depth_mm.value, 1e3 * depth_mm.u95());
            println!(
                "{name} {depth_um}: {value:.1} ± {u95:.1}, true {:.1}: {}",
                truth * depth_um,
                decision.verdict
            );
            assert!((value - truth * depth_um).abs() <= u95, "{name} {depth_um}");
            let expected: &[Verdict] = if truth * depth_um > LIMIT_UM + 2.0 * u95 {
                &[Verdict::NoGo]
            } else {
                &[Verdict::NoGo, Verdict::Warn]
            };
            let undecidable = matches!(
                decision.verdict,
                Verdict::Indeterminate {
                    reason: Reason::Undecidable { .. }
                }
            );
            let near = truth * depth_um <= LIMIT_UM + 2.0 * u95;
            assert!(
                expected.contains(&decision.verdict) || near && undecidable,
                "{name} {depth_um}: {decision:?}"
            );
        }
    }
    // Half a millimetre deep in one quarter of a millimetre squared: a single cell of old.
    let pit = Shape::Scratch {
        at: [0.85, 1.5],
        across: [1.0, 0.0],
        width: 0.25,
        length: 0.25,
    };
    let wear = measure(&mut Draw::new(5), |p| 500.0 * pit.at(p), None);
    assert_eq!(
        judge(&wear, &limits()).verdict,
        Verdict::NoGo,
        "{:?}",
        wear.judged
    );
}
