//! The cores of a bundle in a flat-field capture: sub-pixel centres and brightness.

mod fit;
mod flat_field;

use crate::head::CoreMap;
use flankscope_foundation::order::quantile;

use fit::{Fit, peaks};
pub use flat_field::FlatField;

/// Why no cores were found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FindError {
    /// No frame was added.
    #[error("no flat-field frame: at least one is needed")]
    NoFrame,
    /// Not pixels.
    #[error(
        "the flat field was summed in cells: cores show in single pixels only (pixel grid, binning 1)"
    )]
    Cells,
    /// Too bright.
    #[error(
        "{got} pixels of the flat field are saturated (above {limit_dn} counts), none may be: expose shorter"
    )]
    Saturated {
        /// Number found.
        got: usize,
        /// Counts that count as saturated.
        limit_dn: u16,
    },
    /// Too dark.
    #[error(
        "the flat field's bright cores have {got_dn:.1} counts above the dark level, at least {limit_dn} are needed: expose longer, face a white matt target"
    )]
    Dim {
        /// Counts of the 99th percentile.
        got_dn: f64,
        /// Least.
        limit_dn: f64,
    },
    /// Hardly any peaks.
    #[error(
        "{got} cores in the flat field, at least {limit} are needed: is there a bundle, in focus?"
    )]
    Few {
        /// Number found.
        got: usize,
        /// Least.
        limit: usize,
    },
    /// Cores too close to tell apart.
    #[error(
        "the cores lie {got_px:.2} px apart, at least {limit_px} px are needed to tell them apart: magnify more, or use the pixel grid"
    )]
    Pitch {
        /// Pitch.
        got_px: f64,
        /// Least.
        limit_px: f64,
    },
    /// The fit did not settle.
    #[error(
        "after {sweeps} sweeps core centres still move by {got_px:.4} px rms, {limit_px} px are needed: is the flat field in focus?"
    )]
    Unsettled {
        /// Sweeps done.
        sweeps: usize,
        /// Last step.
        got_px: f64,
        /// Largest step that counts as settled.
        limit_px: f64,
    },
}

/// Photon noise at this level still centres a core to 0.02 px.
const LEAST_BRIGHT_DN: f64 = 50.0;
const LEAST_CORES: usize = 7;
/// Closer than this, peaks of neighbouring cores merge for the blur of any relay lens.
const LEAST_PITCH_PX: f64 = 2.8;
/// Peaks below this part of the 99th percentile are halo or noise.
const FAINTEST_RATIO: f32 = 0.05;
/// Finds every core: peaks first, then centres, brightness and the common width of all cores' images together by least
/// squares (Gauss–Newton, core by core on the residual of all), because neighbouring images overlap.
///
/// # Errors
/// [`FindError`].
pub fn find(flat: &FlatField) -> Result<CoreMap, FindError> {
    let image = flat.mean()?;
    let bright_dn = quantile(
        &mut image.iter().map(|&v| f64::from(v)).collect::<Vec<_>>(),
        0.99,
    )
    .unwrap_or(0.0);
    if !(bright_dn >= LEAST_BRIGHT_DN) {
        return Err(FindError::Dim {
            got_dn: bright_dn,
            limit_dn: LEAST_BRIGHT_DN,
        });
    }
    let peaks = peaks(
        &image,
        flat.width,
        flat.height,
        FAINTEST_RATIO * bright_dn as f32,
    );
    let mut map = CoreMap {
        width_px: flat.width as u32,
        height_px: flat.height as u32,
        core_sigma_px: 0.0,
        gains: vec![1.0; peaks.len()],
        positions_px: peaks,
    };
    let few = |got| FindError::Few {
        got,
        limit: LEAST_CORES,
    };
    let pitch = map.pitch_px().ok_or_else(|| few(map.gains.len()))?;
    if !(pitch >= LEAST_PITCH_PX) {
        return Err(FindError::Pitch {
            got_px: pitch,
            limit_px: LEAST_PITCH_PX,
        });
    }
    let mut fit = Fit::new(&image, flat.width, flat.height, &map, pitch);
    fit.settle()?;
    // A dim core close to a bright one is no peak, but what is left when the others are taken away.
    if fit.add_hidden(pitch) > 0 {
        fit.settle()?;
    }
    fit.keep_into(&mut map, pitch);
    if map.gains.len() < LEAST_CORES {
        return Err(few(map.gains.len()));
    }
    Ok(map)
}
