//! The line to a gripper: any transport, with a message log and a check for signals.

use std::io;
use std::time::Duration;

use anyhow::{Context, Result};
use embedded_io::{ErrorType, Read, ReadReady, Write};
use serial2::SerialPort;
use wsg_protocol::Direction;
use wsg_protocol::driver::blocking::Transport;
use wsg_protocol::driver::host::{Tcp, Udp};

use super::address::Address;
use super::record::Recorder;
use super::signals::Signals;
use super::slcan::Slcan;

/// How long a wait for the gripper lasts before keys and signals are polled.
pub(crate) const LOOK_MS: u32 = 20;

/// Serial ports: the operating system reports received bytes, except on Windows.
#[cfg(unix)]
use wsg_protocol::driver::host::PolledStream as SerialStream;
#[cfg(not(unix))]
use wsg_protocol::driver::host::Stream as SerialStream;

/// How long a read of a serial port waits where the operating system does not report received bytes.
const READ_TIMEOUT: Duration = Duration::from_millis(1);
/// Time-out for writing to a serial port.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Any transport of the driver.
trait Wire: Transport<Error = io::Error> {}

impl<T: Transport<Error = io::Error>> Wire for T {}

/// The line to a gripper.
pub(crate) struct Line {
    wire: Box<dyn Wire>,
    recorder: Option<Recorder>,
    signals: Signals,
}

impl Line {
    /// Opens the line to an address.
    pub(crate) fn open(address: &Address, recorder: Option<Recorder>, signals: Signals) -> Result<Self> {
        let wire: io::Result<Box<dyn Wire>> = match address {
            Address::Tcp(host) | Address::Gcl(host) => boxed(Tcp::connect(host.as_str())),
            Address::Udp { gripper, answer_port } => boxed(Udp::connect(gripper.as_str(), *answer_port)),
            Address::GclUdp(host) => boxed(Udp::connect(host.as_str(), 0)),
            Address::Serial { device, rate } => boxed(open_port(device, *rate).map(SerialStream::new)),
            Address::Slcan { device, kbit, identifiers } => {
                let port = open_port(device, SLCAN_RATE);
                boxed(port.and_then(|port| Slcan::open(port, *kbit, *identifiers)).map(SerialStream::new))
            }
        };
        let wire = wire.with_context(|| address.to_string())?;
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

/// Rate of the serial port of an SLCAN adapter in bit/s. USB adapters ignore it; others use it as their default.
const SLCAN_RATE: u32 = 115_200;

fn boxed(wire: io::Result<impl Wire + 'static>) -> io::Result<Box<dyn Wire>> {
    Ok(Box::new(wire?))
}

fn open_port(device: &str, rate: u32) -> io::Result<SerialPort> {
    let mut port = SerialPort::open(device, rate)?;
    port.set_read_timeout(READ_TIMEOUT)?;
    port.set_write_timeout(WRITE_TIMEOUT)?;
    // Discard bytes received earlier: they answer no request of this program.
    port.discard_input_buffer()?;
    Ok(port)
}

impl ErrorType for Line {
    type Error = io::Error;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.signals.check()?;
        self.wire.read_ready()
    }
}

impl Transport for Line {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        // A signal just before the wait does not interrupt it, so limit its length.
        self.wire.wait(at_most_ms.min(LOOK_MS))?;
        self.signals.check()
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.wire.read(buffer)?;
        self.record(Direction::FromGripper, buffer.get(..count).unwrap_or(&[]))?;
        Ok(count)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.wire.write(bytes)?;
        self.record(Direction::ToGripper, bytes.get(..count).unwrap_or(&[]))?;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.wire.flush()
    }
}
