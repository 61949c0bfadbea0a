//! Turn of a view about the axis against one-sided wear of all teeth: both look alike to a registration.
//!
//! A motion along the circumference by t (as change of wear on the judged tooth's left flank) adds t to the wear of every left
//! flank and takes it from every right one. The sum of both sides does not depend on it, the difference does, and no point of
//! the view says which t is right. Material may be worn away, but it may also flow or stick: no sign of a change is presumed. What
//! is weighed are five explanations of what the flanks in view read:
//!
//! | explanation | its weight | what knows t |
//! |---|---|---|
//! | both sides are sound | 1 | the flanks of both sides |
//! | all left flanks changed by one amount, the right ones are sound | 0.15 | the right flanks |
//! | all right flanks changed by one amount, the left ones are sound | 0.15 | the left flanks |
//! | both sides changed, each by an amount of its own | 0.5 | the stages |
//! | both sides changed by equal and opposite amounts | 0.02 | the stages |
//!
//! Every amount of either sign within [`CHANGE_MM`] is as likely as any other. With every explanation single flanks may be off
//! the rest of their side by any amount: one worn tooth among sound neighbours does not move the pose. The stages' word (normal,
//! with their stated uncertainty; in a difference to a baseline with the same mount, that of both approaches alone) counts with
//! all of them. So flanks that are sound pin t to about the uncertainty of their form, and where left and right flanks cannot
//! both be sound the stages decide how much of their difference is on either side.
//!
//! Two assumptions remain: amounts of two sides that have nothing to do with each other do not cancel to within the form of the
//! flanks, and equal and opposite amounts are rare. Such a change is not told from a turn but by the stages; it is held for one
//! where they contradict it by about two standard uncertainties. Smaller ones are seen with a datum that does not change alone
//! (`inspect.datum_height_mm`).
//!
//! The density of t that follows may have several peaks. What is stated is its expectation, and a standard uncertainty so wide
//! that the coverage intervals for one-sided 95 % and two-sided 95 % reach the quantiles of the density on either side.

use std::f64::consts::SQRT_2;

use flankscope_foundation::normal::{COVERAGE_95, guard_factor};
use flankscope_foundation::order::midpoint_median;
use serde::{Deserialize, Serialize};

use super::mount::MountPose;
use crate::gear::Flank;

/// Standard uncertainty of a pose that only the flanks determine, as wear, mm: wider than any wear of a usable gear, narrow enough for
/// integration steps below a micrometre.
pub const ANY_POSE_MM: f64 = 0.1;

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
    /// Change of its wear by a motion that adds 1 to that of the judged tooth's left flank and takes 1 from its right one.
    pub per_turn: f64,
}

/// Evidence of one view about its own pose's turn about the axis.
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
    /// Change of the wear of both sides alike if the pose were that of the stages, mm.
    pub stages_both_mm: f64,
    /// Standard uncertainty of that, mm.
    pub both_sigma_mm: f64,
    /// Mounting of die and head; none where the lands were not seen well enough.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<MountPose>,
    /// Pose by the mounting of the baseline; none where the mounting is another one.
    #[serde(skip)]
    pub same_mount: Option<SameMount>,
}

/// Pose that a view would have in the mounting of its baseline.
#[derive(Debug, Clone, PartialEq)]
pub struct SameMount {
    /// The t that would bring the view's pose there, by the approaches of the stages, for each drift of the mounting.
    pub stages: Vec<Statement>,
    /// Probability that it is another mounting.
    pub remounted: f64,
    /// Change of the wear of both sides alike if the pose were there, mm.
    pub both_mm: f64,
}

/// Knowledge of t with this probability: a normal distribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statement {
    /// Probability of the statement.
    pub probability: f64,
    /// Expected t, mm.
    pub at_mm: f64,
    /// Its standard uncertainty, mm.
    pub sigma_mm: f64,
}

impl Statement {
    fn certain(at_mm: f64, sigma_mm: f64) -> Self {
        Self {
            probability: 1.0,
            at_mm,
            sigma_mm,
        }
    }

    /// Expectation of t by all of them, and its standard uncertainty, mm.
    fn together(statements: &[Self]) -> (f64, f64) {
        let (mut whole, mut sum_mm, mut squares) = (0.0, 0.0, 0.0);
        for statement in statements {
            whole += statement.probability;
            sum_mm += statement.probability * statement.at_mm;
        }
        let mean_mm = sum_mm / whole;
        for statement in statements {
            let off_mm = statement.at_mm - mean_mm;
            squares += statement.probability * (statement.sigma_mm.powi(2) + off_mm * off_mm);
        }
        (mean_mm, (squares / whole).sqrt())
    }
}

/// Standard uncertainties of the stages by which a sound datum is off them with a probability of 1 %, either of both ways counted.
const STAGES_CONTRADICT: f64 = 2.8;

/// Standard uncertainties of the stages at which they overrule flanks that look sound.
const STAGES_OVERRULE: f64 = 2.0;

/// Equal and opposite changes of both sides of all teeth that may add to a local loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OppositeChange {
    /// The flank's largest loss with them, mm.
    pub together_mm: f64,
    /// The stages contradict the pose in that direction by more than two standard uncertainties.
    pub is_seen: bool,
}

/// Estimate of t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Expected t, mm.
    pub mean_mm: f64,
    /// Its standard uncertainty, mm.
    pub u_mm: f64,
    /// Mean of the median wear of the left and of the right flanks in view, mm: no turn changes it, and a change of all flanks
    /// alike is as large, of either sign, where no more than half of a side changed by something else.
    pub both_sides_mm: f64,
    /// Largest change of all flanks alike that the pose may hide, by the stages' positions, mm (standard uncertainty).
    pub both_hidden_mm: f64,
    /// Difference between the t of the stages and the mean, mm.
    pub from_stages_mm: f64,
    /// Standard uncertainty of the t of the stages, mm.
    pub stages_sigma_mm: f64,
    /// Median wear of the left and of the right flanks in view as read, mm; infinite where none is in view.
    pub levels_mm: [f64; 2],
}

impl Turn {
    /// Mean turn of several captures, each in its own pose; its uncertainty is that of the worst of them,
    /// since they share die, mount and the form of the flanks.
    pub(super) fn of_all(turns: impl Iterator<Item = Self>) -> Self {
        let (mut count, mut sum, mut worst) = (0.0, 0.0, [0.0_f64; 2]);
        let mut both_sides_mm = 0.0;
        let (mut from_stages_mm, mut stages_sigma_mm, mut levels_mm) = (0.0, 0.0_f64, [0.0; 2]);
        for turn in turns {
            count += 1.0;
            sum += turn.mean_mm;
            from_stages_mm += turn.from_stages_mm;
            stages_sigma_mm = stages_sigma_mm.max(turn.stages_sigma_mm);
            for (level, of) in levels_mm.iter_mut().zip(turn.levels_mm) {
                *level += of;
            }
            // NaN stays NaN.
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
            from_stages_mm: from_stages_mm / count,
            stages_sigma_mm,
            levels_mm: levels_mm.map(|sum| sum / count),
        }
    }

    /// Largest loss that this flank may have if both sides of all teeth changed by equal and opposite amounts beside a local loss, mm:
    /// what the stages say, and `sigmas` of their standard uncertainties more. `depth_mm` is its wear depth as read, `u95_mm` the expanded
    /// uncertainty of that. None without a local loss: a die that shows none has rarely changed so, it is presumed.
    pub(super) fn with_opposite_mm(
        &self,
        flank: Flank,
        [depth_mm, u95_mm]: [f64; 2],
        sigmas: f64,
    ) -> Option<OppositeChange> {
        let level_mm = match flank {
            Flank::Left => self.levels_mm[0],
            Flank::Right => self.levels_mm[1],
            Flank::Face => return None,
        };
        let stages_mm = flank.sign() * self.from_stages_mm;
        let opposite_mm = stages_mm + sigmas * self.stages_sigma_mm;
        (depth_mm - level_mm > u95_mm).then(|| OppositeChange {
            together_mm: depth_mm + flank.sign() * self.mean_mm + opposite_mm.max(0.0),
            is_seen: stages_mm > STAGES_OVERRULE * self.stages_sigma_mm,
        })
    }
}

/// Points of the numerical integral, and how many standard deviations of stages and form it spans.
const STEPS: usize = 2_000;
const SPAN: f64 = 6.0;
/// Largest change of a flank or of a side that is thought possible, mm: four times a usual stop limit.
const CHANGE_MM: f64 = 0.2;
/// Prior share of flanks whose wear differs from the rest of their side.
const SINGLE_SHARE: f64 = 0.1;
/// Weights of the explanations, relative to that both sides are sound: one given side changed, both changed each by its own
/// amount, both by equal and opposite amounts. The first two and either side together are about as likely as a sound die; the
/// last one lets the stages overrule sound-looking flanks where they are two standard uncertainties off. Chosen by simulation
/// (this file's tests, with other seeds): sound dies keep their go, and of every family at most one in twenty passes a limit.
const ONE_SIDE: f64 = 0.15;
const BOTH_SIDES: f64 = 0.5;
const OPPOSITE: f64 = 0.02;
/// Least standard uncertainty of a flank's median, mm: noise, and its effect on the fit.
const LEAST_FORM_MM: f64 = 0.5e-3;

impl PoseEvidence {
    /// The same flank in this view.
    fn seen(&self, flank: &SeenFlank) -> Option<&SeenFlank> {
        let is_it = |seen: &&SeenFlank| (seen.tooth, seen.flank) == (flank.tooth, flank.flank);
        self.flanks.iter().find(is_it)
    }

    /// The flanks with their wear since `before`, of those that both saw.
    fn since(&self, before: Option<&Self>) -> Vec<SeenFlank> {
        let Some(before) = before else {
            return self.flanks.clone();
        };
        self.flanks
            .iter()
            .filter_map(|now| {
                let then = before.seen(now)?;
                Some(SeenFlank {
                    median_mm: now.median_mm - then.median_mm,
                    ..*now
                })
            })
            .collect()
    }

    /// Estimate of t when every flank's form is known to `form_mm` (standard uncertainty); since `before`, where that is
    /// given. `absolute_form_mm` is to what the form is known without a baseline.
    pub fn turn(&self, before: Option<&Self>, form_mm: f64, absolute_form_mm: f64) -> Turn {
        let flanks = self.since(before);
        let any_mount = |then: [f64; 2]| {
            let sigma_mm = self.approach_sigma_mm.hypot(self.mount_sigma_mm);
            Statement::certain(self.stages_mm - then[0], sigma_mm.hypot(then[1]))
        };
        let (stages, both_hidden_mm) = match before {
            None => {
                let both_hidden_mm = self.stages_both_mm.hypot(self.both_sigma_mm);
                (vec![any_mount([0.0; 2])], both_hidden_mm)
            }
            Some(before) => {
                // The stages' position now is compared with the pose by the flanks then.
                let then = before.turn(None, absolute_form_mm, absolute_form_mm);
                let mut other = any_mount([then.mean_mm, then.u_mm]);
                match &self.same_mount {
                    // A turn moves both sides in opposite directions, so that in the same mounting only the form is left in doubt.
                    Some(same) => {
                        other.probability = same.remounted;
                        let stages = [same.stages.as_slice(), &[other]].concat();
                        (stages, same.both_mm.hypot(SQRT_2 * form_mm))
                    }
                    None => {
                        let both_mm = self.stages_both_mm - before.stages_both_mm;
                        (vec![other], both_mm.hypot(self.both_sigma_mm))
                    }
                }
            }
        };
        let (mean_mm, u_mm) = posterior(&flanks, &stages, form_mm);
        let same = self.same_mount.as_ref().filter(|_| before.is_some());
        let (stages_mm, sigma_mm) = Statement::together(same.map_or(&stages, |same| &same.stages));
        let level_mm = |side: Flank| {
            let of_side = flanks.iter().filter(|f| f.flank == side);
            let mut mm: Vec<f64> = of_side.map(|f| f.median_mm).collect();
            midpoint_median(&mut mm).unwrap_or(f64::INFINITY)
        };
        let levels_mm = Flank::BOTH.map(level_mm);
        Turn {
            mean_mm,
            u_mm,
            both_sides_mm: 0.5 * (levels_mm[0] + levels_mm[1]),
            both_hidden_mm,
            from_stages_mm: stages_mm - mean_mm,
            stages_sigma_mm: sigma_mm,
            levels_mm,
        }
    }

    /// Estimate of t from the flanks that a view of the same moment shows as well, whose t is known; their form is seen at other places of
    /// the field and known to `form_mm` (standard uncertainty). None where both views have no flank in common.
    pub(super) fn beside(&self, other: &Self, known: &Turn, form_mm: f64) -> Option<Turn> {
        let turned = self.flanks.iter().filter_map(|now| {
            let shown = other.seen(now)?;
            let wear_mm = shown.median_mm + shown.per_turn * known.mean_mm;
            Some((wear_mm - now.median_mm) / now.per_turn)
        });
        let mut turned: Vec<f64> = turned.collect();
        Some(Turn {
            mean_mm: midpoint_median(&mut turned)?,
            u_mm: known.u_mm.hypot(form_mm),
            ..*known
        })
    }

    /// Loss that a datum hides by its own wear, mm. The pose that rests on it is compared with the stages, as wear of both sides alike and as
    /// wear of one side that the other one gained. Differences beyond [`STAGES_CONTRADICT`] standard uncertainties count in full.
    pub(super) fn datum_hides_mm(&self) -> f64 {
        let turned_sigma_mm = self.approach_sigma_mm.hypot(self.mount_sigma_mm);
        let contradicted =
            |off_mm: f64, sigma_mm: f64| match off_mm.abs() <= STAGES_CONTRADICT * sigma_mm {
                true => 0.0,
                false => off_mm.abs(),
            };
        contradicted(self.stages_both_mm, self.both_sigma_mm)
            + contradicted(self.stages_mm, turned_sigma_mm)
    }
}

/// Expectation of t and its standard uncertainty, mm: from the flanks in view, what the stages say, and the standard uncertainty of a
/// flank's form.
fn posterior(flanks: &[SeenFlank], stages: &[Statement], form_mm: f64) -> (f64, f64) {
    let form_mm = form_mm.max(LEAST_FORM_MM);
    let (mut low_mm, mut high_mm) = (f64::INFINITY, f64::NEG_INFINITY);
    for Statement {
        at_mm, sigma_mm, ..
    } in stages
    {
        low_mm = low_mm.min(at_mm - SPAN * sigma_mm);
        high_mm = high_mm.max(at_mm + SPAN * sigma_mm);
    }
    for flank in flanks {
        let sound_mm = -flank.median_mm / flank.per_turn;
        low_mm = low_mm.min(sound_mm - SPAN * form_mm);
        high_mm = high_mm.max(sound_mm + SPAN * form_mm);
    }
    let step_mm = (high_mm - low_mm) / STEPS as f64;
    let t_mm = |i: usize| low_mm + step_mm * i as f64;
    let form_mm = form_mm.max(step_mm);
    // Density of any amount of change.
    let any = 0.5 / CHANGE_MM;
    // Likelihood of each side by t, if but for single flanks it is sound; every explanation is linear in it, so its scale is free.
    let side = |side: Flank| -> Vec<f64> {
        let of_side = || flanks.iter().filter(|f| f.flank == side);
        let log = |i: usize| -> f64 {
            let of_flank = |f: &SeenFlank| {
                let off = (f.median_mm + f.per_turn * t_mm(i)) / form_mm;
                let sound = (-0.5 * off * off).exp() / (form_mm * std::f64::consts::TAU.sqrt());
                ((1.0 - SINGLE_SHARE) * sound + SINGLE_SHARE * any).ln()
            };
            of_side().map(of_flank).sum()
        };
        let logs: Vec<f64> = (0..=STEPS).map(log).collect();
        let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logs.iter().map(|log| (log - highest).exp()).collect()
    };
    let [left, right] = Flank::BOTH.map(side);
    let sound: Vec<f64> = left.iter().zip(&right).map(|(l, r)| l * r).collect();
    // The same if it changed by any amount: the mean over all t within the largest change.
    let reach = (CHANGE_MM / step_mm) as usize;
    let changed = |likelihood: &[f64]| -> Vec<f64> {
        let mut sums = vec![0.0; STEPS + 2];
        for (i, density) in likelihood.iter().enumerate() {
            sums[i + 1] = sums[i] + any * step_mm * density;
        }
        let over = |i: usize| sums[(i + reach).min(STEPS) + 1] - sums[i.saturating_sub(reach)];
        (0..=STEPS).map(over).collect()
    };
    let [left_any, right_any, opposite] = [&left, &right, &sound].map(|of| changed(of));
    let density: Vec<f64> = (0..=STEPS)
        .map(|i| {
            let of_flanks = sound[i]
                + ONE_SIDE * (left_any[i] * right[i] + left[i] * right_any[i])
                + BOTH_SIDES * left_any[i] * right_any[i]
                + OPPOSITE * opposite[i];
            let of_stages = stages.iter().map(|stated| {
                let sigma_mm = stated.sigma_mm.max(step_mm);
                let off = (t_mm(i) - stated.at_mm) / sigma_mm;
                stated.probability / sigma_mm * (-0.5 * off * off).exp()
            });
            of_flanks * of_stages.sum::<f64>()
        })
        .collect();
    let whole: f64 = density.iter().sum();
    let mean = density.iter().enumerate().map(|(i, d)| d * t_mm(i));
    let mean_mm = mean.sum::<f64>() / whole;
    if !mean_mm.is_finite() {
        return (f64::NAN, f64::NAN);
    }
    let quantile_mm = |probability: f64| {
        let mut below = 0.0;
        for (i, d) in density.iter().enumerate() {
            let rest = probability * whole - below;
            if *d >= rest {
                return t_mm(i) + step_mm * (rest / d - 0.5);
            }
            below += d;
        }
        high_mm
    };
    let u_mm = [(0.95, guard_factor(0.95)), (0.5 + 0.5 * 0.95, COVERAGE_95)]
        .into_iter()
        .flat_map(|(probability, factor)| {
            [quantile_mm(probability), quantile_mm(1.0 - probability)]
                .map(|quantile| (quantile - mean_mm).abs() / factor)
        })
        .fold(0.0, f64::max);
    (mean_mm, u_mm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::{Rule, Word, decide};
    use crate::wear::DETECTION_FACTOR;
    use flankscope_foundation::random::{normal, uniform};

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
            mount: None,
            same_mount: None,
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
            for sign in [1.0, -1.0] {
                let turn =
                    view([sign * worn; 2], [0.0; 2], turned, 4e-3).turn(None, FORM_MM, FORM_MM);
                let off = turn.mean_mm - turned;
                assert!(off.abs() < 2.0 * turn.u_mm, "{turned}: {turn:?}");
                assert!(
                    (0.5 * STAGES_MM..1.5 * STAGES_MM).contains(&turn.u_mm),
                    "{turn:?}"
                );
                assert!((turn.both_sides_mm - 0.5 * sign * worn).abs() < 1e-12);
            }
        }
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
        // The part of the difference between both poses that is no wear.
        assert!(
            (turn.mean_mm - 0.01).abs() < 3.0 * turn.u_mm && turn.u_mm < 2.0 * FORM_MM,
            "{turn:?}"
        );
    }

    /// Since a baseline of a sound die: in its mounting, or in another one.
    fn in_mount(same_mount: Option<SameMount>, worn_mm: [f64; 2]) -> Turn {
        let mounted = PoseEvidence {
            mount_sigma_mm: 3.0 * STAGES_MM,
            ..view([0.0; 2], [0.0; 2], 0.0, 0.0)
        };
        let now = PoseEvidence {
            flanks: view([worn_mm[0]; 2], [worn_mm[1]; 2], 0.0, 0.0).flanks,
            same_mount,
            ..mounted.clone()
        };
        now.turn(Some(&mounted), FORM_MM, 4.0 * FORM_MM)
    }

    /// The pose is where the baseline's mounting puts it, but for the approaches.
    fn same() -> SameMount {
        SameMount {
            stages: vec![Statement {
                probability: 0.995,
                ..Statement::certain(0.0, 1e-3)
            }],
            remounted: 0.005,
            both_mm: 0.0,
        }
    }

    #[test]
    fn one_side_is_known_as_well_as_the_stages_repeat_in_the_mounting_of_the_baseline() {
        let kept = in_mount(Some(same()), [0.055, 0.0]);
        assert!(
            kept.mean_mm.abs() < 2.0 * kept.u_mm && kept.u_mm < 2e-3,
            "{kept:?}"
        );
        let other = in_mount(None, [0.055, 0.0]);
        assert!(other.u_mm > STAGES_MM, "{other:?}");
    }

    /// A die that only turned is not believed to have worn on one side and grown on the other as the stages alone would say; both remain
    /// possible.
    #[test]
    fn die_that_came_back_turned_about_its_axis_is_not_held_for_worn() {
        for turned_mm in [-20e-3, -7e-3, 7e-3, 20e-3] {
            let turn = in_mount(Some(same()), [-turned_mm, turned_mm]);
            let believed = turn.mean_mm / turned_mm;
            assert!((0.4..1.0).contains(&believed), "{turned_mm}: {turn:?}");
            for possible_mm in [0.0, turned_mm] {
                let off_mm = (turn.mean_mm - possible_mm).abs();
                assert!(off_mm < COVERAGE_95 * turn.u_mm, "{turned_mm}: {turn:?}");
            }
        }
        // A die that did not turn, worn on both sides, on one or not at all.
        for worn_mm in [[0.04, 0.04], [0.06, 0.02], [0.02, 0.0], [0.0, 0.0]] {
            let turn = in_mount(Some(same()), worn_mm);
            assert!(
                turn.mean_mm.abs() < 2.0 * turn.u_mm && turn.u_mm < 2e-3,
                "{worn_mm:?}: {turn:?}"
            );
        }
    }

    #[test]
    fn change_of_both_sides_may_hide_less_in_the_mounting_of_the_baseline() {
        let hidden_mm = |same| in_mount(same, [0.03; 2]).both_hidden_mm;
        assert!((hidden_mm(Some(same())) - SQRT_2 * FORM_MM).abs() < 1e-12);
        let moved = SameMount {
            both_mm: 5e-3,
            ..same()
        };
        assert!(hidden_mm(Some(moved)) > 5e-3);
        assert!(hidden_mm(None) >= view([0.0; 2], [0.0; 2], 0.0, 0.0).both_sigma_mm);
    }

    #[test]
    fn a_further_view_of_the_same_flanks_takes_over_what_the_main_one_knows() {
        let main = view([0.055; 2], [0.02; 2], 0.0, 0.0);
        let known = Turn {
            u_mm: 1e-3,
            ..main.turn(None, FORM_MM, FORM_MM)
        };
        for turned_mm in [-0.02, 0.0, 0.03] {
            let further = view([0.055; 2], [0.02; 2], turned_mm, 0.0);
            let beside = further
                .beside(&main, &known, FORM_MM)
                .expect("flanks of both");
            let off_mm = beside.mean_mm - known.mean_mm - turned_mm;
            assert!(off_mm.abs() < 1e-12, "{turned_mm}: {off_mm}");
            assert!((beside.u_mm - known.u_mm.hypot(FORM_MM)).abs() < 1e-12);
        }
        let mut elsewhere = main.clone();
        elsewhere
            .flanks
            .iter_mut()
            .for_each(|flank| flank.tooth = Some(70));
        assert!(elsewhere.beside(&main, &known, FORM_MM).is_none());
    }

    /// Left and right flanks of three teeth, mm: what they lost.
    type Die = [[f64; 3]; 2];

    /// Verdicts on the judged flanks of a family of dies, the middle ones: number of flanks, how many were go, and how
    /// many were beyond a limit and passed, by the warning limit (go) or the stop limit (go or warn).
    #[derive(Default)]
    struct Passed {
        flanks: f64,
        go: f64,
        beyond: [f64; 2],
        passed: [f64; 2],
    }

    /// Many dies of a family, each seen in a pose of its own by stages that are off by as much as they state (standard
    /// uncertainties of stages and form, mm).
    fn judged(
        die: impl Fn(u64) -> Die,
        [stages_mm, form_mm]: [f64; 2],
        (seed, draws): (u64, u64),
    ) -> Passed {
        let rule = Rule::new(30.0, 50.0);
        let mut passed = Passed::default();
        for draw in 0..draws {
            let die = die(draw);
            let n = |k: u64| normal(seed, 100 * draw + k);
            let (turned_mm, off_mm) = (0.02 * n(0), stages_mm * n(1));
            let seen = |(side, tooth): (usize, usize)| {
                let flank = Flank::BOTH[side];
                SeenFlank {
                    tooth: Some(39 + tooth as u32),
                    flank,
                    median_mm: die[side][tooth] - flank.sign() * turned_mm
                        + form_mm * n(2 + 3 * side as u64 + tooth as u64),
                    per_turn: flank.sign(),
                }
            };
            let places = (0..2).flat_map(|side| (0..3).map(move |tooth| (side, tooth)));
            let evidence = PoseEvidence {
                flanks: places.map(seen).collect(),
                stages_mm: turned_mm + off_mm,
                approach_sigma_mm: stages_mm,
                ..view([0.0; 2], [0.0; 2], 0.0, 0.0)
            };
            let turn = evidence.turn(None, form_mm, form_mm);
            for (side, flank) in Flank::BOTH.into_iter().enumerate() {
                let mm = seen((side, 1)).median_mm + flank.sign() * turn.mean_mm;
                let u_um = 1e3 * turn.u_mm.hypot(form_mm);
                let detects = DETECTION_FACTOR * u_um < rule.warn_um;
                let words = [mm, -mm].map(|mm| decide(1e3 * mm, u_um, &rule).word());
                let go = detects && words == [Word::Go; 2];
                let warn = detects && words.contains(&Word::Warn) && !words.contains(&Word::NoGo);
                let warn = warn && !words.contains(&Word::Indeterminate);
                passed.flanks += 1.0;
                passed.go += f64::from(go);
                let truth_um = 1e3 * die[side][1].abs();
                for (k, limit_um) in [rule.warn_um, rule.limit_um].into_iter().enumerate() {
                    if truth_um > limit_um {
                        passed.beyond[k] += 1.0;
                        passed.passed[k] += f64::from(go || (k == 1 && warn));
                    }
                }
            }
        }
        passed
    }

    /// Stages alone, stages since a baseline, stages and form as built, mm (standard uncertainties): the demo die's.
    const KNOWN_MM: [[f64; 2]; 3] = [[14.4e-3, 2e-3], [8.9e-3, 0.5e-3], [14.4e-3, 3.3e-3]];

    #[test]
    fn sound_dies_and_those_with_one_worn_tooth_keep_their_verdict() {
        for known in KNOWN_MM {
            let sound = judged(|_| [[0.0; 3]; 2], known, (1091, 1000));
            assert!(sound.go >= 0.95 * sound.flanks, "{known:?}: {}", sound.go);
            // A neighbour that is worn on both flanks.
            let depth = |draw: u64| 0.1 * uniform(17, draw);
            let beside = |draw| [[depth(draw), 0.0, 0.0]; 2];
            let beside = judged(beside, known, (1092, 1000));
            assert!(
                beside.go >= 0.95 * beside.flanks,
                "{known:?}: {}",
                beside.go
            );
        }
    }

    #[test]
    fn what_is_beyond_a_limit_is_passed_once_in_twenty_at_most_whatever_the_other_side_does() {
        let between = |from: f64, to: f64| {
            move |draw: u64, k: u64| 1e-3 * (from + (to - from) * uniform(23, 100 * draw + k))
        };
        let (worn, any, proud) = (
            between(31.0, 100.0),
            between(-100.0, 100.0),
            between(-40.0, 0.0),
        );
        let families: [(&str, &dyn Fn(u64) -> Die); 10] = [
            ("45 and 20 proud", &|_| [[0.045; 3], [-0.020; 3]]),
            ("65 and 29 proud", &|_| [[0.065; 3], [-0.029; 3]]),
            ("55 and 10 proud", &|_| [[0.055; 3], [-0.010; 3]]),
            ("one side worn", &|i| [[worn(i, 0); 3], [0.0; 3]]),
            ("one side proud", &|i| [[0.0; 3], [-worn(i, 0); 3]]),
            ("one worn, the other proud", &|i| {
                [[worn(i, 0); 3], [proud(i, 1); 3]]
            }),
            ("one worn, the other anything", &|i| {
                [[worn(i, 0); 3], [any(i, 1); 3]]
            }),
            ("every flank its own", &|i| {
                [
                    [worn(i, 0), worn(i, 1), worn(i, 2)],
                    [proud(i, 3), proud(i, 4), proud(i, 5)],
                ]
            }),
            ("two teeth of three", &|i| {
                [
                    [0.0, worn(i, 0), worn(i, 0)],
                    [0.0, proud(i, 1), proud(i, 1)],
                ]
            }),
            ("the judged tooth", &|i| {
                [[0.0, worn(i, 0), 0.0], [0.0, proud(i, 1), 0.0]]
            }),
        ];
        for known in KNOWN_MM {
            for (name, die) in families {
                let of = judged(die, known, (1093, 300));
                for k in 0..2 {
                    assert!(
                        of.passed[k] <= 0.05 * of.beyond[k],
                        "{name}, {known:?}: {} of {}",
                        of.passed[k],
                        of.beyond[k]
                    );
                }
            }
            // Opposite changes, which only the stages tell from a turn: passed no more once both sides are a stop limit off.
            let opposite = |i| [[worn(i, 0) + 0.02; 3], [-worn(i, 0) - 0.02; 3]];
            let of = judged(opposite, known, (1094, 300));
            assert!(
                of.passed[1] <= 0.05 * of.beyond[1],
                "{known:?}: {}",
                of.passed[1]
            );
        }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        let mut evidence = view([0.0; 2], [0.0; 2], 0.0, 0.0);
        evidence.flanks[1].median_mm = f64::NAN;
        let turn = evidence.turn(None, FORM_MM, FORM_MM);
        assert!(turn.mean_mm.is_nan() && turn.u_mm.is_nan(), "{turn:?}");
    }

    #[test]
    fn a_sound_datum_is_held_for_worn_once_in_a_hundred_and_a_worn_one_by_all_that_is_off() {
        let at = |both_mm: f64, turned_mm: f64| PoseEvidence {
            stages_both_mm: both_mm,
            both_sigma_mm: 4e-3,
            stages_mm: turned_mm,
            approach_sigma_mm: 6e-3,
            mount_sigma_mm: 8e-3,
            ..view([0.0; 2], [0.0; 2], 0.0, 0.0)
        };
        const DRAWS: u64 = 40_000;
        let held = |i: &u64| {
            at(4e-3 * normal(77, 2 * i), 10e-3 * normal(77, 2 * i + 1)).datum_hides_mm() > 0.0
        };
        let rate = (0..DRAWS).filter(held).count() as f64 / DRAWS as f64;
        // Beyond 2.8 standard deviations is a normal error with a probability of 0.511 %; four standard deviations of the count.
        let expected = 1.0 - (1.0 - 5.11e-3_f64).powi(2);
        let chance = 4.0 * (expected / DRAWS as f64).sqrt();
        assert!((rate - expected).abs() < chance, "{rate} {expected}");
        assert_eq!(at(20e-3, 0.0).datum_hides_mm(), 20e-3);
        assert_eq!(at(0.0, -40e-3).datum_hides_mm(), 40e-3);
        assert!(at(f64::NAN, 0.0).datum_hides_mm().is_nan());
    }

    /// The die lost 51 µm in all, part of it locally and part as equal and opposite changes that the pose took for a turn.
    #[test]
    fn local_loss_and_an_opposite_change_pass_only_where_the_stages_err_by_more_than_one_sigma() {
        const LIMIT_MM: f64 = 50e-3;
        for local_mm in [10e-3, 20e-3, 28e-3] {
            const DRAWS: u64 = 4000;
            let passes = |i: &u64| {
                let turn = Turn {
                    mean_mm: 0.0,
                    u_mm: 1e-3,
                    both_sides_mm: 0.0,
                    both_hidden_mm: 0.0,
                    from_stages_mm: 51e-3 - local_mm + STAGES_MM * normal(5, *i),
                    stages_sigma_mm: STAGES_MM,
                    levels_mm: [0.0; 2],
                };
                let together = turn.with_opposite_mm(Flank::Left, [local_mm, 4e-3], 1.0);
                together.expect("a local loss").together_mm <= LIMIT_MM
            };
            let rate = (0..DRAWS).filter(passes).count() as f64 / DRAWS as f64;
            // A normal error below -1 standard deviation has a probability of 15.9 %.
            assert!(
                rate < 0.159 + 4.0 * (0.159 / DRAWS as f64).sqrt(),
                "{local_mm}: {rate}"
            );
            assert!(rate > 0.05, "{local_mm}: {rate}");
        }
        let level = Turn {
            levels_mm: [20e-3, 0.0],
            ..Turn::of_all(std::iter::once(
                view([0.0; 2], [0.0; 2], 0.0, 0.0).turn(None, FORM_MM, FORM_MM),
            ))
        };
        // Wear of the whole side does not count as local.
        assert_eq!(
            level.with_opposite_mm(Flank::Left, [22e-3, 4e-3], 1.0),
            None
        );
    }
}
