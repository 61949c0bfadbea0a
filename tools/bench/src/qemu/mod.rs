//! The controller as its Cortex-M4 image in QEMU, instead of the one in the bench's process.
//!
//! ```text
//!  host ══ pseudo-terminal ══ Port ── socket ── UART0 ┐
//!  device models ── lines ── pins ─── socket ── UART1 ├ image in qemu-system-arm, machine mps2-an386
//!  stage model ── ESP301 text ─────── socket ── UART2 ┘
//! ```
//! Devices, camera and frames are those of the in-process bench. The image's processor and the devices here run in real time. The
//! content of a frame depends on neither, because an exposure lasts from edge to edge by the image's own clock, in whole lines of
//! the sensor.

pub mod figures;
mod machine;
mod pins;

pub use figures::Figures;
pub use flankscope_pin_wire as pin_wire;
pub use machine::{EmulatorError, Machine, find_image};
pub use pins::{Emulated, FaultInjection, join};
