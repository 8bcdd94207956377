//! The PLC's wires, the LED, the gripper's line, the buses and the service port on their pins (RM0440, GPIO).

use stm32_metapac::gpio::Gpio;
use stm32_metapac::{GPIOA, GPIOB, GPIOC, RCC};
use wsg_bridge_fw::io::{InputPort, Inputs, OutputPort, Outputs};
use wsg_nucleo_g474re::{INDICATOR, INPUTS, OUTPUT_PINS, OUTPUT_PORT, Port, port_from_outputs};

/// The function of the USARTs on their pins, and that of FDCAN1 (data sheet DS12288, alternate functions).
const AF_USART: u32 = 7;
const AF_FDCAN1: u32 = 9;

/// The pins of the lines, and what they are pulled to while nobody drives them. A line idles high: without a transceiver the receiver
/// hears silence, not noise; and recessive is high. Low, which is no driver, is the bus's driver enable.
const LINES: [(Port, u8, u32, u32); 9] = [
    // The gripper's, USART1: transmitter, receiver.
    (Port::C, 4, AF_USART, PULL_NONE),
    (Port::C, 5, AF_USART, PULL_UP),
    // The bus's, USART3: transmitter, receiver, driver enable.
    (Port::B, 10, AF_USART, PULL_UP),
    (Port::B, 11, AF_USART, PULL_UP),
    (Port::B, 14, AF_USART, PULL_DOWN),
    // The service port's, USART2: transmitter, receiver.
    (Port::A, 2, AF_USART, PULL_UP),
    (Port::A, 3, AF_USART, PULL_UP),
    // CAN's, FDCAN1: receiver, transmitter.
    (Port::A, 11, AF_FDCAN1, PULL_UP),
    (Port::A, 12, AF_FDCAN1, PULL_UP),
];

/// Values of a pin's field in MODER and PUPDR.
const MODE_INPUT: u32 = 0b00;
const MODE_OUTPUT: u32 = 0b01;
const MODE_ALTERNATE: u32 = 0b10;
const PULL_NONE: u32 = 0b00;
const PULL_UP: u32 = 0b01;
const PULL_DOWN: u32 = 0b10;

/// The PLC's wires. There is one value of it, made by [`init`].
pub(crate) struct Pins(());

/// Sets up all pins; outputs are low before they become outputs.
pub(crate) fn init() -> Pins {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
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
    for (port, pin, function, pull) in LINES {
        hand_over(port, pin, function, pull);
    }
    pins
}

impl Pins {
    /// Lights the LED, or not.
    #[inline]
    pub(crate) fn indicate(&mut self, is_lit: bool) {
        let (port, pin) = INDICATOR;
        registers(port).bsrr().write(|w| w.0 = 1 << if is_lit { pin } else { pin + 16 });
    }
}

impl InputPort for Pins {
    #[inline]
    fn read(&mut self) -> Inputs {
        // Each port once, so that wires of one port are seen at the same moment.
        let [a, b, c] = [GPIOA, GPIOB, GPIOC].map(|port| port.idr().read().0);
        let levels = |port| match port {
            Port::A => a,
            Port::B => b,
            Port::C => c,
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
    }
}
