//! The bridge on the board B-L475E-IOT01A (STM32L475VG): entry point and interrupt vectors.

#![no_std]
#![no_main]

mod log;

use cortex_m_rt::{entry, exception};
use wsg_b_l475e_iot01a::drivers::can1::Can1;
use wsg_b_l475e_iot01a::drivers::{Iot01a, TICK};
use wsg_bridge_fw::Station;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::plc::BusHandler;
use wsg_stm32::bus;
use wsg_stm32::pac::interrupt;

#[entry]
fn main() -> ! {
    // Too large for the stack. `entry` makes this safe, because it runs only once.
    static mut STATION: Station<Can1> =
        Station::new(CanBus::new(Can1::new(), BusOffPolicy::DEFAULT), bus::BUS.profibus());
    wsg_stm32::run::<Iot01a>(STATION)
}

#[exception]
fn SysTick() {
    TICK.count();
}

#[interrupt]
fn LPUART1() {
    static mut HANDLER: BusHandler = BusHandler::new();
    bus::on_bus_interrupt::<Iot01a>(HANDLER);
}

#[interrupt]
fn USART1() {
    bus::on_service_interrupt::<Iot01a>();
}

#[interrupt]
fn TIM6_DAC() {
    bus::on_timer_interrupt::<Iot01a>();
}
