//! Transports to grippers at any address.

use std::io;
use std::time::Duration;

#[cfg(unix)]
use rustix::fs::{FlockOperation, flock};
#[cfg(unix)]
use rustix::io::Errno;
use serial2::{IntoSettings, KeepSettings, SerialPort};
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
        Address::Serial { device, rate } => serial(open_port(device, *rate, false)?)?,
        Address::Slcan { device, kbit, identifiers } => {
            let port = open_port(device, slcan::PORT_RATE, false)?;
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

/// Opens a serial port with 8N1, for this program alone or with others that share it. Fails if another program's use forbids that.
pub(crate) fn open_port(device: &str, rate: u32, is_alone: bool) -> io::Result<SerialPort> {
    let mut port = SerialPort::open(device, KeepSettings)?;
    // Before the settings change: the other program uses them.
    lock(&port, is_alone)?;
    let mut settings = port.get_configuration()?;
    rate.apply_to_settings(&mut settings)?;
    port.set_configuration(&settings)?;
    port.set_read_timeout(READ_TIMEOUT)?;
    port.set_write_timeout(WRITE_TIMEOUT)?;
    // Discard bytes received earlier: they answer no request of this program.
    port.discard_input_buffer()?;
    Ok(port)
}

#[cfg(unix)]
fn lock(port: &SerialPort, is_alone: bool) -> io::Result<()> {
    let operation = if is_alone {
        FlockOperation::NonBlockingLockExclusive
    } else {
        FlockOperation::NonBlockingLockShared
    };
    flock(port, operation).map_err(|error| match error {
        Errno::WOULDBLOCK => io::Error::new(io::ErrorKind::ResourceBusy, "another program uses this port"),
        _ => error.into(),
    })
}

/// Windows opens each port for one program alone.
#[cfg(not(unix))]
fn lock(_: &SerialPort, _: bool) -> io::Result<()> {
    Ok(())
}
