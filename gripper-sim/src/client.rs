//! A client of any kind, as the gripper sees it: bytes in, frames out, and what is due for it.

use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{Completion, FrameBuffer, PortCounters, PortId, PortKind, Protocol};
use crate::time::Time;
use crate::updates::Readings;
use crate::{binary, gcl, modbus, profibus};
use wsg_fieldbus::SilenceReaction;

/// A client, by what it speaks.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "the core allocates nothing, and neither is small")]
pub(crate) enum Client {
    /// The binary protocol.
    Binary(binary::Client),
    /// The text protocol.
    Text(gcl::Client),
    /// Modbus/TCP.
    Modbus(modbus::Client),
    /// PROFIBUS DP.
    Profibus(profibus::Client),
    /// A bus that brings whole images.
    Images(PortId),
}

impl Client {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        match kind.protocol() {
            Protocol::Binary => Self::Binary(binary::Client::new(id, kind, config)),
            Protocol::Text => Self::Text(gcl::Client::new(id, kind, config)),
            Protocol::Modbus => Self::Modbus(modbus::Client::new(id)),
            Protocol::Profibus => Self::Profibus(profibus::Client::new(id, config.profibus_address)),
            Protocol::Images => Self::Images(id),
        }
    }

    pub(crate) const fn id(&self) -> PortId {
        match self {
            Self::Binary(client) => client.id(),
            Self::Text(client) => client.id(),
            Self::Modbus(client) => client.id(),
            Self::Profibus(client) => client.id(),
            Self::Images(id) => *id,
        }
    }

    /// Whether it is an error that the client is gone.
    pub(crate) const fn is_missed(&self) -> bool {
        match self {
            Self::Binary(client) => client.is_missed(),
            Self::Text(client) => client.is_missed(),
            // Masters that connect for each request are common; a bus has a watchdog.
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => false,
        }
    }

    /// What becomes of a motion that it has begun by the register interface when it is gone.
    pub(crate) const fn reaction_to_its_end(&self, config: &Config) -> SilenceReaction {
        match self {
            // Masters that connect for each request are common.
            Self::Binary(_) | Self::Text(_) | Self::Modbus(_) => SilenceReaction::Hold,
            // The watchdog of the bus went with its line.
            Self::Profibus(_) | Self::Images(_) => config.bus_reaction,
        }
    }

    /// Whether nothing more can be understood of what the client sends.
    pub(crate) const fn is_lost(&self) -> bool {
        match self {
            Self::Binary(_) | Self::Text(_) | Self::Profibus(_) | Self::Images(_) => false,
            Self::Modbus(client) => client.is_lost(),
        }
    }

    pub(crate) fn counters(&self) -> PortCounters {
        match self {
            Self::Binary(client) => client.counters(),
            Self::Text(client) => client.counters(),
            Self::Modbus(client) => client.counters(),
            Self::Profibus(client) => client.counters(),
            Self::Images(_) => PortCounters::default(),
        }
    }

    /// Takes bytes up to the first request, or some of them, and carries the request out; returns how many bytes it took
    /// and whether anything happened.
    pub(crate) fn receive(
        &mut self,
        device: &mut Device,
        fieldbus: &mut Fieldbus,
        now: Time,
        bytes: &[u8],
    ) -> (usize, bool) {
        match self {
            Self::Binary(client) => client.receive(device, now, bytes),
            Self::Text(client) => client.receive(device, now, bytes),
            Self::Modbus(client) => client.receive(device, fieldbus, now, bytes),
            Self::Profibus(client) => client.receive(device, fieldbus, now, bytes),
            Self::Images(_) => (bytes.len(), false),
        }
    }

    /// Notes that no more bytes follow for now, and carries out what a datagram ends; returns whether anything happened.
    pub(crate) fn pause(&mut self, device: &mut Device, now: Time) -> bool {
        match self {
            Self::Binary(client) => {
                client.pause(now);
                false
            }
            Self::Text(client) => client.pause(device, now),
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => false,
        }
    }

    /// Ends the wait for the rest of a frame, or for a master, if its time is over; returns whether anything happened. Call until nothing
    /// does.
    pub(crate) fn expire(&mut self, device: &mut Device, fieldbus: &mut Fieldbus, now: Time) -> bool {
        match self {
            Self::Binary(client) => client.expire(device, now),
            Self::Text(client) => {
                client.expire(now);
                false
            }
            Self::Modbus(_) | Self::Images(_) => false,
            Self::Profibus(client) => client.expire(device, fieldbus, now),
        }
    }

    /// Ends what it has subscribed to.
    pub(crate) fn end_updates(&mut self) {
        match self {
            Self::Binary(client) => client.end_updates(),
            Self::Text(client) => client.end_updates(),
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => {}
        }
    }

    pub(crate) fn next_due(&self, now: Time) -> Option<Time> {
        match self {
            Self::Binary(client) => client.next_due(now),
            Self::Text(client) => client.next_due(now),
            Self::Modbus(_) | Self::Images(_) => None,
            Self::Profibus(client) => client.next_due(now),
        }
    }

    /// Sends the second answer to a command.
    pub(crate) fn complete(&mut self, done: Completion) {
        match self {
            Self::Binary(client) => client.complete(done),
            Self::Text(client) => client.complete(done),
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => {}
        }
    }

    /// Sends an answer of a script; its commands are those of the binary protocol.
    pub(crate) fn answer_script(&mut self, id: u8, payload: &[u8]) {
        if let Self::Binary(client) = self {
            client.answer_script(id, payload);
        }
    }

    /// Sends the updates that are due.
    pub(crate) fn publish(&mut self, now: Time, readings: &Readings) {
        match self {
            Self::Binary(client) => client.publish(now, readings),
            Self::Text(client) => client.publish(now, readings),
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => {}
        }
    }

    pub(crate) fn has_frame(&self) -> bool {
        match self {
            Self::Binary(client) => client.has_frame(),
            Self::Text(client) => client.has_line(),
            Self::Modbus(client) => client.has_frame(),
            Self::Profibus(client) => client.has_frame(),
            Self::Images(_) => false,
        }
    }

    /// The next frame, or line, whole.
    pub(crate) fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        match self {
            Self::Binary(client) => client.next_frame(buffer),
            Self::Text(client) => client.next_line(buffer),
            Self::Modbus(client) => client.next_frame(buffer),
            Self::Profibus(client) => client.next_frame(buffer),
            Self::Images(_) => None,
        }
    }
}
