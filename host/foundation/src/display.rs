//! Figures in sentences.

use std::fmt;

/// A figure in a sentence: what is no finite number is said in words.
#[derive(Clone, Copy, Debug)]
pub struct Number(pub f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_finite() {
            fmt::Display::fmt(&self.0, f)
        } else {
            f.write_str("(no number)")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_told_as_they_are_and_others_in_words() {
        assert_eq!(format!("{:.1} {}", Number(1.25), Number(50.0)), "1.2 50");
        assert_eq!(format!("{:.1}", Number(f64::NAN)), "(no number)");
        assert_eq!(format!("{}", Number(f64::NEG_INFINITY)), "(no number)");
    }
}
