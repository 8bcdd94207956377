//! Serial lines: a pseudo terminal, a Unix socket as an emulator's UART has it, or a real device.

use super::hub::{Client, Hub};
use super::lines::SerialLine;
use super::slcan;
use super::stream::{self, Pace};
use crate::port::PortKind;
use anyhow::{Context, Result, bail};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream as StdUnixStream;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::unix::pipe;
use tokio::net::{UnixListener, UnixStream};
use tokio::task::spawn_local;
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
    Terminal {
        line: Terminal,
        /// The other end of a pseudo terminal: while it is open, clients may come and go.
        _other_end: Option<OwnedFd>,
    },
    Socket(Socket),
}

impl SerialPort {
    pub(super) fn open(line: &SerialLine) -> Result<Self> {
        match line {
            SerialLine::Pty => Self::open_pty().context("no pseudo terminal can be opened"),
            SerialLine::Unix(path) => {
                let socket = Socket::bind(path)
                    .with_context(|| format!("the Unix socket {} cannot be opened", path.display()))?;
                Ok(Self { path: path.clone(), line: Open::Socket(socket) })
            }
            SerialLine::Device(path) => Self::open_device(path)
                .with_context(|| format!("the serial device {} cannot be opened", path.display())),
        }
    }

    /// What a client opens.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Serves the line, which carries the frames' bytes themselves or, by SLCAN, those of CAN frames.
    pub(super) async fn serve(self, hub: Rc<Hub>, carried: Carried) -> Result<()> {
        let name = self.path.display().to_string();
        match self.line {
            Open::Terminal { line, .. } => {
                let client = hub
                    .connect(carried.kind(), &name)
                    .context("the gripper has no place for the serial line")?;
                carried
                    .serve(&client, line.reader, line.writer)
                    .await
                    .with_context(|| format!("the serial line {name} failed"))?;
                bail!("the serial line {name} was closed")
            }
            Open::Socket(socket) => loop {
                let (stream, _) =
                    socket.listener.accept().await.with_context(|| format!("{name} accepts no more"))?;
                spawn_local(serve_client(Rc::clone(&hub), stream, name.clone(), carried));
            },
        }
    }

    fn open_pty() -> Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = PathBuf::from(ptsname(&master, Vec::new())?.to_str()?);
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let other_end = rustix::fs::open(&path, flags, Mode::empty())?;
        make_raw(&other_end)?;
        rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK)?;
        let line = Terminal::new(master)?;
        Ok(Self { path, line: Open::Terminal { line, _other_end: Some(other_end) } })
    }

    fn open_device(path: &Path) -> Result<Self> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let device = rustix::fs::open(path, flags, Mode::empty())?;
        make_raw(&device).context("it is no terminal")?;
        let line = Terminal::new(device)?;
        Ok(Self { path: path.to_owned(), line: Open::Terminal { line, _other_end: None } })
    }
}

async fn serve_client(hub: Rc<Hub>, mut stream: UnixStream, name: String, carried: Carried) {
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

/// A terminal, read and written without blocking.
///
/// Tokio has no type for terminals that goes without `unsafe`; its unchecked pipes read and write any descriptor.
#[derive(Debug)]
struct Terminal {
    reader: pipe::Receiver,
    writer: pipe::Sender,
}

impl Terminal {
    /// The terminal behind this descriptor, which does not block.
    fn new(terminal: OwnedFd) -> io::Result<Self> {
        let writer = pipe::Sender::from_owned_fd_unchecked(terminal.try_clone()?)?;
        Ok(Self { reader: pipe::Receiver::from_owned_fd_unchecked(terminal)?, writer })
    }
}

/// Every byte as it comes: no echo, no line editing, no signals.
fn make_raw(terminal: impl AsFd) -> rustix::io::Result<()> {
    let mut settings = tcgetattr(&terminal)?;
    settings.make_raw();
    settings.set_speed(BIT_RATE)?;
    tcsetattr(&terminal, OptionalActions::Now, &settings)
}

/// A listening Unix socket; its file goes with it.
#[derive(Debug)]
struct Socket {
    listener: UnixListener,
    path: PathBuf,
}

impl Socket {
    fn bind(path: &Path) -> io::Result<Self> {
        remove_left_over(path);
        let listener = UnixListener::bind(path)?;
        Ok(Self { listener, path: path.to_owned() })
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // It may have been removed by somebody else.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Removes a socket whose server ended without doing so: nobody accepts there any more.
fn remove_left_over(path: &Path) {
    let is_socket = std::fs::symlink_metadata(path).is_ok_and(|data| data.file_type().is_socket());
    let is_dead =
        || StdUnixStream::connect(path).is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused);
    if is_socket && is_dead() {
        // If that fails, so does the binding, and says why.
        let _ = std::fs::remove_file(path);
    }
}
