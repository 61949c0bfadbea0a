//! CMSDK UARTs: interrupt-driven receive into a ring, transmit from the task.
//!
//! A byte is taken from the receiver in its interrupt. When the ring is full the interrupt is masked instead, and the
//! reader unmasks it once it has made room: nothing is lost as long as the sender minds the receiver's flow control,
//! and the ring holds the longest message of the link, so even one that does not has time.

use core::convert::Infallible;
use core::future::poll_fn;
use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering};
use core::task::Poll;

use cortex_m::peripheral::NVIC;
use embassy_sync::waitqueue::AtomicWaker;
use embedded_io_async::{ErrorType, Read, Write};
use flankscope_controller::stage::StagePort;
use flankscope_protocol::{Line, MAX_FRAME_BYTES};

use crate::registers::{Block, Irq};

const DATA: usize = 0x00;
const STATE: usize = 0x04;
const CONTROL: usize = 0x08;
const INTERRUPT: usize = 0x0C;
const BAUD_DIVIDER: usize = 0x10;
const STATE_TX_FULL: u32 = 1 << 0;
const STATE_RX_FULL: u32 = 1 << 1;
const CONTROL_TX: u32 = 1 << 0;
const CONTROL_RX: u32 = 1 << 1;
const CONTROL_RX_INTERRUPT: u32 = 1 << 3;
const INTERRUPT_RX: u32 = 1 << 1;

/// What the dividers divide.
pub const CLOCK_HZ: u32 = 25_000_000;

/// Bytes of the ring; a power of two, more than the longest frame.
const RING: usize = 512;
const _: () = assert!(RING.is_power_of_two() && RING > MAX_FRAME_BYTES);

/// A UART whose interrupt is `irq`.
pub struct Uart {
    block: Block,
    irq: Irq,
    ring: [AtomicU8; RING],
    /// Bytes ever put in and taken out; the interrupt moves the first, the reader the second.
    put: AtomicUsize,
    taken: AtomicUsize,
    reader: AtomicWaker,
}

impl Uart {
    /// Not started.
    pub const fn new(block: Block, irq: Irq) -> Self {
        Self {
            block,
            irq,
            ring: [const { AtomicU8::new(0) }; RING],
            put: AtomicUsize::new(0),
            taken: AtomicUsize::new(0),
            reader: AtomicWaker::new(),
        }
    }

    /// Starts transmitter, receiver and interrupt.
    pub fn start(&self, divider: u32) {
        self.block.write(BAUD_DIVIDER, divider);
        self.block
            .write(CONTROL, CONTROL_TX | CONTROL_RX | CONTROL_RX_INTERRUPT);
        // SAFETY: the interrupt's handler is in place and works from the first byte on.
        unsafe { NVIC::unmask(self.irq) };
    }

    /// The receive interrupt.
    pub fn on_receive(&self) {
        while let Some(byte) = self.receive() {
            let put = self.put.load(Ordering::Relaxed);
            if let Some(slot) = self.ring.get(put % RING) {
                slot.store(byte, Ordering::Relaxed);
            }
            self.put.store(put.wrapping_add(1), Ordering::Release);
        }
        self.reader.wake();
    }

    /// The next byte from the receiver, unless the ring is full: then its interrupt is masked.
    fn receive(&self) -> Option<u8> {
        let held = self
            .put
            .load(Ordering::Relaxed)
            .wrapping_sub(self.taken.load(Ordering::Acquire));
        if held >= RING {
            NVIC::mask(self.irq);
            return None;
        }
        self.receive_now()
    }

    /// The next byte, past the ring: for an interrupt handler that consumes bytes itself.
    pub fn receive_now(&self) -> Option<u8> {
        self.block.write(INTERRUPT, INTERRUPT_RX);
        (self.block.read(STATE) & STATE_RX_FULL != 0).then(|| self.block.read(DATA) as u8)
    }

    fn take(&self, buffer: &mut [u8]) -> usize {
        let mut count = 0;
        let put = self.put.load(Ordering::Acquire);
        let mut taken = self.taken.load(Ordering::Relaxed);
        for slot in buffer {
            if taken == put {
                break;
            }
            *slot = self
                .ring
                .get(taken % RING)
                .map_or(0, |byte| byte.load(Ordering::Relaxed));
            taken = taken.wrapping_add(1);
            count += 1;
        }
        self.taken.store(taken, Ordering::Release);
        // SAFETY: unmasking an interrupt whose handler is in place; nothing depends on its being masked.
        unsafe { NVIC::unmask(self.irq) };
        count
    }

    /// Sends bytes, waiting for the transmitter. Callable from anywhere; whole messages need a critical section.
    pub fn send_now(&self, bytes: &[u8]) {
        for &byte in bytes {
            while self.block.read(STATE) & STATE_TX_FULL != 0 {}
            self.block.write(DATA, u32::from(byte));
        }
    }
}

/// A task's end of a UART.
#[derive(Clone, Copy)]
pub struct Port(pub &'static Uart);

impl ErrorType for Port {
    type Error = Infallible;
}

impl StagePort for Port {
    /// The UART sends and receives from here on; it has 8N1 and nothing else, which the controller's limits know.
    fn set_line(&mut self, line: &Line) -> bool {
        let divider = line.divider(CLOCK_HZ);
        divider.inspect(|&divider| self.0.start(divider)).is_some()
    }
}

impl Read for Port {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            // First the waker, then the look: a byte between the two wakes.
            self.0.reader.register(context.waker());
            match self.0.take(buffer) {
                0 if !buffer.is_empty() => Poll::Pending,
                count => Poll::Ready(Ok(count)),
            }
        })
        .await
    }
}

impl Write for Port {
    /// QEMU's transmitter is never busy for long, so this waits without yielding.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.send_now(bytes);
        Ok(bytes.len())
    }

    async fn write_all(&mut self, bytes: &[u8]) -> Result<(), Infallible> {
        self.0.send_now(bytes);
        Ok(())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
