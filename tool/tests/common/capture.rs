//! Builder for capture files: Ethernet packets, 1 ms apart.
#![allow(dead_code, reason = "each test uses only a part")]

use etherparse::PacketBuilder;

pub(crate) const CLIENT: [u8; 4] = [192, 168, 1, 5];
pub(crate) const GRIPPER: [u8; 4] = [192, 168, 1, 20];

/// A little-endian pcap file with microsecond time stamps, under construction.
pub(crate) struct Capture {
    file: Vec<u8>,
    now_us: u32,
}

impl Capture {
    pub(crate) fn new() -> Self {
        let mut file = vec![0xD4, 0xC3, 0xB2, 0xA1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        file.extend([0, 0, 4, 0, 1, 0, 0, 0]);
        Self { file, now_us: 0 }
    }

    pub(crate) fn into_file(self) -> Vec<u8> {
        self.file
    }

    pub(crate) fn packet(&mut self, bytes: &[u8]) {
        self.now_us += 1_000;
        let len = bytes.len() as u32;
        for word in [1_700_000_000 + self.now_us / 1_000_000, self.now_us % 1_000_000, len, len] {
            self.file.extend(word.to_le_bytes());
        }
        self.file.extend(bytes);
    }

    pub(crate) fn udp(&mut self, from: ([u8; 4], u16), to: ([u8; 4], u16), payload: &[u8]) {
        let mut bytes = Vec::new();
        let builder = PacketBuilder::ethernet2([2; 6], [4; 6]).ipv4(from.0, to.0, 64).udp(from.1, to.1);
        builder.write(&mut bytes, payload).unwrap();
        self.packet(&bytes);
    }
}

/// A TCP connection from a client to a gripper, with initial sequence numbers 1000 and 5000.
pub(crate) struct Connection {
    /// TCP port of the gripper.
    pub(crate) port: u16,
    /// Next sequence numbers of the client and of the gripper.
    pub(crate) next: [u32; 2],
}

impl Connection {
    pub(crate) fn open(capture: &mut Capture, port: u16) -> Self {
        let connection = Self { port, next: [1_000, 5_000] };
        connection.segment(capture, true, 999, None, true, &[]);
        connection.segment(capture, false, 4_999, Some(1_000), true, &[]);
        connection
    }

    /// Sends bytes in segments of at most `most` bytes, which acknowledge everything received from the other side.
    pub(crate) fn send(&mut self, capture: &mut Capture, to_gripper: bool, bytes: &[u8], most: usize) {
        let (own, other) = if to_gripper { (0, 1) } else { (1, 0) };
        for payload in bytes.chunks(most) {
            self.segment(capture, to_gripper, self.next[own], Some(self.next[other]), false, payload);
            self.next[own] += payload.len() as u32;
        }
    }

    /// Writes one segment with the given sequence and acknowledgement numbers.
    pub(crate) fn segment(
        &self,
        capture: &mut Capture,
        to_gripper: bool,
        sequence: u32,
        acknowledged: Option<u32>,
        syn: bool,
        payload: &[u8],
    ) {
        let (client, gripper) = ((CLIENT, 40_000), (GRIPPER, self.port));
        let (from, to) = if to_gripper { (client, gripper) } else { (gripper, client) };
        let ip = PacketBuilder::ethernet2([2; 6], [4; 6]).ipv4(from.0, to.0, 64);
        let mut tcp = ip.tcp(from.1, to.1, sequence, 8_192);
        if let Some(number) = acknowledged {
            tcp = tcp.ack(number);
        }
        if syn {
            tcp = tcp.syn();
        }
        let mut bytes = Vec::new();
        tcp.write(&mut bytes, payload).unwrap();
        capture.packet(&bytes);
    }
}
