//! The gripper's line and the bus during one turn of the bridge.

use std::convert::Infallible;

use bus_modbus::rtu::Character;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::BusPort;
use wsg_protocol::Command;
use wsg_protocol::frame::{Frame, OVERHEAD};

use super::action::Image;

/// The gripper's line, with room for everything.
pub(super) struct Line<'a> {
    incoming: &'a [u8],
    outgoing: Vec<u8>,
}

impl<'a> Line<'a> {
    /// A line that brings these bytes.
    pub(super) const fn bringing(incoming: &'a [u8]) -> Self {
        Self { incoming, outgoing: Vec::new() }
    }

    /// The commands that the bridge has sent.
    pub(super) fn commands(&self) -> impl Iterator<Item = Command<'_>> {
        let mut rest = &self.outgoing[..];
        std::iter::from_fn(move || {
            let [_, _, _, id, low, high, ..] = *rest else { return None };
            let (frame, behind) = rest.split_at(OVERHEAD + usize::from(u16::from_le_bytes([low, high])));
            rest = behind;
            let payload = &frame[OVERHEAD - 2..frame.len() - 2];
            Some(Command::decode(&Frame { id, payload }).expect("the bridge sends valid commands"))
        })
    }
}

impl ErrorType for Line<'_> {
    type Error = Infallible;
}

impl ReadReady for Line<'_> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.incoming.is_empty())
    }
}

impl Read for Line<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        self.incoming.read(buffer).or(Ok(0))
    }
}

impl WriteReady for Line<'_> {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Line<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.outgoing.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The bus: at most one request, and silence after it.
pub(super) struct Bus(&'static [u8]);

impl Bus {
    pub(super) const SILENT: Self = Self(&[]);

    /// Write Multiple Registers, 0 to 3.
    pub(super) fn writing(image: Image) -> Self {
        static REQUESTS: [[u8; 17]; Image::ALL.len()] = {
            let mut requests = [[0; 17]; Image::ALL.len()];
            let mut at = 0;
            while at < requests.len() {
                let [i0, i1, i2, i3, i4, i5, i6, i7] = Image::ALL[at].output().to_bytes();
                requests[at] = sealed([UNIT, 16, 0, 0, 0, 4, 8, i0, i1, i2, i3, i4, i5, i6, i7, 0, 0]);
                at += 1;
            }
            requests
        };
        Self(&REQUESTS[image as usize])
    }

    /// Read Holding Registers, the first.
    pub(super) const fn reading() -> Self {
        static REQUEST: [u8; 8] = sealed([UNIT, 3, 0, 0, 0, 1, 0, 0]);
        Self(&REQUEST)
    }
}

/// The bridge's address.
pub(super) const UNIT: u8 = 1;

/// The frame with its checksum in the last two bytes.
const fn sealed<const N: usize>(mut frame: [u8; N]) -> [u8; N] {
    let mut sum = 0xFFFF_u16;
    let mut at = 0;
    while at < N - 2 {
        sum ^= frame[at] as u16;
        let mut bit = 0;
        while bit < 8 {
            sum = if sum & 1 == 1 { sum >> 1 ^ 0xA001 } else { sum >> 1 };
            bit += 1;
        }
        at += 1;
    }
    [frame[N - 2], frame[N - 1]] = sum.to_le_bytes();
    frame
}

impl BusPort for Bus {
    fn receive(&mut self) -> Option<(Character, u32)> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some((Character::Byte(*first), 0))
    }

    fn silence_us(&mut self) -> u32 {
        1_000_000
    }

    fn send(&mut self, _: &[u8]) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use bus_modbus::rtu;

    #[test]
    fn requests_have_their_checksum() {
        for Bus(frame) in [Bus::writing(Image::GripGently), Bus::reading()] {
            let (body, sum) = frame.split_at(frame.len() - 2);
            assert_eq!(sum, rtu::crc(body).to_le_bytes());
        }
    }

    #[test]
    fn images_are_in_order() {
        for image in Image::ALL {
            assert_eq!(Image::ALL[image as usize], image);
        }
    }
}
