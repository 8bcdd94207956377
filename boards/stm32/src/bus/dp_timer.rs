//! When an answer on PROFIBUS is due, to the microsecond: TIM6 (RM0351, chapter 33; RM0440), which runs the bus's handler once.
//!
//! Where there is no such timer, as in an emulator, the answer is sent with the next turn of the main loop.

use cortex_m::peripheral::NVIC;
use stm32_metapac::{Interrupt, RCC, TIM6};

use crate::board::Stm32Board;
use crate::uart::{self, Uart};

/// Starts the timer's clock.
pub(super) fn start<B: Stm32Board>() {
    RCC.apb1enr1().modify(|w| w.set_tim6en(true));
    let _ = RCC.apb1enr1().read();
    TIM6.psc().write_value((B::HCLK_HZ / 1_000_000) as u16 - 1);
    TIM6.cr1().write(|w| {
        // Once, and no interrupt for what begins it anew.
        w.set_opm(true);
        w.set_urs(stm32_metapac::timer::vals::Urs::COUNTER_ONLY);
    });
    TIM6.dier().write(|w| w.set_uie(true));
    uart::unmask(Interrupt::TIM6_DAC);
}

/// Runs the bus's handler in so many microseconds, up to 65 ms, and not at a time that was set before.
pub(super) fn wake_in(us: u32) {
    TIM6.cr1().modify(|w| w.set_cen(false));
    TIM6.arr().write(|w| w.set_arr(u16::try_from(us).unwrap_or(u16::MAX)));
    // Counter and prescaler from 0.
    TIM6.egr().write(|w| w.set_ug(true));
    TIM6.cr1().modify(|w| w.set_cen(true));
}

/// Has the bus's handler run. For the handler of TIM6.
#[inline]
pub fn on_interrupt<B: Stm32Board>() {
    TIM6.sr().write(|w| w.set_uif(false));
    NVIC::pend(B::BusUart::INTERRUPT);
}
