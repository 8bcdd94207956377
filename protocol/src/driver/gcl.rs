//! GCL, as used by a driver: commands and replies of the binary protocol, translated to lines of text.

mod translate;

use super::Error;
use super::link::{Link, Protocol};
use crate::command::{Command, CommandId, Kind};
use crate::field::DecodeError;
use crate::frame;
use crate::gcl::session::{Event as GclEvent, RequestError as LineError, Session};
use crate::gcl::{Answer, CommandName, LineReader, ParseError, Request, Value as LineValue};
use crate::reply::{Reply, Value};
use crate::session::{self, Event, Known, RequestError, Topic};
use crate::time::Instant;
use crate::types::{AutoUpdate, Status, SystemLimits};
use translate::Terms;

/// Default limit for a received line over GCL, in bytes.
pub const GCL_LINE_LEN: usize = 256;

/// Length of the longest reply line that a driver needs: 32 system state flags.
const LONGEST_NEEDED: usize = "@SYSFLAGS=[]".len() + 2 * 32;

/// The text protocol (GCL). `RX` is the maximum length of a received line in bytes, at least 76.
///
/// Requests have the same effect as over the binary protocol, with these differences:
///
/// | method | over GCL |
/// |---|---|
/// | limits | The stroke follows from the model (DEVTYPE). GCL has no query for the others: `assume_limits` states them, and `known().limits` returns them. Without them, the driver refuses only negative speeds and forces. The manual does not specify how the gripper treats other values |
/// | `set_force_limit`, `force_limit` | stored by the driver and sent with every GRIP; [`Error::NoForceLimit`] before the first setting |
/// | `move_by` | queries the width, then sends `MOVE` to that width plus the offset |
/// | `grip` | queries the width first to determine the direction; blocked outside the part width tolerance: [`Error::Blocked`] |
/// | `release` | queries the width, then sends `RELEASE` by the distance from it; only after a grip (E_NOT_AVAILABLE), and only away from the part (otherwise [`Error::NotInGcl`]) |
/// | `system_info` | hardware revision 0; firmware 0.0.0 if the binary protocol cannot represent it |
/// | `finger_info` | four bytes of data for a WSG-FMF, 0 for other fingers |
/// | `finger_data` | supported for a WSG-FMF; E_NOT_AVAILABLE for other fingers |
/// | `announce_disconnect` | `BYE` |
/// | [`timeouts`](session::Config::timeouts), [`verify_settings`](session::Config::verify_settings) | no effect |
///
/// The gripper determines the direction of `RELEASE`: away from the part of its last grip. The driver knows only its
/// own grips, not the grips of other clients. Before its first grip it assumes that the fingers have closed.
///
/// These requests return [`Error::NotInGcl`] and send nothing: `move_to` and `move_by` with
/// [`OnBlock::Clamp`](super::OnBlock::Clamp), `statistics` with a reset, `limits`, acceleration, soft limits,
/// overdrive, `set_tag`, `set_finger_power`, `loop_back`, and `raw` with any command that GCL lacks.
#[derive(Debug)]
pub struct Gcl<const RX: usize = GCL_LINE_LEN> {
    session: Session,
    reader: LineReader<RX>,
    line: [u8; Request::MAX_LEN + 1],
    /// The request in the line buffer.
    name: CommandName,
    terms: Terms,
    known: Known,
    /// The limits stated by the program.
    limits: Option<SystemLimits>,
    /// The reply to a request that the driver serves itself.
    own_answer: Option<Reply<'static>>,
    /// The state of a PWT or CLT request.
    setting: Setting,
}

/// The state of a request that exists only in GCL.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Setting {
    Open,
    Is(f32),
    Refused(Status),
    Withdrawn,
}

impl<const RX: usize> Gcl<RX> {
    pub(super) const fn new(config: session::Config) -> Self {
        const {
            assert!(
                RX >= LONGEST_NEEDED,
                "RX must be at least 76: the session queries the system state flags"
            );
        }
        Self {
            session: Session::new(translate::session_config(&config)),
            reader: LineReader::new(),
            line: [0; Request::MAX_LEN + 1],
            name: CommandName::Verbose,
            terms: Terms::NONE,
            known: Known::NOTHING,
            limits: None,
            own_answer: None,
            setting: Setting::Open,
        }
    }

    /// States the limits of the gripper.
    pub(super) const fn assume_limits(&mut self, limits: SystemLimits) {
        self.limits = Some(limits);
        self.known.limits = if self.session.is_connected() { self.limits } else { None };
    }

    /// Requests or sets PWT or CLT.
    pub(super) fn request_setting<E>(&mut self, request: Request) -> Result<(), Error<E>> {
        self.setting = Setting::Open;
        Ok(self.session.request(request)?)
    }

    /// Returns the outcome of that request.
    pub(super) const fn setting<E>(&self) -> Result<f32, Error<E>> {
        match self.setting {
            Setting::Is(value) => Ok(value),
            Setting::Refused(status) => Err(Error::Refused(status)),
            Setting::Withdrawn => Err(Error::NotConnected),
            Setting::Open => Err(Error::Unanswered),
        }
    }

    /// Serves the requests that need no message, and returns the reply.
    fn serve<E>(&mut self, command: &Command<'_>) -> Result<Option<Reply<'static>>, Error<E>> {
        match *command {
            Command::SetForceLimit { force } => {
                self.terms.force = Some(force);
                Ok(Some(Reply::success(Value::SetForceLimit)))
            }
            Command::GetForceLimit => {
                let force = self.terms.force.ok_or(Error::NoForceLimit)?;
                Ok(Some(Reply::success(Value::GetForceLimit(force))))
            }
            _ => Ok(None),
        }
    }

    fn ask<E>(&mut self, command: &Command<'_>, width: Option<f32>) -> Result<(), Error<E>> {
        command.check()?;
        if matches!(command, Command::SetForceLimit { .. } | Command::GetForceLimit) && !self.is_connected() {
            return Err(Error::NotConnected);
        }
        if let Some(answer) = self.serve(command)? {
            self.own_answer = Some(answer);
            return Ok(());
        }
        let request = self.terms.request(command, width)?;
        self.session.request(request)?;
        self.terms.asked(command, width);
        Ok(())
    }
}

impl<const RX: usize> Protocol for Gcl<RX> {}

impl<const RX: usize> Link for Gcl<RX> {
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
        self.session.motion().and_then(|name| self.terms.id(name))
    }

    fn known(&self) -> &Known {
        &self.known
    }

    /// The smaller stroke counts if the stated one differs from the gripper's.
    fn limits(&self) -> SystemLimits {
        let stated = self.known.limits.unwrap_or(SystemLimits::UNKNOWN);
        let stroke = self.session.known().stroke.map_or(stated.stroke, |stroke| stroke.min(stated.stroke));
        SystemLimits { stroke, ..stated }
    }

    fn line_counters(&self) -> frame::FrameCounters {
        let lines = self.reader.counters();
        frame::FrameCounters { dropped: lines.dropped, bad_checksum: 0, oversize: lines.too_long }
    }

    fn session_counters(&self) -> session::SessionCounters {
        self.session.counters()
    }

    fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
        self.session.subscribe(translate::autosend(topic, update));
    }

    fn wants_width(&self, command: &Command<'_>) -> bool {
        command.check().is_ok() && self.terms.wants_width(command)
    }

    fn forget_force_limit(&mut self) {
        self.terms.force = None;
    }

    fn request<E>(&mut self, command: Command<'static>, width: Option<f32>) -> Result<(), Error<E>> {
        self.ask(&command, width)
    }

    fn request_borrowed<E>(&mut self, command: &Command<'_>) -> Result<(), Error<E>> {
        self.ask(command, None)
    }

    fn withdraw(&mut self) {
        self.own_answer = None;
        self.session.withdraw();
    }

    fn take_back(&mut self) -> bool {
        self.session.take_back(self.name)
    }

    fn outlives_connection(&self) -> bool {
        matches!(self.name, CommandName::Faststop | CommandName::Autosend) || self.name.kind() == Kind::Query
    }

    fn hang_up(&mut self) {
        self.session.disconnect();
        self.reader.reset();
    }

    fn receive(&mut self, now: Instant, bytes: &[u8], note: &mut impl FnMut(&Event<'_>)) {
        let Self { session, reader, terms, known, limits, setting, .. } = self;
        let mut rest = bytes;
        loop {
            let (taken, event) = reader.push_slice(rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            let Some(event) = event else { return };
            let event = session.handle(now, &event);
            *known = translate::known(session.known(), limits.filter(|_| session.is_connected()));
            if let Some(event) = event {
                setting.note(&event);
                terms.report(&event, known, note);
            }
        }
    }

    /// A line has no time-out: TCP may delay a part of it, and a datagram contains all of it.
    fn is_mid_message(&self) -> bool {
        false
    }

    fn give_up_half(&mut self, _now: Instant, _note: &mut impl FnMut(&Event<'_>)) {}

    fn tick(&mut self, now: Instant) -> Option<Event<'static>> {
        if let Some(answer) = self.own_answer.take() {
            return Some(Event::Answered(answer));
        }
        loop {
            let event = self.session.tick(now);
            let limits = self.limits.filter(|_| self.session.is_connected());
            self.known = translate::known(self.session.known(), limits);
            let event = event?;
            self.setting.note(&event);
            if let Some(event) = self.terms.of_time(&event) {
                return Some(event);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }

    fn encode_next(&mut self, now: Instant, _lent: Option<Command<'_>>) -> Option<usize> {
        let request = self.session.poll_transmit(now)?;
        self.name = request.name();
        // It fits, and the session has checked it.
        Some(request.write_line_into(&mut self.line).unwrap_or(0))
    }

    fn encoded(&self) -> &[u8] {
        &self.line
    }

    #[cfg(feature = "std")]
    fn stop_message(kind: super::StopKind, buffer: &mut [u8; super::MAX_STOP_LEN]) -> usize {
        let request = match kind {
            super::StopKind::Stop => Request::Stop,
            super::StopKind::FastStop => Request::Faststop,
        };
        request.write_line_into(buffer).unwrap_or(0)
    }
}

impl Setting {
    fn note(&mut self, event: &GclEvent<'_>) {
        let is_setting = |name: &CommandName| matches!(name, CommandName::Pwt | CommandName::Clt);
        match event {
            GclEvent::Answered(Answer::Value(LineValue::Pwt(value) | LineValue::Clt(value))) => {
                *self = Self::Is(*value);
            }
            GclEvent::Answered(answer @ Answer::Err { name, .. })
                if name.command().is_some_and(|name| is_setting(&name)) =>
            {
                *self = Self::Refused(answer.status());
            }
            GclEvent::Withdrawn(name) if is_setting(name) => *self = Self::Withdrawn,
            _ => {}
        }
    }
}

impl<E> From<LineError> for Error<E> {
    fn from(error: LineError) -> Self {
        Self::from(match error {
            LineError::NotConnected => RequestError::NotConnected,
            LineError::MotionRunning => RequestError::MotionRunning,
            LineError::FastStopRunning => RequestError::FastStopRunning,
            LineError::QueueFull => RequestError::QueueFull,
            LineError::Invalid(ParseError::Range) => RequestError::Invalid(DecodeError::NotFinite),
            LineError::Invalid(_) => RequestError::Invalid(DecodeError::UndefinedValue),
        })
    }
}
