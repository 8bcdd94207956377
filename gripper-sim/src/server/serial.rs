//! Serial lines: a real device and, on Unix, a pseudo terminal or a Unix socket.

#[cfg(unix)]
mod unix;

use super::hub::{ClientHandle, Hub};
use super::lines::SerialLine;
use super::open_line::{OpenLine, Place};
use super::slcan;
use crate::port::PortKind;
use anyhow::{Context, Result, bail};
use fieldbus_host::stream::{self, FlowControl};
use serial2_tokio::SerialPort as Device;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncWrite};
use wsg_protocol::can::Identifiers;

/// Bit rate of the RS-232 interface, with 8 data bits, no parity and one stop bit.
const BIT_RATE: u32 = 115_200;

/// An open serial line.
#[derive(Debug)]
pub(super) struct SerialPort {
    path: PathBuf,
    line: Open,
}

#[derive(Debug)]
enum Open {
    Device(Device),
    #[cfg(unix)]
    Pty(unix::Pty),
    #[cfg(unix)]
    Socket(unix::Socket),
}

impl SerialPort {
    pub(super) fn open(line: &SerialLine) -> Result<Self> {
        match line {
            #[cfg(unix)]
            SerialLine::Pty => {
                let (pty, path) = unix::Pty::open().context("no pseudo terminal can be opened")?;
                Ok(Self { path, line: Open::Pty(pty) })
            }
            #[cfg(unix)]
            SerialLine::Unix(path) => {
                let socket = unix::Socket::bind(path)
                    .with_context(|| format!("the Unix socket {} cannot be opened", path.display()))?;
                Ok(Self { path: path.clone(), line: Open::Socket(socket) })
            }
            #[cfg(not(unix))]
            SerialLine::Pty => {
                bail!("no pseudo terminal can be opened: this requires Unix; expected a device, such as COM3")
            }
            #[cfg(not(unix))]
            SerialLine::Unix(path) => bail!(
                "the Unix socket {} cannot be opened: this requires Unix; expected a device, such as COM3",
                path.display()
            ),
            SerialLine::Device(path) => {
                let device = open_device(path)
                    .with_context(|| format!("the serial device {} cannot be opened", path.display()))?;
                Ok(Self { path: path.clone(), line: Open::Device(device) })
            }
        }
    }

    /// Returns the bit rate of a device. Terminals and sockets have none.
    pub(super) fn rate(&self) -> String {
        match self.line {
            Open::Device(_) => format!("{BIT_RATE} bit/s"),
            #[cfg(unix)]
            Open::Pty(_) | Open::Socket(_) => String::new(),
        }
    }

    /// Returns the path that a client opens.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the line, which carries the bytes of frames or telegrams, or CAN frames by SLCAN.
    pub(super) fn into_line(self, name: &'static str, carried: Carried) -> OpenLine {
        OpenLine::new(name, Place::Path(self.path.clone()), move |hub| self.serve(hub, carried))
    }

    async fn serve(self, hub: Arc<Hub>, carried: Carried) -> Result<()> {
        let name = self.path.display().to_string();
        match self.line {
            Open::Device(device) => {
                let (reader, writer) = tokio::io::split(device);
                serve_terminal(&hub, reader, writer, &name, carried).await
            }
            #[cfg(unix)]
            Open::Pty(unix::Pty { reader, writer, other_end: _open }) => {
                serve_terminal(&hub, reader, writer, &name, carried).await
            }
            #[cfg(unix)]
            Open::Socket(socket) => loop {
                let (stream, _) = fieldbus_host::accept::insist(|| socket.listener.accept()).await;
                tokio::task::spawn_local(serve_client(Arc::clone(&hub), stream, name.clone(), carried));
            },
        }
    }
}

/// Serves a line that has no end in normal operation.
async fn serve_terminal(
    hub: &Arc<Hub>,
    reader: impl AsyncRead + Unpin,
    writer: impl AsyncWrite + Unpin,
    name: &str,
    carried: Carried,
) -> Result<()> {
    let client = hub
        .connect(carried.kind(), name)
        .context("all client places are taken; none is left for the serial line")?;
    carried.serve(&client, reader, writer).await.with_context(|| format!("the serial line {name} failed"))?;
    bail!("the serial line {name} was closed")
}

#[cfg(unix)]
async fn serve_client(hub: Arc<Hub>, mut stream: tokio::net::UnixStream, name: String, carried: Carried) {
    let Some(client) = hub.connect(carried.kind(), &name) else { return };
    let (reader, writer) = stream.split();
    // The client has disconnected in either case.
    let _ = carried.serve(&client, reader, writer).await;
}

/// The contents of a serial line.
#[derive(Clone, Copy, Debug)]
pub(super) enum Carried {
    /// The frames of the gripper, byte by byte.
    Bytes,
    /// CAN frames with SLCAN encoding.
    Slcan(Identifiers, slcan::Side),
    /// Telegrams of PROFIBUS DP.
    Profibus,
}

impl Carried {
    const fn kind(self) -> PortKind {
        match self {
            Self::Bytes => PortKind::Serial,
            Self::Slcan(..) => PortKind::Can,
            Self::Profibus => PortKind::Profibus,
        }
    }

    async fn serve(
        self,
        client: &ClientHandle,
        reader: impl AsyncRead + Unpin,
        writer: impl AsyncWrite + Unpin,
    ) -> io::Result<()> {
        match self {
            Self::Bytes | Self::Profibus => stream::serve(client, reader, writer, FlowControl::Absent).await,
            Self::Slcan(identifiers, side) => slcan::serve(client, reader, writer, identifiers, side).await,
        }
    }
}

/// Opens a device in raw mode: no echo, no line editing, no signals.
fn open_device(path: &Path) -> io::Result<Device> {
    Device::open(path, BIT_RATE)
}
