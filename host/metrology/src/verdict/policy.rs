//! Rules over verdicts: several combined, one withheld for a reason, and figures too near to a limit to decide.

use super::{Reason, Verdict, Word};

/// Verdict on a figure whose guard band holds the limit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Undecided {
    /// Nothing is said.
    #[default]
    Indeterminate,
    /// No-go: a figure that is not proven good counts as bad.
    NoGo,
}

/// The tool's verdict from its features': one no-go is enough; then one indeterminate; then one warning. Without features
/// there is nothing to say. Of several alike it is the first.
pub fn combine(features: impl IntoIterator<Item = Verdict>) -> Verdict {
    let mut worst: Option<Verdict> = None;
    for verdict in features {
        if worst.as_ref().is_none_or(|w| verdict.word() > w.word()) {
            worst = Some(verdict);
        }
    }
    worst.unwrap_or(Verdict::Indeterminate {
        reason: Reason::NoFeatures,
    })
}

impl Word {
    /// The verdict withheld for a reason: the capture stopped early, something was not seen, the result
    /// could not be stored. Damage that was found stays found; everything else is indeterminate.
    #[must_use]
    pub fn withheld(self) -> Self {
        match self {
            Self::NoGo => Self::NoGo,
            Self::Go | Self::Warn | Self::Indeterminate => Self::Indeterminate,
        }
    }
}

impl Verdict {
    /// The same for a verdict. What was indeterminate before keeps its reason.
    #[must_use]
    pub fn withheld(self, why: &Reason) -> Self {
        if self.word().passes() {
            Self::Indeterminate {
                reason: why.clone(),
            }
        } else {
            self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unsure() -> Verdict {
        Verdict::Indeterminate {
            reason: Reason::NoFeatures,
        }
    }

    #[test]
    fn the_worst_feature_decides() {
        assert_eq!(combine([]), unsure());
        assert_eq!(combine([Verdict::Go, Verdict::Warn]), Verdict::Warn);
        assert_eq!(combine([Verdict::Warn, unsure(), Verdict::Go]), unsure());
        assert_eq!(
            combine([unsure(), Verdict::NoGo, Verdict::Go]),
            Verdict::NoGo
        );
        let first = Verdict::Indeterminate {
            reason: Reason::TipUnseen,
        };
        assert_eq!(combine([first.clone(), unsure()]), first);
    }

    #[test]
    fn nothing_that_is_withheld_passes_and_damage_stays_found() {
        for verdict in [Verdict::Go, Verdict::Warn, Verdict::NoGo, unsure()] {
            let word = verdict.word();
            let left = verdict.clone().withheld(&Reason::TipUnseen);
            assert_eq!(left.word(), word.withheld());
            assert!(!left.word().passes(), "{word}");
            assert_eq!(left == Verdict::NoGo, verdict == Verdict::NoGo, "{word}");
            let kept = if word.passes() {
                Reason::TipUnseen
            } else {
                Reason::NoFeatures
            };
            assert!(left.reason().is_none_or(|reason| *reason == kept));
        }
    }
}
