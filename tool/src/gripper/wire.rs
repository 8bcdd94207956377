//! Transports to grippers at any address.

use std::io;
use std::time::Duration;

use serial2::SerialPort;
use wsg_protocol::driver::Stoppable;
use wsg_protocol::driver::blocking::Transport;
#[cfg(unix)]
use wsg_protocol::driver::host::PolledStream;
use wsg_protocol::driver::host::{Stream, Tcp, Udp};

use super::address::Address;
use super::slcan::{self, Slcan};

/// How long a read of a serial port waits where the operating system does not report received bytes.
const READ_TIMEOUT: Duration = Duration::from_millis(1);
/// Time-out for writing to a serial port.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// Rate of the serial port of an SLCAN adapter in bit/s. USB adapters ignore it; others use it as their default.
const SLCAN_RATE: u32 = 115_200;

/// Any transport of the blocking driver whose gripper can be stopped from another thread.
pub trait Wire: Transport<Error = io::Error> + Stoppable + Send {}

impl<T: Transport<Error = io::Error> + Stoppable + Send> Wire for T {}

/// Opens the transport to an address.
///
/// # Errors
/// Returns the error of the socket or of the serial port.
pub fn open(address: &Address) -> io::Result<Box<dyn Wire>> {
    Ok(match address {
        Address::Tcp(host) | Address::Gcl { gripper: host, .. } => Box::new(Tcp::connect(host.as_str())?),
        Address::Udp { gripper, answer_port } => Box::new(Udp::connect(gripper.as_str(), *answer_port)?),
        Address::GclUdp { gripper, .. } => Box::new(Udp::connect(gripper.as_str(), 0)?),
        Address::Serial { device, rate } => serial(open_port(device, *rate)?)?,
        Address::Slcan { device, kbit, identifiers } => {
            let port = open_port(device, SLCAN_RATE)?;
            let second = slcan::Encoder::new(port.try_clone()?, *identifiers);
            Box::new(Stream::with_second(Slcan::open(port, *kbit, *identifiers)?, second))
        }
    })
}

#[cfg(unix)]
fn serial(port: SerialPort) -> io::Result<Box<dyn Wire>> {
    Ok(Box::new(PolledStream::new(port)))
}

/// The operating system does not report bytes received by a serial port.
#[cfg(not(unix))]
fn serial(port: SerialPort) -> io::Result<Box<dyn Wire>> {
    let second = port.try_clone()?;
    Ok(Box::new(Stream::with_second(port, second)))
}

fn open_port(device: &str, rate: u32) -> io::Result<SerialPort> {
    let mut port = SerialPort::open(device, rate)?;
    port.set_read_timeout(READ_TIMEOUT)?;
    port.set_write_timeout(WRITE_TIMEOUT)?;
    // Discard bytes received earlier: they answer no request of this program.
    port.discard_input_buffer()?;
    Ok(port)
}
