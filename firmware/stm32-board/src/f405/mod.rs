//! What an STM32F405 has of its own, and what QEMU's machine `netduinoplus2` (QEMU 7.2) lacks of it.
//!
//! | the model lacks | instead |
//! |---|---|
//! | RCC, PWR | `missing_registers`: what embassy-stm32's start waits for reads as ready |
//! | levels of the press's contacts (GPIOF) | `missing_registers`: the test sets them, and raises their EXTI lines |
//! | compare channels of its timers | `time`: TIM2 counts, SysTick is the alarm; embassy-stm32's time driver is not linked |
//! | the USARTs' interrupts of an empty transmitter | [`TransmitterEmpty`] |
//! | the USARTs' flag of an idle line | [`EAGER_READS`] |
//! | registers that outlive a reset (RTC) | [`Kept`]: RAM that no start clears |
//! | reset flags (RCC) | none is ever set |
//! | other GPIO, IWDG, DAC, I2C, DMA | nothing: outputs and feeding are seen in the emulator's log, inputs read low, buses time out |
//!
//! So this image is for the emulator: on a chip it would run with another clock and forget why it was reset.

mod missing_registers;
mod time;

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt::typelevel::{self, Handler};
use embassy_stm32::pac::usart::Usart;
use embassy_stm32::peripherals::{USART2, USART3};
use embassy_stm32::rcc::LsConfig;
use embassy_stm32::{Config, Peripherals, bind_interrupts, interrupt, pac, usart};

use crate::failsafe;

/// Of the processor, as embassy-stm32 is told: the internal oscillator, without the PLL.
pub const CLOCK_MHZ: u32 = 16;

/// A reader is woken by every byte: the model never says that a line is idle.
pub const EAGER_READS: Option<usize> = Some(1);

/// The independent watchdog. The model lacks it: nothing resets a program that hangs.
pub type WatchdogUnit = embassy_stm32::peripherals::IWDG;

/// The same, out of all peripherals.
macro_rules! watchdog_unit {
    ($peripherals:ident) => {
        $peripherals.IWDG
    };
}
pub(crate) use watchdog_unit;

bind_interrupts!(pub struct UartIrqs {
    USART2 => usart::BufferedInterruptHandler<USART2>, TransmitterEmpty;
    USART3 => usart::BufferedInterruptHandler<USART3>, TransmitterEmpty;
});

/// Comes again as long as the driver waits for the transmitter: the model sets TXE and TC, but they raise no interrupt.
pub struct TransmitterEmpty;

impl TransmitterEmpty {
    fn pend(unit: Usart, number: interrupt::Interrupt) {
        let (enabled, status) = (unit.cr1().read(), unit.sr().read());
        if enabled.txeie() && status.txe() || enabled.tcie() && status.tc() {
            NVIC::pend(number);
        }
    }
}

impl Handler<typelevel::USART2> for TransmitterEmpty {
    unsafe fn on_interrupt() {
        Self::pend(pac::USART2, interrupt::Interrupt::USART2);
    }
}

impl Handler<typelevel::USART3> for TransmitterEmpty {
    unsafe fn on_interrupt() {
        Self::pend(pac::USART3, interrupt::Interrupt::USART3);
    }
}

/// Starts embassy-stm32 with the clock that the chip has after a reset.
pub fn init() -> Peripherals {
    let mut config = Config::default();
    config.rcc.ls = LsConfig::off();
    let peripherals = missing_registers::answered(|| embassy_stm32::init(config));
    time::start();
    peripherals
}

/// What the chip says made the reset before this start. The model says nothing.
pub struct ResetFlags {
    pub watchdog: bool,
    /// Power came on, or fell below the brown-out level.
    pub power: bool,
}

impl ResetFlags {
    /// Reads and forgets them.
    pub fn take() -> Self {
        let causes = pac::RCC.csr();
        let read = causes.read();
        causes.modify(|bits| bits.set_rmvf(true));
        Self {
            watchdog: read.wdgrstf(),
            power: read.porrstf() || read.borrstf(),
        }
    }
}

/// The mark; any content is one.
#[unsafe(link_section = ".uninit.KEPT")]
static KEPT: MaybeUninit<AtomicU32> = MaybeUninit::uninit();

/// RAM that no start clears, for the model lacks the backup domain's registers.
pub struct Kept(&'static AtomicU32);

impl Kept {
    pub fn open() -> Self {
        // SAFETY: any bits are a valid word.
        Self(unsafe { KEPT.assume_init_ref() })
    }

    /// The mark, once.
    pub fn take_mark(&self) -> u32 {
        let mark = self.0.load(Ordering::Relaxed);
        self.0.store(0, Ordering::Relaxed);
        mark
    }

    /// Without the cause, which is for a board's debugger.
    pub fn put(&self, mark: u32, _cause: u32) {
        self.0.store(mark, Ordering::Release);
    }
}

/// Threshold of the supply's detector: 2.8 V falling (RM0090, PWR_CR.PLS). The model lacks it and never finds the supply low.
pub const SUPPLY_LEVEL: u8 = 0b110;

/// Of the supply's detector.
pub const SUPPLY_INTERRUPT: interrupt::Interrupt = interrupt::Interrupt::PVD;

#[interrupt]
unsafe fn PVD() {
    failsafe::supply_sinks()
}
