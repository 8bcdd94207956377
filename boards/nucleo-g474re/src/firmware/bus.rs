//! Two UARTs, interrupt driven both ways (RM0440, USART): USART3 is the PLC's bus, with Modbus RTU or PROFIBUS, USART2 the
//! service port, which the board's ST-LINK hands on over USB, with Modbus RTU.
//!
//! USART3 switches the transceiver's driver by itself (DE mode). PROFIBUS is answered in the handler, which has less than 87 µs
//! for it: then the next byte of the gripper's line is complete, and all interrupts have the same priority.

mod dp_timer;

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use bus_profibus::Character;
use cortex_m::peripheral::NVIC;
use stm32_metapac::usart::Usart;
use stm32_metapac::usart::regs::Isr;
use stm32_metapac::usart::vals::{M0, Presc, Ps, Stop};
use stm32_metapac::{Interrupt, RCC, USART2, USART3, interrupt};
use wsg_bridge_fw::plc::{DpBuffers, DpResponder, Interrupts, RtuBuffers, RtuPort, RtuUart, UartStatus};
use wsg_bridge_fw::{BusConfig, Format};
use wsg_nucleo_g474re::UartClock;

use crate::clock::HCLK_HZ;
use crate::tick;

/// One type for both lines, so that there is one copy of their code.
type Buffers = RtuBuffers;

static BUS: Buffers = RtuBuffers::new();
static SERVICE: Buffers = RtuBuffers::new();

/// What the handler of PROFIBUS and the main loop share.
pub(crate) static PROFIBUS: DpBuffers = DpBuffers::new();

/// Whether the bus is PROFIBUS and not Modbus RTU; set once, before its interrupt is unmasked.
static IS_PROFIBUS: AtomicBool = AtomicBool::new(false);

/// The service port's rate.
const SERVICE_CLOCK: Option<UartClock> = UartClock::for_rate(HCLK_HZ, BusConfig::SERVICE.baud);
const _: () = assert!(SERVICE_CLOCK.is_some());

/// The bridge's end of Modbus RTU on a line; nothing comes and goes before its start.
pub(crate) type Line = RtuPort<Registers>;

/// The end of the bus. To be asked for once.
pub(crate) const fn line() -> Line {
    RtuPort::new(Registers(Interrupt::USART3), &BUS)
}

/// The end of the service port. To be asked for once.
pub(crate) const fn service_line() -> Line {
    RtuPort::new(Registers(Interrupt::USART2), &SERVICE)
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

/// Starts Modbus RTU on the bus. The clock runs, the pins are set up. At a rate that this board cannot do (settings hold none)
/// it stays silent.
pub(crate) fn start(config: &BusConfig) {
    BUS.start(config);
    if set_up_bus(config.baud, config.format) {
        unmask(Interrupt::USART3);
    }
}

/// Starts PROFIBUS on the bus instead: the handler begins with the first [`serve_profibus`].
pub(crate) fn start_profibus() {
    IS_PROFIBUS.store(true, Ordering::Relaxed);
    dp_timer::start();
    unmask(Interrupt::USART3);
}

/// Has the handler take what the main loop's turn has brought. Once a millisecond is enough: each run ends the main loop's
/// sleep.
pub(crate) fn serve_profibus() {
    NVIC::pend(Interrupt::USART3);
}

/// Starts the service port. The clock runs at [`HCLK_HZ`], the pins are set up.
pub(crate) fn start_service() {
    let Some(clock) = SERVICE_CLOCK else { return };
    RCC.apb1enr1().modify(|w| w.set_usart2en(true));
    let _ = RCC.apb1enr1().read();
    SERVICE.start(&BusConfig::SERVICE);
    set_up(USART2, BusConfig::SERVICE.format, clock);
    unmask(Interrupt::USART2);
}

fn unmask(interrupt: Interrupt) {
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(interrupt) };
}

/// Sets the bus up for a rate and a format, before its start or anew; whether this board can do that.
// Once in the image.
#[inline(never)]
fn set_up_bus(baud: u32, format: Format) -> bool {
    let Some(clock) = UartClock::for_rate(HCLK_HZ, baud) else { return false };
    RCC.apb1enr1().modify(|w| w.set_usart3en(true));
    let _ = RCC.apb1enr1().read();
    // Rate and format change while it is off.
    USART3.cr1().write(|_| {});
    USART3.cr3().write(|w| w.set_dem(true));
    set_up(USART3, format, clock);
    true
}

#[inline(never)]
fn set_up(uart: Usart, format: Format, clock: UartClock) {
    uart.presc().write(|w| w.set_prescaler(if clock.is_halved { Presc::DIV2 } else { Presc::DIV1 }));
    uart.brr().write(|w| w.0 = clock.divider.into());
    uart.cr2().write(|w| {
        w.set_stop(if matches!(format, Format::None2) { Stop::STOP2 } else { Stop::STOP1 });
    });
    let with_parity = matches!(format, Format::Even1);
    uart.cr1().write(|w| {
        // The parity bit is the ninth.
        w.set_m0(if with_parity { M0::BIT9 } else { M0::BIT8 });
        w.set_pce(with_parity);
        w.set_ps(Ps::EVEN);
        // A driver is on for half a bit before and after what it sends, in sixteenths. Without DE mode that is nothing.
        w.set_deat(8);
        w.set_dedt(8);
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
}

#[interrupt]
fn USART3() {
    // Made here: as a static that has its value from the start it would take its size of flash.
    static mut RESPONDER: MaybeUninit<DpResponder> = MaybeUninit::uninit();
    static mut IS_MADE: bool = false;
    if !IS_PROFIBUS.load(Ordering::Relaxed) {
        serve_modbus(USART3, &BUS);
        return;
    }
    if !core::mem::replace(IS_MADE, true) {
        RESPONDER.write(DpResponder::new(&PROFIBUS));
    }
    // SAFETY: it was written in this call or in one before.
    serve_master(unsafe { RESPONDER.assume_init_mut() });
}

#[interrupt]
fn USART2() {
    serve_modbus(USART2, &SERVICE);
}

/// One byte each way per call; the interrupt stays pending while there is more.
#[inline(never)]
fn serve_modbus(uart: Usart, buffers: &Buffers) {
    let status = uart.isr().read();
    if status.rxne() {
        let byte = (uart.rdr().read().0 & 0xFF) as u8;
        buffers.on_receive(byte, is_damaged(status), status.tc(), tick::now_us());
    } else if status.ore() {
        // A byte came between the look at the status and the fetching of the one before.
        buffers.on_overrun();
    }
    clear_errors(uart, status);
    if let Some(byte) = buffers.on_transmit(status.txe(), status.tc()) {
        uart.tdr().write(|w| w.0 = byte.into());
    }
    enable(uart, buffers.interrupts());
}

/// One character each way, as above.
fn serve_master(responder: &mut DpResponder) {
    let status = USART3.isr().read();
    let received = if status.rxne() {
        let byte = (USART3.rdr().read().0 & 0xFF) as u8;
        Some(if is_damaged(status) { Character::Damaged } else { Character::Byte(byte) })
    } else {
        // As above.
        status.ore().then_some(Character::Damaged)
    };
    clear_errors(USART3, status);
    let status = UartStatus { received, has_room: status.txe(), is_complete: status.tc() };
    let action = responder.step(status, tick::now_ms(), tick::now_us());
    if let Some(rate) = action.rate {
        set_up_bus(rate.bit_s(), Format::Even1);
    }
    if let Some(byte) = action.send {
        USART3.tdr().write(|w| w.0 = byte.into());
    }
    if let Some(wait_us) = action.wait_us {
        dp_timer::wake_in(wait_us);
    }
    enable(USART3, action.interrupts);
}

fn is_damaged(status: Isr) -> bool {
    status.fe() || status.pe() || status.ne() || status.ore()
}

fn clear_errors(uart: Usart, status: Isr) {
    uart.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_pe(status.pe());
        w.set_ne(status.ne());
        w.set_ore(status.ore());
    });
}

#[inline(never)]
fn enable(uart: Usart, Interrupts { transmit_empty, transmission_complete }: Interrupts) {
    let control = uart.cr1().read();
    if control.txeie() != transmit_empty || control.tcie() != transmission_complete {
        uart.cr1().modify(|w| {
            w.set_txeie(transmit_empty);
            w.set_tcie(transmission_complete);
        });
    }
}
