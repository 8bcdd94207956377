//! Transports that forward to another one.

use std::convert::Infallible;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write};
use wsg_protocol::HomingDirection;
use wsg_protocol::driver::blocking::{Gripper, Spinning, Transport};
use wsg_sim::{Config, PortKind};

use crate::rig::TestRig;

/// A UART without waiting, which sends at a flush. Each look at it takes a millisecond.
struct Uart {
    rig: TestRig,
    to_send: Vec<u8>,
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl Read for Uart {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        self.rig.read(buffer)
    }
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        self.rig.pass(1);
        self.rig.read_ready()
    }
}

impl Write for Uart {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.to_send.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        self.rig.write_all(&self.to_send)?;
        self.to_send.clear();
        Ok(())
    }
}

#[test]
fn uart_that_spins_homes_the_gripper() {
    let rig = TestRig::new(PortKind::Tcp, Config::default());
    let uart = Uart { rig: rig.clone(), to_send: vec![] };
    let mut gripper = Gripper::new(Spinning(uart), rig);
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Default).unwrap();
    assert!(gripper.width().unwrap().0 > 100.0);
}

/// A line whose cable is cut.
struct Cut;

impl ErrorType for Cut {
    type Error = ErrorKind;
}

impl Read for Cut {
    fn read(&mut self, _: &mut [u8]) -> Result<usize, ErrorKind> {
        Err(ErrorKind::NotConnected)
    }
}

impl ReadReady for Cut {
    fn read_ready(&mut self) -> Result<bool, ErrorKind> {
        Err(ErrorKind::NotConnected)
    }
}

impl Write for Cut {
    fn write(&mut self, _: &[u8]) -> Result<usize, ErrorKind> {
        Err(ErrorKind::NotConnected)
    }

    fn flush(&mut self) -> Result<(), ErrorKind> {
        Err(ErrorKind::NotConnected)
    }
}

impl Transport for Cut {
    fn wait(&mut self, _: u32) -> Result<(), ErrorKind> {
        Err(ErrorKind::NotConnected)
    }
}

#[test]
fn borrowed_transport_waits_like_its_owner() {
    fn wait(mut line: impl Transport<Error = ErrorKind>) -> Result<(), ErrorKind> {
        line.wait(1)
    }
    assert_eq!(wait(&mut Cut), Err(ErrorKind::NotConnected));
}
