//! The controller for the STM32F405 of QEMU's machine `netduinoplus2`: the NUCLEO's tasks, pins and drivers, without a board.
//!
//! USART3 is the host link, USART2 the stage controller. What the emulator's models lack, and what stands in for it, is in the
//! module `chip` (`f405`) of [`flankscope_stm32_board`].
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    flankscope_stm32_board::run()
}
