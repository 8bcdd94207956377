//! The PLC's wires, the LED, the gripper's line, the buses and the service port on their pins (RM0351, chapter 8).

use stm32_metapac::gpio::Gpio;
use stm32_metapac::{GPIOA, GPIOB, GPIOC, GPIOD, RCC};
use wsg_bridge_fw::io::{InputPort, Inputs, OutputPort, Outputs};

use crate::{INDICATOR, INPUTS, OUTPUT_PINS, OUTPUT_PORT, Port, port_from_outputs};

/// Pins of the gripper's line, UART4, on port A: transmitter, receiver, and their function there.
const UART4_TX: u8 = 0;
const UART4_RX: u8 = 1;
const AF_UART4: u32 = 8;

/// Pins of the bus, LPUART1: receiver and transmitter on port C, driver enable on port B, and their function there.
const LPUART1_RX: u8 = 0;
const LPUART1_TX: u8 = 1;
const LPUART1_DE: u8 = 1;
const AF_LPUART1: u32 = 8;

/// Pins of the service port, USART1, on port B: transmitter, receiver, and their function there.
const USART1_PINS: [u8; 2] = [6, 7];
const AF_USART1: u32 = 7;

/// Pins of CAN1 on port B: receiver, transmitter, and their function there.
const CAN1_PINS: [u8; 2] = [8, 9];
const AF_CAN1: u32 = 9;

/// Values of a pin's field in MODER and PUPDR.
const MODE_INPUT: u32 = 0b00;
const MODE_OUTPUT: u32 = 0b01;
const MODE_ALTERNATE: u32 = 0b10;
const PULL_NONE: u32 = 0b00;
const PULL_UP: u32 = 0b01;
const PULL_DOWN: u32 = 0b10;

/// The PLC's wires. There is one value of it, made by [`init`].
pub struct Pins(());

/// Sets up all pins; outputs are low before they become outputs.
pub fn init() -> Pins {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_gpioden(true);
    });
    // A port takes writes two cycles after its clock is enabled; reading back takes that long.
    let _ = RCC.ahb2enr().read();

    let mut pins = Pins(());
    pins.write(Outputs::empty());
    for pin in (0..16).filter(|pin| OUTPUT_PINS & (1 << pin) != 0) {
        set_up(OUTPUT_PORT, pin, MODE_OUTPUT, PULL_NONE);
    }
    let (port, pin) = INDICATOR;
    set_up(port, pin, MODE_OUTPUT, PULL_NONE);
    for wire in &INPUTS {
        set_up(wire.port, wire.pin, MODE_INPUT, PULL_DOWN);
    }

    hand_over(Port::A, UART4_TX, AF_UART4, PULL_NONE);
    // A line idles high: without a transceiver the receiver hears silence, not noise.
    hand_over(Port::A, UART4_RX, AF_UART4, PULL_UP);
    hand_over(Port::C, LPUART1_TX, AF_LPUART1, PULL_UP);
    hand_over(Port::C, LPUART1_RX, AF_LPUART1, PULL_UP);
    // Low, which is no driver, also while nobody drives it.
    hand_over(Port::B, LPUART1_DE, AF_LPUART1, PULL_DOWN);
    for pin in USART1_PINS {
        hand_over(Port::B, pin, AF_USART1, PULL_UP);
    }
    for pin in CAN1_PINS {
        // Recessive is high.
        hand_over(Port::B, pin, AF_CAN1, PULL_UP);
    }
    pins
}

impl Pins {
    /// Lights the LED, or not.
    #[inline]
    pub fn indicate(&mut self, is_lit: bool) {
        let (port, pin) = INDICATOR;
        registers(port).bsrr().write(|w| w.0 = 1 << if is_lit { pin } else { pin + 16 });
    }
}

impl InputPort for Pins {
    #[inline]
    fn read(&mut self) -> Inputs {
        // Each port once, so that wires of one port are seen at the same moment.
        let [a, b, c, d] = [GPIOA, GPIOB, GPIOC, GPIOD].map(|port| port.idr().read().0);
        let levels = |port| match port {
            Port::A => a,
            Port::B => b,
            Port::C => c,
            Port::D => d,
        };
        INPUTS.iter().fold(Inputs::empty(), |high, wire| {
            if levels(wire.port) & (1 << wire.pin) != 0 { high | wire.signal } else { high }
        })
    }
}

impl OutputPort for Pins {
    #[inline]
    fn write(&mut self, outputs: Outputs) {
        let high = port_from_outputs(outputs);
        let low = OUTPUT_PINS & !high;
        registers(OUTPUT_PORT).bsrr().write(|w| w.0 = u32::from(low) << 16 | u32::from(high));
    }
}

/// Hands a pin over to a peripheral.
fn hand_over(port: Port, pin: u8, function: u32, pull: u32) {
    let field = 4 * (pin % 8);
    registers(port).afr(usize::from(pin >= 8)).modify(|w| w.0 = (w.0 & !(0xF << field)) | function << field);
    set_up(port, pin, MODE_ALTERNATE, pull);
}

fn set_up(port: Port, pin: u8, mode: u32, pull: u32) {
    let field = 2 * pin;
    let with = |register: u32, value: u32| (register & !(0b11 << field)) | value << field;
    registers(port).pupdr().modify(|w| w.0 = with(w.0, pull));
    registers(port).moder().modify(|w| w.0 = with(w.0, mode));
}

#[inline]
fn registers(port: Port) -> Gpio {
    match port {
        Port::A => GPIOA,
        Port::B => GPIOB,
        Port::C => GPIOC,
        Port::D => GPIOD,
    }
}
