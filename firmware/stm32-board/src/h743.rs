//! What the STM32H743 has of its own: clocks, reset flags, registers that outlive a reset, names of interrupts and units.

use cortex_m_rt::{ExceptionFrame, exception};
use embassy_stm32::peripherals::{USART2, USART3};
use embassy_stm32::{Config, Peripherals, bind_interrupts, interrupt, pac, rcc, usart};

use crate::failsafe;

/// Of the processor.
pub const CLOCK_MHZ: u32 = 400;

/// A reader is woken when its line falls silent, or its buffer is half full.
pub const EAGER_READS: Option<usize> = None;

/// The independent watchdog.
pub type WatchdogUnit = embassy_stm32::peripherals::IWDG1;

/// The same, out of all peripherals.
macro_rules! watchdog_unit {
    ($peripherals:ident) => {
        $peripherals.IWDG1
    };
}
pub(crate) use watchdog_unit;

bind_interrupts!(pub struct UartIrqs {
    USART2 => usart::BufferedInterruptHandler<USART2>;
    USART3 => usart::BufferedInterruptHandler<USART3>;
});

/// Sets the clocks.
pub fn init() -> Peripherals {
    embassy_stm32::init(clocks())
}

/// 400 MHz from the internal oscillator (64 MHz / 4 * 50 / 2), buses at 200 and 100 MHz.
fn clocks() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = Some(rcc::HSIPrescaler::DIV1);
    config.rcc.pll1 = Some(rcc::Pll {
        source: rcc::PllSource::HSI,
        prediv: rcc::PllPreDiv::DIV4,
        mul: rcc::PllMul::MUL50,
        fracn: None,
        divp: Some(rcc::PllDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = rcc::Sysclk::PLL1_P;
    config.rcc.ahb_pre = rcc::AHBPrescaler::DIV2;
    config.rcc.apb1_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb2_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb3_pre = rcc::APBPrescaler::DIV2;
    config.rcc.apb4_pre = rcc::APBPrescaler::DIV2;
    config.rcc.voltage_scale = rcc::VoltageScale::Scale1;
    config
}

/// What the chip says made the reset before this start.
pub struct ResetFlags {
    pub watchdog: bool,
    /// Power came on, or fell below the brown-out level.
    pub power: bool,
}

impl ResetFlags {
    /// Reads and forgets them.
    pub fn take() -> Self {
        let causes = pac::RCC.rsr();
        let read = causes.read();
        causes.modify(|bits| bits.set_rmvf(true));
        Self {
            watchdog: read.iwdg1rstf(),
            power: read.porrstf() || read.borrstf(),
        }
    }
}

/// Two of the backup domain's registers: they keep their content over every reset but the loss of power. The RAM does not: it is
/// written in words of 64 bits with their ECC, and a reset may take the one that still waits to be completed.
pub struct Kept(());

impl Kept {
    const MARK: usize = 0;
    const CAUSE: usize = 1;

    /// Clock on, write protection off. For use before interrupts are on, or after they are off.
    pub fn open() -> Self {
        pac::RCC.apb4enr().modify(|bits| bits.set_rtcapben(true));
        // The clock arrives before the access behind this read.
        let _clocked = pac::RCC.apb4enr().read();
        pac::PWR.cr1().modify(|bits| bits.set_dbp(true));
        while !pac::PWR.cr1().read().dbp() {}
        Self(())
    }

    /// The mark, once; the cause stays for a debugger.
    pub fn take_mark(&self) -> u32 {
        let mark = pac::RTC.bkpr(Self::MARK).read().bkp();
        Self::write(Self::MARK, 0);
        mark
    }

    /// Cause first, so that a mark has one.
    pub fn put(&self, mark: u32, cause: u32) {
        Self::write(Self::CAUSE, cause);
        Self::write(Self::MARK, mark);
    }

    /// Until it reads back, a few times at most: a reset is due, with or without it.
    fn write(at: usize, value: u32) {
        for _ in 0..4 {
            pac::RTC.bkpr(at).write(|bits| bits.set_bkp(value));
            cortex_m::asm::dsb();
            if pac::RTC.bkpr(at).read().bkp() == value {
                return;
            }
        }
    }
}

/// Threshold of the supply's detector: 2.85 V falling (RM0433, PWR_CR1.PLS). Above the highest brown-out level of the option bytes.
pub const SUPPLY_LEVEL: u8 = 0b110;

/// Of the supply's detector.
pub const SUPPLY_INTERRUPT: interrupt::Interrupt = interrupt::Interrupt::PVD_AVD;

#[interrupt]
unsafe fn PVD_AVD() {
    failsafe::supply_sinks()
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    failsafe::fall_safe(frame.pc())
}
