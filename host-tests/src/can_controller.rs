//! Interface between a CAN bus and any controller model.

use std::fmt::Debug;

use crate::can_wire::WireFrame;

/// A pending transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmission {
    /// Index of its mailbox.
    pub mailbox: usize,
    /// The message.
    pub frame: WireFrame,
}

/// Cause of a failed frame, numbered as bxCAN's LEC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCode {
    /// More than five equal consecutive bits.
    Stuff = 1,
    /// A fixed-form bit had the wrong level.
    Form = 2,
    /// No acknowledgement.
    Acknowledgement = 3,
    /// A recessive bit was read as dominant.
    BitRecessive = 4,
    /// A dominant bit was read as recessive.
    BitDominant = 5,
    /// The checksum differs.
    Crc = 6,
}

/// A controller's behaviour on a bus. The bus reports when a frame begins, ends or fails.
pub trait BusController: Clone + Debug + Send + 'static {
    /// Returns the configured rate in bit/s.
    fn rate(&self) -> u32;

    /// Returns whether it receives and acknowledges frames.
    fn takes_part(&self) -> bool;

    /// Returns the message that it would send on a free bus.
    fn next_transmission(&self) -> Option<Transmission>;

    /// Handles the start of its own transmission.
    fn begin_transmission(&mut self, mailbox: usize);

    /// Handles the start of another station's frame. `lost` is the mailbox that lost arbitration, if any.
    fn begin_reception(&mut self, lost: Option<usize>);

    /// Handles the acknowledgement of its own frame.
    fn end_transmission(&mut self, mailbox: usize);

    /// Handles the failure of its own frame.
    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode);

    /// Handles the end of another station's frame.
    fn end_reception(&mut self, frame: &WireFrame);

    /// Handles the failure of another station's frame.
    fn fail_reception(&mut self, why: ErrorCode);

    /// Handles idle bits of a free bus.
    fn idle(&mut self, bits: u32);
}
