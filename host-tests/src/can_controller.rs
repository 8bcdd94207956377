//! What a bus asks of a CAN controller, whichever it is.

use std::fmt::Debug;

use crate::can_wire::WireFrame;

/// A message that is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmission {
    /// Which mailbox it is in.
    pub mailbox: usize,
    /// The message.
    pub frame: WireFrame,
}

/// Why a frame failed, by the numbers of bxCAN's LEC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCode {
    /// More than five equal bits.
    Stuff = 1,
    /// A bit that is fixed was not so.
    Form = 2,
    /// Nobody acknowledged.
    Acknowledgement = 3,
    /// A recessive bit was not seen.
    BitRecessive = 4,
    /// A dominant bit was not seen.
    BitDominant = 5,
    /// The checksum is another.
    Crc = 6,
}

/// A controller, by what it does on a bus. The bus says when a frame begins, ends, or fails.
pub trait BusController: Clone + Debug + Send + 'static {
    /// The rate that it is set up for, in bit/s.
    fn rate(&self) -> u32;

    /// Whether it hears the bus and acknowledges what is on it.
    fn takes_part(&self) -> bool;

    /// What it would send if the bus were free now.
    fn next_transmission(&self) -> Option<Transmission>;

    /// It has begun to send a mailbox's message.
    fn begin_transmission(&mut self, mailbox: usize);

    /// Another has begun to send; what this one would have sent has lost arbitration, if it was to begin at once.
    fn begin_reception(&mut self, lost: Option<usize>);

    /// What it sent was acknowledged.
    fn end_transmission(&mut self, mailbox: usize);

    /// What it sent failed.
    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode);

    /// Another's frame has come through.
    fn end_reception(&mut self, frame: &WireFrame);

    /// Another's frame has failed.
    fn fail_reception(&mut self, why: ErrorCode);

    /// So many bits of a free bus have passed.
    fn idle(&mut self, bits: u32);
}
