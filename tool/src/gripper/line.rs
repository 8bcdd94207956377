//! The line to a gripper: any transport, with a message log and a check for signals.

use std::io;

use anyhow::{Context, Result};
use embedded_io::{ErrorType, Read, ReadReady, Write};
use wsg_protocol::Direction;
use wsg_protocol::driver::blocking::Transport;

use super::address::Address;
use super::record::Recorder;
use super::signals::Signals;
use super::wire::{self, Wire};

/// How long a wait for the gripper lasts before keys and signals are polled.
pub(crate) const LOOK_MS: u32 = 20;

/// The connection to a gripper, over any line.
pub(crate) struct Connection {
    wire: Box<dyn Wire>,
    recorder: Option<Recorder>,
    signals: Signals,
}

impl Connection {
    /// Opens the connection to an address.
    pub(crate) fn open(address: &Address, recorder: Option<Recorder>, signals: Signals) -> Result<Self> {
        let wire = wire::open(address).with_context(|| address.to_string())?;
        Ok(Self { wire, recorder, signals })
    }

    fn record(&mut self, direction: Direction, bytes: &[u8]) -> io::Result<()> {
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let recorded = recorder.record(direction, bytes);
        if recorded.is_err() {
            // The line is still needed to stop the gripper, so continue without a log.
            self.recorder = None;
        }
        recorded
    }
}

impl ErrorType for Connection {
    type Error = io::Error;
}

impl ReadReady for Connection {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.signals.check()?;
        self.wire.read_ready()
    }
}

impl Transport for Connection {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        // A signal just before the wait does not interrupt it, so limit its length.
        self.wire.wait(at_most_ms.min(LOOK_MS))?;
        self.signals.check()
    }
}

impl Read for Connection {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.wire.read(buffer)?;
        self.record(Direction::FromGripper, buffer.get(..count).unwrap_or(&[]))?;
        Ok(count)
    }
}

impl Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.wire.write(bytes)?;
        self.record(Direction::ToGripper, bytes.get(..count).unwrap_or(&[]))?;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.wire.flush()
    }
}
