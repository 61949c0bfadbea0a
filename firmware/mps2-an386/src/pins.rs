//! Virtual pins: what a pin drives goes to the bench over UART1 with the time of the edge, inputs come back the same way.

use core::cell::Cell;
use core::convert::Infallible;
use core::future::poll_fn;
use core::sync::atomic::{AtomicU16, AtomicU32, Ordering};
use core::task::Poll;

use critical_section::Mutex;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_hal::digital::{ErrorType, OutputPin};
use embedded_hal_async::digital::Wait;
use flankscope_controller::devices::{CurrentSetting, NotSelected, PatternPort};
use flankscope_protocol::Milliamps;

use crate::bench_wire::{self, BENCH};
use crate::{clock, stack};
use flankscope_pin_wire::{InputDecoder, Subject};

static DECODER: Mutex<Cell<InputDecoder>> = Mutex::new(Cell::new(InputDecoder::new()));

/// Sends one message; its time is now.
pub fn tell(subject: Subject, value: u16) {
    // No interrupt may come between the look at the clock and the last byte.
    critical_section::with(|_| bench_wire::send(subject, value, clock::now_us()));
}

/// UART1's receive interrupt.
pub fn on_receive() {
    while let Some(byte) = BENCH.receive_now() {
        let message = critical_section::with(|cs| {
            let mut decoder = DECODER.borrow(cs).get();
            let message = decoder.push(byte);
            DECODER.borrow(cs).set(decoder);
            message
        });
        if let Some((subject, value)) = message {
            hear(subject, u16::from(value));
        }
    }
}

fn hear(subject: Subject, value: u16) {
    let input = match subject {
        Subject::LedSense => &LED_SENSE,
        Subject::DmdReady => &DMD_READY,
        Subject::CameraReady => &CAMERA_READY,
        Subject::CameraExposing => &CAMERA_EXPOSING,
        Subject::PatternTaken => &PATTERN_TAKEN,
        Subject::PressOpenA => &PRESS_OPEN_A,
        Subject::PressOpenB => &PRESS_OPEN_B,
        Subject::DieClear => &DIE_CLEAR,
        Subject::GuardClosed => &GUARD_CLOSED,
        Subject::Cycle => &CYCLE,
        Subject::RetractSwitch => &RETRACT_SWITCH,
        Subject::Tick => return clock::on_answer(),
        Subject::StackUsed => {
            return tell(
                subject,
                u16::try_from(stack::used_bytes()).unwrap_or(u16::MAX),
            );
        }
        Subject::AlarmLatency => {
            return tell(
                subject,
                u16::try_from(clock::latest_alarm_us()).unwrap_or(u16::MAX),
            );
        }
        #[cfg(feature = "fault-injection")]
        Subject::InjectFault => return crate::fault_injection::order(value as u8),
        #[cfg(not(feature = "fault-injection"))]
        Subject::InjectFault => return,
        Subject::LedEnable
        | Subject::LedCurrent
        | Subject::DmdTrigger
        | Subject::CameraTrigger
        | Subject::SelectPattern
        | Subject::Started
        | Subject::HeadClear1
        | Subject::HeadClear2
        | Subject::Go
        | Subject::NoGo
        | Subject::VerdictBeat => return,
    };
    input.set(value);
    tell(subject, value);
}

/// An output pin, low at start.
pub struct Output {
    subject: Subject,
    level: bool,
}

impl ErrorType for Output {
    type Error = Infallible;
}

impl OutputPin for Output {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.drive(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.drive(true);
        Ok(())
    }
}

impl Output {
    /// The pin of this subject.
    pub const fn new(subject: Subject) -> Self {
        Self {
            subject,
            level: false,
        }
    }

    /// Only a change is an edge.
    fn drive(&mut self, level: bool) {
        if self.level == level {
            return;
        }
        self.level = level;
        tell(self.subject, u16::from(level));
    }
}

/// An input pin, or another number that the bench sets.
pub struct Input {
    value: AtomicU16,
    rises: AtomicU32,
    falls: AtomicU32,
    waiting: AtomicWaker,
}

pub static LED_SENSE: Input = Input::new();
pub static DMD_READY: Input = Input::new();
pub static CAMERA_READY: Input = Input::new();
pub static CAMERA_EXPOSING: Input = Input::new();
pub static PRESS_OPEN_A: Input = Input::new();
pub static PRESS_OPEN_B: Input = Input::new();
pub static DIE_CLEAR: Input = Input::new();
pub static GUARD_CLOSED: Input = Input::new();
pub static CYCLE: Input = Input::new();
pub static RETRACT_SWITCH: Input = Input::new();
static PATTERN_TAKEN: Input = Input::new();

/// No answer yet.
const UNANSWERED: u16 = u16::MAX;

/// Waits until the bench has said how every input stands; a real pin has its level from the first instant.
pub async fn levels_known() {
    for input in [
        &LED_SENSE,
        &DMD_READY,
        &CAMERA_READY,
        &CAMERA_EXPOSING,
        &PRESS_OPEN_A,
        &PRESS_OPEN_B,
        &DIE_CLEAR,
        &GUARD_CLOSED,
        &CYCLE,
        &RETRACT_SWITCH,
    ] {
        input.answered().await;
    }
}

impl Input {
    const fn new() -> Self {
        Self {
            value: AtomicU16::new(UNANSWERED),
            rises: AtomicU32::new(0),
            falls: AtomicU32::new(0),
            waiting: AtomicWaker::new(),
        }
    }

    /// From the interrupt.
    fn set(&self, value: u16) {
        let before = self.value.swap(value, Ordering::AcqRel);
        if before == 0 && value != 0 {
            self.rises.fetch_add(1, Ordering::Relaxed);
        }
        if before != 0 && value == 0 {
            self.falls.fetch_add(1, Ordering::Relaxed);
        }
        self.waiting.wake();
    }

    async fn wait(&self, mut over: impl FnMut(&Self) -> bool) {
        poll_fn(|context| {
            self.waiting.register(context.waker());
            if over(self) {
                Poll::Ready(())
            } else {
                Poll::Pending
            }
        })
        .await;
    }

    async fn answered(&self) {
        self.wait(|input| input.value.load(Ordering::Acquire) != UNANSWERED)
            .await;
    }

    fn edges(&self) -> (u32, u32) {
        (
            self.rises.load(Ordering::Relaxed),
            self.falls.load(Ordering::Relaxed),
        )
    }
}

/// A pin's end in a driver.
#[derive(Clone, Copy)]
pub struct InputPin(pub &'static Input);

impl ErrorType for InputPin {
    type Error = Infallible;
}

impl embedded_hal::digital::InputPin for InputPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.value.load(Ordering::Acquire) != 0)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.value.load(Ordering::Acquire) == 0)
    }
}

impl Wait for InputPin {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.0
            .wait(|input| input.value.load(Ordering::Acquire) != 0)
            .await;
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.0
            .wait(|input| input.value.load(Ordering::Acquire) == 0)
            .await;
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        let (before, _) = self.0.edges();
        self.0.wait(|input| input.edges().0 != before).await;
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        let (_, before) = self.0.edges();
        self.0.wait(|input| input.edges().1 != before).await;
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        let before = self.0.edges();
        self.0.wait(|input| input.edges() != before).await;
        Ok(())
    }
}

/// The bus to the DMD controller.
pub struct PatternBus;

impl PatternPort for PatternBus {
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected> {
        PATTERN_TAKEN.value.store(UNANSWERED, Ordering::Release);
        tell(Subject::SelectPattern, pattern);
        PATTERN_TAKEN.answered().await;
        match PATTERN_TAKEN.value.load(Ordering::Acquire) {
            0 => Err(NotSelected),
            _ => Ok(()),
        }
    }
}

/// The LED driver's current setting.
pub struct Current;

impl CurrentSetting for Current {
    fn set(&mut self, current: Milliamps) {
        tell(Subject::LedCurrent, current.get());
    }
}
