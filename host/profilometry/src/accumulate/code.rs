//! Frames of a code to one difference per cell and bit.
//!
//! A bit is lit where its frame is brighter than the mean of the finest fringes (half the light, whatever else shines), or than
//! its complement. The finest fringes come last before the code, so that their sums of the same exposure are at hand; an exposure
//! of which they saturate in a cell is left out, as it is of the fringes. A bit's own frame may saturate where its projector shows
//! white brighter than the fringes' crests: it is lit then.

/// Sums of one bit over the exposures used, in counts per frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BitSums {
    /// Light less its threshold: positive where the bit is lit.
    pub difference: Vec<f32>,
    /// Amplitude of the finest fringes in the same exposures.
    pub amplitude: Vec<f32>,
}

impl BitSums {
    pub fn new(cells: usize) -> Self {
        Self {
            difference: vec![0.0; cells],
            amplitude: vec![0.0; cells],
        }
    }
}

/// Frame of a bit: the bit or its complement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BitPart {
    /// The only one.
    Alone,
    /// The first of two.
    Lit,
    /// The second of two.
    Complement,
}

/// Sums of the finest fringes of one exposure, cell by cell.
#[derive(Clone, Copy)]
pub(super) struct Finest<'a> {
    pub re: &'a [f32],
    pub im: &'a [f32],
    pub sum: &'a [f32],
    pub steps: u32,
}

/// Adds what a bit's frames differ by.
#[inline(always)]
pub(super) fn add_difference(
    finest: Finest<'_>,
    of_cell: impl Fn(usize, f32) -> f32,
    difference: &mut [f32],
    amplitude: &mut [f32],
) {
    let share = 1.0 / finest.steps as f32;
    for i in 0..difference.len() {
        let mean = finest.sum[i] * share;
        let off = of_cell(i, mean);
        // The mean is infinite where a fringe was saturated; the difference no number where a bit's frame was and says nothing.
        let good = off.is_finite() && mean.is_finite();
        let swing =
            2.0 * share * (finest.re[i] * finest.re[i] + finest.im[i] * finest.im[i]).sqrt();
        difference[i] += if good { off } else { 0.0 };
        amplitude[i] += if good { swing } else { 0.0 };
    }
}
