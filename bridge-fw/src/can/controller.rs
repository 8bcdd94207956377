//! What a CAN controller has to tell and to do besides frames.

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

/// A CAN controller that does not leave bus-off by itself.
///
/// Frames go by `embedded_can::nb::Can`. Frames of one identifier must leave in the order in which they were given; of
/// others, one that takes another's place gives it back, as that trait says.
pub trait CanController: embedded_can::nb::Can {
    /// How it sees the bus now.
    fn health(&mut self) -> Health;

    /// Forgets the frames that it was given and has not sent.
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

    fn abort(&mut self) {}

    fn recover(&mut self) {}
}
