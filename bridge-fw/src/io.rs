//! The wires between PLC and bridge: which there are, and how a board hands them over.
//!
//! Not here: what a wire does (debouncing and meaning are the bridge's) and where it is on a board (its own crate says).

use bitflags::bitflags;
use embedded_hal::digital::{InputPin, OutputPin};

bitflags! {
    /// Levels of the eight wires from the PLC, as read, not debounced. A set bit is a high wire.
    ///
    /// Every input is pulled down, so a broken or unpowered wire reads 0, and 0 asks for nothing
    /// but a FAST STOP: the safe level of each bit is 0.
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
        /// High while no FAST STOP is wanted; low, also by a broken wire, stops the gripper.
        const FAST_STOP_OK = 1 << 5;
        /// Number of the recipe, bit 0.
        const RECIPE0 = 1 << 6;
        /// Number of the recipe, bit 1.
        const RECIPE1 = 1 << 7;
    }
}

bitflags! {
    /// Levels of the seven wires to the PLC. A set bit is a high wire.
    ///
    /// The empty set is what a bridge without power or firmware shows: not ready, no link.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Outputs: u8 {
        /// The gripper accepts a motion command.
        const READY = 1 << 0;
        /// A motion command is being carried out.
        const BUSY = 1 << 1;
        /// A part is held with the wanted force.
        const HOLDING = 1 << 2;
        /// No part was found, or the held part was lost.
        const PART_FAULT = 1 << 3;
        /// A command was refused or failed, or a FAST STOP waits to be acknowledged.
        const ERROR = 1 << 4;
        /// The fingers have been homed.
        const REFERENCED = 1 << 5;
        /// The gripper answers on its line.
        const LINK_OK = 1 << 6;
    }
}

impl Inputs {
    /// How many input wires there are.
    pub const COUNT: usize = 8;
}

impl Outputs {
    /// How many output wires there are.
    pub const COUNT: usize = 7;
}

const _: () = assert!(Inputs::all().bits().count_ones() as usize == Inputs::COUNT);
const _: () = assert!(Outputs::all().bits().count_ones() as usize == Outputs::COUNT);

/// Where a bridge reads the PLC's wires.
pub trait InputPort {
    /// The levels at this moment. A wire whose level cannot be read counts as low.
    fn read(&mut self) -> Inputs;
}

/// Where a bridge drives the wires to the PLC.
pub trait OutputPort {
    /// Drives all wires to these levels.
    ///
    /// Outputs change together. Where the hardware cannot do that, the PLC may see states in between, none of which claims more
    /// than the one before or the one after: [`HalOutputs`] has the order.
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
    /// `pins` in the order of the bits of [`Inputs`], set up as inputs with pull-down.
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
/// The pins change one after the other, in an order in which a PLC may sample any state in between: first those that become
/// cautious, then those that become confident. BUSY, ERROR and PART_FAULT are cautious while they are high, the others while they
/// are low. So each state in between
/// - is at least as cautious as the one before or the one after it in every wire: no READY, HOLDING, REFERENCED or LINK_OK that both
///   lack, and no ERROR or PART_FAULT hidden that both have;
/// - shows BUSY, if that changes, together with whatever else is changing: a PLC that waits until BUSY is low, and then reads the others,
///   reads those that belong to it;
/// - has ERROR high while LINK_OK is low, as both ends have it.
#[derive(Debug)]
pub struct HalOutputs<P> {
    pins: [P; Outputs::COUNT],
}

impl<P: OutputPin> HalOutputs<P> {
    /// The order in which outputs become cautious. They become confident in the reverse order.
    const ORDER: [Outputs; Outputs::COUNT] = [
        Outputs::BUSY,
        Outputs::ERROR,
        Outputs::PART_FAULT,
        Outputs::READY,
        Outputs::HOLDING,
        Outputs::REFERENCED,
        Outputs::LINK_OK,
    ];

    /// Outputs that are cautious while they are high.
    const CAUTIOUS_HIGH: Outputs = Outputs::BUSY.union(Outputs::ERROR).union(Outputs::PART_FAULT);

    /// `pins` in the order of the bits of [`Outputs`], set up as outputs.
    pub const fn new(pins: [P; Outputs::COUNT]) -> Self {
        Self { pins }
    }

    fn drive(&mut self, output: Outputs, is_high: bool) {
        let Some(pin) = self.pins.get_mut(output.bits().trailing_zeros() as usize) else { return };
        // A pin that refuses has no better place to report to: the main loop writes again in its
        // next turn.
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

    /// A wire with a fixed level, or one that cannot be read.
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

    /// A pin that notes what all pins show after each of its changes.
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
    fn a_pin_that_cannot_be_read_counts_as_low() {
        let mut port = HalInputs::new(core::array::from_fn(|bit| {
            Wire(if bit == 5 { Err(ErrorKind::Other) } else { Ok(true) })
        }));
        assert_eq!(port.read(), !Inputs::FAST_STOP_OK);
    }

    /// Every state that the outputs show while they change, from the first to the last.
    fn shown(before: Outputs, after: Outputs) -> Vec<Outputs> {
        let shown = RefCell::new(std::vec![before]);
        let mut port = HalOutputs::new(core::array::from_fn(|bit| NotingPin { bit, port: &shown }));
        port.write(after);
        assert_eq!(shown.borrow().last(), Some(&after));
        shown.into_inner()
    }

    /// Calls it with what is shown during each change from one state to another.
    fn for_each_change(check: impl Fn(&[Outputs], [Outputs; 2])) {
        let states = || (0..=Outputs::all().bits()).map(Outputs::from_bits_retain);
        for before in states() {
            states().for_each(|after| check(&shown(before, after), [before, after]));
        }
    }

    #[test]
    fn no_state_in_between_claims_more_than_the_one_before_or_the_one_after() {
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
    fn busy_is_low_together_with_what_belongs_to_it_alone() {
        for_each_change(|shown, ends| {
            let [was_busy, is_busy] = ends.map(|end| end.contains(Outputs::BUSY));
            for &seen in shown.iter().filter(|seen| was_busy != is_busy && !seen.contains(Outputs::BUSY)) {
                assert_eq!(seen, ends[usize::from(was_busy)], "between {ends:?}");
            }
        });
    }

    #[test]
    fn error_is_high_without_link_ok_in_between_too() {
        let is_told = |state: &Outputs| state.intersects(Outputs::LINK_OK | Outputs::ERROR);
        for_each_change(|shown, ends| {
            assert!(shown.iter().all(is_told) || !ends.iter().all(is_told), "{shown:?}");
        });
    }

    #[test]
    fn each_output_changes_once_at_the_most() {
        for_each_change(|shown, [before, after]| {
            let changes = shown.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert_eq!(changes, (before ^ after).bits().count_ones() as usize, "{shown:?}");
        });
    }
}
