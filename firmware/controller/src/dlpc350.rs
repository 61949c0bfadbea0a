//! Pattern engine: a TI DLPC350-class DMD controller over I2C, showing patterns out of its own flash.
//!
//! Each pattern is a sequence of one, so that one trigger shows exactly one pattern and a missed trigger can never
//! shift those behind it: stop, point the look-up tables at the pattern, validate, start, wait until it runs (its image comes from
//! flash), then trigger.
//!
//! | I2C write | read | meaning                            | bytes                                                  |
//! |-----------|------|------------------------------------|--------------------------------------------------------|
//! | `0xE5`    |      | pattern display start/stop         | 0 stop, 2 start                                        |
//! | `0xE6`    |      | exposure and frame period          | two u32, us                                            |
//! | `0xE9`    |      | display mode                       | 1 = pattern sequence                                   |
//! | `0xEF`    |      | pattern data source                | 3 = flash                                              |
//! | `0xF0`    |      | trigger mode                       | 1 = internal or external triggers                      |
//! | `0xF5`    |      | look-up table control              | entries-1, repeat, patterns per TRIG_OUT_2 -1, images-1 |
//! | `0xF6`    |      | look-up table offset               | 0..=127                                                |
//! | `0xF7`    |      | mailbox                            | 1 image indices, 2 pattern definitions, 0 closes       |
//! | `0xF8`    |      | mailbox data                       | image index, or a 3 byte pattern definition            |
//! |           | `0x22` | main status                      | bit 1: the sequence runs                               |
//! | `0xFD`    | `0x7D` | validation                       | bit 7 busy; bits 0..=4 what is wrong                   |
//!
//! An answer begins with a status byte, bit 0 of which says that the rest is one; until then it is read again, not asked
//! again, since a question replaces the answer to the one before.
//!
//! **What this rests on.** Codes, meaning of their bytes, layout of a pattern definition and order of the steps were
//! compared with the comments of TI's own host library for the DLPC350, with excerpts of its programmer's guide
//! (DLPU010) and, for every code in the table, the slave address, the write bit and the status byte, with the published
//! firmware of a 3D printer that drives this chip over I2C (Autodesk's Ember, `Hardware.h`, `Projector.cpp`). That
//! firmware shows patterns of the video input, not of the flash, and waits 100 ms between commands, for which neither it
//! nor the guide gives a reason. Nothing has been tried on a chip here: check the times on the first real board.

use crate::devices::{NotSelected, PatternPort};
use crate::dlpc::register::{DISPLAY_MODE, MAIN_STATUS, START_STOP};
use crate::dlpc::{BusFailed, PATTERNS, RUNNING, Registers, START, STOP};
use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::I2c;
use flankscope_protocol::Microseconds;
use flankscope_protocol::pattern_memory::Place;

/// Sub-addresses that only this chip has, or has in its own way.
mod register {
    pub const PERIODS: u8 = 0x66;
    pub const DATA_SOURCE: u8 = 0x6F;
    pub const TRIGGER_MODE: u8 = 0x70;
    pub const LUT_CONTROL: u8 = 0x75;
    pub const LUT_OFFSET: u8 = 0x76;
    pub const MAILBOX: u8 = 0x77;
    pub const MAILBOX_DATA: u8 = 0x78;
    pub const VALIDATE: u8 = 0x7D;
}

/// Of the status byte before an answer.
const READY: u8 = 1 << 0;
/// How often a validation is asked about, and how many times: it takes a few milliseconds.
const POLL: Duration = Duration::from_millis(1);
const POLLS: u32 = 15;

/// Binary patterns in one image.
const BINARY_PER_IMAGE: u16 = 24;
/// Image, pattern in it, bits, inverted: pattern 24 at 1 bit fills with white; inverted, with black.
const BLACK: (u16, u32, u32, u32) = (0, 24, 1, 1);

/// Bits per pixel of the stored patterns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BitDepth {
    /// Binary patterns: 24 in one image.
    One,
    /// Grey patterns: 3 in one image.
    Eight,
}

impl BitDepth {
    fn bits(self) -> u32 {
        match self {
            Self::One => 1,
            Self::Eight => 8,
        }
    }
}

/// What is true of the patterns in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Bits per pixel.
    pub depth: BitDepth,
    /// How long a pattern stands. The camera's exposure must end within.
    pub exposure: Microseconds,
    /// Patterns in flash, the black one not counted.
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
    /// The bus did not acknowledge.
    #[error(transparent)]
    Bus(#[from] BusFailed),
    #[error("the validation did not end within {limit_ms} ms")]
    Validating {
        /// Patience.
        limit_ms: u32,
    },
    /// The validation found the settings wrong; see [`Flaws`].
    #[error("the settings are invalid: {0:?}")]
    Invalid(Flaws),
}

/// What the validation found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flaws(pub u8);

impl Flaws {
    /// Exposure or frame period is impossible.
    pub const PERIOD: u8 = 1 << 0;
    /// A pattern number is impossible.
    pub const PATTERN: u8 = 1 << 1;
    /// TRIG_OUT_1 would not fall between patterns.
    pub const TRIGGER_OUT: u8 = 1 << 2;
    /// No black is shown before a triggered pattern: light of the old one could leak into the exposure.
    pub const POST_SECTOR: u8 = 1 << 3;
    /// Exposure and frame period differ by less than 230 us.
    pub const DIFFERENCE: u8 = 1 << 4;
    const BUSY: u8 = 1 << 7;
}

/// The driver. Owns its bus.
#[derive(Debug)]
pub struct Dlpc350<B> {
    registers: Registers<B>,
    settings: Settings,
    prepared: bool,
}

impl<B: I2c> Dlpc350<B> {
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

    /// Pattern mode, flash, external trigger, periods: once.
    async fn prepare(&mut self) -> Result<(), PatternError> {
        self.registers.write(DISPLAY_MODE, [PATTERNS]).await?;
        self.registers.write(START_STOP, [STOP]).await?;
        self.registers.write(register::DATA_SOURCE, [3]).await?;
        self.registers.write(register::TRIGGER_MODE, [1]).await?;
        let [a, b, c, d] = self.settings.exposure.get().to_le_bytes();
        // A triggered pattern follows no frame rate: the period is the exposure.
        self.registers
            .write(register::PERIODS, [a, b, c, d, a, b, c, d])
            .await?;
        self.prepared = true;
        Ok(())
    }

    /// Makes the controller wait for the trigger of this pattern; 0 is black, n the n-th in flash.
    ///
    /// # Errors
    /// No such pattern, a dead bus, or settings that the controller refuses.
    pub async fn arm(&mut self, pattern: u16) -> Result<(), PatternError> {
        let shown = self.arm_once(pattern).await;
        // Until it is seen to run the controller may have restarted: begin from nothing.
        self.prepared = false;
        shown
    }

    async fn arm_once(&mut self, pattern: u16) -> Result<(), PatternError> {
        let limit = self.settings.patterns;
        if pattern > limit {
            return Err(PatternError::NoSuchPattern {
                got: pattern,
                limit,
            });
        }
        if !self.prepared {
            self.prepare().await?;
        }
        let (image, definition) = self.definition(pattern);
        let to = &mut self.registers;
        to.write(START_STOP, [STOP]).await?;
        // One entry, once, one pattern per TRIG_OUT_2, one image: all counted from 0 on the wire.
        to.write(register::LUT_CONTROL, [0, 0, 0, 0]).await?;
        to.write(register::MAILBOX, [1]).await?;
        to.write(register::LUT_OFFSET, [0]).await?;
        to.write(register::MAILBOX_DATA, [image]).await?;
        to.write(register::MAILBOX, [0]).await?;
        to.write(register::MAILBOX, [2]).await?;
        to.write(register::LUT_OFFSET, [0]).await?;
        to.write(register::MAILBOX_DATA, definition).await?;
        to.write(register::MAILBOX, [0]).await?;
        self.validate().await?;
        Ok(self.registers.write(START_STOP, [START]).await?)
    }

    async fn validate(&mut self) -> Result<(), PatternError> {
        self.registers.write(register::VALIDATE, []).await?;
        let mut asked = false;
        for _ in 0..POLLS {
            if !asked {
                self.registers.ask(register::VALIDATE).await?;
            }
            Timer::after(POLL).await;
            let [status, flaws] = self.registers.answer().await?;
            asked = status & READY == 0;
            match flaws {
                _ if asked => {}
                0 => return Ok(()),
                busy if busy & Flaws::BUSY != 0 => {}
                flaws => return Err(PatternError::Invalid(Flaws(flaws))),
            }
        }
        Err(PatternError::Validating { limit_ms: POLLS })
    }

    /// Whether the pattern armed last has been fetched from flash and waits for its trigger.
    ///
    /// # Errors
    /// A dead bus.
    pub async fn is_waiting(&mut self) -> Result<bool, PatternError> {
        self.registers.ask(MAIN_STATUS).await?;
        let [status, main] = self.registers.answer().await?;
        self.prepared = status & READY != 0 && main & RUNNING != 0;
        Ok(self.prepared)
    }

    /// Flash image and table entry of a pattern.
    ///
    /// Bits 0..=1 trigger (1 external, rising edge), 2..=7 pattern within the image, 8..=11 bit depth, 12..=14 LEDs
    /// (0: the LED is ours to drive), 16 invert, 17 black behind it, 18 swap to another image.
    fn definition(&self, pattern: u16) -> (u8, [u8; 3]) {
        let depth = self.settings.depth;
        let (image, within, depth_bits, invert) = match (depth, pattern.checked_sub(1)) {
            (BitDepth::One, Some(index)) => (
                index / BINARY_PER_IMAGE,
                u32::from(index % BINARY_PER_IMAGE),
                depth.bits(),
                0,
            ),
            (BitDepth::Eight, Some(_)) => match Place::of(pattern) {
                Some(Place { image, plane }) => (image, plane as u32, depth.bits(), 0),
                None => BLACK,
            },
            (_, None) => BLACK,
        };
        let word = 1 | within << 2 | depth_bits << 8 | invert << 16 | 1 << 18;
        let [a, b, c, _] = word.to_le_bytes();
        (u8::try_from(image).unwrap_or(u8::MAX), [a, b, c])
    }
}

impl<B: I2c> PatternPort for Dlpc350<B> {
    async fn select(&mut self, pattern: u16) -> Result<(), NotSelected> {
        self.arm(pattern).await.map_err(|_| NotSelected)
    }
    async fn is_loaded(&mut self) -> Result<bool, NotSelected> {
        self.is_waiting().await.map_err(|_| NotSelected)
    }
}
