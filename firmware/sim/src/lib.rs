//! The controller on the host: embassy's executor, one time driver, virtual pins, UARTs and I2C.
//!
//! Each [`Sim`] owns the thread it was made on, with a clock of its own, so simulations run in parallel and never see
//! each other. Virtual time jumps from deadline to deadline and stands still in between, however long the host takes
//! to compute: the same inputs give the same times.
//!
//! ```
//! use embassy_time::{Duration, Instant, Timer};
//! use embedded_hal::digital::OutputPin;
//! use embedded_hal_async::digital::Wait;
//! use flankscope_sim::{Clock, Sim};
//!
//! let sim = Sim::new(Clock::Stepped);
//! let (mut driver, mut watcher) = (sim.line("led"), sim.line("other"));
//! let mut led = driver.clone();
//! sim.spawn(async move {
//!     Timer::after(Duration::from_secs(3)).await;
//!     driver.set_high().unwrap();
//! });
//! sim.spawn(async move {
//!     led.wait_for_high().await.unwrap();
//!     assert_eq!(Instant::now().as_millis(), 3000);
//!     watcher.set_high().unwrap();
//! });
//! sim.run();
//! assert_eq!(sim.edges().len(), 2);
//! ```

mod clock;
mod executor;
pub mod i2c;
pub mod line;
pub mod pty;
mod sync;
pub mod uart;
mod watchdog;
mod wiring;

pub use clock::now_us;
pub use executor::{Clock, Hold, Pace, Remote, Sim};
pub use i2c::I2cBus;
pub use line::{Edge, Line};
pub use pty::Pty;
pub use uart::Port;
pub use watchdog::Controller;
pub use wiring::{
    Board, CurrentCell, PatternBus, PressLines, ProjectorLines, Wiring, spawn_controller,
};
