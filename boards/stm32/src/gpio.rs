//! The PLC's wires, the LED and the pins of the lines (RM0351, chapter 8; RM0440, GPIO).

use core::marker::PhantomData;

use stm32_metapac::gpio::Gpio;
use stm32_metapac::{GPIOA, GPIOB, GPIOC, GPIOD, RCC};
use wsg_bridge_fw::io::{InputPort, Inputs, OutputPort, Outputs};

use crate::board::Stm32Board;
use crate::{LinePin, Port, Pull, output_pins, port_from_outputs};

/// Values of a pin's MODER field.
const MODE_INPUT: u32 = 0b00;
const MODE_OUTPUT: u32 = 0b01;
const MODE_ALTERNATE: u32 = 0b10;

/// The PLC's wires. [`init`] creates the only value.
pub struct Pins<B>(PhantomData<B>);

impl<B: Stm32Board> Pins<B> {
    const OUTPUT_PINS: u16 = output_pins(&B::OUTPUTS);
}

/// The LED. [`init`] creates the only value.
pub struct Led<B>(PhantomData<B>);

impl<B: Stm32Board> Led<B> {
    /// Switches the LED on or off.
    #[inline]
    pub fn indicate(&mut self, is_lit: bool) {
        let (port, pin) = B::INDICATOR;
        registers(port).bsrr().write(|w| w.0 = 1 << if is_lit { pin } else { pin + 16 });
    }
}

/// Configures all pins. The output levels are set to low before the pins become outputs.
#[must_use]
pub fn init<B: Stm32Board>() -> (Pins<B>, Led<B>) {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
        w.set_gpiocen(true);
        w.set_gpioden(true);
    });
    // A port accepts writes two cycles after its clock is enabled; the read-back takes that long.
    let _ = RCC.ahb2enr().read();

    let mut pins = Pins::<B>(PhantomData);
    pins.write(Outputs::empty());
    for pin in (0..16).filter(|pin| Pins::<B>::OUTPUT_PINS & (1 << pin) != 0) {
        set_up(B::OUTPUT_PORT, pin, MODE_OUTPUT, Pull::None);
    }
    let (port, pin) = B::INDICATOR;
    set_up(port, pin, MODE_OUTPUT, Pull::None);
    for wire in &B::INPUTS {
        set_up(wire.port, wire.pin, MODE_INPUT, Pull::Down);
    }
    for LinePin { port, pin, function, pull } in B::LINES {
        let field = 4 * (pin % 8);
        let function = u32::from(*function) << field;
        let register = registers(*port).afr(usize::from(*pin >= 8));
        register.modify(|w| w.0 = (w.0 & !(0xF << field)) | function);
        set_up(*port, *pin, MODE_ALTERNATE, *pull);
    }
    (pins, Led(PhantomData))
}

impl<B: Stm32Board> InputPort for Pins<B> {
    #[inline]
    fn read(&mut self) -> Inputs {
        // Read each port once, so that all wires of a port are sampled simultaneously.
        let [a, b, c, d] = [GPIOA, GPIOB, GPIOC, GPIOD].map(|port| port.idr().read().0);
        let levels = |port| match port {
            Port::A => a,
            Port::B => b,
            Port::C => c,
            Port::D => d,
        };
        B::INPUTS.iter().fold(Inputs::empty(), |high, wire| {
            if levels(wire.port) & (1 << wire.pin) != 0 { high | wire.signal } else { high }
        })
    }
}

impl<B: Stm32Board> OutputPort for Pins<B> {
    #[inline]
    fn write(&mut self, outputs: Outputs) {
        let high = port_from_outputs(&B::OUTPUTS, outputs);
        let low = Self::OUTPUT_PINS & !high;
        registers(B::OUTPUT_PORT).bsrr().write(|w| w.0 = u32::from(low) << 16 | u32::from(high));
    }
}

fn set_up(port: Port, pin: u8, mode: u32, pull: Pull) {
    let field = 2 * pin;
    let with = |register: u32, value: u32| (register & !(0b11 << field)) | value << field;
    registers(port).pupdr().modify(|w| w.0 = with(w.0, pull as u32));
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
