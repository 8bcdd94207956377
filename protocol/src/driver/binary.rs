//! The binary protocol below a driver.

use super::link::{Link, Protocol};
use super::{Error, MAX_FRAME_LEN, MAX_REPLY_LEN};
use crate::command::{Command, CommandId};
use crate::frame::{self, FrameEncoder, FrameParser, OVERHEAD, Payload};
use crate::session::{self, Known, Notice, Session, Signal};
use crate::time::Instant;
use crate::types::AutoUpdate;

/// The binary protocol (command set).
///
/// `RX` is the longest payload of a reply that is taken, at least 34, and `TX` the longest frame that is sent, at least
/// 17.
#[derive(Debug)]
pub struct Binary<const RX: usize = MAX_REPLY_LEN, const TX: usize = MAX_FRAME_LEN> {
    session: Session,
    parser: FrameParser<RX>,
    frame: [u8; TX],
    /// The command in the frame.
    id: CommandId,
}

impl<const RX: usize, const TX: usize> Binary<RX, TX> {
    pub(super) const fn new(config: session::Config) -> Self {
        const {
            assert!(RX >= 34, "the session asks for the limits, 32 bytes behind a status");
            assert!(TX >= OVERHEAD + Command::MAX_FIXED_LEN, "every command of fixed length fits");
        }
        Self {
            session: Session::new(config),
            parser: FrameParser::new(),
            frame: [0; TX],
            id: CommandId::Unknown(0),
        }
    }
}

impl<const RX: usize, const TX: usize> Protocol for Binary<RX, TX> {}

impl<const RX: usize, const TX: usize> Link for Binary<RX, TX> {
    fn is_connected(&self) -> bool {
        self.session.is_connected()
    }

    fn is_busy(&self) -> bool {
        self.session.is_busy()
    }

    fn owes_fast_stop(&self) -> bool {
        self.session.owes_fast_stop()
    }

    fn motion(&self) -> Option<CommandId> {
        self.session.motion()
    }

    fn known(&self) -> &Known {
        self.session.known()
    }

    fn line_counters(&self) -> frame::Counters {
        self.parser.counters()
    }

    fn session_counters(&self) -> session::Counters {
        self.session.counters()
    }

    fn subscribe(&mut self, signal: Signal, update: AutoUpdate) {
        self.session.subscribe(signal, update);
    }

    fn wants_width(&self, _command: &Command<'_>) -> bool {
        false
    }

    fn request<E>(&mut self, command: Command<'static>, _width: Option<f32>) -> Result<(), Error<E>> {
        Ok(self.session.request(command)?)
    }

    fn request_lent<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>> {
        let needed = command.len().saturating_add(OVERHEAD);
        if needed > TX {
            return Err(Error::TooLong { needed });
        }
        Ok(self.session.request_lent(command)?)
    }

    fn withdraw(&mut self) {
        self.session.withdraw();
    }

    fn take_back(&mut self) -> bool {
        self.session.take_back(self.id)
    }

    fn hang_up(&mut self) {
        self.session.disconnect();
        self.parser.reset();
    }

    fn receive(&mut self, now: Instant, bytes: &[u8], note: &mut impl FnMut(&Notice<'_>)) {
        let mut rest = bytes;
        loop {
            let (taken, event) = self.parser.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            let Some(event) = event else { return };
            if let Some(notice) = self.session.handle(now, &event) {
                note(&notice);
            }
        }
    }

    fn is_mid_message(&self) -> bool {
        self.parser.is_mid_frame()
    }

    fn give_up_half(&mut self, now: Instant, note: &mut impl FnMut(&Notice<'_>)) {
        while let Some(event) = self.parser.expire() {
            if let Some(notice) = self.session.handle(now, &event) {
                note(&notice);
            }
        }
    }

    fn tick(&mut self, now: Instant) -> Option<Notice<'static>> {
        self.session.tick(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }

    fn encode_next(&mut self, now: Instant, lent: Option<Command<'_>>) -> Option<usize> {
        let command = self.session.poll_transmit_lent(now, lent)?;
        self.id = command.id();
        // It fits: what is lent was checked, and there is room for all others.
        Some(FrameEncoder::new(self.id.code(), command).write_into(&mut self.frame).unwrap_or(0))
    }

    fn encoded(&self) -> &[u8] {
        &self.frame
    }
}
