//! A pseudo terminal in front of the board's bus, so that a master opens it as it opens a serial port.
//!
//! It refuses parity: masters must be told 8N1 or 8N2. The emulated line knows neither rate nor parity.

use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::thread;

use anyhow::{Context, Result};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// A pseudo terminal whose other end is the board's bus.
pub struct Terminal {
    /// Of the end that a master opens.
    pub path: String,
    /// Open, so that masters may come and go.
    _other_end: File,
}

impl Terminal {
    /// A terminal whose other end is this line.
    ///
    /// # Errors
    /// When the system gives none.
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
        // Each until an end is gone.
        thread::spawn(move || io::copy(&mut from_masters, &mut line));
        thread::spawn(move || io::copy(&mut from_board, &mut to_masters));
        Ok(Self { path, _other_end: other_end })
    }
}
