//! From when until when a certificate is valid. Of the certificate (X.509, RFC 5280, 4.1) only the path to these two times is read.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Tags of DER (X.690).
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xa0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

/// Why a certificate is not valid at a moment, if so.
pub fn objection(certificate: &[u8], now: Timestamp) -> Option<String> {
    match validity(certificate) {
        None => Some("from when until when this certificate is valid cannot be read".into()),
        Some([from, _]) if now < from => Some(format!("this certificate is valid from {from}")),
        Some([_, until]) if until < now => Some(format!("this certificate expired at {until}")),
        Some(_) => None,
    }
}

/// The first and the last moment.
fn validity(certificate: &[u8]) -> Option<[Timestamp; 2]> {
    let (body, _) = element(certificate, SEQUENCE)?;
    let (mut to_be_signed, _) = element(body, SEQUENCE)?;
    if to_be_signed.first() == Some(&VERSION) {
        to_be_signed = any(to_be_signed)?.2;
    }
    // Serial number, signature's algorithm, issuer.
    for _ in 0..3 {
        to_be_signed = any(to_be_signed)?.2;
    }
    let (times, _) = element(to_be_signed, SEQUENCE)?;
    let (tag, from, after_from) = any(times)?;
    let from = moment(tag, from)?;
    let (tag, until, _) = any(after_from)?;
    Some([from, moment(tag, until)?])
}

/// Tag and content of the first element, and what follows it.
fn any(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, tail) = bytes.split_first()?;
    let (&length, tail) = tail.split_first()?;
    let (length, tail) = match usize::from(length) {
        short @ 0..0x80 => (short, tail),
        long => {
            let (digits, tail) = tail.split_at_checked(long - 0x80)?;
            let add = |sum: usize, byte: &u8| sum.checked_mul(256)?.checked_add((*byte).into());
            (digits.iter().try_fold(0, add)?, tail)
        }
    };
    let (content, tail) = tail.split_at_checked(length)?;
    Some((tag, content, tail))
}

fn element(bytes: &[u8], wanted: u8) -> Option<(&[u8], &[u8])> {
    let (tag, content, tail) = any(bytes)?;
    (tag == wanted).then_some((content, tail))
}

/// A time with seconds, in UTC; years of two digits are 1950 to 2049.
fn moment(tag: u8, text: &[u8]) -> Option<Timestamp> {
    let text = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
    let is_digits = text.bytes().all(|byte| byte.is_ascii_digit());
    let text = match (tag, text.len()) {
        (UTC_TIME, 12) if is_digits => {
            let century = if text < "50" { "20" } else { "19" };
            format!("{century}{text}")
        }
        (GENERALIZED_TIME, 14) if is_digits => text.into(),
        _ => return None,
    };
    let number = |range: std::ops::Range<usize>| text.get(range)?.parse::<i8>().ok();
    let at = DateTime::new(
        text.get(..4)?.parse().ok()?,
        number(4..6)?,
        number(6..8)?,
        number(8..10)?,
        number(10..12)?,
        number(12..14)?,
        0,
    );
    TimeZone::UTC.to_timestamp(at.ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn der(tag: u8, content: &[u8]) -> Vec<u8> {
        let length = content.len();
        match u8::try_from(length) {
            Ok(length @ 0..0x80) => [&[tag, length], content].concat(),
            _ => [&[tag, 0x82, (length >> 8) as u8, length as u8], content].concat(),
        }
    }

    /// A certificate as far as it is read, and something behind.
    fn certificate(from: (u8, &str), until: (u8, &str), version: bool) -> Vec<u8> {
        let [from, until] = [from, until].map(|(tag, text)| der(tag, text.as_bytes()));
        let mut inside = Vec::new();
        if version {
            inside.extend(der(VERSION, &der(2, &[2])));
        }
        inside.extend(der(2, &[1; 20]));
        inside.extend(der(SEQUENCE, &[5, 0]));
        inside.extend(der(SEQUENCE, &[0x31; 300]));
        inside.extend(der(SEQUENCE, &[from, until].concat()));
        inside.extend([0xff; 40]);
        der(SEQUENCE, &[der(SEQUENCE, &inside), vec![1, 2, 3]].concat())
    }

    #[test]
    fn a_certificate_is_valid_between_its_times() {
        let now = "2026-11-27T12:00:00Z".parse().unwrap();
        let short = |text| (UTC_TIME, text);
        let long = |text| (GENERALIZED_TIME, text);
        for (from, until, expected) in [
            (short("260101000000Z"), short("270101000000Z"), None),
            (short("500101000000Z"), long("20500101000000Z"), None),
            (
                short("260101000000Z"),
                short("261127115959Z"),
                Some("expired at 2026-11-27T11:59:59Z"),
            ),
            (
                short("261127120001Z"),
                short("270101000000Z"),
                Some("valid from 2026-11-27T12:00:01Z"),
            ),
            (
                short("260101"),
                short("270101000000Z"),
                Some("cannot be read"),
            ),
            (
                short("261301000000Z"),
                short("270101000000Z"),
                Some("cannot be read"),
            ),
        ] {
            for version in [true, false] {
                let bytes = certificate(from, until, version);
                let got = objection(&bytes, now);
                assert!(
                    match (expected, &got) {
                        (None, None) => true,
                        (Some(expected), Some(got)) => got.contains(expected),
                        _ => false,
                    },
                    "{from:?} {until:?}: {got:?}"
                );
                // Cut or changed anywhere, it is never more than unreadable.
                for at in 0..bytes.len() {
                    let _ = objection(&bytes[..at], now);
                    let mut other = bytes.clone();
                    other[at] ^= 0x80;
                    let _ = objection(&other, now);
                }
            }
        }
    }
}
