//! The time of a PROFIBUS answer, in microseconds: TIM6 (RM0351, chapter 33; RM0440) triggers the bus's handler once.
//!
//! Without this timer, for example in an emulator, the next iteration of the main loop sends the answer.

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
        // One shot, without an interrupt when it is restarted.
        w.set_opm(true);
        w.set_urs(stm32_metapac::timer::vals::Urs::COUNTER_ONLY);
    });
    TIM6.dier().write(|w| w.set_uie(true));
    uart::unmask(Interrupt::TIM6_DAC);
}

/// Triggers the bus's handler after `us`, at most 65 ms. Replaces an earlier request.
pub(super) fn wake_in(us: u32) {
    TIM6.cr1().modify(|w| w.set_cen(false));
    TIM6.arr().write(|w| w.set_arr(u16::try_from(us).unwrap_or(u16::MAX)));
    // Reset counter and prescaler.
    TIM6.egr().write(|w| w.set_ug(true));
    TIM6.cr1().modify(|w| w.set_cen(true));
}

/// Triggers the bus's handler. Call it from the handler of TIM6.
#[inline]
pub fn on_interrupt<B: Stm32Board>() {
    TIM6.sr().write(|w| w.set_uif(false));
    NVIC::pend(B::BusUart::INTERRUPT);
}
