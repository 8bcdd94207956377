//! The announcement sent when a TCP connection is dropped, so that the gripper does not enter FAST STOP.

use super::readiness::is_readable_within;
use crate::command::{Command, CommandId};
use crate::frame::{FrameEncoder, OVERHEAD, PREAMBLE_BYTE, PREAMBLE_LEN};
use core::time::Duration;
use std::io::{self, ErrorKind};
use std::net::TcpStream;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Time-out for the gripper to close its end.
pub(super) const LINGER: Duration = Duration::from_millis(100);

/// Reads until the gripper has closed its end or the time-out expires. Unread bytes would cause a reset of the
/// connection, which may overtake the announcement.
pub(super) fn linger(mut socket: &TcpStream, at_most: Duration) {
    let begun = Instant::now();
    let mut unread = [0; 512];
    loop {
        let left = at_most.saturating_sub(begun.elapsed()).as_millis() as u32;
        if left == 0 || !is_readable_within(socket, left).unwrap_or(false) {
            return;
        }
        #[expect(clippy::disallowed_methods, reason = "it is read again")]
        match io::Read::read(&mut socket, &mut unread) {
            Ok(1..) => {}
            Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::WouldBlock) => {}
            Ok(0) | Err(_) => return,
        }
    }
}

/// Observes the messages of a driver and its stop handles, and determines whether the end must be announced.
#[derive(Clone, Debug, Default)]
pub(super) struct Farewell {
    /// Valid even after a panic, because no update is left half done.
    state: Arc<Mutex<State>>,
}

/// Nothing has been sent yet, so no announcement is due.
#[derive(Debug, Default)]
struct State {
    protocol: Option<Spoken>,
    is_due: bool,
}

/// A protocol, recognized by the first byte of the first message.
#[derive(Clone, Copy, Debug)]
enum Spoken {
    Binary,
    #[cfg(feature = "gcl")]
    Gcl,
}

impl Farewell {
    /// Records a message that was written.
    ///
    /// After a FAST STOP, no announcement is due until it is acknowledged. A FAST STOP may be lost, and the unannounced
    /// end then triggers another one.
    pub(super) fn note(&self, message: &[u8]) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.protocol.is_none() {
            state.protocol = Spoken::by(message);
            state.is_due = state.protocol.is_some();
        }
        match state.protocol.and_then(|protocol| protocol.id(message)) {
            Some(CommandId::DisconnectAnnouncement | CommandId::FastStop) => state.is_due = false,
            Some(CommandId::Acknowledge) => state.is_due = true,
            _ => {}
        }
    }

    /// Writes the announcement to `buffer` and returns it, if one is due.
    pub(super) fn due<'b>(&self, buffer: &'b mut [u8; OVERHEAD]) -> Option<&'b [u8]> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let len = match state.protocol.filter(|_| state.is_due)? {
            Spoken::Binary => {
                let command = Command::DisconnectAnnouncement;
                FrameEncoder::new(command.id().code(), command).write_into(buffer).ok()?
            }
            #[cfg(feature = "gcl")]
            Spoken::Gcl => crate::gcl::Request::Bye.write_line_into(buffer).ok()?,
        };
        buffer.get(..len)
    }
}

impl Spoken {
    fn by(message: &[u8]) -> Option<Self> {
        match *message.first()? {
            PREAMBLE_BYTE => Some(Self::Binary),
            #[cfg(feature = "gcl")]
            _ => Some(Self::Gcl),
            #[cfg(not(feature = "gcl"))]
            _ => None,
        }
    }

    /// Returns the command of a message, or `None` for the rest of a partial message.
    fn id(self, message: &[u8]) -> Option<CommandId> {
        match self {
            Self::Binary => {
                let rest = message.strip_prefix(&[PREAMBLE_BYTE; PREAMBLE_LEN])?;
                rest.first().copied().map(CommandId::from_code)
            }
            #[cfg(feature = "gcl")]
            Self::Gcl => {
                use crate::gcl::CommandName;
                let name = message.split(|byte| !byte.is_ascii_alphabetic()).next()?;
                match CommandName::from_text(core::str::from_utf8(name).ok()?)? {
                    CommandName::Bye => Some(CommandId::DisconnectAnnouncement),
                    CommandName::Faststop => Some(CommandId::FastStop),
                    CommandName::Fsack => Some(CommandId::Acknowledge),
                    _ => None,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::readiness::tests::connected;
    use std::vec::Vec;

    fn frame(command: Command<'_>) -> Vec<u8> {
        FrameEncoder::new(command.id().code(), command).collect()
    }

    #[test]
    fn end_waits_until_the_gripper_closes_and_all_data_is_read() {
        use io::{Read, Write};
        let forever = Duration::from_secs(60);
        let (mut near, mut far) = connected();
        far.write_all(&[1; 1_000]).unwrap();
        drop(far);
        linger(&near, forever);
        assert_eq!(near.read_to_end(&mut Vec::new()).unwrap(), 0);

        let (near, _far) = connected();
        near.set_read_timeout(Some(forever)).unwrap();
        let begun = Instant::now();
        linger(&near, Duration::from_millis(20));
        // The time is counted in whole milliseconds.
        assert!((Duration::from_millis(19)..forever).contains(&begun.elapsed()));
    }

    fn due(messages: &[&[u8]]) -> Option<Vec<u8>> {
        let farewell = Farewell::default();
        messages.iter().for_each(|message| farewell.note(message));
        farewell.due(&mut [0; OVERHEAD]).map(<[u8]>::to_vec)
    }

    #[test]
    fn end_is_announced_in_the_protocol_that_was_spoken_and_once() {
        let announcement = frame(Command::DisconnectAnnouncement);
        assert_eq!(due(&[]), None, "no announcement is due before the first message");
        assert_eq!(due(&[&frame(Command::Stop)]), Some(announcement.clone()));
        assert_eq!(due(&[&frame(Command::Stop), &announcement]), None);
        #[cfg(feature = "gcl")]
        {
            assert_eq!(due(&[b"VERBOSE=0\n"]), Some(b"BYE()\n".to_vec()));
            assert_eq!(due(&[b"VERBOSE=0\n", b"BYE()\n"]), None);
        }
    }

    #[test]
    fn fast_stop_keeps_the_end_unannounced_until_it_is_acknowledged() {
        let [fast_stop, query] = [frame(Command::FastStop), frame(Command::GetForceLimit)];
        assert_eq!(due(&[&fast_stop, &query]), None);
        let acknowledged = [&*fast_stop, &query, &frame(Command::ACKNOWLEDGE)];
        assert_eq!(due(&acknowledged), Some(frame(Command::DisconnectAnnouncement)));
        #[cfg(feature = "gcl")]
        {
            assert_eq!(due(&[b"FASTSTOP()\n", b"POS?\n"]), None);
            assert_eq!(due(&[b"FASTSTOP()\n", b"FSACK()\n"]), Some(b"BYE()\n".to_vec()));
        }
    }

    #[test]
    fn rest_of_a_message_changes_nothing() {
        let stop = frame(Command::Stop);
        assert_eq!(due(&[&stop[..3], &stop[3..]]), Some(frame(Command::DisconnectAnnouncement)));
    }
}
