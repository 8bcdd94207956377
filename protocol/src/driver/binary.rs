//! The binary protocol, as used by a driver.

use super::link::{Link, Protocol};
use super::{Error, MAX_FRAME_LEN, MAX_REPLY_LEN};
use crate::command::{Command, CommandId};
use crate::frame::{self, FrameEncoder, FrameParser, OVERHEAD, Payload};
use crate::session::{self, Event, Known, Session, Topic};
use crate::time::Instant;
use crate::types::{AutoUpdate, PrePositionFlags};

/// The binary protocol (command set).
///
/// `RX` is the maximum payload of a received reply in bytes, at least 34, and `TX` the maximum length of a sent frame,
/// at least 17.
#[derive(Debug)]
pub struct Binary<const RX: usize = MAX_REPLY_LEN, const TX: usize = MAX_FRAME_LEN> {
    session: Session,
    parser: FrameParser<RX>,
    frame: [u8; TX],
    /// The command in the frame buffer.
    id: CommandId,
}

impl<const RX: usize, const TX: usize> Binary<RX, TX> {
    pub(super) const fn new(config: session::Config) -> Self {
        const {
            assert!(
                RX >= 34,
                "RX must be at least 34: the session queries the limits, 32 bytes after the status"
            );
            assert!(
                TX >= OVERHEAD + Command::MAX_FIXED_LEN,
                "TX must be at least 17, for every command of fixed length"
            );
        }
        Self {
            session: Session::new(config),
            parser: FrameParser::new(),
            frame: [0; TX],
            id: CommandId::Unknown(0),
        }
    }

    /// Chooses how late the answer to a request that must not be repeated may be. See the session's method.
    #[cfg(feature = "std")]
    pub(super) const fn tolerate_late_answers(&mut self, does_tolerate: bool) {
        self.session.tolerate_late_answers(does_tolerate);
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

    fn fast_stop_pending(&self) -> bool {
        self.session.fast_stop_pending()
    }

    fn is_urgent(&self) -> bool {
        self.session.is_urgent()
    }

    fn motion(&self) -> Option<CommandId> {
        self.session.motion()
    }

    fn known(&self) -> &Known {
        self.session.known()
    }

    fn line_counters(&self) -> frame::FrameCounters {
        self.parser.counters()
    }

    fn session_counters(&self) -> session::SessionCounters {
        self.session.counters()
    }

    fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
        self.session.subscribe(topic, update);
    }

    fn wants_width(&self, command: &Command<'_>) -> bool {
        matches!(command, Command::PrePosition { flags, .. } if flags.contains(PrePositionFlags::RELATIVE))
    }

    fn request<E>(&mut self, command: Command<'static>, _width: Option<f32>) -> Result<(), Error<E>> {
        Ok(self.session.request(command)?)
    }

    fn request_borrowed<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>> {
        let needed = command.len().saturating_add(OVERHEAD);
        if needed > TX {
            return Err(Error::TooLong { needed });
        }
        Ok(self.session.request_borrowed(command)?)
    }

    fn withdraw(&mut self) {
        self.session.withdraw();
    }

    fn take_back(&mut self) -> bool {
        self.session.take_back(self.id)
    }

    fn outlives_connection(&self) -> bool {
        self.id.outlives_connection()
    }

    fn hang_up(&mut self) {
        self.session.disconnect();
        self.parser.reset();
    }

    fn receive(&mut self, now: Instant, bytes: &[u8], note: &mut impl FnMut(&Event<'_>)) {
        let mut rest = bytes;
        loop {
            let (taken, event) = self.parser.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            let Some(event) = event else { return };
            if let Some(event) = self.session.handle(now, &event) {
                note(&event);
            }
        }
    }

    fn is_mid_message(&self) -> bool {
        self.parser.is_mid_frame()
    }

    fn give_up_half(&mut self, now: Instant, note: &mut impl FnMut(&Event<'_>)) {
        while let Some(event) = self.parser.expire() {
            if let Some(event) = self.session.handle(now, &event) {
                note(&event);
            }
        }
    }

    fn tick(&mut self, now: Instant) -> Option<Event<'static>> {
        self.session.tick(now)
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }

    fn encode_next(&mut self, now: Instant, borrowed: Option<Command<'_>>) -> Option<usize> {
        let command = self.session.poll_transmit_borrowed(now, borrowed)?;
        self.id = command.id();
        // It fits: borrowed commands were checked, and the buffer holds all others.
        Some(FrameEncoder::new(self.id.code(), command).write_into(&mut self.frame).unwrap_or(0))
    }

    fn encoded(&self) -> &[u8] {
        &self.frame
    }

    #[cfg(feature = "std")]
    fn stop_message(kind: super::StopKind, buffer: &mut [u8; super::MAX_STOP_LEN]) -> usize {
        let command = kind.command();
        FrameEncoder::new(command.id().code(), command).write_into(buffer).unwrap_or(0)
    }
}
