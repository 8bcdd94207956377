//! What the firmware drives on its output port, from the writes QEMU traces.
//!
//! Why not intercept the port's pins through qtest: that reports each pin on its own, so a write
//! that changes three of them looks like three changes, and two writes in a row like one or two as
//! the host's scheduler likes. A trace line is one write, so the states here are exactly those the
//! chip showed, in their order.

use std::str::SplitWhitespace;

use wsg_b_l475e_iot01a::{OUTPUT_PINS, OUTPUT_PORT, OUTPUTS};
use wsg_bridge_fw::io::Outputs;

/// QEMU's trace event for a write to a GPIO port.
pub(super) const TRACE_EVENT: &str = "stm32l4x5_gpio_write";

/// The registers of the output port that decide what it drives (RM0351, 8.4).
#[derive(Debug)]
pub(super) struct OutputPort {
    moder: u32,
    odr: u32,
    is_served: bool,
}

impl Default for OutputPort {
    /// The port after reset: pins A13 to A15 belong to the debug port, all others are analog.
    fn default() -> Self {
        Self { moder: 0xABFF_FFFF, odr: 0, is_served: false }
    }
}

impl OutputPort {
    /// Follows a line of QEMU's trace; false where it is none.
    pub(super) fn follow(&mut self, line: &str) -> bool {
        let mut words = line.split_whitespace();
        if words.next() != Some(TRACE_EVENT) {
            return false;
        }
        let port = words.next().and_then(|name| name.strip_prefix("GPIO"));
        if port.is_some_and(|letter| letter.chars().eq([OUTPUT_PORT.letter()]))
            && let Some((offset, value)) = labelled(&mut words, "addr:").zip(labelled(&mut words, "val:"))
        {
            self.write(offset, value);
        }
        true
    }

    fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x00 => self.moder = value,
            0x14 => self.show(value),
            // BSRR: where a pin is both set and reset, set wins.
            0x18 => self.show((self.odr & !(value >> 16)) | value),
            0x28 => self.show(self.odr & !value),
            _ => {}
        }
    }

    fn show(&mut self, levels: u32) {
        self.odr = levels & 0xFFFF;
        self.is_served |= self.driven() & OUTPUT_PINS == OUTPUT_PINS;
    }

    /// Levels of the wires to the PLC. One that is not driven is low: each has a pull-down.
    pub(super) fn outputs(&self) -> Outputs {
        wsg_stm32::outputs_from_port(&OUTPUTS, self.driven() & self.odr as u16)
    }

    /// Whether the firmware has shown anything on wires that it drives, which its main loop does first.
    pub(super) fn is_served(&self) -> bool {
        self.is_served
    }

    fn driven(&self) -> u16 {
        (0..16).filter(|pin| (self.moder >> (2 * pin)) & 0b11 == 0b01).fold(0, |pins, pin| pins | 1 << pin)
    }
}

/// The hexadecimal number behind `label`.
fn labelled(words: &mut SplitWhitespace<'_>, label: &str) -> Option<u32> {
    words.find(|&word| word == label)?;
    u32::from_str_radix(words.next()?.strip_prefix("0x")?, 16).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// MODER with every output pin an output.
    const IN_CHARGE: &str = "stm32l4x5_gpio_write GPIOA addr: 0x0 val: 0x6bff555a\n";

    fn after(lines: &[&str]) -> OutputPort {
        let mut port = OutputPort::default();
        for line in lines {
            assert!(port.follow(line), "{line}");
        }
        port
    }

    #[test]
    fn a_level_shows_once_its_pin_is_an_output() {
        let set_all = "stm32l4x5_gpio_write GPIOA addr: 0x18 val: 0x80fc";
        assert_eq!(after(&[set_all]).outputs(), Outputs::empty());
        assert_eq!(after(&[set_all, IN_CHARGE]).outputs(), Outputs::all());
    }

    #[test]
    fn the_port_is_served_from_the_first_levels_on_driven_pins_on() {
        let clear_all = "stm32l4x5_gpio_write GPIOA addr: 0x18 val: 0x80fc0000";
        assert!(!after(&[clear_all, IN_CHARGE]).is_served());
        assert!(after(&[clear_all, IN_CHARGE, clear_all]).is_served());
    }
}
