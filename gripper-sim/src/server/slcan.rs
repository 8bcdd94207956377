//! A gripper on a CAN bus over a serial line with SLCAN.

use super::can;
use super::hub::ClientHandle;
use bus_slcan::{Adapter, ClassicFrame, Decoder, Line, encode};
use fieldbus_host::{Client, stream};
use std::io;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::task::yield_now;
use wsg_protocol::can::Identifiers;

/// The gripper's role on the serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    /// The adapter: the client that opens the line is the host and sees the gripper on the adapter's bus.
    Adapter,
    /// The host: an adapter with a CAN bus is connected to the line.
    Host,
}

/// Initialization sent by the host: close the channel in any state, 500 kbit/s, open the channel.
const OPENING: &[u8] = b"\rC\rS6\rO\r";

/// Number of bytes per read.
const CHUNK_LEN: usize = 256;

/// Capacity of the queue to a host that does not read, in bytes. Excess frames are lost, as on a bus.
const QUEUE_LEN: usize = 16 * 1024;

/// Serves the client until the line closes.
pub(super) async fn serve(
    client: &ClientHandle,
    mut reader: impl AsyncRead + Unpin,
    mut writer: impl AsyncWrite + Unpin,
    identifiers: Identifiers,
    side: Side,
) -> io::Result<()> {
    let mut decoder = Decoder::new();
    let mut adapter = (side == Side::Adapter).then(Adapter::new);
    let mut waiting: Vec<u8> = if side == Side::Host { OPENING.to_vec() } else { Vec::new() };
    let mut chunk = [0; CHUNK_LEN];
    loop {
        // Messages are taken from the gripper while the channel is closed, too, and discarded.
        loop {
            let frames: Vec<ClassicFrame> = can::transmit(client, identifiers);
            if frames.is_empty() {
                break;
            }
            if is_open(adapter) && waiting.len() < QUEUE_LEN {
                waiting.extend(frames.iter().flat_map(|frame| encode(frame).as_bytes().to_vec()));
            }
        }
        tokio::select! {
            written = stream::write(&mut writer, &waiting), if !waiting.is_empty() => match written? {
                0 => return Err(io::ErrorKind::WriteZero.into()),
                count => drop(waiting.drain(..count)),
            },
            read = stream::read(&mut reader, &mut chunk) => match read? {
                0 => return Ok(()),
                count => {
                    for &byte in chunk.iter().take(count) {
                        let Some(line) = decoder.push::<ClassicFrame>(byte) else { continue };
                        if let Some(adapter) = &mut adapter {
                            waiting.extend(adapter.answer(&line));
                        }
                        if let Line::Frame(frame) = line
                            && is_open(adapter)
                        {
                            can::receive(client, identifiers, &frame);
                        }
                    }
                }
            },
            () = client.frame_waits() => {}
        }
        yield_now().await;
    }
}

/// Returns whether the channel is open. On the host side it always is.
fn is_open(adapter: Option<Adapter>) -> bool {
    adapter.is_none_or(|adapter| adapter.is_open())
}
