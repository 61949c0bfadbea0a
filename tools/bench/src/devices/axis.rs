//! One stage axis: its position over time, its motion, and its faults.

use super::motion::{Dynamics, Profile};
use super::stage::NO_MEMORY;
use super::stage::errors::{
    MOTOR_OFF, MOTOR_UNDEFINED, NEGATIVE_LIMIT, NEGATIVE_SWITCH, NO_SUCH_MOVE, POSITIVE_LIMIT,
    POSITIVE_SWITCH, Refusal, of_axis,
};
use super::stage::settings::Settings;

/// One axis, in its own unit (degrees or millimetres).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisModel {
    /// Answer to `ID?`.
    pub name: &'static str,
    /// Unit number, the answer to `SN?`: 7 degrees, 2 millimetres.
    pub unit: u8,
    /// Speed and acceleration when switched on.
    pub dynamics: Dynamics,
    pub travel: (f64, f64),
    /// Position of the home switch, at which it stands when switched on.
    pub home: f64,
    /// Largest difference of the true position from the reported one.
    pub error: f64,
    /// Part of the error that is drawn anew at each approach, at most all of it; the rest is a function of the position.
    pub repeatability: f64,
    /// Backlash between motor and table: the table lags by half of it in the direction of motion.
    pub backlash: f64,
    /// Number of the move that never ends (stall).
    pub stalls_at_move: Option<u32>,
}

impl AxisModel {
    /// A connector of the controller to which no stage is connected.
    pub const NONE: Self = Self {
        name: NO_MEMORY,
        unit: 0,
        dynamics: Dynamics {
            speed: 0.0,
            acceleration: 0.0,
            deceleration: 0.0,
        },
        travel: (0.0, 0.0),
        home: 0.0,
        error: 0.0,
        repeatability: 0.0,
        backlash: 0.0,
        stalls_at_move: None,
    };

    /// Whether there is a stage.
    pub(super) fn is_connected(&self) -> bool {
        self.travel.0 < self.travel.1
    }
}

/// Distance of a hardware limit switch beyond the software limit, in units of the axis.
const SWITCH_BEYOND: f64 = 1.0;

/// Event at the end of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Arrival {
    /// Unintended arrival at a hardware limit switch.
    Switch(Refusal),
    /// Arrival at a software limit after a move without a target.
    SoftwareLimit(Refusal),
    /// Home is found: this position has the given reading from now on.
    Home(f64),
}

/// State and faults of an axis.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// Its number in the protocol.
    pub number: usize,
    pub model: AxisModel,
    pub profile: Profile,
    pub settings: Settings,
    /// Settings that persist across a reset.
    pub saved: Settings,
    pub motor_on: bool,
    pub moves: u32,
    /// Moves to another position.
    pub approaches: u32,
    pub stalled: bool,
    /// Fault: the move never ends.
    pub stalls: bool,
    /// Fault: added to the next reading of the position only.
    pub reads_beside_mm: f64,
    /// Fault: added to the next target only.
    pub overshoots_mm: f64,
    /// Fault: the next move ends halfway, at a limit switch.
    pub meets_limit: bool,
    /// Time at which the move ends, and the event then.
    pub arrival: Option<(f64, Arrival)>,
    /// Direction of the last move: 1 up, -1 down, 0 none yet.
    pub sent: f64,
    /// Origin of the client's positions, moved by `DH`.
    pub zero: f64,
    /// Reading that `DH` last assigned to the present position.
    pub defined_home: f64,
}

impl Axis {
    pub fn new(number: usize, model: AxisModel) -> Self {
        let settings = Settings::new(&model);
        Self {
            number,
            model,
            profile: Profile::rest(model.home),
            saved: settings.clone(),
            settings,
            motor_on: false,
            moves: 0,
            approaches: 0,
            stalled: false,
            stalls: false,
            reads_beside_mm: 0.0,
            overshoots_mm: 0.0,
            meets_limit: false,
            arrival: None,
            sent: 0.0,
            zero: 0.0,
            defined_home: 0.0,
        }
    }

    /// Its reported position.
    pub fn reading(&self, now_s: f64) -> f64 {
        self.profile.position(now_s) - self.zero
    }

    /// Its reported position after the move.
    pub fn destination(&self) -> f64 {
        self.profile.target() - self.zero
    }

    /// From now on its present position reads as `reading`.
    pub fn shift(&mut self, now_s: f64, reading: f64) {
        self.zero = self.profile.position(now_s) - reading;
    }

    /// Speed and accelerations of the next move, `speed` at most.
    fn dynamics(&self, speed: f64) -> Dynamics {
        Dynamics {
            speed,
            acceleration: self.settings.get("AC"),
            deceleration: self.settings.get("AG"),
        }
    }

    /// Whether a reading is within the software limits, if these are active.
    pub fn within_limits(&self, reading: f64) -> Result<(), Refusal> {
        let refused = |error| Err(of_axis(self.number, error));
        if !self.settings.bit("ZS", 0) {
            Ok(())
        } else if reading < self.settings.get("SL") {
            refused(NEGATIVE_LIMIT)
        } else if reading > self.settings.get("SR") {
            refused(POSITIVE_LIMIT)
        } else {
            Ok(())
        }
    }

    /// Whether a move is allowed.
    pub fn may_move(&self) -> Result<(), Refusal> {
        let refused = |error| Err(of_axis(self.number, error));
        if self.settings.get("QM") == 0.0 {
            refused(MOTOR_UNDEFINED)
        } else if self.settings.get("TJ") > 2.0 {
            refused(NO_SUCH_MOVE)
        } else if !self.motor_on {
            refused(MOTOR_OFF)
        } else {
            Ok(())
        }
    }

    /// The limit switches, down and up.
    pub fn switches(&self) -> (f64, f64) {
        let (lowest, highest) = self.model.travel;
        (lowest - SWITCH_BEYOND, highest + SWITCH_BEYOND)
    }

    /// Starts a move to a position at the speed set by `VA`.
    pub fn send(&mut self, now_s: f64, target: f64) {
        self.send_at(now_s, target, self.settings.get("VA"));
    }

    /// Starts a move to a position at another speed.
    pub fn send_at(&mut self, now_s: f64, target: f64, speed: f64) {
        let here = self.profile.position(now_s);
        let mut target = target + core::mem::take(&mut self.overshoots_mm);
        let up = target > here;
        if target != here {
            self.sent = if up { 1.0 } else { -1.0 };
            self.approaches += 1;
        }
        let (down_switch, up_switch) = self.switches();
        let mut trips = target < down_switch || target > up_switch;
        target = target.clamp(down_switch, up_switch);
        if core::mem::take(&mut self.meets_limit) {
            target = 0.5 * (here + target);
            trips = true;
        }
        self.profile = self.profile.redirect(now_s, target, self.dynamics(speed));
        let switch = if up { POSITIVE_SWITCH } else { NEGATIVE_SWITCH };
        self.arrival = trips.then(|| (self.profile.end_s(), Arrival::Switch(switch)));
        self.stalled |= self
            .model
            .stalls_at_move
            .is_some_and(|from| self.moves >= from);
        self.moves += 1;
    }

    /// Sets the event at the end of the move.
    pub fn arrive_as(&mut self, arrival: Arrival) {
        self.arrival.get_or_insert((self.profile.end_s(), arrival));
    }

    /// Brings it to rest.
    pub fn brake(&mut self, now_s: f64, deceleration: f64) {
        let dynamics = Dynamics {
            deceleration,
            ..self.dynamics(self.settings.get("VA"))
        };
        self.profile = self.profile.brake(now_s, dynamics);
        self.arrival = None;
    }

    /// Without current it stops immediately, by friction.
    pub fn switch_off(&mut self, now_s: f64) {
        self.motor_on = false;
        if self.profile.speed(now_s) != 0.0 {
            self.brake(now_s, self.settings.get("AE"));
        }
    }

    /// Reaction to `AB` or a fault by a bit setting: none, motor off, or stop.
    pub fn react(&mut self, now_s: f64, setting: &str) {
        if !self.settings.bit(setting, 0) {
            return;
        }
        if self.settings.bit(setting, 2) {
            self.brake(now_s, self.settings.get("AE"));
        }
        if self.settings.bit(setting, 1) {
            self.switch_off(now_s);
        }
    }

    /// Handles the events until now; returns an error, if one occurred.
    pub fn settle(&mut self, now_s: f64) -> Option<Refusal> {
        let (at_s, arrival) = self.arrival.take_if(|(at_s, _)| now_s >= *at_s)?;
        match arrival {
            Arrival::Switch(error) => {
                self.react(now_s, "ZH");
                self.settings
                    .bit("ZH", 0)
                    .then(|| of_axis(self.number, error))
            }
            Arrival::SoftwareLimit(error) => Some(of_axis(self.number, error)),
            Arrival::Home(reading) => {
                self.shift(at_s, reading);
                None
            }
        }
    }

    pub fn done(&self, now_s: f64) -> bool {
        !self.stalled && !self.stalls && now_s >= self.profile.end_s()
    }
}
