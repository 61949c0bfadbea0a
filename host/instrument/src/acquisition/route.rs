//! Order in which views are visited: the one that takes least time, the parts of that time, and the time of a single move.
//!
//! Both axes move at once, so a leg takes as long as the slower one ([`StageConfig`] has their dynamics). The order is exact, by
//! Held and Karp's dynamic programme over sets of views (J. SIAM 10, 1962): a million steps for the 16 views that a plan holds.

use std::fmt;
use std::time::Duration;

use flankscope_protocol::{StageConfig, View};

use super::program::{Program, StagePosition, micrometres};

/// Stages come to a stop within this after an abort.
const STOPPING: Duration = Duration::from_millis(300);

/// What an abort may be late on its way through host, line and controller.
const ABORT_LATENCY: Duration = Duration::from_millis(400);

/// A route through all views, from the present position of the stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// Indices of the views in the order of visits.
    pub order: Vec<usize>,
    /// Parts of its time.
    pub time: RouteTime,
}

/// Parts of the time of a check by the configured dynamics, from the first move to the last exposure, s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RouteTime {
    /// Legs on which the rotary axis was the slower one.
    pub rotation_s: f64,
    /// Legs on which the vertical axis was the slower one.
    pub insertion_s: f64,
    /// Settling times after moves.
    pub settling_s: f64,
    /// Frames, with pattern changes and readout.
    pub exposure_s: f64,
}

/// Time that every view takes besides the move to it, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stay {
    settling_s: f64,
    exposure_s: f64,
}

impl RouteTime {
    /// Sum of all parts, s.
    pub fn total_s(&self) -> f64 {
        self.parts().iter().map(|(_, part_s)| part_s).sum()
    }

    /// Name of the largest part.
    pub fn bound(&self) -> &'static str {
        let [first, rest @ ..] = self.parts();
        let largest = rest.into_iter().fold(
            first,
            |most, part| if part.1 > most.1 { part } else { most },
        );
        largest.0
    }

    fn parts(&self) -> [(&'static str, f64); 4] {
        [
            ("rotation", self.rotation_s),
            ("insertion", self.insertion_s),
            ("exposure", self.exposure_s),
            ("settling", self.settling_s),
        ]
    }
}

impl fmt::Display for RouteTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} s: ", self.total_s())?;
        for (name, part_s) in self.parts() {
            write!(f, "{name} {part_s:.1}, ")?;
        }
        write!(f, "bounded by {}", self.bound())
    }
}

/// Time of a leg, µs; between legs of equal time, the smaller rotation is preferred.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Cost {
    time_us: u64,
    turning_us: u64,
}

impl Cost {
    fn and(self, other: Self) -> Self {
        Self {
            time_us: self.time_us + other.time_us,
            turning_us: self.turning_us + other.turning_us,
        }
    }
}

/// Time of both axes, µs: rotary, vertical.
fn axes_us(stage: &StageConfig, from: View, to: View) -> [u64; 2] {
    let turn = stage.rotation.travel_time(from.rotation, to.rotation);
    let lift = stage.vertical.travel_time(from.vertical, to.vertical);
    [turn, lift].map(|time| u64::from(time.get()))
}

fn cost(stage: &StageConfig, from: View, to: View) -> Cost {
    let [turn, lift] = axes_us(stage, from, to);
    Cost {
        time_us: turn.max(lift),
        turning_us: turn,
    }
}

impl Program {
    /// The quickest route through the first `count` views for stages at `start`; at most as many views as a plan holds.
    pub fn quickest_from(&self, start: View, count: usize) -> Route {
        let views = self.positions.iter().take(count);
        let views: Vec<View> = views.map(StagePosition::view).collect();
        let stay = Stay {
            settling_s: self.settling_s(),
            exposure_s: self.exposure_s(),
        };
        quickest(&self.stage, start, &views, stay)
    }

    /// Time to stop and to leave the die from the lowest view.
    pub fn leaving_time(&self) -> Duration {
        let vertical = micrometres(self.retract_mm);
        let ways_us = self.positions.iter().map(|at| {
            let from = at.view();
            let [_, lift_us] = axes_us(&self.stage, from, View { vertical, ..from });
            lift_us
        });
        STOPPING + Duration::from_micros(ways_us.max().unwrap_or(0)) + ABORT_LATENCY
    }

    /// Time to move from one view to another and to settle there.
    pub fn moving_time(&self, from: usize, to: usize) -> Duration {
        let at = |view: usize| self.positions.get(view).map(StagePosition::view);
        let (Some(from), Some(to)) = (at(from), at(to)) else {
            return Duration::ZERO;
        };
        let move_us = cost(&self.stage, from, to).time_us;
        Duration::from_micros(move_us) + Duration::from_secs_f64(self.settling_s())
    }
}

/// The quickest route through `views`.
///
/// At most [`flankscope_protocol::plan::MAX_VIEWS`]: memory and time grow with two to the power of their number.
fn quickest(stage: &StageConfig, start: View, views: &[View], stay: Stay) -> Route {
    let order = quickest_order(stage, start, views);
    let mut time = RouteTime {
        settling_s: stay.settling_s * views.len() as f64,
        exposure_s: stay.exposure_s * views.len() as f64,
        ..RouteTime::default()
    };
    let mut from = start;
    for &view in &order {
        let [turn, lift] = axes_us(stage, from, views[view]);
        let of = if turn >= lift {
            &mut time.rotation_s
        } else {
            &mut time.insertion_s
        };
        *of += turn.max(lift) as f64 / 1e6;
        from = views[view];
    }
    Route { order, time }
}

fn quickest_order(stage: &StageConfig, start: View, views: &[View]) -> Vec<usize> {
    let n = views.len();
    if n == 0 {
        return Vec::new();
    }
    let legs: Vec<Vec<Cost>> = views
        .iter()
        .map(|&from| views.iter().map(|&to| cost(stage, from, to)).collect())
        .collect();
    // Quickest route through a set of views that ends at one of them, and the view before that.
    let mut best: Vec<Option<(Cost, usize)>> = vec![None; n << n];
    for (view, &at) in views.iter().enumerate() {
        best[(1 << view) * n + view] = Some((cost(stage, start, at), view));
    }
    for set in 1_usize..1 << n {
        for last in (0..n).filter(|last| set >> last & 1 == 1) {
            let Some((so_far, _)) = best[set * n + last] else {
                continue;
            };
            for next in (0..n).filter(|next| set >> next & 1 == 0) {
                let there = so_far.and(legs[last][next]);
                let slot = &mut best[(set | 1 << next) * n + next];
                if slot.is_none_or(|(known, _)| there < known) {
                    *slot = Some((there, last));
                }
            }
        }
    }
    let mut set = (1 << n) - 1;
    let ways = (0..n).filter_map(|last| Some((best[set * n + last]?.0, last)));
    let Some((_, mut last)) = ways.min() else {
        return (0..n).collect();
    };
    let mut order = Vec::with_capacity(n);
    while let Some((_, before)) = best[set * n + last] {
        order.push(last);
        set &= !(1 << last);
        if set == 0 {
            break;
        }
        last = before;
    }
    order.reverse();
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const STAY: Stay = Stay {
        settling_s: 0.1,
        exposure_s: 1.2,
    };

    fn deg(angle_deg: f64, vertical_mm: f64) -> View {
        let rotation_rad = angle_deg.to_radians();
        StagePosition {
            rotation_rad,
            vertical_mm,
        }
        .view()
    }

    fn time_us(stage: &StageConfig, start: View, views: &[View], order: &[usize]) -> u64 {
        let mut from = start;
        let mut total = 0;
        for &at in order {
            total += cost(stage, from, views[at]).time_us;
            from = views[at];
        }
        total
    }

    /// All permutations of `n` views (Heap 1963).
    fn every_order(n: usize) -> Vec<Vec<usize>> {
        fn permute(k: usize, order: &mut Vec<usize>, all: &mut Vec<Vec<usize>>) {
            if k <= 1 {
                return all.push(order.clone());
            }
            for i in 0..k {
                permute(k - 1, order, all);
                let with = if k.is_multiple_of(2) { i } else { 0 };
                order.swap(with, k - 1);
            }
        }
        let (mut order, mut all) = ((0..n).collect(), Vec::new());
        permute(n, &mut order, &mut all);
        all
    }

    #[test]
    fn no_order_is_quicker() {
        let mut random = Pcg64Mcg::seed_from_u64(17);
        for round in 0..60 {
            let n = 1 + round % 7;
            let mut stage = StageConfig::DEFAULT;
            stage.rotation.speed.0 = random.random_range(20_000..200_000);
            stage.vertical.speed.0 = random.random_range(10_000..300_000);
            let mut place = || {
                deg(
                    random.random_range(-360.0..360.0),
                    random.random_range(-50.0..100.0),
                )
            };
            let start = place();
            let views: Vec<View> = (0..n).map(|_| place()).collect();
            let found = quickest(&stage, start, &views, STAY);
            let least = every_order(n)
                .iter()
                .map(|order| time_us(&stage, start, &views, order))
                .min();
            assert_eq!(Some(time_us(&stage, start, &views, &found.order)), least);
            let mut sorted = found.order.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..n).collect::<Vec<_>>());
            let motion_us = (found.time.rotation_s + found.time.insertion_s) * 1e6;
            assert!((motion_us - least.unwrap() as f64).abs() < 1.0);
        }
    }

    #[test]
    fn a_full_plan_is_planned_exactly_along_a_line() {
        // Every leg is at least a step of 10 degrees, so no route is shorter than step by step from the near end.
        let views: Vec<View> = (0..16)
            .map(|i| deg(f64::from(i * 7 % 16) * 10.0 - 60.0, 33.0))
            .collect();
        let found = quickest(&StageConfig::DEFAULT, deg(-70.0, 33.0), &views, STAY);
        let angles: Vec<i32> = found
            .order
            .iter()
            .map(|&at| views[at].rotation.get())
            .collect();
        assert!(angles.is_sorted(), "{angles:?}");
    }

    /// Between orders of equal time, the one with less rotation is chosen: the insertion takes longer than the first rotation.
    #[test]
    fn ties_turn_less() {
        let start = deg(3.0, 100.0);
        let views = [deg(-20.0, 33.0), deg(20.0, 33.0)];
        let found = quickest(&StageConfig::DEFAULT, start, &views, STAY);
        assert_eq!(found.order, [1, 0]);
    }

    /// By hand: 67 mm take 0.795 s, 120 deg 1.75 s at 80 deg/s and 0.85 s at 200 deg/s and 1000 deg/s².
    #[test]
    fn three_teeth_anywhere_within_5_s_where_the_axes_allow_it() {
        let start = deg(0.0, 100.0);
        let anywhere = [deg(-120.0, 33.0), deg(0.0, 33.0), deg(120.0, 33.0)];
        let stay = Stay {
            settling_s: 0.05,
            exposure_s: 0.5,
        };
        let slow = quickest(&StageConfig::DEFAULT, start, &anywhere, stay);
        // 1.75 s out, 1.75 s twice back, and 3 x 0.55 s.
        assert!(
            (slow.time.total_s() - (3.0 * 1.75 + 1.65)).abs() < 1e-3,
            "{}",
            slow.time
        );
        assert_eq!(slow.time.bound(), "rotation");
        let mut stage = StageConfig::DEFAULT;
        (stage.rotation.speed.0, stage.rotation.acceleration.0) = (200_000, 1_000_000);
        let quick = quickest(&stage, start, &anywhere, stay);
        // 0.8 s for each of three legs.
        assert!((quick.time.rotation_s - 2.4).abs() < 1e-3, "{}", quick.time);
        assert!(quick.time.total_s() < 5.0);
        let words = quick.time.to_string();
        for said in [
            "rotation 2.4, insertion 0.0, exposure 1.5",
            "bounded by rotation",
        ] {
            assert!(words.contains(said), "{words}");
        }
    }
}
