//! The axes of the stages, as in the station file and as sent to the controller.

use flankscope_foundation::textfile::BadValue;
use flankscope_protocol::{
    AxisPosition, FlowControl, HomeAt, Limits, Line, LinearAxis, Micrometres, MicrometresPerSecond,
    MicrometresPerSecondSquared, Microradians, MillidegreesPerSecond, MillidegreesPerSecondSquared,
    Parity, RotaryAxis, StageConfig, StageError, StageName, StageValue,
};
use serde::{Deserialize, Serialize};

/// The serial line between controller and stage controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StageLine {
    /// Bit/s.
    pub baud: u32,
    /// Data bits of a character.
    pub data_bits: u8,
    /// Parity of a character.
    pub parity: ParityBit,
    /// Stop bits of a character.
    pub stop_bits: u8,
    pub flow_control: Flow,
}

/// Parity of a character.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ParityBit {
    None,
    Even,
    Odd,
}

/// Flow control of the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Flow {
    None,
    RtsCts,
}

/// Signal that referencing searches for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Home {
    SwitchAndIndex,
    Switch,
    UpperLimit,
    LowerLimit,
}

/// The axis that turns die or head. If the file has this section, it must have all keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rotation {
    /// Its number at the stage controller.
    pub axis: u8,
    /// Model that the stage must report; `None`: not checked.
    #[serde(default)]
    pub model: Option<String>,
    /// Speed of a move, deg/s.
    pub speed_deg_s: f64,
    /// Acceleration and deceleration, deg/s².
    pub acceleration_deg_s2: f64,
    /// Both ends of the travel, deg.
    pub travel_deg: [f64; 2],
    /// Angle assigned to the reference position, deg.
    pub home_deg: f64,
    /// Speed of the search, deg/s.
    pub home_speed_deg_s: f64,
    /// Signal that the search looks for.
    pub home_at: Home,
}

/// The axis that raises the head. If the file has this section, it must have all keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vertical {
    /// Its number at the stage controller.
    pub axis: u8,
    /// Model that the stage must report; `None`: not checked.
    #[serde(default)]
    pub model: Option<String>,
    /// Speed of a move, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration and deceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Both ends of the travel, mm.
    pub travel_mm: [f64; 2],
    /// Position assigned to the reference, mm: the head is clear of the die there.
    pub home_mm: f64,
    /// Speed of the search, mm/s.
    pub home_speed_mm_s: f64,
    /// Signal that the search looks for.
    pub home_at: Home,
}

impl Default for StageLine {
    fn default() -> Self {
        Self {
            baud: StageConfig::DEFAULT.line.baud,
            data_bits: 8,
            parity: ParityBit::None,
            stop_bits: 1,
            flow_control: Flow::None,
        }
    }
}

impl Default for Rotation {
    /// [`StageConfig::DEFAULT`].
    fn default() -> Self {
        Self {
            axis: 1,
            model: None,
            speed_deg_s: 80.0,
            acceleration_deg_s2: 320.0,
            travel_deg: [-360.0, 360.0],
            home_deg: 0.0,
            home_speed_deg_s: 80.0,
            home_at: Home::SwitchAndIndex,
        }
    }
}

impl Default for Vertical {
    /// [`StageConfig::DEFAULT`].
    fn default() -> Self {
        Self {
            axis: 2,
            model: None,
            speed_mm_s: 100.0,
            acceleration_mm_s2: 800.0,
            travel_mm: [-150.0, 150.0],
            home_mm: 100.0,
            home_speed_mm_s: 100.0,
            home_at: Home::SwitchAndIndex,
        }
    }
}

impl StageLine {
    fn config(&self) -> Line {
        Line {
            baud: self.baud,
            data_bits: self.data_bits,
            parity: match self.parity {
                ParityBit::None => Parity::None,
                ParityBit::Even => Parity::Even,
                ParityBit::Odd => Parity::Odd,
            },
            stop_bits: self.stop_bits,
            flow: match self.flow_control {
                Flow::None => FlowControl::None,
                Flow::RtsCts => FlowControl::RtsCts,
            },
        }
    }
}

impl Home {
    fn config(self) -> HomeAt {
        match self {
            Self::SwitchAndIndex => HomeAt::SwitchAndIndex,
            Self::Switch => HomeAt::Switch,
            Self::UpperLimit => HomeAt::UpperLimit,
            Self::LowerLimit => HomeAt::LowerLimit,
        }
    }
}

/// Thousandths of a speed or an acceleration; saturates at the limits of the type, which are beyond every limit of the controller.
fn thousandths(value: f64) -> u32 {
    (value * 1e3).round() as u32
}

fn microradians(angle_deg: f64) -> Microradians {
    Microradians((angle_deg.to_radians() * 1e6).round() as i32)
}

fn micrometres(place_mm: f64) -> Micrometres {
    Micrometres((place_mm * 1e3).round() as i32)
}

/// The model as sent to the controller; [`check`] has verified that nothing of it is lost.
fn model(of: &Option<String>) -> Option<StageName> {
    StageName::of(of.as_ref()?.as_bytes())
}

/// The stage configuration that is sent to the controller.
pub(super) fn config(line: &StageLine, turn: &Rotation, lift: &Vertical) -> StageConfig {
    StageConfig {
        line: line.config(),
        rotation: RotaryAxis {
            number: turn.axis,
            model: model(&turn.model),
            speed: MillidegreesPerSecond(thousandths(turn.speed_deg_s)),
            acceleration: MillidegreesPerSecondSquared(thousandths(turn.acceleration_deg_s2)),
            from: microradians(turn.travel_deg[0]),
            to: microradians(turn.travel_deg[1]),
            home: microradians(turn.home_deg),
            home_speed: MillidegreesPerSecond(thousandths(turn.home_speed_deg_s)),
            home_at: turn.home_at.config(),
        },
        vertical: LinearAxis {
            number: lift.axis,
            model: model(&lift.model),
            speed: MicrometresPerSecond(thousandths(lift.speed_mm_s)),
            acceleration: MicrometresPerSecondSquared(thousandths(lift.acceleration_mm_s2)),
            from: micrometres(lift.travel_mm[0]),
            to: micrometres(lift.travel_mm[1]),
            home: micrometres(lift.home_mm),
            home_speed: MicrometresPerSecond(thousandths(lift.home_speed_mm_s)),
            home_at: lift.home_at.config(),
        },
    }
}

/// Checks all limits of the controller, with errors that name the keys of the file.
pub(super) fn check(line: &StageLine, turn: &Rotation, lift: &Vertical) -> Result<(), BadValue> {
    let said = |what| said(what, line, turn, lift);
    for what in [Microradians::VALUES, Micrometres::VALUES].as_flattened() {
        let Said {
            key, value, unit, ..
        } = said(*what);
        if !value.is_finite() {
            return Err(BadValue::new(
                key,
                value,
                format!("a finite number of {unit}"),
            ));
        }
    }
    for (key, written) in [
        ("stages.rotation.model", &turn.model),
        ("stages.vertical.model", &lift.model),
    ] {
        let Some(written) = written else { continue };
        let name = StageName::of(written.as_bytes());
        if !name.is_some_and(|name| name.is_model() && name.text() == written.as_bytes()) {
            let right = format!(
                "1 to {} printable ASCII characters without a comma, as the stage answers to ID?",
                StageName::LONGEST_MODEL
            );
            return Err(BadValue::new(key, written, right));
        }
    }
    let Err(error) = config(line, turn, lift).validate(&Limits::DEFAULT) else {
        return Ok(());
    };
    Err(match error {
        StageError::Outside { what, min, max, .. } => {
            let of = said(what);
            let right = format!("{} to {} {}", of.back(min), of.back(max), of.unit);
            of.bad(right.trim_end().to_owned())
        }
        StageError::Inverted { what, limit, .. } => {
            let of = said(what);
            let right = format!(
                "an upper end above the lower one, {} {}",
                of.back(limit),
                of.unit
            );
            of.bad(right)
        }
        StageError::TooSlow {
            what, got, limit, ..
        } => {
            let [got_s, limit_s] = [got, limit].map(|time| f64::from(time.get()) / 1e6);
            said(what).bad(format!(
                "a speed at which the whole travel, and a quarter of it, takes at most {limit_s:.0} s; at this one it takes {got_s:.0} s"
            ))
        }
        StageError::SameNumber { got } => {
            let right = "another number than that of the rotary axis";
            BadValue::new("stages.vertical.axis", got, right)
        }
        StageError::Model { .. } => BadValue::new("stages", error.to_string(), "another model"),
        StageError::LineForm { got } => {
            let right = "8 data bits, no parity, 1 stop bit, no flow control: the controller's port has nothing else";
            BadValue::new("stages.line.baud", got.to_string(), right)
        }
        StageError::Version { .. } => BadValue::new(
            "stages",
            error.to_string(),
            "one release of host and firmware",
        ),
    })
}

/// A value with its key, as in the file.
struct Said {
    key: &'static str,
    value: f64,
    unit: &'static str,
    /// Wire units per unit of the file.
    scale: f64,
}

impl Said {
    /// A wire value in the file's unit, rounded to a thousandth.
    fn back(&self, wire: i64) -> f64 {
        (wire as f64 / self.scale * 1e3).round() / 1e3
    }

    fn bad(&self, right: String) -> BadValue {
        BadValue::new(self.key, self.value, right)
    }
}

#[rustfmt::skip]
fn said(what: StageValue, line: &StageLine, turn: &Rotation, lift: &Vertical) -> Said {
    let urad_per_deg = 1e6 * std::f64::consts::PI / 180.0;
    let (key, value, unit, scale) = match what {
        StageValue::Baud => ("stages.line.baud", f64::from(line.baud), "baud", 1.0),
        StageValue::RotationNumber => ("stages.rotation.axis", f64::from(turn.axis), "", 1.0),
        StageValue::RotationSpeed => ("stages.rotation.speed_deg_s", turn.speed_deg_s, "deg/s", 1e3),
        StageValue::RotationAcceleration => ("stages.rotation.acceleration_deg_s2", turn.acceleration_deg_s2, "deg/s2", 1e3),
        StageValue::RotationFrom => ("stages.rotation.travel_deg", turn.travel_deg[0], "deg at the lower end", urad_per_deg),
        StageValue::RotationTo => ("stages.rotation.travel_deg", turn.travel_deg[1], "deg at the upper end", urad_per_deg),
        StageValue::RotationHome => ("stages.rotation.home_deg", turn.home_deg, "deg, within the travel", urad_per_deg),
        StageValue::RotationHomeSpeed => ("stages.rotation.home_speed_deg_s", turn.home_speed_deg_s, "deg/s", 1e3),
        StageValue::VerticalNumber => ("stages.vertical.axis", f64::from(lift.axis), "", 1.0),
        StageValue::VerticalSpeed => ("stages.vertical.speed_mm_s", lift.speed_mm_s, "mm/s", 1e3),
        StageValue::VerticalAcceleration => ("stages.vertical.acceleration_mm_s2", lift.acceleration_mm_s2, "mm/s2", 1e3),
        StageValue::VerticalFrom => ("stages.vertical.travel_mm", lift.travel_mm[0], "mm at the lower end", 1e3),
        StageValue::VerticalTo => ("stages.vertical.travel_mm", lift.travel_mm[1], "mm at the upper end", 1e3),
        StageValue::VerticalHome => ("stages.vertical.home_mm", lift.home_mm, "mm, within the travel", 1e3),
        StageValue::VerticalHomeSpeed => ("stages.vertical.home_speed_mm_s", lift.home_speed_mm_s, "mm/s", 1e3),
    };
    Said { key, value, unit, scale }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_file_the_axes_are_the_protocols_own() {
        let of = config(
            &StageLine::default(),
            &Rotation::default(),
            &Vertical::default(),
        );
        assert_eq!(of, StageConfig::DEFAULT);
    }
}
