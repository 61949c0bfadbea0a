//! Both stages behind an emulated Newport ESP301: its text protocol on a UART, trapezoidal motion, stage errors.

use super::axis::{Axis, AxisModel};
use super::camera::ExposureSink;
use super::motion::Dynamics;
use super::{DeviceFault, Faults, World};
use embassy_time::{Instant, Timer};
use embedded_io_async::{Read, Write};
use flankscope_sim::Port;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// Both axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisModels {
    /// Axis 1.
    pub rotation: AxisModel,
    /// Axis 2.
    pub vertical: AxisModel,
}

impl Default for AxisModels {
    /// URS150BCC and IMS300V. Errors as the instrument's authors state them (±15 mdeg, ±5 um); speeds are the stages'
    /// rated ones, accelerations assumed (full speed within 0.25 s and 0.125 s).
    fn default() -> Self {
        Self {
            rotation: AxisModel {
                name: "URS150BCC",
                unit: 7,
                dynamics: Dynamics {
                    speed: 80.0,
                    acceleration: 320.0,
                },
                travel: (-361.0, 361.0),
                home: 0.0,
                error: 0.015,
                stalls_at_move: None,
            },
            vertical: AxisModel {
                name: "IMS300V",
                unit: 2,
                dynamics: Dynamics {
                    speed: 100.0,
                    acceleration: 800.0,
                },
                travel: (-150.0, 150.0),
                home: 100.0,
                error: 0.005,
                stalls_at_move: None,
            },
        }
    }
}

/// Where the stages really are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePose {
    /// Rotary stage.
    pub rotation_rad: f64,
    /// Vertical stage.
    pub vertical_mm: f64,
}

/// The stages and the state of their controller.
#[derive(Debug, Clone)]
pub struct StageModel {
    axes: [Axis; 2],
    seed: u64,
    errors: VecDeque<(u32, &'static str)>,
}

impl StageModel {
    /// Switched on, standing at the home switches.
    #[must_use]
    pub fn new(models: AxisModels, seed: u64) -> Self {
        Self {
            axes: [Axis::new(models.rotation), Axis::new(models.vertical)],
            seed,
            errors: VecDeque::new(),
        }
    }

    /// Where the stages really are.
    #[must_use]
    pub fn true_pose(&self, now_us: u64) -> TruePose {
        let now_s = now_us as f64 * 1e-6;
        self.pose_of(|axis| axis.profile.position(now_s))
    }

    /// Where the stages will really come to stand.
    #[must_use]
    pub fn true_destination(&self) -> TruePose {
        self.pose_of(|axis| axis.profile.target())
    }

    /// The next time after `now_us` at which the vertical axis crosses `vertical_mm`, to the millisecond it is looked
    /// at; `None` if it will not.
    pub(super) fn vertical_crossing_us(&self, now_us: u64, vertical_mm: f64) -> Option<u64> {
        let profile = &self.axes[1].profile;
        let above = |at_us: u64| profile.position(at_us as f64 * 1e-6) >= vertical_mm;
        let (level, end_us) = (above(now_us), (profile.end_s() * 1e6).ceil() as u64 + 1_000);
        (now_us..=end_us)
            .step_by(1_000)
            .skip(1)
            .find(|&at_us| above(at_us) != level)
    }

    /// The line sends the vertical axis to a place at least a millimetre away.
    fn moves_vertically(&self, line: &str) -> bool {
        let axis = &self.axes[1];
        let mut commands = line.split(';');
        let target: Option<f64> =
            commands.find_map(|command| command.trim().strip_prefix("2PA")?.parse().ok());
        target.is_some_and(|target| (target + axis.zero - axis.profile.target()).abs() >= 1.0)
    }

    fn pose_of(&self, position: impl Fn(&Axis) -> f64) -> TruePose {
        let [rotation, vertical] = [0, 1].map(|n| {
            let axis = &self.axes[n];
            position(axis) + axis.model.error * self.unit_error(n, axis.profile.target())
        });
        TruePose {
            rotation_rad: rotation.to_radians(),
            vertical_mm: vertical,
        }
    }

    /// Uniform in -1..1, the same whenever the same axis is sent to the same position (to a millionth).
    fn unit_error(&self, axis: usize, position: f64) -> f64 {
        let cell = (position * 1e6).round() as i64 as u64;
        let mut mixed =
            self.seed ^ cell.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ ((axis as u64 + 1) << 56);
        // SplitMix64's finaliser (Steele, Lea, Flood 2014).
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Carries out one line of commands at `now_us` and returns the answer, if any. `true`: something set off.
    fn line(&mut self, now_us: u64, line: &str) -> (String, bool) {
        let now_s = now_us as f64 * 1e-6;
        for (n, axis) in self.axes.iter_mut().enumerate() {
            if let Some((_, (code, message))) = axis.trips.take_if(|(at_s, _)| now_s >= *at_s) {
                axis.motor_on = false;
                self.errors
                    .push_back(((n as u32 + 1) * 100 + code, message));
            }
        }
        let (mut answers, mut set_off) = (String::new(), false);
        for command in line
            .split(';')
            .map(str::trim)
            .filter(|command| !command.is_empty())
        {
            match self.command(now_s, command) {
                Ok(Answer::None) => {}
                Ok(Answer::SetOff) => set_off = true,
                Ok(Answer::Text(text)) => {
                    answers.push_str(&text);
                    answers.push_str("\r\n");
                }
                Err(error) => {
                    // The controller's buffer holds ten; the oldest is read first.
                    if self.errors.len() < 10 {
                        self.errors.push_back(error);
                    }
                }
            }
        }
        (answers, set_off)
    }

    fn command(&mut self, now_s: f64, command: &str) -> Result<Answer, (u32, &'static str)> {
        let digits = command.bytes().take_while(u8::is_ascii_digit).count();
        let (number, rest) = command.split_at(digits);
        let (name, argument) = rest.split_at_checked(2).ok_or(UNKNOWN)?;
        let (name, argument) = (name.to_ascii_uppercase(), argument.trim());
        let text = |text: String| Ok(Answer::Text(text));
        // What can only be read may be asked without a question mark, and some clients do.
        match (name.as_str(), argument) {
            ("VE", "?") => return text("ESP301 Version 3.0.1 6/1/99".into()),
            ("TE", "" | "?") => {
                return text(
                    self.errors
                        .pop_front()
                        .map_or(0, |(code, _)| code)
                        .to_string(),
                );
            }
            ("TB", "" | "?") => {
                let (code, message) = self.errors.pop_front().unwrap_or((0, "NO ERROR DETECTED"));
                return text(format!("{code}, {:.0}, {message}", now_s * 1e3));
            }
            ("ST", "") if number.is_empty() => {
                for axis in &mut self.axes {
                    axis.profile = axis.profile.brake(now_s, axis.dynamics);
                }
                return Ok(Answer::SetOff);
            }
            _ => {}
        }
        let index: usize = number.parse().map_err(|_| MISSING_AXIS)?;
        let axis = index
            .checked_sub(1)
            .and_then(|n| self.axes.get_mut(n))
            .ok_or(NO_SUCH_AXIS)?;
        let of_axis = |code: u32, message: &'static str| (index as u32 * 100 + code, message);
        let value = || {
            argument
                .parse::<f64>()
                .ok()
                .filter(|value| value.is_finite())
                .ok_or(MISSING_PARAMETER)
        };
        let motor = |axis: &Axis| {
            if axis.motor_on {
                Ok(())
            } else {
                Err(of_axis(13, "MOTOR NOT ENABLED"))
            }
        };
        match (name.as_str(), argument) {
            ("ID", "?") => text(format!("{}, SN0001", axis.model.name)),
            ("SN", "?") => text(axis.model.unit.to_string()),
            ("SL", "?") => text(axis.model.travel.0.to_string()),
            ("SR", "?") => text(axis.model.travel.1.to_string()),
            ("VA", "?") => text(axis.dynamics.speed.to_string()),
            ("MO", "?") => text(u8::from(axis.motor_on).to_string()),
            ("MD", "" | "?") => text(u8::from(axis.done(now_s)).to_string()),
            ("TP", "" | "?") => {
                let beside_mm = core::mem::take(&mut axis.reads_beside_mm);
                let position = axis.profile.position(now_s) - axis.zero + beside_mm;
                text(format!("{position:.6}"))
            }
            ("PA" | "DP", "?") => text(format!("{:.6}", axis.profile.target() - axis.zero)),
            ("MO", "") => {
                axis.motor_on = true;
                Ok(Answer::None)
            }
            ("MF", "") => {
                axis.motor_on = false;
                Ok(Answer::None)
            }
            ("DH", "") => {
                // Where it stands becomes position 0.
                axis.shift(now_s, 0.0);
                Ok(Answer::None)
            }
            ("DH", _) => {
                let reading = value()?;
                axis.shift(now_s, reading);
                Ok(Answer::None)
            }
            ("SH", "?") => text(axis.home_preset.to_string()),
            ("AC", "?") => text(axis.dynamics.acceleration.to_string()),
            ("PR", _) => {
                let target = axis.profile.target() + value()?;
                motor(axis)?;
                axis.within_travel(target)
                    .map_err(|(code, message)| of_axis(code, message))?;
                axis.send(now_s, target);
                Ok(Answer::SetOff)
            }
            ("ST", "") => {
                axis.profile = axis.profile.brake(now_s, axis.dynamics);
                Ok(Answer::SetOff)
            }
            ("SH", _) => {
                axis.home_preset = value()?;
                Ok(Answer::None)
            }
            ("VA", _) => {
                let speed = value()?;
                if !(speed > 0.0 && speed <= axis.model.dynamics.speed) {
                    return Err(of_axis(10, "MAXIMUM VELOCITY EXCEEDED"));
                }
                axis.dynamics.speed = speed;
                Ok(Answer::None)
            }
            ("OR", _) => {
                motor(axis)?;
                // The scale is set so that the switch reads as preset; here both are the same place.
                axis.zero = 0.0;
                axis.send(now_s, axis.home_preset);
                Ok(Answer::SetOff)
            }
            ("PA", _) => {
                let target = value()? + axis.zero;
                motor(axis)?;
                axis.within_travel(target)
                    .map_err(|(code, message)| of_axis(code, message))?;
                axis.send(now_s, target);
                Ok(Answer::SetOff)
            }
            _ => Err(UNKNOWN),
        }
    }
}

enum Answer {
    None,
    SetOff,
    Text(String),
}

// Numbers and texts of the manual's list of errors, compared with the tables that two clients of others carry
// (InstrumentKit, golab). Errors of an axis have its number in front: 205 is the lower limit switch of axis 2.
const UNKNOWN: (u32, &str) = (6, "COMMAND DOES NOT EXIST");
const NO_SUCH_AXIS: (u32, &str) = (9, "AXIS NUMBER OUT OF RANGE");
const MISSING_AXIS: (u32, &str) = (37, "AXIS NUMBER MISSING");
const MISSING_PARAMETER: (u32, &str) = (38, "COMMAND PARAMETER MISSING");

pub(super) async fn run<S: ExposureSink>(port: Port, world: Rc<World>, sink: Rc<RefCell<S>>) {
    serve(port, &world.stage, &world.faults, |destination| {
        world.course.signal(());
        sink.borrow_mut().moving_to(destination);
    })
    .await;
}

/// Answers on `port` for ever; `set_off` is told where the stages are bound for.
///
/// `WS` holds everything behind it back until the axis stands, as the real controller does.
pub(super) async fn serve(
    mut port: Port,
    stage: &RefCell<StageModel>,
    faults: &Faults,
    mut set_off: impl FnMut(TruePose),
) {
    let mut line = Vec::new();
    let mut buffer = [0u8; 64];
    loop {
        let Ok(count) = port.read(&mut buffer).await;
        for &byte in &buffer[..count] {
            match byte {
                b'\r' => {
                    let text = String::from_utf8_lossy(&line).into_owned();
                    line.clear();
                    let mut rest = text.as_str();
                    while !rest.is_empty() {
                        let (now, wait, later) = split_at_wait(rest);
                        spoil(stage, faults, now);
                        let (mut answer, moved) =
                            stage.borrow_mut().line(Instant::now().as_micros(), now);
                        if !answer.is_empty() {
                            if faults.spoils(DeviceFault::StageSilent) {
                                answer.clear();
                            } else if faults.spoils(DeviceFault::StageGarbage) {
                                answer = "\u{7f}?#9,\r\n".into();
                            } else if faults.spoils(DeviceFault::StageLate) {
                                Timer::after_millis(300).await;
                            }
                        }
                        let Ok(()) = port.write_all(answer.as_bytes()).await;
                        if moved {
                            let destination = stage.borrow().true_destination();
                            set_off(destination);
                        }
                        if let Some((axis, delay_ms)) = wait {
                            stands(stage, axis).await;
                            Timer::after_millis(delay_ms).await;
                        }
                        rest = later;
                    }
                }
                b'\n' => {}
                // The controller's input buffer holds 80 characters.
                byte if line.len() < 80 => line.push(byte),
                _ => {}
            }
        }
    }
}

/// Faults of the mechanics and of the controller's own, just before a line is carried out.
fn spoil(stage: &RefCell<StageModel>, faults: &Faults, line: &str) {
    let mut stage = stage.borrow_mut();
    let moving = line.contains("PA") && !line.contains('?');
    if moving && line.contains("1PA") && faults.spoils(DeviceFault::RotationStalls) {
        stage.axes[0].stalls = true;
    }
    if moving && line.contains("2PA") && faults.spoils(DeviceFault::VerticalStalls) {
        stage.axes[1].stalls = true;
    }
    if line == "TB?" && faults.spoils(DeviceFault::StageError) {
        stage.errors.push_front((7, "PARAMETER OUT OF RANGE"));
    }
    if stage.moves_vertically(line) && faults.spoils(DeviceFault::StageOvershoots) {
        stage.axes[1].overshoots_mm = 0.5;
    }
    if stage.moves_vertically(line) && faults.spoils(DeviceFault::StageLimit) {
        stage.axes[1].meets_limit = true;
    }
    if line == "2TP?" && faults.spoils(DeviceFault::StageBeside) {
        let reading_mm = 1.0;
        stage.axes[1].reads_beside_mm = reading_mm;
    }
}

/// What is done at once, the wait behind it (axis counted from 0 or all, and a delay), and what comes after that.
fn split_at_wait(line: &str) -> (&str, Option<(Option<usize>, u64)>, &str) {
    let mut start = 0;
    for command in line.split(';') {
        let end = start + command.len();
        let trimmed = command.trim();
        let digits = trimmed.bytes().take_while(u8::is_ascii_digit).count();
        let (number, rest) = trimmed.split_at(digits);
        if let Some(delay) = rest
            .get(..2)
            .filter(|name| name.eq_ignore_ascii_case("WS"))
            .and_then(|_| rest.get(2..))
        {
            let axis = number.parse::<usize>().ok().and_then(|n| n.checked_sub(1));
            let delay_ms = delay.trim().parse().unwrap_or(0);
            let later = line.get(end + 1..).unwrap_or_default();
            return (&line[..start], Some((axis, delay_ms)), later);
        }
        start = end + 1;
    }
    (line, None, "")
}

/// Completes when the axis, or every axis, stands; one that stalls never does.
async fn stands(stage: &RefCell<StageModel>, axis: Option<usize>) {
    loop {
        let now_s = Instant::now().as_micros() as f64 * 1e-6;
        let stand = {
            let stage = stage.borrow();
            let mut axes = stage.axes.iter().enumerate();
            axes.all(|(n, one)| axis.is_some_and(|axis| axis != n) || one.done(now_s))
        };
        if stand {
            return;
        }
        Timer::after_millis(1).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(stage: &mut StageModel, now_us: u64, line: &str) -> String {
        stage.line(now_us, line).0
    }

    #[test]
    fn a_move_is_accepted_at_once_and_done_later() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        assert_eq!(
            ask(&mut stage, 0, "1MO;2MO;1PA8;2PA33;TB?"),
            "0, 0, NO ERROR DETECTED\r\n"
        );
        // 67 mm at 100 mm/s plus one ramp of 0.125 s.
        assert_eq!(ask(&mut stage, 794_000, "1MD?;2MD?"), "1\r\n0\r\n");
        assert_eq!(
            ask(&mut stage, 796_000, "2MD?;2TP?;1TP?"),
            "1\r\n33.000000\r\n8.000000\r\n"
        );
    }

    #[test]
    fn a_stop_brings_an_axis_to_rest_short_of_its_target() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        ask(&mut stage, 0, "2MO;2PA0");
        ask(&mut stage, 500_000, "2ST");
        // Braking from 100 mm/s takes 0.125 s and 6.25 mm; 0.5 s of travel were 43.75 mm.
        assert_eq!(ask(&mut stage, 626_000, "2MD?;2TP?"), "1\r\n50.000000\r\n");
    }

    #[test]
    fn what_is_wrong_is_refused_with_its_number_and_moves_nothing() {
        let mut stage = StageModel::new(AxisModels::default(), 1);
        for (line, code) in [
            ("2PA1", 213),
            ("1XX", 6),
            ("PA1", 37),
            ("3PA1", 9),
            ("1PA", 38),
            ("2PAnan", 38),
            ("1VA1000", 110),
        ] {
            assert_eq!(ask(&mut stage, 0, line), "");
            assert_eq!(ask(&mut stage, 0, "TE?"), format!("{code}\r\n"), "{line}");
        }
        ask(&mut stage, 0, "2MO;2PA151;2PA-151");
        assert_eq!(
            ask(&mut stage, 0, "TE?;TE?;TE?;2MD?;2TP?"),
            "206\r\n207\r\n0\r\n1\r\n100.000000\r\n"
        );
    }

    #[test]
    fn errors_are_repeatable_bounded_and_spread() {
        let axes = AxisModels::default();
        let pose = |seed: u64, target: f64| {
            let mut stage = StageModel::new(axes, seed);
            ask(&mut stage, 0, &format!("1MO;2MO;1PA{target};2PA{target}"));
            stage.true_pose(100_000_000)
        };
        assert_eq!(pose(3, 12.5), pose(3, 12.5));
        assert_ne!(pose(3, 12.5), pose(4, 12.5));
        let errors: Vec<f64> = (0..1000)
            .map(|n| pose(7, f64::from(n) * 0.1).vertical_mm - f64::from(n) * 0.1)
            .collect();
        assert!(errors.iter().all(|error| error.abs() <= 0.005 + 1e-9));
        let mean = errors.iter().sum::<f64>() / 1000.0;
        let deviation = (errors.iter().map(|error| error * error).sum::<f64>() / 1000.0).sqrt();
        // Uniform: standard deviation 5/sqrt(3) um; of the mean of 1000, 0.09 um.
        assert!(mean.abs() < 4.0 * 0.09e-3, "mean {mean} mm");
        assert!(
            (deviation - 0.005 / 3f64.sqrt()).abs() < 0.3e-3,
            "deviation {deviation} mm"
        );
    }
}
