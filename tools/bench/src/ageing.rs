//! Progress of the die's wear while the press runs.

use crate::world::{MAX_DEPTH_UM, Wear};

/// Damage at the start, and the increment per press cycle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ageing {
    /// Damage before the first cycle.
    pub initial: Vec<Wear>,
    /// Damage per cycle.
    pub per_cycle: Vec<Wear>,
}

impl Ageing {
    /// The damage after a number of cycles, limited to the greatest depth of the model.
    #[must_use]
    pub fn after(&self, cycles: u32) -> Vec<Wear> {
        let mut wear = self.initial.clone();
        for rate in &self.per_cycle {
            let grown_mm = rate.depth_mm * f64::from(cycles);
            let same = |one: &&mut Wear| {
                (one.tooth, one.flank, one.kind) == (rate.tooth, rate.flank, rate.kind)
            };
            match wear.iter_mut().find(same) {
                Some(one) => one.depth_mm += grown_mm,
                None => wear.push(Wear {
                    depth_mm: grown_mm,
                    ..*rate
                }),
            }
        }
        for one in &mut wear {
            one.depth_mm = one.depth_mm.min(MAX_DEPTH_UM * 1e-3);
        }
        wear
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_add_up_on_the_flank_they_wear() {
        let parse = |text: &str| text.parse::<Wear>().unwrap();
        let ageing = Ageing {
            initial: vec![parse("40:left:10"), parse("12:right:5:pit")],
            per_cycle: vec![parse("40:left:0.5"), parse("68:left:2")],
        };
        assert_eq!(ageing.after(0)[..2], ageing.initial[..]);
        let worn = ageing.after(20);
        let depth_um = |i: usize| (worn[i].depth_mm * 1e3 * 1e6).round() / 1e6;
        assert_eq!([depth_um(0), depth_um(1), depth_um(2)], [20.0, 5.0, 40.0]);
        assert_eq!(ageing.after(100_000)[2].depth_mm, MAX_DEPTH_UM * 1e-3);
    }
}
