//! Liquid lens driver: the registers of a MAX14574, by the usage in published drivers, independent of the controller's driver.

use super::DeviceFault;
use flankscope_sim::i2c::I2cDevice;

/// I2C address.
pub const ADDRESS: u8 = 0x77;

const STATUS: usize = 0x00;
const FAIL: usize = 0x01;
const USERMODE: usize = 0x03;
const OIS_LSB: usize = 0x04;
const LLV1: usize = 0x05;
const COMMAND: usize = 0x09;
/// The last register.
const DRIVERCONF: usize = 0x0A;

/// Number of reads of the command register until the connection test is finished.
const TEST_READS: u32 = 2;
/// Outputs 3 and 4 have no lens, as the test always reports.
const BARE: u8 = 0b1100;

/// The chip with two lenses on its first two outputs.
pub struct Chip<T, P> {
    registers: [u8; DRIVERCONF + 1],
    at: usize,
    /// Number of reads until the test is finished.
    testing: u32,
    /// Present fault.
    trouble: T,
    /// Called with the voltages of the lenses; `None` if they are off.
    put_out: P,
}

impl<T: Fn(DeviceFault) -> bool, P: FnMut(Option<u16>)> Chip<T, P> {
    /// State after power-up: sleep mode.
    pub fn new(trouble: T, put_out: P) -> Self {
        Self {
            registers: [0; DRIVERCONF + 1],
            at: 0,
            testing: 0,
            trouble,
            put_out,
        }
    }

    fn is_on(&self) -> bool {
        self.registers[USERMODE] & 0b11 == 0b11
    }

    fn store(&mut self, register: usize, byte: u8) {
        match register {
            USERMODE => {
                self.registers[USERMODE] = byte;
                if !self.is_on() {
                    (self.put_out)(None);
                }
            }
            COMMAND => {
                if byte & 1 != 0 {
                    self.testing = TEST_READS;
                }
                if byte & 2 != 0 && self.is_on() {
                    let low = u16::from(self.registers[OIS_LSB] & 3);
                    (self.put_out)(Some(u16::from(self.registers[LLV1]) << 2 | low));
                }
            }
            OIS_LSB..COMMAND | DRIVERCONF => self.registers[register] = byte,
            // Read-only or unused registers.
            _ => {}
        }
    }

    fn load(&mut self, register: usize) -> u8 {
        let bit = |fault, bit: u8| u8::from((self.trouble)(fault)) << bit;
        match register {
            STATUS if self.is_on() => {
                bit(DeviceFault::LensHot, 4) | bit(DeviceFault::LensNoBoost, 2)
            }
            FAIL => BARE | bit(DeviceFault::LensOpen, 0) | bit(DeviceFault::LensShort, 5),
            COMMAND => {
                self.testing = self.testing.saturating_sub(1);
                u8::from(self.testing > 0)
            }
            other => self.registers.get(other).copied().unwrap_or(0),
        }
    }
}

impl<T: Fn(DeviceFault) -> bool, P: FnMut(Option<u16>)> I2cDevice for Chip<T, P> {
    fn write(&mut self, bytes: &[u8]) -> bool {
        if (self.trouble)(DeviceFault::LensSilent) {
            return false;
        }
        let Some((&first, data)) = bytes.split_first() else {
            return true;
        };
        self.at = usize::from(first);
        for &byte in data {
            self.store(self.at, byte);
            self.at += 1;
        }
        true
    }

    fn read(&mut self, answer: &mut [u8]) -> bool {
        if (self.trouble)(DeviceFault::LensSilent) {
            return false;
        }
        if (self.trouble)(DeviceFault::LensForgets) {
            // Its supply failed briefly.
            self.registers = [0; DRIVERCONF + 1];
            (self.put_out)(None);
        }
        for byte in answer {
            *byte = self.load(self.at);
            self.at += 1;
        }
        true
    }
}
