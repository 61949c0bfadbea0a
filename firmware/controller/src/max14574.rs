//! Liquid lens driver: a MAX14574 over I2C, giving an electrowetting lens (Varioptic's A-25H and A-39N class) its voltage.
//!
//! The driver counts 1024 steps of an alternating voltage, from 24.4 V rms on; a lens' power is nearly in proportion to it. Counts
//! are what is commanded and read back here: the sources agree on 24.4 V and on about 70 V for the last step, and differ by half a
//! percent in the step (44.2 to 44.5 mV). All four outputs get the same counts, so that two equal lenses (before camera and
//! projector) hang on any two of them.
//!
//! | register | name     | bits                                                                                    |
//! |----------|----------|-----------------------------------------------------------------------------------------|
//! | `0x00`   | STATUS   | 4 thermal shutdown, 2 the boost converter does not reach its voltage                    |
//! | `0x01`   | FAIL     | 6 open, 5 short, 4 the common connection, 3..=0 connections of outputs 4 to 1            |
//! | `0x03`   | USERMODE | 1 active, 0 awake; 0 is off                                                              |
//! | `0x04`   | OIS_LSB  | the two low bits of outputs 1 (1..=0) to 4 (7..=6)                                       |
//! | `0x05..` | LLV1..4  | the eight high bits of each output                                                       |
//! | `0x09`   | COMMAND  | 1 put the voltages out, 0 test the connections: stays 1 until FAIL is the test's result |
//!
//! **What this rests on.** Not the data sheet, which was not at hand: address, registers and bits were compared between a Linux
//! driver of a drone's camera (`drivers/media/video/max14574.c` and its header), a liquid-lens eyepiece's firmware (`max14574.h`),
//! a Python library for a single-board computer, and two microscopes that write it (UCLA's Miniscope V4 through its data
//! acquisition and OpenEphys, and a squid microscope's controller). They agree but in one: the Python library has the thermal
//! shutdown in bit 3 of STATUS, both C headers in bit 4. Writes of several registers in one transaction are the microscopes'
//! (USERMODE on, LLV4 on). Reads here are of one register at a time, as all sources do. **Assumed:** that the test of the
//! connections ends within [`TEST_POLLS`] ms, and that outputs without a lens show only in their own bits of FAIL. Nothing has been
//! tried on a chip here.

use crate::lens::{Lens, LensFault};
use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::I2c;
use flankscope_protocol::{Fault, LensCounts};

/// 7 bit slave address (`0xEE`/`0xEF` on the wire).
pub const ADDRESS: u8 = 0x77;

mod register {
    pub const STATUS: u8 = 0x00;
    pub const FAIL: u8 = 0x01;
    pub const USERMODE: u8 = 0x03;
    pub const OIS_LSB: u8 = 0x04;
    pub const LLV1: u8 = 0x05;
    pub const COMMAND: u8 = 0x09;
}

const HOT: u8 = 1 << 4;
const NO_BOOST: u8 = 1 << 2;
const OPEN: u8 = 1 << 6;
const SHORT: u8 = 1 << 5;
const NO_COMMON: u8 = 1 << 4;
const ACTIVE: u8 = 1 << 1;
const AWAKE: u8 = 1 << 0;
const PUT_OUT: u8 = 1 << 1;
const TEST: u8 = 1 << 0;
/// The largest count.
const COUNTS_MAX: u16 = 1023;
/// How often and how many times the end of the test is asked for.
const POLL: Duration = Duration::from_millis(1);
/// See there.
pub const TEST_POLLS: u32 = 10;

/// The driver. Owns its bus.
#[derive(Debug)]
pub struct Max14574<B> {
    bus: B,
    /// Outputs with a lens, a bit each from output 1 on.
    outputs: u8,
}

impl<B: I2c> Max14574<B> {
    /// `outputs`: those with a lens, a bit each from output 1 on. Nothing is sent yet.
    pub const fn new(bus: B, outputs: u8) -> Self {
        Self {
            bus,
            outputs: outputs & 0x0F,
        }
    }

    async fn write(&mut self, bytes: &[u8]) -> Result<(), LensFault> {
        let written = self.bus.write(ADDRESS, bytes).await;
        written.map_err(|_| LensFault::of(Fault::LensSilent, bytes.first()))
    }

    async fn read(&mut self, register: u8) -> Result<u8, LensFault> {
        let mut answer = [0];
        let read = self.bus.write_read(ADDRESS, &[register], &mut answer).await;
        read.map_err(|_| LensFault::of(Fault::LensSilent, Some(&register)))?;
        let [answer] = answer;
        Ok(answer)
    }

    /// It is active, every output has these counts, and nothing is wrong with it.
    async fn verify(&mut self, high: u8, low: u8) -> Result<(), LensFault> {
        for (register, want) in [
            (register::USERMODE, ACTIVE | AWAKE),
            (register::OIS_LSB, low),
        ] {
            let got = self.read(register).await?;
            if got != want {
                return Err(LensFault::of(Fault::LensLost, Some(&got)));
            }
        }
        for output in 0..4 {
            let got = self.read(register::LLV1 + output).await?;
            if got != high {
                return Err(LensFault::of(Fault::LensLost, Some(&got)));
            }
        }
        let status = self.read(register::STATUS).await?;
        match status {
            hot if hot & HOT != 0 => Err(LensFault::of(Fault::LensHot, Some(&status))),
            low if low & NO_BOOST != 0 => Err(LensFault::of(Fault::LensVoltage, Some(&status))),
            _ => Ok(()),
        }
    }

    /// A lens hangs on every output that should have one, and none is shorted.
    async fn connected(&mut self) -> Result<(), LensFault> {
        self.write(&[register::COMMAND, TEST]).await?;
        for _ in 0..TEST_POLLS {
            Timer::after(POLL).await;
            if self.read(register::COMMAND).await? & TEST != 0 {
                continue;
            }
            let fail = self.read(register::FAIL).await?;
            return match fail {
                short if short & SHORT != 0 => Err(LensFault::of(Fault::LensShort, Some(&fail))),
                open if open & (OPEN | NO_COMMON | self.outputs) != 0 => {
                    Err(LensFault::of(Fault::LensOpen, Some(&fail)))
                }
                _ => Ok(()),
            };
        }
        Err(LensFault::of(Fault::LensSilent, Some(&register::COMMAND)))
    }
}

/// High and low bits of counts, the low ones for all four outputs.
fn split(LensCounts(counts): LensCounts) -> (u8, u8) {
    let counts = counts.min(COUNTS_MAX);
    let [low, _] = (counts & 3).to_le_bytes();
    let [high, _] = (counts >> 2).to_le_bytes();
    (high, low * 0b0101_0101)
}

impl<B: I2c> Lens for Max14574<B> {
    async fn off(&mut self) -> bool {
        self.write(&[register::USERMODE, 0]).await.is_ok()
    }

    async fn set(&mut self, counts: LensCounts) -> Result<(), LensFault> {
        let (high, low) = split(counts);
        self.write(&[register::USERMODE, ACTIVE | AWAKE, low])
            .await?;
        self.write(&[register::LLV1, high, high, high, high, PUT_OUT])
            .await?;
        // Before the lens comes to rest, in case that it feels the test.
        self.connected().await?;
        self.verify(high, low).await
    }

    async fn check(&mut self, counts: LensCounts) -> Result<(), LensFault> {
        let (high, low) = split(counts);
        self.verify(high, low).await
    }
}
