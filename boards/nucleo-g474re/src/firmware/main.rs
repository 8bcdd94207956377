//! The bridge on the board NUCLEO-G474RE (STM32G474RE): entry point and interrupt vectors.
//!
//! Executed in QEMU with models of the peripherals that its machine lacks, never on hardware.

#![no_std]
#![no_main]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use cortex_m_rt::{entry, exception};
use wsg_bridge_fw::Station;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::plc::BusHandler;
use wsg_nucleo_g474re::drivers::can::Can;
use wsg_nucleo_g474re::drivers::{Nucleo, TICK};
use wsg_stm32::bus;
use wsg_stm32::pac::interrupt;

#[entry]
fn main() -> ! {
    // Too large for the stack. `entry` makes this safe, because it runs only once.
    static mut STATION: Station<Can> =
        Station::new(CanBus::new(Can::new(), BusOffPolicy::DEFAULT), bus::BUS.profibus());
    wsg_stm32::run::<Nucleo>(STATION)
}

#[exception]
fn SysTick() {
    TICK.count();
}

#[interrupt]
fn USART2() {
    bus::on_service_interrupt::<Nucleo>();
}

#[interrupt]
fn USART3() {
    static mut HANDLER: BusHandler = BusHandler::new();
    bus::on_bus_interrupt::<Nucleo>(HANDLER);
}

#[interrupt]
fn TIM6_DAC() {
    bus::on_timer_interrupt::<Nucleo>();
}
