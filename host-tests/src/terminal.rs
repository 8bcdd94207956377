//! A pseudo-terminal connected to the board's bus, which a master opens like a serial port.
//!
//! It rejects parity, so masters must use 8N1 or 8N2. The emulated line has neither rate nor parity.

use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::thread;

use anyhow::{Context, Result};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// A pseudo-terminal connected to the board's bus.
pub struct Terminal {
    /// Path of the end for the master.
    pub path: String,
    /// Kept open, so that masters can disconnect and reconnect.
    _other_end: File,
}

impl Terminal {
    /// Creates a terminal connected to this line.
    ///
    /// # Errors
    /// Fails when the system provides no pseudo-terminal.
    pub fn to(mut line: UnixStream) -> Result<Self> {
        let master: OwnedFd = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, vec![])?.into_string()?;
        let other_end = File::options()
            .read(true)
            .write(true)
            .open(&path)
            .with_context(|| format!("cannot open {path}"))?;
        let mut raw = tcgetattr(&other_end)?;
        raw.make_raw();
        tcsetattr(&other_end, OptionalActions::Now, &raw)?;
        let (mut from_masters, mut from_board) = (File::from(master), line.try_clone()?);
        let mut to_masters = from_masters.try_clone()?;
        // Each thread ends when either end is closed.
        thread::spawn(move || io::copy(&mut from_masters, &mut line));
        thread::spawn(move || io::copy(&mut from_board, &mut to_masters));
        Ok(Self { path, _other_end: other_end })
    }
}
