//! The camera's sensor: counts, electrons, noise.

use serde::{Deserialize, Serialize};

use flankscope_foundation::textfile::{self, BadValue};

/// From counts to electrons: `electrons = (dn - offset_dn) gain_e_per_dn`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Electrons at saturation.
    pub full_well_e: f64,
    /// Electrons per count.
    pub gain_e_per_dn: f64,
    /// Standard deviation of the dark noise per pixel and frame.
    pub read_noise_e: f64,
    /// Counts without light.
    pub offset_dn: f64,
    /// Bits per pixel.
    pub bits: u32,
}

impl Sensor {
    /// For frames of unknown origin whose counts end at `full_scale_dn`: a 10 000 electron sensor that fills them, 10 electrons of read noise, no offset.
    ///
    /// Sensible for an 8 or 10 bit industrial camera; predicted uncertainties are then indicative only.
    pub fn assumed(full_scale_dn: u16) -> Self {
        Self {
            full_well_e: 10_000.0,
            gain_e_per_dn: 10_000.0 / f64::from(full_scale_dn.max(1)),
            read_noise_e: 10.0,
            offset_dn: 0.0,
            bits: (16 - full_scale_dn.leading_zeros()).max(8),
        }
    }

    /// Returns the sensor with a full well that this count reaches at the latest.
    #[must_use]
    pub fn ending_at(self, count_dn: u16) -> Self {
        let most_e = (f64::from(count_dn) - self.offset_dn) * self.gain_e_per_dn;
        match most_e > 0.0 {
            true => Self {
                full_well_e: self.full_well_e.min(most_e),
                ..self
            },
            false => self,
        }
    }

    /// The largest count.
    pub fn full_scale_dn(&self) -> u16 {
        full_scale_dn(self.bits.min(16)) as u16
    }

    /// Above this count a pixel is taken as saturated: 95 % of where either the bits or the full well end.
    pub fn saturation_limit_dn(&self) -> u16 {
        let full_well_dn = self.offset_dn + self.full_well_e / self.gain_e_per_dn;
        (0.95 * full_well_dn.min(full_scale_dn(self.bits))) as u16
    }

    /// Variance per pixel and frame that does not come from light: read noise and rounding, in electrons squared.
    pub fn dark_variance_e2(&self) -> f64 {
        self.read_noise_e * self.read_noise_e + self.gain_e_per_dn * self.gain_e_per_dn / 12.0
    }

    #[rustfmt::skip]
    pub(super) fn check(&self) -> Result<(), BadValue> {
        let Self { full_well_e, gain_e_per_dn, read_noise_e, offset_dn, bits } = self;
        let positive = |value: f64| value > 0.0 && value < 1e9;
        textfile::require(&[
            (positive(*full_well_e), "sensor.full_well_e", full_well_e, "must be positive electrons"),
            (positive(*gain_e_per_dn), "sensor.gain_e_per_dn", gain_e_per_dn, "must be positive electrons per count"),
            ((0.0..1e6).contains(read_noise_e), "sensor.read_noise_e", read_noise_e, "must be zero or positive electrons"),
            ((8..=16).contains(bits), "sensor.bits", bits, "must be 8 to 16"),
            ((0.0..0.5 * full_scale_dn(*bits)).contains(offset_dn), "sensor.offset_dn", offset_dn, "must be at least 0 and below half of full scale"),
        ])
    }
}

fn full_scale_dn(bits: u32) -> f64 {
    2f64.powi(bits as i32) - 1.0
}
