//! A gripper on a CAN bus: filtering of received frames, segmentation of messages into CAN frames, and Linux SocketCAN.

use super::hub::ClientHandle;
use super::open_line::OpenLine;
use crate::port::MAX_FRAME_LEN;
use anyhow::Result;
use embedded_can::{Frame, Id};
use fieldbus_host::Client;
use wsg_protocol::can::{Identifiers, Segments};

/// Passes the data of a CAN frame to the gripper if the identifier matches. The gripper finds the message boundaries.
pub(super) fn receive<F: Frame>(client: &ClientHandle, identifiers: Identifiers, frame: &F) {
    if frame.id() == Id::Standard(identifiers.gripper().receive) && frame.is_data_frame() {
        client.receive(frame.data());
    }
}

/// Returns the CAN frames of the gripper's next message; none if there is no message.
pub(super) fn transmit<F: Frame>(client: &ClientHandle, identifiers: Identifiers) -> Vec<F> {
    let mut buffer = [0; MAX_FRAME_LEN];
    let message = client.transmit(&mut buffer).unwrap_or(&[]);
    let segments = Segments::new(message.iter().copied());
    segments.filter_map(|segment| segment.frame(identifiers.gripper().transmit)).collect()
}

#[cfg(target_os = "linux")]
mod interface {
    use super::*;
    use crate::port::PortKind;
    use crate::server::hub::Hub;
    use crate::server::open_line::Place;
    use anyhow::Context;
    use socketcan::tokio::CanSocket;
    use socketcan::{CanFrame, SocketOptions};
    use std::collections::VecDeque;
    use std::io;
    use std::sync::Arc;
    use tokio::time::{Duration, sleep};

    /// Retry interval when the interface has no room: a few frames on the slowest bus.
    const RETRY: Duration = Duration::from_millis(2);

    /// Opens the line on a CAN interface.
    pub(in crate::server) fn open(name: &str, identifiers: Identifiers) -> Result<OpenLine> {
        let open = || {
            let socket = CanSocket::open(name)?;
            // A gripper does not evaluate error frames of the controller.
            socket.set_error_filter_drop_all()?;
            io::Result::Ok(socket)
        };
        let socket = open().with_context(|| format!("the CAN interface {name} cannot be opened"))?;
        let serve = |name: String| move |hub| serve(hub, socket, name, identifiers);
        Ok(OpenLine::new("can", Place::Path(name.into()), serve(name.to_owned())))
    }

    async fn serve(hub: Arc<Hub>, socket: CanSocket, name: String, identifiers: Identifiers) -> Result<()> {
        let client = hub
            .connect(PortKind::Can, &name)
            .context("all client places are taken; none is left for the CAN interface")?;
        exchange(&client, &socket, identifiers)
            .await
            .with_context(|| format!("the CAN interface {name} failed"))
    }

    async fn exchange(client: &ClientHandle, socket: &CanSocket, identifiers: Identifiers) -> io::Result<()> {
        let mut waiting: VecDeque<CanFrame> = VecDeque::new();
        loop {
            if waiting.is_empty() {
                waiting.extend(transmit::<CanFrame>(client, identifiers));
            }
            let next = waiting.front().copied();
            let send = async {
                match next {
                    Some(frame) => write(socket, frame).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                sent = send => {
                    sent?;
                    waiting.pop_front();
                }
                received = socket.read_frame() => match received {
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    received => receive(client, identifiers, &received?),
                },
                () = client.frame_waits(), if next.is_none() => {}
            }
        }
    }

    /// Sends a frame as soon as the interface has room. Its queue is short, so a full queue is not an error.
    async fn write(socket: &CanSocket, frame: CanFrame) -> io::Result<()> {
        const ENOBUFS: i32 = rustix::io::Errno::NOBUFS.raw_os_error();
        loop {
            match socket.write_frame(frame).await {
                Err(error) if error.raw_os_error() == Some(ENOBUFS) => sleep(RETRY).await,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }
}

#[cfg(target_os = "linux")]
pub(super) use interface::open;

/// Reports that this system does not have SocketCAN.
#[cfg(not(target_os = "linux"))]
pub(super) fn open(name: &str, _: Identifiers) -> Result<OpenLine> {
    anyhow::bail!("the CAN interface {name} cannot be opened: SocketCAN requires Linux")
}
