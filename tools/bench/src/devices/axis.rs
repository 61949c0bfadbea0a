//! One stage axis: where it is at a time, how it moves, and what can go wrong with it.

use super::motion::{Dynamics, Profile};
use super::stage::errors::{
    MOTOR_OFF, MOTOR_UNDEFINED, NEGATIVE_LIMIT, NEGATIVE_SWITCH, NO_SUCH_MOVE, POSITIVE_LIMIT,
    POSITIVE_SWITCH, Refusal, of_axis,
};
use super::stage::settings::Settings;

/// One axis, in its own unit (degrees or millimetres).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisModel {
    /// What it answers to `ID?`.
    pub name: &'static str,
    /// Unit number it answers to `SN?`: 7 degrees, 2 millimetres.
    pub unit: u8,
    /// Speed and acceleration when switched on.
    pub dynamics: Dynamics,
    /// Travel.
    pub travel: (f64, f64),
    /// Position of the home switch, where it stands when switched on.
    pub home: f64,
    /// The true position differs from the reported one by up to this much either way, always alike at one position.
    pub error: f64,
    /// Play between motor and table: the table stays behind by half of it, whichever way it came.
    pub backlash: f64,
    /// It never comes to a stand once it has been sent this many times (stall).
    pub stalls_at_move: Option<u32>,
}

/// A hardware limit switch stands this far beyond the travel that the software limits allow, in units of the axis.
const SWITCH_BEYOND: f64 = 1.0;

/// What comes to pass at the end of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Arrival {
    /// At a hardware limit switch that nobody sent it to.
    Switch(Refusal),
    /// At a software limit, after a move without an end.
    SoftwareLimit(Refusal),
    /// Home is found: the place reads so from now on.
    Home(f64),
}

/// Where an axis is on its way, and what is wrong with it.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    /// Its number on the wire.
    pub number: usize,
    pub model: AxisModel,
    pub profile: Profile,
    pub settings: Settings,
    /// Settings that outlive a reset.
    pub saved: Settings,
    pub motor_on: bool,
    pub moves: u32,
    pub stalled: bool,
    /// It never comes to a stand.
    pub stalls: bool,
    /// Added to the next reading of the position, and to no other.
    pub reads_beside_mm: f64,
    /// Added to the next target, and to no other.
    pub overshoots_mm: f64,
    /// The next move ends halfway, at a limit switch.
    pub meets_limit: bool,
    /// When the move ends and what then.
    pub arrival: Option<(f64, Arrival)>,
    /// Which way it was sent last: 1 up, -1 down, 0 not yet.
    pub sent: f64,
    /// Where the client counts from, moved by `DH`.
    pub zero: f64,
    /// Position that `DH` last gave to the place where it stood.
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

    /// What its position reads as.
    pub fn reading(&self, now_s: f64) -> f64 {
        self.profile.position(now_s) - self.zero
    }

    /// What its position will read as once it stands.
    pub fn destination(&self) -> f64 {
        self.profile.target() - self.zero
    }

    /// From here on the place where it stands reads as `reading`.
    pub fn shift(&mut self, now_s: f64, reading: f64) {
        self.zero = self.profile.position(now_s) - reading;
    }

    /// Speed and ramps of the next move, `speed` at most.
    fn dynamics(&self, speed: f64) -> Dynamics {
        Dynamics {
            speed,
            acceleration: self.settings.get("AC"),
            deceleration: self.settings.get("AG"),
        }
    }

    /// Whether a reading is within the software limits, where these are watched.
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

    /// Whether it may be sent anywhere.
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

    /// Sends it to a place by `VA`.
    pub fn send(&mut self, now_s: f64, target: f64) {
        self.send_at(now_s, target, self.settings.get("VA"));
    }

    /// Sends it to a place at another speed.
    pub fn send_at(&mut self, now_s: f64, target: f64, speed: f64) {
        let here = self.profile.position(now_s);
        let mut target = target + core::mem::take(&mut self.overshoots_mm);
        let up = target > here;
        if target != here {
            self.sent = if up { 1.0 } else { -1.0 };
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

    /// What comes to pass where the move ends.
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

    /// Without current it comes to rest at once, by friction.
    pub fn switch_off(&mut self, now_s: f64) {
        self.motor_on = false;
        if self.profile.speed(now_s) != 0.0 {
            self.brake(now_s, self.settings.get("AE"));
        }
    }

    /// What `AB`, or a fault, does by a setting in bits: nothing, motor off, or a stop.
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

    /// What came to pass until now; an error, if it was one.
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
