//! Captures (pcap and pcapng): conversations with grippers over TCP and UDP.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::net::{IpAddr, SocketAddr};

use anyhow::{Context, Result, bail};
use etherparse::{EtherType, LaxNetSlice, LaxSlicedPacket, TransportSlice};
use pcap_parser::traits::PcapNGPacketBlock;
use pcap_parser::{Block, Linktype, PcapBlockOwned, PcapError, create_reader};
use wsg_protocol::Direction;
use wsg_protocol::frame::{PREAMBLE_BYTE, PREAMBLE_LEN};
use wsg_protocol::gcl::{Answer, Request};

use super::entry::{self, Entry};
use super::tcp::{Stream, Stretch};

/// The gripper's factory ports: TCP, UDP, and the UDP port to which it sends answers.
const TCP_PORT: u16 = 1000;
const UDP_PORT: u16 = 1500;
const UDP_REMOTE_PORT: u16 = 1501;

/// Magic numbers: pcapng, and pcap in either byte order with microsecond or nanosecond time stamps.
const BEGINNINGS: [[u8; 4]; 5] = [
    [0x0A, 0x0D, 0x0D, 0x0A],
    [0xD4, 0xC3, 0xB2, 0xA1],
    [0xA1, 0xB2, 0xC3, 0xD4],
    [0x4D, 0x3C, 0xB2, 0xA1],
    [0xA1, 0xB2, 0x3C, 0x4D],
];

/// Returns whether a file is a pcap or pcapng capture.
pub(crate) fn is_capture(bytes: &[u8]) -> bool {
    BEGINNINGS.iter().any(|beginning| bytes.starts_with(beginning))
}

/// A captured packet with its link type and time.
struct Packet {
    link: Linktype,
    /// Time stamp in seconds, if the capture has one.
    time: Option<f64>,
    bytes: Vec<u8>,
}

/// The transport protocol of a conversation.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Transport {
    Tcp,
    Udp,
}

/// The two endpoints of a conversation, the lower address first.
type Ends = (Transport, SocketAddr, SocketAddr);

/// The data exchanged between two endpoints.
#[derive(Default)]
struct Conversation {
    /// Streams sent by the lower endpoint and by the upper one.
    streams: [Stream; 2],
    /// Datagrams: packet, whether the lower endpoint sent it, bytes.
    datagrams: Vec<(usize, bool, Vec<u8>)>,
    /// Whether the lower endpoint opened the connection, if known.
    opened_by_lower: Option<bool>,
    has_data: [bool; 2],
}

/// The entries found, with their packets.
#[derive(Default)]
struct Found {
    entries: Vec<(usize, Entry)>,
    times: Vec<Option<f64>>,
}

/// Decodes a capture. With `port`, only conversations on that gripper port are decoded.
pub(crate) fn decode(file: Vec<u8>, port: Option<u16>, gcl: Option<bool>) -> Result<Vec<Entry>> {
    let (packets, end) = packets(file)?;
    let mut found = Found { entries: Vec::new(), times: packets.iter().map(|packet| packet.time).collect() };
    let mut open: BTreeMap<Ends, Conversation> = BTreeMap::new();
    let mut closed = Vec::new();
    let mut other_packets = 0;
    for (at, packet) in packets.iter().enumerate() {
        if !take(packet, at, &mut open, &mut closed) {
            other_packets += 1;
        }
    }
    closed.extend(open);
    let mut left_out = BTreeSet::new();
    for (ends, conversation) in closed {
        found.add(ends, conversation, port, gcl, &mut left_out);
    }
    found.entries.sort_by_key(|(packet, _)| *packet);
    let mut entries: Vec<Entry> = found.entries.into_iter().map(|(_, entry)| entry).collect();
    let mut note = |words: String| entries.push(Entry::note(String::new(), words));
    if other_packets > 0 {
        note(format!(
            "skipped {}: not TCP or UDP over IP, fragmented, or truncated before the payload",
            entry::count(other_packets, "packet")
        ));
    }
    if !left_out.is_empty() {
        let ports: Vec<String> = left_out.iter().map(u16::to_string).collect();
        note(format!(
            "skipped conversations without a gripper, on port {}; pass --port to select one",
            ports.join(", ")
        ));
    }
    if let Some(end) = end {
        note(end);
    }
    Ok(entries)
}

/// Reads the packets. Also returns a remark if the file ends abnormally.
fn packets(file: Vec<u8>) -> Result<(Vec<Packet>, Option<String>)> {
    // Buffer the whole file, so that only its end can be incomplete.
    let capacity = file.len() + 1;
    let is_ng = file.starts_with(&BEGINNINGS[0]);
    let beginning = if is_ng { "first block" } else { "header" };
    let mut reader = create_reader(capacity, Cursor::new(file))
        .ok()
        .with_context(|| format!("the {beginning} of the capture is corrupted"))?;
    let mut packets = Vec::new();
    let mut link = Linktype::NULL;
    let mut fraction = 1e-6;
    // For pcapng: link type, time offset and resolution of each interface in the section.
    let mut interfaces: Vec<(Linktype, i64, Option<u64>)> = Vec::new();
    let mut is_at_end = false;
    loop {
        let len = match reader.next() {
            Ok((len, block)) => {
                match block {
                    PcapBlockOwned::LegacyHeader(header) => {
                        link = header.network;
                        fraction = if header.is_nanosecond_precision() { 1e-9 } else { 1e-6 };
                    }
                    PcapBlockOwned::Legacy(block) => packets.push(Packet {
                        link,
                        time: Some(f64::from(block.ts_sec) + f64::from(block.ts_usec) * fraction),
                        bytes: block.data.to_vec(),
                    }),
                    PcapBlockOwned::NG(Block::SectionHeader(_)) => interfaces.clear(),
                    PcapBlockOwned::NG(Block::InterfaceDescription(it)) => {
                        interfaces.push((it.linktype, it.ts_offset(), it.ts_resolution()));
                    }
                    PcapBlockOwned::NG(Block::EnhancedPacket(block)) => {
                        let interface = interfaces.get(block.if_id as usize);
                        let (link, offset, resolution) =
                            interface.copied().unwrap_or((Linktype::NULL, 0, None));
                        let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
                        let time = resolution
                            .filter(|it| *it > 0)
                            .map(|it| ticks as f64 / it as f64 + offset as f64);
                        packets.push(Packet { link, time, bytes: block.packet_data().to_vec() });
                    }
                    PcapBlockOwned::NG(Block::SimplePacket(block)) => {
                        let link = interfaces.first().map_or(Linktype::NULL, |(link, ..)| *link);
                        packets.push(Packet { link, time: None, bytes: block.packet_data().to_vec() });
                    }
                    PcapBlockOwned::NG(_) => {}
                }
                len
            }
            Err(PcapError::Eof) => return Ok((packets, None)),
            Err(PcapError::Incomplete(_)) if !is_at_end => {
                is_at_end = true;
                if reader.refill().is_err() {
                    bail!("cannot read the capture");
                }
                continue;
            }
            Err(_) => {
                let words = format!("the capture is truncated or corrupted after packet {}", packets.len());
                return Ok((packets, Some(words)));
            }
        };
        reader.consume_noshift(len);
    }
}

/// Adds a packet to its conversation. Returns false if it is neither TCP nor UDP.
fn take(
    packet: &Packet,
    at: usize,
    open: &mut BTreeMap<Ends, Conversation>,
    closed: &mut Vec<(Ends, Conversation)>,
) -> bool {
    let Some(sliced) = sliced(packet) else { return false };
    let (from, to): (IpAddr, IpAddr) = match &sliced.net {
        Some(LaxNetSlice::Ipv4(ip)) => {
            (ip.header().source_addr().into(), ip.header().destination_addr().into())
        }
        Some(LaxNetSlice::Ipv6(ip)) => {
            (ip.header().source_addr().into(), ip.header().destination_addr().into())
        }
        _ => return false,
    };
    let (transport, ports) = match &sliced.transport {
        Some(TransportSlice::Tcp(tcp)) => (Transport::Tcp, (tcp.source_port(), tcp.destination_port())),
        Some(TransportSlice::Udp(udp)) => (Transport::Udp, (udp.source_port(), udp.destination_port())),
        _ => return false,
    };
    let (from, to) = (SocketAddr::new(from, ports.0), SocketAddr::new(to, ports.1));
    let is_from_lower = from <= to;
    let ends = if is_from_lower { (transport, from, to) } else { (transport, to, from) };
    match &sliced.transport {
        Some(TransportSlice::Tcp(tcp)) => {
            let side = usize::from(!is_from_lower);
            // A new connection between the endpoints of an earlier one.
            let is_new = tcp.syn() && !tcp.ack();
            if is_new && open.get(&ends).is_some_and(|it| it.has_data != [false; 2]) {
                closed.extend(open.remove_entry(&ends));
            }
            let conversation = open.entry(ends).or_default();
            if tcp.syn() {
                conversation.opened_by_lower = Some(is_from_lower == is_new);
            }
            let [lower, upper] = &mut conversation.streams;
            let own = if is_from_lower { lower } else { upper };
            if tcp.syn() {
                own.start(tcp.sequence_number());
            } else if !tcp.payload().is_empty() {
                own.receive(at, tcp.sequence_number(), tcp.payload());
                if let Some(has_data) = conversation.has_data.get_mut(side) {
                    *has_data = true;
                }
            }
        }
        Some(TransportSlice::Udp(udp)) => {
            let conversation = open.entry(ends).or_default();
            conversation.datagrams.push((at, is_from_lower, udp.payload().to_vec()));
        }
        _ => {}
    }
    true
}

/// Parses the headers of a packet, as far as they were captured.
fn sliced(packet: &Packet) -> Option<LaxSlicedPacket<'_>> {
    let bytes = packet.bytes.as_slice();
    match packet.link {
        Linktype::ETHERNET => LaxSlicedPacket::from_ethernet(bytes).ok(),
        // Linux cooked capture v1 and v2: the header ends or begins with an EtherType.
        Linktype(113) => of_ether_type(bytes.get(14..16)?, bytes.get(16..)?),
        Linktype(276) => of_ether_type(bytes.get(..2)?, bytes.get(20..)?),
        // Loopback: an address family precedes the packet.
        Linktype::NULL | Linktype(108) => LaxSlicedPacket::from_ip(bytes.get(4..)?).ok(),
        Linktype(12 | 14 | 101 | 228 | 229) => LaxSlicedPacket::from_ip(bytes).ok(),
        _ => None,
    }
}

fn of_ether_type<'a>(ether_type: &[u8], rest: &'a [u8]) -> Option<LaxSlicedPacket<'a>> {
    let [high, low] = *ether_type else { return None };
    Some(LaxSlicedPacket::from_ether_type(EtherType(u16::from_be_bytes([high, low])), rest))
}

impl Found {
    /// Formats a packet's number, and its time relative to the first packet if known.
    fn time(&self, packet: usize) -> String {
        let first = self.times.iter().flatten().next();
        match (self.times.get(packet).copied().flatten(), first) {
            (Some(time), Some(first)) => format!("#{} {:.6} s", packet + 1, time - first),
            _ => format!("#{}", packet + 1),
        }
    }

    fn add(
        &mut self,
        (transport, lower, upper): Ends,
        conversation: Conversation,
        port: Option<u16>,
        gcl: Option<bool>,
        left_out: &mut BTreeSet<u16>,
    ) {
        let Conversation { streams, datagrams, opened_by_lower, .. } = conversation;
        let [of_lower, of_upper] = streams;
        let repeated = of_lower.repeated + of_upper.repeated;
        let stretches = [of_lower.finish(), of_upper.finish()];
        let is_gripper = |end: SocketAddr| match (port, transport) {
            (Some(port), _) => end.port() == port,
            (None, Transport::Tcp) => end.port() == TCP_PORT,
            (None, Transport::Udp) => end.port() == UDP_PORT,
        };
        let answers_to_lower = port.is_none()
            && transport == Transport::Udp
            && lower.port() == UDP_REMOTE_PORT
            && !is_gripper(lower);
        let is_of_a_gripper = is_gripper(lower) || is_gripper(upper);
        let has_gripper_data = || {
            let datagrams = datagrams.iter().map(|(.., bytes)| bytes.as_slice());
            let streams = stretches.iter().flatten().map(|stretch| stretch.bytes.as_slice());
            streams.chain(datagrams).any(is_gripper_data)
        };
        let has_data = !datagrams.is_empty() || stretches.iter().any(|it| !it.is_empty());
        if !has_data {
            return;
        }
        if !(is_of_a_gripper || port.is_none() && has_gripper_data()) {
            left_out.insert(lower.port().min(upper.port()));
            return;
        }
        // A gripper never opens a connection. If neither port nor SYN identifies it, assume the lower port.
        let gripper_is_upper = match (is_gripper(lower), is_gripper(upper), opened_by_lower) {
            (true, false, _) => false,
            (false, true, _) => true,
            (_, _, Some(by_lower)) => by_lower,
            _ => answers_to_lower || upper.port() < lower.port(),
        };
        let direction = |is_from_lower: bool| {
            if is_from_lower == gripper_is_upper { Direction::ToGripper } else { Direction::FromGripper }
        };
        let way = |is_from_lower: bool| {
            let (from, to) = if is_from_lower { (lower, upper) } else { (upper, lower) };
            let name = if transport == Transport::Tcp { "tcp" } else { "udp" };
            format!("{name} {from} > {to}")
        };
        for (packet, is_from_lower, bytes) in datagrams {
            let place = format!("{} {}", self.time(packet), way(is_from_lower));
            let entries = decoded(&bytes, gcl, direction(is_from_lower), |_| place.clone());
            self.entries.extend(entries.into_iter().map(|entry| (packet, entry)));
        }
        let mut last_packet = 0;
        for (stretches, is_from_lower) in stretches.iter().zip([true, false]) {
            // Detect the protocol per direction, because a piece may hold only part of a line.
            let is_gcl = gcl.unwrap_or_else(|| stretches.iter().all(|stretch| entry::is_gcl(&stretch.bytes)));
            for stretch in stretches {
                let last = self.add_stretch(stretch, is_gcl, direction(is_from_lower), &way(is_from_lower));
                last_packet = last_packet.max(last);
            }
        }
        if repeated > 0 {
            let segments = entry::count(repeated, "TCP segment");
            let words = format!("skipped {segments} retransmitted between {lower} and {upper}");
            self.entries.push((last_packet, Entry::note(String::new(), words)));
        }
    }

    /// Adds the entries of a piece of a stream, and returns their last packet.
    fn add_stretch(&mut self, stretch: &Stretch, is_gcl: bool, direction: Direction, way: &str) -> usize {
        if stretch.missing_before > 0 {
            let packet = stretch.packet_of(0);
            let missing = entry::count(stretch.missing_before as usize, "byte");
            let words = format!("{missing} of the stream missing from the capture");
            self.entries.push((packet, Entry::note(format!("{} {way}", self.time(packet)), words)));
        }
        let mut packets = Vec::new();
        let place = |range: std::ops::Range<usize>| {
            let packet = stretch.packet_of(range.end.saturating_sub(1));
            packets.push(packet);
            let offset = stretch.offset + range.start as u64;
            format!("{} {way} @{offset:08X}", self.time(packet))
        };
        let entries = decoded(&stretch.bytes, Some(is_gcl), direction, place);
        let last = packets.iter().copied().max().unwrap_or(0);
        self.entries.extend(packets.into_iter().zip(entries));
        last
    }
}

fn decoded(
    bytes: &[u8],
    gcl: Option<bool>,
    direction: Direction,
    place: impl FnMut(std::ops::Range<usize>) -> String,
) -> Vec<Entry> {
    let is_gcl = gcl.unwrap_or_else(|| entry::is_gcl(bytes));
    let decode = if is_gcl { entry::of_gcl } else { entry::of_binary };
    decode(bytes, Some(direction), place)
}

/// Returns whether bytes contain a preamble or begin with a GCL line.
fn is_gripper_data(bytes: &[u8]) -> bool {
    let line = bytes.split(|byte| matches!(byte, b'\r' | b'\n')).find(|line| !line.trim_ascii().is_empty());
    let is_line = |line: &[u8]| Request::parse(line).is_ok() || Answer::parse(line).is_ok();
    bytes.windows(PREAMBLE_LEN).any(|window| window == [PREAMBLE_BYTE; PREAMBLE_LEN])
        || line.is_some_and(is_line)
}
