//! What a stage says it is: its model, and its serial number behind a comma, as stage controllers have it.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Most characters of a name; what is longer is cut.
const LENGTH: usize = 24;

/// Model and serial number of a stage, such as `URS150BCC, SN0001`; printable ASCII.
///
/// One from the wire may hold any bytes: [`StageName::is_model`] judges it, and it shows none that are not printable.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StageName([u8; LENGTH]);

impl StageName {
    /// Most characters of a model. Shorter than a name, so that no cut name passes for a model.
    pub const LONGEST_MODEL: usize = 20;

    /// The name, cut to its first 24 characters; `None` where it is empty or not printable ASCII.
    #[must_use]
    pub fn of(text: &[u8]) -> Option<Self> {
        let text = text.trim_ascii();
        let printable = text.iter().all(|&byte| printable(byte));
        if text.is_empty() || !printable {
            return None;
        }
        let mut name = [0; LENGTH];
        for (to, &from) in name.iter_mut().zip(text) {
            *to = from;
        }
        Some(Self(name))
    }

    /// All of it.
    #[must_use]
    pub fn text(&self) -> &[u8] {
        let mut parts = self.0.split(|&byte| byte == 0);
        parts.next().unwrap_or_default()
    }

    /// What stands before the first comma.
    #[must_use]
    pub fn model(&self) -> &[u8] {
        let mut parts = self.text().split(|&byte| byte == b',');
        parts.next().unwrap_or_default().trim_ascii()
    }

    /// Whether it is a model alone, which a stage can answer as.
    #[must_use]
    pub fn is_model(&self) -> bool {
        let text = self.text();
        (1..=Self::LONGEST_MODEL).contains(&text.len())
            && text == self.model()
            && Self::of(text) == Some(*self)
    }
}

fn printable(byte: u8) -> bool {
    (b' '..=b'~').contains(&byte)
}

impl fmt::Display for StageName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for &byte in self.text() {
            let shown = if printable(byte) { byte } else { b'?' };
            fmt::Write::write_char(f, char::from(shown))?;
        }
        Ok(())
    }
}

impl fmt::Debug for StageName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::string::ToString;

    fn name(text: &str) -> StageName {
        StageName::of(text.as_bytes()).expect("printable")
    }

    #[test]
    fn a_model_is_what_stands_before_the_comma() {
        for (text, model) in [
            ("URS150BCC, SN0001", "URS150BCC"),
            (" TS50DC.5 ,SN1263\r\n", "TS50DC.5"),
            ("Unknown", "Unknown"),
            ("MODEL WITH A VERY LONG NAME, 1", "MODEL WITH A VERY LONG N"),
            (", 7", ""),
        ] {
            assert_eq!(name(text).model(), model.as_bytes(), "{text}");
        }
        assert_eq!(name("IMS300V, 7").to_string(), "IMS300V, 7");
    }

    #[test]
    fn what_no_stage_answers_as_is_no_model() {
        assert!(name("IMS300V").is_model());
        assert!(name("A MODEL OF 20 LETTER").is_model());
        for text in ["IMS300V, 7", "A MODEL OF 21 LETTERS", ","] {
            assert!(!name(text).is_model(), "{text}");
        }
        for none in [&b""[..], b" \r\n", b"IMS\x07", b"\xc3\xa4", b"A\0B"] {
            assert_eq!(StageName::of(none), None, "{none:?}");
        }
        // As only a stranger's bytes can be.
        let mut foreign = [0; LENGTH];
        assert!(!StageName(foreign).is_model());
        foreign[0] = 0x1b;
        assert!(!StageName(foreign).is_model());
        assert_eq!(StageName(foreign).to_string(), "?");
        (foreign[0], foreign[2]) = (b'A', b'B');
        assert!(!StageName(foreign).is_model(), "something behind its end");
    }
}
