//! A client on a byte stream: TCP, a Unix socket, or a terminal.

use super::hub::ClientHandle;
use crate::port::MAX_FRAME_LEN;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::task::yield_now;
use tokio::time::timeout;

/// Number of bytes per read, small enough that the gripper's queue always has room for the answers.
const CHUNK_LEN: usize = 256;

/// How long a connection closed by the gripper is drained.
const LINGER: Duration = Duration::from_secs(1);

/// Whether bytes are accepted from a client that does not read its answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FlowControl {
    /// Only after it has read them: a stream with flow control.
    Present,
    /// Always: a serial line has no flow control, and unread answers are lost.
    Absent,
}

/// Serves the client until it disconnects or synchronization is lost for good.
pub(super) async fn serve(
    client: &ClientHandle,
    mut reader: impl AsyncRead + Unpin,
    mut writer: impl AsyncWrite + Unpin,
    flow_control: FlowControl,
) -> io::Result<()> {
    let at_all_times = flow_control == FlowControl::Absent;
    let mut chunk = [0; CHUNK_LEN];
    let mut buffer = [0; MAX_FRAME_LEN];
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
pub(super) async fn read(reader: &mut (impl AsyncRead + Unpin), buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match reader.read(buffer).await {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// Writes once, with the same retry as [`read`].
pub(super) async fn write(writer: &mut (impl AsyncWrite + Unpin), bytes: &[u8]) -> io::Result<usize> {
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
    use crate::port::PortKind;
    use crate::server::hub::Hub;
    use std::pin::Pin;
    use std::task::{Context, Poll};
    use tokio::io::ReadBuf;
    use wsg_protocol::{Command, FrameEncoder, Reply, Status};

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
        let hub = Hub::of_test();
        let client = hub.connect(PortKind::Tcp, "interrupted").unwrap();
        let stop = Command::Stop;
        let outgoing = FrameEncoder::new(stop.id().code(), stop).collect();
        let (mut reader, mut writer) =
            (Interrupted { outgoing, ..Interrupted::default() }, Interrupted::default());

        // Until the client has no more bytes; it is read only after it has received its answer.
        serve(&client, &mut reader, &mut writer, FlowControl::Present).await.unwrap();

        let answer = Reply::status_only(stop.id(), Status::Success);
        assert_eq!(writer.received, FrameEncoder::new(stop.id().code(), answer).collect::<Vec<u8>>());
        assert_eq!(writer.calls, 2 * writer.received.len(), "every other call was interrupted");
    }
}
