//! A CAN controller: frames, error counters, withdrawal, bus-off.

use embedded_can::{ErrorKind, Frame, Id};

/// How a controller sees the bus (ISO 11898-1, fault confinement).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Bus-off: it takes no part in the bus any more.
    pub is_off: bool,
    /// Error passive: one of its counters is above 127.
    pub is_passive: bool,
    /// The transmit error counter; it stops at 255.
    pub transmit_errors: u8,
    /// The receive error counter.
    pub receive_errors: u8,
}

/// The outcome of [`CanController::withdraw`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Withdrawal {
    /// The frame is being sent, and may still fail. Withdraw it again in the next turn.
    Undecided,
    /// It was not sent and never will be.
    Withdrawn,
    /// It was sent, or there was none.
    TooLate,
}

impl Withdrawal {
    /// Returns the outcome by what every controller reports of a mailbox after the request: whether it is still occupied, and
    /// whether its last frame was sent.
    #[must_use]
    pub const fn of(is_occupied: bool, was_sent: bool) -> Self {
        match (is_occupied, was_sent) {
            (true, _) => Self::Undecided,
            (false, false) => Self::Withdrawn,
            (false, true) => Self::TooLate,
        }
    }
}

/// A CAN controller that does not leave bus-off by itself.
///
/// It takes and gives frames by `embedded_can::nb::Can`. It holds at most one frame with a given identifier, so frames with
/// the same identifier are sent in the order in which it took them. A frame that takes the place of another gives that one
/// back, as the trait defines.
pub trait CanController: embedded_can::nb::Can {
    /// How it sees the bus now.
    fn health(&mut self) -> Health;

    /// Withdraws the frame with this identifier that it took and has not sent. Frames with other identifiers stay, though they
    /// may have to wait until the withdrawal is decided. Does not wait.
    ///
    /// No controller stops a frame that is being sent. It completes that frame, but does not repeat it if it fails. Until then
    /// the withdrawal is [`Undecided`](Withdrawal::Undecided), and the caller repeats it once a turn.
    fn withdraw(&mut self, id: Id) -> Withdrawal;

    /// Forgets all frames that it took and has not sent, and a withdrawal that is not decided.
    fn abort(&mut self);

    /// Begins to leave bus-off, which takes 128 times 11 recessive bits. Does not wait for that.
    fn recover(&mut self);
}

/// No controller, for a board that has none: as good as one that is bus-off.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoCan;

/// A frame of [`NoCan`], of which there is none.
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
