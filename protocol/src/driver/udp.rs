//! What the blocking and the async UDP transport share.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

/// The port that a gripper listens on as delivered.
pub(super) const GRIPPER_PORT: u16 = 1500;
/// The port that a gripper answers to as delivered.
pub(super) const ANSWER_PORT: u16 = 1501;

/// More than a message has, and what a datagram carries over Ethernet.
pub(super) const MAX_DATAGRAM_LEN: usize = 1_500;
const _: () = assert!(MAX_DATAGRAM_LEN > crate::frame::MAX_MESSAGE_LEN);

/// Every local address of the gripper's family.
pub(super) const fn any_like(gripper: SocketAddr) -> IpAddr {
    match gripper {
        SocketAddr::V4(_) => IpAddr::V4(Ipv4Addr::UNSPECIFIED),
        SocketAddr::V6(_) => IpAddr::V6(Ipv6Addr::UNSPECIFIED),
    }
}

/// Whether an error says that nobody listens there now: the gripper may be switched on later.
pub(super) fn is_silence(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// Whether a datagram of this length is the gripper's. It may have left another port than the one that the gripper listens
/// on. One without a byte says nothing, and ends nothing.
pub(super) fn is_message(len: usize, sender: SocketAddr, gripper: SocketAddr) -> bool {
    len > 0 && sender.ip() == gripper.ip()
}
