//! Transmit buffers of a CAN controller: allocation to frames, and pending withdrawal.
//!
//! Controllers send by the priority of buffers or identifiers, not in the order of acceptance. This policy ensures the order
//! that [`CanController`](super::CanController) guarantees. A driver reads its registers, follows the policy, and writes its
//! registers.

use embedded_can::Id;

use super::{CanConfig, Withdrawal};

/// Buffer of frames to the gripper.
const GRIPPER: usize = 0;

/// First key of extended identifiers, which have 29 bits.
const EXTENDED: u32 = 1 << 31;

/// Not the key of any identifier.
const NONE: u32 = u32::MAX;

/// The three transmit buffers of a controller.
///
/// The first holds frames to the gripper only, so a FAST STOP never waits for the frame of another node. The other two hold any
/// frames, but never two with the same identifier, because the controller might send the second one first.
#[derive(Clone, Debug)]
pub struct TransmitBuffers {
    /// The [`key`] of frames to the gripper; `NONE` before the start.
    gripper: u32,
    /// The key of the last frame in each buffer.
    given: [u32; Self::COUNT],
    /// The buffer whose frame is being withdrawn.
    withdrawing: Option<usize>,
}

impl TransmitBuffers {
    /// Transmit buffers of a controller: bxCAN, FDCAN of an STM32G4 and MCP2515 have this many.
    pub const COUNT: usize = 3;

    /// Creates the policy of a controller that has not started. It takes no buffer for the gripper's frames alone.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "a driver creates it in a constant")]
    pub const fn new() -> Self {
        Self { gripper: NONE, given: [NONE; Self::COUNT], withdrawing: None }
    }

    /// Sets the gripper's identifier. Called with empty buffers, after each set-up of the controller.
    pub fn start(&mut self, config: &CanConfig) {
        self.gripper = key(config.gripper.controller().transmit.into());
        self.withdrawing = None;
    }

    /// Returns the buffer for a frame with this identifier, or `None` if the frame must wait. The driver loads the frame
    /// immediately.
    pub fn take(&mut self, id: Id, is_empty: [bool; Self::COUNT]) -> Option<usize> {
        let id = key(id);
        let [is_gripper_empty, is_one_empty, is_other_empty] = is_empty;
        let [_, in_one, in_other] = self.given;
        let buffer = if self.gripper == id {
            is_gripper_empty.then_some(GRIPPER)
        } else {
            match (is_one_empty, is_other_empty) {
                (true, true) => Some(1),
                (true, false) if in_other != id => Some(1),
                (false, true) if in_one != id => Some(2),
                _ => None,
            }
        };
        *self.given.get_mut(buffer?)? = id;
        buffer
    }

    /// Returns the buffer whose frame is being withdrawn, if any. The driver keeps the buffer's sent flag until
    /// [`decide`](Self::decide).
    #[must_use]
    pub const fn withdrawing(&self) -> Option<usize> {
        self.withdrawing
    }

    /// Starts the withdrawal of the frame with this identifier. Returns its buffer, or `None` if no buffer holds it unsent.
    pub fn withdraw(&mut self, id: Id, is_empty: [bool; Self::COUNT]) -> Option<usize> {
        let id = key(id);
        let mut held = self.given.iter().zip(is_empty);
        self.withdrawing = held.position(|(given, is_empty)| !is_empty && *given == id);
        self.withdrawing
    }

    /// Records and returns the outcome of the withdrawal according to the registers. After an abort of all frames, it is
    /// [`Withdrawal::Withdrawn`].
    pub fn decide(&mut self, outcome: Withdrawal) -> Withdrawal {
        if outcome != Withdrawal::Undecided {
            self.withdrawing = None;
        }
        outcome
    }
}

/// Returns an identifier as a number, which is compared with less code than an [`Id`].
fn key(id: Id) -> u32 {
    match id {
        Id::Standard(id) => id.as_raw().into(),
        Id::Extended(id) => EXTENDED.wrapping_add(id.as_raw()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_can::{ExtendedId, StandardId};

    fn id(raw: u16) -> Id {
        StandardId::new(raw).unwrap().into()
    }

    fn gripper() -> Id {
        CanConfig::DEFAULT.gripper.controller().transmit.into()
    }

    fn started() -> TransmitBuffers {
        let mut buffers = TransmitBuffers::new();
        buffers.start(&CanConfig::DEFAULT);
        buffers
    }

    #[test]
    fn gripper_has_its_own_buffer_and_other_frames_share_two() {
        let mut buffers = started();
        assert_eq!(buffers.take(id(0x180), [true; 3]), Some(1));
        assert_eq!(buffers.take(id(0x280), [true, false, true]), Some(2));
        assert_eq!(buffers.take(id(0x380), [true, false, false]), None);
        assert_eq!(buffers.take(gripper(), [true, false, false]), Some(0));
        assert_eq!(buffers.take(gripper(), [false, true, true]), None);
    }

    #[test]
    fn two_frames_with_one_identifier_never_wait_in_two_buffers() {
        let mut buffers = started();
        assert_eq!(buffers.take(id(0x180), [true; 3]), Some(1));
        assert_eq!(buffers.take(id(0x180), [true, false, true]), None);
        assert_eq!(buffers.take(id(0x181), [true, false, true]), Some(2));
        assert_eq!(buffers.take(id(0x181), [true, true, false]), None);
        assert_eq!(buffers.take(id(0x180), [true, true, false]), Some(1));
        assert_eq!(buffers.take(id(0x180), [true; 3]), Some(1), "sent frames do not count");
    }

    #[test]
    fn only_an_unsent_frame_with_the_identifier_is_withdrawn() {
        let mut buffers = started();
        for (frame, is_empty) in [(gripper(), [true; 3]), (id(0x180), [false, true, true])] {
            buffers.take(frame, is_empty).unwrap();
        }
        assert_eq!(buffers.withdraw(id(0x280), [false, false, true]), None);
        assert_eq!(buffers.withdraw(gripper(), [true, false, true]), None, "already sent");
        assert_eq!(buffers.withdraw(id(0x180), [false, false, true]), Some(1));

        assert_eq!(buffers.decide(Withdrawal::Undecided), Withdrawal::Undecided);
        assert_eq!(buffers.withdrawing(), Some(1));
        assert_eq!(buffers.decide(Withdrawal::Withdrawn), Withdrawal::Withdrawn);
        assert_eq!(buffers.withdrawing(), None);
    }

    #[test]
    fn restart_of_the_controller_ends_a_withdrawal() {
        let mut buffers = started();
        buffers.take(gripper(), [true; 3]).unwrap();
        assert_eq!(buffers.withdraw(gripper(), [false, true, true]), Some(0));
        buffers.start(&CanConfig::DEFAULT);
        assert_eq!(buffers.withdrawing(), None);
    }

    #[test]
    fn standard_and_extended_identifiers_with_one_number_differ() {
        let mut buffers = started();
        let extended = Id::Extended(ExtendedId::new(0x180).unwrap());
        assert_eq!(buffers.take(id(0x180), [true; 3]), Some(1));
        assert_eq!(buffers.take(extended, [true, false, true]), Some(2));
        assert_eq!(buffers.withdraw(extended, [true, false, false]), Some(2));
    }

    #[test]
    fn gripper_has_no_buffer_before_the_start() {
        assert_eq!(TransmitBuffers::new().take(gripper(), [true; 3]), Some(1));
    }
}
