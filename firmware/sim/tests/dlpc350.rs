//! The pattern engine's driver against a mock chip that knows the documented commands and their rules.
//!
//! The chip here is written from the command descriptions, not from the driver: it keeps registers and mailboxes,
//! decodes table entries by their documented bits, and refuses what the documents forbid.

use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, Operation};
use flankscope_controller::dlpc350::{ADDRESS, BitDepth, Dlpc350, Flaws, PatternError, Settings};
use flankscope_protocol::Microseconds;
use flankscope_sim::{Clock, Sim};
use std::cell::RefCell;
use std::rc::Rc;

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
struct Chip {
    log: Vec<Vec<u8>>,
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
    /// This many transactions are acknowledged, then none.
    dies_after: Option<usize>,
    never_ready: bool,
    /// The validation was asked about; its answer is still read too early this many times.
    asked: Option<u32>,
    /// So often each.
    early_reads: u32,
}

impl Chip {
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
            (0x7D, []) => self.asked = Some(self.early_reads),
            other => panic!("no such command: {other:02x?}"),
        }
    }

    fn read(&mut self, answer: &mut [u8]) {
        assert_eq!(answer.len(), 2);
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

#[derive(Clone, Default)]
struct Bus(Rc<RefCell<Chip>>);

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl I2c for Bus {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        assert_eq!(address, ADDRESS);
        let mut chip = self.0.borrow_mut();
        let done = chip.log.len();
        if chip.dies_after.is_some_and(|limit| done >= limit) {
            return Err(ErrorKind::Bus);
        }
        match operations {
            [Operation::Write(bytes)] => {
                chip.log.push(bytes.to_vec());
                chip.write(bytes);
            }
            [Operation::Read(answer)] => {
                chip.log.push(Vec::new());
                chip.read(answer);
            }
            other => panic!("{other:?}"),
        }
        Ok(())
    }
}

const SETTINGS: Settings = Settings {
    depth: BitDepth::Eight,
    exposure: Microseconds(100_000),
    patterns: 12,
};

/// Arms one pattern after another on one chip.
fn arm(
    chip: Chip,
    settings: Settings,
    patterns: &[u16],
) -> (Rc<RefCell<Chip>>, Vec<Result<(), PatternError>>) {
    let bus = Bus(Rc::new(RefCell::new(chip)));
    let chip = Rc::clone(&bus.0);
    let results = Rc::new(RefCell::new(Vec::new()));
    let (sim, out, patterns) = (
        Sim::new(Clock::Stepped),
        Rc::clone(&results),
        patterns.to_vec(),
    );
    sim.spawn(async move {
        let mut driver = Dlpc350::new(bus, settings);
        for pattern in patterns {
            let armed = driver.arm(pattern).await;
            out.borrow_mut().push(armed);
        }
    });
    sim.run();
    let results = results.take();
    (chip, results)
}

#[test]
fn every_pattern_waits_for_its_trigger_in_its_place_in_flash() {
    for number in 0..=12u16 {
        let (chip, results) = arm(Chip::default(), SETTINGS, &[3, number]);
        assert_eq!(results, [Ok(()), Ok(())]);
        let chip = chip.borrow();
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
        let (chip, results) = arm(Chip::default(), settings, &[number]);
        assert_eq!(results, [Ok(())]);
        let shown = chip.borrow().shown();
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
    let (chip, results) = arm(Chip::default(), short, &[1]);
    assert_eq!(results, [Err(PatternError::Invalid(Flaws(Flaws::PERIOD)))]);
    assert!(!chip.borrow().running);

    let slow = Chip {
        never_ready: true,
        ..Chip::default()
    };
    let (chip, results) = arm(slow, SETTINGS, &[1]);
    assert_eq!(results, [Err(PatternError::Validating { limit_ms: 15 })]);
    assert!(!chip.borrow().running);

    let mute = Chip {
        early_reads: u32::MAX,
        ..Chip::default()
    };
    let (chip, results) = arm(mute, SETTINGS, &[1]);
    assert_eq!(results, [Err(PatternError::Validating { limit_ms: 15 })]);
    assert!(!chip.borrow().running);

    let (chip, results) = arm(Chip::default(), SETTINGS, &[13]);
    assert_eq!(
        results,
        [Err(PatternError::NoSuchPattern { got: 13, limit: 12 })]
    );
    assert!(chip.borrow().log.is_empty());
}

#[test]
fn an_answer_that_is_not_ready_is_waited_for() {
    let short = Settings {
        exposure: Microseconds(1_000),
        ..SETTINGS
    };
    for early_reads in 1..=2 {
        let chip = || Chip {
            early_reads,
            ..Chip::default()
        };
        let (_, results) = arm(chip(), SETTINGS, &[1]);
        assert_eq!(results, [Ok(())], "{early_reads} times");
        let (chip, results) = arm(chip(), short, &[1]);
        assert_eq!(results, [Err(PatternError::Invalid(Flaws(Flaws::PERIOD)))]);
        assert!(!chip.borrow().running);
    }
}

#[test]
fn a_bus_that_dies_at_any_transaction_is_noticed_and_all_is_set_up_anew() {
    let (whole, _) = arm(Chip::default(), SETTINGS, &[1]);
    let transactions = whole.borrow().log.len();
    for limit in 0..transactions {
        let dying = Chip {
            dies_after: Some(limit),
            ..Chip::default()
        };
        let bus = Bus(Rc::new(RefCell::new(dying)));
        let chip = Rc::clone(&bus.0);
        let sim = Sim::new(Clock::Stepped);
        let healed = Rc::clone(&chip);
        sim.spawn(async move {
            let mut driver = Dlpc350::new(bus, SETTINGS);
            assert_eq!(driver.arm(2).await, Err(PatternError::Bus));
            // The chip comes back as after power-up.
            *healed.borrow_mut() = Chip::default();
            assert_eq!(driver.arm(2).await, Ok(()));
        });
        sim.run();
        assert!(chip.borrow().running, "after {limit} of {transactions}");
        assert_eq!(chip.borrow().log.len(), transactions);
    }
}
