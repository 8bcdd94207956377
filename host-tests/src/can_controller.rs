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

/// Consecutive recessive bits before a controller takes part (ISO 11898-1).
pub(crate) const BITS_TO_SYNCHRONISE: u32 = 11;

/// Counts recessive bits. Returns the number of sequences of [`BITS_TO_SYNCHRONISE`] that they complete.
pub(crate) fn count_sequences(recessive: &mut u32, bits: u32) -> u32 {
    let before = *recessive;
    *recessive = before.saturating_add(bits);
    *recessive / BITS_TO_SYNCHRONISE - before / BITS_TO_SYNCHRONISE
}

/// Timing of a bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Bit rate in bit/s.
    pub rate: u32,
    /// Sample point in thousandths of a bit.
    pub sample_point: u32,
    /// Synchronisation jump width in time quanta.
    pub jump: u32,
    /// Time quanta per bit.
    pub quanta: u32,
}

impl BitTiming {
    /// Computes the timing from a clock in Hz, its prescaler, the quanta before and after the sample point, and the
    /// synchronisation jump width.
    pub(crate) const fn new(clock_hz: u32, prescaler: u32, [before, after]: [u32; 2], jump: u32) -> Self {
        let quanta = before + after;
        Self { rate: clock_hz / (prescaler * quanta), sample_point: 1_000 * before / quanta, jump, quanta }
    }
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

/// Error counters and fault confinement (ISO 11898-1).
#[derive(Clone, Debug, Default)]
pub(crate) struct Confinement {
    pub(crate) transmit: u16,
    pub(crate) receive: u16,
    pub(crate) is_off: bool,
    /// Remaining sequences of 11 recessive bits until bus-off ends; `None` while no recovery is requested.
    pub(crate) to_recover: Option<u32>,
}

/// Last value of an error-active controller, and last value before bus-off.
const LAST_ACTIVE: u16 = 127;
const LAST_ON: u16 = 255;

/// Value of the receive counter after a success while error passive (ISO 11898-1: 119 to 127).
const PASSIVE_RETURN: u16 = 120;

/// Sequences of 11 recessive bits that end bus-off.
pub(crate) const RECOVERY: u32 = 128;

impl Confinement {
    /// Returns whether a counter has reached its warning limit.
    pub(crate) const fn warns(counter: u16) -> bool {
        counter >= 96
    }

    pub(crate) const fn is_passive(counter: u16) -> bool {
        counter > LAST_ACTIVE
    }

    /// Returns the applying bits of a status register, given those for the warning limit, error passive and bus-off.
    pub(crate) fn states(&self, bits: [u32; 3]) -> u32 {
        let highest = self.transmit.max(self.receive);
        let applies = [Self::warns(highest), Self::is_passive(highest), self.is_off];
        bits.iter().zip(applies).filter(|(_, applies)| *applies).map(|(bit, _)| bit).sum()
    }

    pub(crate) fn transmitted(&mut self) {
        self.transmit = self.transmit.saturating_sub(1);
    }

    pub(crate) fn received(&mut self) {
        self.receive =
            if Self::is_passive(self.receive) { PASSIVE_RETURN } else { self.receive.saturating_sub(1) };
    }

    pub(crate) fn transmit_error(&mut self, why: ErrorCode) {
        // An error-passive transmitter does not count missing acknowledgements.
        if why != ErrorCode::Acknowledgement || !Self::is_passive(self.transmit) {
            self.transmit += 8;
        }
        self.is_off |= self.transmit > LAST_ON;
    }

    pub(crate) fn receive_error(&mut self) {
        self.receive = (self.receive + 1).min(LAST_ON);
    }

    /// Requests the recovery from bus-off after this many sequences of 11 recessive bits.
    pub(crate) fn begin_recovery(&mut self, sequences: u32) {
        if self.is_off {
            self.to_recover = Some(sequences);
        }
    }

    /// Counts received sequences of 11 recessive bits.
    pub(crate) fn count_recessive(&mut self, sequences: u32) {
        let Some(left) = &mut self.to_recover else { return };
        *left = left.saturating_sub(sequences);
        if *left == 0 {
            *self = Self::default();
        }
    }
}

/// Traffic for the tests of controller models.
#[cfg(test)]
pub(crate) mod testing {
    use super::{BITS_TO_SYNCHRONISE, BusController, ErrorCode};
    use crate::can_wire::WireFrame;

    pub(crate) fn receive(can: &mut impl BusController, frame: &WireFrame) {
        can.begin_reception(None);
        can.end_reception(frame);
    }

    /// Sends the next frame. Returns its mailbox.
    pub(crate) fn send(can: &mut impl BusController) -> usize {
        let mailbox = can.next_transmission().unwrap().mailbox;
        can.begin_transmission(mailbox);
        can.end_transmission(mailbox);
        mailbox
    }

    pub(crate) fn fail(can: &mut impl BusController, times: usize, why: ErrorCode) {
        for _ in 0..times {
            let mailbox = can.next_transmission().unwrap().mailbox;
            can.begin_transmission(mailbox);
            can.fail_transmission(mailbox, why);
        }
    }

    /// Checks that 32 errors cause bus-off, which ends after `rejoin` and as many sequences of 11 recessive bits, and
    /// that the transmission is still pending.
    pub(crate) fn assert_recovers<C: BusController>(can: &mut C, rejoin: impl Fn(&mut C), sequences: u32) {
        fail(can, 31, ErrorCode::BitDominant);
        assert!(can.takes_part());
        fail(can, 1, ErrorCode::BitDominant);
        can.idle(1_000_000);
        assert!(!can.takes_part(), "no automatic recovery");
        rejoin(can);
        can.idle(sequences * BITS_TO_SYNCHRONISE - 1);
        assert!(!can.takes_part());
        can.idle(1);
        assert!(can.takes_part() && can.next_transmission().is_some());
    }
}
