//! UDP: one frame or line per datagram. Frames go to a fixed port of whoever sent last, lines to the port that asked.

use super::echoes::Echoes;
use super::hub::{Client, Hub};
use crate::port::{MAX_FRAME_LEN, PortKind};
use anyhow::{Context, Result};
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Instant;
use tokio::net::UdpSocket;
use tokio::task::yield_now;

/// The longest datagram there is.
const DATAGRAM_LEN: usize = 65_535;

/// A signal, or what the system tells about an earlier datagram that found nobody.
const fn is_of_the_past(error: ErrorKind) -> bool {
    matches!(error, ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// `remote_port`: where answers go; `None`: to the port that asked. `kind` says which protocol is spoken.
pub(super) async fn serve(
    hub: Rc<Hub>,
    socket: UdpSocket,
    remote_port: Option<u16>,
    kind: PortKind,
) -> Result<()> {
    let client =
        hub.connect(kind, &socket.local_addr()?.to_string()).context("the gripper has no place for UDP")?;
    let mut datagram = vec![0; DATAGRAM_LEN];
    let mut remote: Option<SocketAddr> = None;
    let mut echoes = Echoes::default();
    loop {
        send_waiting(&client, &socket, remote, &mut echoes).await;
        tokio::select! {
            received = socket.recv_from(&mut datagram) => match received {
                Ok((len, from)) => {
                    let received = datagram.get(..len).unwrap_or(&[]);
                    if !echoes.must_end(Instant::now(), from, received) {
                        let here = SocketAddr::new(from.ip(), remote_port.unwrap_or(from.port()));
                        if remote.is_some_and(|before| before != here) {
                            client.end_updates();
                            send_waiting(&client, &socket, remote, &mut echoes).await;
                        }
                        remote = Some(here);
                        client.receive(received);
                    }
                    // A client that sends without end gets no more than its turn.
                    yield_now().await;
                }
                Err(error) if is_of_the_past(error.kind()) => {}
                Err(error) => return Err(error).context("UDP receives no more"),
            },
            () = client.frame_waits() => {}
            () = client.request_waits() => client.arrive(),
        }
    }
}

/// Sends every frame that waits.
async fn send_waiting(client: &Client, socket: &UdpSocket, remote: Option<SocketAddr>, echoes: &mut Echoes) {
    let mut buffer = [0; MAX_FRAME_LEN];
    while let Some(frame) = client.transmit(&mut buffer) {
        if let Some(address) = remote {
            echoes.sent(frame);
            // Nobody may listen there; a datagram is lost then, as datagrams are.
            let _ = socket.send_to(frame, address).await;
        }
    }
}
