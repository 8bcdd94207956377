//! What a CAN controller has to tell and to do besides frames.

use core::marker::PhantomData;

use embedded_can::{ErrorKind, Frame};

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
#[derive(Clone, Copy, Debug)]
pub struct NoCan<F>(PhantomData<fn() -> F>);

impl<F> NoCan<F> {
    /// None.
    #[must_use]
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<F> Default for NoCan<F> {
    fn default() -> Self {
        Self::new()
    }
}

impl<F: Frame> embedded_can::nb::Can for NoCan<F> {
    type Frame = F;
    type Error = ErrorKind;

    fn transmit(&mut self, _: &F) -> nb::Result<Option<F>, ErrorKind> {
        Err(nb::Error::WouldBlock)
    }

    fn receive(&mut self) -> nb::Result<F, ErrorKind> {
        Err(nb::Error::WouldBlock)
    }
}

impl<F: Frame> CanController for NoCan<F> {
    fn health(&mut self) -> Health {
        Health { is_off: true, ..Health::default() }
    }

    fn abort(&mut self) {}

    fn recover(&mut self) {}
}
