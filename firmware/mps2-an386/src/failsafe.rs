//! What happens when the program itself is wrong: the cause is kept, LED and head-clear go out, the controller starts anew.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::addr_of_mut;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use flankscope_protocol::message::Boot;

use crate::pins::tell;
use flankscope_pin_wire::Subject;

/// Survives a reset, not a power cycle.
#[repr(C)]
struct Kept {
    /// Why, as [`PANIC`] or [`WATCHDOG`], or [`RUNNING`]; anything else: the power was off.
    mark: u32,
    cause: u32,
}

const PANIC: u32 = 0x5AFE_B007;
const WATCHDOG: u32 = 0x5AFE_D069;
/// It ran, and nothing was wrong that it knew of.
const RUNNING: u32 = 0x5AFE_0009;
/// Cause: the watchdog reset by itself, before its interrupt was served.
const BY_ITSELF: u32 = 1;

#[unsafe(link_section = ".uninit.KEPT")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();

/// Why the controller started, and the cause that was kept (0: none). From here on it is running.
///
/// Whatever resets a running controller and says nothing is the watchdog, out of patience twice: on a busy machine the emulator
/// may pass over both windows at once.
pub fn boot() -> (Boot, u32) {
    let kept = addr_of_mut!(KEPT).cast::<Kept>();
    // SAFETY: called once, before interrupts are on; any content is a valid `Kept`.
    let Kept { mark, cause } = unsafe { kept.read_volatile() };
    // SAFETY: as above.
    unsafe {
        kept.write_volatile(Kept {
            mark: RUNNING,
            cause: 0,
        })
    };
    match mark {
        PANIC => (Boot::Panic, cause),
        WATCHDOG => (Boot::Watchdog, cause),
        RUNNING => (Boot::Watchdog, BY_ITSELF),
        _ => (Boot::PowerUp, 0),
    }
}

/// Drops the outputs, keeps `mark` and `cause` over the reset, resets.
fn fall_safe(mark: u32, cause: u32) -> ! {
    cortex_m::interrupt::disable();
    for output in [
        Subject::LedEnable,
        Subject::CameraTrigger,
        Subject::HeadClear1,
        Subject::HeadClear2,
    ] {
        tell(output, 0);
    }
    // SAFETY: interrupts are off and a reset follows.
    unsafe {
        addr_of_mut!(KEPT)
            .cast::<Kept>()
            .write_volatile(Kept { mark, cause })
    };
    SCB::sys_reset()
}

/// What must not be is so, at this source line.
pub fn gone_wrong(line: u32) -> ! {
    fall_safe(PANIC, line)
}

/// The cause is the source line; none is reachable in the release image, which `cargo xtask firmware` checks.
#[panic_handler]
fn on_panic(info: &PanicInfo<'_>) -> ! {
    fall_safe(PANIC, info.location().map_or(1, |location| location.line()))
}

/// The cause is the address of the instruction.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    fall_safe(PANIC, frame.pc())
}

/// The watchdog was not fed. Nothing masks this interrupt, and it comes before all others.
#[exception]
unsafe fn NonMaskableInt() -> ! {
    fall_safe(WATCHDOG, 0)
}
