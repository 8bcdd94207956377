//! A client of any kind: its received bytes, its queued frames, and its due times.

use crate::binary::BinaryClient;
use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::gcl::TextClient;
use crate::modbus::ModbusClient;
use crate::port::{Completion, FrameBuffer, PortCounters, PortId, PortKind, Protocol};
use crate::profibus::ProfibusSlave;
use crate::time::Time;
use crate::updates::Readings;
use wsg_fieldbus::SilenceReaction;

/// A client, by protocol.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "the core allocates nothing, and neither is small")]
pub(crate) enum ProtocolClient {
    /// A client of the binary protocol.
    Binary(BinaryClient),
    /// A client of the text protocol (GCL).
    Text(TextClient),
    /// A master on Modbus/TCP.
    Modbus(ModbusClient),
    /// A master on a PROFIBUS DP line.
    Profibus(ProfibusSlave),
    /// A bus that transfers complete images.
    Images(PortId),
}

impl ProtocolClient {
    /// Takes over the settings of a running gripper.
    pub(crate) fn reconfigure(&mut self, before: &Config, config: &Config) {
        match self {
            Self::Binary(client) => client.reconfigure(before, config),
            Self::Text(client) => client.reconfigure(config),
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => {}
        }
    }

    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        match kind.protocol() {
            Protocol::Binary => Self::Binary(BinaryClient::new(id, kind, config)),
            Protocol::Text => Self::Text(TextClient::new(id, kind, config)),
            Protocol::Modbus => Self::Modbus(ModbusClient::new(id)),
            Protocol::Profibus => Self::Profibus(ProfibusSlave::new(id, config.profibus_address)),
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

    /// Returns whether the end of the connection is an error.
    pub(crate) const fn is_missed(&self) -> bool {
        match self {
            Self::Binary(client) => client.is_missed(),
            Self::Text(client) => client.is_missed(),
            // Many masters reconnect for each request; a bus has a watchdog.
            Self::Modbus(_) | Self::Profibus(_) | Self::Images(_) => false,
        }
    }

    /// Returns the reaction to the client's end for a motion that it started by the register interface.
    pub(crate) const fn reaction_to_its_end(&self, config: &Config) -> SilenceReaction {
        match self {
            // Many masters reconnect for each request.
            Self::Binary(_) | Self::Text(_) | Self::Modbus(_) => SilenceReaction::Hold,
            // The watchdog of the bus ends with its line.
            Self::Profibus(_) | Self::Images(_) => config.bus_reaction,
        }
    }

    /// Returns whether the client's byte stream has lost synchronization for good.
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

    /// Takes bytes up to the first request, or some of them, and executes the request. Returns the number of bytes
    /// taken and whether anything happened.
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

    /// Marks the end of the available bytes and executes a request that the end of a datagram completes. Returns
    /// whether anything happened.
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

    /// Processes an expired time-out of an incomplete frame or of a master, and returns whether anything happened. Call
    /// until it returns `false`.
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

    /// Ends all subscriptions of the client.
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

    /// Sends an answer of a script; script commands belong to the binary protocol.
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

    /// Returns the next complete frame or line.
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
