//! Percent encoding (RFC 3986, 2.3): what is no unreserved character becomes its bytes' numbers.

/// A text as the value of a query, or as a part of a file's name.
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
