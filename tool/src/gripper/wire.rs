//! Transports to grippers at any address.

use std::fs::File;
use std::io;
use std::time::Duration;

#[cfg(unix)]
use rustix::fs::{FlockOperation, flock};
#[cfg(unix)]
use rustix::io::Errno;
use serial2::{IntoSettings, KeepSettings, SerialPort};
use wsg_protocol::can::Identifiers;
use wsg_protocol::driver::Stoppable;
use wsg_protocol::driver::blocking::Transport;
#[cfg(unix)]
use wsg_protocol::driver::host::PolledStream;
use wsg_protocol::driver::host::{Stream, Tcp, Udp};

use super::address::Address;
use super::can::{self, CanStream, Carrier, Encoder};

/// How long a read of a serial port or a CAN interface waits where the operating system does not report received bytes.
const READ_TIMEOUT: Duration = Duration::from_millis(1);
/// Time-out for writing to a serial port or a CAN interface.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Any transport of the blocking driver whose gripper can be stopped from another thread.
pub trait Wire: Transport<Error = io::Error> + Stoppable + Send {}

impl<T: Transport<Error = io::Error> + Stoppable + Send> Wire for T {}

/// Opens the transport to an address.
///
/// # Errors
/// Returns the error of the socket, the serial port or the CAN interface.
pub fn open(address: &Address) -> io::Result<Box<dyn Wire>> {
    Ok(match address {
        Address::Tcp(host) | Address::Gcl { gripper: host, .. } => Box::new(Tcp::connect(host.as_str())?),
        Address::Udp { gripper, answer_port } => Box::new(Udp::connect(gripper.as_str(), *answer_port)?),
        Address::GclUdp { gripper, .. } => Box::new(Udp::connect(gripper.as_str(), 0)?),
        Address::Serial { device, rate } => serial(open_port(device, *rate, false)?)?,
        Address::Slcan { device, kbit, identifiers } => {
            let mut port = open_port(device, can::PORT_RATE, false)?;
            can::open_channel(&mut port, *kbit)?;
            let second = port.try_clone()?;
            on_can(port, second, Carrier::Slcan, *identifiers)
        }
        Address::SocketCan { interface, identifiers } => {
            let interface = open_interface(interface, *identifiers, true)?;
            let second = interface.try_clone()?;
            on_can(interface, second, Carrier::SocketCan, *identifiers)
        }
    })
}

fn on_can<P>(port: P, second: P, carrier: Carrier, identifiers: Identifiers) -> Box<dyn Wire>
where
    P: io::Read + io::Write + Send + 'static,
{
    let second = Encoder::new(second, carrier, identifiers);
    Box::new(Stream::with_second(CanStream::new(port, carrier, identifiers), second))
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

/// Opens a CAN interface for the frames of a gripper, for an echo of each own frame after the bus has taken it, and for a report that
/// its controller has left the bus. Reads and writes wait only if `waits`.
#[cfg(target_os = "linux")]
pub(crate) fn open_interface(name: &str, identifiers: Identifiers, waits: bool) -> io::Result<File> {
    use std::os::fd::AsFd;

    use socketcan::{CanSocket, Socket, SocketOptions};

    /// Bits that a received frame must share with a filter: the identifier, and the flags of extended and remote frames.
    const FILTERED: u32 = 0xC000_07FF;
    /// Error of a controller that has left the bus.
    const BUS_OFF: u32 = 0x40;

    let open = || {
        let socket = CanSocket::open(name)?;
        let side = identifiers.controller();
        socket.set_filters(&[side.transmit, side.receive].map(|id| (id.as_raw().into(), FILTERED)))?;
        socket.set_error_filter(BUS_OFF)?;
        socket.set_recv_own_msgs(true)?;
        socket.set_nonblocking(!waits)?;
        socket.set_read_timeout(READ_TIMEOUT)?;
        socket.set_write_timeout(WRITE_TIMEOUT)?;
        socket.as_fd().try_clone_to_owned()
    };
    let opened: io::Result<_> = open();
    let opened = opened.map_err(|error| {
        io::Error::new(error.kind(), format!("the CAN interface {name} cannot be opened: {error}"))
    });
    opened.map(File::from)
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn open_interface(_: &str, _: Identifiers, _: bool) -> io::Result<File> {
    Err(io::Error::new(io::ErrorKind::Unsupported, "SocketCAN requires Linux"))
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
