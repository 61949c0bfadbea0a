//! Newport ESP301 motion controller over its text protocol (ESP301 user's manual, section 3).
//!
//! Commands end with a carriage return, answers with carriage return and line feed. A command without a question mark
//! has no answer, so after each line the error buffer is read (`TB?`: "code, time stamp, text"; code 0 is no error).
//!
//! | used          | meaning                                     |
//! |---------------|---------------------------------------------|
//! | `1MO`         | motor on                                    |
//! | `1VA80`       | velocity, units per second                  |
//! | `1AC320`      | acceleration, units per second²             |
//! | `1AG320`      | deceleration, units per second²             |
//! | `1OH80`       | velocity of the search for home             |
//! | `2SH100`      | position that the home switch stands for    |
//! | `1OR1`        | search for home: 1 switch and index, 2 switch, 3 upper limit, 4 lower limit |
//! | `1SL-360`     | lower end of the travel                     |
//! | `1SR360`      | upper end of the travel                     |
//! | `1PA12.5`     | move to absolute position                   |
//! | `1ST`         | stop; without a number, every axis          |
//! | `1MD?`        | 1 = motion done                             |
//! | `1TP?`        | actual position                             |
//! | `1ID?`        | model and serial number of the stage, such as `TS50DC.5, SN1263`; `Unknown` of one that has no memory |
//! | `TB?`         | oldest error                                |

use super::{Pose, Stage, StageFault, StagePort, StageRequest, decimal};
use embassy_time::{Duration, with_timeout};
use flankscope_protocol::{
    Fault, HomeAt, Line as Serial, Micrometres, Microradians, StageConfig, StageName,
};

/// What a stop is sent at before anybody has said how the line is set: after a reset something may still move.
const USUAL_BAUDS: [u32; 7] = [9_600, 19_200, 38_400, 57_600, 115_200, 460_800, 921_600];
/// Longest exchange of [`Stage::standing`] with stages that stand, questions and answers: `1MD?` and `1`, `TB?` and an error without a
/// name, `1TP?` and `-123.456789`, line ends included.
const WATCH_BYTES: u64 = 2 * (5 + 3) + (4 + 31) + 2 * (5 + 13);
/// Its answers, and the time that each is given beside that on the wire.
const WATCH_ANSWERS: u64 = 5;
const ANSWER_US: u64 = 5_000;
/// Least patience: on a fast line a pause of the controller is no reason to leave the die.
const LEAST_WATCH: Duration = Duration::from_millis(60);
/// The controller answers questions within a few milliseconds even while it moves.
const REPLY_TIMEOUT: Duration = Duration::from_millis(200);
/// Longer than the controller ever pauses within or before an answer it is late with.
const QUIET: Duration = Duration::from_millis(150);
/// The controller's error buffer holds ten.
const ERRORS_HELD: usize = 10;
/// 180/pi in millionths: a micro-radian is 57.295780 millionths of a degree.
const DEGREES_PER_RADIAN_MILLIONTHS: i64 = 57_295_780;

type Line = heapless::String<80>;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    No,
    Vertical,
    Rotation,
}

/// One axis, in the controller's own units: degrees or millimetres, in millionths.
#[derive(Debug, Clone, Copy)]
struct Axis {
    number: char,
    speed: i64,
    acceleration: i64,
    from: i64,
    to: i64,
    home: i64,
    home_speed: i64,
    home_at: HomeAt,
}

/// Rotation and vertical axis.
#[derive(Debug, Clone, Copy)]
struct Axes {
    rotation: Axis,
    vertical: Axis,
}

impl Axes {
    fn of(stage: &StageConfig) -> Self {
        let (turn, lift) = (&stage.rotation, &stage.vertical);
        let millionths = |thousandths: u32| i64::from(thousandths) * 1_000;
        Self {
            rotation: Axis {
                number: digit(turn.number),
                speed: millionths(turn.speed.get()),
                acceleration: millionths(turn.acceleration.get()),
                from: rotation_deg(turn.from),
                to: rotation_deg(turn.to),
                home: rotation_deg(turn.home),
                home_speed: millionths(turn.home_speed.get()),
                home_at: turn.home_at,
            },
            vertical: Axis {
                number: digit(lift.number),
                speed: millionths(lift.speed.get()),
                acceleration: millionths(lift.acceleration.get()),
                from: vertical_mm(lift.from),
                to: vertical_mm(lift.to),
                home: vertical_mm(lift.home),
                home_speed: millionths(lift.home_speed.get()),
                home_at: lift.home_at,
            },
        }
    }
}

/// The driver. Owns its UART.
#[derive(Debug)]
pub struct Esp301<P> {
    port: P,
    /// As it was set last.
    line: Serial,
    /// None before the first reference run.
    axes: Option<Axes>,
    homing: Homing,
    /// A question was given up: its answer may still come.
    out_of_step: bool,
}

impl<P: StagePort> Esp301<P> {
    /// Nothing is sent before the first request, and nothing but a stop before the first reference run.
    pub const fn new(port: P) -> Self {
        Self {
            port,
            line: StageConfig::DEFAULT.line,
            axes: None,
            homing: Homing::No,
            out_of_step: false,
        }
    }

    async fn set_line(&mut self, line: &Serial) -> Result<(), StageFault> {
        self.line = *line;
        if !self.port.set_line(line) {
            return Err(nonsense());
        }
        // What was sent at other speeds is noise to the stages' controller: an empty line ends what it took for the beginning of one.
        self.send("").await?;
        self.forget_errors().await
    }

    /// Sends one line and reads the error buffer.
    async fn order(&mut self, line: &Line) -> Result<(), StageFault> {
        self.send(line).await?;
        self.oldest_error().await
    }

    /// Fails with the oldest error in the buffer.
    async fn oldest_error(&mut self) -> Result<(), StageFault> {
        let mut answer = Line::new();
        self.ask("TB?", &mut answer).await?;
        let code = answer.split(',').next().unwrap_or_default().trim();
        match code.parse::<u32>() {
            Ok(0) => Ok(()),
            Ok(detail) => Err(StageFault {
                fault: Fault::StageError,
                detail,
            }),
            Err(_) => Err(nonsense()),
        }
    }

    async fn send(&mut self, line: &str) -> Result<(), StageFault> {
        let sent = async {
            self.port
                .write_all(line.as_bytes())
                .await
                .map_err(|_| silent())?;
            self.port.write_all(b"\r").await.map_err(|_| silent())?;
            self.port.flush().await.map_err(|_| silent())
        };
        with_timeout(REPLY_TIMEOUT, sent)
            .await
            .map_err(|_| silent())?
    }

    /// Sends a question and reads one line of answer. Orders have none, and need not wait until the line is quiet.
    async fn ask(&mut self, question: &str, answer: &mut Line) -> Result<(), StageFault> {
        self.fall_in().await;
        self.send(question).await?;
        self.out_of_step = true;
        let answered = with_timeout(REPLY_TIMEOUT, self.line(answer))
            .await
            .map_err(|_| silent())?;
        self.out_of_step = answered.is_err();
        answered
    }

    /// Throws away what still comes of old answers, until the line has been quiet for a while: an answer that is
    /// taken for the one to a later question is worse than none.
    async fn fall_in(&mut self) {
        let mut stale = [0u8; 32];
        let mut reads = 0u8;
        while self.out_of_step {
            let quiet = with_timeout(QUIET, self.port.read(&mut stale))
                .await
                .is_err();
            reads = reads.saturating_add(1);
            // A line that never falls quiet is reported by the question that follows.
            self.out_of_step = !quiet && reads < u8::MAX;
        }
    }

    async fn line(&mut self, answer: &mut Line) -> Result<(), StageFault> {
        answer.clear();
        loop {
            let mut byte = [0u8];
            if self.port.read(&mut byte).await.map_err(|_| silent())? == 0 {
                return Err(silent());
            }
            match byte {
                [b'\n' | b'\r'] if answer.is_empty() => {}
                [b'\n' | b'\r'] => return Ok(()),
                [byte] => answer.push(char::from(byte)).map_err(|_| nonsense())?,
            }
        }
    }

    async fn axis_line(
        &mut self,
        axis: char,
        question: &str,
        answer: &mut Line,
    ) -> Result<(), StageFault> {
        let mut line = Line::new();
        if line.push(axis).is_err() || line.push_str(question).is_err() {
            return Err(nonsense());
        }
        self.ask(&line, answer).await
    }

    async fn axis_question(&mut self, axis: char, question: &str) -> Result<i64, StageFault> {
        let mut answer = Line::new();
        self.axis_line(axis, question, &mut answer).await?;
        decimal::read(answer.trim().as_bytes()).ok_or_else(nonsense)
    }

    async fn name(&mut self, axis: char) -> Result<StageName, StageFault> {
        let mut answer = Line::new();
        self.axis_line(axis, "ID?", &mut answer).await?;
        StageName::of(answer.as_bytes()).ok_or_else(nonsense)
    }

    /// Empties the error buffer: what is left from before is not the error of what comes next.
    async fn forget_errors(&mut self) -> Result<(), StageFault> {
        for _ in 0..ERRORS_HELD {
            match self.oldest_error().await {
                Err(StageFault {
                    fault: Fault::StageError,
                    ..
                }) => {}
                other => return other,
            }
        }
        Ok(())
    }

    /// Line, motors on, dynamics, search for home and what it stands for.
    async fn prepare(&mut self, stage: &StageConfig) -> Result<Axes, StageFault> {
        self.set_line(&stage.line).await?;
        let axes = Axes::of(stage);
        for axis in [&axes.rotation, &axes.vertical] {
            self.order_axis(axis, &[Order::Plain("MO"), Order::Set("VA", axis.speed)])
                .await?;
            self.order_axis(
                axis,
                &[
                    Order::Set("AC", axis.acceleration),
                    Order::Set("AG", axis.acceleration),
                ],
            )
            .await?;
            self.order_axis(
                axis,
                &[
                    Order::Set("OH", axis.home_speed),
                    Order::Set("SH", axis.home),
                ],
            )
            .await?;
        }
        Ok(axes)
    }

    /// Ends of the travel: they count from the home that was found.
    async fn set_travel(&mut self, axes: &Axes) -> Result<(), StageFault> {
        for axis in [&axes.rotation, &axes.vertical] {
            self.order_axis(
                axis,
                &[Order::Set("SL", axis.from), Order::Set("SR", axis.to)],
            )
            .await?;
        }
        Ok(())
    }

    /// One line of orders to an axis.
    async fn order_axis(&mut self, axis: &Axis, orders: &[Order]) -> Result<(), StageFault> {
        let mut line = Line::new();
        build(&mut line, orders.iter().map(|order| (axis, *order)))?;
        self.order(&line).await
    }

    async fn search(&mut self, axis: &Axis) -> Result<(), StageFault> {
        let mode = match axis.home_at {
            HomeAt::SwitchAndIndex => "OR1",
            HomeAt::Switch => "OR2",
            HomeAt::UpperLimit => "OR3",
            HomeAt::LowerLimit => "OR4",
        };
        self.order_axis(axis, &[Order::Plain(mode)]).await
    }

    /// Halts every axis, also of a controller that nobody has said anything of.
    async fn stop(&mut self) -> Result<(), StageFault> {
        if self.axes.is_some() {
            // The retract is next, and must not wait for what a controller in trouble may answer.
            return self.send("ST").await;
        }
        for baud in USUAL_BAUDS {
            if self.port.set_line(&Serial {
                baud,
                ..StageConfig::DEFAULT.line
            }) {
                self.send("ST").await?;
            }
        }
        Ok(())
    }
}

impl<P: StagePort> Stage for Esp301<P> {
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault> {
        self.homing = Homing::No;
        match (request, self.axes) {
            (StageRequest::Home { stage, .. }, _) => {
                let axes = self.prepare(&stage).await?;
                self.axes = Some(axes);
                self.homing = Homing::Vertical;
                self.search(&axes.vertical).await
            }
            (StageRequest::Stop, _) => self.stop().await,
            // A question, which [`Stage::identity`] answers: nothing to set off.
            (StageRequest::Identify { .. }, _) => Ok(()),
            (StageRequest::Move { view, .. }, Some(axes)) => {
                let mut line = Line::new();
                let turn = Order::Set("PA", rotation_deg(view.rotation));
                let lift = Order::Set("PA", vertical_mm(view.vertical));
                build(&mut line, [(&axes.rotation, turn), (&axes.vertical, lift)])?;
                self.order(&line).await
            }
            (StageRequest::Retract { vertical, .. }, Some(axes)) => {
                // Whatever went wrong before may have switched the motor off, a limit switch does. And it left its
                // error: whether this order is obeyed shows in where the head stands.
                let mut line = Line::new();
                let out = [Order::Plain("MO"), Order::Set("PA", vertical_mm(vertical))];
                build(&mut line, out.map(|order| (&axes.vertical, order)))?;
                self.send(&line).await?;
                self.forget_errors().await
            }
            (StageRequest::Move { .. } | StageRequest::Retract { .. }, None) => Err(StageFault {
                fault: Fault::OutOfStep,
                detail: 0,
            }),
        }
    }

    async fn standing(&mut self) -> Result<Option<Pose>, StageFault> {
        let Some(axes) = self.axes else {
            // Nothing was set off.
            return Err(nonsense());
        };
        for axis in [axes.vertical, axes.rotation] {
            match self.axis_question(axis.number, "MD?").await? {
                0 => return Ok(None),
                1_000_000 => {}
                _ => return Err(nonsense()),
            }
        }
        match self.homing {
            Homing::Vertical => {
                // The head is clear of the die now; only then may die or head turn.
                self.homing = Homing::Rotation;
                self.search(&axes.rotation).await?;
                return Ok(None);
            }
            Homing::Rotation => {
                self.homing = Homing::No;
                self.oldest_error().await?;
                self.set_travel(&axes).await?;
            }
            Homing::No => {}
        }
        // A stand that is none: a limit switch, a following error.
        self.oldest_error().await?;
        let rotation = self.axis_question(axes.rotation.number, "TP?").await?;
        let vertical = self.axis_question(axes.vertical.number, "TP?").await?;
        let pose = rotation_from_deg(rotation).zip(vertical_from_mm(vertical));
        let (rotation, vertical) = pose.ok_or_else(nonsense)?;
        Ok(Some(Pose { rotation, vertical }))
    }

    fn watch_limit(&self) -> Duration {
        let wire_us = (WATCH_BYTES * self.line.byte_ns()).div_ceil(1_000);
        LEAST_WATCH.max(Duration::from_micros(wire_us + WATCH_ANSWERS * ANSWER_US))
    }

    async fn identity(&mut self, stage: &StageConfig) -> Result<[StageName; 2], StageFault> {
        self.set_line(&stage.line).await?;
        Ok([
            self.name(digit(stage.rotation.number)).await?,
            self.name(digit(stage.vertical.number)).await?,
        ])
    }
}

fn silent() -> StageFault {
    StageFault {
        fault: Fault::StageSilent,
        detail: 0,
    }
}

fn nonsense() -> StageFault {
    StageFault {
        fault: Fault::StageReply,
        detail: 0,
    }
}

/// What one axis is told.
#[derive(Clone, Copy)]
enum Order {
    Plain(&'static str),
    /// With a number, in millionths.
    Set(&'static str, i64),
}

/// One line of orders, each behind the number of its axis.
fn build<'a>(
    line: &mut Line,
    orders: impl IntoIterator<Item = (&'a Axis, Order)>,
) -> Result<(), StageFault> {
    line.clear();
    let fits = orders.into_iter().all(|(axis, order)| {
        let apart = line.is_empty() || line.push(';').is_ok();
        apart
            && line.push(axis.number).is_ok()
            && match order {
                Order::Plain(name) => line.push_str(name).is_ok(),
                Order::Set(name, millionths) => {
                    line.push_str(name).is_ok() && decimal::write(millionths, line)
                }
            }
    });
    if fits { Ok(()) } else { Err(nonsense()) }
}

fn digit(number: u8) -> char {
    char::from(b'0'.saturating_add(number.min(9)))
}

/// Nearest multiple, half away from zero.
fn div_nearest(value: i64, by: i64) -> i64 {
    let half = by / 2;
    (if value < 0 {
        value - half
    } else {
        value + half
    }) / by
}

/// Millionths of a degree.
fn rotation_deg(rotation: Microradians) -> i64 {
    div_nearest(
        i64::from(rotation.get()) * DEGREES_PER_RADIAN_MILLIONTHS,
        1_000_000,
    )
}

fn rotation_from_deg(millionths: i64) -> Option<Microradians> {
    let scaled = millionths.checked_mul(1_000_000)?;
    i32::try_from(div_nearest(scaled, DEGREES_PER_RADIAN_MILLIONTHS))
        .ok()
        .map(Microradians)
}

/// Millionths of a millimetre.
fn vertical_mm(vertical: Micrometres) -> i64 {
    i64::from(vertical.get()) * 1_000
}

fn vertical_from_mm(millionths: i64) -> Option<Micrometres> {
    i32::try_from(div_nearest(millionths, 1_000))
        .ok()
        .map(Micrometres)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_come_back_to_the_microradian() {
        for rotation in [
            0,
            1,
            -1,
            74_799,
            -1_234_567,
            6_283_186,
            -6_283_186,
            i32::MAX / 4,
        ] {
            let rotation = Microradians(rotation);
            assert_eq!(rotation_from_deg(rotation_deg(rotation)), Some(rotation));
        }
        // Half a turn, pi rad = 3 141 593 urad to the nearest: 180.000020 deg.
        assert!((rotation_deg(Microradians(3_141_593)) - 180_000_000).abs() <= 40);
        assert_eq!(rotation_from_deg(i64::MAX / 4), None);
    }

    #[test]
    fn positions_come_back_to_the_micrometre() {
        for vertical in [0, 33_000, -150_000, i32::MIN] {
            assert_eq!(
                vertical_from_mm(vertical_mm(Micrometres(vertical))),
                Some(Micrometres(vertical))
            );
        }
    }
}
