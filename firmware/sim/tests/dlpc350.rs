//! The pattern engine's driver against a mock chip that knows the documented commands and their rules.
//!
//! The chip here is written from the command descriptions, not from the driver: it keeps registers and mailboxes,
//! decodes table entries by their documented bits, and refuses what the documents forbid.

mod common;

use common::{Chip, PatternEngine, Wired};
use flankscope_controller::dlpc::BusFailed;
use flankscope_controller::dlpc350::{BitDepth, Dlpc350, Flaws, PatternError, Settings};
use flankscope_protocol::Microseconds;
use flankscope_sim::I2cBus;

/// What a trigger would show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shown {
    image: u8,
    pattern: u8,
    bits: u8,
    inverted: bool,
    trigger: u8,
    leds: u8,
}

#[derive(Debug, Default)]
struct Mock {
    pattern_mode: bool,
    source: u8,
    trigger_mode: u8,
    periods: (u32, u32),
    control: [u8; 4],
    mailbox: u8,
    offset: u8,
    image: Option<u8>,
    entry: Option<u32>,
    validated: bool,
    busy_polls: u32,
    running: bool,
    never_ready: bool,
    /// The validation was asked about; its answer is still read too early this many times.
    asked: Option<u32>,
    /// So often each.
    early_reads: u32,
    /// Questions about the main status during which a started pattern is still fetched from flash.
    fetching: u32,
    /// The main status was asked about.
    status_asked: bool,
}

impl Chip for Mock {
    fn write(&mut self, bytes: &[u8]) {
        let (&code, data) = bytes.split_first().expect("a sub-address");
        let setting = [0xE6, 0xEF, 0xF0, 0xF5, 0xF7, 0xF8];
        if setting.contains(&code) {
            assert!(!self.running, "{code:#x} while a sequence runs");
            self.validated = false;
        }
        match (code, data) {
            (0xE9, [mode]) => self.pattern_mode = *mode & 1 == 1,
            (0xE5, [0]) => self.running = false,
            (0xE5, [2]) => {
                assert!(self.validated, "started without a validation");
                self.running = true;
                self.fetching = FETCHING;
            }
            (0xEF, [source]) => self.source = *source,
            (0xF0, [mode]) => self.trigger_mode = *mode,
            (0xE6, [a, b, c, d, e, f, g, h]) => {
                self.periods = (
                    u32::from_le_bytes([*a, *b, *c, *d]),
                    u32::from_le_bytes([*e, *f, *g, *h]),
                );
            }
            (0xF5, [entries, repeat, per_trigger, images]) => {
                self.control = [*entries, *repeat, *per_trigger, *images];
            }
            (0xF7, [mailbox @ 0..=3]) => self.mailbox = *mailbox,
            (0xF6, [offset @ 0..=127]) => self.offset = *offset,
            (0xF8, [image]) if self.mailbox == 1 && self.offset == 0 => self.image = Some(*image),
            (0xF8, [a, b, c]) if self.mailbox == 2 && self.offset == 0 => {
                self.entry = Some(u32::from_le_bytes([*a, *b, *c, 0]));
            }
            (0xFD, []) => {
                assert_eq!(self.mailbox, 0, "validated with an open mailbox");
                (self.validated, self.busy_polls) = (true, 3);
            }
            // A question replaces the one before.
            (0x7D, []) => (self.asked, self.status_asked) = (Some(self.early_reads), false),
            (0x22, []) => (self.asked, self.status_asked) = (None, true),
            other => panic!("no such command: {other:02x?}"),
        }
    }

    fn read(&mut self, answer: &mut [u8]) {
        assert_eq!(answer.len(), 2);
        if std::mem::take(&mut self.status_asked) {
            // The mirrors are not parked; the sequence runs once its image is there.
            let runs = self.running && self.fetching == 0;
            self.fetching = self.fetching.saturating_sub(1);
            answer.copy_from_slice(&[1, u8::from(runs) << 1]);
            return;
        }
        match &mut self.asked {
            None => panic!("read without a question"),
            // Not ready: what follows the status byte is no answer, though it reads like a good one.
            Some(early @ 1..) => {
                *early -= 1;
                answer.fill(0);
                return;
            }
            Some(0) => self.asked = None,
        }
        answer[0] = 1;
        if self.busy_polls > 0 || self.never_ready {
            self.busy_polls = self.busy_polls.saturating_sub(1);
            answer[1] = 0x80;
            return;
        }
        let mut flaws = 0;
        let (exposure, period) = self.periods;
        // An 8 bit pattern needs 8333 us, a binary one 235 us (their fastest documented rates, 120 Hz and 4225 Hz).
        let shortest = if self.shown().bits == 8 { 8_333 } else { 235 };
        if exposure < shortest || period < exposure {
            flaws |= 1;
        }
        if period != exposure && period - exposure < 230 {
            flaws |= 16;
        }
        if self.shown().bits == 8 && self.shown().pattern > 2 {
            flaws |= 2;
        }
        answer[1] = flaws;
        self.validated = flaws == 0;
    }
}

impl Mock {
    fn shown(&self) -> Shown {
        let entry = self.entry.expect("a table entry");
        let field = |from: u32, bits: u32| (entry >> from & ((1 << bits) - 1)) as u8;
        Shown {
            image: self.image.expect("an image index"),
            trigger: field(0, 2),
            pattern: field(2, 6),
            bits: field(8, 4),
            leds: field(12, 3),
            inverted: field(16, 1) == 1,
        }
    }
}

/// Questions that an image takes.
const FETCHING: u32 = 2;

const SETTINGS: Settings = Settings {
    depth: BitDepth::Eight,
    exposure: Microseconds(100_000),
    patterns: 12,
};

impl PatternEngine for Dlpc350<I2cBus> {
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
    common::arm(chip, |bus| Dlpc350::new(bus, settings), patterns)
}

#[test]
fn every_pattern_waits_for_its_trigger_in_its_place_in_flash() {
    for number in 0..=12u16 {
        let (wired, results) = arm(Mock::default(), SETTINGS, &[3, number]);
        assert_eq!(results, [Ok(()), Ok(())]);
        let chip = wired.chip;
        assert!(chip.running && chip.pattern_mode && chip.mailbox == 0);
        // Flash, external trigger, one entry shown once.
        assert_eq!(
            (chip.source, chip.trigger_mode, chip.control),
            (3, 1, [0; 4])
        );
        assert_eq!(chip.periods, (100_000, 100_000));
        let expected = match number {
            0 => Shown {
                image: 0,
                pattern: 24,
                bits: 1,
                inverted: true,
                trigger: 1,
                leds: 0,
            },
            n => Shown {
                image: ((n - 1) / 3) as u8,
                pattern: ((n - 1) % 3) as u8,
                bits: 8,
                inverted: false,
                trigger: 1,
                leds: 0,
            },
        };
        assert_eq!(chip.shown(), expected);
    }
}

#[test]
fn binary_patterns_are_24_to_an_image() {
    let settings = Settings {
        depth: BitDepth::One,
        patterns: 60,
        ..SETTINGS
    };
    for (number, image, pattern) in [(1, 0, 0), (24, 0, 23), (25, 1, 0), (60, 2, 11)] {
        let (wired, results) = arm(Mock::default(), settings, &[number]);
        assert_eq!(results, [Ok(())]);
        let shown = wired.chip.shown();
        assert_eq!(
            (shown.image, shown.pattern, shown.bits),
            (image, pattern, 1)
        );
    }
}

#[test]
fn what_the_chip_refuses_is_not_started() {
    let short = Settings {
        exposure: Microseconds(1_000),
        ..SETTINGS
    };
    let (wired, results) = arm(Mock::default(), short, &[1]);
    assert_eq!(results, [Err(PatternError::Invalid(Flaws(Flaws::PERIOD)))]);
    assert!(!wired.chip.running);

    let slow = Mock {
        never_ready: true,
        ..Mock::default()
    };
    let (wired, results) = arm(slow, SETTINGS, &[1]);
    assert_eq!(results, [Err(PatternError::Validating { limit_ms: 15 })]);
    assert!(!wired.chip.running);

    let mute = Mock {
        early_reads: u32::MAX,
        ..Mock::default()
    };
    let (wired, results) = arm(mute, SETTINGS, &[1]);
    assert_eq!(results, [Err(PatternError::Validating { limit_ms: 15 })]);
    assert!(!wired.chip.running);

    let (wired, results) = arm(Mock::default(), SETTINGS, &[13]);
    assert_eq!(
        results,
        [Err(PatternError::NoSuchPattern { got: 13, limit: 12 })]
    );
    assert!(wired.log.is_empty());
}

#[test]
fn an_answer_that_is_not_ready_is_waited_for() {
    let short = Settings {
        exposure: Microseconds(1_000),
        ..SETTINGS
    };
    for early_reads in 1..=2 {
        let chip = || Mock {
            early_reads,
            ..Mock::default()
        };
        let (_, results) = arm(chip(), SETTINGS, &[1]);
        assert_eq!(results, [Ok(())], "{early_reads} times");
        let (wired, results) = arm(chip(), short, &[1]);
        assert_eq!(results, [Err(PatternError::Invalid(Flaws(Flaws::PERIOD)))]);
        assert!(!wired.chip.running);
    }
}

#[test]
fn a_bus_that_dies_at_any_transaction_is_noticed_and_all_is_set_up_anew() {
    let driver = |bus| Dlpc350::new(bus, SETTINGS);
    common::dies_at_any_transaction::<Mock, _>(driver, PatternError::Bus(BusFailed), |chip| {
        chip.running
    });
}
