//! Only the parser: finds the frames among received bytes, on any target, without a session and without allocation.

use wsg_protocol::{Event, FrameParser, Reply};

/// Noise, then the gripper's answer to Grip Part: E_CMD_PENDING.
const RECEIVED: [u8; 12] = [0x00, 0xAA, 0xAA, 0xAA, 0xAA, 0x25, 0x02, 0x00, 0x1A, 0x00, 0x6D, 0x48];

fn main() {
    let mut parser = FrameParser::<64>::new();
    for byte in RECEIVED {
        if let Some(Event::Frame(frame)) = parser.push(byte) {
            match Reply::decode(&frame) {
                Ok(reply) => println!("{reply}"),
                Err(error) => println!("{:02X}h: {error}", frame.id),
            }
        }
    }
}
