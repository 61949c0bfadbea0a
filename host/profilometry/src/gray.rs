//! Reflected binary Gray code (F. Gray, US patent 2 632 058, 1953): which stripe of the projector lights a cell.
//!
//! The projector's width is cut into stripes; each bit's frame is lit where that bit of the stripe's code word is set, most
//! significant bit first. Neighbouring words differ in one bit, the first and the last too, so a cell on the edge of two stripes has
//! one uncertain bit and two possible words, which are neighbours: it lies at their edge.

use serde::{Deserialize, Serialize};

/// A code beside phase-shifted frequencies.
///
/// `stripe = floor(stripes (column - origin_px) / width)`, columns counted at pixel centres; stripes are counted modulo `2^bits`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GrayCode {
    /// Bits of a word.
    pub bits: u32,
    /// Stripes over the projector's full width.
    pub stripes: f64,
    /// The column where stripe 0 begins.
    pub origin_px: f64,
    /// Whether the frame of every bit is followed by its complement.
    pub complement: bool,
}

/// Position of a cell by its code word, in stripes from the beginning of stripe 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripePosition {
    /// Middle of a stripe, or the edge of two.
    pub stripes: f64,
    /// Farthest from there, but for blur: half a stripe, or nothing at an edge.
    pub half_width: f64,
}

/// More stripes than any projector has columns.
pub const MAX_BITS: u32 = 16;

impl GrayCode {
    /// Frames of one exposure.
    pub fn frames(&self) -> u32 {
        self.bits * if self.complement { 2 } else { 1 }
    }

    /// Stripes after which the code repeats.
    pub fn period(&self) -> u32 {
        1 << self.bits
    }

    /// Whether `bit`, 0 the most significant, is lit at `column`.
    pub fn is_lit(&self, bit: u32, column: f64, width_px: f64) -> bool {
        let stripe = (self.stripes * (column - self.origin_px) / width_px).floor();
        let binary = stripe.rem_euclid(f64::from(self.period())) as u32;
        let word = binary ^ (binary >> 1);
        word >> (self.bits - 1 - bit) & 1 == 1
    }

    /// Position of a cell from its bits, most significant first; a `None` among them is an uncertain bit. `None` if words other than
    /// those of two neighbouring stripes are possible.
    pub fn place(&self, bits: &[Option<bool>]) -> Option<StripePosition> {
        let untold = bits.iter().filter(|bit| bit.is_none()).count();
        // Bits of the binary number: each is the parity of the word's bits so far.
        let stripe = |instead: bool| {
            let digits = bits.iter().scan(0, |digit, bit| {
                *digit ^= u32::from(bit.unwrap_or(instead));
                Some(*digit)
            });
            digits.fold(0, |number, digit| number << 1 | digit)
        };
        let (first, second) = (stripe(false), stripe(true));
        match untold {
            0 => Some(StripePosition {
                stripes: f64::from(first) + 0.5,
                half_width: 0.5,
            }),
            1 => {
                let (low, high) = (first.min(second), first.max(second));
                let edge = match high - low {
                    1 => high,
                    apart if apart + 1 == self.period() => 0,
                    _ => return None,
                };
                Some(StripePosition {
                    stripes: f64::from(edge),
                    half_width: 0.0,
                })
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The code as it is published: write the shorter one down, then its mirror image; put 0 before the former, 1 before the latter.
    fn reflected(bits: u32) -> Vec<Vec<bool>> {
        let Some(shorter) = bits.checked_sub(1) else {
            return vec![vec![]];
        };
        let shorter = reflected(shorter);
        let before = |first: bool, word: &Vec<bool>| [vec![first], word.clone()].concat();
        let forwards = shorter.iter().map(|word| before(false, word));
        let backwards = shorter.iter().rev().map(|word| before(true, word));
        forwards.chain(backwards).collect()
    }

    fn code(bits: u32, stripes: f64) -> GrayCode {
        GrayCode {
            bits,
            stripes,
            origin_px: -0.5,
            complement: false,
        }
    }

    #[test]
    fn words_are_those_of_the_reflected_list() {
        for bits in 1..=8 {
            let list = reflected(bits);
            let code = code(bits, list.len() as f64);
            for (stripe, word) in list.iter().enumerate() {
                // Both ends of a stripe 3 px wide.
                for column in [3 * stripe, 3 * stripe + 2] {
                    let width_px = 3.0 * list.len() as f64;
                    let shown: Vec<bool> = (0..bits)
                        .map(|bit| code.is_lit(bit, column as f64, width_px))
                        .collect();
                    assert_eq!(&shown, word, "{bits} bits, stripe {stripe}");
                }
                let told: Vec<Option<bool>> = word.iter().copied().map(Some).collect();
                let place = code.place(&told).unwrap();
                assert_eq!(
                    (place.stripes, place.half_width),
                    (stripe as f64 + 0.5, 0.5)
                );
            }
        }
    }

    /// Every word with every bit taken away, against looking through the list for the words that are left.
    #[test]
    fn a_bit_that_cannot_be_told_leaves_an_edge_or_nothing() {
        for bits in 2..=6 {
            let list = reflected(bits);
            let count = list.len();
            for word in &list {
                for lost in 0..bits as usize {
                    let mut told: Vec<Option<bool>> = word.iter().copied().map(Some).collect();
                    told[lost] = None;
                    let fits = |other: &Vec<bool>| {
                        let same = other.iter().zip(&told);
                        same.clone().all(|(a, b)| b.is_none_or(|b| *a == b))
                    };
                    let left: Vec<usize> = (0..count).filter(|&at| fits(&list[at])).collect();
                    let edge = match left[..] {
                        [a, b] if b == a + 1 => Some(b as f64),
                        [0, b] if b == count - 1 => Some(0.0),
                        _ => None,
                    };
                    let place = code(bits, count as f64).place(&told);
                    assert_eq!(place.map(|place| place.stripes), edge, "{told:?}");
                    assert!(place.is_none_or(|place| place.half_width == 0.0));
                }
            }
        }
        assert_eq!(code(3, 8.0).place(&[None, Some(true), None]), None);
    }

    /// With 48 stripes of 6 bits the code goes on beyond the projector; with 3 bits it repeats within.
    #[test]
    fn stripes_repeat_after_all_words() {
        let (long, short) = (code(6, 48.0), code(3, 48.0));
        for column in 0..1024 {
            let at = f64::from(column);
            for bit in 0..3 {
                let later = at + 8.0 * 1024.0 / 48.0;
                assert_eq!(
                    short.is_lit(bit, at, 1024.0),
                    short.is_lit(bit, later, 1024.0)
                );
                let before = at - 64.0 * 1024.0 / 48.0;
                assert_eq!(
                    long.is_lit(bit, at, 1024.0),
                    long.is_lit(bit, before, 1024.0)
                );
            }
        }
    }
}
