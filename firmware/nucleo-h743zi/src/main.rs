//! The controller for a NUCLEO-H743ZI2; all of it is in [`flankscope_stm32_board`].
#![no_std]
#![no_main]

#[cortex_m_rt::entry]
fn main() -> ! {
    flankscope_stm32_board::run()
}
