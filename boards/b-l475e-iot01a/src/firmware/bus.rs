//! The PLC's bus: LPUART1 for Modbus RTU, interrupt driven both ways (RM0351, chapter 41).
//!
//! The peripheral switches the transceiver's driver by itself (DE mode).

use cortex_m::peripheral::NVIC;
use stm32_metapac::rcc::vals::Lpuart1sel;
use stm32_metapac::usart::vals::{M0, Ps, Stop};
use stm32_metapac::{Interrupt, LPUART1, PWR, RCC, interrupt};
use wsg_b_l475e_iot01a::BusClock;
use wsg_bridge_fw::plc::{Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::{BusConfig, Format};

use crate::tick;

/// What comes in 7 ms at 230 400 bit/s.
const RECEIVED_MAX: usize = 512;
const TO_SEND_MAX: usize = 256;

static BUFFERS: RtuBuffers<RECEIVED_MAX, TO_SEND_MAX> = RtuBuffers::new();

/// The bridge's end of the bus; nothing comes and goes before [`start`].
pub(crate) type Bus = RtuPort<Registers, RECEIVED_MAX, TO_SEND_MAX>;

/// The end of the bus. To be asked for once.
pub(crate) const fn line() -> Bus {
    RtuPort::new(Registers(()), &BUFFERS)
}

/// What the main loop needs of the registers.
pub(crate) struct Registers(());

impl RtuUart for Registers {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::LPUART1);
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}

/// Starts the bus. The clock runs, the pins are set up. At a rate that this board cannot do (settings hold none) it stays
/// silent.
pub(crate) fn start(config: &BusConfig) {
    let Some((clock, divider)) = BusClock::for_rate(config.baud) else { return };
    BUFFERS.start(config);
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

    LPUART1.brr().write(|w| w.0 = divider);
    LPUART1.cr2().write(|w| {
        w.set_stop(if matches!(config.format, Format::None2) { Stop::STOP2 } else { Stop::STOP1 });
    });
    LPUART1.cr3().write(|w| w.set_dem(true));
    let with_parity = matches!(config.format, Format::Even1);
    LPUART1.cr1().write(|w| {
        // The parity bit is the ninth.
        w.set_m0(if with_parity { M0::BIT9 } else { M0::BIT8 });
        w.set_pce(with_parity);
        w.set_ps(Ps::EVEN);
        // The driver is on for 16 clocks, a microsecond, before and after what it sends.
        w.set_deat(16);
        w.set_dedt(16);
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::LPUART1) };
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

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn LPUART1() {
    let status = LPUART1.isr().read();
    if status.rxne() {
        let byte = (LPUART1.rdr().read().0 & 0xFF) as u8;
        let damaged = status.fe() || status.pe() || status.ne() || status.ore();
        BUFFERS.on_receive(byte, damaged, status.tc(), tick::now_us());
    } else if status.ore() {
        // A byte came between the look at the status and the fetching of the one before.
        BUFFERS.on_overrun();
    }
    LPUART1.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_pe(status.pe());
        w.set_ne(status.ne());
        w.set_ore(status.ore());
    });
    if let Some(byte) = BUFFERS.on_transmit(status.txe(), status.tc()) {
        LPUART1.tdr().write(|w| w.0 = byte.into());
    }
    let Interrupts { transmit_empty, transmission_complete } = BUFFERS.interrupts();
    let control = LPUART1.cr1().read();
    if control.txeie() != transmit_empty || control.tcie() != transmission_complete {
        LPUART1.cr1().modify(|w| {
            w.set_txeie(transmit_empty);
            w.set_tcie(transmission_complete);
        });
    }
}
