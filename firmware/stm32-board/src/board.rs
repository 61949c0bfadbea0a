//! Pins of the board and what is on them. The table in `firmware/README.md` is this file in words.
//!
//! Part of each image for an STM32 board, not a crate: what differs from chip to chip is the image's own module `chip`.

use embassy_stm32::dac::{Dac, DacChannel, Value};
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::{AnyPin, Input, Level, Output, OutputOpenDrain, Pin, Pull, Speed};
use embassy_stm32::i2c::{self, I2c, Master};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::mode::{Async, Blocking};
use embassy_stm32::peripherals::{
    DMA1_CH0, DMA1_CH2, DMA1_CH3, DMA1_CH4, DMA1_CH6, DMA1_CH7, I2C1, I2C2, I2C3,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, bind_interrupts, dma, interrupt, pac};
use embassy_time::Duration;
use embedded_io_async::{ErrorType, Read, Write};
use flankscope_controller::devices::{CurrentSetting, PinCamera, PinDmd, PinLed};
#[cfg(not(feature = "dlp5500"))]
use flankscope_controller::dlpc350::{BitDepth, Dlpc350 as DmdController, Settings};
#[cfg(feature = "dlp5500")]
use flankscope_controller::dlpc900::{Dlpc900 as DmdController, Mirrors, Settings};
use flankscope_controller::max14574::Max14574;
use flankscope_controller::press::PinPress;
use flankscope_controller::stage::StagePort;
use flankscope_controller::{LightEngine, Optics, Watchdog};
use flankscope_protocol::{
    FlowControl, Limits, Line, LineRecord, MAX_FRAME_BYTES, Microseconds, Milliamps, Parity,
    StageConfig,
};
use static_cell::StaticCell;

use crate::chip::{self, UartIrqs};

bind_interrupts!(struct Irqs {
    I2C1_EV => i2c::EventInterruptHandler<I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<I2C1>;
    I2C2_EV => i2c::EventInterruptHandler<I2C2>;
    I2C2_ER => i2c::ErrorInterruptHandler<I2C2>;
    I2C3_EV => i2c::EventInterruptHandler<I2C3>;
    I2C3_ER => i2c::ErrorInterruptHandler<I2C3>;
    DMA1_STREAM0 => dma::InterruptHandler<DMA1_CH0>;
    DMA1_STREAM2 => dma::InterruptHandler<DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<DMA1_CH3>;
    DMA1_STREAM4 => dma::InterruptHandler<DMA1_CH4>;
    DMA1_STREAM6 => dma::InterruptHandler<DMA1_CH6>;
    DMA1_STREAM7 => dma::InterruptHandler<DMA1_CH7>;
    EXTI0 => exti::InterruptHandler<interrupt::typelevel::EXTI0>;
    EXTI1 => exti::InterruptHandler<interrupt::typelevel::EXTI1>;
    EXTI2 => exti::InterruptHandler<interrupt::typelevel::EXTI2>;
    EXTI3 => exti::InterruptHandler<interrupt::typelevel::EXTI3>;
    EXTI4 => exti::InterruptHandler<interrupt::typelevel::EXTI4>;
    EXTI9_5 => exti::InterruptHandler<interrupt::typelevel::EXTI9_5>;
    EXTI15_10 => exti::InterruptHandler<interrupt::typelevel::EXTI15_10>;
});

/// How the host's line is set.
static HOST_LINE: LineRecord = LineRecord::new(Line::HOST);

/// The fastest that a DMD controller's bus goes, and the lens driver's.
const BUS_HZ: u32 = 400_000;
/// Patience with one transaction: the longest has 10 bytes, a quarter of a millisecond.
const BUS_TIMEOUT: Duration = Duration::from_millis(2);

/// The lens driver's outputs that have a lens: the camera's on the first, the projectors' on the second.
const LENS_OUTPUTS: u8 = 0b0011;

/// The patterns in a DMD controller's flash. One stands for as long as any camera exposure, and as long again.
const PATTERNS: Settings = Settings {
    #[cfg(not(feature = "dlp5500"))]
    depth: BitDepth::Eight,
    #[cfg(feature = "dlp5500")]
    mirrors: Mirrors::Dlp5500,
    exposure: Microseconds(2 * Limits::DEFAULT.exposure_max.get()),
    patterns: Limits::DEFAULT.patterns_max,
};

/// Four beats of the tasks.
const WATCHDOG_US: u32 = 200_000;

type In = ExtiInput<'static, Async>;
type Out = Output<'static>;
/// The devices that work with light.
pub type BoardOptics = Optics<
    PinLed<Out, In, LedCurrent>,
    PinDmd<Out, In, PatternBus>,
    PinCamera<Out, In, In>,
    Max14574<Bus>,
>;
type Bus = I2c<'static, Async, Master>;
type PatternBus = DmdController<Bus>;

/// The press's signals.
pub type BoardPress = PinPress<In, Out>;

/// Everything wired.
pub struct Board {
    pub press: BoardPress,
    /// LED, DMD, camera.
    pub optics: BoardOptics,
    /// Host link.
    pub host: BufferedUart<'static>,
    /// Stage controller.
    pub stage: StageUart,
    /// Not started yet.
    pub watchdog: BoardWatchdog,
}

impl Board {
    /// Sets clocks and pins: every output low, before anything else is done. `None` if a UART refuses its settings, which are fixed.
    pub fn take() -> Option<Self> {
        let mut p = chip::init();
        watch_supply();
        let low = |pin: Peri<'static, AnyPin>| Output::new(pin, Level::Low, Speed::Low);
        let [led, second_led, head_clear_1, head_clear_2] =
            [p.PE2.into(), p.PE15.into(), p.PE12.into(), p.PE14.into()].map(low);
        let [dmd, second_dmd, camera] = [p.PE6.into(), p.PE9.into(), p.PE7.into()].map(low);
        let [go, no_go, beat] = [p.PG0.into(), p.PG1.into(), p.PG2.into()].map(low);
        free_bus(p.PB8.reborrow(), p.PB9.reborrow());
        free_bus(p.PA8.reborrow(), p.PC9.reborrow());
        free_bus(p.PB10.reborrow(), p.PB11.reborrow());
        let mut bus = i2c::Config::default();
        bus.frequency = Hertz(BUS_HZ);
        bus.timeout = BUS_TIMEOUT;
        // Each bus on the DMA channels that an STM32F4 has wired to it; an STM32H7 has them all at its choice.
        let patterns = I2c::new(p.I2C1, p.PB8, p.PB9, p.DMA1_CH6, p.DMA1_CH0, Irqs, bus);
        // A bus of its own: a lens on a long cable that holds it down takes no pattern with it.
        let second_patterns = I2c::new(p.I2C3, p.PA8, p.PC9, p.DMA1_CH4, p.DMA1_CH2, Irqs, bus);
        let [first_current, second_current] =
            LedCurrent::both(Dac::new_blocking(p.DAC1, p.PA4, p.PA5));
        // A bridge in its plug: what is not plugged in is not there.
        let plug = Input::new(p.PG3, Pull::Down);
        settle(SIGNAL_SETTLE_US);
        let fitted = plug.is_high();
        let second = LightEngine {
            led: PinLed {
                enable: second_led,
                sense: ExtiInput::new(p.PE13, p.EXTI13, Pull::Down, Irqs),
                current: second_current,
            },
            dmd: PinDmd {
                trigger: second_dmd,
                ready: ExtiInput::new(p.PE11, p.EXTI11, Pull::Down, Irqs),
                port: DmdController::new(second_patterns, PATTERNS),
            },
        };
        let lens = I2c::new(p.I2C2, p.PB10, p.PB11, p.DMA1_CH7, p.DMA1_CH3, Irqs, bus);
        let optics = Optics {
            first: LightEngine {
                led: PinLed {
                    enable: led,
                    sense: ExtiInput::new(p.PE3, p.EXTI3, Pull::Down, Irqs),
                    current: first_current,
                },
                dmd: PinDmd {
                    trigger: dmd,
                    ready: ExtiInput::new(p.PE4, p.EXTI4, Pull::Down, Irqs),
                    port: DmdController::new(patterns, PATTERNS),
                },
            },
            second: fitted.then_some(second),
            camera: PinCamera {
                trigger: camera,
                ready: ExtiInput::new(p.PE5, p.EXTI5, Pull::Down, Irqs),
                exposing: ExtiInput::new(p.PE10, p.EXTI10, Pull::Down, Irqs),
            },
            lens: Max14574::new(lens, LENS_OUTPUTS),
        };
        let input_low = Pull::Down; // a cut cable reads as "not safe"
        let press = PinPress {
            press_open_a: ExtiInput::new(p.PF0, p.EXTI0, input_low, Irqs),
            // Low means open: a cut cable must read high.
            press_open_b: ExtiInput::new(p.PF1, p.EXTI1, Pull::Up, Irqs),
            die_clear: ExtiInput::new(p.PF2, p.EXTI2, input_low, Irqs),
            guard_closed: ExtiInput::new(p.PF6, p.EXTI6, input_low, Irqs),
            cycle: ExtiInput::new(p.PF7, p.EXTI7, input_low, Irqs),
            retract_switch: ExtiInput::new(p.PF8, p.EXTI8, input_low, Irqs),
            head_clear: [head_clear_1, head_clear_2],
            go,
            no_go,
            beat,
        };
        static HOST: StaticCell<[[u8; MAX_FRAME_BYTES]; 2]> = StaticCell::new();
        static STAGE: StaticCell<[[u8; 128]; 2]> = StaticCell::new();
        let settings = uart(HOST_LINE.line());
        let [to_host, from_host] = HOST.try_init([[0; MAX_FRAME_BYTES]; 2])?;
        let host = BufferedUart::new(
            p.USART3, p.PD9, p.PD8, to_host, from_host, UartIrqs, settings,
        )
        .ok()?;
        // As a host has it set later.
        let settings = uart(StageConfig::DEFAULT.line);
        let [to_stage, from_stage] = STAGE.try_init([[0; 128]; 2])?;
        let stage = BufferedUart::new(
            p.USART2, p.PD6, p.PD5, to_stage, from_stage, UartIrqs, settings,
        )
        .ok()?;
        Some(Self {
            press,
            optics,
            host,
            stage: StageUart(stage),
            watchdog: BoardWatchdog(IndependentWatchdog::new(
                chip::watchdog_unit!(p),
                WATCHDOG_US,
            )),
        })
    }
}

/// The stage controller's UART: no RTS and CTS either, which the controller's limits know.
pub struct StageUart(BufferedUart<'static>);

impl StagePort for StageUart {
    fn set_line(&mut self, line: &Line) -> bool {
        self.0.set_config(&uart(*line)).is_ok()
    }
}

impl ErrorType for StageUart {
    type Error = usart::Error;
}

impl Read for StageUart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, usart::Error> {
        Read::read(&mut self.0, buffer).await
    }
}

impl Write for StageUart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, usart::Error> {
        Write::write(&mut self.0, bytes).await
    }
    async fn flush(&mut self) -> Result<(), usart::Error> {
        Write::flush(&mut self.0).await
    }
}

/// A UART set as a line is. Its pins decide about flow control: the host's UART has no RTS and CTS.
fn uart(line: Line) -> usart::Config {
    let mut settings = usart::Config::default();
    settings.baudrate = line.baud;
    settings.eager_reads = chip::EAGER_READS;
    settings.data_bits = match line.data_bits {
        7 => usart::DataBits::DataBits7,
        _ => usart::DataBits::DataBits8,
    };
    settings.parity = match line.parity {
        Parity::None => usart::Parity::ParityNone,
        Parity::Even => usart::Parity::ParityEven,
        Parity::Odd => usart::Parity::ParityOdd,
    };
    settings.stop_bits = match line.stop_bits {
        2 => usart::StopBits::STOP2,
        _ => usart::StopBits::STOP1,
    };
    settings
}

const _: () = assert!(
    matches!(Line::HOST.flow, FlowControl::None),
    "the host's UART has no pins for flow control"
);

/// The LED driver's current input: full scale of the converter is the largest current allowed.
pub struct LedCurrent(DacChannel<'static, Blocking>);

impl LedCurrent {
    /// The converter's two channels: one for each projector.
    fn both(converter: Dac<'static, Blocking>) -> [Self; 2] {
        let (first, second) = converter.split();
        [Self(first), Self(second)]
    }
}

impl CurrentSetting for LedCurrent {
    fn set(&mut self, current: Milliamps) {
        let full = u32::from(Limits::DEFAULT.led_max.get()).max(1);
        let code = (u32::from(current.get()) * 4095 / full).min(4095);
        self.0.set(Value::Bit12Right(code as u16));
    }
}

/// The independent watchdog: its clock is its own, and once started nothing but a reset stops it. The reset makes every
/// pin an input, so that the outside's pull-downs drop the outputs.
pub struct BoardWatchdog(IndependentWatchdog<'static, chip::WatchdogUnit>);

impl BoardWatchdog {
    /// From here on it must be fed.
    pub fn start(&mut self) {
        self.0.unleash();
    }
}

impl Watchdog for BoardWatchdog {
    fn feed(&mut self) {
        self.0.pet();
    }
}

/// Waits for the supply, then watches it: below the threshold its interrupt drops the outputs.
fn watch_supply() {
    pac::PWR.cr1().modify(|bits| {
        bits.set_pls(chip::SUPPLY_LEVEL);
        bits.set_pvde(true);
    });
    settle(SIGNAL_SETTLE_US);
    // Every output is still an input, pulled low outside.
    while pac::PWR.csr1().read().pvdo() {}
    const PVD_LINE: usize = 16;
    pac::EXTI
        .rtsr(0)
        .modify(|bits| bits.set_line(PVD_LINE, true));
    pac::EXTI.pr(0).write(|bits| bits.set_line(PVD_LINE, true));
    pac::EXTI
        .imr(0)
        .modify(|bits| bits.set_line(PVD_LINE, true));
    chip::SUPPLY_INTERRUPT.set_priority(Priority::P0);
    // SAFETY: its handler shares nothing with the rest of the program.
    unsafe { chip::SUPPLY_INTERRUPT.enable() };
}

/// Lets an input with a pull resistor of 40 kOhm and a metre of cable reach its level.
const SIGNAL_SETTLE_US: u32 = 50;
/// Half a bit of the I2C bus's slow mode.
const HALF_BIT_US: u32 = 5;

/// Busy waiting.
fn settle(time_us: u32) {
    cortex_m::asm::delay(chip::CLOCK_MHZ * time_us);
}

/// Frees an I2C bus whose device was left in the middle of a byte by a reset: it holds SDA low until it has had its clocks, nine at
/// most, then a stop (UM10204, 3.1.16).
fn free_bus(scl: Peri<'_, impl Pin>, sda: Peri<'_, impl Pin>) {
    let mut scl = OutputOpenDrain::new(scl, Level::High, Speed::Low);
    let mut sda = OutputOpenDrain::new(sda, Level::High, Speed::Low);
    settle(HALF_BIT_US);
    for _ in 0..9 {
        if sda.is_high() {
            break;
        }
        scl.set_low();
        settle(HALF_BIT_US);
        scl.set_high();
        settle(HALF_BIT_US);
    }
    // A start and a stop: whoever still listens to a transfer hears its end.
    sda.set_low();
    settle(HALF_BIT_US);
    sda.set_high();
    settle(HALF_BIT_US);
}

/// Both LED enables, camera trigger and both head-clear outputs low, whatever the rest of the program thinks.
pub fn go_dark() {
    for pin in [2, 7, 12, 14, 15] {
        pac::GPIOE.bsrr().write(|bits| bits.set_br(pin, true));
    }
}
