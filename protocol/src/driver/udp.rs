//! The common part of the blocking and the async UDP transport.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// The default port on which a gripper listens.
pub(super) const GRIPPER_PORT: u16 = 1500;
/// The default port to which a gripper replies.
pub(super) const ANSWER_PORT: u16 = 1501;

/// Longer than any message; the size of a datagram over Ethernet.
pub(super) const MAX_DATAGRAM_LEN: usize = 1_500;
const _: () = assert!(MAX_DATAGRAM_LEN > crate::frame::MAX_MESSAGE_LEN);

/// Returns the unspecified address of the gripper's address family.
pub(super) const fn any_like(gripper: SocketAddr) -> IpAddr {
    match gripper {
        SocketAddr::V4(_) => IpAddr::V4(Ipv4Addr::UNSPECIFIED),
        SocketAddr::V6(_) => IpAddr::V6(Ipv6Addr::UNSPECIFIED),
    }
}

/// Returns whether the error means that no socket listens there now. The gripper may be switched on later.
pub(super) fn is_silence(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// Returns whether a datagram of this length was sent by the gripper. Its source port may differ from the port on which the
/// gripper listens. An empty datagram is ignored.
pub(super) fn is_message(len: usize, sender: SocketAddr, gripper: SocketAddr) -> bool {
    len > 0 && sender.ip() == gripper.ip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_closed_port_is_silence() {
        for kind in [ErrorKind::ConnectionRefused, ErrorKind::ConnectionReset] {
            assert!(is_silence(&kind.into()), "{kind}");
        }
        for kind in [ErrorKind::NetworkUnreachable, ErrorKind::WouldBlock, ErrorKind::BrokenPipe] {
            assert!(!is_silence(&kind.into()), "{kind}");
        }
    }
}
