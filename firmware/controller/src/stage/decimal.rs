//! Millionths to decimal text and back, without floating point and without the formatting machinery.

/// Longest text: sign, 13 digits before the point, point, 6 behind.
pub const MAX_CHARS: usize = 21;

const SCALE: u64 = 1_000_000;

/// Appends `millionths` / 1 000 000 with six decimals; false if there is no room.
#[must_use]
pub fn write<const N: usize>(millionths: i64, out: &mut heapless::String<N>) -> bool {
    let magnitude = millionths.unsigned_abs();
    let mut digits = [b'0'; MAX_CHARS];
    let (mut whole, mut part) = (magnitude / SCALE, magnitude % SCALE);
    let mut used = 0usize;
    for slot in digits.iter_mut().rev() {
        *slot = match used {
            0..=5 => {
                let digit = part % 10;
                part /= 10;
                b'0' + digit as u8
            }
            6 => b'.',
            _ => {
                let digit = whole % 10;
                whole /= 10;
                b'0' + digit as u8
            }
        };
        used += 1;
        if used >= 8 && whole == 0 {
            break;
        }
    }
    let sign = if millionths < 0 {
        out.push('-').is_ok()
    } else {
        true
    };
    sign && digits
        .iter()
        .skip(MAX_CHARS.saturating_sub(used))
        .all(|&digit| out.push(char::from(digit)).is_ok())
}

/// Reads a decimal number as millionths, rounding further decimals to nearest; `None` if it is anything else.
#[must_use]
pub fn read(text: &[u8]) -> Option<i64> {
    let (negative, digits) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    };
    let mut value = 0i64;
    let mut decimals: Option<u32> = None;
    let mut any = false;
    for &byte in digits {
        match (byte, decimals) {
            (b'.', None) => decimals = Some(0),
            (b'0'..=b'9', _) => {
                any = true;
                let digit = i64::from(byte - b'0');
                match &mut decimals {
                    // The seventh decimal rounds, the rest is dropped.
                    Some(6) => {
                        value = value.checked_add(i64::from(digit >= 5))?;
                        decimals = Some(7);
                    }
                    Some(7..) => {}
                    seen => {
                        value = value.checked_mul(10)?.checked_add(digit)?;
                        if let Some(count) = seen {
                            *count += 1;
                        }
                    }
                }
            }
            _ => return None,
        }
    }
    let missing = 6u32.saturating_sub(decimals.unwrap_or(0));
    let value = value.checked_mul(10i64.checked_pow(missing)?)?;
    any.then_some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::{format, string::String};

    fn text(millionths: i64) -> String {
        let mut out = heapless::String::<32>::new();
        assert!(write(millionths, &mut out));
        String::from(out.as_str())
    }

    #[test]
    fn text_is_that_of_the_standard_library() {
        for value in [
            0,
            1,
            -1,
            9,
            999_999,
            1_000_000,
            -1_000_001,
            33_000_000,
            2_147_483_648_000_000,
            -87_654_321,
        ] {
            let sign = if value < 0 { "-" } else { "" };
            let magnitude = i64::abs(value);
            assert_eq!(
                text(value),
                format!(
                    "{sign}{}.{:06}",
                    magnitude / 1_000_000,
                    magnitude % 1_000_000
                )
            );
            assert_eq!(read(text(value).as_bytes()), Some(value));
        }
    }

    #[test]
    fn other_spellings_of_a_number_are_read() {
        for (spelling, value) in [
            ("5", 5_000_000),
            ("+5.", 5_000_000),
            (".5", 500_000),
            ("-0.25", -250_000),
            ("12.34567849", 12_345_678),
            ("12.3456785", 12_345_679),
        ] {
            assert_eq!(read(spelling.as_bytes()), Some(value), "{spelling}");
        }
    }

    #[test]
    fn anything_else_is_refused() {
        for junk in [
            "",
            "-",
            ".",
            "1.2.3",
            "1e5",
            "nan",
            " 1",
            "1 ",
            "99999999999999999999",
            "--1",
        ] {
            assert_eq!(read(junk.as_bytes()), None, "{junk}");
        }
    }
}
