//! A CAN controller: frames, error counters, withdrawal, bus-off.

use embedded_can::{ErrorKind, Frame, Id};

/// State of a controller's fault confinement (ISO 11898-1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Bus-off: the controller no longer takes part in the bus.
    pub is_off: bool,
    /// Error passive: one of its counters is above 127.
    pub is_passive: bool,
    /// Transmit error counter, saturating at 255.
    pub transmit_errors: u8,
    /// Receive error counter (REC) of the controller.
    pub receive_errors: u8,
}

/// The outcome of [`CanController::withdraw`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Withdrawal {
    /// The frame is being sent, and may still fail. Withdraw it again in the next turn.
    Undecided,
    /// The frame was not sent and never will be.
    Withdrawn,
    /// The frame was sent, or there was none.
    TooLate,
}

impl Withdrawal {
    /// Returns the outcome from the state of a mailbox after the request: whether it is still occupied, and whether its last
    /// frame was sent.
    #[must_use]
    pub const fn of(is_occupied: bool, was_sent: bool) -> Self {
        match (is_occupied, was_sent) {
            (true, _) => Self::Undecided,
            (false, false) => Self::Withdrawn,
            (false, true) => Self::TooLate,
        }
    }
}

/// A CAN controller that stays bus-off until [`recover`](Self::recover).
///
/// `embedded_can::nb::Can` transfers the frames. The controller holds at most one frame with a given identifier, so frames
/// with the same identifier are sent in order. A frame that replaces another one returns it, as the trait defines.
pub trait CanController: embedded_can::nb::Can<Frame: Clone> {
    /// Returns the current state of fault confinement.
    fn health(&mut self) -> Health;

    /// Withdraws an accepted but unsent frame with this identifier. Other frames stay, but may have to wait for the decision.
    /// Does not wait.
    ///
    /// No controller stops a frame that is being sent. It completes the frame, but does not repeat it after a failure. Until
    /// then the withdrawal is [`Undecided`](Withdrawal::Undecided), and the caller repeats it once per turn.
    fn withdraw(&mut self, id: Id) -> Withdrawal;

    /// Discards all accepted but unsent frames, and an undecided withdrawal.
    fn abort(&mut self);

    /// Starts the recovery from bus-off, which takes 128 times 11 recessive bits. Does not wait for it.
    fn recover(&mut self);
}

/// No controller, for a board without CAN. It behaves like one that is bus-off.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoCan;

/// Frame type of [`NoCan`]. It has no values.
#[derive(Clone, Copy, Debug)]
pub enum NoFrame {}

impl Frame for NoFrame {
    fn new(_: impl Into<Id>, _: &[u8]) -> Option<Self> {
        None
    }

    fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        match *self {}
    }

    fn is_remote_frame(&self) -> bool {
        match *self {}
    }

    fn id(&self) -> Id {
        match *self {}
    }

    fn dlc(&self) -> usize {
        match *self {}
    }

    fn data(&self) -> &[u8] {
        match *self {}
    }
}

impl embedded_can::nb::Can for NoCan {
    type Frame = NoFrame;
    type Error = ErrorKind;

    fn transmit(&mut self, frame: &NoFrame) -> nb::Result<Option<NoFrame>, ErrorKind> {
        match *frame {}
    }

    fn receive(&mut self) -> nb::Result<NoFrame, ErrorKind> {
        Err(nb::Error::WouldBlock)
    }
}

impl CanController for NoCan {
    fn health(&mut self) -> Health {
        Health { is_off: true, ..Health::default() }
    }

    fn withdraw(&mut self, _: Id) -> Withdrawal {
        Withdrawal::TooLate
    }

    fn abort(&mut self) {}

    fn recover(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn board_without_can_is_bus_off() {
        assert!(NoCan.health().is_off);
    }
}
