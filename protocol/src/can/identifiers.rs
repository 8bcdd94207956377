//! CAN identifiers of the two directions.

use embedded_can::StandardId;

/// The two identifiers of a gripper: N for requests, N + 1 for replies.
///
/// ```
/// use wsg_protocol::can::Identifiers;
///
/// let pair = Identifiers::from_base(0x100).unwrap();
/// assert_eq!(pair.base(), 0x100);
/// assert_eq!(pair.controller().transmit.as_raw(), 0x100);
/// assert_eq!(pair.controller().receive, pair.gripper().transmit);
/// assert_eq!(Identifiers::from_base(0x7FF), None); // N + 1 would need a twelfth bit
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identifiers {
    base: u16,
    to_gripper: StandardId,
    from_gripper: StandardId,
}

/// The identifiers of one side, for sending and receiving.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The identifier on which this side sends.
    pub transmit: StandardId,
    /// The identifier on which this side receives.
    pub receive: StandardId,
}

impl Identifiers {
    /// The default pair, 120h and 121h. Neither is a predefined CANopen identifier, so the gripper can share a CANopen
    /// bus. Both have a higher priority than process data.
    pub const DEFAULT: Self = match Self::from_base(0x120) {
        Some(pair) => pair,
        None => Self { base: 0, to_gripper: StandardId::ZERO, from_gripper: StandardId::MAX },
    };

    /// Returns the pair N and N + 1, or `None` from N = 7FFh on, where N + 1 exceeds 11 bits.
    #[must_use]
    pub const fn from_base(n: u16) -> Option<Self> {
        match (StandardId::new(n), StandardId::new(n.saturating_add(1))) {
            (Some(to_gripper), Some(from_gripper)) => Some(Self { base: n, to_gripper, from_gripper }),
            _ => None,
        }
    }

    /// Returns N, the identifier of requests.
    #[must_use]
    pub const fn base(self) -> u16 {
        self.base
    }

    /// Returns the controller's side, which sends on N and receives on N + 1.
    #[must_use]
    pub const fn controller(self) -> Endpoint {
        Endpoint { transmit: self.to_gripper, receive: self.from_gripper }
    }

    /// Returns the gripper's side, which sends on N + 1 and receives on N.
    #[must_use]
    pub const fn gripper(self) -> Endpoint {
        Endpoint { transmit: self.from_gripper, receive: self.to_gripper }
    }
}
