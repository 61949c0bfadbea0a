//! Words and marks of text files as programs and C libraries write them.

/// Byte-order mark of UTF-8.
const UTF8_MARK: &[u8] = b"\xef\xbb\xbf";

/// Contents after the byte-order mark of UTF-8, if there is one.
pub(super) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(UTF8_MARK).unwrap_or(bytes)
}

/// Whether a file starts with the byte-order mark of UTF-16.
pub(super) fn is_utf16(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\xff\xfe") || bytes.starts_with(b"\xfe\xff")
}

/// Parses a number. Accepts the exponents of Fortran (`1.5D+01`) and the words of C libraries for NaN (`-nan(ind)`, `1.#QNAN`)
/// and infinity (`1.#INF`). Returns `None` for other text.
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| unusual_number(word))
}

#[cold]
fn unusual_number(word: &str) -> Option<f64> {
    let lower = word.to_ascii_lowercase();
    let (sign, size) = match lower.strip_prefix('-') {
        Some(size) => (-1.0, size),
        None => (1.0, lower.strip_prefix('+').unwrap_or(&lower)),
    };
    if let Some(kind) = size.strip_prefix("1.#") {
        let is_nan = ["ind", "qnan", "snan"]
            .iter()
            .any(|nan| kind.starts_with(nan));
        let infinite = kind.starts_with("inf").then_some(sign * f64::INFINITY);
        return if is_nan { Some(f64::NAN) } else { infinite };
    }
    if size.starts_with("nan(") && size.ends_with(')') {
        return Some(f64::NAN);
    }
    let (mantissa, exponent) = size.split_once('d')?;
    let value: f64 = format!("{mantissa}e{exponent}").parse().ok()?;
    Some(sign * value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_fortran_and_c_libraries_are_read() {
        assert_eq!(number("-1.5354199D+01"), Some(-15.354_199));
        assert_eq!(number("2.5d-1"), Some(0.25));
        assert_eq!(number("-1.#INF"), Some(f64::NEG_INFINITY));
        for word in [
            "-nan(ind)",
            "-nan(0x8000)",
            "-nan",
            "-1.#IND",
            "1.#QNAN",
            "1.#IND00",
        ] {
            assert!(number(word).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["", "x", "d", "1.#", "1d", "nan(", "1,5"] {
            assert_eq!(number(word), None, "{word}");
        }
    }
}
