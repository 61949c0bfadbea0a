//! Implementation of the stage controller's commands.

use super::super::axis::{Arrival, Axis};
use super::StageModel;
use super::errors::{
    MISSING_AXIS, MISSING_PARAMETER, MOTOR_UNDEFINED, NEGATIVE_LIMIT, NO_SUCH_AXIS,
    NO_SUCH_PROGRAM, NOT_ALLOWED, OUT_OF_RANGE, PARAMETER_OUT_OF_RANGE, POSITIVE_LIMIT, Refusal,
    UNKNOWN, of_axis,
};

const VERSION: &str = "ESP301 Version 3.0.1 6/1/99";
/// Size of the controller's error buffer; the oldest error is read first.
const ERRORS_KEPT: usize = 10;
const LONGEST_WAIT_MS: f64 = 60_000.0;
const PROGRAMS: std::ops::RangeInclusive<u32> = 1..=100;
/// Memory for stored programs, bytes.
const PROGRAM_MEMORY: usize = 61_440;

/// Commands in the manuals that are not emulated: groups, digital I/O, data acquisition, master-slave modes, labels and starts of
/// programs, events, the front panel, the IEEE-488 address.
const NOT_EMULATED: &[&str] = &[
    "BG", "BK", "BL", "BM", "BN", "BO", "BP", "BQ", "DC", "DD", "DE", "DF", "DG", "DL", "DO", "EO",
    "ES", "HA", "HB", "HC", "HD", "HE", "HF", "HJ", "HL", "HN", "HO", "HP", "HQ", "HS", "HV", "HW",
    "HX", "HZ", "JL", "LC", "RQ", "SA", "SB", "SI", "SK", "SS", "UH", "UL",
];

/// Result of a command.
pub(super) enum Answer {
    None,
    SetOff,
    Text(String),
}

/// A wait that delays all following commands.
pub(super) enum Wait {
    /// Until this axis, or every axis, has stopped, and a delay after that.
    Stop {
        axis: Option<usize>,
        then_ms: u64,
    },
    /// Until this axis passes this position.
    Crossing {
        axis: usize,
        place: f64,
        from_below: bool,
    },
    Time(u64),
    /// Until these commands are finished.
    Program(String),
}

/// A number of the protocol, which must be finite.
pub(super) fn number(text: &str) -> Result<f64, Refusal> {
    let value = text.parse::<f64>().ok();
    value
        .filter(|value| value.is_finite())
        .ok_or(MISSING_PARAMETER)
}

/// Axis number, name, and argument of a command; blanks are ignored.
fn parts(command: &str) -> Option<(Option<u32>, String, String)> {
    let text: String = command.chars().filter(|c| !c.is_whitespace()).collect();
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (front, rest) = text.split_at(digits);
    let (name, behind) = rest.split_at_checked(2)?;
    let front = (!front.is_empty()).then(|| front.parse().unwrap_or(u32::MAX));
    Some((front, name.to_ascii_uppercase(), behind.to_owned()))
}

/// Whether a command delays those after it.
pub(super) fn holds(command: &str) -> bool {
    parts(command).is_some_and(|(_, name, _)| matches!(name.as_str(), "WS" | "WP" | "WT" | "EX"))
}

fn yes_or_no(yes: bool) -> Answer {
    Answer::Text(u8::from(yes).to_string())
}

impl StageModel {
    /// Executes one line of commands at `now_us` and returns the answer, if any, and whether a motion started.
    pub(super) fn line(&mut self, now_us: u64, line: &str) -> (String, bool) {
        let now_s = now_us as f64 * 1e-6;
        self.settle(now_s);
        let (mut answers, mut set_off) = (String::new(), false);
        let commands = line.split(';').map(str::trim);
        for command in commands.filter(|command| !command.is_empty()) {
            match self.command(now_s, command) {
                Ok(Answer::None) => {}
                Ok(Answer::SetOff) => set_off = true,
                Ok(Answer::Text(text)) => {
                    answers.push_str(&text);
                    answers.push_str("\r\n");
                }
                Err(error) => self.note(error),
            }
        }
        (answers, set_off)
    }

    /// The wait that `command` starts; `None` if it is invalid or only recorded.
    pub(super) fn hold(&mut self, now_us: u64, command: &str) -> Option<Wait> {
        let now_s = now_us as f64 * 1e-6;
        self.settle(now_s);
        if let Some(program) = self.recording {
            self.record(program, command);
            return None;
        }
        let wait = self.wait(now_s, command);
        wait.map_err(|error| self.note(error)).ok()
    }

    /// Whether this axis, or every axis, has stopped; a stalled one never does.
    pub(super) fn stands(&self, now_s: f64, axis: Option<usize>) -> bool {
        let mut axes = self.axes.iter().enumerate();
        axes.all(|(n, one)| axis.is_some_and(|axis| axis != n) || one.done(now_s))
    }

    fn note(&mut self, error: Refusal) {
        if self.errors.len() < ERRORS_KEPT {
            self.errors.push_back(error);
        }
    }

    fn settle(&mut self, now_s: f64) {
        for n in 0..self.axes.len() {
            if let Some(error) = self.axes[n].settle(now_s) {
                self.note(error);
            }
        }
    }

    fn record(&mut self, program: u32, command: &str) {
        let lines = self.programs.entry(program).or_default();
        lines.push(command.trim().to_owned());
    }

    fn axis(&mut self, front: Option<u32>) -> Result<&mut Axis, Refusal> {
        let n = front.ok_or(MISSING_AXIS)? as usize;
        let axis = n.checked_sub(1).and_then(|n| self.axes.get_mut(n));
        axis.ok_or(NO_SUCH_AXIS)
    }

    fn wait(&mut self, now_s: f64, command: &str) -> Result<Wait, Refusal> {
        let (front, name, behind) = parts(command).ok_or(UNKNOWN)?;
        let ms = |text: &str| match number(text)? {
            ms if (0.0..=LONGEST_WAIT_MS).contains(&ms) => Ok(ms as u64),
            _ => Err(OUT_OF_RANGE),
        };
        match name.as_str() {
            "WT" => Ok(Wait::Time(ms(&behind)?)),
            "WS" => {
                let axis = match front {
                    Some(_) => Some(self.axis(front)?.number - 1),
                    None => None,
                };
                let then_ms = if behind.is_empty() { 0 } else { ms(&behind)? };
                Ok(Wait::Stop { axis, then_ms })
            }
            "WP" => {
                let axis = self.axis(front)?;
                let place = number(&behind)? + axis.zero;
                let (here, there) = (axis.profile.position(now_s), axis.profile.target());
                if place < here.min(there) || place > here.max(there) {
                    return Err(of_axis(axis.number, PARAMETER_OUT_OF_RANGE));
                }
                Ok(Wait::Crossing {
                    axis: axis.number - 1,
                    place,
                    from_below: there >= here,
                })
            }
            _ => {
                let program = front.ok_or(MISSING_PARAMETER)?;
                let lines = self.programs.get(&program).ok_or(NO_SUCH_PROGRAM)?;
                // A program that executes a program would never end.
                if lines.iter().any(|line| holds(line) && line.contains("EX")) {
                    return Err(NOT_ALLOWED);
                }
                let times = match behind.as_str() {
                    "" => 1,
                    text => number(text)?.clamp(1.0, 1000.0) as usize,
                };
                Ok(Wait::Program(vec![lines.join(";"); times].join(";")))
            }
        }
    }

    fn command(&mut self, now_s: f64, command: &str) -> Result<Answer, Refusal> {
        if command.eq_ignore_ascii_case("*IDN?") {
            return Ok(Answer::Text(VERSION.into()));
        }
        let (front, name, behind) = parts(command).ok_or(UNKNOWN)?;
        let (name, behind) = (name.as_str(), behind.as_str());
        if let Some(program) = self.recording {
            let question = behind == "?" || matches!(name, "TB" | "TE" | "TP" | "MD" | "TS" | "TX");
            if name == "QP" {
                self.recording = None;
                return Ok(Answer::None);
            } else if !question {
                self.record(program, command);
                return Ok(Answer::None);
            }
        }
        if let Some(answer) = self.of_controller(now_s, front, name, behind) {
            return answer;
        }
        if NOT_EMULATED.contains(&name) {
            return Err(NOT_ALLOWED);
        }
        if !AXIS_COMMANDS.contains(&name) && self.axes[0].settings.answer(name).is_none() {
            return Err(UNKNOWN);
        }
        let axis = self.axis(front)?;
        if let Some(answer) = of_motion(axis, now_s, name, behind) {
            return answer;
        }
        if let Some(answer) = of_status(axis, now_s, name, behind) {
            return answer;
        }
        match behind {
            "?" => axis.settings.answer(name).map(Answer::Text).ok_or(UNKNOWN),
            _ => {
                let number = axis.number;
                let done = axis.settings.set(number, name, behind).ok_or(UNKNOWN)?;
                done.map(|()| Answer::None)
            }
        }
    }

    /// Commands without an axis.
    fn of_controller(
        &mut self,
        now_s: f64,
        front: Option<u32>,
        name: &str,
        behind: &str,
    ) -> Option<Result<Answer, Refusal>> {
        let text = |text: String| Ok(Answer::Text(text));
        Some(match (name, behind) {
            ("VE", "" | "?") => text(VERSION.into()),
            // Read-only values may be requested without a question mark, as some clients do.
            ("TE", "" | "?") => text(
                self.errors
                    .pop_front()
                    .map_or(0, |error| error.0)
                    .to_string(),
            ),
            ("TB", "" | "?") => {
                let (code, message) = self.errors.pop_front().unwrap_or((0, "NO ERROR DETECTED"));
                text(format!("{code}, {:.0}, {message}", now_s * 1e3))
            }
            ("TS", "" | "?") => text(char::from(self.status(now_s)).to_string()),
            ("TX", "" | "?") => {
                let moving = u8::from(!self.stands(now_s, None));
                text(char::from(0x40 | moving << 4).to_string())
            }
            ("PH", "" | "?") => text(self.switches(now_s)),
            // Drivers and stages of axes 1 and 2 are present.
            ("ZU", "" | "?") => text("303H".into()),
            ("ZZ", "?") => text("0H".into()),
            ("XM", "" | "?") => {
                let used: usize = self
                    .programs
                    .values()
                    .flatten()
                    .map(|line| line.len() + 1)
                    .sum();
                text(PROGRAM_MEMORY.saturating_sub(used).to_string())
            }
            ("ST", "") if front.is_none() => {
                for axis in &mut self.axes {
                    axis.brake(now_s, axis.settings.get("AG"));
                }
                Ok(Answer::SetOff)
            }
            // Applies to every axis, whatever the axis number; ZE sets the reaction.
            ("AB", "") => {
                for axis in &mut self.axes {
                    axis.react(now_s, "ZE");
                }
                Ok(Answer::SetOff)
            }
            ("RS", "") => {
                self.reset(now_s);
                Ok(Answer::SetOff)
            }
            ("SM", "") => {
                for axis in &mut self.axes {
                    axis.saved = axis.settings.clone();
                }
                Ok(Answer::None)
            }
            // A stored program ends before the next command is read.
            ("AP", "") => Ok(Answer::None),
            ("EP" | "XX" | "LP", "") => self.program(front, name),
            ("QP", "") => Err(NOT_ALLOWED),
            _ => return None,
        })
    }

    /// `EP` begins a program, `XX` deletes one, `LP` lists it.
    fn program(&mut self, front: Option<u32>, name: &str) -> Result<Answer, Refusal> {
        let program = front.ok_or(MISSING_PARAMETER)?;
        if !PROGRAMS.contains(&program) {
            return Err(OUT_OF_RANGE);
        }
        match name {
            "EP" => {
                self.recording = Some(program);
                Ok(Answer::None)
            }
            "XX" => {
                self.programs.remove(&program);
                Ok(Answer::None)
            }
            _ => match self.programs.get(&program) {
                Some(lines) => Ok(Answer::Text(lines.join("\r\n"))),
                None => Err(NO_SUCH_PROGRAM),
            },
        }
    }

    /// All axes at rest and without current, with saved settings; the present positions become 0.
    fn reset(&mut self, now_s: f64) {
        for axis in &mut self.axes {
            axis.switch_off(now_s);
            axis.settings = axis.saved.clone();
            axis.zero = axis.profile.target();
        }
        self.errors.clear();
        self.recording = None;
    }

    /// Moving axes (bits 0 to 2), and whether any has current (bit 4).
    fn status(&self, now_s: f64) -> u8 {
        let moving = |n: usize| u8::from(!self.axes[n].done(now_s)) << n;
        let powered = self.axes.iter().any(|axis| axis.motor_on);
        0x40 | moving(0) | moving(1) | u8::from(powered) << 4
    }

    /// Two registers: upper limit switches (bits 0 to 2), lower ones (8 to 10) and emergency stops, which are inactive (27, 28);
    /// home switches (0 to 2).
    fn switches(&self, now_s: f64) -> String {
        let (mut limits, mut homes) = (1u32 << 27 | 1 << 28, 0u32);
        let connected = |(_, axis): &(usize, &Axis)| axis.model.is_connected();
        for (n, axis) in self.axes.iter().enumerate().filter(connected) {
            let here = axis.profile.position(now_s);
            let (down, up) = axis.switches();
            limits |= u32::from(here >= up) << n | u32::from(here <= down) << (8 + n);
            homes |= u32::from(here >= axis.model.home) << n;
        }
        format!("{limits:X}H, {homes:X}H")
    }
}

/// Answer to `ID?` for a stage without a memory of its model.
pub const NO_MEMORY: &str = "Unknown";

/// Axis commands other than settings.
const AXIS_COMMANDS: &[&str] = &[
    "DH", "DP", "DV", "ID", "MD", "MF", "MO", "MT", "MV", "MZ", "OR", "PA", "PR", "QD", "QR", "ST",
    "TP", "TV", "UF",
];

/// Commands that start or stop an axis, or report its position.
fn of_motion(
    axis: &mut Axis,
    now_s: f64,
    name: &str,
    behind: &str,
) -> Option<Result<Answer, Refusal>> {
    let go = |done: Result<(), Refusal>| done.map(|()| Answer::SetOff);
    Some(match (name, behind) {
        ("PA" | "PR", "?") => Ok(Answer::Text(position(axis, axis.destination()))),
        ("MV" | "MT" | "MZ" | "OR", "?") => Ok(yes_or_no(axis.done(now_s))),
        ("PA", _) => go(number(behind).and_then(|target| travel(axis, now_s, target))),
        ("PR", _) => go(number(behind).and_then(|by| {
            let target = axis.destination() + by;
            travel(axis, now_s, target)
        })),
        ("MV", _) => go(direction(axis, behind).map(|up| until_limit(axis, now_s, up))),
        ("MT", _) => go(direction(axis, behind).map(|up| to_switch(axis, now_s, up))),
        // The index pulse is next to the home switch.
        ("MZ", _) => go(direction(axis, behind).map(|_| {
            axis.send_at(now_s, axis.model.home, axis.settings.get("OH"));
        })),
        ("OR", _) => go(home(axis, now_s, behind)),
        ("ST", "") => {
            axis.brake(now_s, axis.settings.get("AG"));
            Ok(Answer::SetOff)
        }
        ("DH", "?") => Ok(Answer::Text(position(axis, axis.defined_home))),
        ("DH", _) => {
            let reading = if behind.is_empty() {
                Ok(0.0)
            } else {
                number(behind)
            };
            reading.map(|reading| {
                axis.shift(now_s, reading);
                axis.defined_home = reading;
                Answer::None
            })
        }
        _ => return None,
    })
}

/// Commands that report the state of an axis, or switch its motor.
fn of_status(
    axis: &mut Axis,
    now_s: f64,
    name: &str,
    behind: &str,
) -> Option<Result<Answer, Refusal>> {
    let speed = |axis: &Axis| format!("{:.6}", axis.profile.speed(now_s));
    Some(match (name, behind) {
        ("ID", "?" | "") => Ok(Answer::Text(match axis.model.name {
            NO_MEMORY => NO_MEMORY.into(),
            name => format!("{name}, SN0001"),
        })),
        ("ID", _) => Err(NOT_ALLOWED),
        ("MD", "" | "?") => Ok(yes_or_no(axis.done(now_s))),
        ("TP", "" | "?") => {
            let beside_mm = core::mem::take(&mut axis.reads_beside_mm);
            let reading = axis.reading(now_s) + beside_mm;
            Ok(Answer::Text(position(axis, reading)))
        }
        ("DP", "" | "?") => Ok(Answer::Text(position(axis, axis.destination()))),
        ("TV" | "DV", "" | "?") => Ok(Answer::Text(speed(axis))),
        ("MO" | "MF", "?") => Ok(yes_or_no(axis.motor_on)),
        ("MO", "") if axis.settings.get("QM") == 0.0 => Err(of_axis(axis.number, MOTOR_UNDEFINED)),
        ("MO", "") => {
            axis.motor_on = true;
            Ok(Answer::None)
        }
        ("MF", "") => {
            axis.switch_off(now_s);
            Ok(Answer::SetOff)
        }
        // The driver accepts its settings without current.
        ("QD", "") => {
            axis.switch_off(now_s);
            Ok(Answer::SetOff)
        }
        ("UF", "") => Ok(Answer::None),
        // Torque reduction of a stepper at rest, which the stages do not have.
        ("QR", "?") => Ok(Answer::Text("0, 100".into())),
        ("QR", _) => match behind.split_once(',').map(|(a, b)| (number(a), number(b))) {
            Some((Ok(0.0..=60_000.0), Ok(0.0..=100.0))) => Ok(Answer::None),
            Some((Ok(_), Ok(_))) => Err(of_axis(axis.number, PARAMETER_OUT_OF_RANGE)),
            _ => Err(MISSING_PARAMETER),
        },
        _ => return None,
    })
}

/// A position, with the number of digits set by `FP`.
fn position(axis: &Axis, reading: f64) -> String {
    let places = axis.settings.get("FP") as usize;
    let text = format!("{reading:.places$}");
    // The device does not print a negative zero.
    match text.strip_prefix('-') {
        Some(size) if !size.contains(|digit: char| ('1'..='9').contains(&digit)) => size.to_owned(),
        _ => text,
    }
}

/// Direction of a move, for an axis that may move.
fn direction(axis: &Axis, behind: &str) -> Result<bool, Refusal> {
    let up = match behind {
        "+" => true,
        "-" => false,
        "" => return Err(MISSING_PARAMETER),
        _ => return Err(of_axis(axis.number, PARAMETER_OUT_OF_RANGE)),
    };
    axis.may_move().map(|()| up)
}

/// Moves an axis to the position with this reading.
fn travel(axis: &mut Axis, now_s: f64, reading: f64) -> Result<(), Refusal> {
    axis.may_move()?;
    axis.within_limits(reading)?;
    axis.send(now_s, reading + axis.zero);
    Ok(())
}

/// Moves an axis until the software limit, if active, or the limit switch.
fn until_limit(axis: &mut Axis, now_s: f64, up: bool) {
    if !axis.settings.bit("ZS", 0) {
        let (down_switch, up_switch) = axis.switches();
        let beyond = if up {
            up_switch + 1.0
        } else {
            down_switch - 1.0
        };
        axis.send(now_s, beyond);
        return;
    }
    let (limit, error) = if up {
        ("SR", POSITIVE_LIMIT)
    } else {
        ("SL", NEGATIVE_LIMIT)
    };
    let target = axis.settings.get(limit) + axis.zero;
    axis.send(now_s, target);
    axis.arrive_as(Arrival::SoftwareLimit(error));
}

/// Moves an axis to its limit switch at home-search speed; arriving there is not an error.
fn to_switch(axis: &mut Axis, now_s: f64, up: bool) {
    let (down_switch, up_switch) = axis.switches();
    let target = if up { up_switch } else { down_switch };
    axis.send_at(now_s, target, axis.settings.get("OH"));
}

/// A home search in the given mode, or in that of `OM`; the position found gets the reading set by `SH`.
fn home(axis: &mut Axis, now_s: f64, mode: &str) -> Result<(), Refusal> {
    let mode = match mode {
        "" => axis.settings.get("OM"),
        text => number(text)?,
    };
    if mode.fract() != 0.0 || !(0.0..=6.0).contains(&mode) {
        return Err(of_axis(axis.number, PARAMETER_OUT_OF_RANGE));
    }
    axis.may_move()?;
    let (down_switch, up_switch) = axis.switches();
    let target = match mode as u32 {
        0 => axis.zero,
        1 | 2 => axis.model.home,
        3 | 5 => up_switch,
        _ => down_switch,
    };
    axis.send_at(now_s, target, axis.settings.get("OH"));
    axis.arrive_as(Arrival::Home(axis.settings.get("SH")));
    Ok(())
}
