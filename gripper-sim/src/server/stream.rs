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
            written = writer.write(buffer.get(left.clone()).unwrap_or(&[])), if !is_idle => match written? {
                0 => return Err(io::ErrorKind::WriteZero.into()),
                count => left.start += count,
            },
            read = reader.read(&mut chunk), if (is_idle && client.takes_more()) || at_all_times => match read? {
                0 => return Ok(()),
                count => client.receive(chunk.get(..count).unwrap_or(&[])),
            },
            () = client.frame_waits(), if is_idle => {}
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
        while reader.read(&mut chunk).await? > 0 {}
        Ok(())
    });
    drained.await.unwrap_or(Ok(()))
}
