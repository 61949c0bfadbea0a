//! How much of what was asked for a scan has measured.

use flankscope_metrology::gear::Flank;
use flankscope_metrology::verdict::{Code, Reason};
use serde::Serialize;

/// Fields that the plan requires: both flanks of every view's middle tooth, over the view's height. A scan applies only to the
/// teeth and heights of its views.
#[derive(Clone, Debug, Serialize)]
pub struct Coverage {
    /// Number of fields.
    pub fields: usize,
    /// Requested teeth that were measured: both flanks, at every requested height.
    pub teeth: usize,
    /// Teeth of the gear.
    pub of_teeth: u32,
    /// Number of requested heights.
    pub heights: usize,
    /// Smallest fraction of a field that must be measured.
    pub least_ratio: f64,
    /// Measured fraction of the field with the smallest coverage.
    pub worst_ratio: f64,
    /// Fields with less coverage than required.
    pub holes: Vec<Hole>,
}

/// A field with too little coverage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hole {
    pub tooth: u32,
    /// Side of the tooth.
    pub flank: Flank,
    /// Height of the view's middle, mm.
    pub vertical_mm: f64,
    /// Fraction that was measured.
    pub seen_ratio: f64,
}

impl Coverage {
    /// The scope of a verdict, in words. `height_ratio` is the judged fraction of these teeth's height, `bore_ratio` the measured
    /// fraction of the bore.
    #[must_use]
    pub fn looked_at(&self, height_ratio: f64, bore_ratio: f64) -> String {
        format!(
            "{} of {} teeth at {} height{} ({} % of their face width), {} % of the bore",
            self.teeth,
            self.of_teeth,
            self.heights,
            if self.heights == 1 { "" } else { "s" },
            percent(height_ratio),
            percent(bore_ratio)
        )
    }

    /// Why the scan cannot be a "go", if so: less was measured than requested.
    pub fn objection(&self) -> Option<Reason> {
        let first = self.holes.first()?;
        let why = format!(
            "{} of {} planned flank fields were seen to less than {:.0} %; the first is tooth {} {} at {:.1} mm with {:.0} %",
            self.holes.len(),
            self.fields,
            100.0 * self.least_ratio,
            first.tooth,
            first.flank,
            first.vertical_mm,
            100.0 * first.seen_ratio,
        );
        Some(Reason::instrument(Code::Unseen, why))
    }
}

/// A fraction in percent; only a complete one is rounded to 100.
#[must_use]
pub fn percent(ratio: f64) -> String {
    let rounded = (1e3 * ratio).round() / 10.0;
    let most = if ratio < 1.0 { 99.9 } else { 100.0 };
    format!("{:.1}", rounded.min(most))
}

#[cfg(test)]
mod tests {
    use super::percent;

    #[test]
    fn only_all_of_it_is_a_hundred_percent() {
        let said = [0.0847, 0.9996, 1.0].map(percent);
        assert_eq!(said, ["8.5", "99.9", "100.0"]);
    }
}
