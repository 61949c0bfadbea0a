//! Check of tooth numbers: views of a few teeth each against those that a baseline recorded.
//!
//! In a scan of all teeth, [`super::tooth_identity`] correlates patterns around the bore. A check sees three teeth of some
//! views: of each flank its median deviation, then and now. Less the median of its side in its view, which takes off what the pose
//! adds to all flanks of a side, the medians are the die's own pattern. Compared are the flanks of a view with what was recorded
//! of the same teeth, and with what was recorded of the teeth one or several further.

use crate::gear::Flank;
use crate::wear::PoseEvidence;

use flankscope_foundation::order::median_of;

/// Probability of chance agreement below which an agreement is significant.
const CHANCE: f64 = 1e-2;
/// The recorded teeth do not explain the view when they are off by so many standard uncertainties (root mean square) ...
const FAR_SIGMAS: f64 = 3.0;
/// ... and others do when they are off by no more than so many.
const NEAR_SIGMAS: f64 = 1.5;

/// Result of the comparison: tooth numbers confirmed, shifted, or not determined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Seen {
    /// These are the recorded teeth.
    Same,
    /// The view of a tooth shows what was recorded of the tooth so many further.
    Turned(i64),
    /// The forms cannot tell.
    NotTold,
}

/// Agreement of views with the recorded ones at one shift of the tooth numbers.
#[derive(Debug, Clone, Copy)]
struct Agreement {
    /// Sum of squared differences, mm², and of the recorded deviations.
    differences: f64,
    recorded: f64,
    freedom: f64,
}

impl Agreement {
    fn rms_mm(self) -> f64 {
        (self.differences / self.freedom).sqrt()
    }

    /// Bound of the probability that unrelated patterns of the recorded size agree as well: of chi-square below its mean
    /// (Chernoff).
    fn chance(self) -> f64 {
        let unrelated = 2.0 * self.recorded / self.freedom;
        let part = self.differences / (self.freedom * unrelated);
        if part < 1.0 {
            (part * (1.0 - part).exp()).powf(0.5 * self.freedom)
        } else {
            1.0
        }
    }
}

/// Compares views with the recorded ones of a gear with so many teeth. `sigma_mm` is the standard uncertainty of the difference
/// of one flank's two medians, seen at the same place of the field and at another one.
pub fn compare(
    teeth: u32,
    recorded: &[PoseEvidence],
    now: &[PoseEvidence],
    sigma_mm: [f64; 2],
) -> Seen {
    let half = i64::from(teeth) / 2;
    let of = |turned| agreement(teeth, recorded, now, turned);
    let same = of(0);
    if let Some(same) = same
        && same.rms_mm() <= NEAR_SIGMAS * sigma_mm[0]
        && same.chance() < CHANCE
    {
        return Seen::Same;
    }
    if same.is_some_and(|same| same.rms_mm() <= FAR_SIGMAS * sigma_mm[0]) {
        return Seen::NotTold;
    }
    let others = (-half..=half).filter(|turned| *turned != 0);
    let tried: Vec<(i64, Agreement)> = others
        .filter_map(|turned| Some((turned, of(turned)?)))
        .collect();
    let share = CHANCE / tried.len().max(1) as f64;
    let mut found = tried
        .iter()
        .filter(|(_, other)| other.rms_mm() <= NEAR_SIGMAS * sigma_mm[1] && other.chance() < share);
    match (found.next(), found.next()) {
        (Some((turned, _)), None) => Seen::Turned(*turned),
        _ => Seen::NotTold,
    }
}

fn agreement(
    teeth: u32,
    recorded: &[PoseEvidence],
    now: &[PoseEvidence],
    turned: i64,
) -> Option<Agreement> {
    let mut all = Agreement {
        differences: 0.0,
        recorded: 0.0,
        freedom: 0.0,
    };
    let count = i64::from(teeth);
    for view in now {
        for then in recorded {
            for side in Flank::BOTH {
                let pairs: Vec<[f64; 2]> = view
                    .flanks
                    .iter()
                    .filter(|flank| flank.flank == side && flank.median_mm.is_finite())
                    .filter_map(|flank| {
                        let shown = (i64::from(flank.tooth?) - 1 + turned).rem_euclid(count) + 1;
                        let of_tooth = |other: &&crate::wear::SeenFlank| {
                            other.flank == side && other.tooth.map(i64::from) == Some(shown)
                        };
                        let before = then.flanks.iter().find(of_tooth)?;
                        Some([flank.median_mm, before.median_mm])
                    })
                    .collect();
                if pairs.len() < 2 || (turned == 0 && view.tooth != then.tooth) {
                    continue;
                }
                all.differences += squares(pairs.iter().map(|[now, then]| now - then));
                all.recorded += squares(pairs.iter().map(|[_, then]| *then));
                all.freedom += pairs.len() as f64 - 1.0;
            }
        }
    }
    (all.freedom > 0.0).then_some(all)
}

/// Sum of squares about the median.
fn squares(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let middle = median_of(values.clone()).unwrap_or(f64::NAN);
    values.map(|value| (value - middle).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wear::SeenFlank;
    use flankscope_foundation::random::normal;

    const SIGMA_MM: [f64; 2] = [0.7e-3, 1.2e-3];

    /// Views of three teeth, each with both neighbours: a die whose flanks are off by `form_mm`, put down `turned` teeth further.
    fn views(
        seed: u64,
        turned: u32,
        form_mm: f64,
        lost_mm: impl Fn(u32) -> f64,
    ) -> Vec<PoseEvidence> {
        let view = |tooth: u32| {
            let flank = |other: u32, flank: Flank| {
                let of_die = (other - 1 + turned) % 84 + 1;
                let side = u64::from(flank == Flank::Right);
                let own = form_mm * normal(7, u64::from(2 * of_die) + side);
                let noise = 0.3e-3 * normal(seed, u64::from(2 * other) + side);
                SeenFlank {
                    tooth: Some(other),
                    flank,
                    // The pose's turn.
                    median_mm: own + noise + lost_mm(of_die) + 5e-3 * flank.sign(),
                    per_turn: flank.sign(),
                }
            };
            PoseEvidence {
                tooth: Some(tooth),
                flanks: (tooth - 1..=tooth + 1)
                    .flat_map(|other| Flank::BOTH.map(|side| flank(other, side)))
                    .collect(),
                stages_mm: 0.0,
                approach_sigma_mm: 1e-3,
                mount_sigma_mm: 1e-3,
                stages_both_mm: 0.0,
                both_sigma_mm: 1e-3,
                mount: None,
                same_mount: None,
            }
        };
        [12, 40, 68].map(view).into()
    }

    #[test]
    fn forms_say_whether_a_die_was_put_down_as_it_was() {
        let new = |form_mm| views(1, 0, form_mm, |_| 0.0);
        for (turned, told) in [
            (0, Seen::Same),
            (1, Seen::Turned(1)),
            (83, Seen::Turned(-1)),
        ] {
            let now = views(2, turned, 5e-3, |_| 0.0);
            assert_eq!(compare(84, &new(5e-3), &now, SIGMA_MM), told, "{turned}");
        }
        // As drawn all teeth are alike; turned by seven teeth it shows what nobody recorded.
        for (turned, form_mm) in [(0, 0.0), (1, 0.0), (7, 5e-3)] {
            let now = views(2, turned, form_mm, |_| 0.0);
            assert_eq!(
                compare(84, &new(form_mm), &now, SIGMA_MM),
                Seen::NotTold,
                "{turned}"
            );
        }
        // Wear of every tooth by amounts of its own is no turn, on a hundred dies.
        for seed in 0..100 {
            let lost = |tooth| 20e-3 * normal(100 + seed, u64::from(tooth)).abs();
            let now = views(seed, 0, 5e-3, lost);
            assert_eq!(
                compare(84, &new(5e-3), &now, SIGMA_MM),
                Seen::NotTold,
                "{seed}"
            );
        }
    }
}
