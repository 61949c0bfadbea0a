//! One stage axis: where it is at a time, how it moves, and what can go wrong with it.

use super::motion::{Dynamics, Profile};

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
    /// It never comes to a stand once it has been sent this many times (stall).
    pub stalls_at_move: Option<u32>,
}

/// Where an axis is on its way, and what is wrong with it.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub model: AxisModel,
    pub profile: Profile,
    pub dynamics: Dynamics,
    pub motor_on: bool,
    pub moves: u32,
    /// Value the home switch is given by `SH`.
    pub home_preset: f64,
    pub stalled: bool,
    /// It never comes to a stand.
    pub stalls: bool,
    /// Added to the next reading of the position, and to no other.
    pub reads_beside_mm: f64,
    /// Added to the next target, and to no other.
    pub overshoots_mm: f64,
    /// The next move ends halfway, at a limit switch.
    pub meets_limit: bool,
    /// When it trips the limit switch that it is under way to, and the error that the controller then has.
    pub trips: Option<(f64, (u32, &'static str))>,
    /// Where the client counts from, moved by `DH`.
    pub zero: f64,
}

impl Axis {
    pub fn new(model: AxisModel) -> Self {
        Self {
            model,
            profile: Profile::rest(model.home),
            dynamics: model.dynamics,
            motor_on: false,
            moves: 0,
            home_preset: model.home,
            stalled: false,
            stalls: false,
            reads_beside_mm: 0.0,
            overshoots_mm: 0.0,
            meets_limit: false,
            trips: None,
            zero: 0.0,
        }
    }

    /// From here on the place where it stands reads as `reading`.
    pub fn shift(&mut self, now_s: f64, reading: f64) {
        self.zero = self.profile.position(now_s) - reading;
    }

    pub fn within_travel(&self, target: f64) -> Result<(), (u32, &'static str)> {
        let (lowest, highest) = self.model.travel;
        if target < lowest {
            return Err((7, "NEGATIVE SOFTWARE LIMIT DETECTED"));
        }
        if target > highest {
            return Err((6, "POSITIVE SOFTWARE LIMIT DETECTED"));
        }
        Ok(())
    }

    pub fn send(&mut self, now_s: f64, target: f64) {
        let here = self.profile.position(now_s);
        let mut target = target + core::mem::take(&mut self.overshoots_mm);
        let up = target > here;
        let limit = core::mem::take(&mut self.meets_limit);
        if limit {
            target = 0.5 * (here + target);
        }
        self.profile = self.profile.redirect(now_s, target, self.dynamics);
        self.trips = limit.then(|| {
            let error = if up {
                (4, "POSITIVE HARDWARE LIMIT DETECTED")
            } else {
                (5, "NEGATIVE HARDWARE LIMIT DETECTED")
            };
            (self.profile.end_s(), error)
        });
        self.stalled |= self
            .model
            .stalls_at_move
            .is_some_and(|from| self.moves >= from);
        self.moves += 1;
    }

    pub fn done(&self, now_s: f64) -> bool {
        !self.stalled && !self.stalls && now_s >= self.profile.end_s()
    }
}
