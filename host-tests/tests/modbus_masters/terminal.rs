//! A pseudo terminal in front of the board's bus, so that a master opens it as it opens a serial port.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::thread;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// A pseudo terminal whose other end is the board's bus.
pub(crate) struct Terminal {
    /// Of the end that a master opens.
    pub(crate) path: String,
    /// Open, so that masters may come and go.
    _other_end: File,
}

impl Terminal {
    pub(crate) fn to(line: UnixStream) -> Self {
        let master: OwnedFd = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let path = ptsname(&master, vec![]).unwrap().into_string().unwrap();
        let other_end = File::options().read(true).write(true).open(&path).unwrap();
        let mut raw = tcgetattr(&other_end).unwrap();
        raw.make_raw();
        tcsetattr(&other_end, OptionalActions::Now, &raw).unwrap();
        let (from_masters, from_board) = (File::from(master), line.try_clone().unwrap());
        let to_masters = from_masters.try_clone().unwrap();
        thread::spawn(move || pump(from_masters, line));
        thread::spawn(move || pump(from_board, to_masters));
        Self { path, _other_end: other_end }
    }
}

/// Copies until an end is gone.
fn pump(mut from: impl Read, mut to: impl Write) {
    let mut chunk = [0; 256];
    while let Ok(count @ 1..) = from.read(&mut chunk) {
        if to.write_all(&chunk[..count]).is_err() {
            return;
        }
    }
}
