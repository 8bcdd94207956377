//! Attributes of the objects: Identity, Assembly (volume 1, chapter 5), TCP/IP Interface, Ethernet Link, QoS (volume 2,
//! chapter 5).

use core::net::{Ipv4Addr, SocketAddrV4};

use super::{Device, INACTIVITY_S};
use crate::cursor::Writer;
use crate::encapsulation::PORT;
use crate::forward_open::Kind;
use crate::path::Target;
use crate::profile::{Profile, Status};
use crate::state::State;

/// Differentiated services code points (DSCP) by the attributes of the QoS object: urgent, scheduled, high and low
/// priority, explicit messages. Senders of cyclic data use the second one, TCP connections the last one.
pub const DSCP: [u8; 5] = [55, 47, 43, 31, 27];

pub(super) mod class {
    pub(crate) const IDENTITY: u32 = 0x01;
    pub(crate) const MESSAGE_ROUTER: u32 = 0x02;
    pub(crate) const ASSEMBLY: u32 = 0x04;
    pub(crate) const CONNECTION_MANAGER: u32 = 0x06;
    pub(crate) const QOS: u32 = 0x48;
    pub(crate) const TCP_IP: u32 = 0xF5;
    pub(crate) const ETHERNET_LINK: u32 = 0xF6;
}

impl<const OUT: usize, const IN: usize> Device<OUT, IN> {
    /// Checks that class and instance exist. Returns revision, maximum instance and number of instances of the class.
    pub(super) fn find(&self, target: &Target) -> Result<[u16; 3], Status> {
        let Profile { output, input, configuration, input_only, listen_only, .. } = self.profile;
        let assemblies = [output, input, configuration, input_only, listen_only];
        let (facts, is_there) = match target.class {
            class::ASSEMBLY => {
                let highest = assemblies.iter().copied().max().unwrap_or(0);
                ([2, highest, 5], assemblies.iter().any(|number| u32::from(*number) == target.instance))
            }
            class::TCP_IP | class::ETHERNET_LINK => ([4, 1, 1], target.instance == 1),
            class::IDENTITY | class::MESSAGE_ROUTER | class::CONNECTION_MANAGER | class::QOS => {
                ([1, 1, 1], target.instance == 1)
            }
            _ => return Err(Status::PathUnknown),
        };
        if is_there || target.instance == 0 { Ok(facts) } else { Err(Status::NoInstance) }
    }

    /// Writes an attribute of an instance, or of the class as instance 0.
    pub(super) fn attribute(&self, target: &Target, out: &mut Writer<'_>) -> Result<(), Status> {
        let Self { profile, network, .. } = self;
        let facts = self.find(target)?;
        if target.instance == 0 {
            let index = target.attribute.and_then(|number| usize::try_from(number).ok()?.checked_sub(1));
            out.u16(*index.and_then(|index| facts.get(index)).ok_or(Status::AttributeUnsupported)?);
            return Ok(());
        }
        match (target.class, target.attribute.unwrap_or(0)) {
            (class::IDENTITY, 1) => out.u16(profile.vendor_id),
            (class::IDENTITY, 2) => out.u16(profile.device_type),
            (class::IDENTITY, 3) => out.u16(profile.product_code),
            (class::IDENTITY, 4) => out.bytes(&profile.revision),
            (class::IDENTITY, 5) => out.u16(self.status()),
            (class::IDENTITY, 6) => out.u32(profile.serial_number),
            (class::IDENTITY, 7) => {
                let name = profile.product_name.as_bytes();
                let name = name.get(..32).unwrap_or(name);
                out.u8(name.len() as u8);
                out.bytes(name);
            }
            // Operational.
            (class::IDENTITY, 8) => out.u8(3),
            (class::ASSEMBLY, 3) => out.bytes(self.assembly(target.instance)),
            (class::ASSEMBLY, 4) => out.u16(self.assembly(target.instance).len() as u16),
            // Status: configured. No capability to be configured, static configuration.
            (class::TCP_IP, 1) => out.u32(1),
            (class::TCP_IP, 2 | 3) => out.u32(0),
            // Path to the Ethernet link object.
            (class::TCP_IP, 4) => out.bytes(&[2, 0, 0x20, 0xF6, 0x24, 1]),
            (class::TCP_IP, 5) => {
                let none = Ipv4Addr::UNSPECIFIED;
                for address in [network.address, network.mask, network.gateway, none, none] {
                    out.u32(address.to_bits());
                }
                // No domain name.
                out.u16(0);
            }
            // No host name.
            (class::TCP_IP, 6) => out.u16(0),
            // Time to live of multicast, and its configuration: one group of the standard's algorithm, or none.
            (class::TCP_IP, 8) => out.u8(1),
            (class::TCP_IP, 9) => {
                let group = profile.allows_multicast.then(|| network.group().to_bits());
                out.u16(0);
                out.u16(group.is_some().into());
                out.u32(group.unwrap_or(0));
            }
            (class::TCP_IP, 13) => out.u16(INACTIVITY_S),
            (class::ETHERNET_LINK, 1) => out.u32(network.speed),
            // Link up; full duplex and successfully negotiated if the speed is known.
            (class::ETHERNET_LINK, 2) => out.u32(if network.speed > 0 { 0x0F } else { 1 }),
            (class::ETHERNET_LINK, 3) => out.bytes(&network.mac),
            // Twisted pair.
            (class::ETHERNET_LINK, 7) => out.u8(2),
            // Negotiation; the supported pair of speed and duplex mode, if known.
            (class::ETHERNET_LINK, 11) => {
                out.u32(2);
                out.u8((network.speed > 0).into());
                if network.speed > 0 {
                    out.u16(u16::try_from(network.speed).unwrap_or(u16::MAX));
                    out.u8(1);
                }
            }
            (class::QOS, number @ 4..=8) => {
                let index = number.saturating_sub(4) as usize;
                out.bytes(DSCP.get(index..=index).unwrap_or(&[]));
            }
            _ => return Err(Status::AttributeUnsupported),
        }
        Ok(())
    }

    /// Writes all attributes of the only instance of a class. Attributes that do not exist have their defaults.
    pub(super) fn all(&self, class: u32, out: &mut Writer<'_>) -> Result<(), Status> {
        let parts: &[(u32, u32, &[u8])] = match class {
            class::IDENTITY => &[(1, 7, &[])],
            // Safety network number; address conflict detection, quick connect.
            class::TCP_IP => &[(1, 6, &[0; 6]), (8, 9, &[0; 37]), (13, 13, &[])],
            // Counters and control; states enabled, no label.
            class::ETHERNET_LINK => &[(1, 3, &[0; 96]), (7, 7, &[1, 1, 0]), (11, 11, &[])],
            _ => return Err(Status::ServiceUnsupported),
        };
        for (first, last, defaults) in parts {
            for attribute in *first..=*last {
                self.attribute(&Target { class, instance: 1, attribute: Some(attribute) }, out)?;
            }
            out.bytes(defaults);
        }
        Ok(())
    }

    /// Returns the status of the Identity object: whether the device is owned, and the extended device status.
    fn status(&self) -> u16 {
        let extended = match self.state() {
            State::Run => 6,
            // All connections are idle, the last one has timed out, or there was no connection.
            _ if self.connections().any(|it| it.kind != Kind::Explicit) => 7,
            _ if self.has_timed_out => 2,
            _ => 3,
        };
        (extended << 4) | u16::from(self.owner().is_some())
    }

    fn assembly(&self, instance: u32) -> &[u8] {
        match u16::try_from(instance) {
            Ok(number) if number == self.profile.output => &self.outputs,
            Ok(number) if number == self.profile.input => &self.inputs,
            _ => &[],
        }
    }

    /// Writes the item of ListIdentity (volume 2, chapter 2).
    pub(super) fn identity(&self, out: &mut Writer<'_>) {
        // Version of the protocol.
        out.u16(1);
        out.socket_address(SocketAddrV4::new(self.network.address, PORT));
        // Identity has all its attributes.
        let _ = self.all(class::IDENTITY, out);
        out.u8(3);
    }
}
