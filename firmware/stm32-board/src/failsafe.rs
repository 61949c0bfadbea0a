//! What happens when the program itself is wrong, or its supply fails: the outputs go low, the cause is kept, the controller starts
//! anew. What the stages were doing is stopped at every start, whatever its cause is said to be (the sequencer's first request).

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use flankscope_protocol::message::Boot;

use crate::chip::{Kept, ResetFlags};

/// In the first kept register: why the controller reset itself. The second holds the source line of a panic or the address of a
/// fault, for a debugger.
const PANIC: u32 = 0x5AFE_B007;
const BROWN_OUT: u32 = 0x5AFE_B0F0;

/// Why the controller started.
pub fn boot() -> Boot {
    let flags = ResetFlags::take();
    let mark = Kept::open().take_mark();
    match mark {
        _ if flags.watchdog => Boot::Watchdog,
        PANIC => Boot::Panic,
        BROWN_OUT => Boot::PowerUp,
        _ if flags.power => Boot::PowerUp,
        // The reset pin, a debugger, or what no flag tells.
        _ => Boot::Requested,
    }
}

fn reset(mark: u32, cause: u32) -> ! {
    cortex_m::interrupt::disable();
    crate::board::go_dark();
    Kept::open().put(mark, cause);
    SCB::sys_reset()
}

/// Drops the LEDs, the camera trigger and head-clear, keeps the cause, resets.
pub fn fall_safe(cause: u32) -> ! {
    reset(PANIC, cause)
}

#[panic_handler]
fn on_panic(info: &PanicInfo<'_>) -> ! {
    fall_safe(info.location().map_or(1, |location| location.line()))
}

/// The supply has sunk to where the outputs' levels are not sure for long.
pub fn supply_sinks() -> ! {
    reset(BROWN_OUT, 0)
}
