//! A client on a stream of bytes: TCP, a Unix socket, a terminal.

use super::hub::Client;
use crate::port::MAX_FRAME_LEN;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::task::yield_now;
use tokio::time::timeout;

/// Bytes read at a time: few enough that the answers to them always find room in the gripper's queue.
const CHUNK_LEN: usize = 256;

/// How long a connection that is closed by the gripper is read from for nothing.
const LINGER: Duration = Duration::from_secs(1);

/// When bytes are taken from a client that does not read its answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pace {
    /// Not before it has read them: a stream with flow control.
    OfTheReader,
    /// At all times: a serial line has no flow control, and its answers are lost.
    OfTheLine,
}

/// Serves the client until it is gone, or can be understood no more.
pub(super) async fn serve(
    client: &Client,
    mut reader: impl AsyncRead + Unpin,
    mut writer: impl AsyncWrite + Unpin,
    pace: Pace,
) -> io::Result<()> {
    let at_all_times = pace == Pace::OfTheLine;
    let mut chunk = [0; CHUNK_LEN];
    let mut buffer = [0; MAX_FRAME_LEN];
    // What is left of the frame being written: from where to where in `buffer`.
    let mut left = 0..0;
    loop {
        if left.is_empty() {
            left = 0..client.transmit(&mut buffer).map_or(0, <[u8]>::len);
        }
        let is_idle = left.is_empty();
        if is_idle && client.is_over() {
            return close(reader, writer).await;
        }
        tokio::select! {
            written = write(&mut writer, buffer.get(left.clone()).unwrap_or(&[])), if !is_idle => match written? {
                0 => return Err(io::ErrorKind::WriteZero.into()),
                count => left.start += count,
            },
            read = read(&mut reader, &mut chunk), if (is_idle && client.takes_more()) || at_all_times => match read? {
                0 => return Ok(()),
                count => client.receive(chunk.get(..count).unwrap_or(&[])),
            },
            () = client.frame_waits(), if is_idle => {}
            () = client.dismissed() => return Ok(()),
            // One at a time, so that its answers find room.
            () = client.request_waits(), if (is_idle && client.has_room()) || at_all_times => client.arrive(),
        }
        // One frame, or one run of bytes, is a turn: clients without end leave the others theirs.
        yield_now().await;
    }
}

/// Closes a connection so that what was sent arrives: what comes in meanwhile would have the system take it back.
async fn close(mut reader: impl AsyncRead + Unpin, mut writer: impl AsyncWrite + Unpin) -> io::Result<()> {
    writer.shutdown().await?;
    let mut chunk = [0; CHUNK_LEN];
    // Whoever goes on sending is cut off.
    let drained = timeout(LINGER, async {
        while read(&mut reader, &mut chunk).await? > 0 {}
        Ok(())
    });
    drained.await.unwrap_or(Ok(()))
}

/// One read, made again when a signal has interrupted it: a terminal says so even to who does not wait.
pub(super) async fn read(reader: &mut (impl AsyncRead + Unpin), buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        match reader.read(buffer).await {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// One write, made again like a [`read`].
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
    use crate::config::Config;
    use crate::port::PortKind;
    use crate::server::hub::Hub;
    use crate::server::lines::Profile;
    use std::pin::Pin;
    use std::sync::Arc;
    use std::task::{Context, Poll};
    use tokio::io::ReadBuf;
    use wsg_protocol::{Command, FrameEncoder, Reply, Status};

    /// A line on which every other call is interrupted by a signal, and the others move one byte each.
    #[derive(Default)]
    struct Nervous {
        calls: usize,
        /// What the client still says.
        says: Vec<u8>,
        hears: Vec<u8>,
    }

    impl Nervous {
        fn interrupted(&mut self) -> io::Result<()> {
            self.calls += 1;
            if self.calls.is_multiple_of(2) { Ok(()) } else { Err(io::ErrorKind::Interrupted.into()) }
        }
    }

    impl AsyncRead for Nervous {
        fn poll_read(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
            buffer: &mut ReadBuf<'_>,
        ) -> Poll<io::Result<()>> {
            self.interrupted()?;
            if !self.says.is_empty() {
                buffer.put_slice(&[self.says.remove(0)]);
            }
            Poll::Ready(Ok(()))
        }
    }

    impl AsyncWrite for Nervous {
        fn poll_write(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
            bytes: &[u8],
        ) -> Poll<io::Result<usize>> {
            self.interrupted()?;
            self.hears.extend(bytes.iter().take(1));
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
        let hub = Arc::new(Hub::new(Config::default(), Profile::Instant, 0, None));
        let client = hub.connect(PortKind::Tcp, "nervous").unwrap();
        let stop = Command::Stop;
        let says = FrameEncoder::new(stop.id().code(), stop).collect();
        let (mut reader, mut writer) = (Nervous { says, ..Nervous::default() }, Nervous::default());

        // Until the client says no more; it is not heard before it has its answer.
        serve(&client, &mut reader, &mut writer, Pace::OfTheReader).await.unwrap();

        let answer = Reply::status_only(stop.id(), Status::Success);
        assert_eq!(writer.hears, FrameEncoder::new(stop.id().code(), answer).collect::<Vec<u8>>());
        assert_eq!(writer.calls, 2 * writer.hears.len(), "every other call was interrupted");
    }
}
