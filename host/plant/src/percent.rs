//! Percent encoding (RFC 3986, 2.1).

/// A text as the value of a query, or as a part of a file's name: what is no unreserved character becomes its bytes' numbers.
pub fn encoded(text: &str) -> String {
    let mut out = String::new();
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~".contains(&byte) {
            out.push(char::from(byte));
        } else {
            out += &format!("%{byte:02X}");
        }
    }
    out
}

/// A name in which the characters that are special where it stands, and % itself, become their numbers.
#[cfg(any(feature = "mqtt", feature = "opcua"))]
pub fn escaped(name: &str, is_special: impl Fn(char) -> bool) -> String {
    let mut out = String::new();
    for c in name.chars() {
        match c == '%' || is_special(c) {
            true => out += &format!("%{:02X}", u32::from(c)),
            false => out.push(c),
        }
    }
    out
}
