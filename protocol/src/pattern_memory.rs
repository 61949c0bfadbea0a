//! Where a pattern lies in the projector's memory: the one place for those who write the images and those who show them.
//!
//! A DLPC350 stores images of 24 bit; with 8 bit patterns, three of them share one. Its tables number them green 0, red 1,
//! blue 2 (TI, DLPU010, table "Pattern Number Mapping"; the same in published programs that drive the chip, for instance
//! `patNum = 0/1/2 (G/R/B)` of several users of TI's host library).

/// A colour channel of a 24 bit image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Plane {
    /// Pattern 0 of an image.
    Green = 0,
    /// Pattern 1.
    Red = 1,
    /// Pattern 2.
    Blue = 2,
}

/// Image and channel of an 8 bit pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Number of the image, from 0.
    pub image: u16,
    /// Channel in it.
    pub plane: Plane,
}

impl Place {
    /// Patterns of 8 bit that share an image.
    pub const PER_IMAGE: u16 = 3;

    /// Of a pattern, counted from 1 as in a capture plan; 0 is black, which needs no memory.
    #[must_use]
    pub const fn of(pattern: u16) -> Option<Self> {
        let Some(index) = pattern.checked_sub(1) else {
            return None;
        };
        let plane = match index % Self::PER_IMAGE {
            0 => Plane::Green,
            1 => Plane::Red,
            _ => Plane::Blue,
        };
        Some(Self {
            image: index / Self::PER_IMAGE,
            plane,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_patterns_share_an_image() {
        assert_eq!(Place::of(0), None, "black");
        let of = |pattern| Place::of(pattern).map(|place| (place.image, place.plane as u8));
        assert_eq!(of(1), Some((0, 0)));
        assert_eq!(of(3), Some((0, 2)));
        assert_eq!(of(4), Some((1, 0)));
        assert_eq!(of(u16::MAX), Some((21_844, 2)));
    }
}
