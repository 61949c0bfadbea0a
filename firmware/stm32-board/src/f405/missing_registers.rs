//! Two registers that the emulator's model lacks and embassy-stm32's start waits for.
//!
//! The model of the STM32F405 has no RCC and no PWR: their registers read 0, so "the oscillator is ready" and "the backup domain
//! is open" never come. During the start the memory protection unit forbids both blocks; the fault of an access ends here,
//! and what was to be loaded is the register's value on a chip that is ready. Stores have no effect, as in the emulator.

use core::arch::naked_asm;

use cortex_m::peripheral::{MPU, SCB};

use crate::failsafe;

/// RCC_CR: the internal oscillator is on and ready (RM0090, 7.3.1: its value after a reset, without the trimming).
const RCC_CR: (u32, u32) = (0x4002_3800, 0x0000_0003);
/// PWR_CR: write access to the backup domain (RM0090, 5.4.1).
const PWR_CR: (u32, u32) = (0x4000_7000, 1 << 8);

/// Bytes that a region of the memory protection unit has at least; each register above is the first of such a block.
const BLOCK_BYTES: u32 = 32;

/// Region size (2 to the power of 4 + 1 bytes), enabled, no access for anybody.
const NO_ACCESS: u32 = 4 << 1 | 1;
/// The unit on; everything else as without it.
const ENABLE: u32 = 1 << 2 | 1;

/// MMFSR: a data access was refused, and its address is known.
const DATA_ADDRESS: u32 = 1 << 7 | 1 << 1;

/// Runs the start of the hardware library with both registers answered.
pub fn answered<T>(start: impl FnOnce() -> T) -> T {
    // SAFETY: nothing else uses the unit, and interrupts are off or use none of the two blocks.
    let unit = unsafe { &*MPU::PTR };
    for (region, (address, _)) in [RCC_CR, PWR_CR].into_iter().enumerate() {
        // SAFETY: regions 0 and 1 exist, and only these blocks are forbidden.
        unsafe {
            unit.rnr.write(region as u32);
            unit.rbar.write(address);
            unit.rasr.write(NO_ACCESS);
            unit.ctrl.write(ENABLE);
        }
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    let started = start();
    // SAFETY: the unit is off again, as after a reset.
    unsafe { unit.ctrl.write(0) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    started
}

/// What the wrapper below has saved: a filler, r4 to r11, the return code; then what the processor has: r0 to r3, r12, lr, pc, flags.
type Saved = [u32; 18];
const PC: usize = 16;

/// Where register `number` lies in it.
fn slot(number: u32) -> Option<usize> {
    match number {
        0..=3 => Some(10 + number as usize),
        4..=11 => Some(number as usize - 3),
        12 => Some(14),
        14 => Some(15),
        _ => None,
    }
}

/// Every fault of the processor. The library's start masks interrupts, and with them the protection unit's own exception.
#[unsafe(no_mangle)]
#[unsafe(naked)]
unsafe extern "C" fn HardFault() {
    naked_asm!(
        "push {{r3-r11, lr}}",
        "mov r0, sp",
        "bl {answer}",
        "pop {{r3-r11, pc}}",
        answer = sym answer,
    )
}

/// Completes the access that faulted; anything else is a fault of the program, which falls safe.
extern "C" fn answer(saved: &mut Saved) {
    if complete(saved).is_none() {
        failsafe::fall_safe(saved[PC]);
    }
}

fn complete(saved: &mut Saved) -> Option<()> {
    // SAFETY: read, and cleared by the ones written.
    let (status, address) = unsafe {
        let scb = &*SCB::PTR;
        let status = scb.cfsr.read();
        scb.cfsr.write(status);
        (status, scb.mmfar.read())
    };
    let (register, value) = [RCC_CR, PWR_CR]
        .into_iter()
        .find(|(register, _)| address.wrapping_sub(*register) < BLOCK_BYTES)?;
    let access = Access::at(saved[PC]).filter(|_| status == DATA_ADDRESS)?;
    if access.loads {
        *saved.get_mut(slot(access.register)?)? = if address == register { value } else { 0 };
    }
    saved[PC] += access.bytes;
    Some(())
}

/// A load or a store of one word.
struct Access {
    loads: bool,
    register: u32,
    /// Length of the instruction.
    bytes: u32,
}

impl Access {
    /// The instruction at `pc` (Arm DDI 0403, A5.2.4 and A5.3.7, A5.3.10): base and offset, without writing the base back.
    fn at(pc: u32) -> Option<Self> {
        // SAFETY: the processor has just executed what stands there; two halfwords are always within the flash.
        let [first, second] = unsafe { (pc as *const [u16; 2]).read_volatile() }.map(u32::from);
        let short = |loads| Self {
            loads,
            register: first & 7,
            bytes: 2,
        };
        let long = |loads| Self {
            loads,
            register: second >> 12,
            bytes: 4,
        };
        match (first >> 9, first & 0xFFF0) {
            (0b0110_100..=0b0110_111 | 0b0101_100, _) => Some(short(true)),
            (0b0110_000..=0b0110_011 | 0b0101_000, _) => Some(short(false)),
            (_, 0xF8D0) => Some(long(true)),
            (_, 0xF8C0) => Some(long(false)),
            // Offset in a register.
            (_, 0xF850) if second & 0xFC0 == 0 => Some(long(true)),
            (_, 0xF840) if second & 0xFC0 == 0 => Some(long(false)),
            // Offset subtracted.
            (_, 0xF850) if second & 0xF00 == 0xC00 => Some(long(true)),
            (_, 0xF840) if second & 0xF00 == 0xC00 => Some(long(false)),
            _ => None,
        }
    }
}
