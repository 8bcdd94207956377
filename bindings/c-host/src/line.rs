//! Any line to a gripper.

use std::io;

use embedded_io::{ErrorType, Read, ReadReady, Write};
use wsg_protocol::driver::blocking::Transport;
use wsg_protocol::driver::{StopLine, Stoppable};

/// A transport whose gripper can be stopped from another thread.
trait Wire: Transport<Error = io::Error> + Stoppable + Send {}

impl<T: Transport<Error = io::Error> + Stoppable + Send> Wire for T {}

/// A TCP connection, a UDP socket or a serial port.
pub(crate) struct Line(Box<dyn Wire>);

impl Line {
    pub(crate) fn new(wire: impl Transport<Error = io::Error> + Stoppable + Send + 'static) -> Self {
        Self(Box::new(wire))
    }

    /// Opens a serial port: 8 data bits, no parity, 1 stop bit.
    pub(crate) fn serial(device: &str, rate: u32) -> io::Result<Self> {
        use std::time::Duration;
        let mut port = serial2::SerialPort::open(device, rate)?;
        port.set_read_timeout(Duration::from_millis(1))?;
        port.set_write_timeout(Duration::from_secs(1))?;
        // Earlier bytes answer no request of this program.
        port.discard_input_buffer()?;
        #[cfg(unix)]
        return Ok(Self::new(wsg_protocol::driver::host::PolledStream::new(port)));
        #[cfg(not(unix))]
        {
            let second = port.try_clone()?;
            Ok(Self::new(wsg_protocol::driver::host::Stream::with_second(port, second)))
        }
    }
}

impl ErrorType for Line {
    type Error = io::Error;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> io::Result<bool> {
        self.0.read_ready()
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Transport for Line {
    fn wait(&mut self, at_most_ms: u32) -> io::Result<()> {
        self.0.wait(at_most_ms)
    }
}

impl Stoppable for Line {
    fn stop_line(&mut self) -> io::Result<StopLine> {
        self.0.stop_line()
    }
}
