//! The controller's tasks on an STM32 board: embassy-stm32's pins and UARTs behind the controller's traits.
//!
//! The sequencer runs in an interrupt of its own above link and stages, so that an edge is never late because a message
//! is being encoded.

use embassy_executor::{Executor, InterruptExecutor};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use flankscope_controller::stage::esp301::Esp301;
use flankscope_controller::{
    CommandHandler, Mailboxes, Sequence, link, press_sequencer, sequence, serve_stage, supervise,
};
use static_cell::StaticCell;

use crate::board::{Board, BoardOptics, BoardPress, BoardWatchdog, StageUart};
use crate::failsafe;

static MAIL: Mailboxes = Mailboxes::supervised();
static URGENT: InterruptExecutor = InterruptExecutor::new();
static BACKGROUND: StaticCell<Executor> = StaticCell::new();

#[embassy_executor::task]
async fn receive(port: BufferedUartRx<'static>) {
    link::receive(port, &MAIL).await;
}

#[embassy_executor::task]
async fn transmit(port: BufferedUartTx<'static>) {
    link::transmit(port, &MAIL).await;
}

#[embassy_executor::task]
async fn stages(port: StageUart) {
    serve_stage(Esp301::new(port), &MAIL).await;
}

#[embassy_executor::task]
async fn capture(handler: CommandHandler, optics: BoardOptics, press: BoardPress) {
    press_sequencer(handler, optics, press, &MAIL).await;
}

#[embassy_executor::task]
async fn feeding(watchdog: BoardWatchdog) {
    supervise(watchdog, &MAIL).await;
}

/// Nothing on the board raises it: pended by software.
#[interrupt]
unsafe fn SPI3() {
    // SAFETY: this is the handler, and it is unmasked only by `start`.
    unsafe { URGENT.on_interrupt() };
}

/// Never returns; the first that it does is to find out why the controller started, and to set every output low.
pub fn run() -> ! {
    let boot = failsafe::boot();
    let Some(Board {
        optics,
        press,
        host,
        stage,
        mut watchdog,
    }) = Board::take()
    else {
        failsafe::fall_safe(line!())
    };
    watchdog.start();
    let handler = CommandHandler::new(Sequence::new(sequence::Config::DEFAULT), boot);
    interrupt::SPI3.set_priority(Priority::P6);
    let urgent = URGENT.start(interrupt::SPI3);
    if let Ok(task) = capture(handler, optics, press) {
        urgent.spawn(task);
    }
    let (to_host, from_host) = host.split();
    let Some(background) = BACKGROUND.try_uninit() else {
        failsafe::fall_safe(line!())
    };
    background.write(Executor::new()).run(|spawner| {
        if let Ok(task) = receive(from_host) {
            spawner.spawn(task);
        }
        if let Ok(task) = transmit(to_host) {
            spawner.spawn(task);
        }
        if let Ok(task) = stages(stage) {
            spawner.spawn(task);
        }
        if let Ok(task) = feeding(watchdog) {
            spawner.spawn(task);
        }
    })
}
