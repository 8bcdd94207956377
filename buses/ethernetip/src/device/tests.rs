//! Behaviour of the adapter, as seen by originators. Messages are hexadecimal text, where `..` stands for any byte.

mod cyclic;
mod explicit;
mod manager;

use super::*;
use crate::profile::Status;
use crate::{Client, Registers};
use core::net::Ipv4Addr;
use std::borrow::ToOwned;
use std::format;
use std::string::String;
use std::vec::Vec;

/// The identity of the wire examples.
pub(crate) const PROFILE: Profile = Profile {
    vendor_id: 1,
    device_type: 0x0C,
    product_code: 65_001,
    revision: [2, 3],
    serial_number: 123_456_789,
    product_name: "OpENer PC",
    output: 150,
    input: 100,
    configuration: 151,
    input_only: 152,
    listen_only: 153,
    register_class: Some(0x64),
    min_interval_us: 1_000,
    allows_multicast: true,
};
const _: () = assert!(PROFILE.is_valid());

const NETWORK: Network = Network {
    address: Ipv4Addr::new(192, 168, 0, 5),
    mask: Ipv4Addr::new(255, 255, 255, 0),
    gateway: Ipv4Addr::UNSPECIFIED,
    mac: [2, 0, 0, 0, 0, 5],
    speed: 100,
};

/// Address of the originator, and of another station.
pub(super) const PLC: Ipv4Addr = Ipv4Addr::new(192, 168, 0, 1);
pub(super) const OTHER: Ipv4Addr = Ipv4Addr::new(192, 168, 0, 2);

/// 4 registers of 2 bytes; register 3 cannot be written.
#[derive(Debug, Default)]
pub(super) struct Map([[u8; 2]; 4]);

impl Registers for Map {
    fn read(&mut self, instance: u16, attribute: u16, value: &mut [u8]) -> Result<usize, Status> {
        let register = self.0.get(usize::from(instance)).ok_or(Status::NoInstance)?;
        match attribute {
            1 => value.get_mut(..2).ok_or(Status::ReplyTooLarge)?.copy_from_slice(register),
            // The number is the length, which may be more than the buffer holds.
            32.. => return Ok(attribute.into()),
            _ => return Err(Status::AttributeUnsupported),
        }
        Ok(2)
    }

    fn write(&mut self, instance: u16, _: u16, value: &[u8], is_owned: bool) -> Result<(), Status> {
        let value = value.try_into().map_err(|_| Status::TooLong)?;
        match self.0.get_mut(usize::from(instance)) {
            Some(_) if is_owned => Err(Status::StateConflict),
            Some(register) if instance < 3 => {
                *register = value;
                Ok(())
            }
            _ => Err(Status::NotSettable),
        }
    }
}

#[test]
fn identifiers_are_random_and_hold_their_place() {
    // The published sequence of SplitMix64 from this seed.
    let mut random = Random(1_234_567);
    assert_eq!(random.next(), 6_457_827_717_110_365_317);
    assert_eq!(random.id(3), 0x0A81_F4A4);
}

pub(super) fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<u32> =
        hex.chars().filter(|char| !char.is_whitespace()).map(|char| char.to_digit(16).unwrap()).collect();
    digits.chunks(2).map(|pair| (pair[0] * 16 + pair[1]) as u8).collect()
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Compares hexadecimal text with a pattern.
#[track_caller]
pub(super) fn assert_like(found: &str, pattern: &str, about: &str) {
    let wanted: String = pattern.chars().filter(|char| !char.is_whitespace()).collect();
    let is_like = found.len() == wanted.len()
        && found.chars().zip(wanted.chars()).all(|(found, wanted)| wanted == '.' || wanted == found);
    assert!(is_like, "{about}\n found {found}\nwanted {wanted}");
}

/// A device, with the clock and the sessions of its clients.
pub(super) struct Rig {
    pub(super) device: Device<8, 12>,
    pub(super) registers: Map,
    pub(super) now: u64,
}

impl Rig {
    pub(super) fn new() -> Self {
        Self { device: Device::new(PROFILE, NETWORK, 1), registers: Map::default(), now: 0 }
    }

    /// A device with a session of the client 1.
    pub(super) fn with_session() -> (Self, u32) {
        let mut rig = Self::new();
        let handle = rig.register(1);
        (rig, handle)
    }

    /// Sends a frame over the client's TCP connection. Clients from 100 on are at another station.
    pub(super) fn frame(&mut self, client: u32, frame: &[u8]) -> Vec<u8> {
        let client = Client { number: client, address: if client < 100 { PLC } else { OTHER } };
        let mut answer = [0; MAX_FRAME_LEN];
        let sent = self.device.request(self.now, client, frame, &mut self.registers, &mut answer);
        sent.map_or(Vec::new(), <[u8]>::to_vec)
    }

    /// Sends a command with data. Returns status and data of the answer, or `None` without an answer.
    pub(super) fn command(
        &mut self,
        client: u32,
        command: u16,
        session: u32,
        data: &str,
    ) -> Option<(u32, Vec<u8>)> {
        let answer = self.frame(client, &frame(command, session, &bytes(data)));
        let header = answer.get(..24)?;
        assert_eq!(header[..2], command.to_le_bytes());
        assert_eq!(usize::from(u16::from_le_bytes([header[2], header[3]])), answer.len() - 24);
        assert_eq!(header[12..24], *b"contexts\0\0\0\0");
        Some((u32::from_le_bytes(header[8..12].try_into().unwrap()), answer[24..].to_vec()))
    }

    /// Registers a session and returns its handle.
    pub(super) fn register(&mut self, client: u32) -> u32 {
        let answer = self.frame(client, &frame(0x65, 0, &[1, 0, 0, 0]));
        assert_eq!(answer[8..12], [0; 4]);
        u32::from_le_bytes(answer[4..8].try_into().unwrap())
    }

    /// Sends an unconnected message. Returns the answer from its service on, followed by any further items.
    pub(super) fn message(&mut self, client: u32, session: u32, message: &str, items: &str) -> String {
        let message = bytes(message);
        let count = 2 + bytes(items).len() / 20;
        let data = format!(
            "00000000 0000 {} 00000000 b200 {} {} {items}",
            hex(&(count as u16).to_le_bytes()),
            hex(&(message.len() as u16).to_le_bytes()),
            hex(&message)
        );
        let (status, data) = self.command(client, 0x6F, session, &data).expect("messages have an answer");
        assert_eq!(status, 0);
        hex(&data[16..])
    }

    /// Opens a connection. Returns its identifier, or the answer if it is refused.
    pub(super) fn open(&mut self, client: u32, session: u32, open: &Fo) -> Result<u32, String> {
        let answer = self.message(client, session, &open.hex(), open.items);
        if bytes(&answer)[2] != 0 {
            return Err(answer);
        }
        Ok(u32::from_le_bytes(bytes(&answer[8..16]).try_into().unwrap()))
    }

    /// Receives a packet of a connection, with any data. Returns whether it is the owner's.
    pub(super) fn packet(&mut self, from: Ipv4Addr, id: u32, sequence: u32, data: &str) -> bool {
        let data = bytes(data);
        let [id, sequence] = [id, sequence].map(|number| hex(&number.to_le_bytes()));
        let len = hex(&(data.len() as u16).to_le_bytes());
        let packet = bytes(&format!("0200 0280 0800 {id} {sequence} b100 {len} {}", hex(&data)));
        self.device.receive_packet(self.now, from, &packet)
    }

    /// Receives outputs in run or idle mode. Each byte of them is the low byte of the sequence count.
    pub(super) fn outputs(&mut self, id: u32, sequence: u32, count: u16, header: u32) -> Vec<Event> {
        let (header, outputs) = (hex(&header.to_le_bytes()), hex(&[count as u8; 8]));
        self.packet(PLC, id, sequence, &format!("{} {header} {outputs}", hex(&count.to_le_bytes())));
        self.events()
    }

    pub(super) fn events(&mut self) -> Vec<Event> {
        core::iter::from_fn(|| self.device.poll(self.now)).collect()
    }

    /// Returns all datagrams that are due.
    pub(super) fn sent(&mut self) -> Vec<(SocketAddrV4, String)> {
        let mut buffer = [0; MAX_FRAME_LEN];
        let mut sent = Vec::new();
        while let Some(Transmit::Io(len, to) | Transmit::Answer(len, to)) =
            self.device.poll_transmit(self.now, &mut buffer)
        {
            sent.push((to, hex(&buffer[..len])));
        }
        sent
    }
}

/// Returns a frame of encapsulation.
pub(super) fn frame(command: u16, session: u32, data: &[u8]) -> Vec<u8> {
    let mut frame = [command.to_le_bytes(), (data.len() as u16).to_le_bytes()].concat();
    frame.extend(session.to_le_bytes());
    frame.extend(*b"\0\0\0\0contexts\0\0\0\0");
    frame.extend(data);
    frame
}

/// A Forward_Open. Pairs are of the outputs and of the inputs.
#[derive(Clone, Copy)]
pub(super) struct Fo {
    pub(super) is_large: bool,
    pub(super) serial: u16,
    pub(super) multiplier: u8,
    pub(super) rpi: [u32; 2],
    pub(super) size: [u16; 2],
    /// Flags of the connection: 4 for point-to-point, 2 for multicast, 8 for a redundant owner.
    pub(super) flags: [u16; 2],
    pub(super) transport: u8,
    pub(super) path: &'static str,
    pub(super) items: &'static str,
}

/// The exclusive owner of the wire examples.
pub(super) const OWN: Fo = Fo {
    is_large: false,
    serial: 1,
    multiplier: 1,
    rpi: [20_000; 2],
    size: [14, 14],
    flags: [4, 4],
    transport: 1,
    path: "3404 000000000000 0000 2004 2497 2c96 2c64",
    items: "",
};
pub(super) const INPUT_ONLY: Fo = Fo { size: [2, 14], path: "2004 2497 2c98 2c64", serial: 2, ..OWN };
pub(super) const LISTEN_ONLY: Fo = Fo { size: [2, 14], path: "2004 2497 2c99 2c64", serial: 3, ..OWN };
pub(super) const EXPLICIT: Fo = Fo { size: [500; 2], path: "2002 2401", transport: 0xA3, serial: 4, ..OWN };

impl Fo {
    pub(super) fn hex(&self) -> String {
        let [output, input] = [0, 1].map(|way| {
            let parameters = if self.is_large {
                hex(&[self.size[way].to_le_bytes(), (self.flags[way] << 12 | 0x0800).to_le_bytes()].concat())
            } else {
                hex(&(self.flags[way] << 12 | 0x0800 | self.size[way]).to_le_bytes())
            };
            hex(&self.rpi[way].to_le_bytes()) + &parameters
        });
        let (service, words) = (if self.is_large { 0x5B } else { 0x54 }, bytes(self.path).len() / 2);
        format!(
            "{service:02x} 02 2006 2401 0af0 30a119e4 2fa119e4 {} 0100 0df0efbe {:02x} 000000 {output} {input} \
             {:02x} {words:02x} {}",
            hex(&self.serial.to_le_bytes()),
            self.multiplier,
            self.transport,
            self.path
        )
    }
}

/// Returns a Forward_Close.
pub(super) fn close(serial: u16) -> String {
    format!("4e 02 2006 2401 0af0 {} 0100 0df0efbe 02 00 2004 2497", hex(&serial.to_le_bytes()))
}
