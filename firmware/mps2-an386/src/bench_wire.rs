//! The wire to the bench: UART1, which carries pin messages both ways.

use flankscope_pin_wire::{PinMessage, Subject};

use crate::registers::{Block, Irq};
use crate::uart::Uart;

pub static BENCH: Uart = Uart::new(Block::UART1, Irq::Uart1Rx);

/// Sends one message. No interrupt may come between two messages' bytes: call it in a critical section.
pub fn send(subject: Subject, value: u16, at_us: u64) {
    BENCH.send_now(
        &PinMessage {
            subject,
            value,
            at_us,
        }
        .to_bytes(),
    );
}
