//! The few registers of the Cortex-M System Design Kit's peripherals that this image uses, and their interrupts.
//!
//! Source: Arm DDI 0479 (Cortex-M System Design Kit) and Arm DAI 0386 (application note AN386, memory and interrupt map).

use cortex_m::interrupt::InterruptNumber;

/// Clock of timers and UARTs, in Hz.
pub const CLOCK_HZ: u32 = 25_000_000;

/// Interrupt numbers.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Irq {
    Uart0Rx = 0,
    Uart1Rx = 2,
    Uart2Rx = 4,
    Timer0 = 8,
    Timer1 = 9,
    /// Not wired to anything on this machine, pended by software: link and stage tasks.
    Background = 30,
    /// Likewise: the sequencer.
    Sequencer = 31,
}

// SAFETY: the numbers are distinct and within the 32 interrupts of the AN386 image.
unsafe impl InterruptNumber for Irq {
    fn number(self) -> u16 {
        self as u16
    }
}

/// A block of 32-bit registers at a fixed address.
#[derive(Clone, Copy)]
pub struct Block(usize);

impl Block {
    /// CMSDK APB timers.
    pub const TIMER0: Self = Self(0x4000_0000);
    pub const TIMER1: Self = Self(0x4000_1000);
    /// CMSDK APB UARTs.
    pub const UART0: Self = Self(0x4000_4000);
    pub const UART1: Self = Self(0x4000_5000);
    pub const UART2: Self = Self(0x4000_6000);
    /// CMSDK APB watchdog.
    pub const WATCHDOG: Self = Self(0x4000_8000);

    pub fn read(self, offset: usize) -> u32 {
        // SAFETY: blocks exist only for the peripherals above, and every offset used lies within them.
        unsafe { ((self.0 + offset) as *const u32).read_volatile() }
    }

    pub fn write(self, offset: usize, value: u32) {
        // SAFETY: as for reading; no write has an effect on memory.
        unsafe { ((self.0 + offset) as *mut u32).write_volatile(value) }
    }
}

/// Unmasks the timers' interrupts and orders all interrupts: clock and UARTs first, then the sequencer, then the rest.
pub fn prioritise() {
    // The alarm first of all: after a sleep it puts the clock right, by which everything else is stamped.
    const ALARM: u8 = 0x00;
    const URGENT: u8 = 0x40;
    const SEQUENCER: u8 = 0x80;
    const BACKGROUND: u8 = 0xC0;
    // SAFETY: called once at start; the registers are the core's own, and the handlers are in place.
    unsafe {
        let mut nvic = cortex_m::Peripherals::steal().NVIC;
        for irq in [Irq::Uart0Rx, Irq::Uart1Rx, Irq::Uart2Rx, Irq::Timer0] {
            nvic.set_priority(irq, URGENT);
        }
        nvic.set_priority(Irq::Timer1, ALARM);
        nvic.set_priority(Irq::Sequencer, SEQUENCER);
        nvic.set_priority(Irq::Background, BACKGROUND);
        cortex_m::peripheral::NVIC::unmask(Irq::Timer0);
        cortex_m::peripheral::NVIC::unmask(Irq::Timer1);
    }
}
