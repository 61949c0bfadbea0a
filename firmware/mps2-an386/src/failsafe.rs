//! What happens when the program itself is wrong: the cause is kept, LED and head-clear go out, the controller starts anew.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use flankscope_protocol::message::Boot;

use crate::pin_wire::Subject;
use crate::pins::tell;

/// Survives a reset, not a power cycle.
#[repr(C)]
struct Kept {
    /// Says that the rest was written.
    mark: u32,
    cause: u32,
}

const MARK: u32 = 0x5AFE_B007;

#[unsafe(link_section = ".uninit.KEPT")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Keeps `cause` over the reset that follows.
fn keep(cause: u32) {
    // SAFETY: only called with interrupts off, just before a reset.
    unsafe {
        addr_of_mut!(KEPT)
            .cast::<Kept>()
            .write_volatile(Kept { mark: MARK, cause })
    };
}

/// Why the controller started, and the cause kept by the panic handler (0: none). Forgets it.
pub fn boot() -> (Boot, u32) {
    let kept = addr_of_mut!(KEPT).cast::<Kept>();
    // SAFETY: called once, before interrupts are on; any content is a valid `Kept`.
    let Kept { mark, cause } = unsafe { kept.read_volatile() };
    if mark != MARK {
        return (Boot::PowerUp, 0);
    }
    // SAFETY: as above.
    unsafe { kept.write_volatile(Kept { mark: 0, cause: 0 }) };
    (Boot::Panic, cause)
}

fn fall_safe(cause: u32) -> ! {
    cortex_m::interrupt::disable();
    for output in [
        Subject::LedEnable,
        Subject::CameraTrigger,
        Subject::HeadClear1,
        Subject::HeadClear2,
    ] {
        tell(output, 0);
    }
    keep(cause);
    SCB::sys_reset()
}

/// The cause is the source line; none is reachable in the release image, which `cargo xtask firmware` checks.
#[panic_handler]
fn on_panic(info: &PanicInfo<'_>) -> ! {
    fall_safe(info.location().map_or(1, |location| location.line()))
}

/// The cause is the address of the instruction.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    fall_safe(frame.pc())
}
