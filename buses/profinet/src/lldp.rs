//! LLDP: announces the device to its neighbour, so that engineering tools can draw the topology.

use crate::cursor::Writer;
use crate::frame::{self, ETHERTYPE_LLDP, MacAddress};
use crate::station::{IpParameters, StationName};

const MULTICAST: MacAddress = MacAddress([0x01, 0x80, 0xC2, 0, 0, 0x0E]);

/// Interval between announcements.
pub(crate) const INTERVAL_US: u64 = 5_000_000;
/// Validity of an announcement in seconds.
const TIME_TO_LIVE: u16 = 20;

/// Identifier of the only port.
pub(crate) const PORT_ID: &[u8] = b"port-001";

/// 100BASE-TX in full duplex.
pub(crate) const MAU_TYPE: u16 = 16;

mod field {
    pub(super) const CHASSIS: u16 = 1;
    pub(super) const PORT: u16 = 2;
    pub(super) const TTL: u16 = 3;
    pub(super) const MANAGEMENT: u16 = 8;
    pub(super) const ORGANISATION: u16 = 127;
}

const SUBTYPE_MAC: u8 = 4;
const SUBTYPE_LOCAL: u8 = 7;
/// OUIs of PROFIBUS & PROFINET International and of IEEE 802.3.
const PNO: [u8; 3] = [0, 0x0E, 0xCF];
const IEEE_802_3: [u8; 3] = [0, 0x12, 0x0F];

/// Writes an announcement. Returns its length.
pub(crate) fn transmit(
    buffer: &mut [u8],
    mac: MacAddress,
    name: &StationName,
    ip: &IpParameters,
) -> Option<usize> {
    let mut writer = Writer::new(buffer);
    frame::header(&mut writer, MULTICAST, mac, None, ETHERTYPE_LLDP);
    if name.is_empty() {
        tlv(&mut writer, field::CHASSIS, &[&[SUBTYPE_MAC], &mac.0]);
    } else {
        tlv(&mut writer, field::CHASSIS, &[&[SUBTYPE_LOCAL], name.as_bytes()]);
    }
    tlv(&mut writer, field::PORT, &[&[SUBTYPE_LOCAL], PORT_ID]);
    tlv(&mut writer, field::TTL, &[&TIME_TO_LIVE.to_be_bytes()]);
    // Port status: neither class 2 nor class 3. Then the MAC address of the interface.
    tlv(&mut writer, field::ORGANISATION, &[&PNO, &[2, 0, 0, 0, 0]]);
    tlv(&mut writer, field::ORGANISATION, &[&PNO, &[5], &mac.0]);
    // Autonegotiation is supported and enabled; its capabilities are not listed.
    tlv(&mut writer, field::ORGANISATION, &[&IEEE_802_3, &[1, 3, 0, 0], &MAU_TYPE.to_be_bytes()]);
    if ip.is_set() {
        // IPv4 address of interface 1 by ifIndex, without an object identifier.
        tlv(&mut writer, field::MANAGEMENT, &[&[5, 1], &ip.address, &[2, 0, 0, 0, 1, 0]]);
    }
    writer.u16(0);
    frame::finish(writer)
}

fn tlv(writer: &mut Writer<'_>, kind: u16, parts: &[&[u8]]) {
    let len: usize = parts.iter().map(|part| part.len()).sum();
    writer.u16(kind << 9 | len as u16 & 0x01FF);
    parts.iter().for_each(|part| writer.bytes(part));
}
