//! The serial line between host and controller: the one place that says how it is set.
//!
//! The host opens its port with [`Line::HOST`], both board images set their UART to it, and a test holds the table in
//! `firmware/README.md` to it. A pseudo-terminal carries bytes at any speed, so a test also reads the settings that the host
//! left on one and compares them with those in the images.

use core::fmt;
use serde::{Deserialize, Serialize};

/// Parity of a character.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum Parity {
    /// No parity bit.
    None = 0,
    /// An even number of ones.
    Even = 1,
    /// An odd number of ones.
    Odd = 2,
}

/// Who may stop whom.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(u8)]
pub enum FlowControl {
    /// Nobody: each side reads as fast as the other writes.
    None = 0,
    /// By the lines RTS and CTS.
    RtsCts = 1,
}

/// How an asynchronous serial line is set.
///
/// Its layout is fixed, so that it can be read out of a board's image: baud in little endian, then one byte each for data
/// bits, parity, stop bits and flow control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[repr(C)]
pub struct Line {
    /// Bit/s.
    pub baud: u32,
    /// Data bits of a character.
    pub data_bits: u8,
    /// Parity of a character.
    pub parity: Parity,
    /// Stop bits of a character.
    pub stop_bits: u8,
    /// Who may stop whom.
    pub flow: FlowControl,
}

impl Line {
    /// Between host and controller. A trigger event of 40 bytes takes 0.4 ms; 25 MHz and 100 MHz, the clocks of the boards'
    /// UARTs, divide to it within 0.5 %, a quarter of what a receiver bears.
    pub const HOST: Self = Self {
        baud: 921_600,
        data_bits: 8,
        parity: Parity::None,
        stop_bits: 1,
        flow: FlowControl::None,
    };

    /// What a character takes on the wire, ns: a start bit, data, parity, stop bits.
    #[must_use]
    pub const fn byte_ns(&self) -> u64 {
        let parity = !matches!(self.parity, Parity::None) as u8;
        let bits = 1u8
            .saturating_add(self.data_bits)
            .saturating_add(parity)
            .saturating_add(self.stop_bits);
        match (bits as u64)
            .saturating_mul(1_000_000_000)
            .checked_div(self.baud as u64)
        {
            Some(time_ns) => time_ns,
            None => u64::MAX,
        }
    }

    /// Divider of a clock for this speed, to the nearest; `None` where no divider comes within 2 %: a receiver that samples the
    /// middle of the tenth bit bears 5 %, and the other side and both oscillators need some of it.
    #[must_use]
    pub const fn divider(&self, clock_hz: u32) -> Option<u32> {
        let Some(rounded) = clock_hz.checked_add(self.baud >> 1) else {
            return None;
        };
        let Some(divider) = rounded.checked_div(self.baud) else {
            return None;
        };
        let made_hz = divider.saturating_mul(self.baud);
        if divider == 0 || made_hz.abs_diff(clock_hz).saturating_mul(50) > made_hz {
            return None;
        }
        Some(divider)
    }
}

/// How a board's image carries its line: behind a mark by which it is found without a table of symbols.
///
/// The image configures its UART from [`LineRecord::line`], so that what a test finds is what the board does.
#[derive(Debug)]
#[repr(C)]
pub struct LineRecord {
    mark: [u8; 16],
    line: Line,
}

impl LineRecord {
    const MARK: [u8; 16] = *b"flankscope line:";

    /// The record of a line.
    #[must_use]
    pub const fn new(line: Line) -> Self {
        Self {
            mark: Self::MARK,
            line,
        }
    }

    /// The line, out of the record: the compiler is kept from knowing it, so that the record is in the image.
    #[must_use]
    pub fn line(&'static self) -> Line {
        core::hint::black_box(self).line
    }

    /// The bytes of a [`Line`] behind each mark in an image.
    pub fn find(image: &[u8]) -> impl Iterator<Item = [u8; 8]> {
        let marked = image.windows(Self::MARK.len().saturating_add(8));
        marked.filter_map(|bytes| {
            let (mark, line) = bytes.split_first_chunk()?;
            (*mark == Self::MARK).then_some(line.try_into().ok()?)
        })
    }
}

impl Line {
    /// As it lies in a little-endian board's image.
    #[must_use]
    pub const fn bytes(&self) -> [u8; 8] {
        let [a, b, c, d] = self.baud.to_le_bytes();
        [
            a,
            b,
            c,
            d,
            self.data_bits,
            self.parity as u8,
            self.stop_bits,
            self.flow as u8,
        ]
    }
}

impl fmt::Display for Line {
    /// As people write it: `921600 8N1, no flow control`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parity = match self.parity {
            Parity::None => 'N',
            Parity::Even => 'E',
            Parity::Odd => 'O',
        };
        let flow = match self.flow {
            FlowControl::None => "no flow control",
            FlowControl::RtsCts => "RTS/CTS",
        };
        write!(
            f,
            "{} {}{parity}{}, {flow}",
            self.baud, self.data_bits, self.stop_bits
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters_take_their_bits() {
        // Ten bits of 52.083 us.
        let slow = Line {
            baud: 19_200,
            ..Line::HOST
        };
        assert_eq!(slow.byte_ns(), 520_833);
        let parity = Line {
            parity: Parity::Even,
            stop_bits: 2,
            ..slow
        };
        assert_eq!(parity.byte_ns(), 625_000);
    }

    #[test]
    fn dividers_are_near_enough_or_there_is_none() {
        // 25 MHz / 27 = 925 926 (+0.47 %); 100 MHz / 109 = 917 431 (-0.45 %).
        assert_eq!(Line::HOST.divider(25_000_000), Some(27));
        assert_eq!(Line::HOST.divider(100_000_000), Some(109));
        // 1.4 MHz lies between 1 and 2 dividers, 52 % and 24 % away.
        assert_eq!(Line::HOST.divider(1_400_000), None);
        assert_eq!(Line::HOST.divider(0), None);
        let none = Line {
            baud: 0,
            ..Line::HOST
        };
        assert_eq!(none.divider(25_000_000), None);
    }
}
