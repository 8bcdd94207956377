//! The PLC's bus: LPUART1 for Modbus RTU, interrupt driven both ways (RM0351, chapter 41).
//!
//! The peripheral switches the transceiver's driver by itself (DE mode). What the transceiver echoes of the bridge's own
//! frames is not handed over.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use bus_modbus::rtu::{Character, MAX_FRAME_LEN};
use cortex_m::peripheral::NVIC;
use stm32_metapac::rcc::vals::Lpuart1sel;
use stm32_metapac::usart::vals::{M0, Ps, Stop};
use stm32_metapac::{Interrupt, LPUART1, PWR, RCC, interrupt};
use wsg_b_l475e_iot01a::BusClock;
use wsg_bridge_fw::byte_queue::ByteQueue;
use wsg_bridge_fw::{BusConfig, BusPort, Format};

use crate::tick;

/// Steps in which silence is handed on, in microseconds; 15 bits hold 262 ms of it.
const STEP_US: u32 = 8;
const MAX_STEPS: u32 = 0x7FFF;
/// Beside the steps: the character is damaged, or one before it was lost.
const DAMAGED: u16 = 0x8000;

/// A character in the queue: silence, high byte first, and the byte.
const ENTRY_LEN: usize = 3;
/// What comes in 7 ms at 230 400 bit/s.
const RECEIVED_MAX: usize = 512;
const TO_SEND_MAX: usize = 256;
const _: () = assert!(TO_SEND_MAX >= MAX_FRAME_LEN);

static RECEIVED: ByteQueue<RECEIVED_MAX> = ByteQueue::new();
static TO_SEND: ByteQueue<TO_SEND_MAX> = ByteQueue::new();
/// The time of a character, rounded up, in microseconds. Set by [`start`].
static CHARACTER_US: AtomicU32 = AtomicU32::new(0);
/// When the last character ended, in microseconds.
static RECEIVED_AT: AtomicU32 = AtomicU32::new(0);
/// A frame is being sent. Set by [`Bus::send`] while it is not, cleared by the handler.
static SENDING: AtomicBool = AtomicBool::new(false);
/// Bytes of this frame that were sent, and that came back from a transceiver that echoes. The handler's own.
static SENT: AtomicU32 = AtomicU32::new(0);
static ECHOED: AtomicU32 = AtomicU32::new(0);
/// The next character follows one that was lost. The handler's own.
static LOST: AtomicBool = AtomicBool::new(false);

/// The bridge's end of the bus. There is one value of it; nothing comes and goes before [`start`].
pub(crate) struct Bus(());

impl Bus {
    pub(crate) const fn new() -> Self {
        Self(())
    }
}

/// Starts the bus. The clock runs, the pins are set up. At a rate that this board cannot do (settings hold none) it stays
/// silent.
pub(crate) fn start(config: &BusConfig) {
    let Some((clock, divider)) = BusClock::for_rate(config.baud) else { return };
    let character_us = (config.format.bits() * 1_000_000).div_ceil(config.baud.max(1));
    CHARACTER_US.store(character_us, Ordering::Relaxed);
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

impl BusPort for Bus {
    fn receive(&mut self) -> Option<(Character, u32)> {
        // The handler pushes the three together, and this code does not interrupt it.
        let silence = u16::from_be_bytes([RECEIVED.pop()?, RECEIVED.pop()?]);
        let byte = RECEIVED.pop()?;
        let character = if silence & DAMAGED != 0 { Character::Damaged } else { Character::Byte(byte) };
        Some((character, u32::from(silence & !DAMAGED) * STEP_US))
    }

    fn silence_us(&mut self) -> u32 {
        // In this order: a character that comes between the two readings would make the silence negative, that is, end
        // a frame in its middle.
        let received_at = RECEIVED_AT.load(Ordering::Relaxed);
        let silence_us = tick::now_us().wrapping_sub(received_at);
        if RECEIVED.is_empty() { silence_us } else { 0 }
    }

    fn send(&mut self, frame: &[u8]) {
        if SENDING.load(Ordering::Relaxed) {
            return;
        }
        SENDING.store(true, Ordering::Relaxed);
        for &byte in frame {
            // There is room for the longest.
            let _ = TO_SEND.push(byte);
        }
        // The handler alone switches interrupts, so main loop and handler never change the same register.
        NVIC::pend(Interrupt::LPUART1);
    }
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[interrupt]
fn LPUART1() {
    let status = LPUART1.isr().read();
    let damaged = status.fe() || status.pe() || status.ne() || status.ore();
    if status.rxne() {
        let byte = (LPUART1.rdr().read().0 & 0xFF) as u8;
        if !is_echo(status.tc()) {
            take(byte, damaged);
        }
    }
    LPUART1.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_pe(status.pe());
        w.set_ne(status.ne());
        w.set_ore(status.ore());
    });
    send_next(status.txe(), status.tc());
}

/// Whether what was received is the bridge's own. Behind the last bit that can only be the last byte, and only if the
/// others came back as well: else it is the begin of the next request already, and this handler is late.
fn is_echo(is_complete: bool) -> bool {
    if !SENDING.load(Ordering::Relaxed) {
        return false;
    }
    let echoed = ECHOED.load(Ordering::Relaxed) + 1;
    ECHOED.store(echoed, Ordering::Relaxed);
    !(is_complete && TO_SEND.is_empty() && echoed < SENT.load(Ordering::Relaxed))
}

fn take(byte: u8, damaged: bool) {
    let now_us = tick::now_us();
    let distance_us = now_us.wrapping_sub(RECEIVED_AT.load(Ordering::Relaxed));
    RECEIVED_AT.store(now_us, Ordering::Relaxed);
    if RECEIVED.room() < ENTRY_LEN {
        LOST.store(true, Ordering::Relaxed);
        return;
    }
    let steps =
        (distance_us.saturating_sub(CHARACTER_US.load(Ordering::Relaxed)) / STEP_US).min(MAX_STEPS) as u16;
    let void = damaged || LOST.load(Ordering::Relaxed);
    LOST.store(false, Ordering::Relaxed);
    let [high, low] = if void { steps | DAMAGED } else { steps }.to_be_bytes();
    for byte in [high, low, byte] {
        let _ = RECEIVED.push(byte);
    }
}

/// The next byte of a frame, or its end: the last bit has left.
fn send_next(has_room: bool, is_complete: bool) {
    let sending = SENDING.load(Ordering::Relaxed);
    if has_room && let Some(byte) = TO_SEND.pop() {
        LPUART1.tdr().write(|w| w.0 = byte.into());
        SENT.store(SENT.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    } else if sending && is_complete && TO_SEND.is_empty() {
        SENT.store(0, Ordering::Relaxed);
        ECHOED.store(0, Ordering::Relaxed);
        SENDING.store(false, Ordering::Relaxed);
    }
    let more_to_send = !TO_SEND.is_empty();
    let ends = !more_to_send && SENDING.load(Ordering::Relaxed);
    let control = LPUART1.cr1().read();
    if control.txeie() != more_to_send || control.tcie() != ends {
        LPUART1.cr1().modify(|w| {
            w.set_txeie(more_to_send);
            w.set_tcie(ends);
        });
    }
}
