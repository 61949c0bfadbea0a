//! A camera's samples into the slot's 16 bits, in one pass: what is read here was never written anywhere else.
//!
//! | format | bytes | samples |
//! |---|---|---|
//! | `Mono8`, `Mono16` | 1, 2 | one; little endian. `Mono10` and `Mono12` come as `Mono16` does |
//! | `Mono10p`, `Mono12p` | 5, 3 | 4, 2: one bit stream, least significant bit first (EMVA, Pixel Format Naming Convention 2.1) |
//! | `Mono10Packed`, `Mono12Packed` | 3 | 2: high bits in the outer bytes, both low parts in the middle one (AIA, GigE Vision 1.2) |

use std::str::FromStr;

/// How a camera packs its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// 8 bits.
    Mono8,
    /// 10 bits in 16.
    Mono10,
    /// 12 bits in 16.
    Mono12,
    /// 16 bits.
    Mono16,
    /// 10 bits, one stream.
    Mono10p,
    /// 12 bits, one stream.
    Mono12p,
    /// 10 bits, two samples to three bytes.
    Mono10Packed,
    /// 12 bits, two samples to three bytes.
    Mono12Packed,
}

/// What cannot be unpacked.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnpackError {
    /// Another format.
    #[error(
        "pixel format {got} is not among Mono8, Mono10, Mono12, Mono16, Mono10p, Mono12p, Mono10Packed, Mono12Packed: set the camera to one of them"
    )]
    Format {
        /// Its name.
        got: String,
    },
    /// Another number of bytes than so many samples take.
    #[error("{got} bytes came; {pixels} samples of {format:?} take {need}")]
    Length {
        got: usize,
        /// Bytes that would be right.
        need: usize,
        pixels: usize,
        /// Their format.
        format: PixelFormat,
    },
}

impl FromStr for PixelFormat {
    type Err = UnpackError;

    /// By the name that a camera gives it.
    fn from_str(name: &str) -> Result<Self, UnpackError> {
        let mut all = Self::ALL.into_iter();
        let named = all.find(|format| format.name() == name);
        named.ok_or_else(|| UnpackError::Format { got: name.into() })
    }
}

impl PixelFormat {
    pub const ALL: [Self; 8] = [
        Self::Mono8,
        Self::Mono10,
        Self::Mono12,
        Self::Mono16,
        Self::Mono10p,
        Self::Mono12p,
        Self::Mono10Packed,
        Self::Mono12Packed,
    ];

    /// The name that a camera gives it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mono8 => "Mono8",
            Self::Mono10 => "Mono10",
            Self::Mono12 => "Mono12",
            Self::Mono16 => "Mono16",
            Self::Mono10p => "Mono10p",
            Self::Mono12p => "Mono12p",
            Self::Mono10Packed => "Mono10Packed",
            Self::Mono12Packed => "Mono12Packed",
        }
    }

    /// Its number (EMVA, Pixel Format Values 2.1): the third byte is how many bits a sample takes on the wire.
    #[must_use]
    pub fn pfnc(self) -> u32 {
        match self {
            Self::Mono8 => 0x0108_0001,
            Self::Mono10 => 0x0110_0003,
            Self::Mono12 => 0x0110_0005,
            Self::Mono16 => 0x0110_0007,
            Self::Mono10p => 0x010A_0046,
            Self::Mono12p => 0x010C_0047,
            Self::Mono10Packed => 0x010C_0004,
            Self::Mono12Packed => 0x010C_0006,
        }
    }

    /// Bits of a sample.
    #[must_use]
    pub fn bits(self) -> u32 {
        match self {
            Self::Mono8 => 8,
            Self::Mono10 | Self::Mono10p | Self::Mono10Packed => 10,
            Self::Mono12 | Self::Mono12p | Self::Mono12Packed => 12,
            Self::Mono16 => 16,
        }
    }

    /// Bytes of so many samples.
    #[must_use]
    pub fn bytes(self, pixels: usize) -> usize {
        match self {
            Self::Mono8 => pixels,
            Self::Mono10 | Self::Mono12 | Self::Mono16 => 2 * pixels,
            Self::Mono10p => (10 * pixels).div_ceil(8),
            Self::Mono12p | Self::Mono10Packed | Self::Mono12Packed => (12 * pixels).div_ceil(8),
        }
    }

    /// Unpacks all samples of a frame.
    ///
    /// # Errors
    /// [`UnpackError::Length`].
    pub fn unpack(self, bytes: &[u8], pixels: &mut [u16]) -> Result<(), UnpackError> {
        let need = self.bytes(pixels.len());
        if bytes.len() != need {
            return Err(UnpackError::Length {
                got: bytes.len(),
                need,
                pixels: pixels.len(),
                format: self,
            });
        }
        match self {
            Self::Mono8 => {
                for (pixel, &byte) in pixels.iter_mut().zip(bytes) {
                    *pixel = byte.into();
                }
            }
            Self::Mono10 | Self::Mono12 | Self::Mono16 => {
                for (pixel, pair) in pixels.iter_mut().zip(bytes.chunks_exact(2)) {
                    *pixel = u16::from_le_bytes([pair[0], pair[1]]);
                }
            }
            Self::Mono10p => groups::<4, 5>(bytes, pixels, |b| {
                [
                    b[0] | (b[1] & 0x03) << 8,
                    b[1] >> 2 | (b[2] & 0x0F) << 6,
                    b[2] >> 4 | (b[3] & 0x3F) << 4,
                    b[3] >> 6 | b[4] << 2,
                ]
            }),
            Self::Mono12p => groups::<2, 3>(bytes, pixels, |b| {
                [b[0] | (b[1] & 0x0F) << 8, b[1] >> 4 | b[2] << 4]
            }),
            Self::Mono10Packed => groups::<2, 3>(bytes, pixels, |b| {
                [b[0] << 2 | b[1] & 0x03, b[2] << 2 | b[1] >> 4 & 0x03]
            }),
            Self::Mono12Packed => groups::<2, 3>(bytes, pixels, |b| {
                [b[0] << 4 | b[1] & 0x0F, b[2] << 4 | b[1] >> 4]
            }),
        }
        Ok(())
    }
}

/// Group by group of `P` samples in `B` bytes; the last group may be cut off, what is missing of it counts as zero.
fn groups<const P: usize, const B: usize>(
    bytes: &[u8],
    pixels: &mut [u16],
    of: impl Fn([u16; B]) -> [u16; P],
) {
    let (whole, rest) = bytes.as_chunks::<B>();
    let (groups, last) = pixels.as_chunks_mut::<P>();
    for (group, bytes) in groups.iter_mut().zip(whole) {
        *group = of(bytes.map(u16::from));
    }
    if !last.is_empty() {
        let mut cut = [0; B];
        for (to, &from) in cut.iter_mut().zip(rest) {
            *to = from.into();
        }
        for (pixel, sample) in last.iter_mut().zip(of(cut)) {
            *pixel = sample;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(bytes: &mut [u8], bit: usize, value: u16, of: u32) {
        bytes[bit / 8] |= (((value >> of) & 1) as u8) << (bit % 8);
    }

    /// Bit by bit, as the conventions draw it.
    fn packed(format: PixelFormat, pixels: &[u16]) -> Vec<u8> {
        let mut bytes = vec![0; format.bytes(pixels.len())];
        for (n, &value) in pixels.iter().enumerate() {
            for of in 0..format.bits() {
                let k = of as usize;
                let bit = match format {
                    PixelFormat::Mono8 => 8 * n + k,
                    PixelFormat::Mono10 | PixelFormat::Mono12 | PixelFormat::Mono16 => 16 * n + k,
                    PixelFormat::Mono10p => 10 * n + k,
                    PixelFormat::Mono12p => 12 * n + k,
                    // High bits in byte 0 or 2 of the group, low ones in byte 1, those of the second sample in its upper half.
                    PixelFormat::Mono10Packed | PixelFormat::Mono12Packed => {
                        let low = format.bits() as usize - 8;
                        let (group, second) = (24 * (n / 2), n % 2);
                        match k.checked_sub(low) {
                            Some(high) => group + 16 * second + high,
                            None => group + 8 + 4 * second + k,
                        }
                    }
                };
                set(&mut bytes, bit, value, of);
            }
        }
        bytes
    }

    #[test]
    fn every_format_comes_back_at_every_length() {
        for format in PixelFormat::ALL {
            for length in 0..30_usize {
                let mask = u16::MAX >> (16 - format.bits());
                let sent: Vec<u16> = (0..length as u16)
                    .map(|i| i.wrapping_mul(40_503).wrapping_add(12_345) & mask)
                    .collect();
                let bytes = packed(format, &sent);
                let mut got = vec![0xAAAA; length];
                format.unpack(&bytes, &mut got).unwrap();
                assert_eq!(got, sent, "{format:?} {length}");
            }
            assert_eq!(format.name().parse(), Ok(format));
            assert_eq!(format.name(), format!("{format:?}"));
            let wire_bits = (format.pfnc() >> 16) & 0xFF;
            assert_eq!(format.bytes(8), wire_bits as usize, "{format:?}");
        }
    }

    /// Two samples, 0xABC and 0x123, as the two conventions draw them.
    #[test]
    fn the_two_ways_of_twelve_bits_are_told_apart() {
        let mut pixels = [0; 2];
        let unpack = |format: PixelFormat, bytes: [u8; 3], pixels: &mut [u16; 2]| {
            format.unpack(&bytes, pixels).unwrap();
        };
        unpack(PixelFormat::Mono12p, [0xBC, 0x3A, 0x12], &mut pixels);
        assert_eq!(pixels, [0xABC, 0x123]);
        unpack(PixelFormat::Mono12Packed, [0xAB, 0x3C, 0x12], &mut pixels);
        assert_eq!(pixels, [0xABC, 0x123]);
    }

    #[test]
    fn wrong_lengths_and_formats_are_named() {
        let error = PixelFormat::Mono12p
            .unpack(&[0; 10], &mut [0; 8])
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "10 bytes came; 8 samples of Mono12p take 12"
        );
        let error = "BayerRG8".parse::<PixelFormat>().unwrap_err();
        assert!(error.to_string().contains("BayerRG8"), "{error}");
    }
}
