//! Figures and names in sentences.

use std::borrow::Cow;
use std::fmt;

use serde::{Deserialize, Deserializer};

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

/// Whether a character would move, colour or turn what is written about it: on a terminal it could forge a line.
#[must_use]
pub fn is_command(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A name as it may be shown: what is no letter of it is told by its number.
#[must_use]
pub fn plain(text: &str) -> Cow<'_, str> {
    if !text.contains(is_command) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if is_command(c) {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown.into()
}

/// Reads a name of a file that a person writes (`#[serde(deserialize_with)]`).
///
/// # Errors
/// It has more than one line, or characters that no name has.
pub fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    let name = String::deserialize(from)?;
    match name.chars().find(|c| is_command(*c)) {
        None => Ok(name),
        Some(c) => Err(serde::de::Error::custom(format_args!(
            "a name holds the character {}; right would be words on one line, without control characters",
            c.escape_default()
        ))),
    }
}

/// As [`name`], of a key that may be left out.
///
/// # Errors
/// As [`name`].
pub fn some_name<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    name(from).map(Some)
}

/// A text as a cell of a table (RFC 4180). A spreadsheet takes what begins like a formula for one: a quotation mark before it makes
/// it the text that it is.
#[must_use]
pub fn cell(text: &str) -> String {
    let text = plain(text);
    let guard = if text.starts_with(['=', '+', '-', '@']) {
        "'"
    } else {
        ""
    };
    // Some spreadsheets split at semicolons, after which a formula could begin.
    if text.contains([',', ';', '"']) {
        format!("\"{guard}{}\"", text.replace('"', "\"\""))
    } else {
        format!("{guard}{text}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_forge_neither_lines_nor_formulas() {
        assert_eq!(plain("press 7, Müller"), "press 7, Müller");
        assert_eq!(
            plain("a\r\x1b[32mGO\nb\u{202e}"),
            "a\\r\\u{1b}[32mGO\\nb\\u{202e}"
        );
        for (text, shown) in [
            ("press 7", "press 7"),
            ("a, \"b\"", "\"a, \"\"b\"\"\""),
            ("=1+1", "'=1+1"),
            ("die;=1+1", "\"die;=1+1\""),
            ("-2,@", "\"'-2,@\""),
            ("@x", "'@x"),
            ("\t=1", "\\t=1"),
            ("a\nb", "a\\nb"),
        ] {
            assert_eq!(cell(text), shown);
        }
        #[derive(Debug, Deserialize)]
        struct Named {
            #[serde(deserialize_with = "name")]
            name: String,
            #[serde(default, deserialize_with = "some_name")]
            serial: Option<String>,
        }
        let read = |text: &str| toml::from_str::<Named>(text);
        let named = read("name = 'die 7'").unwrap();
        assert_eq!((&*named.name, named.serial), ("die 7", None));
        for text in [
            "name = \"die\\nGO\"",
            "name = 'die'\nserial = \"\\u001b[2J\"",
        ] {
            let error = read(text).unwrap_err();
            assert!(error.message().contains("words on one line"), "{error}");
        }
    }

    #[test]
    fn numbers_are_told_as_they_are_and_others_in_words() {
        assert_eq!(format!("{:.1} {}", Number(1.25), Number(50.0)), "1.2 50");
        assert_eq!(format!("{:.1}", Number(f64::NAN)), "(no number)");
        assert_eq!(format!("{}", Number(f64::NEG_INFINITY)), "(no number)");
    }
}
