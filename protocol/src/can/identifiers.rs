//! Which identifier carries which direction.

use embedded_can::StandardId;

/// The two identifiers of a gripper: N to it, N + 1 from it.
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

/// One side of the pair: what it sends on and what it listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The identifier of what this side sends.
    pub transmit: StandardId,
    /// The identifier of what this side receives.
    pub receive: StandardId,
}

impl Identifiers {
    /// 120h and 121h, which this project uses where nothing else is said: none of CANopen's predefined identifiers, so
    /// both fit on one bus, and of higher priority than process data.
    pub const DEFAULT: Self = match Self::from_base(0x120) {
        Some(pair) => pair,
        None => Self { base: 0, to_gripper: StandardId::ZERO, from_gripper: StandardId::MAX },
    };

    /// The pair N and N + 1; `None` where N + 1 has no 11-bit identifier, that is from N = 7FFh on.
    #[must_use]
    pub const fn from_base(n: u16) -> Option<Self> {
        match (StandardId::new(n), StandardId::new(n.saturating_add(1))) {
            (Some(to_gripper), Some(from_gripper)) => Some(Self { base: n, to_gripper, from_gripper }),
            _ => None,
        }
    }

    /// Returns N.
    #[must_use]
    pub const fn base(self) -> u16 {
        self.base
    }

    /// The controller's side: sends on N, receives on N + 1.
    #[must_use]
    pub const fn controller(self) -> Endpoint {
        Endpoint { transmit: self.to_gripper, receive: self.from_gripper }
    }

    /// The gripper's side: sends on N + 1, receives on N.
    #[must_use]
    pub const fn gripper(self) -> Endpoint {
        Endpoint { transmit: self.from_gripper, receive: self.to_gripper }
    }
}
