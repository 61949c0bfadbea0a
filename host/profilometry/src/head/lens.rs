//! The liquid lens that sets the focus of a head, and its driver's counts.

use flankscope_foundation::textfile::{self, BadValue};
use serde::{Deserialize, Serialize};

/// Largest count that a driver of ten bits takes.
const COUNTS_MAX: u16 = 1023;
/// Longest that a lens may take to come to rest.
const SETTLE_MAX_MS: u32 = 2_000;

/// Driver of a head's focus. Both liquid lenses, in front of camera and projector, are on one driver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LensDrive {
    /// Driver counts at zero optical power, usually not an integer.
    pub zero_counts: f64,
    /// Power gained per count.
    pub dpt_per_count: f64,
    /// Counts between which the head is driven: least and most.
    pub range: [u16; 2],
    /// From the voltage to rest.
    pub settle_ms: u32,
    /// Driver counts while this head measures.
    pub counts: u16,
}

impl LensDrive {
    /// Power that counts give.
    #[must_use]
    pub fn power_dpt(&self, counts: u16) -> f64 {
        let dpt = (f64::from(counts) - self.zero_counts) * self.dpt_per_count;
        // A file states it: without what a product of decimals leaves in the sixteenth place.
        (1e6 * dpt).round() / 1e6
    }

    /// Power that it is driven to.
    #[must_use]
    pub fn setting_dpt(&self) -> f64 {
        self.power_dpt(self.counts)
    }

    /// The same lens, driven to the counts nearest to a power.
    ///
    /// # Errors
    /// A power that is none, or beyond the range.
    pub fn driven_to(&self, power_dpt: f64) -> Result<Self, BadValue> {
        let counts = (self.zero_counts + power_dpt / self.dpt_per_count).round();
        let [least, most] = self.range;
        // Written so that a NaN fails.
        if !(counts >= f64::from(least) && counts <= f64::from(most)) {
            let [one, other] = self.range.map(|counts| self.power_dpt(counts));
            return Err(BadValue::new(
                "focus",
                power_dpt,
                format!("must be {:.2} to {:.2} dpt", one.min(other), one.max(other)),
            ));
        }
        Ok(Self {
            counts: counts as u16,
            ..*self
        })
    }

    #[rustfmt::skip]
    pub(super) fn check(&self) -> Result<(), BadValue> {
        let [least, most] = self.range;
        textfile::require(&[
            ((0.0..=f64::from(COUNTS_MAX)).contains(&self.zero_counts), "lens.zero_counts", &self.zero_counts, "must be 0 to 1023"),
            ((1e-4..=1.0).contains(&self.dpt_per_count.abs()), "lens.dpt_per_count", &self.dpt_per_count, "must be 0.0001 to 1 dpt, up or down"),
            (least < most && most <= COUNTS_MAX, "lens.range", &self.range, "must be two counts of at most 1023, the lesser first"),
            ((least..=most).contains(&self.counts), "lens.counts", &self.counts, "must be within lens.range"),
            (self.settle_ms <= SETTLE_MAX_MS, "lens.settle_ms", &self.settle_ms, "must be at most 2000"),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: LensDrive = LensDrive {
        zero_counts: 516.5,
        dpt_per_count: -0.04,
        range: [416, 616],
        settle_ms: 150,
        counts: 516,
    };

    #[test]
    fn a_power_is_driven_by_the_nearest_counts_within_the_range() {
        let counts = |dpt| LENS.driven_to(dpt).map(|lens| lens.counts);
        assert_eq!(counts(1.0).ok(), Some(492)); // 491.5, away from zero
        assert_eq!(counts(-3.98).ok(), Some(616));
        for dpt in -350..=350 {
            let dpt = f64::from(dpt) / 100.0;
            let off = LENS.driven_to(dpt).unwrap().setting_dpt() - dpt;
            assert!(off.abs() <= 0.02 + 1e-9, "{dpt}: {off}");
        }
        for beyond in [4.1, -4.1, f64::NAN, f64::INFINITY] {
            let words = LENS.driven_to(beyond).unwrap_err().expected;
            assert_eq!(words, "must be -3.98 to 4.02 dpt");
        }
    }

    #[test]
    fn what_drives_no_lens_is_refused_by_its_key() {
        assert!(LENS.check().is_ok());
        let refused = |change: fn(&mut LensDrive)| {
            let mut lens = LENS;
            change(&mut lens);
            lens.check().unwrap_err().key
        };
        assert_eq!(refused(|l| l.zero_counts = f64::NAN), "lens.zero_counts");
        assert_eq!(refused(|l| l.dpt_per_count = 0.0), "lens.dpt_per_count");
        assert_eq!(
            refused(|l| l.dpt_per_count = f64::NAN),
            "lens.dpt_per_count"
        );
        assert_eq!(refused(|l| l.range = [616, 416]), "lens.range");
        assert_eq!(refused(|l| l.range = [416, 1024]), "lens.range");
        assert_eq!(refused(|l| l.counts = 617), "lens.counts");
        assert_eq!(refused(|l| l.settle_ms = 2001), "lens.settle_ms");
    }
}
