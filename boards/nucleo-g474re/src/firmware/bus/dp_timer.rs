//! When an answer on PROFIBUS is due, to the microsecond: TIM6 (RM0440), which runs the line's handler once.

use cortex_m::peripheral::NVIC;
use stm32_metapac::{Interrupt, RCC, TIM6, interrupt};

use crate::clock::HCLK_HZ;

/// APB1 is not divided, so the timer gets the core's clock.
const CYCLES_PER_US: u16 = (HCLK_HZ / 1_000_000) as u16;

/// Starts the timer's clock.
pub(super) fn start() {
    RCC.apb1enr1().modify(|w| w.set_tim6en(true));
    let _ = RCC.apb1enr1().read();
    TIM6.psc().write_value(CYCLES_PER_US - 1);
    TIM6.cr1().write(|w| {
        // Once, and no interrupt for what begins it anew.
        w.set_opm(true);
        w.set_urs(stm32_metapac::timer::vals::Urs::COUNTER_ONLY);
    });
    TIM6.dier().write(|w| w.set_uie(true));
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares nothing.
    unsafe { NVIC::unmask(Interrupt::TIM6_DAC) };
}

/// Runs the line's handler in so many microseconds, up to 65 ms, and not at a time that was set before.
pub(super) fn wake_in(us: u32) {
    TIM6.cr1().modify(|w| w.set_cen(false));
    TIM6.arr().write(|w| w.set_arr(u16::try_from(us).unwrap_or(u16::MAX)));
    // Counter and prescaler from 0.
    TIM6.egr().write(|w| w.set_ug(true));
    TIM6.cr1().modify(|w| w.set_cen(true));
}

#[interrupt]
fn TIM6_DAC() {
    TIM6.sr().write(|w| w.set_uif(false));
    NVIC::pend(Interrupt::USART3);
}
