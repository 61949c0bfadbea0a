//! The controller as a Cortex-M4 image for QEMU's machine `mps2-an386`.
//!
//! | UART | address     | other end                                                     |
//! |------|-------------|---------------------------------------------------------------|
//! | 0    | 0x4000_4000 | host link                                                     |
//! | 1    | 0x4000_5000 | the bench: virtual pins, see [`flankscope_pin_wire`]          |
//! | 2    | 0x4000_6000 | stage controller, ESP301 text                                 |
//!
//! Two executors, each in a software interrupt: the sequencer above link and stages, so that an edge is never late
//! because a message is being encoded. Interrupts of clock and UARTs are above both; thread mode only sleeps.
#![no_std]
#![no_main]

mod bench_wire;
mod clock;
mod failsafe;
mod fault_injection;
mod level;
mod pins;
mod registers;
mod stack;
mod uart;
mod watchdog;

use cortex_m_rt::{entry, exception};
use flankscope_controller::devices::{PinCamera, PinDmd, PinLed};
use flankscope_controller::liveness::Task;
use flankscope_controller::press::PinPress;
use flankscope_controller::stage::esp301::Esp301;
use flankscope_controller::{
    CommandHandler, LightEngine, Mailboxes, NoLens, Optics, Sequence, link, press_sequencer,
    sequence, serve_stage, supervise,
};
use flankscope_protocol::{Line, LineRecord, Microseconds};

use crate::level::Level;
use crate::pins::{Current, InputPin, Output, PatternBus};
use crate::registers::{Block, Irq};
use crate::uart::{Port, Uart};
use flankscope_pin_wire::Subject;

static HOST: Uart = Uart::new(Block::UART0, Irq::Uart0Rx);
static STAGE: Uart = Uart::new(Block::UART2, Irq::Uart2Rx);
static MAIL: Mailboxes = Mailboxes::supervised();

static URGENT: Level = Level::new(Irq::Sequencer);
static BACKGROUND: Level = Level::new(Irq::Background);

/// How the host's line is set; QEMU does not mind, a board would.
static HOST_LINE: LineRecord = LineRecord::new(Line::HOST);
/// As fast as a UART goes; nothing limits the bench's wires.
const LEAST_DIVIDER: u32 = 16;

/// The controller as delivered, but for a host that runs on the same machine as this emulation and everything else:
/// it may be silent for a second, as in the in-process simulation.
const CONFIG: sequence::Config = sequence::Config {
    host_silence: Microseconds::from_millis(1_000),
    ..sequence::Config::DEFAULT
};

/// Every output that a device looks at.
const LOW_AT_START: [Subject; 8] = [
    Subject::LedEnable,
    Subject::CameraTrigger,
    Subject::DmdTrigger,
    Subject::HeadClear1,
    Subject::HeadClear2,
    Subject::Go,
    Subject::NoGo,
    Subject::VerdictBeat,
];

/// The interrupt that ends a sleep on time.
const ALARM: i16 = Irq::Timer1 as i16;

type PinOptics = Optics<
    PinLed<Output, InputPin, Current>,
    PinDmd<Output, InputPin, PatternBus>,
    PinCamera<Output, InputPin, InputPin>,
    NoLens,
>;

#[embassy_executor::task]
async fn receive() {
    fault_injection::exposed(Task::Receive, link::receive(Port(&HOST), &MAIL)).await;
}

#[embassy_executor::task]
async fn transmit() {
    fault_injection::exposed(Task::Transmit, link::transmit(Port(&HOST), &MAIL)).await;
}

#[embassy_executor::task]
async fn stages() {
    let driver = Esp301::new(Port(&STAGE));
    fault_injection::exposed(Task::Stage, serve_stage(driver, &MAIL)).await;
}

#[embassy_executor::task]
async fn capture(handler: CommandHandler, optics: PinOptics, press: PinPress<InputPin, Output>) {
    pins::levels_known().await;
    let work = press_sequencer(handler, optics, press, &MAIL);
    fault_injection::exposed(Task::Sequencer, work).await;
}

#[embassy_executor::task]
async fn feeding(watchdog: watchdog::Cmsdk) {
    supervise(watchdog, &MAIL).await;
}

#[entry]
fn main() -> ! {
    let (boot, cause) = failsafe::boot();
    clock::start();
    registers::prioritise();
    bench_wire::BENCH.start(LEAST_DIVIDER);
    let Some(divider) = HOST_LINE.line().divider(uart::CLOCK_HZ) else {
        failsafe::gone_wrong(line!())
    };
    // Whatever was driven before a reset is not driven any more.
    for output in LOW_AT_START {
        pins::tell(output, 0);
    }
    pins::tell(Subject::Started, u16::try_from(cause).unwrap_or(u16::MAX));
    HOST.start(divider);

    let optics = Optics {
        first: LightEngine {
            led: PinLed {
                enable: Output::new(Subject::LedEnable),
                sense: InputPin(&pins::LED_SENSE),
                current: Current,
            },
            dmd: PinDmd {
                trigger: Output::new(Subject::DmdTrigger),
                ready: InputPin(&pins::DMD_READY),
                port: PatternBus,
            },
        },
        // No virtual pins for one.
        second: None,
        camera: PinCamera {
            trigger: Output::new(Subject::CameraTrigger),
            ready: InputPin(&pins::CAMERA_READY),
            exposing: InputPin(&pins::CAMERA_EXPOSING),
        },
        lens: NoLens,
    };
    let press = PinPress {
        press_open_a: InputPin(&pins::PRESS_OPEN_A),
        press_open_b: InputPin(&pins::PRESS_OPEN_B),
        die_clear: InputPin(&pins::DIE_CLEAR),
        guard_closed: InputPin(&pins::GUARD_CLOSED),
        cycle: InputPin(&pins::CYCLE),
        retract_switch: InputPin(&pins::RETRACT_SWITCH),
        head_clear: [
            Output::new(Subject::HeadClear1),
            Output::new(Subject::HeadClear2),
        ],
        go: Output::new(Subject::Go),
        no_go: Output::new(Subject::NoGo),
        beat: Output::new(Subject::VerdictBeat),
    };
    let handler = CommandHandler::new(Sequence::new(CONFIG), boot);
    let watchdog = watchdog::Cmsdk::start();
    URGENT.start(|spawner| spawner.spawn_if(capture(handler, optics, press)));
    BACKGROUND.start(|spawner| {
        spawner.spawn_if(stages());
        spawner.spawn_if(receive());
        spawner.spawn_if(transmit());
        spawner.spawn_if(feeding(watchdog));
    });
    loop {
        clock::sleep();
    }
}

#[exception]
unsafe fn DefaultHandler(number: i16) {
    if number != ALARM {
        clock::awake();
    }
    match number {
        0 => HOST.on_receive(),
        2 => pins::on_receive(),
        4 => STAGE.on_receive(),
        8 => clock::on_wrap(),
        ALARM => clock::on_alarm(),
        30 => BACKGROUND.poll(),
        31 => URGENT.poll(),
        // Nothing else is enabled.
        _ => {}
    }
}
