//! What the models of CAN controllers share: the interface to a bus, activity, error counters and fault confinement.

use std::fmt::Debug;
use std::ops::Range;

use anyhow::Result;

use crate::can_wire::WireFrame;

/// A pending transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmission {
    /// Index of its mailbox.
    pub mailbox: usize,
    /// The message.
    pub frame: WireFrame,
}

/// Result of an attempt to send a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// Another station has acknowledged it.
    Acknowledged,
    /// Another station has won arbitration.
    LostArbitration,
    /// The frame had an error.
    Failed,
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
    /// Returns the state that every controller has.
    fn node(&self) -> &Node;

    /// Returns the state that every controller has, to change it.
    fn node_mut(&mut self) -> &mut Node;

    /// Returns the configured bit timing.
    fn bit_timing(&self) -> BitTiming;

    /// Returns the request that it would send first.
    fn next_request(&self) -> Option<Transmission>;

    /// Handles the end of an attempt to send the message in this mailbox.
    fn attempt_ended(&mut self, mailbox: usize, attempt: Attempt);

    /// Filters a received message, and stores it. Returns whether a filter accepted it.
    fn accept(&mut self, frame: &WireFrame) -> bool;

    /// Handles the end of a frame in which it took part; `why` is its error, if any.
    fn frame_ended(&mut self, why: Option<ErrorCode>) {
        self.node_mut().count(why);
    }

    /// Enters a requested mode that was postponed until the end of a frame.
    fn change_mode(&mut self) {}

    /// Handles idle bits of a free bus.
    fn idle(&mut self, bits: u32);

    /// Returns the configured rate in bit/s.
    fn rate(&self) -> u32 {
        self.bit_timing().rate
    }

    /// Returns all messages accepted by a filter since reset, including lost ones.
    fn accepted(&self) -> &[WireFrame] {
        &self.node().accepted
    }

    /// Returns the driver's accesses that the manual forbids.
    fn violations(&self) -> &[String] {
        &self.node().violations
    }

    /// Returns whether it receives and acknowledges frames.
    fn takes_part(&self) -> bool {
        self.node().activity != Activity::Synchronising
    }

    /// Returns the message that it would send on a free bus.
    fn next_transmission(&self) -> Option<Transmission> {
        if self.takes_part() { self.next_request() } else { None }
    }

    /// Handles the start of its own transmission.
    fn begin_transmission(&mut self, mailbox: usize) {
        let node = self.node_mut();
        (node.activity, node.sending) = (Activity::Transmitting, mailbox);
    }

    /// Handles the start of another station's frame. `lost` is the mailbox that lost arbitration, if any.
    fn begin_reception(&mut self, lost: Option<usize>) {
        self.node_mut().recessive = 0;
        if let Some(mailbox) = lost {
            self.attempt_ended(mailbox, Attempt::LostArbitration);
        }
        if self.takes_part() {
            self.node_mut().activity = Activity::Receiving;
        }
    }

    /// Handles the acknowledgement of its own frame.
    fn end_transmission(&mut self, mailbox: usize) {
        self.attempt_ended(mailbox, Attempt::Acknowledged);
        self.end_frame(None);
    }

    /// Handles the failure of its own frame.
    fn fail_transmission(&mut self, mailbox: usize, why: ErrorCode) {
        self.attempt_ended(mailbox, Attempt::Failed);
        self.end_frame(Some(why));
    }

    /// Handles the end of another station's frame.
    fn end_reception(&mut self, frame: &WireFrame) {
        if self.node().activity == Activity::Receiving && self.accept(frame) {
            self.node_mut().accepted.push(*frame);
        }
        self.end_frame(None);
    }

    /// Handles the failure of another station's frame.
    fn fail_reception(&mut self, why: ErrorCode) {
        self.end_frame(Some(why));
    }

    /// Handles the end of a frame, which has as many recessive bits as synchronisation requires.
    fn end_frame(&mut self, why: Option<ErrorCode>) {
        if matches!(self.node().activity, Activity::Receiving | Activity::Transmitting) {
            self.node_mut().last_error = why.map_or(0, |why| why as u32);
            self.frame_ended(why);
            let node = self.node_mut();
            node.activity = if node.faults.is_off { Activity::Synchronising } else { Activity::Idle };
        }
        self.change_mode();
        self.node_mut().recessive = 0;
        self.idle(BITS_TO_SYNCHRONISE);
    }
}

/// A controller whose registers are at [`CAN1`] in the memory of an STM32.
pub trait MappedController: BusController {
    /// Addresses of its message RAM; empty without one.
    const RAM: Range<u32> = 0..0;

    /// Numbers of its interrupts.
    const LINES: [u8; 2];

    /// Loads the word at this offset from [`CAN1`].
    ///
    /// # Errors
    /// Fails when no such register is modelled.
    fn load(&mut self, offset: u32) -> Result<u32>;

    /// Stores to the word at this offset from [`CAN1`].
    ///
    /// # Errors
    /// Fails when the register or the requested option is not modelled.
    fn store(&mut self, offset: u32, value: u32) -> Result<()>;

    /// Returns the interrupt levels in the order of [`LINES`](Self::LINES).
    fn interrupts(&self) -> [bool; 2];

    /// Returns whether received data waits for the core, possibly without an interrupt.
    fn has_unread_data(&self) -> bool {
        false
    }

    /// Handles a reset of the chip.
    fn reset(&mut self);
}

/// Base address of CAN1 (RM0351, table 1) and of FDCAN1.
pub const CAN1: u32 = 0x4000_6400;

/// Activity on a bus, numbered as ACT in PSR of FDCAN (RM0440, 44.4.13).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Activity {
    /// Off the bus, or waiting for recessive bits.
    #[default]
    Synchronising,
    Idle,
    Receiving,
    Transmitting,
}

/// The state on a bus that every controller has.
#[derive(Clone, Debug, Default)]
pub struct Node {
    pub(crate) activity: Activity,
    pub(crate) sending: usize,
    /// Recessive bits since the last frame, or since it began to synchronise.
    pub(crate) recessive: u32,
    pub(crate) faults: Confinement,
    /// The error of the last frame as an [`ErrorCode`], or 0.
    pub(crate) last_error: u32,
    pub(crate) accepted: Vec<WireFrame>,
    pub(crate) violations: Vec<String>,
}

impl Node {
    /// Leaves the bus until the next sequence of recessive bits.
    pub(crate) fn synchronise(&mut self) {
        (self.activity, self.recessive) = (Activity::Synchronising, 0);
    }

    /// Returns whether the message in this mailbox is in transmission.
    pub(crate) fn is_sending(&self, mailbox: usize) -> bool {
        self.activity == Activity::Transmitting && self.sending == mailbox
    }

    /// Records an access that the manual forbids.
    pub(crate) fn forbidden(&mut self, what: impl Into<String>) {
        self.violations.push(what.into());
    }

    /// Changes the error counters at the end of the frame in progress; `why` is its error, if any (ISO 11898-1).
    pub(crate) fn count(&mut self, why: Option<ErrorCode>) {
        let Confinement { transmit, receive, is_off, .. } = &mut self.faults;
        match (self.activity, why) {
            (Activity::Transmitting, None) => *transmit = transmit.saturating_sub(1),
            // An error-passive transmitter does not count missing acknowledgements.
            (Activity::Transmitting, Some(ErrorCode::Acknowledgement))
                if Confinement::is_passive(*transmit) => {}
            (Activity::Transmitting, Some(_)) => *transmit += 8,
            (Activity::Receiving, None) if Confinement::is_passive(*receive) => *receive = PASSIVE_RETURN,
            (Activity::Receiving, None) => *receive = receive.saturating_sub(1),
            (Activity::Receiving, Some(_)) => *receive = (*receive + 1).min(LAST_ON),
            (Activity::Synchronising | Activity::Idle, _) => {}
        }
        *is_off |= *transmit > LAST_ON;
    }

    /// Counts recessive bits while its controller is on: synchronises it, and ends bus-off if that was requested. Returns
    /// whether the bits complete a sequence of [`BITS_TO_SYNCHRONISE`].
    pub(crate) fn idle(&mut self, bits: u32) -> bool {
        let before = self.recessive;
        self.recessive = before.saturating_add(bits);
        let sequences = self.recessive / BITS_TO_SYNCHRONISE - before / BITS_TO_SYNCHRONISE;
        if let Some(left) = &mut self.faults.to_recover {
            *left = left.saturating_sub(sequences);
            if *left == 0 {
                self.faults = Confinement::default();
            }
        }
        if sequences > 0 && !self.faults.is_off {
            self.activity = Activity::Idle;
        }
        sequences > 0
    }
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

    /// Requests the recovery from bus-off after this many sequences of 11 recessive bits.
    pub(crate) fn begin_recovery(&mut self, sequences: u32) {
        if self.is_off {
            self.to_recover = Some(sequences);
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
