//! The message router (volume 1, chapter 2): explicit messages to objects.

use core::net::SocketAddrV4;

use super::Device;
use super::objects::class;
use crate::connection::Client;
use crate::cursor::{Reader, Writer};
use crate::forward_open::{Failure, Open, Served, Triad, exact_path};
use crate::path::Target;
use crate::profile::{Profile, Registers, Status};
use crate::state::Reset;

mod service {
    pub(super) const GET_ALL: u8 = 0x01;
    pub(super) const RESET: u8 = 0x05;
    pub(super) const GET_SINGLE: u8 = 0x0E;
    pub(super) const SET_SINGLE: u8 = 0x10;
    pub(super) const FORWARD_CLOSE: u8 = 0x4E;
    pub(super) const UNCONNECTED_SEND: u8 = 0x52;
    pub(super) const FORWARD_OPEN: u8 = 0x54;
    pub(super) const LARGE_FORWARD_OPEN: u8 = 0x5B;
}

/// Bit of a service in an answer.
const ANSWER: u8 = 0x80;

/// Circumstances of a message.
pub(super) struct Context<'a> {
    pub(super) now: u64,
    pub(super) client: Client,
    /// Socket address for cyclic data to the originator, if the originator gives one; after the opening, the group if any.
    pub(super) target: Option<SocketAddrV4>,
    pub(super) registers: &'a mut dyn Registers,
    /// The connection that the message opens or closes.
    pub(super) triad: Option<Triad>,
    /// Whether the message has opened a connection with cyclic data.
    pub(super) has_opened_io: bool,
}

/// A request to an object.
#[derive(Clone, Copy, Debug)]
struct Request<'a> {
    service: u8,
    path: &'a [u8],
    data: &'a [u8],
}

impl<'a> Request<'a> {
    /// Parses a message. Returns `None` if its path is incomplete.
    fn parse(message: &'a [u8]) -> Option<Self> {
        let mut reader = Reader::new(message);
        let (service, words) = (reader.u8()?, reader.u8()?);
        let path = reader.bytes(usize::from(words).saturating_mul(2))?;
        Some(Self { service, path, data: reader.rest() })
    }

    /// Returns the request embedded in an Unconnected_Send, or this request if it is of another service.
    fn unwrapped(&self, profile: &Profile) -> Result<Self, Status> {
        let manager = Target { class: class::CONNECTION_MANAGER, instance: 1, attribute: None };
        if self.service != service::UNCONNECTED_SEND || Target::parse(self.path, profile)? != manager {
            return Ok(*self);
        }
        let mut reader = Reader::new(self.data);
        let mut embedded = || {
            let (_tick, _ticks, len) = (reader.u8()?, reader.u8()?, reader.u16()?);
            let message = reader.bytes(len.into())?;
            // A pad byte after an odd length.
            reader.bytes(usize::from(len & 1))?;
            let (words, _reserved) = (reader.u8()?, reader.u8()?);
            Some((message, words))
        };
        let (message, words) = embedded().ok_or(Status::TooShort)?;
        // The route leads here, wherever it began.
        exact_path(&reader, words)?;
        Self::parse(message).ok_or(Status::PathSegment)
    }
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Executes a message. Returns the length of the answer, or `None` if the message is incomplete or the buffer too short
    /// even for a refusal.
    pub(super) fn serve(
        &mut self,
        context: &mut Context<'_>,
        message: &[u8],
        answer: &mut [u8],
    ) -> Option<usize> {
        let outer = Request::parse(message)?;
        let mut out = Writer::new(answer);
        let (service, result) = match outer.unwrapped(&self.profile) {
            Ok(request) => {
                out.bytes(&[request.service | ANSWER, 0, 0, 0]);
                (request.service, self.route(context, &request, &mut out))
            }
            Err(status) => (outer.service, Err(status.into())),
        };
        let failure = match (result, out.finish()) {
            (Ok(()), Some(len)) => return Some(len),
            (Ok(()), None) => Status::ReplyTooLarge.into(),
            (Err(failure), _) => failure,
        };
        let (status, words) = match failure {
            Failure::Status(status) => (status, [None; 2]),
            Failure::Connection(code, right) => (Status::ConnectionFailure, [Some(code), right]),
        };
        let words = words.into_iter().flatten();
        let mut out = Writer::new(answer);
        out.bytes(&[service | ANSWER, 0, status as u8, words.clone().count() as u8]);
        words.for_each(|word| out.u16(word));
        if let Some(triad) = context.triad {
            out.bytes(&triad);
            // No path remains.
            out.u16(0);
        }
        out.finish()
    }

    fn route(&mut self, context: &mut Context<'_>, request: &Request<'_>, out: &mut Writer<'_>) -> Served {
        let target = Target::parse(request.path, &self.profile)?;
        if self.profile.register_class.is_some_and(|class| target.class == class.into()) {
            return Ok(self.registers(context, request, &target, out)?);
        }
        self.find(&target)?;
        match (request.service, target.class, target.instance) {
            (service::FORWARD_OPEN | service::LARGE_FORWARD_OPEN, class::CONNECTION_MANAGER, 1) => {
                let open = Open::parse(request.data, request.service == service::LARGE_FORWARD_OPEN)?;
                self.open(context, &open, out)
            }
            (service::FORWARD_CLOSE, class::CONNECTION_MANAGER, 1) => self.close(context, request.data, out),
            // Data of a read is ignored: some clients append an empty route.
            (service::GET_SINGLE, ..) => Ok(self.attribute(&target, out)?),
            (service::GET_ALL, class, 1..) => Ok(self.all(class, out)?),
            // All attributes are read-only: an explicit message must never set outputs. Missing ones have their own status.
            (service::SET_SINGLE, ..) => {
                self.attribute(&target, &mut Writer::new(&mut []))?;
                Err(Status::NotSettable.into())
            }
            (service::RESET, class::IDENTITY, 1) => Ok(self.reset(request.data)?),
            _ => Err(Status::ServiceUnsupported.into()),
        }
    }

    /// Serves the application's class.
    fn registers(
        &mut self,
        context: &mut Context<'_>,
        request: &Request<'_>,
        target: &Target,
        out: &mut Writer<'_>,
    ) -> Result<(), Status> {
        let instance = u16::try_from(target.instance).map_err(|_| Status::NoInstance)?;
        let attribute = target.attribute.and_then(|number| u16::try_from(number).ok());
        let attribute = attribute.ok_or(Status::AttributeUnsupported)?;
        match request.service {
            service::GET_SINGLE => out.bytes_with(|value| context.registers.read(instance, attribute, value)),
            service::SET_SINGLE => {
                let is_owned = self.owner().is_some();
                context.registers.write(instance, attribute, request.data, is_owned)
            }
            _ => Err(Status::ServiceUnsupported),
        }
    }

    fn reset(&mut self, data: &[u8]) -> Result<(), Status> {
        let kind = match data {
            [] | [0] => Reset::Restart,
            [1] => Reset::Factory,
            [_] => return Err(Status::InvalidValue),
            _ => return Err(Status::TooLong),
        };
        if self.owner().is_some() {
            return Err(Status::StateConflict);
        }
        self.pending.reset = Some(kind);
        Ok(())
    }
}
