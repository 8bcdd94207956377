//! A CAN controller that is none: frames over a serial line, by SLCAN. For a board or an emulator without CAN.

use bus_slcan::{ClassicFrame, Decoder, Encoded, Line, encode};
use embedded_io::{Read, ReadReady, Write, WriteReady};

use super::{CanController, Health};

/// Frames over a serial line. The bridge is the adapter's side, but it answers nothing and lets frames through from the
/// start: hosts do not wait for answers, and nobody has to open what is no adapter.
#[derive(Debug)]
pub struct SlcanPort<L> {
    line: L,
    decoder: Decoder,
    /// What is being sent, and how much of it has left.
    sending: Option<(Encoded, usize)>,
}

/// A line was no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MalformedLine;

impl embedded_can::Error for MalformedLine {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Form
    }
}

impl<L> SlcanPort<L> {
    /// Frames over this line.
    pub const fn new(line: L) -> Self {
        Self { line, decoder: Decoder::new(), sending: None }
    }
}

impl<L: Read + ReadReady + Write + WriteReady> SlcanPort<L> {
    /// Sends what the line has room for.
    fn send(&mut self) {
        while let Some((line, sent)) = &mut self.sending {
            let rest = line.as_bytes().get(*sent..).unwrap_or(&[]);
            let Some(next) = rest.get(..1) else {
                self.sending = None;
                return;
            };
            if !self.line.write_ready().unwrap_or(false) || !matches!(self.line.write(next), Ok(1)) {
                return;
            }
            *sent += 1;
        }
    }
}

impl<L: Read + ReadReady + Write + WriteReady> embedded_can::nb::Can for SlcanPort<L> {
    type Frame = ClassicFrame;
    type Error = MalformedLine;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, MalformedLine> {
        self.send();
        if self.sending.is_some() {
            return Err(nb::Error::WouldBlock);
        }
        self.sending = Some((encode(frame), 0));
        self.send();
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, MalformedLine> {
        // The rest of a frame leaves while the next is not there yet.
        self.send();
        let mut byte = [0];
        while self.line.read_ready().unwrap_or(false) {
            let Ok(1) = self.line.read(&mut byte) else { break };
            let [byte] = byte;
            match self.decoder.push(byte) {
                Some(Line::Frame(frame)) => return Ok(frame),
                Some(Line::Malformed) => return Err(nb::Error::Other(MalformedLine)),
                Some(Line::Command(..) | Line::Taken(_) | Line::Done | Line::Refused) | None => {}
            }
        }
        Err(nb::Error::WouldBlock)
    }
}

impl<L: Read + ReadReady + Write + WriteReady> CanController for SlcanPort<L> {
    /// A serial line has no fault confinement.
    fn health(&mut self) -> Health {
        Health::default()
    }

    fn abort(&mut self) {
        // A line that has begun is ended: its rest would be taken for the beginning of the next.
        if self.sending.as_ref().is_some_and(|(_, sent)| *sent == 0) {
            self.sending = None;
        }
    }

    fn recover(&mut self) {}
}
