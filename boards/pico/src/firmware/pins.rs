//! The PLC's wires, the LED, both lines and the MCP2515 on their pins, with `embedded-hal`'s traits.

use embedded_hal::digital::OutputPin;
use rp2040_hal::Sio;
use rp2040_hal::gpio::bank0::Gpio25;
use rp2040_hal::gpio::{
    DynPinId, FunctionSioInput, FunctionSioOutput, FunctionSpi, FunctionUart, Pin, PinState, Pins, PullDown,
    PullNone, PullUp,
};
use rp2040_hal::pac::Peripherals;
use wsg_bridge_fw::io::{HalInputs, HalOutputs};

pub(crate) type Wires = (
    HalInputs<Pin<DynPinId, FunctionSioInput, PullDown>>,
    HalOutputs<Pin<DynPinId, FunctionSioOutput, PullNone>>,
);

/// The LED on the board.
pub(crate) struct Led(Pin<Gpio25, FunctionSioOutput, PullNone>);

impl Led {
    /// Switches the LED on or off.
    pub(crate) fn indicate(&mut self, is_lit: bool) {
        let _ = self.0.set_state(is_lit.into());
    }
}

/// Configures all pins. The output levels are set to low before the pins become outputs.
pub(crate) fn init(peripherals: Peripherals) -> (Wires, Led) {
    let mut resets = peripherals.RESETS;
    let sio = Sio::new(peripherals.SIO);
    let pins = Pins::new(peripherals.IO_BANK0, peripherals.PADS_BANK0, sio.gpio_bank0, &mut resets);

    macro_rules! low {
        ($pin:ident) => {
            pins.$pin.into_pull_type::<PullNone>().into_push_pull_output_in_state(PinState::Low)
        };
    }
    macro_rules! input {
        ($pin:ident) => {
            pins.$pin.into_pull_down_input().into_dyn_pin()
        };
    }
    // In the order of `OUTPUTS` and `INPUTS` of the pin table. The emulator's tests compare both.
    let outputs = [
        low!(gpio2).into_dyn_pin(),
        low!(gpio3).into_dyn_pin(),
        low!(gpio15).into_dyn_pin(),
        low!(gpio21).into_dyn_pin(),
        low!(gpio22).into_dyn_pin(),
        low!(gpio26).into_dyn_pin(),
        low!(gpio27).into_dyn_pin(),
    ];
    let inputs = [
        input!(gpio7),
        input!(gpio8),
        input!(gpio9),
        input!(gpio10),
        input!(gpio11),
        input!(gpio12),
        input!(gpio13),
        input!(gpio14),
    ];

    let _: Pin<_, FunctionUart, PullNone> = pins.gpio0.reconfigure();
    // Pull-up, because a line idles high: an open receiver input reads as idle.
    let _: Pin<_, FunctionUart, PullUp> = pins.gpio1.reconfigure();
    let _: Pin<_, FunctionUart, PullUp> = pins.gpio4.reconfigure();
    let _: Pin<_, FunctionUart, PullUp> = pins.gpio5.reconfigure();
    // The bus's driver is off. The handler switches it by the registers of SIO.
    let _: Pin<_, FunctionSioOutput, PullDown> =
        pins.gpio6.into_pull_type::<PullDown>().into_push_pull_output_in_state(PinState::Low);

    let _: Pin<_, FunctionSpi, PullUp> = pins.gpio16.reconfigure();
    let _: Pin<_, FunctionSpi, PullNone> = pins.gpio18.reconfigure();
    let _: Pin<_, FunctionSpi, PullNone> = pins.gpio19.reconfigure();
    // INT of the MCP2515 is active low; without an MCP2515 the pin is high.
    let _: Pin<_, FunctionSioInput, PullUp> = pins.gpio20.reconfigure();
    // Chip select of the MCP2515. The driver switches it by the registers of SIO.
    let _: Pin<_, FunctionSioOutput, PullUp> =
        pins.gpio17.into_pull_type::<PullUp>().into_push_pull_output_in_state(PinState::High);

    ((HalInputs::new(inputs), HalOutputs::new(outputs)), Led(low!(gpio25)))
}
