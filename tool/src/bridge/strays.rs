//! Removes characters that a transceiver adds before a Modbus response.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// A line without strays before its responses: the bytes 00h and FFh between a request and the first other byte. A
/// transceiver that switches over adds them, and no unit has such an address.
///
/// `tokio-modbus` takes the first byte for an address. It then expects a length that a short response never reaches. It
/// discards strays after a response itself.
#[derive(Debug)]
pub(super) struct WithoutStrays<T> {
    line: T,
    /// No byte of the response has been received.
    is_before_response: bool,
}

impl<T> WithoutStrays<T> {
    pub(super) const fn new(line: T) -> Self {
        Self { line, is_before_response: true }
    }
}

impl<T: AsyncRead + Unpin> AsyncRead for WithoutStrays<T> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        loop {
            ready!(Pin::new(&mut self.line).poll_read(context, buffer))?;
            let read = &mut buffer.filled_mut()[before..];
            let end_of_line = read.is_empty();
            let strays = read.iter().take_while(|byte| matches!(byte, 0x00 | 0xFF)).count();
            if !self.is_before_response || end_of_line || strays == 0 {
                self.is_before_response &= end_of_line;
                return Poll::Ready(Ok(()));
            }
            read.copy_within(strays.., 0);
            let left = read.len() - strays;
            buffer.set_filled(before + left);
            if left > 0 {
                self.is_before_response = false;
                return Poll::Ready(Ok(()));
            }
        }
    }
}

impl<T: AsyncWrite + Unpin> AsyncWrite for WithoutStrays<T> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.is_before_response = true;
        Pin::new(&mut self.line).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.line).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.line).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, DuplexStream, duplex};
    use tokio_modbus::client::{Client as _, rtu};
    use tokio_modbus::prelude::Slave;
    use tokio_modbus::{ExceptionCode, Request, Response};

    use super::*;

    const STRAYS: [&[u8]; 5] = [&[], &[0x00], &[0xFF], &[0x00, 0xFF, 0x00], &[0x00; 300]];
    const REQUEST_LEN: usize = 8;

    /// Responds to each request with the next of these frames, between strays.
    async fn respond(mut bridge: DuplexStream, frames: [&'static [u8]; 3], strays: &'static [u8]) {
        for frame in frames {
            let mut request = [0; REQUEST_LEN];
            bridge.read_exact(&mut request).await.unwrap();
            for bytes in [strays, frame, strays] {
                bridge.write_all(bytes).await.unwrap();
            }
        }
    }

    /// Runs in virtual time: a client that waits for missing bytes fails at once.
    #[tokio::test(start_paused = true)]
    async fn responses_between_strays_are_received() {
        let frames: [&[u8]; 3] = [
            // A value, the echo of a write, and exception 02: the address and the function would announce more bytes.
            &[0x01, 0x04, 0x02, 0x00, 0x2A, 0x38, 0xEF],
            &[0x01, 0x06, 0x00, 0x64, 0x00, 0x07, 0x89, 0xD7],
            &[0x01, 0x84, 0x02, 0xC2, 0xC1],
        ];
        for strays in STRAYS {
            let (line, bridge) = duplex(1_024);
            let serve = respond(bridge, frames, strays);
            let ask = async {
                let mut client = rtu::attach_slave(WithoutStrays::new(line), Slave(1));
                let requests = [
                    Request::ReadInputRegisters(0, 1),
                    Request::WriteSingleRegister(100, 7),
                    Request::ReadInputRegisters(9, 1),
                ];
                let mut answers = vec![];
                for request in requests {
                    answers.push(client.call(request).await.unwrap());
                }
                answers
            };
            let asked = tokio::time::timeout(Duration::from_secs(1), async { tokio::join!(ask, serve) });
            let (answers, ()) = asked.await.unwrap_or_else(|_| panic!("no response after {strays:02X?}"));
            let expected = vec![
                Ok(Response::ReadInputRegisters(vec![42])),
                Ok(Response::WriteSingleRegister(100, 7)),
                Err(ExceptionCode::IllegalDataAddress),
            ];
            assert_eq!(answers, expected, "{strays:02X?}");
        }
    }
}
