//! Packing of samples in a GigE Vision frame.

/// `Mono12p` (EMVA, Pixel Format Naming Convention 2.1): one stream of bits, the lowest bit of each sample first.
pub fn mono_12p(pixels: &[u16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity((12 * pixels.len()).div_ceil(8));
    let (pairs, last) = pixels.as_chunks::<2>();
    for &[a, b] in pairs {
        bytes.extend([a as u8, ((a >> 8) & 0x0F | b << 4) as u8, (b >> 4) as u8]);
    }
    if let [a] = last {
        bytes.extend([*a as u8, (a >> 8) as u8 & 0x0F]);
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared with the convention, bit by bit.
    #[test]
    fn every_bit_is_where_the_convention_has_it() {
        for length in 0..9_u16 {
            let pixels: Vec<u16> = (0..length).map(|i| (i * 1999 + 77) & 0xFFF).collect();
            let bytes = mono_12p(&pixels);
            assert_eq!(bytes.len(), (12 * pixels.len()).div_ceil(8));
            for (n, pixel) in pixels.iter().enumerate() {
                for k in 0..12 {
                    let at = 12 * n + k;
                    let bit = bytes[at / 8] >> (at % 8) & 1;
                    assert_eq!(u16::from(bit), pixel >> k & 1, "pixel {n} bit {k}");
                }
            }
        }
    }
}
