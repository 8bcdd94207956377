//! Ethernet addresses, headers and payloads.

use core::fmt;

use crate::cursor::{Reader, Writer};

/// Maximum length of a sent Ethernet frame in bytes, without its checksum.
pub const MAX_FRAME_LEN: usize = 1_514;

/// Minimum length of an Ethernet frame in bytes, without its checksum.
pub(crate) const MIN_FRAME_LEN: usize = 60;

/// Ethertype of PROFINET: DCP, cyclic data and alarms.
pub(crate) const ETHERTYPE_PROFINET: u16 = 0x8892;
pub(crate) const ETHERTYPE_LLDP: u16 = 0x88CC;
/// Ethertype of a VLAN tag, IEEE 802.1Q.
const ETHERTYPE_VLAN: u16 = 0x8100;

/// An Ethernet MAC address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MacAddress(pub [u8; 6]);

impl fmt::Display for MacAddress {
    /// Formats the address with colons, such as `02:00:5e:00:00:01`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, last] = self.0;
        write!(f, "{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{last:02x}")
    }
}

/// A received frame without VLAN tag and checksum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame<'a> {
    pub(crate) destination: MacAddress,
    pub(crate) source: MacAddress,
    pub(crate) ethertype: u16,
    pub(crate) payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Parses a frame, with or without a VLAN tag.
    pub(crate) fn parse(bytes: &'a [u8]) -> Option<Self> {
        let mut reader = Reader::new(bytes);
        let destination = MacAddress(reader.array()?);
        let source = MacAddress(reader.array()?);
        let mut ethertype = reader.u16()?;
        if ethertype == ETHERTYPE_VLAN {
            reader.skip(2)?;
            ethertype = reader.u16()?;
        }
        Some(Self { destination, source, ethertype, payload: reader.rest() })
    }
}

/// Writes the header of a frame. `tag` is the tag control information of a VLAN tag.
pub(crate) fn header(
    writer: &mut Writer<'_>,
    destination: MacAddress,
    source: MacAddress,
    tag: Option<u16>,
    ethertype: u16,
) {
    writer.bytes(&destination.0);
    writer.bytes(&source.0);
    if let Some(tag) = tag {
        writer.u16(ETHERTYPE_VLAN);
        writer.u16(tag);
    }
    writer.u16(ethertype);
}

/// Pads a frame to the minimum length. Returns its length.
pub(crate) fn finish(mut writer: Writer<'_>) -> Option<usize> {
    writer.fill(0, MIN_FRAME_LEN.saturating_sub(writer.len()));
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn address_is_formatted_with_colons() {
        assert_eq!(MacAddress([0x02, 0, 0x5E, 0xAB, 0, 0x01]).to_string(), "02:00:5e:ab:00:01");
    }
}
