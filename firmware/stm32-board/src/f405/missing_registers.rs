//! Registers that the emulator's model lacks, where their value matters.
//!
//! The model of the STM32F405 has no RCC, no PWR and no GPIO: their registers read 0. So "the oscillator is ready" and "the backup
//! domain is open", for which embassy-stm32's start waits, never come, and every contact of the press is low for ever. The
//! memory protection unit forbids these blocks; the fault of an access ends here, and what was to be loaded is the register's
//! value on a chip that is ready, or the contacts' levels as the test has set them. Stores have no effect, as in the emulator.

use core::arch::naked_asm;

use cortex_m::peripheral::{MPU, SCB};

use crate::failsafe;

/// RCC_CR: the internal oscillator is on and ready (RM0090, 7.3.1: its value after a reset, without the trimming).
const RCC_CR: u32 = 0x4002_3800;
const OSCILLATOR_READY: u32 = 0b11;
/// PWR_CR: write access to the backup domain (RM0090, 5.4.1).
const PWR_CR: u32 = 0x4000_7000;
const BACKUP_OPEN: u32 = 1 << 8;

/// GPIOF_IDR, in the block of GPIOF_MODER: the press's contacts.
const GPIOF: u32 = 0x4002_1400;
const GPIOF_IDR: u32 = GPIOF + 0x10;
/// Where the test writes their levels: a word of RAM behind what `memory.x` gives the program.
const CONTACTS: *const u32 = 0x2001_FC00 as *const u32;

/// One region each; the first stays forbidden.
const BLOCKS: [u32; 3] = [GPIOF, RCC_CR, PWR_CR];
/// Bytes that a region of the memory protection unit has at least; the registers lie in the block that begins with the first.
const BLOCK_BYTES: u32 = 32;

/// Region size (2 to the power of 4 + 1 bytes), enabled, no access for anybody.
const NO_ACCESS: u32 = 4 << 1 | 1;
/// The unit on; everything else as without it.
const ENABLE: u32 = 1 << 2 | 1;

/// MMFSR: a data access was refused, and its address is known.
const DATA_ADDRESS: u32 = 1 << 7 | 1 << 1;

/// Runs the start of the hardware library with all of them answered; the contacts are from then on.
pub fn answered<T>(start: impl FnOnce() -> T) -> T {
    // SAFETY: nothing else uses the unit.
    let unit = unsafe { &*MPU::PTR };
    for (region, address) in BLOCKS.into_iter().enumerate() {
        // SAFETY: the unit has eight regions, and every access to these blocks is completed below.
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
    for region in [1, 2] {
        // SAFETY: what was forbidden is as in the emulator again.
        unsafe {
            unit.rnr.write(region);
            unit.rasr.write(0);
        }
    }
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

/// Every fault of the processor: the protection unit's own exception is not enabled, for the library's start masks it.
// SAFETY: the only function of this name, which cortex-m-rt's vector table names; it leaves every register as it was but for those that
// `answer` means to change in what it has saved, and returns by the code that the processor has left in lr.
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
    if status != DATA_ADDRESS {
        return None;
    }
    BLOCKS
        .into_iter()
        .find(|block| address.wrapping_sub(*block) < BLOCK_BYTES)?;
    let access = Access::at(saved[PC])?;
    if access.loads {
        *saved.get_mut(slot(access.register)?)? = match address {
            RCC_CR => OSCILLATOR_READY,
            PWR_CR => BACKUP_OPEN,
            // SAFETY: it is RAM, outside of everything that the program has; any bits are levels.
            GPIOF_IDR => unsafe { CONTACTS.read_volatile() },
            _ => 0,
        };
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
    /// The instruction at `pc`, if it is one that adds an offset to its base or takes it off, and does not write the base back (Arm DDI
    /// 0403, A7.7.43, A7.7.45, A7.7.161 and A7.7.162).
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
        match (first >> 9, first >> 4) {
            (0b0110_100..=0b0110_111 | 0b0101_100, _) => Some(short(true)),
            (0b0110_000..=0b0110_011 | 0b0101_000, _) => Some(short(false)),
            (_, 0xF8D) => Some(long(true)),
            (_, 0xF8C) => Some(long(false)),
            // Offset in a register, or taken off.
            (_, 0xF85) if second & 0xFC0 == 0 || second & 0xF00 == 0xC00 => Some(long(true)),
            (_, 0xF84) if second & 0xFC0 == 0 || second & 0xF00 == 0xC00 => Some(long(false)),
            _ => None,
        }
    }
}
