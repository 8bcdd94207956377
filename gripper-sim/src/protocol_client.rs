//! The clients of all protocols. In a browser, that is the binary one alone.

use crate::binary::BinaryClient;
use crate::client::Client;
use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
#[cfg(not(target_family = "wasm"))]
use crate::gcl::TextClient;
#[cfg(not(target_family = "wasm"))]
use crate::modbus::ModbusClient;
use crate::port::{FrameBuffer, PortCounters, PortId, PortKind, Protocol};
#[cfg(not(target_family = "wasm"))]
use crate::profibus::ProfibusSlave;
use crate::time::Time;
use core::ops::{Deref, DerefMut};
use wsg_fieldbus::SilenceReaction;

/// A client, by protocol.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "the core allocates nothing, and neither is small")]
pub(crate) enum ProtocolClient {
    /// A client of the binary protocol.
    Binary(BinaryClient),
    /// A client of the text protocol (GCL).
    #[cfg(not(target_family = "wasm"))]
    Text(TextClient),
    /// A master on Modbus/TCP.
    #[cfg(not(target_family = "wasm"))]
    Modbus(ModbusClient),
    /// A master on a PROFIBUS DP line.
    #[cfg(not(target_family = "wasm"))]
    Profibus(ProfibusSlave),
    /// A bus that transfers complete images.
    Images(ImageBus),
}

impl ProtocolClient {
    pub(crate) fn new(id: PortId, kind: PortKind, config: &Config) -> Self {
        match kind.protocol() {
            Protocol::Binary => Self::Binary(BinaryClient::new(id, kind, config)),
            #[cfg(not(target_family = "wasm"))]
            Protocol::Text => Self::Text(TextClient::new(id, kind, config)),
            #[cfg(not(target_family = "wasm"))]
            Protocol::Modbus => Self::Modbus(ModbusClient::new(id)),
            #[cfg(not(target_family = "wasm"))]
            Protocol::Profibus => Self::Profibus(ProfibusSlave::new(id, config.profibus_address)),
            // Without lines, no client speaks another protocol, and a page loads faster.
            #[cfg(target_family = "wasm")]
            Protocol::Text | Protocol::Modbus | Protocol::Profibus => Self::Images(ImageBus(id)),
            Protocol::Images => Self::Images(ImageBus(id)),
        }
    }

    /// Returns whether the master of the client sends its outputs cyclically.
    pub(crate) const fn has_cyclic_outputs(&self) -> bool {
        match self {
            Self::Images(_) => true,
            #[cfg(not(target_family = "wasm"))]
            Self::Profibus(_) => true,
            _ => false,
        }
    }

    /// Returns the address of the PROFIBUS master that has locked the slave, if any.
    pub(crate) fn profibus_master(&self) -> Option<u8> {
        match self {
            #[cfg(not(target_family = "wasm"))]
            Self::Profibus(slave) => slave.master(),
            _ => None,
        }
    }
}

impl Deref for ProtocolClient {
    type Target = dyn Client;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Binary(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Text(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Modbus(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Profibus(client) => client,
            Self::Images(client) => client,
        }
    }
}

impl DerefMut for ProtocolClient {
    fn deref_mut(&mut self) -> &mut Self::Target {
        match self {
            Self::Binary(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Text(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Modbus(client) => client,
            #[cfg(not(target_family = "wasm"))]
            Self::Profibus(client) => client,
            Self::Images(client) => client,
        }
    }
}

/// A bus that transfers complete images. It has no bytes and no frames here.
#[derive(Clone, Debug)]
pub(crate) struct ImageBus(PortId);

impl Client for ImageBus {
    fn id(&self) -> PortId {
        self.0
    }

    fn counters(&self) -> PortCounters {
        PortCounters::default()
    }

    fn reaction_to_its_end(&self, config: &Config) -> SilenceReaction {
        config.bus_reaction
    }

    fn receive(&mut self, _: &mut Device, _: &mut Fieldbus, _: Time, bytes: &[u8]) -> (usize, bool) {
        (bytes.len(), false)
    }

    fn has_frame(&self) -> bool {
        false
    }

    fn next_frame<'a>(&mut self, _: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        None
    }
}
