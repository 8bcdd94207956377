//! Modbus RTU on two UARTs, interrupt driven both ways (RM0351, chapters 40 and 41): LPUART1 is the PLC's bus, USART1 the
//! service port, which the board's ST-Link hands on over USB.
//!
//! LPUART1 switches the transceiver's driver by itself (DE mode).

use cortex_m::peripheral::NVIC;
use stm32_metapac::rcc::vals::Lpuart1sel;
use stm32_metapac::usart::Lpuart;
use stm32_metapac::usart::vals::{M0, Ps, Stop};
use stm32_metapac::{Interrupt, LPUART1, PWR, RCC, USART1, interrupt};
use wsg_b_l475e_iot01a::BusClock;
use wsg_b_l475e_iot01a::drivers::clock::HCLK_HZ;
use wsg_bridge_fw::plc::{Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::{BusConfig, Format};

use crate::tick;

/// What comes in 7 ms at 230 400 bit/s.
const RECEIVED_MAX: usize = 512;
const TO_SEND_MAX: usize = 256;

/// One type for both lines, so that there is one copy of their code.
type Buffers = RtuBuffers<RECEIVED_MAX, TO_SEND_MAX>;

static BUS: Buffers = RtuBuffers::new();
static SERVICE: Buffers = RtuBuffers::new();

/// An LPUART has the registers of a USART, at the same places, but two that are not used here.
// SAFETY: the address is that of USART1's registers.
const SERVICE_UART: Lpuart = unsafe { Lpuart::from_ptr(USART1.as_ptr()) };

/// The service port's rate from the bus clock, rounded.
const SERVICE_DIVIDER: u32 = (HCLK_HZ + BusConfig::SERVICE.baud / 2) / BusConfig::SERVICE.baud;
/// The divider's own error is below 0.1 %: what tolerance the line has is left to the clock.
const _: () =
    assert!((HCLK_HZ / SERVICE_DIVIDER).abs_diff(BusConfig::SERVICE.baud) < BusConfig::SERVICE.baud / 1_000);

/// The bridge's end of a line; nothing comes and goes before its start.
pub(crate) type Line = RtuPort<Registers, RECEIVED_MAX, TO_SEND_MAX>;

/// The end of the bus. To be asked for once.
pub(crate) const fn line() -> Line {
    RtuPort::new(Registers(Interrupt::LPUART1), &BUS)
}

/// The end of the service port. To be asked for once.
pub(crate) const fn service_line() -> Line {
    RtuPort::new(Registers(Interrupt::USART1), &SERVICE)
}

/// What the main loop needs of the registers.
pub(crate) struct Registers(Interrupt);

impl RtuUart for Registers {
    fn pend(&mut self) {
        NVIC::pend(self.0);
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}

/// Starts the bus. The clock runs, the pins are set up. At a rate that this board cannot do (settings hold none) it stays
/// silent.
pub(crate) fn start(config: &BusConfig) {
    let Some((clock, divider)) = BusClock::for_rate(config.baud) else { return };
    match clock {
        // It runs for the PLL anyway. (The 80 MHz of the bus clock are too fast below 19 532 bit/s.)
        BusClock::Hsi16 => RCC.ccipr().modify(|w| w.set_lpuart1sel(Lpuart1sel::HSI)),
        BusClock::Lse => {
            start_lse();
            RCC.ccipr().modify(|w| w.set_lpuart1sel(Lpuart1sel::LSE));
        }
    }
    RCC.apb1enr2().modify(|w| w.set_lpuart1en(true));
    let _ = RCC.apb1enr2().read();
    LPUART1.cr3().write(|w| w.set_dem(true));
    start_uart(LPUART1, Interrupt::LPUART1, &BUS, config, divider);
}

/// Starts the service port. The clock runs at [`HCLK_HZ`], the pins are set up.
pub(crate) fn start_service() {
    RCC.apb2enr().modify(|w| w.set_usart1en(true));
    let _ = RCC.apb2enr().read();
    start_uart(SERVICE_UART, Interrupt::USART1, &SERVICE, &BusConfig::SERVICE, SERVICE_DIVIDER);
}

#[inline(never)]
fn start_uart(uart: Lpuart, interrupt: Interrupt, buffers: &Buffers, config: &BusConfig, divider: u32) {
    buffers.start(config);
    uart.brr().write(|w| w.0 = divider);
    uart.cr2().write(|w| {
        w.set_stop(if matches!(config.format, Format::None2) { Stop::STOP2 } else { Stop::STOP1 });
    });
    let with_parity = matches!(config.format, Format::Even1);
    uart.cr1().write(|w| {
        // The parity bit is the ninth.
        w.set_m0(if with_parity { M0::BIT9 } else { M0::BIT8 });
        w.set_pce(with_parity);
        w.set_ps(Ps::EVEN);
        // A driver is on for 16 clocks, a microsecond, before and after what it sends; without DE mode that is nothing.
        w.set_deat(16);
        w.set_dedt(16);
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(interrupt) };
}

/// Switches the crystal of 32.768 kHz on. It takes up to 2 s to swing; until then the bus is deaf, and nobody waits.
fn start_lse() {
    RCC.apb1enr1().modify(|w| w.set_pwren(true));
    let _ = RCC.apb1enr1().read();
    // The register is in the backup domain, which is write-protected after a reset.
    PWR.cr1().modify(|w| w.set_dbp(true));
    // The protection is lifted within some cycles; an emulator without PWR never says so.
    let _ = (0..16).any(|_| PWR.cr1().read().dbp());
    RCC.bdcr().modify(|w| w.set_lseon(true));
}

#[interrupt]
fn LPUART1() {
    handle(LPUART1, &BUS);
}

#[interrupt]
fn USART1() {
    handle(SERVICE_UART, &SERVICE);
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[inline(never)]
fn handle(uart: Lpuart, buffers: &Buffers) {
    let status = uart.isr().read();
    if status.rxne() {
        let byte = (uart.rdr().read().0 & 0xFF) as u8;
        let damaged = status.fe() || status.pe() || status.ne() || status.ore();
        buffers.on_receive(byte, damaged, status.tc(), tick::now_us());
    } else if status.ore() {
        // A byte came between the look at the status and the fetching of the one before.
        buffers.on_overrun();
    }
    uart.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_pe(status.pe());
        w.set_ne(status.ne());
        w.set_ore(status.ore());
    });
    if let Some(byte) = buffers.on_transmit(status.txe(), status.tc()) {
        uart.tdr().write(|w| w.0 = byte.into());
    }
    let Interrupts { transmit_empty, transmission_complete } = buffers.interrupts();
    let control = uart.cr1().read();
    if control.txeie() != transmit_empty || control.tcie() != transmission_complete {
        uart.cr1().modify(|w| {
            w.set_txeie(transmit_empty);
            w.set_tcie(transmission_complete);
        });
    }
}
