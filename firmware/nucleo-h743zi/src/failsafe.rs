//! What happens when the program itself is wrong: the cause is kept, the LED goes out, the controller starts anew.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use flankscope_protocol::message::Boot;

/// Survives a reset, not a power cycle.
#[repr(C)]
struct Kept {
    /// Says that the rest was written.
    mark: u32,
    /// Source line of a panic, or address of a fault; for a debugger.
    cause: u32,
}

const MARK: u32 = 0x5AFE_B007;

#[unsafe(link_section = ".uninit.KEPT")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Why the controller started.
pub fn boot() -> Boot {
    let kept = addr_of_mut!(KEPT).cast::<Kept>();
    // SAFETY: called once, before interrupts are on; any content is a valid `Kept`.
    let mark = unsafe { (*kept).mark };
    if crate::board::watchdog_reset() {
        return Boot::Watchdog;
    }
    if mark != MARK {
        return Boot::PowerUp;
    }
    // SAFETY: as above. The cause stays for a debugger.
    unsafe { addr_of_mut!((*kept).mark).write_volatile(0) };
    Boot::Panic
}

/// Keeps the cause, drops the LED and the camera trigger, resets.
pub fn fall_safe(cause: u32) -> ! {
    cortex_m::interrupt::disable();
    crate::board::go_dark();
    // SAFETY: interrupts are off and a reset follows.
    unsafe {
        addr_of_mut!(KEPT)
            .cast::<Kept>()
            .write_volatile(Kept { mark: MARK, cause })
    };
    SCB::sys_reset()
}

#[panic_handler]
fn on_panic(info: &PanicInfo<'_>) -> ! {
    fall_safe(info.location().map_or(1, |location| location.line()))
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    fall_safe(frame.pc())
}
