//! What TI's pattern controllers have in common on the bus: slave address, write bit, commands that both know. Their documents stand with [`crate::dlpc350`] and [`crate::dlpc900`].

use embedded_hal_async::i2c::I2c;

/// 7 bit slave address (`0x34`/`0x35` on the wire) that the chips have unless their firmware was built with another.
pub const ADDRESS: u8 = 0x1A;

/// Sub-addresses for reading; with the highest bit set they are those for writing.
pub mod register {
    /// Main status: bit 1 is set while a sequence runs, which one that waits for its trigger does.
    pub const MAIN_STATUS: u8 = 0x22;
    /// Pattern display, start or stop.
    pub const START_STOP: u8 = 0x65;
    pub const DISPLAY_MODE: u8 = 0x69;
}

const WRITE: u8 = 0x80;
/// Longest command with its sub-address, bytes.
const LONGEST: usize = 13;

/// Of [`register::START_STOP`].
pub const STOP: u8 = 0;
/// Of [`register::START_STOP`].
pub const START: u8 = 2;
/// Of [`register::MAIN_STATUS`]: the sequencer runs. Until then it fetches its image from flash, and misses a trigger.
pub const RUNNING: u8 = 1 << 1;
/// Of [`register::DISPLAY_MODE`]: patterns, not video.
pub const PATTERNS: u8 = 1;

/// The bus did not acknowledge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the I2C bus failed")]
pub struct BusFailed;

/// A controller's registers. Owns its bus.
#[derive(Debug)]
pub struct Registers<B>(pub B);

impl<B: I2c> Registers<B> {
    /// Sends a command.
    ///
    /// # Errors
    /// The bus did not acknowledge.
    pub async fn write<const N: usize>(
        &mut self,
        register: u8,
        data: [u8; N],
    ) -> Result<(), BusFailed> {
        const { assert!(N < LONGEST) };
        let mut bytes: heapless::Vec<u8, LONGEST> = heapless::Vec::new();
        let fits = bytes.push(register | WRITE).is_ok() && bytes.extend_from_slice(&data).is_ok();
        debug_assert!(fits);
        let written = self.0.write(ADDRESS, &bytes).await;
        written.map_err(|_| BusFailed)
    }

    /// Asks for a register's answer; an answer to an earlier question is lost.
    ///
    /// # Errors
    /// The bus did not acknowledge.
    pub async fn ask(&mut self, register: u8) -> Result<(), BusFailed> {
        let asked = self.0.write(ADDRESS, &[register]).await;
        asked.map_err(|_| BusFailed)
    }

    /// The first bytes of the answer.
    ///
    /// # Errors
    /// The bus did not acknowledge.
    pub async fn answer<const N: usize>(&mut self) -> Result<[u8; N], BusFailed> {
        let mut answer = [0; N];
        let read = self.0.read(ADDRESS, &mut answer).await;
        read.map_err(|_| BusFailed).map(|()| answer)
    }
}
