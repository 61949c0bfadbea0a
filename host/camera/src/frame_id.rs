//! Which frames are missing, by the numbers that a camera gives them.

/// How a camera counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counting {
    /// 1 to 65 535, then 1 again: 0 is no frame (GigE Vision 1.x).
    Sixteen,
    /// 64 bits from 0 on, never around (USB3 Vision, GigE Vision 2.0 extended).
    SixtyFour,
}

/// The numbers seen since the last arming.
#[derive(Clone, Copy, Debug)]
pub struct FrameIds {
    counting: Counting,
    last: Option<u64>,
}

/// A number that cannot follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "frame {got} came after frame {last}: the camera began to count anew, or sent a frame twice"
)]
pub struct OutOfOrder {
    /// That came.
    pub got: u64,
    /// The one before.
    pub last: u64,
}

impl FrameIds {
    /// None seen yet.
    #[must_use]
    pub fn new(counting: Counting) -> Self {
        Self {
            counting,
            last: None,
        }
    }

    /// The first one after arming is the first frame, whatever its number: settings and drained frames make it jump.
    pub fn armed(&mut self) {
        self.last = None;
    }

    /// A frame came without a number: it is the one after the last.
    pub fn unnumbered(&mut self) {
        self.last = self.last.map(|last| match self.counting {
            Counting::Sixteen => last % 65_535 + 1,
            Counting::SixtyFour => last.saturating_add(1),
        });
    }

    /// Frames that are missing before this one.
    ///
    /// # Errors
    /// It does not follow the last one.
    pub fn missing_before(&mut self, got: u64) -> Result<u32, OutOfOrder> {
        let Some(last) = self.last else {
            self.last = Some(got);
            return Ok(0);
        };
        let out_of_order = OutOfOrder { got, last };
        let ahead = match self.counting {
            Counting::SixtyFour => got.checked_sub(last).ok_or(out_of_order)?,
            Counting::Sixteen => {
                const IDS: u64 = 65_535;
                if !(1..=IDS).contains(&got) {
                    return Err(out_of_order);
                }
                let ahead = (got + IDS - last) % IDS;
                // More than half of the way round is a step back.
                if ahead > IDS / 2 {
                    return Err(out_of_order);
                }
                ahead
            }
        };
        self.last = Some(got);
        let missing = ahead.checked_sub(1).ok_or(out_of_order)?;
        u32::try_from(missing).map_err(|_| out_of_order)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_bits_wrap_past_zero() {
        let mut ids = FrameIds::new(Counting::Sixteen);
        let seen = [65_533, 65_534, 65_535, 1, 2, 5];
        let missing: Vec<_> = seen.map(|id| ids.missing_before(id)).into();
        assert_eq!(missing, [Ok(0), Ok(0), Ok(0), Ok(0), Ok(0), Ok(2)]);
        assert!(ids.missing_before(5).is_err(), "twice");
        assert!(ids.missing_before(4).is_err(), "back");
        assert!(ids.missing_before(0).is_err(), "no frame");
        ids.armed();
        assert_eq!(ids.missing_before(9), Ok(0));
        // By brute force: whatever is left out is counted, over the wrap as well.
        let next = |id: u64| id % 65_535 + 1;
        for start in [1, 3, 65_530, 65_535] {
            for left_out in 0..20 {
                let mut ids = FrameIds::new(Counting::Sixteen);
                ids.missing_before(start).unwrap();
                let then = (0..=left_out).fold(start, |id, _| next(id));
                assert_eq!(ids.missing_before(then), Ok(left_out), "{start}");
            }
        }
    }

    #[test]
    fn a_frame_without_a_number_is_the_next_one() {
        for (counting, first, then) in [
            (Counting::Sixteen, 65_534, 2),
            (Counting::SixtyFour, 65_534, 65_537),
        ] {
            let mut ids = FrameIds::new(counting);
            // Nothing is known before the first number.
            ids.unnumbered();
            assert_eq!(ids.missing_before(first), Ok(0));
            ids.unnumbered();
            ids.unnumbered();
            assert_eq!(ids.missing_before(then), Ok(0), "{counting:?}");
            assert!(ids.missing_before(then).is_err());
        }
    }

    #[test]
    fn sixty_four_bits_do_not() {
        let mut ids = FrameIds::new(Counting::SixtyFour);
        assert_eq!(ids.missing_before(0), Ok(0));
        assert_eq!(ids.missing_before(65_536), Ok(65_535));
        assert!(ids.missing_before(1).is_err());
    }
}
