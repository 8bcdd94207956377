//! Serial lines: a pseudo terminal, a Unix socket as an emulator's UART has it, or a real device.

use super::hub::Hub;
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
use tokio::net::unix::pipe;
use tokio::net::{UnixListener, UnixStream};
use tokio::task::spawn_local;

/// Bits per second of the RS-232 interface, 8 data bits, no parity, one stop bit.
const BIT_RATE: u32 = 115_200;

/// A serial line that is to be served.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialLine {
    /// A pseudo terminal, made for the purpose.
    Pty,
    /// A Unix socket at this path, to which clients connect.
    Unix(PathBuf),
    /// A terminal device that exists, such as `/dev/ttyUSB0`; set to 115200 8N1.
    Device(PathBuf),
}

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

    pub(super) async fn serve(self, hub: Rc<Hub>) -> Result<()> {
        let name = self.path.display().to_string();
        match self.line {
            Open::Terminal { line, .. } => {
                let client = hub
                    .connect(PortKind::Serial, &name)
                    .context("the gripper has no place for the serial line")?;
                stream::serve(&client, line.reader, line.writer, Pace::OfTheLine)
                    .await
                    .with_context(|| format!("the serial line {name} failed"))?;
                bail!("the serial line {name} was closed")
            }
            Open::Socket(socket) => loop {
                let (stream, _) =
                    socket.listener.accept().await.with_context(|| format!("{name} accepts no more"))?;
                spawn_local(serve_client(Rc::clone(&hub), stream, name.clone()));
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

async fn serve_client(hub: Rc<Hub>, mut stream: UnixStream, name: String) {
    let Some(client) = hub.connect(PortKind::Serial, &name) else { return };
    let (reader, writer) = stream.split();
    // However it ends, the client is gone; that is all there is to say about it.
    let _ = stream::serve(&client, reader, writer, Pace::OfTheLine).await;
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
