//! Serial lines: a real device, and where there is Unix, a pseudo terminal and a Unix socket.

#[cfg(unix)]
mod unix;

#[cfg(unix)]
use super::accept;
use super::hub::{Client, Hub};
use super::lines::SerialLine;
use super::slcan;
use super::stream::{self, Pace};
use crate::port::PortKind;
use anyhow::{Context, Result, bail};
use serial2_tokio::SerialPort as Device;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncWrite};
use wsg_protocol::can::Identifiers;

/// Bits per second of the RS-232 interface, 8 data bits, no parity, one stop bit.
const BIT_RATE: u32 = 115_200;

/// A serial line that is open.
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
                bail!("no pseudo terminal can be opened: only Unix has them; expected a device, such as COM3")
            }
            #[cfg(not(unix))]
            SerialLine::Unix(path) => bail!(
                "the Unix socket {} cannot be opened: it is served on Unix alone; expected a device, such as COM3",
                path.display()
            ),
            SerialLine::Device(path) => {
                let device = open_device(path)
                    .with_context(|| format!("the serial device {} cannot be opened", path.display()))?;
                Ok(Self { path: path.clone(), line: Open::Device(device) })
            }
        }
    }

    /// What a client opens.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Serves the line, which carries the frames' bytes themselves or, by SLCAN, those of CAN frames.
    pub(super) async fn serve(self, hub: Arc<Hub>, carried: Carried) -> Result<()> {
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
                let (stream, _) = accept::insist(|| socket.listener.accept()).await;
                tokio::task::spawn_local(serve_client(Arc::clone(&hub), stream, name.clone(), carried));
            },
        }
    }
}

/// A line that has no end while all is well.
async fn serve_terminal(
    hub: &Arc<Hub>,
    reader: impl AsyncRead + Unpin,
    writer: impl AsyncWrite + Unpin,
    name: &str,
    carried: Carried,
) -> Result<()> {
    let client = hub.connect(carried.kind(), name).context("the gripper has no place for the serial line")?;
    carried.serve(&client, reader, writer).await.with_context(|| format!("the serial line {name} failed"))?;
    bail!("the serial line {name} was closed")
}

#[cfg(unix)]
async fn serve_client(hub: Arc<Hub>, mut stream: tokio::net::UnixStream, name: String, carried: Carried) {
    let Some(client) = hub.connect(carried.kind(), &name) else { return };
    let (reader, writer) = stream.split();
    // However it ends, the client is gone; that is all there is to say about it.
    let _ = carried.serve(&client, reader, writer).await;
}

/// What goes over a serial line.
#[derive(Clone, Copy, Debug)]
pub(super) enum Carried {
    /// The frames, byte by byte.
    Bytes,
    /// CAN frames by SLCAN.
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
        client: &Client,
        reader: impl AsyncRead + Unpin,
        writer: impl AsyncWrite + Unpin,
    ) -> io::Result<()> {
        match self {
            Self::Bytes | Self::Profibus => stream::serve(client, reader, writer, Pace::OfTheLine).await,
            Self::Slcan(identifiers, side) => slcan::serve(client, reader, writer, identifiers, side).await,
        }
    }
}

/// Opens a device and lets every byte pass as it is: no echo, no line editing, no signals.
fn open_device(path: &Path) -> io::Result<Device> {
    Device::open(path, BIT_RATE)
}
