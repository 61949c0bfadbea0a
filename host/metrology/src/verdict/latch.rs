//! From a row of verdicts to what stands at the press: no-go stays until somebody acknowledges it, and one good check
//! after a warning does not clear the warning.

use super::Word;

/// Output shown at the press and on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Nothing has been checked since power-up or since an acknowledgement.
    Unchecked,
    /// Wear is within the warning limit.
    Go,
    /// Wear is beyond the warning limit; the press may go on.
    Warn,
    /// Wear is beyond the stop limit, or was: only an acknowledgement clears this.
    NoGo,
    /// The last check could not tell.
    Indeterminate,
}

impl Shown {
    /// Whether the output enables the press.
    #[must_use]
    pub fn is_go(self) -> bool {
        self.verdict().passes()
    }

    /// The word for tables and files.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Unchecked => "unchecked",
            checked => checked.verdict().as_str(),
        }
    }

    /// The output as a verdict: indeterminate before the first check.
    #[must_use]
    pub fn verdict(self) -> Word {
        match self {
            Self::Go => Word::Go,
            Self::Warn => Word::Warn,
            Self::NoGo => Word::NoGo,
            Self::Unchecked | Self::Indeterminate => Word::Indeterminate,
        }
    }
}

/// Good checks in a row that clear a warning.
const GO_TO_CLEAR_WARNING: u32 = 2;
/// Checks in a row without a result that call for maintenance.
const INDETERMINATE_TO_CALL: u32 = 3;

/// The memory between checks.
#[derive(Clone, Debug)]
pub struct Latch {
    shown: Shown,
    warned: bool,
    go_in_row: u32,
    indeterminate_in_row: u32,
}

impl Default for Latch {
    fn default() -> Self {
        Self {
            shown: Shown::Unchecked,
            warned: false,
            go_in_row: 0,
            indeterminate_in_row: 0,
        }
    }
}

impl Latch {
    /// The latch after a pause, from the verdicts since the last acknowledgement: a no-go and a warning are remembered, a
    /// go has to be earned again.
    #[must_use]
    pub fn resumed(verdicts: &[Word]) -> Self {
        let mut latch = Self::default();
        for &verdict in verdicts {
            latch.take(verdict);
        }
        if latch.shown != Shown::NoGo {
            latch.shown = Shown::Unchecked;
        }
        latch
    }

    /// Takes a check's verdict and returns what is shown now.
    pub fn take(&mut self, verdict: Word) -> Shown {
        let in_row = |count: u32, of: Word| if verdict == of { count + 1 } else { 0 };
        self.indeterminate_in_row = in_row(self.indeterminate_in_row, Word::Indeterminate);
        self.go_in_row = in_row(self.go_in_row, Word::Go);
        if verdict == Word::Warn {
            self.warned = true;
        } else if self.go_in_row >= GO_TO_CLEAR_WARNING {
            self.warned = false;
        }
        self.shown = match (self.shown, verdict) {
            (Shown::NoGo, _) | (_, Word::NoGo) => Shown::NoGo,
            (_, Word::Warn) => Shown::Warn,
            (_, Word::Go) if self.warned => Shown::Warn,
            (_, Word::Go) => Shown::Go,
            (_, Word::Indeterminate) => Shown::Indeterminate,
        };
        self.shown
    }

    /// No go was confirmed within the time limit: the same as after a check without a result.
    pub fn expire(&mut self) -> Shown {
        self.take(Word::Indeterminate)
    }

    /// Output at present.
    #[must_use]
    pub fn shown(&self) -> Shown {
        self.shown
    }

    /// Somebody has looked: the next check starts afresh, and until then there is no go.
    pub fn acknowledge(&mut self) {
        *self = Self::default();
    }

    /// Several checks in a row gave no result: the head is soiled, moved or broken.
    #[must_use]
    pub fn needs_maintenance(&self) -> bool {
        self.indeterminate_in_row >= INDETERMINATE_TO_CALL
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VERDICTS: [Word; 4] = Word::ALL;

    /// Every row of up to six verdicts.
    fn rows() -> impl Iterator<Item = Vec<Word>> {
        (0..6_u32).flat_map(|length| {
            (0..4_usize.pow(length)).map(move |code| {
                (0..length)
                    .map(|i| VERDICTS[code / 4_usize.pow(i) % 4])
                    .collect()
            })
        })
    }

    #[test]
    fn the_rules_hold_for_every_row_of_verdicts() {
        for row in rows() {
            let mut latch = Latch::default();
            for &verdict in &row {
                latch.take(verdict);
            }
            let shown = latch.shown();
            let stopped = row.contains(&Word::NoGo);
            assert_eq!(
                stopped,
                shown == Shown::NoGo,
                "{row:?}: no-go stays, and only a no-go makes it"
            );
            if let Some(&last) = row.last().filter(|_| !stopped) {
                assert_eq!(
                    shown.is_go(),
                    last == Word::Go || last == Word::Warn,
                    "{row:?}: without a result there is no go"
                );
                let last_warning = row.iter().rposition(|&v| v == Word::Warn);
                let cleared = last_warning.is_none_or(|at| {
                    row[at + 1..]
                        .windows(2)
                        .any(|pair| pair == [Word::Go, Word::Go])
                });
                assert_eq!(
                    shown == Shown::Go,
                    last == Word::Go && cleared,
                    "{row:?}: two good checks clear a warning"
                );
            }
            let trailing = row
                .iter()
                .rev()
                .take_while(|&&v| v == Word::Indeterminate)
                .count();
            assert_eq!(latch.needs_maintenance(), trailing >= 3, "{row:?}");
            let mut resumed = Latch::resumed(&row);
            assert_eq!(
                resumed.shown() == Shown::NoGo,
                stopped,
                "{row:?}: a no-go outlives a pause"
            );
            assert!(!resumed.shown().is_go(), "{row:?}: a go does not");
            let mut uninterrupted = latch.clone();
            for verdict in VERDICTS {
                assert_eq!(
                    resumed.take(verdict),
                    uninterrupted.take(verdict),
                    "{row:?}, then {verdict}: as if there had been no pause"
                );
            }
            latch.acknowledge();
            assert_eq!(latch.shown(), Shown::Unchecked);
            assert!(!latch.shown().is_go(), "acknowledged is not checked");
        }
    }
}
