//! Grips a part over TCP, with the blocking driver: against the virtual gripper, or a real one.
//!
//! ```text
//! cargo run -p wsg-sim -- --tcp 127.0.0.1:1000
//! cargo run -p wsg-protocol --example grip --features embedded-io -- 127.0.0.1:1000
//! ```

use std::io::{self, ErrorKind};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use embedded_io::{ErrorType, Read, ReadReady, Write};
use wsg_protocol::driver::{Error, Grip, blocking::Gripper};
use wsg_protocol::session::Signal;
use wsg_protocol::{AutoUpdate, HomingDirection, Status};

/// A TCP connection as `embedded-io` sees it.
struct Tcp(TcpStream);

impl Tcp {
    fn connect(address: &str) -> io::Result<Self> {
        let stream = TcpStream::connect(address)?;
        // A frame is one segment, and it leaves at once.
        stream.set_nodelay(true)?;
        // How long `read_ready` waits, so that the driver does not spin.
        stream.set_read_timeout(Some(Duration::from_millis(1)))?;
        Ok(Self(stream))
    }
}

impl ErrorType for Tcp {
    type Error = io::Error;
}

impl ReadReady for Tcp {
    fn read_ready(&mut self) -> io::Result<bool> {
        match self.0.peek(&mut [0]) {
            Ok(_) => Ok(true),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(false),
            Err(error) => Err(error),
        }
    }
}

impl Read for Tcp {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        io::Read::read(&mut self.0, buffer)
    }
}

impl Write for Tcp {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        io::Write::write(&mut self.0, bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        io::Write::flush(&mut self.0)
    }
}

fn main() -> Result<(), Error<io::Error>> {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:1000".into());
    let line = Tcp::connect(&address).map_err(Error::Transport)?;
    let start = Instant::now();
    // The clock may wrap, so its low 32 bits will do.
    let clock = move || wsg_protocol::Instant::from_millis(start.elapsed().as_millis() as u32);

    let mut gripper = Gripper::new(line, clock);
    gripper.connect()?;
    println!("{}", gripper.system_info()?);
    println!("{}", gripper.limits()?);
    match gripper.tag(&mut [0; 64]) {
        Ok(tag) => println!("tag: {tag}"),
        Err(Error::Refused(Status::NotAvailable)) => println!("no tag"),
        Err(error) => return Err(error),
    }
    gripper.loop_back(&[0xAA; 32])?;

    // A FAST STOP of an earlier client may be latched.
    gripper.acknowledge()?;
    gripper.home(HomingDirection::Default)?;
    gripper.set_force_limit(40.0)?;

    gripper.subscribe(Signal::Width, AutoUpdate::on_change(50));
    let grip = gripper.begin_grip(20.0, 100.0)?;
    let result = loop {
        if let Some(update) = gripper.next_update(100)? {
            println!("{update:?}");
        }
        if let Some(result) = gripper.poll(&grip)? {
            break result;
        }
    };
    match result {
        Grip::Held => println!("a part is held, {:.2} mm wide", gripper.width()?),
        Grip::NoPart => println!("no part"),
    }
    gripper.release(60.0, 200.0)?;
    println!("{}", gripper.statistics(false)?);
    gripper.announce_disconnect()
}
