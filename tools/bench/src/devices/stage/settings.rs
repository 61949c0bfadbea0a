//! Settings of an axis: values of the two-letter commands that are only stored and read back.
//!
//! Ranges are those of the ESP300 and ESP301 user's manuals, section 3; initial values are the stage's own.

use std::collections::BTreeMap;

use super::errors::{
    ACCELERATION_EXCEEDED, PARAMETER_OUT_OF_RANGE, Refusal, VELOCITY_EXCEEDED, of_axis,
};
use crate::devices::AxisModel;

/// The controller holds encoder counts in 32 bits.
const MOST: f64 = 2e9;

/// Number format of a setting.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Real,
    Whole,
    /// With the suffix H.
    Hexadecimal,
}

/// Allowed values of a setting.
#[derive(Clone, Copy)]
enum Range {
    From(f64, f64),
    /// Above 0, and at most the value of another setting.
    UpTo(&'static str, Refusal),
    AtLeast(&'static str),
}

struct Setting {
    name: &'static str,
    form: Form,
    range: Range,
    /// Value after switching on.
    initial: fn(&AxisModel) -> f64,
}

const fn real(name: &'static str, range: Range, initial: fn(&AxisModel) -> f64) -> Setting {
    let form = Form::Real;
    Setting {
        name,
        form,
        range,
        initial,
    }
}

const fn whole(
    name: &'static str,
    lowest: f64,
    highest: f64,
    initial: fn(&AxisModel) -> f64,
) -> Setting {
    Setting {
        name,
        form: Form::Whole,
        range: Range::From(lowest, highest),
        initial,
    }
}

const fn bits(name: &'static str, initial: fn(&AxisModel) -> f64) -> Setting {
    Setting {
        name,
        form: Form::Hexadecimal,
        range: Range::From(0.0, 65_535.0),
        initial,
    }
}

const ANY: Range = Range::From(0.0, MOST);
const SPEED: Range = Range::UpTo("VU", VELOCITY_EXCEEDED);
const RAMP: Range = Range::UpTo("AU", ACCELERATION_EXCEEDED);

#[rustfmt::skip]
const SETTINGS: &[Setting] = &[
    // Trajectory.
    real("VU", ANY, |axis| axis.dynamics.speed),
    real("VA", SPEED, |axis| axis.dynamics.speed),
    real("VB", Range::From(0.0, MOST), |_| 0.0),
    real("AU", ANY, |axis| axis.dynamics.acceleration.max(axis.dynamics.deceleration)),
    real("AC", RAMP, |axis| axis.dynamics.acceleration),
    real("AG", RAMP, |axis| axis.dynamics.deceleration),
    real("AE", Range::AtLeast("AG"), |axis| axis.dynamics.deceleration),
    real("JK", ANY, |_| 0.0),
    real("JH", SPEED, |axis| axis.dynamics.speed / 2.0),
    real("JW", SPEED, |axis| axis.dynamics.speed / 10.0),
    real("OH", SPEED, |axis| axis.dynamics.speed),
    real("OL", SPEED, |axis| axis.dynamics.speed / 10.0),
    whole("OM", 0.0, 6.0, |_| 1.0),
    // Reading at the home switch.
    real("SH", Range::From(-MOST, MOST), |axis| axis.home),
    real("BA", ANY, |_| 0.0),
    real("CO", ANY, |_| 0.0),
    // 1 trapezoid, 2 S-curve, 3 jog, 4 to 6 slave of another axis.
    whole("TJ", 1.0, 6.0, |_| 1.0),
    // Limits.
    real("SL", Range::From(-MOST, 0.0), |axis| axis.travel.0),
    real("SR", Range::From(0.0, MOST), |axis| axis.travel.1),
    real("FE", ANY, |_| 1.0),
    // Motor and feedback.
    whole("SN", 0.0, 11.0, |axis| f64::from(axis.unit)),
    real("SU", Range::From(2e-9, MOST), |_| 0.0005),
    real("FR", Range::From(2e-9, MOST), |_| 0.01),
    whole("FP", 0.0, 7.0, |_| 6.0),
    whole("QM", 0.0, 4.0, |axis| f64::from(u8::from(axis.is_connected()))),
    real("QI", ANY, |_| 1.0),
    real("QV", ANY, |_| 24.0),
    whole("QS", 1.0, 1000.0, |_| 1.0),
    real("QG", ANY, |_| 1.0),
    real("QT", Range::From(0.0, 20.0), |_| 7.0),
    real("GR", Range::From(-MOST, MOST), |_| 1.0),
    // Servo loop.
    real("KP", ANY, |_| 10.0),
    real("KI", ANY, |_| 1.0),
    real("KD", ANY, |_| 5.0),
    real("KS", ANY, |_| 10.0),
    real("VF", ANY, |_| 0.0),
    real("AF", ANY, |_| 0.0),
    whole("DB", 0.0, MOST, |_| 0.0),
    whole("CL", 0.0, 60_000.0, |_| 0.0),
    // Reactions to a fault: bit 0 enables, bit 1 motor off, bit 2 stop with AE.
    bits("ZA", |_| 291.0),
    bits("ZB", |_| 256.0),
    bits("ZE", |_| 3.0),
    bits("ZF", |_| 3.0),
    bits("ZH", |_| 35.0),
    bits("ZS", |_| 5.0),
];

/// The settings of one axis.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Settings(BTreeMap<&'static str, f64>);

impl Settings {
    pub fn new(model: &AxisModel) -> Self {
        let initial = |setting: &Setting| (setting.name, (setting.initial)(model));
        Self(SETTINGS.iter().map(initial).collect())
    }

    /// The value of a setting in the table; 0 for any other.
    pub fn get(&self, name: &str) -> f64 {
        self.0.get(name).copied().unwrap_or_default()
    }

    /// Whether a bit of a setting is set.
    pub fn bit(&self, name: &str, bit: u32) -> bool {
        (self.get(name) as u32) >> bit & 1 == 1
    }

    /// Answer to a query; `None` if no setting has this name.
    pub fn answer(&self, name: &str) -> Option<String> {
        let setting = SETTINGS.iter().find(|setting| setting.name == name)?;
        let value = self.get(name);
        Some(match setting.form {
            Form::Real if value.fract() == 0.0 => format!("{value:.1}"),
            Form::Real | Form::Whole => value.to_string(),
            Form::Hexadecimal => format!("{:X}H", value as u32),
        })
    }

    /// Sets a value; `None` if no setting has this name.
    pub fn set(&mut self, axis: usize, name: &str, text: &str) -> Option<Result<(), Refusal>> {
        let setting = SETTINGS.iter().find(|setting| setting.name == name)?;
        Some(self.checked(axis, setting, text).map(|value| {
            self.0.insert(setting.name, value);
        }))
    }

    fn checked(&self, axis: usize, setting: &Setting, text: &str) -> Result<f64, Refusal> {
        let out_of_range = of_axis(axis, PARAMETER_OUT_OF_RANGE);
        let value = match text.strip_suffix(['H', 'h']) {
            Some(digits) if setting.form == Form::Hexadecimal => u32::from_str_radix(digits, 16)
                .map(f64::from)
                .map_err(|_| out_of_range)?,
            _ => super::commands::number(text)?,
        };
        if setting.form != Form::Real && value.fract() != 0.0 {
            return Err(out_of_range);
        }
        let (within, otherwise) = match setting.range {
            Range::From(lowest, highest) => ((lowest..=highest).contains(&value), out_of_range),
            Range::UpTo(most, otherwise) => (
                value > 0.0 && value <= self.get(most),
                if value > 0.0 {
                    of_axis(axis, otherwise)
                } else {
                    out_of_range
                },
            ),
            Range::AtLeast(least) => (value >= self.get(least) && value <= MOST, out_of_range),
        };
        if within { Ok(value) } else { Err(otherwise) }
    }
}
