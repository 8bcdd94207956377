//! A client on a byte stream: TCP, a Unix socket, or a terminal.

use crate::client::Client;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::task::yield_now;
use tokio::time::timeout;

/// Number of bytes per read, small enough that the queue of the image's owner always has room for the answers.
const CHUNK_LEN: usize = 256;

/// How long a connection closed by the image's owner is drained.
const LINGER: Duration = Duration::from_secs(1);

/// Whether bytes are accepted from a client that does not read its answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowControl {
    /// Only after it has read them: a stream with flow control.
    Present,
    /// Always: a serial line has no flow control, and unread answers are lost.
    Absent,
}

/// Serves the client until it disconnects or synchronization is lost for good.
///
/// # Errors
/// Returns the error of reader or writer, which means that the client has disconnected.
pub async fn serve<const FRAME_LEN: usize>(
    client: &impl Client<FRAME_LEN>,
    mut reader: impl AsyncRead + Unpin,
    mut writer: impl AsyncWrite + Unpin,
    flow_control: FlowControl,
) -> io::Result<()> {
    let at_all_times = flow_control == FlowControl::Absent;
    let mut chunk = [0; CHUNK_LEN];
    let mut buffer = [0; FRAME_LEN];
    // Range in `buffer` of the frame being written that has not been sent.
    let mut unsent = 0..0;
    loop {
        if unsent.is_empty() {
            unsent = 0..client.transmit(&mut buffer).map_or(0, <[u8]>::len);
        }
        let is_idle = unsent.is_empty();
        if is_idle && client.is_over() {
            return close(reader, writer).await;
        }
        tokio::select! {
            written = write(&mut writer, buffer.get(unsent.clone()).unwrap_or(&[])), if !is_idle => match written? {
                0 => return Err(io::ErrorKind::WriteZero.into()),
                count => unsent.start += count,
            },
            read = read(&mut reader, &mut chunk), if (is_idle && client.takes_more()) || at_all_times => match read? {
                0 => return Ok(()),
                count => client.receive(chunk.get(..count).unwrap_or(&[])),
            },
            () = client.frame_waits(), if is_idle => {}
            () = client.dismissed() => return Ok(()),
            // One request at a time, so that its answers have room.
            () = client.request_waits(), if (is_idle && client.has_room()) || at_all_times => client.arrive(),
        }
        // Yields after each frame or run of bytes, so that a busy client does not starve the others.
        yield_now().await;
    }
}

/// Closes a connection so that sent data is delivered: unread input would make the system discard it.
async fn close(mut reader: impl AsyncRead + Unpin, mut writer: impl AsyncWrite + Unpin) -> io::Result<()> {
    writer.shutdown().await?;
    let mut chunk = [0; CHUNK_LEN];
    // A client that keeps sending is cut off.
    let drained = timeout(LINGER, async {
        while read(&mut reader, &mut chunk).await? > 0 {}
        Ok(())
    });
    drained.await.unwrap_or(Ok(()))
}

/// Reads once, with a retry after a signal: a terminal reports the interruption even to a non-blocking caller.
///
/// # Errors
/// Returns the errors of the reader except `Interrupted`.
pub async fn read(reader: &mut (impl AsyncRead + Unpin), buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match reader.read(buffer).await {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// Writes once, with the same retry as [`read`].
///
/// # Errors
/// Returns the errors of the writer except `Interrupted`.
pub async fn write(writer: &mut (impl AsyncWrite + Unpin), bytes: &[u8]) -> io::Result<usize> {
    loop {
        match writer.write(bytes).await {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::future::pending;
    use std::pin::Pin;
    use std::task::{Context, Poll};
    use tokio::io::ReadBuf;

    const LEN: usize = 8;

    /// Returns each frame to its client.
    #[derive(Default)]
    struct Echo(RefCell<Vec<u8>>);

    impl Client<LEN> for Echo {
        fn receive(&self, bytes: &[u8]) {
            self.0.borrow_mut().extend(bytes);
        }

        fn transmit<'a>(&self, buffer: &'a mut [u8; LEN]) -> Option<&'a [u8]> {
            let mut received = self.0.borrow_mut();
            if received.len() < LEN {
                return None;
            }
            buffer.iter_mut().zip(received.drain(..LEN)).for_each(|(place, byte)| *place = byte);
            Some(&buffer[..])
        }

        fn is_over(&self) -> bool {
            false
        }

        fn frame_waits(&self) -> impl Future<Output = ()> {
            pending()
        }

        fn dismissed(&self) -> impl Future<Output = ()> {
            pending()
        }
    }

    /// A line on which every other call is interrupted by a signal and the others transfer one byte each.
    #[derive(Default)]
    struct Interrupted {
        calls: usize,
        /// The remaining bytes of the client.
        outgoing: Vec<u8>,
        received: Vec<u8>,
    }

    impl Interrupted {
        fn interrupted(&mut self) -> io::Result<()> {
            self.calls += 1;
            if self.calls.is_multiple_of(2) { Ok(()) } else { Err(io::ErrorKind::Interrupted.into()) }
        }
    }

    impl AsyncRead for Interrupted {
        fn poll_read(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
            buffer: &mut ReadBuf<'_>,
        ) -> Poll<io::Result<()>> {
            self.interrupted()?;
            if !self.outgoing.is_empty() {
                buffer.put_slice(&[self.outgoing.remove(0)]);
            }
            Poll::Ready(Ok(()))
        }
    }

    impl AsyncWrite for Interrupted {
        fn poll_write(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
            bytes: &[u8],
        ) -> Poll<io::Result<usize>> {
            self.interrupted()?;
            self.received.extend(bytes.iter().take(1));
            Poll::Ready(Ok(bytes.len().min(1)))
        }

        fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Ok(()))
        }
    }

    #[tokio::test]
    async fn signals_and_calls_that_move_one_byte_lose_nothing() {
        let frame: Vec<u8> = (1..=LEN as u8).collect();
        let (mut reader, mut writer) =
            (Interrupted { outgoing: frame.clone(), ..Interrupted::default() }, Interrupted::default());

        // Until the client has no more bytes; it is read only after it has received its answer.
        serve(&Echo::default(), &mut reader, &mut writer, FlowControl::Present).await.unwrap();

        assert_eq!(writer.received, frame);
        assert_eq!(writer.calls, 2 * writer.received.len(), "every other call was interrupted");
    }
}
