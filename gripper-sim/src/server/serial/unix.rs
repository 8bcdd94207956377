//! Serial lines that only Unix has: a pseudo terminal, and a Unix socket like an emulator's UART.

use super::open_device;
use rustix::fs::OFlags;
use rustix::io::FdFlags;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serial2_tokio::SerialPort as Device;
use std::io;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use tokio::net::UnixListener;
use tokio::net::unix::pipe;

/// A pseudo terminal created by the server.
///
/// `serial2_tokio` opens devices by their paths, and this end has none. Tokio's unchecked pipes read and write any descriptor.
#[derive(Debug)]
pub(super) struct Pty {
    pub(super) reader: pipe::Receiver,
    pub(super) writer: pipe::Sender,
    /// Keeps the terminal alive while clients come and go.
    pub(super) other_end: Device,
}

impl Pty {
    /// Creates a pseudo terminal and returns it with the path of its other end.
    pub(super) fn open() -> io::Result<(Self, PathBuf)> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        rustix::io::fcntl_setfd(&master, FdFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = PathBuf::from(ptsname(&master, Vec::new())?.to_str().map_err(io::Error::other)?);
        let other_end = open_device(&path)?;
        rustix::fs::fcntl_setfl(&master, OFlags::NONBLOCK)?;
        let writer = pipe::Sender::from_owned_fd_unchecked(master.try_clone()?)?;
        let reader = pipe::Receiver::from_owned_fd_unchecked(master)?;
        Ok((Self { reader, writer, other_end }, path))
    }
}

/// A listening Unix socket, whose file is removed with it.
#[derive(Debug)]
pub(super) struct Socket {
    pub(super) listener: UnixListener,
    path: PathBuf,
}

impl Socket {
    pub(super) fn bind(path: &Path) -> io::Result<Self> {
        remove_left_over(path);
        let listener = UnixListener::bind(path)?;
        Ok(Self { listener, path: path.to_owned() })
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // Another process may have removed it already.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Removes the socket file of a server that ended without doing so. Nothing accepts connections there.
fn remove_left_over(path: &Path) {
    let is_socket = std::fs::symlink_metadata(path).is_ok_and(|data| data.file_type().is_socket());
    let is_dead =
        || UnixStream::connect(path).is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused);
    if is_socket && is_dead() {
        // If this fails, the bind fails, too, and reports the cause.
        let _ = std::fs::remove_file(path);
    }
}
