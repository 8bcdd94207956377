//! Sockets for connections from an emulator.

use std::fs;
use std::io;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

/// Sockets in a private directory, which is removed on drop.
#[derive(Debug)]
pub(super) struct Sockets {
    directory: PathBuf,
    listeners: Vec<(&'static str, UnixListener)>,
}

impl Sockets {
    pub(super) fn bind(names: &[&'static str]) -> Result<Self> {
        static EMULATORS: AtomicU32 = AtomicU32::new(0);
        let number = EMULATORS.fetch_add(1, Ordering::Relaxed);
        let directory = std::env::temp_dir().join(format!("wsg-emulator-{}-{number}", process::id()));
        let bind = || {
            // A dead process with the same number may have left its directory.
            let _ = fs::remove_dir_all(&directory);
            fs::create_dir(&directory)?;
            let listen = |name: &&'static str| {
                let listener = UnixListener::bind(directory.join(name))?;
                listener.set_nonblocking(true)?;
                Ok((*name, listener))
            };
            names.iter().map(listen).collect::<io::Result<_>>()
        };
        let listeners = bind().with_context(|| format!("cannot make sockets in {}", directory.display()))?;
        Ok(Self { directory, listeners })
    }

    pub(super) fn directory(&self) -> &Path {
        &self.directory
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.directory.join(name)
    }

    /// Waits until the emulator connects to this socket. Returns whether it does in time.
    pub(super) fn wait(&self, name: &str, time: Duration) -> Result<bool> {
        let timeout = Timespec { tv_sec: 0, tv_nsec: time.subsec_nanos().into() };
        match poll(&mut [PollFd::new(self.listener(name)?, PollFlags::IN)], Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(error) => Err(error).context("cannot poll the sockets"),
        }
    }

    fn listener(&self, name: &str) -> io::Result<&UnixListener> {
        let named = self.listeners.iter().find(|(its, _)| *its == name);
        Ok(&named.ok_or(io::ErrorKind::NotFound)?.1)
    }

    /// Accepts the emulator's connection to this socket.
    pub(super) fn accept(&self, name: &str) -> Result<UnixStream> {
        let accept = || {
            let (connection, _) = self.listener(name)?.accept()?;
            connection.set_nonblocking(false)?;
            Ok::<_, io::Error>(connection)
        };
        accept().with_context(|| format!("the emulator has not connected its {name}"))
    }
}

impl Drop for Sockets {
    fn drop(&mut self) {
        // Failure is harmless: the directory is one for temporary files.
        let _ = fs::remove_dir_all(&self.directory);
    }
}
