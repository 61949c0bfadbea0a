//! Newport ESP301 motion controller over its text protocol (ESP301 user's manual, section 3).
//!
//! Commands end with a carriage return, answers with carriage return and line feed. A command without a question mark
//! has no answer, so after each line the error buffer is read (`TB?`: "code, time stamp, text"; code 0 is no error).
//!
//! | used          | meaning                                     |
//! |---------------|---------------------------------------------|
//! | `1MO`         | motor on                                    |
//! | `1VA80`       | velocity, units per second                  |
//! | `2SH100`      | position that the home switch stands for    |
//! | `1OR`         | search for home                             |
//! | `1PA12.5`     | move to absolute position                   |
//! | `1ST`         | stop                                        |
//! | `1MD?`        | 1 = motion done                             |
//! | `1TP?`        | actual position                             |
//! | `TB?`         | oldest error                                |

use super::{Pose, Stage, StageFault, StageRequest, decimal};
use embassy_time::{Duration, with_timeout};
use embedded_io_async::{Read, Write};
use flankscope_protocol::{Fault, Micrometres, Microradians};

/// Axis 1: rotation in degrees.
const ROTATION: char = '1';
/// Axis 2: vertical in millimetres.
const VERTICAL: char = '2';
/// The controller answers questions within a few milliseconds even while it moves.
const REPLY_TIMEOUT: Duration = Duration::from_millis(200);
/// Longer than the controller ever pauses within or before an answer it is late with.
const QUIET: Duration = Duration::from_millis(150);
/// The controller's error buffer holds ten.
const ERRORS_HELD: usize = 10;
/// 180/pi in millionths: a micro-radian is 57.295780 millionths of a degree.
const DEGREES_PER_RADIAN_MILLIONTHS: i64 = 57_295_780;

type Line = heapless::String<80>;

/// What is true of the mechanics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Axes {
    /// Rotary velocity in thousandths of a degree per second.
    pub rotation_mdeg_per_s: u32,
    /// Vertical velocity in micrometres per second.
    pub vertical_um_per_s: u32,
    /// Position of the vertical stage at its home switch.
    pub home_vertical: Micrometres,
}

impl Axes {
    /// URS150BCC (80 deg/s) and IMS300V (100 mm/s), home 100 mm above the working zero.
    pub const DEFAULT: Self = Self {
        rotation_mdeg_per_s: 80_000,
        vertical_um_per_s: 100_000,
        home_vertical: Micrometres(100_000),
    };
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Homing {
    No,
    Vertical,
    Rotation,
}

/// The driver. Owns its UART.
#[derive(Debug)]
pub struct Esp301<P> {
    port: P,
    axes: Axes,
    homing: Homing,
    prepared: bool,
    /// A question was given up: its answer may still come.
    out_of_step: bool,
}

impl<P: Read + Write> Esp301<P> {
    /// Nothing is sent before the first request.
    pub const fn new(port: P, axes: Axes) -> Self {
        Self {
            port,
            axes,
            homing: Homing::No,
            prepared: false,
            out_of_step: false,
        }
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

    async fn axis_question(&mut self, axis: char, question: &str) -> Result<i64, StageFault> {
        let mut line = Line::new();
        build(&mut line, &[Part::Axis(axis), Part::Text(question)])?;
        let mut answer = Line::new();
        self.ask(&line, &mut answer).await?;
        decimal::read(answer.trim().as_bytes()).ok_or_else(nonsense)
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

    /// Motors on, velocities, meaning of the home switch.
    async fn prepare(&mut self) -> Result<(), StageFault> {
        self.forget_errors().await?;
        let mut line = Line::new();
        for (axis, speed) in [
            (ROTATION, i64::from(self.axes.rotation_mdeg_per_s) * 1_000),
            (VERTICAL, i64::from(self.axes.vertical_um_per_s) * 1_000),
        ] {
            build(
                &mut line,
                &[
                    Part::Axis(axis),
                    Part::Text("MO;"),
                    Part::Axis(axis),
                    Part::Text("VA"),
                    Part::Number(speed),
                ],
            )?;
            self.order(&line).await?;
        }
        let home = vertical_mm(self.axes.home_vertical);
        build(
            &mut line,
            &[Part::Axis(VERTICAL), Part::Text("SH"), Part::Number(home)],
        )?;
        self.order(&line).await?;
        self.prepared = true;
        Ok(())
    }

    async fn order_axis(&mut self, axis: char, order: &str) -> Result<(), StageFault> {
        let mut line = Line::new();
        build(&mut line, &[Part::Axis(axis), Part::Text(order)])?;
        self.order(&line).await
    }
}

impl<P: Read + Write> Stage for Esp301<P> {
    async fn start(&mut self, request: StageRequest) -> Result<(), StageFault> {
        if request == StageRequest::Stop && !self.prepared {
            // After a reset: first of all nothing moves.
            self.send("1ST;2ST").await?;
        }
        if !self.prepared {
            self.prepare().await?;
        }
        self.homing = Homing::No;
        let mut line = Line::new();
        match request {
            StageRequest::Home { .. } => {
                self.homing = Homing::Vertical;
                self.forget_errors().await?;
                return self.order_axis(VERTICAL, "OR").await;
            }
            StageRequest::Move { view, .. } => build(
                &mut line,
                &[
                    Part::Axis(ROTATION),
                    Part::Text("PA"),
                    Part::Number(rotation_deg(view.rotation)),
                    Part::Text(";"),
                    Part::Axis(VERTICAL),
                    Part::Text("PA"),
                    Part::Number(vertical_mm(view.vertical)),
                ],
            )?,
            StageRequest::Retract { vertical, .. } => {
                // Whatever went wrong before may have switched the motor off, a limit switch does. And it left its
                // error: whether this order is obeyed shows in where the head stands.
                build(
                    &mut line,
                    &[
                        Part::Axis(VERTICAL),
                        Part::Text("MO;"),
                        Part::Axis(VERTICAL),
                        Part::Text("PA"),
                        Part::Number(vertical_mm(vertical)),
                    ],
                )?;
                self.send(&line).await?;
                return self.forget_errors().await;
            }
            StageRequest::Stop => {
                build(
                    &mut line,
                    &[
                        Part::Axis(ROTATION),
                        Part::Text("ST;"),
                        Part::Axis(VERTICAL),
                        Part::Text("ST"),
                    ],
                )?;
                // The retract is next, and must not wait for what a controller in trouble may answer.
                return self.send(&line).await;
            }
        }
        self.order(&line).await
    }

    async fn standing(&mut self) -> Result<Option<Pose>, StageFault> {
        for axis in [VERTICAL, ROTATION] {
            match self.axis_question(axis, "MD?").await? {
                0 => return Ok(None),
                1_000_000 => {}
                _ => return Err(nonsense()),
            }
        }
        match self.homing {
            Homing::Vertical => {
                // The head is clear of the die now; only then may the die turn.
                self.homing = Homing::Rotation;
                self.order_axis(ROTATION, "OR").await?;
                return Ok(None);
            }
            Homing::Rotation => self.homing = Homing::No,
            Homing::No => {}
        }
        // A stand that is none: a limit switch, a following error.
        self.oldest_error().await?;
        let rotation = self.axis_question(ROTATION, "TP?").await?;
        let vertical = self.axis_question(VERTICAL, "TP?").await?;
        let pose = rotation_from_deg(rotation).zip(vertical_from_mm(vertical));
        let (rotation, vertical) = pose.ok_or_else(nonsense)?;
        Ok(Some(Pose { rotation, vertical }))
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

enum Part<'a> {
    Axis(char),
    Text(&'a str),
    /// In millionths.
    Number(i64),
}

fn build(line: &mut Line, parts: &[Part<'_>]) -> Result<(), StageFault> {
    line.clear();
    let fits = parts.iter().all(|part| match part {
        Part::Axis(axis) => line.push(*axis).is_ok(),
        Part::Text(text) => line.push_str(text).is_ok(),
        Part::Number(millionths) => decimal::write(*millionths, line),
    });
    if fits { Ok(()) } else { Err(nonsense()) }
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
