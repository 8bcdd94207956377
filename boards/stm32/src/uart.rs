//! The UARTs of the chips, and functions shared by their handlers (RM0351, chapters 40 and 41; RM0440, USART).

use cortex_m::peripheral::NVIC;
use stm32_metapac::usart::regs::Isr;
use stm32_metapac::usart::vals::{M0, Ps, Stop};
use stm32_metapac::usart::{Lpuart, Usart};
use stm32_metapac::{Interrupt, LPUART1, RCC, UART4, USART1, USART2, USART3};
use wsg_bridge_fw::Format;
use wsg_bridge_fw::plc::Interrupts;

use crate::{Divider, chip};

/// A UART of the chip.
pub trait Uart {
    /// Its registers. An LPUART has a USART's layout except for two registers, which this crate does not use.
    const REGISTERS: Lpuart;
    /// The interrupt of the UART in the vector table.
    const INTERRUPT: Interrupt;

    /// Enables the clock of the UART.
    fn enable();
}

const fn lpuart(uart: Usart) -> Lpuart {
    // SAFETY: the address is that of a USART's registers.
    unsafe { Lpuart::from_ptr(uart.as_ptr()) }
}

/// Defines a type for each UART, with its registers and its clock enable bit.
macro_rules! uarts {
    ($($name:ident, $interrupt:ident, $registers:expr, $enable:ident, $set:ident;)+) => {$(
        #[doc = concat!(stringify!($interrupt), ".")]
        pub enum $name {}

        impl Uart for $name {
            const REGISTERS: Lpuart = $registers;
            const INTERRUPT: Interrupt = Interrupt::$interrupt;

            fn enable() {
                RCC.$enable().modify(|w| w.$set(true));
                let _ = RCC.$enable().read();
            }
        }
    )+};
}

uarts! {
    Lpuart1, LPUART1, LPUART1, apb1enr2, set_lpuart1en;
    Usart1, USART1, lpuart(USART1), apb2enr, set_usart1en;
    Usart2, USART2, lpuart(USART2), apb1enr1, set_usart2en;
    Usart3, USART3, lpuart(USART3), apb1enr1, set_usart3en;
    Uart4, UART4, lpuart(UART4), apb1enr1, set_uart4en;
}

/// Sets the rate and format of a disabled UART and enables it.
#[inline(never)]
pub(crate) fn set_up(uart: Lpuart, format: Format, divider: Divider, driver_time: u8) {
    chip::halve_clock(uart, divider.is_halved);
    uart.brr().write(|w| w.0 = divider.brr);
    uart.cr2().write(|w| {
        w.set_stop(if matches!(format, Format::None2) { Stop::STOP2 } else { Stop::STOP1 });
    });
    let with_parity = matches!(format, Format::Even1);
    uart.cr1().write(|w| {
        // The parity bit is the ninth bit.
        w.set_m0(if with_parity { M0::BIT9 } else { M0::BIT8 });
        w.set_pce(with_parity);
        w.set_ps(Ps::EVEN);
        // No effect without DE mode.
        w.set_deat(driver_time);
        w.set_dedt(driver_time);
        w.set_ue(true);
        w.set_re(true);
        w.set_te(true);
        w.set_rxneie(true);
    });
}

/// Unmasks an interrupt of a line.
pub(crate) fn unmask(interrupt: Interrupt) {
    // SAFETY: no critical section depends on this interrupt being masked. The handler shares only atomics with the rest of the
    // program.
    unsafe { NVIC::unmask(interrupt) };
}

pub(crate) fn is_damaged(status: Isr) -> bool {
    status.fe() || status.pe() || status.ne() || status.ore()
}

pub(crate) fn clear_errors(uart: Lpuart, status: Isr) {
    uart.icr().write(|w| {
        w.set_fe(status.fe());
        w.set_pe(status.pe());
        w.set_ne(status.ne());
        w.set_ore(status.ore());
    });
}

/// Enables the interrupts that the handler needs next.
#[inline(never)]
pub(crate) fn enable(uart: Lpuart, Interrupts { transmit_empty, transmission_complete }: Interrupts) {
    let control = uart.cr1().read();
    if control.txeie() != transmit_empty || control.tcie() != transmission_complete {
        uart.cr1().modify(|w| {
            w.set_txeie(transmit_empty);
            w.set_tcie(transmission_complete);
        });
    }
}
