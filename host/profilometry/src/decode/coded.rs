//! The fringe order from a Gray code.
//!
//! A code takes the place of the volume: it says near which column a cell lies, and the finest frequency's phase the rest. A bit
//! counts when its light differs from the threshold by at least half the amplitude of the finest fringes and five standard
//! deviations of its noise; nearer than that lies the blurred edge of two stripes, or noise. One such bit leaves the two words on
//! either side of that edge, and the phase tells the side; more, or one that would exchange stripes that are no neighbours, and
//! the order is uncertain.

use std::f64::consts::{PI, TAU};

use super::cell::Fate;
use super::{DecodeError, Decoder};
use crate::accumulate::Band;
use crate::gray::{GrayCode, MAX_BITS, StripePosition};
use crate::pattern::PatternSet;
use crate::phase::{CellNoise, LightEstimate};
use crate::unwrap::{Clue, Decision, Ladder, MIN_SEPARATION, decide};

/// A code laid on the phase of the finest frequency.
#[derive(Clone, Copy, Debug)]
pub(super) struct CodeLadder {
    code: GrayCode,
    /// Phase of the finest frequency where stripe 0 begins, and across one stripe.
    origin_rad: f64,
    stripe_rad: f64,
    /// Orders that are possible when the stripe is known.
    orders: usize,
    /// Orders that code and frequencies tell apart together.
    pub all_orders: usize,
    /// Phase steps of the finest frequency.
    steps: f64,
}

/// Difference from the threshold below which a bit shows an edge, in amplitudes of the finest fringes. Far from edges it is one, more
/// where the optics blur fringes: half of it bears a threshold that is off by as much.
const EDGE_RATIO: f64 = 0.5;
/// Half the distance of two orders that can be distinguished.
const BIT_SEPARATION: f64 = 0.5 * MIN_SEPARATION;

/// A cell whose bits are asked.
pub(super) struct CodedCell<'a> {
    pub band: &'a Band,
    pub index: usize,
    /// Light of its finest fringes.
    pub finest: &'a LightEstimate,
    pub noise: &'a CellNoise,
}

impl CodeLadder {
    /// `distinct`: orders that the frequencies tell apart by themselves.
    pub fn new(
        code: &GrayCode,
        patterns: &PatternSet,
        distinct: usize,
        width_px: f64,
    ) -> Result<Self, DecodeError> {
        let finest = patterns.finest();
        let fringes = finest.periods / code.stripes;
        // Orders within the stripe, with a rounding margin; where the frequencies allow, half a fringe more at either side.
        let held = ((fringes - 1e-9).ceil() as usize).max(1);
        if held > distinct {
            return Err(DecodeError::WideStripes {
                fringes,
                limit: distinct,
            });
        }
        let orders = if held > 1 && held < distinct {
            held + 1
        } else {
            held
        };
        let all = (f64::from(code.period()) * fringes + 1e-9).floor();
        Ok(Self {
            code: *code,
            origin_rad: finest.phase_rad(code.origin_px, width_px),
            stripe_rad: TAU * fringes,
            orders,
            all_orders: all.clamp(1.0, finest.periods.ceil()) as usize,
            steps: f64::from(finest.steps),
        })
    }

    /// Phase of the finest frequency about which a cell lies, of all repetitions the one nearest to the middle of what is possible.
    fn middle_rad(&self, place: StripePosition, expected_rad: f64) -> f64 {
        let turn_rad = self.stripe_rad * f64::from(self.code.period());
        let phase_rad = self.origin_rad + place.stripes * self.stripe_rad;
        phase_rad + turn_rad * ((expected_rad - phase_rad) / turn_rad).round()
    }

    /// Farthest from the middle that is no other order's: half way between the end of the stripe and half a turn.
    fn reach_rad(&self, place: StripePosition) -> f64 {
        0.5 * (PI + place.half_width * self.stripe_rad)
    }

    /// Position of a cell by its bits.
    fn place(&self, cell: &CodedCell<'_>) -> Option<StripePosition> {
        let &CodedCell {
            band,
            index,
            finest,
            noise,
        } = cell;
        let exposures = f64::from(band.merged.last()?.exposures[index]);
        let dark_e2 = exposures * noise.pixels * noise.dark_variance_e2;
        let mean_e = finest.mean_e.max(0.0);
        // A lit frame has at most twice the mean light.
        let variance_e2 = if self.code.complement {
            0.25 * (2.0 * mean_e + 2.0 * dark_e2)
        } else {
            2.0 * mean_e + dark_e2 + (mean_e + dark_e2) / self.steps
        };
        let least_e = BIT_SEPARATION * variance_e2.sqrt();
        let mut told = [None; MAX_BITS as usize];
        for (told, bit) in told.iter_mut().zip(&band.code) {
            let difference_e = f64::from(bit.difference[index]) * noise.gain_e_per_dn;
            let amplitude_e = f64::from(bit.amplitude[index]) * noise.gain_e_per_dn;
            // Written so that a NaN, and a cell of which every exposure was saturated, tells nothing.
            let tells =
                amplitude_e > 0.0 && difference_e.abs() >= (EDGE_RATIO * amplitude_e).max(least_e);
            *told = tells.then_some(difference_e > 0.0);
        }
        self.code.place(&told[..band.code.len()])
    }
}

impl Decoder {
    /// The order that the code and, within a stripe, the clues of the other frequencies name.
    pub(super) fn coded_order(
        &self,
        ladder: &CodeLadder,
        cell: &CodedCell<'_>,
        clues: &[Clue],
        [wrapped_rad, expected_rad]: [f64; 2],
    ) -> Result<Decision, Fate> {
        let place = ladder.place(cell).ok_or(Fate::UncertainOrder)?;
        let about = |middle_rad, orders| Ladder {
            middle_rad,
            orders,
            expected_rad: f64::INFINITY,
        };
        let middle_rad = ladder.middle_rad(place, expected_rad);
        let found = decide(clues, wrapped_rad, &about(middle_rad, ladder.orders));
        if ladder.orders > 1 {
            return Ok(found);
        }
        if (found.absolute_rad - middle_rad).abs() > ladder.reach_rad(place) {
            return Err(Fate::Disagreeing);
        }
        // A neighbouring order must not be certain by the other frequencies.
        if self.orders >= 3 {
            let other = decide(clues, wrapped_rad, &about(found.absolute_rad, 3));
            let sure = other.separation >= MIN_SEPARATION && other.agreed;
            if sure && (other.absolute_rad - found.absolute_rad).abs() > PI {
                return Err(Fate::Disagreeing);
            }
        }
        Ok(found)
    }
}
