//! What a pose cannot tell from wear: a turn of the whole view, or one side of all teeth worn.
//!
//! A motion along the circumference by t (as change of wear on the judged tooth's left flank) adds t to the wear of every left
//! flank and takes it from every right one. The sum of both sides does not depend on it, the difference does, and no point of
//! the view says which t is right. Three things are known:
//!
//! * material does not grow: whatever t is, no flank in view has less than no wear, as far as its form is known;
//! * where the stages say that the head is, with their uncertainty;
//! * in a difference to a baseline, what the same flanks and the same stages showed then.
//!
//! The density of t is therefore that of the stages (normal), times for every flank the probability that its true wear is not
//! negative. Flanks without wear on both sides pin t to about the uncertainty of one flank's form; with one side worn by d,
//! all t up to d are possible and only the stages' word is left. Every amount of wear is as likely as any other.

use flankscope_foundation::normal::log_probability_below;
use serde::{Deserialize, Serialize};

use crate::gear::Flank;

/// A flank in view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeenFlank {
    /// Tooth, from 1; none of what stands for a side of all teeth.
    pub tooth: Option<u32>,
    /// Side.
    pub flank: Flank,
    /// Median wear over what was seen of it in the judged radii and heights, mm.
    pub median_mm: f64,
    /// What a motion that adds 1 to the judged tooth's left flank and takes 1 from its right one adds to it.
    pub per_turn: f64,
}

/// What one view says of its own pose about the axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseEvidence {
    /// Tooth that is judged, in the middle of the view; none where all are.
    pub tooth: Option<u32>,
    /// All flanks in view.
    pub flanks: Vec<SeenFlank>,
    /// The t that would bring the pose to where the stages say it is, mm.
    pub stages_mm: f64,
    /// Standard uncertainty of that by what is drawn anew with every approach of the stages, mm.
    pub approach_sigma_mm: f64,
    /// Standard uncertainty of that by how head and die are mounted, mm: the same as long as neither is taken out.
    pub mount_sigma_mm: f64,
    /// What bringing the pose to where the stages say would add to the wear of both sides alike, mm.
    pub stages_both_mm: f64,
    /// Standard uncertainty of that, mm.
    pub both_sigma_mm: f64,
    /// Where the mount puts the pose, as far as the view fixes it and no stage moves it: towards the axis, and both tilts over
    /// the view's height, mm.
    pub mount_mm: [f64; 3],
}

/// A mount counts as the same when it agrees within so many standard uncertainties of the flanks' form in both captures.
const SAME_MOUNT: f64 = 3.0 * std::f64::consts::SQRT_2;

/// What is known of t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Expected t, mm.
    pub mean_mm: f64,
    /// Its standard uncertainty, mm.
    pub u_mm: f64,
    /// Mean of the least worn left and right flank in view, mm: no turn changes it, and all flanks alike have lost no more.
    pub both_sides_mm: f64,
    /// What wear of all flanks alike can at most be hidden by the pose, mm (standard uncertainty): by what the stages say.
    pub both_hidden_mm: f64,
}

impl Turn {
    /// What points of several captures, each in its own pose, must be turned by in the mean; as uncertain as the worst of them,
    /// since they share die, mount and the form of the flanks.
    pub(super) fn of_all(turns: impl Iterator<Item = Self>) -> Self {
        let (mut count, mut sum, mut worst) = (0.0, 0.0, [0.0_f64; 2]);
        let mut both_sides_mm = 0.0;
        for turn in turns {
            count += 1.0;
            sum += turn.mean_mm;
            // A figure that is no number stays one.
            for (worst, of) in worst.iter_mut().zip([turn.u_mm, turn.both_hidden_mm]) {
                if of > *worst || of.is_nan() {
                    *worst = of;
                }
            }
            if turn.both_sides_mm.abs() > f64::abs(both_sides_mm) || turn.both_sides_mm.is_nan() {
                both_sides_mm = turn.both_sides_mm;
            }
        }
        Self {
            mean_mm: sum / count,
            u_mm: worst[0],
            both_sides_mm,
            both_hidden_mm: worst[1],
        }
    }
}

/// Points of the numerical integral, and how many standard deviations of the stages it spans.
const STEPS: usize = 2_000;
const SPAN: f64 = 6.0;
/// Where even the best t leaves the flanks together less likely than one flank three standard deviations proud, some are
/// proud in truth (stuck material, another form): they say nothing of t then.
const LEAST_LIKELIHOOD: f64 = -4.5;

impl PoseEvidence {
    /// The flanks with their wear since `before`, of those that both saw.
    fn since(&self, before: Option<&Self>) -> Vec<SeenFlank> {
        let Some(before) = before else {
            return self.flanks.clone();
        };
        self.flanks
            .iter()
            .filter_map(|now| {
                let then = before
                    .flanks
                    .iter()
                    .find(|then| (then.tooth, then.flank) == (now.tooth, now.flank))?;
                Some(SeenFlank {
                    median_mm: now.median_mm - then.median_mm,
                    ..*now
                })
            })
            .collect()
    }

    /// What is known of t when every flank's form is known to `form_mm` (standard uncertainty); since `before`, where that is
    /// given. `absolute_form_mm` is to what the form is known without a baseline.
    pub fn turn(&self, before: Option<&Self>, form_mm: f64, absolute_form_mm: f64) -> Turn {
        let flanks = self.since(before);
        let here_mm = self.approach_sigma_mm.hypot(self.mount_sigma_mm);
        let (stages_mm, sigma_mm, both_mm) = match before {
            None => (self.stages_mm, here_mm, self.stages_both_mm),
            Some(before) => {
                let stays = (0..3)
                    .all(|k| (self.mount_mm[k] - before.mount_mm[k]).abs() <= SAME_MOUNT * form_mm);
                let both_mm = self.stages_both_mm - before.stages_both_mm;
                if stays {
                    let sigma_mm = self.approach_sigma_mm.hypot(before.approach_sigma_mm);
                    (self.stages_mm - before.stages_mm, sigma_mm, both_mm)
                } else {
                    // What the stages say now stands against what the flanks said of the pose then.
                    let then = before.turn(None, absolute_form_mm, absolute_form_mm);
                    (
                        self.stages_mm - then.mean_mm,
                        here_mm.hypot(then.u_mm),
                        both_mm,
                    )
                }
            }
        };
        let neighbours: Vec<SeenFlank> = flanks
            .iter()
            .filter(|flank| flank.tooth.is_none() || flank.tooth != self.tooth)
            .copied()
            .collect();
        let found = [&flanks, &neighbours]
            .into_iter()
            .find_map(|flanks| posterior(flanks, [stages_mm, sigma_mm], form_mm));
        let (mean_mm, u_mm) = found.unwrap_or((stages_mm, sigma_mm));
        // Wear of all flanks alike is on every one of them: the least worn of each side bounds it.
        let least = |side: Flank| {
            flanks
                .iter()
                .filter(|f| f.flank == side)
                .map(|f| f.median_mm)
                .fold(f64::INFINITY, f64::min)
        };
        Turn {
            mean_mm,
            u_mm,
            both_sides_mm: 0.5 * (least(Flank::Left) + least(Flank::Right)),
            both_hidden_mm: both_mm.hypot(self.both_sigma_mm),
        }
    }
}

/// Mean and standard deviation of t; none when the flanks contradict each other.
fn posterior(
    flanks: &[SeenFlank],
    [at_mm, sigma_mm]: [f64; 2],
    form_mm: f64,
) -> Option<(f64, f64)> {
    // Flanks that pin t far from the stages' word must be within the span, too.
    let widest = flanks.iter().map(|f| f.median_mm.abs()).fold(0.0, f64::max);
    let reach_mm = SPAN * sigma_mm + widest + SPAN * form_mm;
    let form_mm = form_mm.max(reach_mm / STEPS as f64);
    let mut terms: Vec<(f64, f64)> = Vec::with_capacity(2 * STEPS + 1);
    let mut best_of_flanks = f64::NEG_INFINITY;
    for i in 0..=2 * STEPS {
        let t = at_mm + reach_mm * (i as f64 / STEPS as f64 - 1.0);
        let of_flanks: f64 = flanks
            .iter()
            .map(|f| log_probability_below((f.median_mm + f.per_turn * t) / form_mm))
            .sum();
        best_of_flanks = best_of_flanks.max(of_flanks);
        terms.push((t, of_flanks - 0.5 * ((t - at_mm) / sigma_mm).powi(2)));
    }
    // A flank without wear is not negative with probability one half: that is no contradiction.
    let unworn = -std::f64::consts::LN_2 * flanks.len() as f64;
    if best_of_flanks.is_nan() || best_of_flanks < unworn + LEAST_LIKELIHOOD {
        return None;
    }
    let highest = terms.iter().map(|t| t.1).fold(f64::NEG_INFINITY, f64::max);
    let (mut whole, mut first, mut second) = (0.0, 0.0, 0.0);
    for (t, log) in terms {
        let density = (log - highest).exp();
        let away = t - at_mm;
        whole += density;
        first += density * away;
        second += density * away * away;
    }
    let mean = first / whole;
    let variance = (second / whole - mean * mean).max(0.0);
    Some((at_mm + mean, variance.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORM_MM: f64 = 0.5e-3;
    const STAGES_MM: f64 = 9e-3;

    /// Two neighbours and the judged tooth 40, laid on CAD by a pose that is off by `turned_mm`.
    fn view(
        left_mm: [f64; 2],
        right_mm: [f64; 2],
        turned_mm: f64,
        stages_error_mm: f64,
    ) -> PoseEvidence {
        let flank = |tooth, flank: Flank, wear: f64| SeenFlank {
            tooth: Some(tooth),
            flank,
            median_mm: wear - flank.sign() * turned_mm,
            per_turn: flank.sign(),
        };
        PoseEvidence {
            tooth: Some(40),
            flanks: vec![
                flank(39, Flank::Left, left_mm[0]),
                flank(40, Flank::Left, left_mm[1]),
                flank(40, Flank::Right, right_mm[0]),
                flank(41, Flank::Right, right_mm[1]),
            ],
            stages_mm: turned_mm + stages_error_mm,
            approach_sigma_mm: STAGES_MM,
            mount_sigma_mm: 0.0,
            stages_both_mm: 0.0,
            both_sigma_mm: 3e-3,
            mount_mm: [0.0; 3],
        }
    }

    #[test]
    fn sound_flanks_pin_the_pose_and_one_worn_tooth_does_not_move_it() {
        for (left, right) in [
            ([0.0, 0.0], [0.0, 0.0]),
            ([0.0, 0.08], [0.0, 0.0]),
            ([0.0, 0.2], [0.0, 0.0]),
            ([0.08, 0.0], [0.0, 0.0]), // the neighbour is the worn one
        ] {
            // Whatever resting place the fit has found.
            for turned in [0.0, 0.027, -0.04] {
                let turn = view(left, right, turned, 5e-3).turn(None, FORM_MM, FORM_MM);
                assert!(
                    (turn.mean_mm - turned).abs() < 3.0 * turn.u_mm && turn.u_mm < 2.0 * FORM_MM,
                    "{left:?} {right:?} {turned}: {turn:?}"
                );
            }
        }
    }

    #[test]
    fn one_side_of_all_teeth_is_known_to_what_the_stages_say() {
        let worn = 0.055;
        for turned in [0.0, 0.0275, 0.055] {
            let turn = view([worn; 2], [0.0; 2], turned, 4e-3).turn(None, FORM_MM, FORM_MM);
            let off = turn.mean_mm - turned;
            assert!(off.abs() < 2.0 * turn.u_mm, "{turned}: {turn:?}");
            // All between no turn and all of it is possible; the stages leave about their own sigma.
            assert!(
                (0.3 * STAGES_MM..1.1 * STAGES_MM).contains(&turn.u_mm),
                "{turn:?}"
            );
            assert!((turn.both_sides_mm - 0.5 * worn).abs() < 1e-12);
        }
        // Small wear of one side cannot hide much.
        let small = view([2e-3; 2], [0.0; 2], 0.0, 4e-3).turn(None, FORM_MM, FORM_MM);
        assert!(small.u_mm < 1.2e-3, "{small:?}");
    }

    #[test]
    fn a_wholly_proud_flank_does_not_turn_the_view() {
        let turn = view([0.0, -0.08], [0.0, 0.0], 0.0, 5e-3).turn(None, FORM_MM, FORM_MM);
        assert!(turn.mean_mm.abs() < 3.0 * FORM_MM, "{turn:?}");
    }

    #[test]
    fn what_was_there_before_is_taken_off() {
        // As built, 20 um off on every left flank; the new die's pose had found another resting place.
        let before = view([0.02; 2], [0.0; 2], 0.01, -3e-3);
        let now = view([0.02; 2], [0.0; 2], 0.02, 2e-3);
        let turn = now.turn(Some(&before), FORM_MM, 4.0 * FORM_MM);
        // What is to be undone of the difference between both poses.
        assert!(
            (turn.mean_mm - 0.01).abs() < 3.0 * turn.u_mm && turn.u_mm < 2.0 * FORM_MM,
            "{turn:?}"
        );
    }

    #[test]
    fn a_mount_that_changed_counts_again() {
        let mounted = |mount_mm| PoseEvidence {
            mount_sigma_mm: 3.0 * STAGES_MM,
            mount_mm,
            ..view([0.055; 2], [0.0; 2], 0.0, 0.0)
        };
        let new = PoseEvidence {
            mount_sigma_mm: 3.0 * STAGES_MM,
            ..view([0.0; 2], [0.0; 2], 0.0, 0.0)
        };
        let [same, other] = [[1e-3, 0.0, 0.0], [0.0, 0.01, 0.0]]
            .map(|mount| mounted(mount).turn(Some(&new), FORM_MM, 4.0 * FORM_MM).u_mm);
        assert!(other > 1.3 * same, "{same} {other}");
    }
}
