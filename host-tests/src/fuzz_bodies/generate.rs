//! Inputs for the run on stable Rust: the same ones every time.

use crate::chance::Chance;

/// What the binary protocol is made of.
pub(super) const BINARY: &[&[u8]] = &[
    &[0xAA, 0xAA, 0xAA],
    &[0xAA],
    &[0x00],
    &[0x00, 0x00],
    &[0x01],
    &[0xFF],
    &[0x1A, 0x00],
    &[0x20],
    &[0x25, 0x08, 0x00],
    &[0x40, 0x06, 0x00],
    &[0x00, 0x00, 0xA0, 0x41],
    b"ack",
];

/// What lines of text are made of.
pub(super) const TEXT: &[&[u8]] = &[
    b"\n",
    b"\r\n",
    b"()",
    b"(",
    b")",
    b"?",
    b"=",
    b",",
    b" ",
    b"[",
    b"]",
    b"\"",
    b"@",
    b"ACK ",
    b"FIN ",
    b"ERR ",
    b"MOVE",
    b"GRIP",
    b"RELEASE",
    b"HOME",
    b"POS",
    b"FORCE",
    b"AUTOSEND",
    b"GRIPSTATE",
    b"SYSFLAGS",
    b"DATA",
    b"FTYPE",
    b"VERSION",
    b"GRIPSTATS",
    b"20.0",
    b"-1.5e3",
    b"0",
    b"7",
    b"true",
    b"E_TIMEOUT",
    b"WSG 50",
    b"MOVE(50)\n",
    b"ACK MOVE\n",
    b"@POS=31.25\n",
];

/// The longest input.
const LONGEST: usize = 96;

/// The input of this number, made of chance and of these pieces.
#[must_use]
pub fn generated(number: u32, pieces: &[&[u8]]) -> Vec<u8> {
    let mut random = Chance::new(u64::from(number) << 32);
    let length = random.below(LONGEST as u64 + 1) as usize;
    // Inputs of pure chance, and of pieces: the mixture changes from one to the next.
    let chance = random.below(5);
    let mut bytes = Vec::with_capacity(length + 4);
    while bytes.len() < length {
        if random.below(5) < chance {
            bytes.push(random.below(256) as u8);
        } else {
            bytes.extend_from_slice(pieces[random.below(pieces.len() as u64) as usize]);
        }
    }
    bytes.truncate(length);
    bytes
}
