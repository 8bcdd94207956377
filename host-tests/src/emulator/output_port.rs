//! Levels of the firmware's output port, derived from the writes that QEMU traces.
//!
//! Intercepting pins through qtest reports each pin separately: one write to three pins looks like three changes, and
//! two successive writes may merge, depending on the host's scheduler. A trace line is one write, so it yields
//! exactly the states of the chip, in order.

use std::str::SplitWhitespace;

use wsg_bridge_fw::io::Outputs;
use wsg_stm32::{Port, output_pins, outputs_from_port};

use super::stm_board::StmBoard;

/// QEMU's trace event for a write to a GPIO port.
pub(super) const TRACE_EVENT: &str = "stm32l4x5_gpio_write";

/// Registers that determine the driven levels of the output port (RM0351, 8.4).
#[derive(Debug)]
pub(super) struct OutputPort {
    board: &'static StmBoard,
    moder: u32,
    odr: u32,
    is_served: bool,
}

impl OutputPort {
    /// Returns a board's port after reset: pins A13 to A15 belong to the debug port, all others are analog.
    pub(super) fn of(board: &'static StmBoard) -> Self {
        let moder = if board.output_port == Port::A { 0xABFF_FFFF } else { 0xFFFF_FFFF };
        Self { board, moder, odr: 0, is_served: false }
    }

    /// Processes a line of QEMU's output. Returns whether it belongs to the trace.
    pub(super) fn follow(&mut self, line: &str) -> bool {
        let mut words = line.split_whitespace();
        if words.next() != Some(TRACE_EVENT) {
            return false;
        }
        let port = words.next().and_then(|name| name.strip_prefix("GPIO"));
        if port.is_some_and(|letter| letter.chars().eq([self.board.output_port.letter()]))
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
            // BSRR: set wins over reset.
            0x18 => self.show((self.odr & !(value >> 16)) | value),
            0x28 => self.show(self.odr & !value),
            _ => {}
        }
    }

    fn show(&mut self, levels: u32) {
        self.odr = levels & 0xFFFF;
        let pins = output_pins(self.board.outputs);
        self.is_served |= self.driven() & pins == pins;
    }

    /// Returns the levels of the wires to the PLC. Undriven wires are low because of their pull-downs.
    pub(super) fn outputs(&self) -> Outputs {
        outputs_from_port(self.board.outputs, self.driven() & self.odr as u16)
    }

    /// Returns whether the firmware has written levels to driven wires, which is the main loop's first action.
    pub(super) fn is_served(&self) -> bool {
        self.is_served
    }

    fn driven(&self) -> u16 {
        (0..16).filter(|pin| (self.moder >> (2 * pin)) & 0b11 == 0b01).fold(0, |pins, pin| pins | 1 << pin)
    }
}

/// Returns the hexadecimal number after `label`.
fn labelled(words: &mut SplitWhitespace<'_>, label: &str) -> Option<u32> {
    words.find(|&word| word == label)?;
    u32::from_str_radix(words.next()?.strip_prefix("0x")?, 16).ok()
}

#[cfg(test)]
mod tests {
    use super::super::stm_board::B_L475E_IOT01A;
    use super::*;

    /// MODER with every output pin an output.
    const IN_CHARGE: &str = "stm32l4x5_gpio_write GPIOA addr: 0x0 val: 0x6bff555a\n";

    fn after(lines: &[&str]) -> OutputPort {
        let mut port = OutputPort::of(&B_L475E_IOT01A);
        for line in lines {
            assert!(port.follow(line), "{line}");
        }
        port
    }

    #[test]
    fn a_level_is_visible_once_its_pin_is_an_output() {
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
