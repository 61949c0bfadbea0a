//! A virtual I2C bus: devices answer at once, the bytes take their time on the wire.

use embassy_time::{Duration, Timer};
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use std::cell::RefCell;
use std::rc::Rc;

/// Nine bits at 400 kHz, rounded up.
const BYTE_US: u64 = 23;

/// What hangs on a bus.
pub trait I2cDevice {
    /// Takes a transaction's bytes; false: it does not acknowledge them.
    fn write(&mut self, bytes: &[u8]) -> bool;
    /// Gives bytes; false: it does not acknowledge its address.
    fn read(&mut self, answer: &mut [u8]) -> bool;
}

type Devices = Vec<(u8, Box<dyn I2cDevice>)>;

/// A bus. Clones are the same bus.
#[derive(Clone, Default)]
pub struct I2cBus(Rc<RefCell<Devices>>);

impl I2cBus {
    /// Hangs a device on it, under a 7 bit address.
    pub fn attach(&self, address: u8, device: impl I2cDevice + 'static) {
        self.0.borrow_mut().push((address, Box::new(device)));
    }

    fn exchange(&self, address: u8, operation: &mut Operation<'_>) -> Result<usize, ErrorKind> {
        let mut devices = self.0.borrow_mut();
        let device = devices.iter_mut().find(|(own, _)| *own == address);
        let (_, device) = device.ok_or(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address))?;
        let (done, length) = match operation {
            Operation::Write(bytes) => (device.write(bytes), bytes.len()),
            Operation::Read(answer) => (device.read(answer), answer.len()),
        };
        done.then_some(length)
            .ok_or(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown))
    }
}

impl ErrorType for I2cBus {
    type Error = ErrorKind;
}

impl I2c for I2cBus {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        for operation in operations {
            let bytes = 1 + self.exchange(address, operation)? as u64;
            Timer::after(Duration::from_micros(BYTE_US * bytes)).await;
        }
        Ok(())
    }
}
