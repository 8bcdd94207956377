//! Wires between PLC and bridge, and the interface to a board's pins.
//!
//! The bridge defines debouncing and meaning of the wires, the board's crate their pins.

use bitflags::bitflags;
use embedded_hal::digital::{InputPin, OutputPin};

bitflags! {
    /// Levels of the eight wires from the PLC, before debouncing. A set bit is a high wire.
    ///
    /// Every input is pulled down, so a broken or unpowered wire reads 0. The safe level of each bit is 0, which at most
    /// requests a FAST STOP.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Inputs: u8 {
        /// Rising edge: grip a part with the selected recipe.
        const GRIP = 1 << 0;
        /// Rising edge: release the part to the release width of the selected recipe.
        const RELEASE = 1 << 1;
        /// Rising edge: move the fingers to the width of the selected recipe (Pre-position).
        const MOVE = 1 << 2;
        /// Rising edge: home the fingers.
        const HOME = 1 << 3;
        /// Rising edge: stop a running motion, or acknowledge a FAST STOP or error.
        const STOP_ACK = 1 << 4;
        /// High: no FAST STOP. Low, which includes a broken wire, stops the gripper.
        const FAST_STOP_OK = 1 << 5;
        /// Bit 0 of the recipe number.
        const RECIPE0 = 1 << 6;
        /// Bit 1 of the recipe number.
        const RECIPE1 = 1 << 7;
    }
}

bitflags! {
    /// Levels of the seven wires to the PLC. A set bit is a high wire.
    ///
    /// A bridge without power or firmware shows the empty set: not ready, no link.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Outputs: u8 {
        /// The gripper accepts a motion command.
        const READY = 1 << 0;
        /// A motion command is in progress.
        const BUSY = 1 << 1;
        /// A part is held with the set force.
        const HOLDING = 1 << 2;
        /// No part was found, or the held part was lost.
        const PART_FAULT = 1 << 3;
        /// A command was refused or failed, or a FAST STOP has not been acknowledged.
        const ERROR = 1 << 4;
        /// The fingers have been homed.
        const REFERENCED = 1 << 5;
        /// The gripper answers on its line.
        const LINK_OK = 1 << 6;
    }
}

impl Inputs {
    /// Number of input wires.
    pub const COUNT: usize = 8;
}

impl Outputs {
    /// Number of output wires.
    pub const COUNT: usize = 7;
}

const _: () = assert!(Inputs::all().bits().count_ones() as usize == Inputs::COUNT);
const _: () = assert!(Outputs::all().bits().count_ones() as usize == Outputs::COUNT);

/// Input wires of a board.
pub trait InputPort {
    /// Returns the current levels. A wire that cannot be read counts as low.
    fn read(&mut self) -> Inputs;
}

/// Output wires of a board.
pub trait OutputPort {
    /// Drives all wires to these levels.
    ///
    /// Outputs change together. If the hardware cannot do that, the PLC may read intermediate states, which claim no more
    /// than the state before or after: see [`HalOutputs`] for the order.
    fn write(&mut self, outputs: Outputs);
}

/// Inputs and outputs of different ports.
impl<I: InputPort, O> InputPort for (I, O) {
    fn read(&mut self) -> Inputs {
        self.0.read()
    }
}

impl<I, O: OutputPort> OutputPort for (I, O) {
    fn write(&mut self, outputs: Outputs) {
        self.1.write(outputs);
    }
}

/// [`InputPort`] over eight pins of any HAL, for a board whose inputs share no port.
#[derive(Debug)]
pub struct HalInputs<P> {
    pins: [P; Inputs::COUNT],
}

impl<P: InputPin> HalInputs<P> {
    /// Creates the port. `pins` are inputs with pull-down, in the order of the bits of [`Inputs`].
    pub const fn new(pins: [P; Inputs::COUNT]) -> Self {
        Self { pins }
    }
}

impl<P: InputPin> InputPort for HalInputs<P> {
    fn read(&mut self) -> Inputs {
        Inputs::from_bits_retain(self.pins.iter_mut().enumerate().fold(0, |levels, (bit, pin)| {
            let high = pin.is_high().unwrap_or(false);
            levels | (u8::from(high) << bit)
        }))
    }
}

/// [`OutputPort`] over seven pins of any HAL, for a board whose outputs share no port.
///
/// The pins change one after the other, so a PLC may sample intermediate states. Outputs that become cautious change first,
/// then outputs that become confident. BUSY, ERROR and PART_FAULT are cautious while high, the others while low. So each
/// intermediate state
/// - is in every wire at least as cautious as the state before or the state after: it shows no READY, HOLDING, REFERENCED or
///   LINK_OK that both lack, and hides no ERROR or PART_FAULT that both have;
/// - shows BUSY high if BUSY changes, so that a PLC that waits for BUSY low then reads the matching outputs;
/// - has ERROR high while LINK_OK is low, as both ends have it.
#[derive(Debug)]
pub struct HalOutputs<P> {
    pins: [P; Outputs::COUNT],
}

impl<P: OutputPin> HalOutputs<P> {
    /// Order in which outputs become cautious. They become confident in reverse order.
    const ORDER: [Outputs; Outputs::COUNT] = [
        Outputs::BUSY,
        Outputs::ERROR,
        Outputs::PART_FAULT,
        Outputs::READY,
        Outputs::HOLDING,
        Outputs::REFERENCED,
        Outputs::LINK_OK,
    ];

    /// Outputs that are cautious while high.
    const CAUTIOUS_HIGH: Outputs = Outputs::BUSY.union(Outputs::ERROR).union(Outputs::PART_FAULT);

    /// Creates the port. `pins` are outputs, in the order of the bits of [`Outputs`].
    pub const fn new(pins: [P; Outputs::COUNT]) -> Self {
        Self { pins }
    }

    fn drive(&mut self, output: Outputs, is_high: bool) {
        let Some(pin) = self.pins.get_mut(output.bits().trailing_zeros() as usize) else { return };
        // An error is ignored, because the main loop writes again in its next turn.
        let _ = if is_high { pin.set_high() } else { pin.set_low() };
    }
}

impl<P: OutputPin> OutputPort for HalOutputs<P> {
    fn write(&mut self, outputs: Outputs) {
        let cautious = !(outputs ^ Self::CAUTIOUS_HIGH);
        for output in Self::ORDER.into_iter().filter(|output| cautious.contains(*output)) {
            self.drive(output, outputs.contains(output));
        }
        for output in Self::ORDER.into_iter().rev().filter(|output| !cautious.contains(*output)) {
            self.drive(output, outputs.contains(output));
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::cell::RefCell;
    use core::convert::Infallible;
    use embedded_hal::digital::{Error, ErrorKind, ErrorType};
    use std::vec::Vec;

    use super::*;

    /// A wire with a fixed level, or an unreadable one.
    struct Wire(Result<bool, ErrorKind>);

    #[derive(Debug)]
    struct Unreadable(ErrorKind);

    impl Error for Unreadable {
        fn kind(&self) -> ErrorKind {
            self.0
        }
    }

    impl ErrorType for Wire {
        type Error = Unreadable;
    }

    impl InputPin for Wire {
        fn is_high(&mut self) -> Result<bool, Unreadable> {
            self.0.map_err(Unreadable)
        }

        fn is_low(&mut self) -> Result<bool, Unreadable> {
            self.0.map(|high| !high).map_err(Unreadable)
        }
    }

    /// A pin that records the state of all pins after each of its changes.
    struct NotingPin<'a> {
        bit: usize,
        port: &'a RefCell<Vec<Outputs>>,
    }

    impl NotingPin<'_> {
        fn set(&self, high: bool) {
            let mut shown = self.port.borrow_mut();
            let mut outputs = *shown.last().unwrap();
            outputs.set(Outputs::from_bits_retain(1 << self.bit), high);
            shown.push(outputs);
        }
    }

    impl ErrorType for NotingPin<'_> {
        type Error = Infallible;
    }

    impl OutputPin for NotingPin<'_> {
        fn set_low(&mut self) -> Result<(), Infallible> {
            self.set(false);
            Ok(())
        }

        fn set_high(&mut self) -> Result<(), Infallible> {
            self.set(true);
            Ok(())
        }
    }

    #[test]
    fn each_pin_is_read_into_its_own_bit() {
        for wire in Inputs::all().iter() {
            let mut port = HalInputs::new(core::array::from_fn(|bit| Wire(Ok(wire.bits() == 1 << bit))));
            assert_eq!(port.read(), wire);
        }
    }

    #[test]
    fn unreadable_pin_counts_as_low() {
        let mut port = HalInputs::new(core::array::from_fn(|bit| {
            Wire(if bit == 5 { Err(ErrorKind::Other) } else { Ok(true) })
        }));
        assert_eq!(port.read(), !Inputs::FAST_STOP_OK);
    }

    /// Returns all states that the outputs show during a change, including both ends.
    fn shown(before: Outputs, after: Outputs) -> Vec<Outputs> {
        let shown = RefCell::new(std::vec![before]);
        let mut port = HalOutputs::new(core::array::from_fn(|bit| NotingPin { bit, port: &shown }));
        port.write(after);
        assert_eq!(shown.borrow().last(), Some(&after));
        shown.into_inner()
    }

    /// Calls `check` with the shown states of each change from one state to another. Miri, which is slow, checks a sample.
    fn for_each_change(check: impl Fn(&[Outputs], [Outputs; 2])) {
        let step = if cfg!(miri) { 17 } else { 1 };
        let states = || (0..=Outputs::all().bits()).step_by(step).map(Outputs::from_bits_retain);
        for before in states() {
            states().for_each(|after| check(&shown(before, after), [before, after]));
        }
    }

    #[test]
    fn no_intermediate_state_claims_more_than_both_ends() {
        let warnings = Outputs::BUSY | Outputs::ERROR | Outputs::PART_FAULT;
        for_each_change(|shown, ends| {
            for &seen in shown {
                let claims_no_more = |end: Outputs| {
                    (end - warnings).contains(seen - warnings) && (seen & warnings).contains(end & warnings)
                };
                assert!(ends.into_iter().any(claims_no_more), "{seen:?} between {ends:?}");
            }
        });
    }

    #[test]
    fn busy_is_low_only_together_with_the_matching_outputs() {
        for_each_change(|shown, ends| {
            let [was_busy, is_busy] = ends.map(|end| end.contains(Outputs::BUSY));
            for &seen in shown.iter().filter(|seen| was_busy != is_busy && !seen.contains(Outputs::BUSY)) {
                assert_eq!(seen, ends[usize::from(was_busy)], "between {ends:?}");
            }
        });
    }

    #[test]
    fn error_is_high_without_link_ok_in_intermediate_states() {
        let is_reported = |state: &Outputs| state.intersects(Outputs::LINK_OK | Outputs::ERROR);
        for_each_change(|shown, ends| {
            assert!(shown.iter().all(is_reported) || !ends.iter().all(is_reported), "{shown:?}");
        });
    }

    #[test]
    fn each_output_changes_at_most_once() {
        for_each_change(|shown, [before, after]| {
            let changes = shown.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert_eq!(changes, (before ^ after).bits().count_ones() as usize, "{shown:?}");
        });
    }
}
