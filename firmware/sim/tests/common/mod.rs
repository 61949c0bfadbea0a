//! A mock chip on a virtual I2C bus, and a pattern engine's driver run against it.

use flankscope_sim::i2c::I2cDevice;
use flankscope_sim::{Clock, I2cBus, Sim};
use std::cell::RefCell;
use std::fmt::Debug;
use std::rc::Rc;

/// Slave address of either pattern controller, as their guides have it: `0x34` and `0x35` on the wire.
const ADDRESS: u8 = 0x34 >> 1;

/// What answers behind the bus, after power-up by default.
pub trait Chip: Default + 'static {
    fn write(&mut self, bytes: &[u8]);

    fn read(&mut self, answer: &mut [u8]);
}

/// The driver under test.
pub trait PatternEngine: 'static {
    type Error: Debug + PartialEq + 'static;

    async fn arm(&mut self, pattern: u16) -> Result<(), Self::Error>;
}

/// A chip, and what came over its wire: a read as no bytes.
#[derive(Default)]
pub struct Wired<C> {
    pub chip: C,
    pub log: Vec<Vec<u8>>,
    /// This many transactions are acknowledged, then none.
    dies_after: Option<usize>,
}

impl<C> Wired<C> {
    fn alive(&self) -> bool {
        self.dies_after.is_none_or(|limit| self.log.len() < limit)
    }
}

struct Device<C>(Rc<RefCell<Wired<C>>>);

impl<C: Chip> I2cDevice for Device<C> {
    fn write(&mut self, bytes: &[u8]) -> bool {
        let mut wired = self.0.borrow_mut();
        let alive = wired.alive();
        if alive {
            wired.log.push(bytes.to_vec());
            wired.chip.write(bytes);
        }
        alive
    }

    fn read(&mut self, answer: &mut [u8]) -> bool {
        let mut wired = self.0.borrow_mut();
        let alive = wired.alive();
        if alive {
            wired.log.push(Vec::new());
            wired.chip.read(answer);
        }
        alive
    }
}

fn wire<C: Chip>(chip: C, dies_after: Option<usize>) -> (I2cBus, Rc<RefCell<Wired<C>>>) {
    let wired = Rc::new(RefCell::new(Wired {
        chip,
        log: Vec::new(),
        dies_after,
    }));
    let bus = I2cBus::default();
    bus.attach(ADDRESS, Device(Rc::clone(&wired)));
    (bus, wired)
}

/// Arms one pattern after another on one chip.
pub fn arm<C: Chip, D: PatternEngine>(
    chip: C,
    driver: impl FnOnce(I2cBus) -> D,
    patterns: &[u16],
) -> (Wired<C>, Vec<Result<(), D::Error>>) {
    let (bus, wired) = wire(chip, None);
    let results = Rc::new(RefCell::new(Vec::new()));
    let (sim, out) = (Sim::new(Clock::Stepped), Rc::clone(&results));
    let (mut driver, patterns) = (driver(bus), patterns.to_vec());
    sim.spawn(async move {
        for pattern in patterns {
            let armed = driver.arm(pattern).await;
            out.borrow_mut().push(armed);
        }
    });
    sim.run();
    (wired.take(), results.take())
}

/// The bus dies before each transaction in turn of arming a pattern, and the chip comes back as after power-up: the driver says
/// `dead`, then sets up everything anew, and the chip is `running`.
pub fn dies_at_any_transaction<C: Chip, D: PatternEngine>(
    driver: fn(I2cBus) -> D,
    dead: D::Error,
    running: fn(&C) -> bool,
) {
    const PATTERN: u16 = 2;
    let (whole, results) = arm(C::default(), driver, &[PATTERN]);
    assert_eq!(results, [Ok(())]);
    let transactions = whole.log.len();
    for limit in 0..transactions {
        let (bus, wired) = wire(C::default(), Some(limit));
        let results = Rc::new(RefCell::new(Vec::new()));
        let (sim, out) = (Sim::new(Clock::Stepped), Rc::clone(&results));
        let (mut driver, healed) = (driver(bus), Rc::clone(&wired));
        sim.spawn(async move {
            let first = driver.arm(PATTERN).await;
            healed.take();
            let second = driver.arm(PATTERN).await;
            out.borrow_mut().extend([first, second]);
        });
        sim.run();
        let results = results.take();
        assert!(
            matches!(results.as_slice(), [Err(error), Ok(())] if *error == dead),
            "after {limit} of {transactions}: {results:?}"
        );
        assert!(
            running(&wired.borrow().chip),
            "after {limit} of {transactions}"
        );
        assert_eq!(wired.borrow().log.len(), transactions);
    }
}
