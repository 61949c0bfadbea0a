//! The pattern engine's driver against a mock chip that knows the documented commands and their rules.
//!
//! The chip here is written from the command descriptions, not from the driver: it keeps its table, decodes entries by their documented
//! bits, and answers with the documented error numbers.

mod common;

use common::{Chip, PatternEngine, Wired};
use flankscope_controller::dlpc::BusFailed;
use flankscope_controller::dlpc900::{Dlpc900, Mirrors, PatternError, Settings};
use flankscope_protocol::Microseconds;
use flankscope_sim::I2cBus;

/// What a trigger would show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shown {
    image: u16,
    first_bit: u8,
    bits: u8,
    exposure_us: u32,
    dark_us: u32,
    leds: u8,
    waits: bool,
}

#[derive(Debug, Clone)]
struct Mock {
    /// Byte 0 of the firmware's kind.
    kind: u8,
    /// Images in flash.
    images: u16,
    mode: u8,
    trigger_in: Option<(u16, u8)>,
    entry: Option<Shown>,
    /// Taken over by the execution command.
    shown: Option<Shown>,
    running: bool,
    /// Questions about the main status during which a started pattern is still fetched from flash.
    fetching: u32,
    error: u8,
    /// Sub-address whose answer comes with the next read.
    asked: Option<u8>,
}

impl Default for Mock {
    fn default() -> Self {
        Self {
            kind: 5,
            images: 13,
            mode: 0,
            trigger_in: None,
            entry: None,
            shown: None,
            running: false,
            fetching: 0,
            error: 0,
            asked: None,
        }
    }
}

const NO_SUCH_COMMAND: u8 = 3;
const NOT_IN_THIS_MODE: u8 = 5;
const BAD_PARAMETER: u8 = 6;
const NO_SUCH_IMAGE: u8 = 11;
const DELAY_RANGE: u8 = 13;
const EXPOSURE_RANGE: u8 = 14;

/// Shortest exposure of 8 bits that a DLP5500 is named for: 1 s / 247 patterns, to whole us.
const SHORTEST_8_BIT_US: u32 = 4_046;

impl Chip for Mock {
    fn write(&mut self, bytes: &[u8]) {
        let (&code, data) = bytes.split_first().expect("a sub-address");
        if code < 0x80 {
            assert!(data.is_empty(), "a question has no data here");
            // "The internal buffer is shared": an answer not fetched is lost.
            self.asked = Some(code);
            return;
        }
        self.asked = None;
        self.error = match (code, data) {
            (0xE9, [mode @ 0..=3]) if !self.running => {
                self.mode = *mode;
                0
            }
            (0xE5, [0]) => {
                self.running = false;
                0
            }
            (0xE5, [2]) if self.mode == 1 && self.shown.is_some() => {
                (self.running, self.fetching) = (true, 2);
                0
            }
            (0xF9, [low, high, edge]) => {
                let delay_us = u16::from_le_bytes([*low, *high]);
                self.trigger_in = Some((delay_us, *edge));
                if delay_us < 105 { DELAY_RANGE } else { 0 }
            }
            (0xF8 | 0xF5, _) if self.running || self.mode != 1 => NOT_IN_THIS_MODE,
            (0xF8, data) => match <[u8; 12]>::try_from(data) {
                Ok(entry) => self.define(entry),
                Err(_) => BAD_PARAMETER,
            },
            (0xF5, [1, 0, 1, 0, 0, 0]) => {
                self.shown = self.entry;
                0
            }
            (0xF5 | 0xE5 | 0xE9, _) => BAD_PARAMETER,
            _ => NO_SUCH_COMMAND,
        };
    }

    fn read(&mut self, answer: &mut [u8]) {
        let value = match self.asked.take() {
            Some(0x32) => self.error,
            Some(0x12) => self.kind,
            Some(0x22) => {
                let runs = self.running && self.fetching == 0;
                self.fetching = self.fetching.saturating_sub(1);
                u8::from(runs) << 1
            }
            other => panic!("read without a question: {other:?}"),
        };
        answer.fill(0);
        answer[0] = value;
    }
}

impl Mock {
    fn define(&mut self, entry: [u8; 12]) -> u8 {
        let number = u16::from_le_bytes([entry[0], entry[1]]);
        let u24 = |at: usize| u32::from_le_bytes([entry[at], entry[at + 1], entry[at + 2], 0]);
        let place = u16::from_le_bytes([entry[10], entry[11]]);
        let shown = Shown {
            image: place & 0x07FF,
            first_bit: (place >> 11) as u8,
            bits: (entry[5] >> 1 & 7) + 1,
            exposure_us: u24(2),
            dark_us: u24(6),
            leds: entry[5] >> 4 & 7,
            waits: entry[5] >> 7 == 1,
        };
        assert_eq!(entry[9], 1, "no pulse on TRIG_OUT_2, 8 bits and no more");
        assert_eq!(entry[5] & 1, 0, "only 1 bit patterns are cleared by it");
        if number != 0 {
            return BAD_PARAMETER;
        }
        if shown.image >= self.images {
            return NO_SUCH_IMAGE;
        }
        if shown.exposure_us < SHORTEST_8_BIT_US {
            return EXPOSURE_RANGE;
        }
        self.entry = Some(shown);
        0
    }
}

const SETTINGS: Settings = Settings {
    mirrors: Mirrors::Dlp5500,
    exposure: Microseconds(100_000),
    patterns: 12,
};

impl PatternEngine for Dlpc900<I2cBus> {
    type Error = PatternError;

    async fn arm(&mut self, pattern: u16) -> Result<(), PatternError> {
        Self::arm(self, pattern).await?;
        while !self.is_waiting().await? {}
        Ok(())
    }
}

/// Arms one pattern after another on one chip; also what came over its wire.
fn arm(
    chip: Mock,
    settings: Settings,
    patterns: &[u16],
) -> (Wired<Mock>, Vec<Result<(), PatternError>>) {
    common::arm(chip, |bus| Dlpc900::new(bus, settings), patterns)
}

#[test]
fn every_pattern_waits_for_its_trigger_in_its_image_and_black_in_the_first() {
    for number in 0..=12u16 {
        let (wired, results) = arm(Mock::default(), SETTINGS, &[3, number]);
        assert_eq!(results, [Ok(()), Ok(())]);
        let chip = wired.chip;
        assert!(chip.running);
        let (delay_us, edge) = chip.trigger_in.expect("a trigger");
        assert!(delay_us >= 105 && edge & 1 == 0, "rising edge");
        let expected = Shown {
            image: number,
            first_bit: 0,
            bits: 8,
            exposure_us: 100_000,
            dark_us: 0,
            leds: 0,
            waits: true,
        };
        assert_eq!(chip.shown, Some(expected));
    }
}

/// The bytes of one selection, as the programmer's guide has them.
#[test]
fn a_selection_is_these_bytes() {
    let (wired, results) = arm(Mock::default(), SETTINGS, &[1, 7]);
    assert_eq!(results, [Ok(()), Ok(())]);
    let log = wired.log;
    // Each order is followed by the question whether it was taken.
    let question: &[&[u8]] = &[&[0x32], &[]];
    let orders: [&[u8]; 4] = [
        &[0xE5, 0],
        &[0xF8, 0, 0, 0xA0, 0x86, 0x01, 0x8E, 0, 0, 0, 1, 7, 0],
        &[0xF5, 1, 0, 1, 0, 0, 0],
        &[0xE5, 2],
    ];
    // Then, until it runs, the question about the main status: no twice, while the image is fetched, then yes.
    let status: [&[u8]; 2] = [&[0x22], &[]];
    let expected: Vec<&[u8]> = orders
        .into_iter()
        .flat_map(|order| std::iter::once(order).chain(question.iter().copied()))
        .chain([status; 3].into_iter().flatten())
        .collect();
    assert_eq!(log[log.len() - expected.len()..], expected);
}

#[test]
fn what_the_chip_refuses_is_not_started() {
    let short = Settings {
        exposure: Microseconds(4_045),
        ..SETTINGS
    };
    let (wired, results) = arm(Mock::default(), short, &[1]);
    assert_eq!(results, [Err(PatternError::Refused(EXPOSURE_RANGE))]);
    assert!(!wired.chip.running);

    let few = Mock {
        images: 7,
        ..Mock::default()
    };
    let (wired, results) = arm(few, SETTINGS, &[6, 7]);
    let refused = Err(PatternError::Refused(NO_SUCH_IMAGE));
    assert_eq!(results, [Ok(()), refused]);
    assert!(!wired.chip.running);

    let (wired, results) = arm(Mock::default(), SETTINGS, &[13]);
    assert_eq!(
        results,
        [Err(PatternError::NoSuchPattern { got: 13, limit: 12 })]
    );
    assert!(wired.log.is_empty());

    let long = Settings {
        exposure: Microseconds(1 << 24),
        ..SETTINGS
    };
    let (wired, results) = arm(Mock::default(), long, &[1]);
    let limit = Microseconds((1 << 24) - 1);
    let got = long.exposure;
    assert_eq!(results, [Err(PatternError::TooLong { got, limit })]);
    assert!(wired.log.is_empty());
}

#[test]
fn patterns_for_other_mirrors_are_not_shown() {
    for kind in [0, 1, 2, 3, 4, 6, 255] {
        let other = Mock {
            kind,
            ..Mock::default()
        };
        let (wired, results) = arm(other, SETTINGS, &[1]);
        let other = PatternError::OtherMirrors { got: kind, want: 5 };
        assert_eq!(results, [Err(other)]);
        assert_eq!(wired.log.len(), 2, "asked, and nothing else");
    }
}

#[test]
fn a_bus_that_dies_at_any_transaction_is_noticed_and_all_is_set_up_anew() {
    let driver = |bus| Dlpc900::new(bus, SETTINGS);
    common::dies_at_any_transaction::<Mock, _>(driver, PatternError::Bus(BusFailed), |chip| {
        chip.running
    });
}
