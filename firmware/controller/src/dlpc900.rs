//! Pattern engine: a TI DLPC900 over I2C, showing patterns out of its own flash. With a DLP5500 it drives 1024 x 768 mirrors.
//!
//! Each pattern is a sequence of one, as [`crate::dlpc350`] has it: stop, define the one entry of the look-up table, take it over,
//! start, then wait for the trigger. A missed trigger can never shift those behind it. What is shown before and behind a triggered
//! pattern is black; TRIG_OUT_1 is high while it stands, which is the board's "DMD ready".
//!
//! Image n in flash is pattern n, image 0 is black, for the chip has no black of its own. Each is a grey image of 24 bit, so that no
//! order of its colours matters: for that no second source was at hand.
//!
//! | I2C write | read   | meaning                  | bytes, least significant first                                          |
//! |-----------|--------|--------------------------|-------------------------------------------------------------------------|
//! | `0xE5`    |        | start/stop               | 0 stop, 2 start                                                         |
//! | `0xE9`    |        | display mode             | 1 = stored patterns                                                     |
//! | `0xF5`    |        | look-up table, execution | u16 entries, u32 patterns to show                                       |
//! | `0xF8`    |        | look-up table, one entry | 12 bytes, see `Dlpc900::entry`                                          |
//! | `0xF9`    |        | TRIG_IN_1                | u16 delay, us; bit 0: 0 = rising edge                                   |
//! |           | `0x22` | main status              | bit 1: the sequence runs                                                |
//! |           | `0x12` | kind of the firmware     | first byte: the DMD, 5 = DLP5500; then 32 letters                       |
//! |           | `0x32` | error of the last command | 0 none; 3 no such command, 5 not in this mode, 6 and 9 to 17 the pattern |
//!
//! **What this rests on.** Addresses, bytes and their meaning: TI's programmer's guide for the chip (DLPU018, revisions I and J:
//! sections 1.1, 2.1, 2.4 and appendix A), each compared with TI's own host library as its users publish it (`CmdList` of
//! `API.c`: I2C and USB numbers side by side, and lengths) and with a published program that runs such modules over USB (dlpyc900:
//! kinds of DMD, numbers of errors). That the bytes over I2C are those over USB is the guide's word (1.1.1.4). Nothing has been tried on
//! a chip here: check the times on the first real board.

use crate::devices::{NotSelected, PatternPort};
use crate::dlpc::register::{DISPLAY_MODE, MAIN_STATUS, START_STOP};
use crate::dlpc::{BusFailed, PATTERNS, RUNNING, Registers, START, STOP};
use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::I2c;
use flankscope_protocol::Microseconds;

/// Sub-addresses that only this chip has, or has in its own way.
mod register {
    pub const KIND: u8 = 0x12;
    pub const ERROR: u8 = 0x32;
    pub const EXECUTION: u8 = 0x75;
    pub const ENTRY: u8 = 0x78;
    pub const TRIGGER_IN: u8 = 0x79;
}

/// Least delay of a trigger that the chip takes, us.
const TRIGGER_DELAY_US: u16 = 105;
/// Of a table entry's sixth byte: 8 bits, LEDs left alone, wait for a trigger.
const EIGHT_BITS: u8 = 7 << 1;
const WAIT_FOR_TRIGGER: u8 = 1 << 7;
/// Of its tenth: no pulse on TRIG_OUT_2.
const WITHOUT_TRIGGER_OUT_2: u8 = 1;
/// Images are numbered from 0.
const LAST_IMAGE: u16 = 255;
/// An exposure is told in 24 bits.
const LONGEST: Microseconds = Microseconds(0x00FF_FFFF);
/// The changed mode is not asked about before: the chip takes its time to fetch its first image.
const MODE_PAUSE: Duration = Duration::from_millis(2);

/// The DMD behind the controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Mirrors {
    /// 1920 x 1080.
    Dlp6500 = 1,
    /// 1024 x 768.
    Dlp5500 = 5,
}

/// What is true of the patterns in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// What the patterns were made for.
    pub mirrors: Mirrors,
    /// How long a pattern stands. The camera's exposure must end within.
    pub exposure: Microseconds,
    /// Patterns in flash, each of 8 bits in an image of its own; image 0, the black one, not counted. At most 255.
    pub patterns: u16,
}

/// Why the controller did not take a pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PatternError {
    /// No such pattern in flash.
    #[error("pattern {got} of {limit}")]
    NoSuchPattern {
        /// Asked for.
        got: u16,
        /// In flash.
        limit: u16,
    },
    /// A pattern cannot stand so long.
    #[error("a pattern of {got}; at most {limit}")]
    TooLong {
        /// Asked for.
        got: Microseconds,
        /// Longest.
        limit: Microseconds,
    },
    /// The bus did not acknowledge.
    #[error(transparent)]
    Bus(#[from] BusFailed),
    #[error("the controller drives DMD number {got}, the patterns are for {want}")]
    OtherMirrors {
        /// By its own word, in its own numbering.
        got: u8,
        /// The settings'.
        want: u8,
    },
    /// The controller refused the last command.
    #[error("the controller says error {0} of its programmer's guide")]
    Refused(u8),
}

/// The driver. Owns its bus.
#[derive(Debug)]
pub struct Dlpc900<B> {
    registers: Registers<B>,
    settings: Settings,
    prepared: bool,
}

impl<B: I2c> Dlpc900<B> {
    /// Nothing is sent before the first selection.
    pub const fn new(bus: B, settings: Settings) -> Self {
        Self {
            registers: Registers(bus),
            settings,
            prepared: false,
        }
    }

    /// Gives the bus back.
    pub fn release(self) -> B {
        self.registers.0
    }

    /// Sends a command and asks whether it was taken.
    async fn order<const N: usize>(
        &mut self,
        register: u8,
        data: [u8; N],
    ) -> Result<(), PatternError> {
        self.registers.write(register, data).await?;
        match self.first_byte(register::ERROR).await? {
            0 => Ok(()),
            code => Err(PatternError::Refused(code)),
        }
    }

    /// The first byte of an answer.
    async fn first_byte(&mut self, register: u8) -> Result<u8, PatternError> {
        self.registers.ask(register).await?;
        let [byte] = self.registers.answer().await?;
        Ok(byte)
    }

    /// The right mirrors, stored patterns, rising edge: once.
    async fn prepare(&mut self) -> Result<(), PatternError> {
        let (got, want) = (
            self.first_byte(register::KIND).await?,
            self.settings.mirrors as u8,
        );
        if got != want {
            return Err(PatternError::OtherMirrors { got, want });
        }
        self.order(START_STOP, [STOP]).await?;
        self.order(DISPLAY_MODE, [PATTERNS]).await?;
        Timer::after(MODE_PAUSE).await;
        let [low, high] = TRIGGER_DELAY_US.to_le_bytes();
        self.order(register::TRIGGER_IN, [low, high, 0]).await?;
        self.prepared = true;
        Ok(())
    }

    /// Makes the controller wait for the trigger of this pattern; 0 is black, n the n-th in flash.
    ///
    /// # Errors
    /// No such pattern, a dead bus, other mirrors, or settings that the controller refuses.
    pub async fn arm(&mut self, pattern: u16) -> Result<(), PatternError> {
        let armed = self.arm_once(pattern).await;
        // Until it is seen to run the controller may have restarted: begin from nothing.
        self.prepared = false;
        armed
    }

    async fn arm_once(&mut self, pattern: u16) -> Result<(), PatternError> {
        let (limit, exposure) = (
            self.settings.patterns.min(LAST_IMAGE),
            self.settings.exposure,
        );
        if pattern > limit {
            return Err(PatternError::NoSuchPattern {
                got: pattern,
                limit,
            });
        }
        if exposure > LONGEST {
            return Err(PatternError::TooLong {
                got: exposure,
                limit: LONGEST,
            });
        }
        if !self.prepared {
            self.prepare().await?;
        }
        self.order(START_STOP, [STOP]).await?;
        let entry = self.entry(pattern);
        self.order(register::ENTRY, entry).await?;
        // One entry, one pattern: shown once, then black.
        self.order(register::EXECUTION, [1, 0, 1, 0, 0, 0]).await?;
        self.order(START_STOP, [START]).await
    }

    /// Whether the pattern armed last has been fetched from flash and waits for its trigger.
    ///
    /// # Errors
    /// A dead bus.
    pub async fn is_waiting(&mut self) -> Result<bool, PatternError> {
        self.prepared = self.first_byte(MAIN_STATUS).await? & RUNNING != 0;
        Ok(self.prepared)
    }

    /// Table entry of a pattern.
    ///
    /// | byte | bits | |
    /// |---|---|---|
    /// | 0, 1 | | number of the entry |
    /// | 2 to 4 | | exposure, us |
    /// | 5 | 0 | clear behind it, of 1 bit patterns |
    /// | | 1 to 3 | bits less one |
    /// | | 4 to 6 | LEDs; 0: the LED is ours to drive |
    /// | | 7 | wait for the trigger |
    /// | 6 to 8 | | black behind it, us |
    /// | 9 | 0 | no pulse on TRIG_OUT_2 |
    /// | 10, 11 | 0 to 10 | image |
    /// | | 11 to 15 | first bit plane in it |
    fn entry(&self, pattern: u16) -> [u8; 12] {
        let [a, b, c, _] = self.settings.exposure.get().to_le_bytes();
        // Its own image, grey: from bit plane 0 on, whatever colour has that number.
        let [low, high] = pattern.to_le_bytes();
        let five = EIGHT_BITS | WAIT_FOR_TRIGGER;
        [
            0,
            0,
            a,
            b,
            c,
            five,
            0,
            0,
            0,
            WITHOUT_TRIGGER_OUT_2,
            low,
            high,
        ]
    }
}

impl<B: I2c> PatternPort for Dlpc900<B> {
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected> {
        self.arm(pattern).await.map_err(|_| NotSelected)
    }
    async fn is_loaded(&mut self) -> Result<bool, NotSelected> {
        self.is_waiting().await.map_err(|_| NotSelected)
    }
}
