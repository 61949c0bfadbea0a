//! How much of the stack was ever used: cortex-m-rt paints it at start, what is not painted any more was used.

use core::ptr::addr_of;

/// What `paint-stack` of cortex-m-rt writes.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Most bytes ever used.
pub fn used_bytes() -> usize {
    let top = addr_of!(_stack_start) as usize;
    let mut at = addr_of!(_stack_end) as usize;
    // SAFETY: the words between the two symbols are the stack's memory; they are only read, one by one.
    while at < top && unsafe { (at as *const u32).read_volatile() } == PAINT {
        at += size_of::<u32>();
    }
    top - at
}
