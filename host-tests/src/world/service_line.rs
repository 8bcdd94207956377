//! The service port in virtual time, connected to a program by a socket.

use std::collections::VecDeque;
use std::io::{ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use bus_modbus::rtu::Character;
use wsg_bridge_fw::BusPort;

/// The service port's end of a line to a master.
#[derive(Debug)]
pub struct ServiceLine {
    stream: UnixStream,
    waiting: VecDeque<Character>,
}

impl ServiceLine {
    /// Creates a line and returns both ends; the second is the master's.
    ///
    /// # Panics
    /// Panics when no socket can be created.
    #[must_use]
    pub fn new() -> (Self, UnixStream) {
        let (near, far) = UnixStream::pair().expect("a socket pair can be created");
        near.set_read_timeout(Some(Duration::from_millis(1))).expect("the time-out is not zero");
        (Self { stream: near, waiting: VecDeque::new() }, far)
    }

    /// Reads until no byte has arrived for a millisecond, so that a request is complete.
    ///
    /// # Panics
    /// Panics when the line fails.
    pub fn read(&mut self) {
        let mut bytes = [0; 256];
        loop {
            match uninterrupted::read(&mut self.stream, &mut bytes) {
                Ok(0) => return,
                Ok(len) => self.waiting.extend(bytes.iter().take(len).copied().map(Character::Byte)),
                Err(error) => {
                    assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}");
                    return;
                }
            }
        }
    }

    /// Discards received bytes.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}

impl BusPort for ServiceLine {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front().map(|character| (character, 0))
    }

    fn silence_us(&mut self) -> u32 {
        100_000
    }

    fn send(&mut self, frame: &[u8]) {
        self.stream.write_all(frame).expect("the master's end is open");
    }
}
